"""Validation cases of single collisions: Chung & Ooi (2011), tests 1 to 3, and the restitution of Zhou's model.

Chung & Ooi 2011, Granular Matter 13:643, doi 10.1007/s10035-011-0277-0; Zhou 2011, doi 10.1063/2.1104106.
"""

from itertools import product

import numpy as np

from granflow.studies.collision_bench import Collision, CollisionBench
from granflow.studies.paper.oblique import Solid
from granflow.studies.validation.case import ValidationCase

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

RESTITUTIONS = (0.3, 0.5, 0.7, 0.9)
SPEEDS = (0.05, 0.5, 5.0)
"""Restitutions and approach velocities [m/s] of Zhou's model."""
RESTITUTION_ERROR = 2e-3
"""Allowed deviation of the restitution: error of the integration at the time step of the bench, 1 % of the duration."""


def elastic_cases() -> list[ValidationCase]:
    """Tests 1 to 3 of Chung & Ooi with elastic spheres: maximum overlap and force, and duration."""
    found = []
    for name, solid, radius, other, speed, published in BENCHMARKS:
        simulated = elastic_collision(solid, radius, other, speed, published[2])
        for (quantity, unit), reference, value in zip(QUANTITIES, published, simulated, strict=True):
            found.append(
                ValidationCase(
                    "Chung & Ooi", f"{name}: {quantity}", reference,
                    "Hertz's closed forms with the materials of Chung & Ooi 2011, doi 10.1007/s10035-011-0277-0",
                    value, unit, HALF_DIGIT, f"digits of the reference, and {STEPS} steps per collision",
                )
            )  # fmt: skip
    return found


def elastic_collision(
    solid: Solid, radius: float, other: float | None, speed: float, duration: float
) -> tuple[float, float, float]:
    """Maximum overlap [m] and force [N], and duration [s], of an elastic collision that lasts about `duration` [s]."""
    second = "rigid" if other is None else "solid"
    bench = CollisionBench(
        materials={"solid": solid, "rigid": RIGID},
        pairs=dict.fromkeys(("solid-solid", "solid-rigid"), {"restitution": 1.0, "friction": 0.0}),
        contact={"normal": "zhou"},
        collisions=[Collision("solid", second, radius, other, speed, 1.0 if other is None else 0.5)],
        run={"duration": 20.0 * duration, "velocity_max": speed, "precision": "f64", "time_step": duration / STEPS},
    )
    overlap, _, force = bench.run()[:, :, 0].T
    bench.free()
    last = int(np.flatnonzero(overlap > 0.0)[-1])
    end = last + overlap[last] / (overlap[last] - overlap[last + 1])
    return float(overlap.max()), float(np.abs(force).max()), float(end * duration / STEPS)


def restitution_cases() -> list[ValidationCase]:
    """Head-on collisions of Zhou's model over restitution and velocity; the restitution does not depend on velocity."""
    names = [f"solid_{number}" for number in range(len(RESTITUTIONS))]
    pairs = {f"{name}-{name}": {"restitution": e, "friction": 0.0} for name, e in zip(names, RESTITUTIONS, strict=True)}
    given = list(product(zip(names, RESTITUTIONS, strict=True), SPEEDS))
    bench = CollisionBench(
        materials=dict.fromkeys(names, GLASS), pairs=pairs, contact={"normal": "zhou"},
        collisions=[Collision(name, name, 0.005, 0.005, speed) for (name, _), speed in given],
        run={"duration": 0.1, "velocity_max": max(SPEEDS), "precision": "f64"},
        numerics={"time_step_fraction": 0.01},
    )  # fmt: skip
    rebound = bench.rebound()
    bench.free()
    return [
        ValidationCase(
            "Restitution of Zhou's model", f"e = {e:g} at {speed:g} m/s", e, "Zhou 2011, Eq. 8, doi 10.1063/2.1104106",
            float(velocity) / speed, "1", RESTITUTION_ERROR, "time step of 1 % of the shortest phase of the contact",
        )
        for ((_, e), speed), velocity in zip(given, rebound, strict=True)
    ]  # fmt: skip
