"""All cases: families of stiff and extreme cases, each a grid of rows and columns."""

from collections.abc import Iterator
from functools import cache, partial
from typing import Any

import numpy as np

from granflow.scene.schema.run import LARGEST_OVERLAP
from granflow.studies.stability import bed_cases
from granflow.studies.stability.bed_cases import (
    DIAMETER,
    RADIUS,
    SIDE,
    bed_positions,
    box_walls,
    column_at_rest,
    energy_budget_result_of,
    particles_at,
)
from granflow.studies.stability.cases import CaseResult, StabilityCase
from granflow.studies.stability.lattices import LATTICES
from granflow.studies.stability.pair_cases import ParticlePair, rebound_result
from granflow.studies.stability.time_step_bounds import LAWS as BOUND_LAWS
from granflow.studies.stability.time_step_bounds import RESOLUTION, real_bounds

RESTITUTIONS = (0.0, 0.001, 0.01, 0.1, 0.3, 0.5, 0.7, 0.9, 1.0)
"""Target restitutions of the family STEPS."""

SHARES = (0.01, 0.03, 0.1, 0.3, 0.99, 2.0, 5.0)
"""Time steps over the largest permitted one; those above 1 must be refused."""

MODULI = tuple(10.0**n for n in range(5, 13))
"""Young's moduli [Pa]."""

VELOCITIES = (1e-6, 1e-3, 0.1, 10.0, 100.0, 400.0)
"""Impact velocities [m/s]."""

STEEL = (3.0432, 0.540, 340.3)
"""sigma, psi and limit velocity [m/s] of stainless steel 316 (Zhou 2011)."""
RADII: tuple[float, ...] = tuple(10.0**n for n in range(-6, 1))
"""Particle radii [m]."""

PRECISIONS = ("f64", "mixed", "f32")
RATIOS: tuple[float, ...] = (1.0, 3.0, 10.0, 30.0, 100.0)
"""Ratios of the radii of two particles."""

DENSITY_RATIOS = (1.0, 1e3, 1e6)
"""Ratios of the densities of two particles."""


SPREAD = 0.1
"""Initial gap between falling particles, over their diameter."""

STEPS = "time step against restitution"
STIFFNESS = "stiffness against velocity"
SIZES = "size against precision"
UNEQUAL = "unequal partners"
MANY = "many particles"
BOUNDS = "stability limit of the time step"
"""Names of the families."""


WITH_FRICTION = ", friction"
"""Suffix of the columns of lattices with friction."""

CONSERVATIVE_WARNING = "the check assumes up to 12 contacts per particle, more than in this lattice"
"""Known reason for a limit of the check that is too conservative."""


def all_cases(full: bool = False) -> list[StabilityCase]:
    """All cases; `full` includes all moduli, sizes and ratios instead of every other one."""
    stride = 1 if full else 2
    moduli = MODULI if full else (1e5, 1e7, 1e9, 1e12)
    return [
        *_bound_cases(), *_many_cases(), *_step_cases(), *_stiffness_cases(moduli),
        *_size_cases(RADII[::stride]), *_unequal_cases(RATIOS[::stride]),
    ]  # fmt: skip


def _step_cases() -> Iterator[StabilityCase]:
    """Restitution at time steps relative to the largest permitted one."""
    pairs = tuple(ParticlePair(restitution=e) for e in RESTITUTIONS)
    for share in SHARES:
        for index, e in enumerate(RESTITUTIONS):
            run = partial(rebound_result, pairs, index, "f64", share)
            yield StabilityCase(STEPS, f"e = {e:g}", f"{share:g}", "the target restitution", run)


def _stiffness_cases(moduli: tuple[float, ...]) -> Iterator[StabilityCase]:
    """Young's modulus and impact velocity at the automatic time step."""
    for modulus in moduli:
        for velocity in VELOCITIES:
            pair = ParticlePair(young_modulus=modulus, restitution=STEEL, velocity=velocity)
            run = partial(rebound_result, (pair,), 0)
            yield StabilityCase(STIFFNESS, f"{modulus:.0e} Pa", f"{velocity:g} m/s", "e(v) of Eq. 12", run)


def _size_cases(radii: tuple[float, ...]) -> Iterator[StabilityCase]:
    """Particle radius and precision."""
    for precision in PRECISIONS:
        for radius in radii:
            run = partial(rebound_result, (ParticlePair(radius=radius),), 0, precision)
            yield StabilityCase(SIZES, precision, f"R = {radius:g} m", "the target restitution", run, precision)


def _unequal_cases(ratios: tuple[float, ...]) -> Iterator[StabilityCase]:
    """Ratios of radius and density of the two particles."""
    for density in DENSITY_RATIOS:
        for ratio in ratios:
            run = partial(rebound_result, (ParticlePair(radius_ratio=ratio, density_ratio=density),), 0)
            reference = "the target restitution and conservation of momentum"
            yield StabilityCase(UNEQUAL, f"density 1 : {density:g}", f"radius 1 : {ratio:g}", reference, run)


def _many_cases() -> Iterator[StabilityCase]:
    """Columns and beds of many particles."""
    for law in bed_cases.LAWS:
        yield StabilityCase(
            MANY, law, "heavy on light", "the weight on the floor", partial(column_at_rest, law, (2.5e3, 2.5e9), 1e11)
        )
        yield StabilityCase(
            MANY, law, "column of 100", "the weight on the floor", partial(column_at_rest, law, (2.5e3,) * 100, 5e7)
        )
        for column, (particles, duration, changes) in _beds().items():
            run = partial(energy_budget_result_of, law, particles, duration, changes)
            yield StabilityCase(MANY, law, column, "the energy budget", run)


def _beds() -> dict[str, tuple[dict[str, Any], float, dict[str, Any]]]:
    """Particles, duration [s] and changed settings for each case assessed by the energy budget."""
    resting_bed = {"bed": particles_at(bed_positions())}
    falling = {"bed": particles_at(bed_positions(spread=SPREAD))}
    half = {"bed": particles_at([[-0.75 * RADIUS, 0, 1e-2], [0.75 * RADIUS, 0, 1e-2]])}
    bullet = [0.3 * RADIUS, 0.2 * RADIUS, SIDE + 2.0 * DIAMETER]
    shot = {**resting_bed, "projectile": particles_at([bullet], [0.0, 0.0, -1000.0])}
    opposed = {
        "left": particles_at(bed_positions(0.0) + [-0.6 * SIDE, 0, 0], [1.0, 0, 0]),
        "right": particles_at(bed_positions(0.3 * RADIUS) + [0.6 * SIDE, 0, 0], [-1.0, 0, 0]),
    }
    speed, depth = 0.05, 5 * 0.05 * RADIUS
    piston = {"kind": "translation", "velocity": [0, 0, -speed], "end": depth / speed}
    lid = {"shape": "plane", "point": [0, 0, SIDE], "normal": [0, 0, -1], "material": "light", "motion": [piston]}
    vibration = {"kind": "vibration", "direction": [0, 0, 1], "frequency": 50.0, "gamma": 100.0}
    no_limit = {"numerics": {"max_overlap": LARGEST_OVERLAP}}
    wide = box_walls(spread=SPREAD)
    weightless = {"gravity": 0.0, "walls": {}}
    return {
        "squeezed": (resting_bed, 1.5 * depth / speed, {"walls": {**box_walls(), "lid": lid}}),
        "initial overlap 50 %": (half, 1e-3, weightless),
        "overlap 50 %, limit off": (half, 1e-3, {**weightless, **no_limit}),
        "1 km/s, soft": (shot, 1e-4, {"walls": box_walls()}),
        "1 km/s, 70 GPa, limit off": (shot, 3e-5, {"walls": box_walls(), "young_modulus": 7e10, **no_limit}),
        "friction 0": (falling, 0.02, {"walls": wide, "friction": 0.0}),
        "friction 10": (falling, 0.02, {"walls": wide, "friction": 10.0}),
        "no gravity": (opposed, 0.01, weightless),
        "shaken, Γ = 100": (
            falling,
            0.04,
            {"walls": box_walls([vibration], SPREAD), "young_modulus": 1e9, "reach": 1.0},
        ),
    }


def _bound_cases() -> Iterator[StabilityCase]:
    """Measured stability limits of all contact models and lattices."""
    for law in BOUND_LAWS:
        for friction in (False, True):
            for lattice in LATTICES:
                column = lattice + WITH_FRICTION * friction
                reference = "1 to 2 times the limit of the check"
                yield StabilityCase(BOUNDS, law, column, reference, partial(bound_result, law, friction, lattice))


def bound_result(law: str, friction: bool, lattice: str) -> CaseResult:
    """Measured stability limit over that of the check, required to be 1 to 2.

    Below 1 the check accepts unstable time steps, which counts as an error of 100 %. `law`: key of
    `time_step_bounds.LAWS`; `lattice`: key of LATTICES.
    """
    bound = _bounds_by_lattice(law, friction)[lattice]
    ratio, inside = bound.ratio, float(np.clip(bound.ratio, 1.0, 2.0))
    too_large, too_small = ratio * RESOLUTION < 1.0, ratio > 2.0 * RESOLUTION
    error = 1.0 if too_large else ratio / 2.0 - 1.0 if too_small else 0.0
    warnings = (CONSERVATIVE_WARNING,) if too_small else ()
    return CaseResult("measured limit over that of the check", inside, ratio, error, bound.allowed, warnings)


@cache
def _bounds_by_lattice(law: str, friction: bool) -> dict[str, Any]:
    """Measured stability limits of one contact model; cached, since they share one engine."""
    return {bound.lattice: bound for bound in real_bounds(law, friction)}
