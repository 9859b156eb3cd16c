"""Binary collisions over three decades of velocity, and what they show about linear springs.

`sweeps_of` collides two equal particles of the scene with every contact model, on the collision bench;
`sweep_columns` gives `collisions.csv`, with the exact values of Zhou (2011). `assess` verifies one statement
with these columns and the runs of the scene: a spring constant from one velocity is wrong a decade away from
it, and Eq. 19 (Zhou 2011) per contact corrects it. `soft_spring_note` warns of a constant that is too soft
for the scene.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from granflow import GranflowError, Scene, SceneError
from granflow.contact import theory
from granflow.contact.material import PairMaterial
from granflow.geometry.sphere import sphere_mass
from granflow.studies.bench import HeadOnCollision, Outcomes, collide
from granflow.studies.compare.bed import MIN_CONTACTS
from granflow.studies.compare.runs import (
    LINEAR_KEYS,
    LawVariant,
    VariantRun,
    at_end,
    automatic_plan,
    densest_stage,
    restitution_for,
)
from granflow.studies.figures import percent

# ---------------------------------------------------------------- collisions

DECADES_BELOW, DECADES_ABOVE, PER_DECADE = 2, 1, 4
"""Range of velocities about the reference velocity in decades, and velocities per decade."""
FINE_STEPS = 100
"""Steps in the shortest collision: the remaining error results from the contact model."""
COARSE_STEPS = 10
"""Steps in an elastic Hertz collision at the reference velocity: the time step for one known velocity."""
STEPS = {"fine": FINE_STEPS, "coarse": COARSE_STEPS}
"""Time steps by name, in steps per collision."""


@dataclass(frozen=True)
class CollisionSubject:
    """Representative collision of the scene: two equal particles of its first group.

    `diameter` [m], `mass_eff` [kg], `reference_velocity` [m/s].
    """

    material: str
    pair_key: str
    pair: PairMaterial
    diameter: float
    mass_eff: float
    reference_velocity: float

    @property
    def radius_eff(self) -> float:
        """Effective radius [m]."""
        return 0.25 * self.diameter

    @property
    def hertz_stiffness(self) -> float:
        """Hertz stiffness k [N/m^1.5]."""
        return float(theory.hertz_stiffness(self.pair.modulus_eff, self.radius_eff))

    @property
    def velocities(self) -> np.ndarray:
        """Approach velocities (n,) [m/s], logarithmically spaced.

        From a hundredth to ten times the reference velocity.
        """
        count = (DECADES_BELOW + DECADES_ABOVE) * PER_DECADE + 1
        return self.reference_velocity * np.logspace(-DECADES_BELOW, DECADES_ABOVE, count)

    def duration(self, velocity: float) -> float:
        """Duration of a contact with Zhou's model [s] (Eq. 13)."""
        e = self.pair.restitution_at(velocity)
        return float(theory.duration(e, self.hertz_stiffness, self.mass_eff, velocity))

    def overlap_max(self, velocity: float) -> float:
        """Maximum overlap of a Hertz contact [m] (Eq. 5)."""
        return float(theory.overlap_max(self.hertz_stiffness, self.mass_eff, velocity))


@dataclass(frozen=True)
class LawSweep:
    """Results of the collisions with one contact model by name in STEPS.

    `refused`: reason of a rejection by name in STEPS, such as an unstable time step.
    """

    variant: LawVariant
    outcomes: dict[str, Outcomes]
    refused: dict[str, str]


def subject_of(scene: Scene, reference_velocity: float) -> CollisionSubject | None:
    """Two equal particles of the scene's first group, of mean diameter; None if their pair has no
    restitution.

    `reference_velocity` [m/s]. Without a pair of the material with itself, another pair of the material is
    used.
    """
    plan = automatic_plan(scene)
    name, group = next(iter(scene.particles.items()))
    keys = [
        scene.pair_key(group.material, group.material),
        *(key for key in scene.pairs if group.material in key),
    ]
    key = next(key for key in keys if key in scene.pairs)
    pair = plan.pair(*key.split("-"))
    if pair.restitution is None:
        return None
    diameter = float(np.mean(plan.scene.particles[name].diameters))
    mass = sphere_mass(0.5 * diameter, scene.materials[group.material].density)
    return CollisionSubject(group.material, key, pair, diameter, 0.5 * mass, reference_velocity)


def sweeps_of(
    scene: Scene,
    subject: CollisionSubject,
    variants: Sequence[LawVariant],
    arch: str = "cpu",
    steps: Sequence[str] = tuple(STEPS),
) -> list[LawSweep]:
    """Run the collisions with every contact model, with a fine time step and one from the reference velocity.

    `steps`: names in STEPS. Fine: FINE_STEPS in the shortest collision; coarse: COARSE_STEPS in an elastic
    collision at the reference velocity. Rejected combinations are in `LawSweep.refused`.
    """
    shortest = min(subject.duration(velocity) for velocity in subject.velocities)
    elastic = float(
        theory.duration(1.0, subject.hertz_stiffness, subject.mass_eff, subject.reference_velocity)
    )
    time_steps = {"fine": shortest / FINE_STEPS, "coarse": elastic / COARSE_STEPS}
    found = []
    for variant in variants:
        outcomes = {}
        refused = {}
        for name in steps:
            try:
                collisions = _collisions(scene, subject, variant)
                outcomes[name] = collide(
                    collisions, variant.normal, time_steps[name], arch, scene.run.precision
                )
            except (GranflowError, SceneError, ValueError) as error:
                refused[name] = str(error)
        found.append(LawSweep(variant, outcomes, refused))
    return found


def _collisions(scene: Scene, subject: CollisionSubject, variant: LawVariant) -> list[HeadOnCollision]:
    """Head-on collisions of the subject at all velocities, with the restitution of the variant."""
    material = scene.materials[subject.material].model_dump(by_alias=True, exclude_none=True)
    e = restitution_for(scene, subject.pair_key, str(variant.normal["law"]), subject.reference_velocity)
    return [
        HeadOnCollision(material, e, subject.diameter, float(velocity)) for velocity in subject.velocities
    ]


def sweep_columns(subject: CollisionSubject, sweeps: Sequence[LawSweep]) -> dict[str, np.ndarray]:
    """Columns of collisions.csv: one row per contact model, time step and velocity, in SI units.

    Exact values: duration and maximum overlap of Zhou (2011), Eqs. 13 and 5, and the target restitution.
    Empty without any outcome.
    """
    velocity = subject.velocities
    exact = {
        "duration_exact": np.array([subject.duration(v) for v in velocity]),
        "overlap_max_exact": np.array([subject.overlap_max(v) for v in velocity]),
        "restitution_exact": np.array([subject.pair.restitution_at(v) for v in velocity]),
    }
    rows: list[dict[str, np.ndarray]] = []
    for sweep in sweeps:
        for name, reached in sweep.outcomes.items():
            rows.append(
                {
                    "law": np.repeat(sweep.variant.key, len(velocity)),
                    "step": np.repeat(name, len(velocity)),
                    "time_step": np.repeat(reached.time_step, len(velocity)),
                    "velocity": velocity,
                    "velocity_over_reference": velocity / subject.reference_velocity,
                    "duration": reached.duration,
                    "overlap_max": reached.overlap_max,
                    "restitution": reached.restitution,
                    "force_max": reached.force_max,
                    **exact,
                }
            )
    return {key: np.concatenate([row[key] for row in rows]) for key in rows[0]} if rows else {}


@dataclass(frozen=True)
class CollisionDeviation:
    """Relative deviations from the exact solution for one contact model at one velocity."""

    duration: float
    overlap_max: float
    restitution: float


def deviation(
    columns: Mapping[str, np.ndarray], law: str, step: str, over_reference: float
) -> CollisionDeviation | None:
    """Deviation of a contact model at a multiple of the reference velocity; None without such collisions.

    `columns`: from `sweep_columns`; `step`: name in STEPS.
    """
    if not columns:
        return None
    is_row = (columns["law"] == law) & (columns["step"] == step)
    is_row &= np.isclose(columns["velocity_over_reference"], over_reference)
    if not is_row.any():
        return None

    def off(name: str) -> float:
        return float(columns[name][is_row][0] / columns[f"{name}_exact"][is_row][0] - 1.0)

    return CollisionDeviation(off("duration"), off("overlap_max"), off("restitution"))


def floor_velocity(subject: CollisionSubject) -> float:
    """Velocity [m/s] below which Eq. 19 per contact uses the spring of this velocity, as in the scene."""
    return theory.MIN_VELOCITY_SHARE * float(subject.velocities.max())


# ---------------------------------------------------------------- assessment of linear springs

TOLERANCE = 0.1
"""Threshold of the relative change over a decade of velocity."""
PER_CONTACT, ONE_SPRING = LINEAR_KEYS
"""Keys of the two variants of the linear contact model."""
DECADE = 10.0
"""Ratio of velocities at which the springs are assessed."""


@dataclass(frozen=True)
class Assessment:
    """A question, whether the answer is yes (None: not measured), and the numbers behind it as a sentence."""

    part: str
    holds: bool | None
    why: str

    @property
    def conclusion(self) -> str:
        """The answer as text."""
        return {True: "yes", False: "no", None: "not measured"}[self.holds]


def assess(columns: Mapping[str, np.ndarray], runs: Sequence[VariantRun]) -> list[Assessment]:
    """Answer all questions, for binary collisions and for the scene; empty without a linear contact model.

    `columns`: of collisions.csv, possibly empty; `runs`: of all variants.
    """
    compared = {run.variant.key for run in runs}.union(columns["law"].tolist() if columns else ())
    if not compared & {ONE_SPRING, PER_CONTACT}:
        return []
    return [*assess_collisions(columns), *_assess_scene(runs)]


def assess_collisions(columns: Mapping[str, np.ndarray]) -> list[Assessment]:
    """Assess accuracy and stability from the columns of collisions.csv."""
    return [_assess_one_spring(columns), _assess_per_contact(columns), _assess_stability(columns)]


def _assess_one_spring(columns: Mapping[str, np.ndarray]) -> Assessment:
    """Assess the accuracy of the spring from one velocity a decade away from it.

    Theory: relative to those of Hertz, duration and overlap change by the factor 10^0.2 per decade of
    velocity.
    """
    part = "Is a spring from one velocity wrong at a tenth of it or at ten times of it?"
    slow = drift(columns, ONE_SPRING, 1.0 / DECADE)
    fast = drift(columns, ONE_SPRING, DECADE)
    if slow is None or fast is None:
        return Assessment(part, None, "The comparison does not include linear.")
    worst = _worst(slow, fast)
    why = (
        f"Relative to Zhou and Hertz the contact duration changes by {_percent(slow.duration)} and the "
        f"maximum overlap by {_percent(slow.overlap_max)} from the reference velocity to a tenth of it, by "
        f"{_percent(fast.duration)} and {_percent(fast.overlap_max)} to ten times it (10^0.2 − 1 is "
        f"{_percent(DECADE**0.2 - 1.0)})."
    )
    return Assessment(part, worst > TOLERANCE, why)


def _assess_per_contact(columns: Mapping[str, np.ndarray]) -> Assessment:
    """Assess the accuracy of Eq. 19 per contact over both decades.

    The changes must be below TOLERANCE; constant deviations result from the linear spring and are only
    reported.
    """
    part = "Does Eq. 19 per contact correct this?"
    slow = drift(columns, PER_CONTACT, 1.0 / DECADE)
    fast = drift(columns, PER_CONTACT, DECADE)
    at_reference = deviation(columns, PER_CONTACT, "fine", 1.0)
    if slow is None or fast is None or at_reference is None:
        return Assessment(part, None, "The comparison does not include linear.")
    worst = _worst(slow, fast)
    why = (
        f"Over both decades the same numbers change by at most {_percent(worst, signed=False)}. Deviations "
        f"at every velocity: contact duration {_percent(at_reference.duration)}, maximum overlap "
        f"{_percent(at_reference.overlap_max)}, due to the linear spring (pi instead of 2.94 in units of "
        "dmax/v) and the dashpot."
    )
    below = drift(columns, PER_CONTACT, 1.0 / DECADE**2)
    if below is not None:
        why += (
            f" Another decade lower, below the velocity limit of the spring constant, the changes are "
            f"{_percent(below.duration)} and {_percent(below.overlap_max)}."
        )
    return Assessment(part, worst < TOLERANCE, why)


def drift(columns: Mapping[str, np.ndarray], law: str, over_reference: float) -> CollisionDeviation | None:
    """Relative change of the ratio of simulated to exact values from the reference velocity to a multiple of
    it.

        (s / s_exact at over_reference * v) / (s / s_exact at v) - 1

    None if the columns lack these collisions.
    """
    at_multiple = deviation(columns, law, "fine", over_reference)
    at_reference = deviation(columns, law, "fine", 1.0)
    if at_multiple is None or at_reference is None:
        return None

    def change(name: str) -> float:
        return float((1.0 + getattr(at_multiple, name)) / (1.0 + getattr(at_reference, name)) - 1.0)

    return CollisionDeviation(change("duration"), change("overlap_max"), change("restitution"))


def _worst(*drifts: CollisionDeviation) -> float:
    """Largest magnitude of the relative changes of contact duration and maximum overlap."""
    return max(
        abs(number) for per_contact in drifts for number in (per_contact.duration, per_contact.overlap_max)
    )


def _assess_stability(columns: Mapping[str, np.ndarray]) -> Assessment:
    """Assess the stability of the spring from one velocity at a fixed time step.

    The measure is the effect of the time step on the restitution a decade above the reference velocity.
    """
    part = "Does a spring from one velocity become unstable at ten times of it?"
    laws = list(dict.fromkeys(columns["law"].tolist())) if columns else []
    effect_by_law = {law: _time_step_effect(columns, law) for law in laws}
    one_spring = effect_by_law.pop(ONE_SPRING, None)
    if one_spring is None:
        return Assessment(part, None, "The comparison does not include linear.")
    others = ", ".join(f"{law} {_percent(off)}" for law, off in effect_by_law.items() if off is not None)
    why = (
        f"With the time step of {COARSE_STEPS} steps per contact at the reference velocity, the restitution "
        f"at ten times the velocity differs by {_percent(one_spring)} from that with a fine time step: the "
        "contact duration, and with it the stable time step, does not depend on the velocity. Other contact "
        f"models become stiffer with the velocity: {others or 'none'}."
    )
    return Assessment(part, one_spring > TOLERANCE, why)


def _time_step_effect(columns: Mapping[str, np.ndarray], law: str) -> float | None:
    """Relative difference of the restitution with the reference and the fine time step, at a decade above.

    None without such collisions, or if the spheres do not separate with the fine time step.
    """
    coarse = deviation(columns, law, "coarse", DECADE)
    fine = deviation(columns, law, "fine", DECADE)
    if coarse is None or fine is None or fine.restitution <= -1.0:
        return None
    return (1.0 + coarse.restitution) / (1.0 + fine.restitution) - 1.0


def _assess_scene(runs: Sequence[VariantRun]) -> list[Assessment]:
    """Assess both springs in the scene: aborts, and the overlaps of the bed relative to those of Hertz.

    A deviation above TOLERANCE counts as wrong.
    """
    one_spring_part = "Is one spring for all contacts wrong in this scene?"
    per_contact_part = "Does Eq. 19 per contact correct this in the scene?"
    by_key = {run.variant.key: run for run in runs}
    one_spring = by_key.get(ONE_SPRING)
    per_contact = by_key.get(PER_CONTACT)
    if one_spring is None or per_contact is None:
        why = "The comparison does not include linear, or linear cannot run the scene."
        return [Assessment(one_spring_part, None, why), Assessment(per_contact_part, None, why)]
    found = []
    for part, run in ((one_spring_part, one_spring), (per_contact_part, per_contact)):
        off, text = _bed_overlap(run, runs)
        holds = None
        if run.stopped or np.isfinite(off):
            is_wrong = bool(run.stopped) or abs(off) > TOLERANCE
            holds = is_wrong if run is one_spring else not is_wrong
        found.append(Assessment(part, holds, text))
    return found


def _bed_overlap(run: VariantRun, runs: Sequence[VariantRun]) -> tuple[float, str]:
    """Relative deviation of the mean overlap of the densest bed from that of Hertz, and a sentence.

    The first complete run replaces Hertz where Hertz is not compared.
    """
    stage = densest_stage(runs)
    finished = [other for other in runs if not other.stopped] or list(runs)
    reference = next((other for other in finished if other.variant.key == "hertz"), finished[0])
    off = float("nan")
    count = at_end(stage, "contact_count")(reference)
    if count >= MIN_CONTACTS:
        overlap = at_end(stage, "overlap_mean")
        off = run.mean(overlap) / reference.mean(overlap) - 1.0
    if run.stopped:
        return (
            off,
            f"The run was aborted at {run.time:.4g} s: {run.stopped.partition(': ')[2].partition('. ')[0]}.",
        )
    if not np.isfinite(off):
        return (
            off,
            f"The run is complete, but the stage {stage} ends with too few contacts for an assessment of the "
            "bed.",
        )
    return off, (
        f"The run is complete. Mean overlap at the end of the stage {stage} relative to "
        f"{reference.variant.key}: {_percent(off)}; static loads act on springs chosen for impacts."
    )


def _percent(share: float, signed: bool = True) -> str:
    """A fraction in percent with one digit and a typographic minus sign."""
    text = f"{100.0 * share:+.1f} %" if signed else f"{100.0 * share:.1f} %"
    return text.replace("-", "−")


# ---------------------------------------------------------------- a spring that is too soft

MARGIN = 1.5
"""Velocity over the reference velocity above which the spring counts as too soft: at a wall of the same
material, the overlap of an impact is that of two particles at 1.2 times the velocity."""


def soft_spring_note(runs: Sequence[VariantRun], subject: CollisionSubject | None) -> str:
    """The sentence, if the largest overlap is that of an impact above the reference velocity; otherwise "".

    The overlap is that of the first complete run without this spring. It determines a velocity by Eq. 5 of
    Zhou (2011):

        d / d0 = (v / v0)^(4/5)        K / K0 = (v / v0)^(2/5)        (Eq. 19)
    """
    spring = next((run for run in runs if run.variant.key == ONE_SPRING), None)
    others = [run for run in runs if run is not spring and not run.stopped]
    if spring is None or subject is None or not others:
        return ""
    overlap = float(np.nanmax(others[0].columns["overlap_largest"], initial=0.0))
    reference = subject.reference_velocity
    ratio = (overlap / (2.0 * subject.overlap_max(reference) / subject.diameter)) ** 1.25
    if ratio < MARGIN:
        return ""
    return (
        f"{spring.variant.title} is softer than the impacts of this scene require: the largest overlap with "
        f"{others[0].variant.title}, {percent(overlap)} of the radius, is that of an impact at "
        f"{ratio * reference:.2g} m/s, for which Eq. 19 gives a spring {ratio**0.4:.2g} times as stiff. Its "
        "velocity is --reference-velocity, by default a tenth of the largest expected impact velocity "
        "(run.velocity_max); in a scene it is contact.normal.stiffness.reference_velocity."
    )
