"""Validation cases of the normal models besides Zhou's: head-on collisions against integrations and closed
forms."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from granflow.studies.bench import Collision, CollisionBench
from validation.case import ValidationCase
from validation.collisions import FRACTION, GLASS, STEP_ERROR, STEP_REASON, measured
from validation.theory_of_collisions import (
    Pair,
    Partner,
    Rebound,
    collide,
    hertz_dashpot,
    linear_dashpot,
    thornton_restitution,
    zhou_spring,
)

RADIUS, SPEED = 0.005, 0.5
"""Radius [m] and approach velocity [m/s] of most collisions."""
SPEEDS = (0.2, 0.5, 1.0)
"""Approach velocities [m/s] of models whose restitution depends on velocity."""
STRENGTH, YIELD_RATIO = 50e6, 1.6
"""Yield strength [Pa] and ratio of the limiting pressure to it, of Thornton's model."""
DEPTH, GIVEN = 0.01, 2e6
"""Plasticity depth, and stiffness [N/m] of the spring of Luding's model."""
PLASTICITY, WORK = 0.5, 200.0
"""Plasticity and work of adhesion [J/m2] of elasto-plastic adhesion, with the same spring."""
SCHWAGER = "Schwager & Poeschel 2007, doi 10.1007/s10035-007-0065-z"


@dataclass(frozen=True)
class Model:
    """A normal model with a restitution, and its collision of two glass spheres.

    contact:      block `normal` of the scene
    restitution:  of the pair
    expected:     rebound by pair and approach velocity [m/s]
    quantities:   attributes of `Rebound` that are compared
    speeds:       approach velocities [m/s]
    """

    contact: Any
    restitution: float
    expected: Callable[[Pair, float], Rebound]
    source: str
    quantities: tuple[str, ...]
    speeds: Sequence[float] = (SPEED,)
    material: Mapping[str, float] | None = None
    pair: Mapping[str, float] | None = None
    """Further properties of the pair."""


NAMES = {
    "velocity": "restitution",
    "duration": "duration",
    "overlap": "maximum overlap",
    "force": "maximum force",
}
"""Quantities by attribute of `Rebound`."""


def viscous_hertz(e: float) -> Callable[[Pair, float], Rebound]:
    """Collisions of a Hertz spring with Tsuji's damping."""
    return lambda pair, v: collide(pair.mass, v, pair.largest_overlap(v), hertz_dashpot(pair, e))


def equal_energy_spring(e: float) -> Callable[[Pair, float], Rebound]:
    """Collisions of a linear spring with the stiffness of Eq. 19 at the approach velocity."""

    def expected(pair: Pair, v: float) -> Rebound:
        return collide(
            pair.mass, v, pair.largest_overlap(v), linear_dashpot(zhou_spring(pair, v), pair.mass, e)
        )

    return expected


def bilinear(e: float) -> Callable[[Pair, float], Rebound]:
    """Collisions of Walton & Braun: a quarter of the period of the spring of Eq. 19, and e times that."""

    def expected(pair: Pair, v: float) -> Rebound:
        stiffness = zhou_spring(pair, v)
        largest = v * math.sqrt(pair.mass / stiffness)
        quarter = 0.5 * math.pi * math.sqrt(pair.mass / stiffness)
        return Rebound(largest, stiffness * largest, quarter, e * quarter, e * v)

    return expected


def luding(e: float) -> Callable[[Pair, float], Rebound]:
    """Collisions of Luding below the limit overlap: k2 = k1 (1 + (kp/k1 - 1) dmax/dlim), kp = k1/e^2.

    The residual overlap at the limit is DEPTH times 2 R: dlim (1 - k1/kp) = 2 R DEPTH.
    """

    def expected(pair: Pair, v: float) -> Rebound:
        largest = v * math.sqrt(pair.mass / GIVEN)
        quarter = 0.5 * math.pi * math.sqrt(pair.mass / GIVEN)
        limit = 2.0 * pair.radius * DEPTH / (1.0 - e**2)
        restitution = 1.0 / math.sqrt(1.0 + (1.0 / e**2 - 1.0) * largest / limit)
        return Rebound(largest, GIVEN * largest, quarter, restitution * quarter, restitution * v)

    return expected


def adhesive(pair: Pair, v: float) -> Rebound:
    """Collisions of the linear elasto-plastic adhesion: area of loading and unloading, and of the tension.

    e^2 = k1/k2 - fmin dp / (k1 dmax^2),   fmin = 3/2 pi w sqrt(2 R dp),   dp = (1 - k1/k2) dmax
    """
    largest = v * math.sqrt(pair.mass / GIVEN)
    residual = PLASTICITY * largest
    tension = 1.5 * math.pi * WORK * math.sqrt(2.0 * pair.radius * residual)
    squared = 1.0 - PLASTICITY - tension * residual / (GIVEN * largest**2)
    return Rebound(largest, GIVEN * largest, math.nan, math.nan, v * math.sqrt(squared))


def plastic(pair: Pair, v: float) -> Rebound:
    """Restitution of Thornton's collision; the other numbers have no closed form."""
    return Rebound(
        math.nan, math.nan, math.nan, math.nan, v * thornton_restitution(pair, YIELD_RATIO * STRENGTH, v)
    )


TSUJI = "Tsuji et al. 1992 and Antypov & Elliott 2011, doi 10.1209/0295-5075/94/50004, integrated"
MODELS = {
    "hertz, e = 0.5": Model("hertz", 0.5, viscous_hertz(0.5), TSUJI, ("velocity", "duration", "overlap")),
    "hertz, e = 0.9": Model("hertz", 0.9, viscous_hertz(0.9), TSUJI, ("velocity", "duration", "overlap")),
    "linear, e = 1": Model(
        {"law": "linear", "stiffness": "onset"},
        1.0,
        equal_energy_spring(1.0),
        "Zhou 2011, Eq. 19",
        ("velocity", "duration", "overlap", "force"),
        SPEEDS,
    ),
    "linear, e = 0.6": Model(
        {"law": "linear", "stiffness": "onset"},
        0.6,
        equal_energy_spring(0.6),
        f"Zhou 2011, Eq. 19; {SCHWAGER}",
        ("velocity", "duration", "overlap"),
    ),
    "walton_braun, e = 0.7": Model(
        {"law": "walton_braun", "stiffness": "onset", "unloading": "constant"},
        0.7,
        bilinear(0.7),
        "Walton & Braun 1986, doi 10.1122/1.549893, with the spring of Zhou 2011, Eq. 19",
        ("velocity", "duration", "overlap", "force"),
    ),
    "luding, limit e = 0.5": Model(
        {"law": "luding", "stiffness": {"value": GIVEN}, "plasticity_depth": DEPTH},
        0.5,
        luding(0.5),
        "Luding 2008, doi 10.1007/s10035-008-0099-x",
        ("velocity", "duration", "overlap"),
        SPEEDS,
    ),
    "eepa, linear, plasticity 0.5": Model(
        {"law": "eepa", "stiffness": {"value": GIVEN}, "adhesion_exponent": 1},
        1.0,
        adhesive,
        "Thakur et al. 2014, doi 10.1007/s10035-014-0506-4",
        ("velocity", "overlap", "force"),
        SPEEDS,
        pair={"plasticity": PLASTICITY, "work_of_adhesion": WORK, "pull_off_force": 0.0},
    ),
    "thornton": Model(
        {"law": "thornton", "yield_ratio": YIELD_RATIO},
        math.nan,
        plastic,
        "Thornton 1997, doi 10.1115/1.2787319",
        ("velocity",),
        SPEEDS,
        material=GLASS | {"yield_strength": STRENGTH},
    ),
}
"""Models by name in the table."""


def normal_model_cases() -> list[ValidationCase]:
    """Collisions of every normal model but those of Zhou and of viscoelastic spheres."""
    return [case for name, model in MODELS.items() for case in model_cases(name, model)]


def model_cases(name: str, model: Model) -> list[ValidationCase]:
    """Collisions of one model at its approach velocities."""
    solid = model.material or GLASS
    has_restitution = not math.isnan(model.restitution)
    bench = CollisionBench(
        materials={"glass": solid},
        pairs={
            "glass-glass": {
                "friction": 0.0,
                **({"restitution": model.restitution} if has_restitution else {}),
                **(model.pair or {}),
            }
        },
        contact={"normal": model.contact},
        collisions=[Collision("glass", "glass", RADIUS, RADIUS, speed) for speed in model.speeds],
        run={"duration": 0.1, "velocity_max": max(model.speeds), "precision": "f64"},
        numerics={"time_step_fraction": FRACTION},
    )
    samples = bench.run()
    time_step = bench.simulation.time_step
    bench.free()
    pair = Pair(Partner(solid, RADIUS), Partner(solid, RADIUS))
    cases = []
    for number, speed in enumerate(model.speeds):
        found = measured(samples[:, :, number], time_step)
        expected = model.expected(pair, speed)
        for quantity in model.quantities:
            unit = {"velocity": "1", "duration": "s", "overlap": "m", "force": "N"}[quantity]
            scale = speed if quantity == "velocity" else 1.0
            cases.append(
                ValidationCase(
                    "Other normal models",
                    f"{name}, {speed:g} m/s: {NAMES[quantity]}",
                    getattr(expected, quantity) / scale,
                    model.source,
                    getattr(found, quantity) / scale,
                    unit,
                    STEP_ERROR,
                    STEP_REASON,
                )
            )
    return cases
