"""The claim about springs, judged from numbers: one spring fails a decade away from its velocity, Eq. 19 mends it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from granflow.study.compare.bed_statistics import LEAST_CONTACTS
from granflow.study.compare.collisions import COARSE_STEPS, CollisionDeviation, deviation
from granflow.study.compare.runs import VariantRun
from granflow.study.compare.summary import at_end, densest_stage

WRONG = 0.1
"""A relative change across a decade of velocity that counts as wrong."""
ONE_SPRING, PER_CONTACT = "linear_reference", "linear_onset"
DECADE = 10.0


@dataclass(frozen=True)
class Assessment:
    """A part of the claim: whether it holds (None: not measured), and the numbers that say so."""

    part: str
    holds: bool | None
    why: str

    @property
    def verdict(self) -> str:
        """In a word or two."""
        return {True: "holds", False: "does not hold", None: "not measured"}[self.holds]


def drift(columns: Mapping[str, np.ndarray], law: str, over_reference: float) -> CollisionDeviation | None:
    """How much the ratio of reached to exact changes from the reference velocity to a multiple of it."""
    at_multiple, at_reference = (deviation(dict(columns), law, "fine", multiple) for multiple in (over_reference, 1.0))
    if at_multiple is None or at_reference is None:
        return None
    return CollisionDeviation(*(
        (1.0 + getattr(at_multiple, name)) / (1.0 + getattr(at_reference, name)) - 1.0
        for name in ("duration", "overlap_max", "restitution")
    ))  # fmt: skip


def assess(columns: Mapping[str, np.ndarray], runs: Sequence[VariantRun]) -> list[Assessment]:
    """The claim in parts: for binary collisions, and for the scene; nothing where no linear spring was compared."""
    compared = {run.variant.key for run in runs}.union(columns["law"].tolist() if columns else ())
    if not compared & {ONE_SPRING, PER_CONTACT}:
        return []
    return [*assess_collisions(columns), *_assess_scene(runs)]


def assess_collisions(columns: Mapping[str, np.ndarray]) -> list[Assessment]:
    """Wrong away from its velocity, mended by Eq. 19, unstable: from the columns of collisions.csv."""
    return [_assess_one_spring(columns), _assess_per_contact(columns), _assess_stability(columns)]


def _worst(*drifts: CollisionDeviation) -> float:
    """Largest change of contact time or largest overlap, either way."""
    return max(abs(number) for per_contact in drifts for number in (per_contact.duration, per_contact.overlap_max))


def _assess_one_spring(columns: Mapping[str, np.ndarray]) -> Assessment:
    part = "A spring from one velocity is wrong an order of magnitude away from it"
    slow, typical_speed = drift(columns, ONE_SPRING, 1.0 / DECADE), drift(columns, ONE_SPRING, DECADE)
    if slow is None or typical_speed is None:
        return Assessment(part, None, "linear was not among the laws.")
    worst = _worst(slow, typical_speed)
    why = (
        f"Against Zhou and Hertz its contact time changes by {_percent(slow.duration)} and its largest overlap by "
        f"{_percent(slow.overlap_max)} from the reference velocity to a tenth of it, by "
        f"{_percent(typical_speed.duration)} "
        f"and {_percent(typical_speed.overlap_max)} to ten times it (10^0.2 is {_percent(DECADE**0.2 - 1.0)})."
    )
    return Assessment(part, worst > WRONG, why)


def _assess_per_contact(columns: Mapping[str, np.ndarray]) -> Assessment:
    part = "Eq. 19 per contact mends it"
    slow, typical_speed = drift(columns, PER_CONTACT, 1.0 / DECADE), drift(columns, PER_CONTACT, DECADE)
    at_reference = deviation(dict(columns), PER_CONTACT, "fine", 1.0)
    if slow is None or typical_speed is None or at_reference is None:
        return Assessment(part, None, "linear was not among the laws.")
    worst = _worst(slow, typical_speed)
    why = (
        f"Across both decades the same numbers change by {_percent(worst, signed=False)} at most. What stays at "
        f"every velocity: a contact time off by {_percent(at_reference.duration)} and a largest overlap off by "
        f"{_percent(at_reference.overlap_max)}, from the straight spring (pi against 2.94 in units of dmax/v) and "
        f"its dashpot."
    )
    below = drift(columns, PER_CONTACT, 1.0 / DECADE**2)
    if below is not None:
        why += (
            f" Another decade down, below the velocity at which the law stops softening its springs, they change by "
            f"{_percent(below.duration)} and {_percent(below.overlap_max)}."
        )
    return Assessment(part, worst < WRONG, why)


def _assess_stability(columns: Mapping[str, np.ndarray]) -> Assessment:
    part = "A spring from one velocity goes unstable an order of magnitude away from it"
    laws = list(dict.fromkeys(columns["law"].tolist())) if columns else []
    lost_by_law = {law: _lost_to_time_step(columns, law) for law in laws}
    one_spring = lost_by_law.pop(ONE_SPRING, None)
    if one_spring is None:
        return Assessment(part, None, "linear was not among the laws.")
    others = ", ".join(f"{law} {_percent(off)}" for law, off in lost_by_law.items() if off is not None)
    why = (
        f"With {COARSE_STEPS} steps to a contact at the reference velocity and that step kept, it rebounds from ten "
        f"times the velocity with a restitution {_percent(one_spring)} off that with a fine step: its contact "
        f"time, and with "
        f"it the stable step, are the same at every velocity. Contacts of other laws stiffen: {others or 'none'}."
    )
    return Assessment(part, one_spring > WRONG, why)


def _lost_to_time_step(columns: Mapping[str, np.ndarray], law: str) -> float | None:
    """Restitution with the reference step over that with a fine one, less 1, a decade above the reference velocity."""
    coarse, fine = (deviation(dict(columns), law, step, DECADE) for step in ("coarse", "fine"))
    if coarse is None or fine is None or fine.restitution <= -1.0:
        return None
    return (1.0 + coarse.restitution) / (1.0 + fine.restitution) - 1.0


def _assess_scene(runs: Sequence[VariantRun]) -> list[Assessment]:
    """Both springs in the scene: stopped or not, and the overlaps of the bed over those of Hertz."""
    one_spring_part, per_contact_part = "In this scene one spring fails", "In this scene Eq. 19 per contact mends it"
    one_spring, per_contact = (
        next((run for run in runs if run.variant.key == key), None) for key in (ONE_SPRING, PER_CONTACT)
    )
    if one_spring is None or per_contact is None:
        why = "linear was not among the laws, or could not run."
        return [Assessment(one_spring_part, None, why), Assessment(per_contact_part, None, why)]
    found = []
    for part, run in ((one_spring_part, one_spring), (per_contact_part, per_contact)):
        off, text = _bed_overlap(run, runs)
        is_wrong = bool(run.stopped) or abs(off) > WRONG
        measured = bool(run.stopped) or bool(np.isfinite(off))
        found.append(Assessment(part, (is_wrong if run is one_spring else not is_wrong) if measured else None, text))
    return found


def _bed_overlap(run: VariantRun, runs: Sequence[VariantRun]) -> tuple[float, str]:
    """Mean overlap of the densest bed over that of Hertz, or of the first law without it, less 1; and in words."""
    stage = densest_stage(runs)
    finished = [other for other in runs if not other.stopped] or list(runs)
    reference = next((other for other in finished if other.variant.key == "hertz"), finished[0])
    off, count = float("nan"), at_end(stage, "contact_count")(reference)
    if count >= LEAST_CONTACTS:
        off = at_end(stage, "overlap_mean")(run) / at_end(stage, "overlap_mean")(reference) - 1.0
    if run.stopped:
        return off, f"A guard stopped it at {run.time:.4g} s: {run.stopped.partition(': ')[2].partition('. ')[0]}."
    if not np.isfinite(off):
        return off, f"It ran to the end, but too few grains touch at the end of the stage {stage} to speak of a bed."
    flow = "".join(
        f" Mass flow through {meter}: {_percent(run.mass_flow(meter) / reference.mass_flow(meter) - 1.0)}."
        for meter in run.meters
        if reference.mass_flow(meter) != 0.0
    )
    return off, (
        f"It ran to the end. Mean overlap at the end of the stage {stage} against {reference.variant.key}: "
        f"{_percent(off)}; grains at rest lean on springs that were chosen for impacts.{flow}"
    )


def _percent(share: float, signed: bool = True) -> str:
    text = f"{100.0 * share:+.1f} %" if signed else f"{100.0 * share:.1f} %"
    return text.replace("-", "−")
