"""Validation cases of attractions: SJKR, liquid bridges and van der Waals forces between two equal elastic
spheres.

    SJKR:           2 pi w R d during overlap, w the cohesion energy density
    liquid bridge:  4 pi R g cos(t) / (1 + 1.05 u + 2.5 u^2),  u = s sqrt(2 R / V),  up to (1 + t/2) V^(1/3)
    van der Waals:  A R / (6 (s0 + s)^2)

with the distance s of the surfaces, 0 during overlap. Nothing is imported from `granflow.contact`.
"""

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from granflow import Scene, Simulation
from granflow.geometry.sphere import sphere_volume
from validation.adhesion import whole_steps
from validation.case import ValidationCase
from validation.collisions import FRACTION, STEP_ERROR, STEP_REASON
from validation.theory_of_collisions import Pair, Partner, collide, signed_power

SOLID = {"young_modulus": 1e7, "poisson_ratio": 0.3, "density": 2000.0}
RADIUS, SPEED = 1e-3, 0.1
"""Material, radius [m] and approach velocity [m/s] of both spheres."""
PAIR = Pair(Partner(SOLID, RADIUS), Partner(SOLID, RADIUS))
DENSITY = 5e4
"""Cohesion energy density [J/m3] of SJKR; its largest attraction is 40 % of the Hertz force."""
TENSION, ANGLE, VOLUME = 0.072, 0.3, 4e-13
"""Surface tension [N/m], contact angle [rad] and volume [m3] of a liquid bridge."""
CONTENT = 2e-3
"""Volume of the film over that of each particle."""
HAMAKER, SEPARATION = 1e-16, 1e-7
"""Hamaker constant [J], and distance [m] of the surfaces in contact."""
GAP = 5e-7
"""Distance [m] of the surfaces at the start."""
WILLETT = (
    "Willett et al. 2000, doi 10.1021/la000657y, Eq. 12; Lian, Thornton & Adams 1993, doi "
    "10.1006/jcis.1993.1452"
)
DISTANT = (0.05, 0.9)
"""Range of distances over the rupture distance or the cut-off in which attractions are compared."""
CUTOFF = 30.0
"""Cut-off over the separation of the van der Waals force."""


def approach(
    cohesion: Any, pair: Mapping[str, float], gap: float = GAP, **group: Any
) -> tuple[np.ndarray, float]:
    """Samples (n, 3) of overlap [m], overlap rate [m/s] and repulsion [N] of each step, and the time step
    [s].

    The samples end when the spheres have been without force for 50 steps after they have touched.
    """
    distance = 2.0 * RADIUS + gap
    spheres = {
        "material": "ball",
        "diameter": 2.0 * RADIUS,
        "velocity": [[0.5 * SPEED, 0.0, 0.0], [-0.5 * SPEED, 0.0, 0.0]],
        "insert": {"kind": "positions", "positions": [[0.0, 0.0, 0.0], [distance, 0.0, 0.0]]},
        **group,
    }
    simulation = Simulation(
        Scene.from_dict(
            {
                "title": "Two spheres",
                "gravity": [0, 0, 0],
                "materials": {"ball": SOLID},
                "pairs": {"ball-ball": {"restitution": 1.0, "friction": 0.0, **pair}},
                "particles": {"balls": spheres},
                "contact": {"normal": "hertz", "tangential": "none", "rolling": "none", "cohesion": cohesion},
                "domain": {"min": [-0.1] * 3, "max": [0.1] * 3, "on_exit": "error"},
                "run": {"duration": 1.0, "velocity_max": SPEED, "precision": "f64"},
                "numerics": {"time_step_fraction": FRACTION, "max_overlap": 0.5},
                "output": {"interval": 1.0},
            }
        )
    )
    rows = []
    quiet = 0
    while quiet < 50:
        simulation.step(1)
        state = simulation.snapshot().particles
        x, v, force = (state[name][:, 0] for name in ("position", "velocity", "force"))
        rows.append((2.0 * RADIUS - (x[1] - x[0]), v[0] - v[1], -force[0]))
        quiet = quiet + 1 if force[0] == 0.0 and v[0] < v[1] else 0
    time_step = simulation.time_step
    simulation.free()
    return np.array(rows), time_step


def attraction_cases() -> list[ValidationCase]:
    """All cases of this module."""
    return sjkr_cases() + bridge_cases() + van_der_waals_cases()


def sjkr_cases() -> list[ValidationCase]:
    """Maximum overlap, duration and attraction of a collision with SJKR."""
    k = PAIR.k
    slope = 2.0 * math.pi * DENSITY * PAIR.radius
    length = PAIR.largest_overlap(SPEED)
    expected = collide(PAIR.mass, SPEED, length, lambda d, _: k * signed_power(d, 1.5) - slope * d)
    samples, time_step = approach("sjkr", {"cohesion_energy_density": DENSITY})
    overlap, _, force = samples.T
    touches = np.flatnonzero(overlap > 0.0)
    first = int(touches[0])
    last = int(touches[-1])
    deep = overlap[touches]
    begin = first - overlap[first] / (overlap[first] - overlap[first - 1])
    end = last + overlap[last] / (overlap[last] - overlap[last + 1])
    rows = (
        ("maximum overlap", expected.overlap, float(overlap.max()), "m"),
        ("duration", 2.0 * expected.loading, float(end - begin) * time_step, "s"),
        ("attraction over overlap", slope, float(np.mean((k * deep**1.5 - force[touches]) / deep)), "N/m"),
    )
    return [
        ValidationCase(
            "Attractions",
            f"sjkr: {name}",
            reference,
            "k d^(3/2) - 2 pi w R d, integrated",
            value,
            unit,
            STEP_ERROR,
            STEP_REASON,
        )
        for name, reference, value, unit in rows
    ]


def bridge_cases() -> list[ValidationCase]:
    """Attraction in contact and at a distance, rupture distance and rebound velocity of both models of
    bridges."""
    pair = {"surface_tension": TENSION, "contact_angle": ANGLE}
    # L_i = V_i / 2 (1 - sqrt(1 - R_j^2 / (R_i + R_j)^2)) of both films (Shi & McCarthy 2008)
    film = CONTENT * sphere_volume(RADIUS)
    shared = film * (1.0 - math.sqrt(0.75))
    transfer = {"law": "capillary_transfer", "max_bridge_volume": 2.0 * shared}
    return [
        *bridge_model_cases("capillary", "capillary", pair | {"liquid_volume": VOLUME}, VOLUME, WILLETT),
        *bridge_model_cases(
            "capillary_transfer",
            transfer,
            pair,
            shared,
            f"{WILLETT}; volume: Shi & McCarthy 2008, doi 10.1016/j.powtec.2007.08.011",
            liquid_content=CONTENT,
        ),
    ]


def bridge_model_cases(
    name: str, cohesion: Any, pair: Mapping[str, float], volume: float, source: str, **group: Any
) -> list[ValidationCase]:
    """Cases of one model whose bridge has this volume [m3]."""
    rupture = (1.0 + 0.5 * ANGLE) * volume ** (1.0 / 3.0)
    touching = 4.0 * math.pi * PAIR.radius * TENSION
    touching *= math.cos(ANGLE)
    scale = math.sqrt(2.0 * PAIR.radius / volume)

    def attraction(distance: np.ndarray) -> np.ndarray:
        u = distance * scale
        return touching / (1.0 + 1.05 * u + 2.5 * u**2)

    distances = np.linspace(0.0, rupture, 20001)
    forces = attraction(distances)
    work = float(np.sum(0.5 * (forces[1:] + forces[:-1])) * distances[1])
    samples, time_step = approach(cohesion, pair, **group)
    cases = force_cases(name, samples, attraction, touching, rupture, source)
    rebound = math.sqrt(SPEED**2 - 2.0 * work / PAIR.mass)
    gap = -samples[:, 0]
    attracted = samples[:, 2] < 0.0
    # the bridge forms and breaks within a step
    impulse = (touching * SPEED + float(attraction(np.array(rupture))) * rebound) * time_step
    rows = (
        (
            "rupture distance",
            rupture,
            float(gap[attracted].max()),
            "m",
            rebound * time_step / rupture,
            "one time step",
        ),
        (
            "rebound velocity",
            rebound,
            float(-samples[-1, 1]),
            "m/s",
            impulse / (PAIR.mass * rebound**2) + STEP_ERROR,
            f"work of the attraction in one step at formation and at rupture, and {STEP_REASON}",
        ),
    )
    return cases + [
        ValidationCase("Attractions", f"{name}: {quantity}", reference, source, value, unit, allowed, reason)
        for quantity, reference, value, unit, allowed, reason in rows
    ]


def van_der_waals_cases() -> list[ValidationCase]:
    """Attraction in contact and at a distance."""
    touching = HAMAKER * PAIR.radius / (6.0 * SEPARATION**2)

    def attraction(distance: np.ndarray) -> np.ndarray:
        return touching / (1.0 + distance / SEPARATION) ** 2

    pair = {"hamaker_constant": HAMAKER, "separation": SEPARATION}
    samples, _ = approach("van_der_waals", pair, 0.9 * CUTOFF * SEPARATION)
    source = "Hamaker 1937, doi 10.1016/S0031-8914(37)80203-7"
    return force_cases("van_der_waals", samples, attraction, touching, CUTOFF * SEPARATION, source)


def force_cases(
    name: str,
    samples: np.ndarray,
    attraction: Callable[[np.ndarray], np.ndarray],
    touching: float,
    reach: float,
    source: str,
) -> list[ValidationCase]:
    """Attraction besides the Hertz force during overlap, and its sum over that of the formula after
    separation."""
    overlap, rate, force = samples.T
    touches = whole_steps(overlap > 0.0)
    separated = (rate < 0.0) & (-overlap > DISTANT[0] * reach) & (-overlap < DISTANT[1] * reach)
    in_contact = float(np.mean(PAIR.k * overlap[touches] ** 1.5 - force[touches]))
    ratio = float(np.sum(-force[separated]) / np.sum(attraction(-overlap[separated])))
    rounding = 1e-6
    return [
        ValidationCase(
            "Attractions",
            f"{name}: {quantity}",
            reference,
            source,
            value,
            unit,
            rounding,
            "rounding of the forces, which are added on a grid",
        )
        for quantity, reference, value, unit in (
            ("attraction in contact", touching, in_contact, "N"),
            ("attraction at a distance over the formula", 1.0, ratio, "1"),
        )
    ]
