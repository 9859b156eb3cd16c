"""The claim about springs, judged from numbers: one spring fails a decade away from its velocity, Eq. 19 mends it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from granflow.study.compare.collisions import COARSE_STEPS, Deviation, deviation
from granflow.study.compare.runs import Run
from granflow.study.compare.summary import at_end, densest_stage
from granflow.study.compare.watch import LEAST_CONTACTS

WRONG = 0.1
"""A relative change across a decade of velocity that counts as wrong."""
ONE_SPRING, PER_CONTACT = "linear_reference", "linear_onset"
DECADE = 10.0


@dataclass(frozen=True)
class Judgement:
    """A part of the claim: whether it holds (None: not measured), and the numbers that say so."""

    part: str
    holds: bool | None
    why: str

    @property
    def verdict(self) -> str:
        """In a word or two."""
        return {True: "holds", False: "does not hold", None: "not measured"}[self.holds]


def drift(columns: Mapping[str, np.ndarray], law: str, over_reference: float) -> Deviation | None:
    """How much the ratio of reached to exact changes from the reference velocity to a multiple of it."""
    there, here = (deviation(dict(columns), law, "fine", multiple) for multiple in (over_reference, 1.0))
    if there is None or here is None:
        return None
    return Deviation(*(
        (1.0 + getattr(there, name)) / (1.0 + getattr(here, name)) - 1.0
        for name in ("duration", "overlap_max", "restitution")
    ))  # fmt: skip


def judge(columns: Mapping[str, np.ndarray], runs: Sequence[Run]) -> list[Judgement]:
    """The claim in parts: for binary collisions, and for the scene; nothing where no linear spring was compared."""
    compared = {run.variant.key for run in runs}.union(columns["law"].tolist() if columns else ())
    if not compared & {ONE_SPRING, PER_CONTACT}:
        return []
    return [*judge_collisions(columns), *_in_the_scene(runs)]


def judge_collisions(columns: Mapping[str, np.ndarray]) -> list[Judgement]:
    """Wrong away from its velocity, mended by Eq. 19, unstable: from the columns of collisions.csv."""
    return [_wrong(columns), _mended(columns), _unstable(columns)]


def _worst(*drifts: Deviation) -> float:
    """Largest change of contact time or largest overlap, either way."""
    return max(abs(number) for each in drifts for number in (each.duration, each.overlap_max))


def _wrong(columns: Mapping[str, np.ndarray]) -> Judgement:
    part = "A spring from one velocity is wrong an order of magnitude away from it"
    slow, fast = drift(columns, ONE_SPRING, 1.0 / DECADE), drift(columns, ONE_SPRING, DECADE)
    if slow is None or fast is None:
        return Judgement(part, None, "linear was not among the laws.")
    worst = _worst(slow, fast)
    why = (
        f"Against Zhou and Hertz its contact time changes by {_percent(slow.duration)} and its largest overlap by "
        f"{_percent(slow.overlap_max)} from the reference velocity to a tenth of it, by {_percent(fast.duration)} "
        f"and {_percent(fast.overlap_max)} to ten times it (10^0.2 is {_percent(DECADE**0.2 - 1.0)})."
    )
    return Judgement(part, worst > WRONG, why)


def _mended(columns: Mapping[str, np.ndarray]) -> Judgement:
    part = "Eq. 19 per contact mends it"
    slow, fast = drift(columns, PER_CONTACT, 1.0 / DECADE), drift(columns, PER_CONTACT, DECADE)
    here = deviation(dict(columns), PER_CONTACT, "fine", 1.0)
    if slow is None or fast is None or here is None:
        return Judgement(part, None, "linear was not among the laws.")
    worst = _worst(slow, fast)
    why = (
        f"Across both decades the same numbers change by {_percent(worst, signed=False)} at most. What stays at "
        f"every velocity: a contact time off by {_percent(here.duration)} and a largest overlap off by "
        f"{_percent(here.overlap_max)}, from the straight spring (pi against 2.94 in units of dmax/v) and its dashpot."
    )
    below = drift(columns, PER_CONTACT, 1.0 / DECADE**2)
    if below is not None:
        why += (
            f" Another decade down, below the velocity at which the law stops softening its springs, they change by "
            f"{_percent(below.duration)} and {_percent(below.overlap_max)}."
        )
    return Judgement(part, worst < WRONG, why)


def _unstable(columns: Mapping[str, np.ndarray]) -> Judgement:
    part = "A spring from one velocity goes unstable an order of magnitude away from it"
    laws = list(dict.fromkeys(columns["law"].tolist())) if columns else []
    lost = {law: _lost_to_the_step(columns, law) for law in laws}
    one = lost.pop(ONE_SPRING, None)
    if one is None:
        return Judgement(part, None, "linear was not among the laws.")
    others = ", ".join(f"{law} {_percent(off)}" for law, off in lost.items() if off is not None)
    why = (
        f"With {COARSE_STEPS} steps to a contact at the reference velocity and that step kept, it rebounds from ten "
        f"times the velocity with a restitution {_percent(one)} off that with a fine step: its contact time, and with "
        f"it the stable step, are the same at every velocity. Contacts of other laws stiffen: {others or 'none'}."
    )
    return Judgement(part, one > WRONG, why)


def _lost_to_the_step(columns: Mapping[str, np.ndarray], law: str) -> float | None:
    """Restitution with the reference step over that with a fine one, less 1, a decade above the reference velocity."""
    coarse, fine = (deviation(dict(columns), law, step, DECADE) for step in ("coarse", "fine"))
    if coarse is None or fine is None or fine.restitution <= -1.0:
        return None
    return (1.0 + coarse.restitution) / (1.0 + fine.restitution) - 1.0


def _in_the_scene(runs: Sequence[Run]) -> list[Judgement]:
    """Both springs in the scene: stopped or not, and the overlaps of the bed over those of Hertz."""
    fails, mends = "In this scene one spring fails", "In this scene Eq. 19 per contact mends it"
    one, each = (next((run for run in runs if run.variant.key == key), None) for key in (ONE_SPRING, PER_CONTACT))
    if one is None or each is None:
        why = "linear was not among the laws, or could not run."
        return [Judgement(fails, None, why), Judgement(mends, None, why)]
    found = []
    for part, run in ((fails, one), (mends, each)):
        off, words = _bed_overlap(run, runs)
        wrong = bool(run.stopped) or abs(off) > WRONG
        measured = bool(run.stopped) or bool(np.isfinite(off))
        found.append(Judgement(part, (wrong if run is one else not wrong) if measured else None, words))
    return found


def _bed_overlap(run: Run, runs: Sequence[Run]) -> tuple[float, str]:
    """Mean overlap of the densest bed over that of Hertz, or of the first law without it, less 1; and in words."""
    stage = densest_stage(runs)
    finished = [other for other in runs if not other.stopped] or list(runs)
    exact = next((other for other in finished if other.variant.key == "hertz"), finished[0])
    off, count = float("nan"), at_end(stage, "contact_count")(exact)
    if count >= LEAST_CONTACTS:
        off = at_end(stage, "overlap_mean")(run) / at_end(stage, "overlap_mean")(exact) - 1.0
    if run.stopped:
        return off, f"A guard stopped it at {run.time:.4g} s: {run.stopped.partition(': ')[2].partition('. ')[0]}."
    if not np.isfinite(off):
        return off, f"It ran to the end, but too few grains touch at the end of the stage {stage} to speak of a bed."
    flow = "".join(
        f" Mass flow through {meter}: {_percent(run.mass_flow(meter) / exact.mass_flow(meter) - 1.0)}."
        for meter in run.meters
        if exact.mass_flow(meter) != 0.0
    )
    return off, (
        f"It ran to the end. Mean overlap at the end of the stage {stage} against {exact.variant.key}: "
        f"{_percent(off)}; grains at rest lean on springs that were chosen for impacts.{flow}"
    )


def _percent(share: float, signed: bool = True) -> str:
    text = f"{100.0 * share:+.1f} %" if signed else f"{100.0 * share:.1f} %"
    return text.replace("-", "−")
