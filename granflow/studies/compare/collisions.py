"""Binary collisions over three decades of velocity.

They show the range of a spring constant from one velocity, and the effect of Eq. 19 (Zhou 2011) per contact.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from granflow import GranflowError, Scene, SceneError
from granflow.contact import theory
from granflow.contact.material import PairMaterial
from granflow.geometry.shape import sphere_mass
from granflow.studies.bench import HeadOnCollision, Outcomes, collide_all
from granflow.studies.compare.runs import LawVariant, automatic_plan, restitution_for

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
    plan, (name, group) = automatic_plan(scene), next(iter(scene.particles.items()))
    keys = [
        scene.pair_key(group.material, group.material),
        *(key for key in scene.pairs if group.material in key),
    ]
    key = next(key for key in keys if key in scene.pairs)
    pair = plan.pair(*key.split("-"))
    if pair.restitution is None:
        return None
    diameter = float(np.mean(plan.group_diameters[name]))
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
                outcomes[name] = collide_all(
                    variant.normal, collisions, time_steps[name], arch, scene.run.precision
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
            labels = {"law": sweep.variant.key, "step": name}
            rows.append(
                {key: np.repeat(word, len(velocity)) for key, word in labels.items()}
                | {"time_step": np.repeat(reached.time_step, len(velocity)), "velocity": velocity}
                | {"velocity_over_reference": velocity / subject.reference_velocity}
                | {"duration": reached.duration, "overlap_max": reached.overlap_max}
                | {"restitution": reached.restitution, "force_max": reached.force_max}
                | exact
            )
    return {key: np.concatenate([row[key] for row in rows]) for key in rows[0]} if rows else {}


@dataclass(frozen=True)
class CollisionDeviation:
    """Relative deviations from the exact solution for one contact model at one velocity."""

    duration: float
    overlap_max: float
    restitution: float


def deviation(
    columns: dict[str, np.ndarray], law: str, step: str, over_reference: float
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
    names = ("duration", "overlap_max", "restitution")
    return CollisionDeviation(
        *(float(columns[n][is_row][0] / columns[f"{n}_exact"][is_row][0] - 1.0) for n in names)
    )


def floor_velocity(subject: CollisionSubject) -> float:
    """Velocity [m/s] below which Eq. 19 per contact uses the spring of this velocity, as in the scene."""
    return theory.MIN_VELOCITY_SHARE * float(subject.velocities.max())
