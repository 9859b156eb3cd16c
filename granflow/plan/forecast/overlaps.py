"""Forecasts of the largest overlaps: in impacts, and at rest under the weight, walls and cohesion."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import partial

from granflow.contact.laws import ContactLaws
from granflow.plan.forecast.advice import Overlap, modulus_factor, modulus_text, required_moduli, without_modulus
from granflow.plan.forecast.contact import TouchingPair, impact_overlap, static_overlap
from granflow.plan.forecast.forecast import Forecast
from granflow.plan.forecast.pressures import BedPressure
from granflow.plan.plan import Plan
from granflow.scene.schema.run import LARGEST_OVERLAP

ENOUGH = 1.05
"""Recommended over forecast overlap limit."""


@dataclass(frozen=True)
class _Largest:
    """The pair with the largest overlap of one cause, and the instruction that all pairs of this cause require."""

    pair: TouchingPair
    overlap: float
    instruction: str


def impact_forecast(plan: Plan, pairs: Iterable[TouchingPair], velocity: float, source: str) -> Forecast | None:
    """The largest overlap of an impact at the maximum velocity [m/s]; `source`: origin of the velocity."""
    limit = plan.max_overlap
    largest = _largest(plan, pairs, lambda pair: impact_overlap(plan.laws, pair, velocity, limit))
    if largest is None:
        return None
    remark = f"{largest.pair.name} at {velocity:.3g} m/s, {source}"
    warning = None
    if largest.overlap > limit:
        warning = (
            f"{largest.pair.name}: an impact at {velocity:.3g} m/s, {source}, overlaps by {_share(largest.overlap)}, "
            f"{_above(plan)} {_remedy(largest)}, or set run.velocity_max lower if all impacts are slower."
        )
    return Forecast("overlap of impacts", _share(largest.overlap), remark, warning, "impact", largest.overlap)


def static_forecasts(plan: Plan, pairs: Iterable[TouchingPair], pressures: Iterable[BedPressure]) -> Iterator[Forecast]:
    """The largest overlap at rest without load (only with cohesion), and under each load.

    A warning of a load is omitted if cohesion alone exceeds the limit.
    """
    touching = list(pairs)
    cohesive = None if plan.laws.cohesion is None else cohesion_forecast(plan, touching)
    if cohesive is not None:
        yield cohesive
    for load in pressures:
        largest = _largest(plan, touching, partial(loaded_overlap, plan.laws, load))
        if largest is None:
            continue
        warning = None
        if largest.overlap > plan.max_overlap and (cohesive is None or cohesive.warning is None):
            warning = (
                f"{largest.pair.name}: under {load.cause} contacts overlap by {_up_to(largest.overlap)}, "
                f"{_above(plan)} {_remedy(largest)}."
            )
        name = "overlap under the weight" if load.kind == "weight" else "overlap under a wall"
        remark = f"{largest.pair.name} under {load.cause}"
        force = load.largest_force(2.0 * largest.pair.radius)
        yield Forecast(name, _up_to(largest.overlap), remark, warning, load.kind, largest.overlap, force)


def supported_forecast(plan: Plan, pairs: Iterable[tuple[TouchingPair, float]]) -> Forecast | None:
    """The largest overlap under the weight [N] of a large particle on one of the small ones that carry it."""
    supported = list(pairs)
    weights = {pair.name: weight for pair, weight in supported}  # also of pairs with another modulus
    largest = _largest(
        plan, (pair for pair, _weight in supported), lambda pair: static_overlap(plan.laws, pair, weights[pair.name])
    )
    if largest is None:
        return None
    warning = None
    if largest.overlap > plan.max_overlap:
        warning = (
            f"{largest.pair.name}: under the weight of one particle the contacts below it overlap by "
            f"{_up_to(largest.overlap)}, {_above(plan)} {_remedy(largest)}."
        )
    remark = f"{largest.pair.name}, at rest"
    force = weights[largest.pair.name]
    return Forecast(
        "overlap under a particle", _up_to(largest.overlap), remark, warning, "weight", largest.overlap, force
    )


def cohesion_forecast(plan: Plan, pairs: Iterable[TouchingPair]) -> Forecast | None:
    """The overlap at which repulsion and attraction balance: particles that touch are drawn together up to it."""
    largest = _largest(plan, pairs, lambda pair: static_overlap(plan.laws, pair, 0.0))
    if largest is None:
        return None
    warning = None
    if largest.overlap > plan.max_overlap:
        assert plan.laws.cohesion is not None
        keys = " or ".join(plan.laws.cohesion.constant_names)
        warning = (
            f"{largest.pair.name}: the cohesion alone draws particles together by {_share(largest.overlap)}, "
            f"{_above(plan)} Lower {keys}, or {_remedy(largest, capital=False)}."
        )
    remark = f"{largest.pair.name}, without load"
    return Forecast("overlap by cohesion", _share(largest.overlap), remark, warning, "cohesion", largest.overlap)


def loaded_overlap(laws: ContactLaws, load: BedPressure, pair: TouchingPair) -> float:
    """Largest relative overlap of a pair under a load; the pressure acts on its smaller particle."""
    return static_overlap(laws, pair, load.largest_force(2.0 * pair.radius))


def _largest(plan: Plan, pairs: Iterable[TouchingPair], overlap: Overlap) -> _Largest | None:
    """The pair with the largest overlap, and the instruction that reduces all to the limit; None without pairs."""
    found = [(overlap(pair), pair) for pair in pairs]
    found = [each for each in found if each[0] == each[0]]  # NaN: a model without reference implementation
    if not found:
        return None
    limit, worst = plan.max_overlap, max(found, key=lambda each: each[0])
    moduli: dict[str, float] = {}
    for size, pair in found:
        if size > limit:
            factor = modulus_factor(pair, overlap, limit)
            if factor is None:
                return _Largest(worst[1], worst[0], without_modulus(pair, overlap))
            for name, value in required_moduli(plan.solids, pair.materials, factor).items():
                moduli[name] = max(moduli.get(name, 0.0), value)
    return _Largest(worst[1], worst[0], modulus_text(moduli))


def _above(plan: Plan) -> str:
    """End of a sentence on an overlap above the limit."""
    place = plan.sources.get("numerics.max_overlap")
    return f"and the run stops above numerics.max_overlap {plan.max_overlap:g}{f' ({place})' if place else ''}."


def _remedy(largest: _Largest, capital: bool = True) -> str:
    """The remedies: moduli, or a higher limit if it is allowed."""
    needed = float(f"{ENOUGH * largest.overlap + 0.005:.2f}")
    accept = f", or set numerics.max_overlap to {needed:g} if such overlaps are intended"
    text = largest.instruction + (accept if needed <= LARGEST_OVERLAP else "")
    return text[0].upper() + text[1:] if capital else text


def _up_to(overlap: float) -> str:
    return f"up to {_share(overlap)}" if overlap < 1.0 else _share(overlap)


def _share(overlap: float) -> str:
    return f"{overlap:.3g} of the radius" if overlap < 1.0 else "more than the radius"
