"""Assessment of linear springs: a constant from one velocity against Eq. 19 (Zhou 2011) per contact.

Statement to verify: one spring constant is wrong a decade away from its velocity, and Eq. 19 corrects it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from granflow.studies.compare.collisions import COARSE_STEPS, CollisionDeviation, CollisionSubject, deviation
from granflow.studies.compare.runs import MIN_CONTACTS, VariantRun, at_end, densest_stage
from granflow.studies.tables import percent

TOLERANCE = 0.1
"""Threshold of the relative change over a decade of velocity."""
ONE_SPRING, PER_CONTACT = "linear_reference", "linear_onset"
"""Keys of the two variants of the linear contact model."""
DECADE = 10.0
"""Ratio of velocities at which the springs are assessed."""


@dataclass(frozen=True)
class Assessment:
    """A statement, whether it holds (None: not measured), and the numbers behind it as a sentence."""

    part: str
    holds: bool | None
    why: str

    @property
    def conclusion(self) -> str:
        """Whether the statement holds, as text."""
        return {True: "holds", False: "does not hold", None: "not measured"}[self.holds]


def drift(columns: Mapping[str, np.ndarray], law: str, over_reference: float) -> CollisionDeviation | None:
    """Relative change of the ratio of simulated to exact values from the reference velocity to a multiple of
    it.

        (s / s_exact at over_reference * v) / (s / s_exact at v) - 1

    None if the columns lack these collisions.
    """
    at_multiple, at_reference = (
        deviation(dict(columns), law, "fine", multiple) for multiple in (over_reference, 1.0)
    )
    if at_multiple is None or at_reference is None:
        return None
    return CollisionDeviation(
        *(
            (1.0 + getattr(at_multiple, name)) / (1.0 + getattr(at_reference, name)) - 1.0
            for name in ("duration", "overlap_max", "restitution")
        )
    )


def assess(columns: Mapping[str, np.ndarray], runs: Sequence[VariantRun]) -> list[Assessment]:
    """Assess all statements, for binary collisions and for the scene; empty without a linear contact model.

    `columns`: of collisions.csv, possibly empty; `runs`: of all variants.
    """
    compared = {run.variant.key for run in runs}.union(columns["law"].tolist() if columns else ())
    if not compared & {ONE_SPRING, PER_CONTACT}:
        return []
    return [*assess_collisions(columns), *_assess_scene(runs)]


def assess_collisions(columns: Mapping[str, np.ndarray]) -> list[Assessment]:
    """Assess accuracy and stability from the columns of collisions.csv."""
    return [_assess_one_spring(columns), _assess_per_contact(columns), _assess_stability(columns)]


def _worst(*drifts: CollisionDeviation) -> float:
    """Largest magnitude of the relative changes of contact duration and maximum overlap."""
    return max(
        abs(number) for per_contact in drifts for number in (per_contact.duration, per_contact.overlap_max)
    )


def _assess_one_spring(columns: Mapping[str, np.ndarray]) -> Assessment:
    """Assess the accuracy of the spring from one velocity a decade away from it.

    Theory: relative to those of Hertz, duration and overlap change by the factor 10^0.2 per decade of
    velocity.
    """
    part = "A spring from one velocity is wrong an order of magnitude away from it"
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
    part = "Eq. 19 per contact corrects it"
    slow = drift(columns, PER_CONTACT, 1.0 / DECADE)
    fast = drift(columns, PER_CONTACT, DECADE)
    at_reference = deviation(dict(columns), PER_CONTACT, "fine", 1.0)
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


def _assess_stability(columns: Mapping[str, np.ndarray]) -> Assessment:
    """Assess the stability of the spring from one velocity at a fixed time step.

    The measure is the effect of the time step on the restitution a decade above the reference velocity.
    """
    part = "A spring from one velocity becomes unstable an order of magnitude away from it"
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
    coarse, fine = (deviation(dict(columns), law, step, DECADE) for step in ("coarse", "fine"))
    if coarse is None or fine is None or fine.restitution <= -1.0:
        return None
    return (1.0 + coarse.restitution) / (1.0 + fine.restitution) - 1.0


def _assess_scene(runs: Sequence[VariantRun]) -> list[Assessment]:
    """Assess both springs in the scene: aborts, and the overlaps of the bed relative to those of Hertz.

    A deviation above TOLERANCE counts as wrong.
    """
    one_spring_part = "In this scene one spring fails"
    per_contact_part = "In this scene Eq. 19 per contact corrects it"
    one_spring, per_contact = (
        next((run for run in runs if run.variant.key == key), None) for key in (ONE_SPRING, PER_CONTACT)
    )
    if one_spring is None or per_contact is None:
        why = "The comparison does not include linear, or linear cannot run the scene."
        return [Assessment(one_spring_part, None, why), Assessment(per_contact_part, None, why)]
    found = []
    for part, run in ((one_spring_part, one_spring), (per_contact_part, per_contact)):
        off, text = _bed_overlap(run, runs)
        is_wrong = bool(run.stopped) or abs(off) > TOLERANCE
        measured = bool(run.stopped) or bool(np.isfinite(off))
        found.append(
            Assessment(part, (is_wrong if run is one_spring else not is_wrong) if measured else None, text)
        )
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
        off = at_end(stage, "overlap_mean")(run) / at_end(stage, "overlap_mean")(reference) - 1.0
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
    flow = "".join(
        f" Mass flow through {meter}: {_percent(run.mass_flow(meter) / reference.mass_flow(meter) - 1.0)}."
        for meter in run.meters
        if reference.mass_flow(meter) != 0.0
    )
    return off, (
        f"The run is complete. Mean overlap at the end of the stage {stage} relative to "
        f"{reference.variant.key}: {_percent(off)}; static loads act on springs chosen for impacts.{flow}"
    )


def _percent(share: float, signed: bool = True) -> str:
    """A fraction in percent with one digit and a typographic minus sign."""
    text = f"{100.0 * share:+.1f} %" if signed else f"{100.0 * share:.1f} %"
    return text.replace("-", "−")


# Sentence on a spring from one velocity that is softer than the contacts of the scene require.

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
