"""Validation cases of tangential models: oblique impacts that stick, against an integration of the published
forces.

    m vt' = T,   I w' = -a T,   u = vt - a w,   a = R - d/2,   T = -kt s - c u,   |T| <= mu F

for a sphere on a wall: slip velocity u, elastic displacement s, tangential stiffness kt (Mindlin 1949: 8 G
sqrt(R d)). Nothing is imported from `granflow.contact`.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from granflow.studies.bench import Collision, CollisionBench
from validation.case import ValidationCase
from validation.collisions import GLASS
from validation.theory_of_collisions import (
    Pair,
    Partner,
    hertz_dashpot,
    zhou_collision,
    zhou_recovery,
)

RADIUS, SPEED = 0.005, 0.5
"""Radius [m] of the sphere, and approach velocity [m/s]."""
FRACTION = 0.002
"""Time step over the shorter of loading and unloading time."""
STEP_ERROR = 0.5 * math.pi * FRACTION
"""Error w dt: increments of the force have the stiffness at the end of each step, a rule of first order."""
STEP_REASON = (
    "w dt of a time step of 0.2 % of a quarter period: each increment has the stiffness at the end of its "
    "step"
)
STEPS = 20000
"""Steps of the integration, whose error is a tenth of STEP_ERROR."""
SOURCE = "Mindlin 1949; Thornton, Cummins & Cleary 2013, doi 10.1016/j.powtec.2012.08.012, integrated"
STIFFNESS = 1e6
"""Stiffness [N/m] of `linear_history`."""


@dataclass(frozen=True)
class Impact:
    """One oblique impact.

    normal, tangential:  blocks of the scene
    restitution:         of the pair
    friction:            coefficient
    along:               tangential over approach velocity
    spring:              rate of change of the displacement by the change of the stiffness: a function of s
                         and of the relative rate kt'/kt, or None for a spring of constant stiffness
    damping:             tangential over normal dashpot
    """

    normal: Any
    tangential: Any
    restitution: float
    friction: float
    along: float
    spring: Callable[[float, float], float] | None
    damping: float = 0.0


def force_kept(s: float, growth: float) -> float:
    """Every change of the stiffness preserves the force kt s."""
    return -s * growth


def force_rescaled(s: float, growth: float) -> float:
    """An increase of the stiffness preserves the force; a decrease reduces it with the stiffness."""
    return -s * max(growth, 0.0)


def displacement_kept(s: float, growth: float) -> float:
    """No change of the stiffness changes the displacement."""
    return 0.0


def displacement_rescaled(s: float, growth: float) -> float:
    """A decrease of the stiffness reduces the displacement in proportion."""
    return s * min(growth, 0.0)


def no_spring(s: float, growth: float) -> float:
    """There is a dashpot alone."""
    return 0.0


KEPT = {"law": "mindlin", "increments": "displacement", "unloading": "kept"}
RESCALED = {"law": "mindlin", "increments": "displacement", "unloading": "rescaled"}
FORCE_KEPT = {"law": "mindlin", "unloading": "kept"}
IMPACTS: Mapping[str, Impact] = {
    "mindlin, no slip, e = 1": Impact("zhou", "mindlin", 1.0, 5.0, 0.5, force_rescaled),
    "mindlin, e = 0.5": Impact("zhou", "mindlin", 0.5, 0.3, 0.4, force_rescaled),
    "mindlin, e = 0.8, steeper": Impact("zhou", "mindlin", 0.8, 0.3, 0.8, force_rescaled),
    "mindlin, unloading kept": Impact("zhou", FORCE_KEPT, 0.5, 0.3, 0.4, force_kept),
    "mindlin, increments of displacement, rescaled": Impact(
        "zhou", RESCALED, 0.5, 0.3, 0.4, displacement_rescaled
    ),
    "mindlin, increments of displacement, kept": Impact("zhou", KEPT, 0.5, 0.3, 0.4, displacement_kept),
    "mindlin with dashpot, hertz, e = 0.8": Impact(
        "hertz", {"law": "mindlin", "damping": 1.0}, 0.8, 0.3, 0.4, force_rescaled, 1.0
    ),
    "linear_history": Impact("zhou", {"law": "linear_history", "stiffness": STIFFNESS}, 0.8, 0.3, 0.4, None),
    "sliding_dashpot, hertz, e = 0.8": Impact(
        "hertz", {"law": "sliding_dashpot", "damping": 1.0}, 0.8, 0.05, 0.4, no_spring, 1.0
    ),
}
"""Impacts by name. They stick first; except for the first they slide before they separate."""


def sticking_cases() -> list[ValidationCase]:
    """Velocity of the contact patch and spin after each of IMPACTS."""
    return [case for name, impact in IMPACTS.items() for case in impact_cases(name, impact)]


def impact_cases(name: str, impact: Impact) -> list[ValidationCase]:
    """Rebound of one impact."""
    bench = CollisionBench(
        materials={"glass": GLASS},
        pairs={"glass-glass": {"restitution": impact.restitution, "friction": impact.friction}},
        contact={"normal": impact.normal, "tangential": impact.tangential},
        collisions=[Collision("glass", "glass", RADIUS, None, SPEED, 1.0, impact.along * SPEED)],
        run={"duration": 0.01, "velocity_max": 2.0 * SPEED, "precision": "f64"},
        numerics={"time_step_fraction": FRACTION, "rayleigh_fraction": 1.0},
    )
    bench.rebound()
    velocity, spin = (each[0, 0] for each in bench.motions())
    bench.free()
    rows = (
        ("tangential velocity of the contact after the impact", -1.0, velocity[1] + RADIUS * spin[2]),
        ("circumferential velocity", RADIUS, -RADIUS * spin[2]),
    )
    along, rotation = rebound(impact)
    expected = (along - RADIUS * rotation, RADIUS * rotation)
    return [
        ValidationCase(
            "Impacts that stick",
            f"{name}: {quantity} over that before",
            reference / (impact.along * SPEED),
            SOURCE,
            float(value) / (impact.along * SPEED),
            "1",
            STEP_ERROR,
            STEP_REASON,
            scale=1.0,
        )
        for (quantity, _, value), reference in zip(rows, expected, strict=True)
    ]


def rebound(impact: Impact) -> tuple[float, float]:
    """Tangential [m/s] and angular velocity [rad/s] after the impact, by the leapfrog method with STEPS
    steps."""
    pair = Pair(Partner(GLASS, RADIUS), Partner(GLASS, math.inf))
    k = pair.k
    mass = pair.mass
    inertia = 0.4 * pair.mass * RADIUS**2
    e = impact.restitution
    y = zhou_recovery(impact.restitution)
    viscous = impact.normal == "hertz"
    dashpot = hertz_dashpot(pair, e) if viscous else None
    step = 1.5 * zhou_collision(pair, 1.0, SPEED).duration / STEPS
    d = 0.5 * step * SPEED
    rate = SPEED
    along = impact.along * SPEED
    rotation = 0.0
    s = 0.0
    largest = 0.0
    kt_before = 0.0
    for _ in range(STEPS):
        if d <= 0.0:
            break
        largest = max(d, largest)
        if dashpot is not None:
            force = max(dashpot(d, rate), 0.0)
        elif d >= largest:
            force = k * d**1.5
        else:
            above = max(d - (1.0 - y) * largest, 0.0)
            slope = (k * largest**1.5 - e**3 * k * (y * largest) ** 1.5) / (y * largest)
            force = slope * above + e**3 * k * above**1.5
        kt = STIFFNESS if impact.spring is None else 8.0 * pair.shear_modulus * math.sqrt(RADIUS * d)
        kt = 0.0 if impact.spring is no_spring else kt
        arm = RADIUS - 0.5 * d
        slip = along - arm * rotation
        if impact.spring is not None and kt_before > 0.0:
            s += impact.spring(s, (kt - kt_before) / (0.5 * (kt + kt_before)))
        s += slip * step
        viscosity = impact.damping * (force - k * d**1.5) / rate if viscous and rate != 0.0 else 0.0
        trial = -kt * s - viscosity * slip
        tangential = max(min(trial, impact.friction * force), -impact.friction * force)
        if tangential != trial and kt > 0.0:
            s = -(tangential + viscosity * slip) / kt
        rate -= step * force / mass
        along += step * tangential / mass
        rotation -= step * arm * tangential / inertia
        d = d + step * rate
        kt_before = kt
    return along, rotation
