"""Validation cases of cohesion models and of viscoelastic spheres in head-on collisions of equal spheres."""

import math

import numpy as np

from granflow.contact import theory
from granflow.contact.material import modulus_eff
from granflow.geometry.sphere import sphere_mass
from granflow.scene.blocks.materials import Material
from granflow.studies.bench import Collision, CollisionBench
from validation.case import ValidationCase

SOLID = {"young_modulus": 1e7, "poisson_ratio": 0.3, "density": 2000.0}
MODULUS = modulus_eff(Material(**SOLID), Material(**SOLID))
"""Effective modulus [Pa]."""
RADIUS = 1e-4
"""Radius [m] of the spheres."""
MASS = 0.5 * sphere_mass(RADIUS, SOLID["density"])
"""Effective mass [kg] of two spheres."""
WORK = 0.05
"""Work of adhesion [J/m2]."""
PULL_OFF = {
    "jkr": (1.5, "Johnson, Kendall & Roberts 1971, doi 10.1098/rspa.1971.0141: 3/2 pi w R"),
    "dmt": (2.0, "Derjaguin, Muller & Toporov 1975, doi 10.1016/0021-9797(75)90018-1: 2 pi w R"),
}
"""Pull-off force over pi w R, and its source."""
JKR_WORK = 7.09
"""Energy that a contact of JKR dissipates, over (w^5 R^4 / E^2)^(1/3) (Thornton & Ning 1998)."""
DIGITS = 0.005 / JKR_WORK
"""Relative rounding error of this coefficient."""
SPEEDS = (0.05, 0.1)
"""Approach velocities [m/s] of adhesive spheres, above the velocity of 0.037 m/s at which spheres of JKR
stick."""
FRACTION = 0.002
"""Time step over the shorter of loading and unloading time."""
PULL_OFF_ERROR = (0.5 * math.pi * FRACTION) ** 2
"""Relative error of the largest of the forces at all steps, (w dt)^2; a phase of a contact is a quarter of a
period."""
JUMPS = (8.0 / 9.0, 5.0 / 9.0)
"""Tension at first contact and at separation over the pull-off force; both begin or end within a time
step."""

VISCOELASTIC_REFERENCE = (0.95, 1.0)
"""Restitution at a velocity [m/s], from which the others follow."""
VISCOELASTIC_SPEEDS = (0.01, 0.1, 10.0)
SERIES = (1.15344, 0.79826)
"""Coefficients of e = 1 - C1 g + C2 g^2 with g ~ v^(1/5) (Ramirez et al. 1999)."""
REMAINDER = 0.5
"""Bound of the remainder of the series over g^(5/2)."""


def adhesion_cases() -> list[ValidationCase]:
    """Pull-off forces of JKR and DMT, rebound velocities of JKR, and restitutions of viscoelastic spheres."""
    cases = []
    for name in PULL_OFF:
        cases += cohesion_cases(name)
    return cases + viscoelastic_cases()


def cohesion_cases(name: str) -> list[ValidationCase]:
    """Pull-off force, the largest tension of a rebound, and for JKR the velocities of rebound."""
    bench = CollisionBench(
        materials={"soft": SOLID},
        pairs={"soft-soft": {"restitution": 1.0, "friction": 0.0, "work_of_adhesion": WORK}},
        contact={"normal": "hertz", "cohesion": name},
        collisions=[Collision("soft", "soft", RADIUS, RADIUS, speed) for speed in SPEEDS],
        run={"duration": 0.01, "velocity_max": max(SPEEDS), "precision": "f64"},
        numerics={"time_step_fraction": FRACTION},
    )
    samples = bench.run()
    time_step = bench.simulation.time_step
    bench.free()
    factor, source = PULL_OFF[name]
    reason = f"(w dt)^2 of a time step of {100 * FRACTION:g} % of a quarter period"
    pull_off = factor * math.pi * WORK * RADIUS / 2.0
    cases = [
        ValidationCase(
            "Adhesion",
            f"{name}: pull-off force",
            pull_off,
            source,
            _pull_off(name, samples[:, :, 0]),
            "N",
            PULL_OFF_ERROR,
            reason,
        )
    ]
    if name == "jkr":
        for speed, value in zip(SPEEDS, -samples[-1, 1], strict=True):
            cases.append(_rebound_case(speed, float(value), pull_off * time_step))
    return cases


def _pull_off(name: str, samples: np.ndarray) -> float:
    """Largest tension [N] of a collision (samples, 3), for DMT the mean attraction besides the Hertz force.

    The tension of DMT is largest at overlap 0, between two samples.
    """
    overlap, _, force = samples.T
    if name == "jkr":
        return float(-force[whole_steps(force != 0.0)].min())
    k = float(theory.hertz_stiffness(MODULUS, RADIUS / 2.0))
    touches = whole_steps(overlap > 0.0)
    return float(np.mean(k * overlap[touches] ** 1.5 - force[touches]))


def whole_steps(acts: np.ndarray) -> np.ndarray:
    """The steps (s,) of an attraction without its first and last, in which it acts for a share of the step."""
    (found,) = np.nonzero(acts)
    return found[1:-1]


def _rebound_case(speed: float, value: float, impulse: float) -> ValidationCase:
    """Velocity of rebound [m/s] after an approach at `speed` [m/s]; `impulse` [N s]: pull-off force times
    time step."""
    loss = JKR_WORK * (WORK**5 * (RADIUS / 2.0) ** 4 / MODULUS**2) ** (1.0 / 3.0)
    rebound = math.sqrt(speed**2 - 2.0 * loss / MASS)
    error = impulse * (JUMPS[0] * speed + JUMPS[1] * rebound)
    return ValidationCase(
        "Adhesion",
        f"jkr: rebound velocity at {speed:g} m/s",
        rebound,
        "Thornton & Ning 1998, doi 10.1016/S0032-5910(98)00099-0: loss 7.09 (w^5 R^4 / E^2)^(1/3)",
        value,
        "m/s",
        (error + DIGITS * loss) / (MASS * rebound**2),
        "work of the tension in one time step at first contact and at separation, and the digits of 7.09",
    )


def viscoelastic_cases() -> list[ValidationCase]:
    """Restitution of viscoelastic spheres over velocity, by the series of Ramirez et al. (1999)."""
    e, reference_velocity = VISCOELASTIC_REFERENCE
    bench = CollisionBench(
        materials={"soft": SOLID},
        pairs={"soft-soft": {"restitution": e, "friction": 0.0}},
        contact={"normal": {"law": "kuwabara_kono", "reference_velocity": reference_velocity}},
        collisions=[Collision("soft", "soft", RADIUS, RADIUS, speed) for speed in VISCOELASTIC_SPEEDS],
        run={"duration": 0.01, "velocity_max": max(VISCOELASTIC_SPEEDS), "precision": "f64"},
        numerics={"time_step_fraction": FRACTION},
    )
    rebound = bench.rebound()
    bench.free()
    first, second = SERIES
    g_reference = (first - math.sqrt(first**2 - 4.0 * second * (1.0 - e))) / (2.0 * second)
    cases = []
    for speed, value in zip(VISCOELASTIC_SPEEDS, rebound, strict=True):
        g = g_reference * (speed / reference_velocity) ** 0.2
        # the remainder of the series at g, and that at the reference, which shifts g in proportion
        allowed = REMAINDER * (g**2.5 + g_reference**1.5 * g)
        cases.append(
            ValidationCase(
                "Viscoelastic spheres",
                f"restitution at {speed:g} m/s, {e:g} at {reference_velocity:g} m/s",
                1.0 - first * g + second * g**2,
                "Ramirez, Poeschel, Brilliantov & Schwager 1999, doi 10.1103/PhysRevE.60.4465",
                float(value) / speed,
                "1",
                allowed,
                "remainder of the series, below g^(5/2) / 2, at both velocities",
                scale=1.0,
                remark="The contact ends at zero force (Schwager & Poeschel 2008).",
            )
        )
    return cases
