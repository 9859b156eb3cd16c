"""All cases: families of stiff and extreme ones, each a grid of rows and columns."""

from collections.abc import Iterator
from functools import cache, partial
from typing import Any

import numpy as np

from granflow.device.backend import Precision
from granflow.scene.schema import LARGEST_OVERLAP
from granflow.study.stability import piles
from granflow.study.stability.bounds import LAWS as BOUND_LAWS
from granflow.study.stability.bounds import RESOLUTION, real_bounds
from granflow.study.stability.cases import Case, Finding
from granflow.study.stability.lattices import LATTICES
from granflow.study.stability.pairs import Pair, rebound_finding
from granflow.study.stability.piles import DIAMETER, RADIUS, SIDE, bed, box, ledger_of, listed, resting

RESTITUTIONS = (0.0, 0.001, 0.01, 0.1, 0.3, 0.5, 0.7, 0.9, 1.0)
SHARES = (0.01, 0.03, 0.1, 0.3, 0.99, 2.0, 5.0)
MODULI = tuple(10.0**n for n in range(5, 13))
VELOCITIES = (1e-6, 1e-3, 0.1, 10.0, 100.0, 400.0)
STEEL = (3.0432, 0.540, 340.3)
"""sigma, psi and limit velocity [m/s] of stainless steel 316 (Zhou 2011)."""
RADII: tuple[float, ...] = tuple(10.0**n for n in range(-6, 1))
PRECISIONS: tuple[Precision, ...] = ("f64", "mixed", "f32")
RATIOS: tuple[float, ...] = (1.0, 3.0, 10.0, 30.0, 100.0)
DENSITY_RATIOS = (1.0, 1e3, 1e6)

SPREAD = 0.1
"""Grains that fall begin as far apart, over their diameter."""

STEPS = "time step against restitution"
STIFFNESS = "stiffness against velocity"
SIZES = "size against precision"
UNEQUAL = "unequal partners"
MANY = "many grains"
BOUNDS = "real bound of the step"

STICKING = ", friction"
CAREFUL = "the check takes grains to touch up to 12 others, where these touch fewer"


def all_cases(full: bool = False) -> list[Case]:
    """Every case; `full` with all moduli and ratios instead of every other one."""
    stride = 1 if full else 2
    moduli = MODULI if full else (1e5, 1e7, 1e9, 1e12)
    return [
        *_bound_cases(), *_many_cases(), *_step_cases(), *_stiffness_cases(moduli),
        *_size_cases(RADII[::stride]), *_unequal_cases(RATIOS[::stride]),
    ]  # fmt: skip


def _step_cases() -> Iterator[Case]:
    pairs = tuple(Pair(restitution=e) for e in RESTITUTIONS)
    for share in SHARES:
        for index, e in enumerate(RESTITUTIONS):
            work = partial(rebound_finding, pairs, index, "f64", share)
            yield Case(STEPS, f"e = {e:g}", f"{share:g}", "the restitution asked for", work)


def _stiffness_cases(moduli: tuple[float, ...]) -> Iterator[Case]:
    for modulus in moduli:
        for velocity in VELOCITIES:
            pair = Pair(young_modulus=modulus, restitution=STEEL, velocity=velocity)
            work = partial(rebound_finding, (pair,), 0)
            yield Case(STIFFNESS, f"{modulus:.0e} Pa", f"{velocity:g} m/s", "e(v) of Eq. 12", work)


def _size_cases(radii: tuple[float, ...]) -> Iterator[Case]:
    for precision in PRECISIONS:
        for radius in radii:
            work = partial(rebound_finding, (Pair(radius=radius),), 0, precision)
            yield Case(SIZES, precision, f"R = {radius:g} m", "the restitution asked for", work, precision)


def _unequal_cases(ratios: tuple[float, ...]) -> Iterator[Case]:
    for density in DENSITY_RATIOS:
        for ratio in ratios:
            work = partial(rebound_finding, (Pair(radius_ratio=ratio, density_ratio=density),), 0)
            against = "the restitution asked for, and momentum"
            yield Case(UNEQUAL, f"density 1 : {density:g}", f"radius 1 : {ratio:g}", against, work)


def _many_cases() -> Iterator[Case]:
    for law in piles.LAWS:
        yield Case(MANY, law, "heavy on light", "weight on the floor", partial(resting, law, (2.5e3, 2.5e9), 1e11))
        yield Case(MANY, law, "column of 100", "weight on the floor", partial(resting, law, (2.5e3,) * 100, 5e7))
        for column, (particles, duration, changes) in _beds().items():
            work = partial(ledger_of, law, particles, duration, changes)
            yield Case(MANY, law, column, "the energy ledger", work)


def _beds() -> dict[str, tuple[dict[str, Any], float, dict[str, Any]]]:
    """Grains, duration [s] and what is changed, for each case judged by the energy ledger."""
    resting_bed = {"grains": listed(bed())}
    falling = {"grains": listed(bed(spread=SPREAD))}
    half = {"grains": listed([[-0.75 * RADIUS, 0, 1e-2], [0.75 * RADIUS, 0, 1e-2]])}
    bullet = [0.3 * RADIUS, 0.2 * RADIUS, SIDE + 2.0 * DIAMETER]
    shot = {**resting_bed, "bullet": listed([bullet], [0.0, 0.0, -1000.0])}
    opposed = {
        "left": listed(bed(0.0) + [-0.6 * SIDE, 0, 0], [1.0, 0, 0]),
        "right": listed(bed(0.3 * RADIUS) + [0.6 * SIDE, 0, 0], [-1.0, 0, 0]),
    }
    speed, depth = 0.05, 5 * 0.05 * RADIUS
    piston = {"kind": "translation", "velocity": [0, 0, -speed], "end": depth / speed}
    lid = {"shape": "plane", "point": [0, 0, SIDE], "normal": [0, 0, -1], "material": "grain", "motion": [piston]}
    shake = {"kind": "vibration", "direction": [0, 0, 1], "frequency": 50.0, "gamma": 100.0}
    open_guard = {"numerics": {"overlap_limit": LARGEST_OVERLAP}}
    wide = box(spread=SPREAD)
    weightless = {"gravity": 0.0, "walls": {}}
    return {
        "squeezed": (resting_bed, 1.5 * depth / speed, {"walls": {**box(), "lid": lid}}),
        "made 50 % overlapping": (half, 1e-3, weightless),
        "the same, guard off": (half, 1e-3, {**weightless, **open_guard}),
        "1 km/s, soft": (shot, 1e-4, {"walls": box()}),
        "1 km/s, 70 GPa, guard off": (shot, 3e-5, {"walls": box(), "young_modulus": 7e10, **open_guard}),
        "friction 0": (falling, 0.02, {"walls": wide, "friction": 0.0}),
        "friction 10": (falling, 0.02, {"walls": wide, "friction": 10.0}),
        "no gravity": (opposed, 0.01, weightless),
        "shaken, Γ = 100": (falling, 0.04, {"walls": box([shake], SPREAD), "young_modulus": 1e9, "reach": 1.0}),
    }


def _bound_cases() -> Iterator[Case]:
    for law in BOUND_LAWS:
        for friction in (False, True):
            for lattice in LATTICES:
                column = lattice + STICKING * friction
                against = "the step that check allows: 1 to 2 times it"
                yield Case(BOUNDS, law, column, against, partial(bound_finding, law, friction, lattice))


def bound_finding(law: str, friction: bool, lattice: str) -> Finding:
    """The real bound over the check's, to be 1 to 2; below 1 the check promises too much, and no error is small."""
    bound = _bounds(law, friction)[lattice]
    ratio, inside = bound.ratio, float(np.clip(bound.ratio, 1.0, 2.0))
    too_bold, too_careful = ratio * RESOLUTION < 1.0, ratio > 2.0 * RESOLUTION
    error = 1.0 if too_bold else ratio / 2.0 - 1.0 if too_careful else 0.0
    said = (CAREFUL,) if too_careful else ()
    return Finding("real bound over the check's", inside, ratio, error, bound.allowed, said)


@cache
def _bounds(law: str, friction: bool) -> dict[str, Any]:
    return {bound.lattice: bound for bound in real_bounds(law, friction)}
