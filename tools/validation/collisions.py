"""Validation cases of single collisions: Chung & Ooi (2011), tests 1 to 3, and Zhou's model.

Chung & Ooi 2011, Granular Matter 13:643, doi 10.1007/s10035-011-0277-0; Zhou 2011, doi 10.1063/2.1104106.
"""

import math
from itertools import product
from typing import Any

import numpy as np

from granflow.scene.blocks.materials import PRESETS
from granflow.studies.bench import Collision, CollisionBench
from granflow.studies.collide import collide
from granflow.studies.paper.oblique import Solid
from validation.case import ValidationCase
from validation.theory_of_collisions import (
    INTEGRATION_ERROR,
    Pair,
    Partner,
    Rebound,
    zhou_collision,
    zhou_limit_velocity,
    zhou_restitution,
    zhou_spring,
)

GLASS = {"young_modulus": 48e9, "poisson_ratio": 0.20, "density": 2800.0}
ALLOY = {"young_modulus": 70e9, "poisson_ratio": 0.30, "density": 2699.0}
OXIDE = {"young_modulus": 380e9, "poisson_ratio": 0.23, "density": 4000.0}
IRON = {"young_modulus": 100e9, "poisson_ratio": 0.25, "density": 7000.0}
RIGID = {"young_modulus": 1e25, "poisson_ratio": 0.3, "density": 1e4}

BENCHMARKS = (
    ("test 1, glass spheres", GLASS, 0.01, 0.01, 20.0, (274.11e-6, 10.697e3, 40.34e-6)),
    ("test 2, alloy sphere on a plane", ALLOY, 0.1, None, 0.2, (49.717e-6, 11.370e3, 731.6e-6)),
    ("test 3, oxide sphere on a plane", OXIDE, 0.0025, None, 3.9, (8.089e-6, 615.35, 6.104e-6)),
    ("test 3, cast iron sphere on a plane", IRON, 0.0025, None, 3.9, (17.189e-6, 506.76, 12.97e-6)),
)
"""Name, material, radii [m], approach velocity [m/s]; maximum overlap [m] and force [N], and duration [s]."""
QUANTITIES = (("maximum overlap", "m"), ("maximum force", "N"), ("duration", "s"))
STEPS = 1000
"""Time steps per collision."""
HALF_DIGIT = 6e-4
"""Allowed deviation from printed numbers of four to five digits."""

FRACTION = 0.01
"""Time step over the shorter of loading and unloading time of a collision."""
STEP_ERROR = (0.5 * math.pi * FRACTION) ** 2
"""Relative error of an integration of second order, (w dt)^2; a phase of a contact is a quarter of a period,
pi/2."""
STEP_REASON = "(w dt)^2 of a time step of 1 % of a quarter period"

RESTITUTIONS = (0.3, 0.5, 0.7, 0.9)
"""Restitutions of Zhou's model."""
PAIRS = (
    ("glass spheres", (GLASS, 0.005), (GLASS, 0.005), 0.5),
    ("oxide sphere on an iron wall", (OXIDE, 0.003), (IRON, math.inf), 1.0),
    ("alloy spheres of 3 and 8 mm", (ALLOY, 0.003), (ALLOY, 0.008), 5.0),
)
"""Name, material and radius [m] of both partners, and approach velocity [m/s]."""
STEELS = {
    "stainless_316": (3.0432, 0.540, 0.310e9, 8030.0),
    "chrome_52100": (0.1418, 0.3114, 2.03e9, 7830.0),
}
"""sigma and psi, yield strength [Pa] and density [kg/m3] of the steels of Zhou 2011, Figs. 3 and 4."""
MIXED = ("stainless_316-chrome_52100", 1.0, 0.5)
"""A pair of both steels, whose limit velocity is that of the softer one, with a chosen sigma and psi."""
STEEL_SPEEDS, LIMIT_SHARES = (
    (0.01, 0.1, 1.0, 10.0),
    {"stainless_316": 0.3, "chrome_52100": 0.7, MIXED[0]: 0.4},
)
"""Approach velocities [m/s] of the steels, and those over the limit velocity from which it is computed."""
STEEL_RADIUS = 0.0127
"""Radius [m] of the spheres in Zhou 2011."""
ZHOU_2011 = "Zhou 2011, doi 10.1063/2.1104106"
STATED = (("stainless_316", 0.4, 1.0), ("chrome_52100", 0.8, 5.0))
"""Material, restitution and approach velocity [m/s] of collisions whose closed forms `granflow collide`
states."""


def elastic_cases() -> list[ValidationCase]:
    """Tests 1 to 3 of Chung & Ooi with elastic spheres: maximum overlap and force, and duration."""
    found = []
    for name, solid, radius, other, speed, published in BENCHMARKS:
        simulated = elastic_collision(solid, radius, other, speed, published[2])
        for (quantity, unit), reference, value in zip(QUANTITIES, published, simulated, strict=True):
            found.append(
                ValidationCase(
                    "Chung & Ooi",
                    f"{name}: {quantity}",
                    reference,
                    "Hertz's closed forms with the materials of Chung & Ooi 2011, doi "
                    "10.1007/s10035-011-0277-0",
                    value,
                    unit,
                    HALF_DIGIT,
                    f"digits of the reference, and {STEPS} steps per collision",
                )
            )
    return found


def elastic_collision(
    solid: Solid, radius: float, other: float | None, speed: float, duration: float
) -> tuple[float, float, float]:
    """Maximum overlap [m] and force [N], and duration [s], of an elastic collision that lasts about
    `duration` [s]."""
    second = "rigid" if other is None else "solid"
    bench = CollisionBench(
        materials={"solid": solid, "rigid": RIGID},
        pairs=dict.fromkeys(("solid-solid", "solid-rigid"), {"restitution": 1.0, "friction": 0.0}),
        contact={"normal": "zhou"},
        collisions=[Collision("solid", second, radius, other, speed, 1.0 if other is None else 0.5)],
        run={
            "duration": 20.0 * duration,
            "velocity_max": speed,
            "precision": "f64",
            "time_step": duration / STEPS,
        },
    )
    overlap, _, force = bench.run()[:, :, 0].T
    bench.free()
    last = int(np.flatnonzero(overlap > 0.0)[-1])
    end = last + overlap[last] / (overlap[last] - overlap[last + 1])
    return float(overlap.max()), float(np.abs(force).max()), float(end * duration / STEPS)


def restitution_cases() -> list[ValidationCase]:
    """Restitution and duration of Zhou's model for each of PAIRS, and maximum overlap and force."""
    pairs: dict[str, Any] = {}
    materials: dict[str, Solid] = {}
    collisions = []
    expected = []
    for (number, (_, one, other, speed)), e in product(enumerate(PAIRS), RESTITUTIONS):
        first, second = (f"{side}_{number}_{round(10 * e)}" for side in ("one", "other"))
        materials |= {first: one[0], second: other[0]}
        pairs[f"{first}-{second}"] = {"restitution": e, "friction": 0.0}
        is_wall = math.isinf(other[1])
        collisions.append(
            Collision(first, second, one[1], None if is_wall else other[1], speed, 1.0 if is_wall else 0.5)
        )
        expected.append(zhou_collision(Pair(Partner(*one), Partner(*other)), e, speed))
    bench = CollisionBench(
        materials=materials,
        pairs=pairs,
        contact={"normal": "zhou"},
        collisions=collisions,
        run={"duration": 0.1, "velocity_max": max(each[3] for each in PAIRS), "precision": "f64"},
        numerics={"time_step_fraction": FRACTION},
    )
    samples = bench.run()
    time_step = bench.simulation.time_step
    bench.free()
    cases = []
    for number, ((name, *_, speed), e) in enumerate(product(PAIRS, RESTITUTIONS)):
        found = measured(samples[:, :, number], time_step)
        of = expected[number]
        rows = [("restitution", e, found.velocity / speed, "1", f"{ZHOU_2011}, Eq. 8")]
        rows.append(("duration", of.duration, found.duration, "s", f"{ZHOU_2011}, Eqs. 13 to 17, integrated"))
        if e == RESTITUTIONS[0]:
            rows.append(("maximum overlap", of.overlap, found.overlap, "m", f"{ZHOU_2011}, Eq. 5"))
            rows.append(("maximum force", of.force, found.force, "N", f"{ZHOU_2011}, Eqs. 4 and 5"))
        cases += [
            ValidationCase(
                "Collisions of Zhou's model",
                f"{name}, e = {e:g}: {quantity}",
                reference,
                source,
                value,
                unit,
                STEP_ERROR,
                STEP_REASON,
            )
            for quantity, reference, value, unit, source in rows
        ]
    return cases


def measured(samples: np.ndarray, time_step: float) -> Rebound:
    """Maximum overlap and force, durations and velocity of separation from overlap, rate and force (samples,
    3).

    The maximum is that of a parabola through three samples. The contact ends at the zero of a parabola
    through three forces, of which the last is not the last one of the contact: it is a mean over a step that
    the contact leaves.
    """
    overlap, rate, force = samples.T
    top = int(np.argmax(overlap))
    largest, turn = _extreme(overlap[top - 1 : top + 2])
    last = int(np.flatnonzero(force > 0.0)[-1])
    steps = np.array([-3.0, -2.0, -1.0])
    roots = np.roots(np.polyfit(steps, force[last - 3 : last], 2))
    end = last + float(min((each.real for each in roots), key=abs))
    before = (top + turn) * time_step
    return Rebound(
        largest, _extreme(force[top - 1 : top + 2])[0], before, end * time_step - before, float(-rate[-1])
    )


def _extreme(values: np.ndarray) -> tuple[float, float]:
    """Maximum of the parabola through three values, and its place in steps from the second one."""
    slope = 0.5 * (values[2] - values[0])
    curvature = values[2] - 2.0 * values[1] + values[0]
    return float(values[1] - 0.5 * slope**2 / curvature), float(-slope / curvature)


def steel_cases() -> list[ValidationCase]:
    """Restitution over velocity of both steels of Zhou 2011, and the limit velocity that fast collisions
    imply."""
    fits = {name: (*fit[:2], zhou_limit_velocity(*fit[2:])) for name, fit in STEELS.items()}
    softer = min(STEELS.values(), key=lambda fit: fit[2])
    fits[MIXED[0]] = (*MIXED[1:], zhou_limit_velocity(*softer[2:]))
    given = [(name, speed) for name in STEELS for speed in STEEL_SPEEDS]
    given += [(name, share * fits[name][2]) for name, share in LIMIT_SHARES.items()]
    partners = {name: (name.partition("-")[0], name.rpartition("-")[2]) for name in fits}
    pairs = {
        "-".join(partners[name]): {
            "restitution": {"preset": name} if name in STEELS else {"sigma": sigma, "psi": psi},
            "friction": 0.0,
        }
        for name, (sigma, psi, _) in fits.items()
    }
    cases = []
    rebounds = {}
    for place in ("impact", "max_overlap"):
        bench = CollisionBench(
            materials={name: {"preset": name} for name in STEELS},
            pairs=pairs,
            contact={"normal": {"law": "zhou", "restitution_at": place}},
            collisions=[
                Collision(*partners[name], STEEL_RADIUS, STEEL_RADIUS, speed) for name, speed in given
            ],
            run={"duration": 0.1, "velocity_max": max(speed for _, speed in given), "precision": "f64"},
            numerics={"time_step_fraction": FRACTION, "rayleigh_fraction": 1.0},
        )
        rebounds[place] = bench.rebound()
        bench.free()
    rows = zip(given * 2, [*rebounds["impact"], *rebounds["max_overlap"]], strict=True)
    for number, ((name, speed), velocity) in enumerate(rows):
        at = "" if number < len(given) else ", restitution_at: max_overlap"
        sigma, psi, limit = fits[name]
        e = zhou_restitution(sigma, psi, limit, speed)
        found = float(velocity) / speed
        if name not in STEELS or speed not in STEEL_SPEEDS:
            loss = -math.log(e)
            share = speed / limit
            cases.append(
                ValidationCase(
                    "Restitution over velocity",
                    f"{name}: limit velocity from the rebound at {share:g} of it{at}",
                    limit,
                    f"{ZHOU_2011}, Eqs. 11 and 12",
                    speed * (1.0 + (sigma / -math.log(found)) ** (1.0 / psi)),
                    "m/s",
                    STEP_ERROR * (1.0 - share) / (psi * loss),
                    f"{STEP_REASON} in e, times d ln vlim / d ln e",
                )
            )
            continue
        cases.append(
            ValidationCase(
                "Restitution over velocity",
                f"{name}: e at {speed:g} m/s{at}",
                e,
                f"{ZHOU_2011}, Eqs. 11 and 12",
                found,
                "1",
                STEP_ERROR,
                STEP_REASON,
            )
        )
    return cases


def stated_cases() -> list[ValidationCase]:
    """Closed forms that `granflow collide` states: duration (Eqs. 13 to 17) and linear spring (Eq. 19)."""
    cases = []
    for name, e, speed in STATED:
        stated = collide("zhou", name, 2.0 * STEEL_RADIUS, speed, restitution=e)
        solid = {"young_modulus": PRESETS[name].young_modulus, "poisson_ratio": PRESETS[name].poisson_ratio}
        partner = Partner(solid | {"density": PRESETS[name].density}, STEEL_RADIUS)
        pair = Pair(partner, partner)
        found = zhou_collision(pair, e, speed)
        rows = (
            ("duration", found.duration, "duration_theory", "s", "Eqs. 13 to 17, integrated"),
            ("spring of equal energy", zhou_spring(pair, speed), "spring_equation19", "N/m", "Eq. 19"),
        )
        cases += [
            ValidationCase(
                "Collisions of Zhou's model",
                f"{name}, e = {e:g} at {speed:g} m/s: {quantity} that collide states",
                reference,
                f"{ZHOU_2011}, {source}",
                stated[key],
                unit,
                INTEGRATION_ERROR,
                "error of the integration",
            )
            for quantity, reference, key, unit, source in rows
        ]
    return cases
