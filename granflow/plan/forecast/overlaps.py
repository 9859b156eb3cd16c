"""Forecasts of the largest overlaps: in impacts, and at rest under the weight, walls and cohesion."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Literal

from granflow.contact.laws import ContactLaws
from granflow.contact.material import Solid
from granflow.load import Scene
from granflow.plan.forecast.advice import Overlap, modulus_factor, modulus_text, required_moduli, without_modulus
from granflow.plan.forecast.contact import TouchingPair, impact_overlap, static_overlap
from granflow.plan.forecast.pressures import BedPressure
from granflow.scene.schema.materials import Material
from granflow.scene.schema.run import LARGEST_OVERLAP

Cause = Literal["impact", "weight", "wall", "cohesion"]
"""Causes of overlaps: an impact, the weight of the bed, a wall that presses on the bed, an attraction."""

ENOUGH = 1.05
"""Recommended over forecast overlap limit."""


@dataclass(frozen=True)
class Forecast:
    """One forecast for `granflow explain`: name, value and remark; `warning`: sentence for check and run, or None.

    cause, overlap:  of a forecast overlap: its cause, and the overlap over the smaller radius; None and 0 for others
    force:           largest contact force [N] of a static pressure, for the pair with the largest overlap
    """

    name: str
    value: str
    remark: str
    warning: str | None = None
    cause: Cause | None = None
    overlap: float = 0.0
    force: float = 0.0


@dataclass(frozen=True)
class _Largest:
    """The pair with the largest overlap of one cause, and the instruction that all pairs of this cause require."""

    pair: TouchingPair
    overlap: float
    instruction: str


def impact_forecast(
    scene: Scene, laws: ContactLaws, pairs: Iterable[TouchingPair], velocity: float, source: str
) -> Forecast | None:
    """The largest overlap of an impact at the maximum velocity [m/s]; `source`: origin of the velocity."""
    limit = scene.numerics.max_overlap
    largest = _largest(scene, pairs, lambda pair: impact_overlap(laws, pair, velocity, limit))
    if largest is None:
        return None
    remark = f"{largest.pair.name} at {velocity:.3g} m/s, {source}"
    warning = None
    if largest.overlap > limit:
        warning = (
            f"{largest.pair.name}: an impact at {velocity:.3g} m/s, {source}, overlaps by {_share(largest.overlap)}, "
            f"{_above(scene)} {_remedy(largest)}, or set run.velocity_max lower if all impacts are slower."
        )
    return Forecast("overlap of impacts", _share(largest.overlap), remark, warning, "impact", largest.overlap)


def static_forecasts(
    scene: Scene, laws: ContactLaws, pairs: Iterable[TouchingPair], pressures: Iterable[BedPressure]
) -> Iterator[Forecast]:
    """The largest overlap at rest without load (only with cohesion), and under each load.

    A warning of a load is omitted if cohesion alone exceeds the limit.
    """
    touching = list(pairs)
    cohesive = None if laws.cohesion is None else cohesion_forecast(scene, laws, touching)
    if cohesive is not None:
        yield cohesive
    for load in pressures:
        largest = _largest(scene, touching, partial(loaded_overlap, laws, load))
        if largest is None:
            continue
        warning = None
        if largest.overlap > scene.numerics.max_overlap and (cohesive is None or cohesive.warning is None):
            warning = (
                f"{largest.pair.name}: under {load.cause} contacts overlap by up to {_share(largest.overlap)}, "
                f"{_above(scene)} {_remedy(largest)}."
            )
        name = "overlap under the weight" if load.kind == "weight" else "overlap under a wall"
        remark = f"{largest.pair.name} under {load.cause}"
        force = load.largest_force(2.0 * largest.pair.radius)
        yield Forecast(name, f"up to {_share(largest.overlap)}", remark, warning, load.kind, largest.overlap, force)


def cohesion_forecast(scene: Scene, laws: ContactLaws, pairs: Iterable[TouchingPair]) -> Forecast | None:
    """The overlap at which repulsion and attraction balance: particles that touch are drawn together up to it."""
    largest = _largest(scene, pairs, lambda pair: static_overlap(laws, pair, 0.0))
    if largest is None:
        return None
    warning = None
    if largest.overlap > scene.numerics.max_overlap:
        assert laws.cohesion is not None
        keys = " or ".join(laws.cohesion.constant_names)
        warning = (
            f"{largest.pair.name}: the cohesion alone draws particles together by {_share(largest.overlap)}, "
            f"{_above(scene)} Lower {keys}, or {_remedy(largest, capital=False)}."
        )
    remark = f"{largest.pair.name}, without load"
    return Forecast("overlap by cohesion", _share(largest.overlap), remark, warning, "cohesion", largest.overlap)


def loaded_overlap(laws: ContactLaws, load: BedPressure, pair: TouchingPair) -> float:
    """Largest relative overlap of a pair under a load; the pressure acts on its smaller particle."""
    return static_overlap(laws, pair, load.largest_force(2.0 * pair.radius))


def _largest(scene: Scene, pairs: Iterable[TouchingPair], overlap: Overlap) -> _Largest | None:
    """The pair with the largest overlap, and the instruction that reduces all to the limit; None without pairs."""
    found = [(overlap(pair), pair) for pair in pairs]
    found = [each for each in found if each[0] == each[0]]  # NaN: a model without reference implementation
    if not found:
        return None
    limit, worst = scene.numerics.max_overlap, max(found, key=lambda each: each[0])
    moduli: dict[str, float] = {}
    for size, pair in found:
        if size > limit:
            factor = modulus_factor(pair, overlap, limit)
            if factor is None:
                return _Largest(worst[1], worst[0], without_modulus(pair, overlap))
            for name, value in required_moduli(_solids(scene.materials), pair.materials, factor).items():
                moduli[name] = max(moduli.get(name, 0.0), value)
    return _Largest(worst[1], worst[0], modulus_text(moduli))


def _solids(materials: Mapping[str, Material]) -> dict[str, Solid]:
    return {name: Solid(each.young_modulus, each.poisson_ratio, each.density) for name, each in materials.items()}


def _above(scene: Scene) -> str:
    """End of a sentence on an overlap above the limit."""
    limit, place = scene.numerics.max_overlap, scene.where("numerics", "max_overlap")
    origin = f" ({place})" if scene.is_given("numerics", "max_overlap") else ""
    return f"and the run stops above numerics.max_overlap {limit:g}{origin}."


def _remedy(largest: _Largest, capital: bool = True) -> str:
    """The remedies: moduli, or a higher limit if it is allowed."""
    needed = float(f"{ENOUGH * largest.overlap + 0.005:.2f}")
    accept = f", or set numerics.max_overlap to {needed:g} if such overlaps are intended"
    text = largest.instruction + (accept if needed <= LARGEST_OVERLAP else "")
    return text[0].upper() + text[1:] if capital else text


def _share(overlap: float) -> str:
    return f"{overlap:.3g} of the radius" if overlap < 1.0 else "more than the radius"
