"""Validation cases of rolling and twisting models: a sphere on a floor that rolls or spins, against closed
forms.

With the load F = m g, a rolling torque T decelerates a rolling sphere by T / ((1 + 2/5) m R), since friction
takes the rest. A spring of rolling that is not at its limit oscillates together with the tangential spring:

    m x'' = -kt (x - R a),   (2/5) m R^2 a'' = R kt (x - R a) - kr a - c a',   kr = kt R^2

Nothing is imported from `granflow.contact`.
"""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from granflow import Scene, Simulation
from validation.case import ValidationCase
from validation.theory_of_collisions import Pair, Partner

GRAVITY, RADIUS = 9.81, 5e-3
SOLID = {"young_modulus": 1e9, "poisson_ratio": 0.3, "density": 2500.0}
"""Radius [m] and material of the sphere and of the floor."""
FRICTION, ROLLING, DISSIPATION, RATIO = 0.5, 0.02, 2e-3, 0.3
"""Friction, rolling friction, dissipative constant [s] of the viscous torque, damping ratio of the SDS
torque."""
LENGTH, TORSION, TORSION_DAMPING = 2e-5, 5e-2, 2e-7
"""Torque over load [m], stiffness [N m/rad] and dashpot [N m s] of `torsion_spring`."""
SPEED, SLOW = 0.1, 2e-6
"""Velocity [m/s] of rolling or spinning spheres, and of spheres whose springs stay below their limits."""
DURATION, SAMPLES, CYCLES, PER_CYCLE = 0.2, 400, 8, 16
"""Duration [s] of motions at the limit and their samples; oscillations that are evaluated, and samples of
each."""
AI = "Ai et al. 2011, doi 10.1016/j.powtec.2010.09.030"
ROLLING_MODELS: Mapping[str, tuple[Any, Mapping[str, float], str]] = {
    "cdt": ("cdt", {"rolling_friction": ROLLING}, f"{AI}, model A: T = mu_r R F"),
    "viscous": (
        "viscous",
        {"rolling_dissipation": DISSIPATION},
        "Brilliantov & Poeschel 1998, doi 10.1209/epl/i1998-00281-7: T = A R F w",
    ),
    "epsd": ("epsd", {"rolling_friction": ROLLING}, f"{AI}, model C: T <= mu_r R F"),
    "sds": ("sds", {"rolling_friction": ROLLING, "rolling_damping": RATIO}, f"{AI}, model C: T <= mu_r R F"),
}
"""Model, keys of the pair, and source."""
TWISTING_MODELS: Mapping[str, tuple[Any, Mapping[str, float], str]] = {
    "marshall": ("marshall", {}, "Marshall 2009, doi 10.1016/j.jcp.2008.10.020: 2/3 mu a F, kt a^2 / 2"),
    "torsion_spring": (
        {"law": "torsion_spring", "stiffness": TORSION, "damping": TORSION_DAMPING},
        {"twisting_friction": LENGTH},
        "spring and dashpot of given numbers",
    ),
}
"""As ROLLING_MODELS."""

PAIR = Pair(Partner(SOLID, RADIUS), Partner(SOLID, math.inf))
MASS, INERTIA = PAIR.mass, 0.4 * PAIR.mass * RADIUS**2
OVERLAP = (MASS * GRAVITY / PAIR.k) ** (2.0 / 3.0)
"""Overlap [m] at which the Hertz force carries the weight."""
TANGENTIAL = 8.0 * PAIR.shear_modulus * math.sqrt(RADIUS * OVERLAP)
"""Tangential stiffness [N/m] at rest (Mindlin 1949)."""
SLIP_RATE = math.sqrt(3.5 * TANGENTIAL / MASS)
"""Angular frequency [rad/s] of the tangential spring alone."""
CONTACT_RATE = math.sqrt(1.5 * PAIR.k * math.sqrt(OVERLAP) / MASS)
"""Angular frequency [rad/s] of the normal contact at rest."""


def on_floor(
    models: Mapping[str, Any], pair: Mapping[str, float], along: float, roll: float, twist: float
) -> Scene:
    """A sphere at rest on a floor: velocity along x [m/s], angular velocities about y and about the normal
    [rad/s]."""
    group = {
        "material": "ball",
        "count": 1,
        "diameter": 2.0 * RADIUS,
        "velocity": [along, 0.0, 0.0],
        "angular_velocity": [0.0, roll, twist],
        "insert": {"kind": "positions", "positions": [[0.0, 0.0, RADIUS - OVERLAP]]},
    }
    floor = {"shape": "plane", "point": [0, 0, 0], "normal": [0, 0, 1], "material": "ball"}
    return Scene.from_dict(
        {
            "title": "Sphere on a floor",
            "gravity": [0.0, 0.0, -GRAVITY],
            "materials": {"ball": SOLID},
            "pairs": {"ball-ball": {"restitution": 1.0, "friction": FRICTION, **pair}},
            "particles": {"ball": group},
            "walls": {"floor": floor},
            "domain": {"min": [-1.0] * 3, "max": [1.0] * 3, "on_exit": "error"},
            "contact": {"normal": "hertz", "tangential": "mindlin", "rolling": "none", **models},
            "run": {"duration": 1.0, "velocity_max": SPEED, "precision": "f64"},
            "output": {"interval": 1.0},
        }
    )


def motion(scene: Scene, interval: float, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Times (n,) [s], velocities (n,) along x and angular velocities (n,) about the normal, and the time step
    [s].

    One sample every `interval` [s], rounded to whole steps.
    """
    simulation = Simulation(scene)
    every = max(round(interval / simulation.time_step), 1)
    rows = []
    for _ in range(count):
        simulation.step(every)
        state = simulation.snapshot().particles
        rows.append((simulation.time, float(state["velocity"][0, 0]), float(state["angular_velocity"][0, 2])))
    time_step = simulation.time_step
    simulation.free()
    time, along, twist = np.array(rows).T
    return time, along, twist, time_step


def modes_of(values: np.ndarray, interval: float, count: int) -> list[complex]:
    """Decay rates and angular frequencies, -g + i w [1/s], of the oscillations in values at equal intervals
    [s].

    Prony's method: each value is a linear combination of the 2 `count` values before it, whose characteristic
    roots are exp((-g +- i w) h). Slower oscillations come first.
    """
    order = 2 * count
    design = np.stack([values[order - 1 - n : len(values) - 1 - n] for n in range(order)], axis=1)
    weights = np.linalg.lstsq(design, values[order:], rcond=None)[0]
    rates = np.log(np.roots([1.0, *-weights]).astype(complex)) / interval
    return sorted((complex(each) for each in rates if each.imag > 0.0), key=lambda each: each.imag)


def coupled_modes(ratio: float) -> list[complex]:
    """Oscillations of the tangential and the rolling spring, -g + i w [1/s], the slower one first.

    ratio:  damping ratio of the dashpot of rolling, c = 2 ratio sqrt(I kr)
    """
    kr = TANGENTIAL * RADIUS**2
    stiffness = np.array(
        [[TANGENTIAL, -RADIUS * TANGENTIAL], [-RADIUS * TANGENTIAL, RADIUS**2 * TANGENTIAL + kr]]
    )
    inverse = np.diag([1.0 / MASS, 1.0 / INERTIA])
    damping = np.diag([0.0, 2.0 * ratio * math.sqrt(INERTIA * kr)])
    matrix = np.block([[np.zeros((2, 2)), np.eye(2)], [-inverse @ stiffness, -inverse @ damping]])
    rates = (complex(each) for each in np.linalg.eigvals(matrix))
    return sorted((each for each in rates if each.imag > 0.0), key=lambda each: each.imag)


def rolling_model_cases() -> list[ValidationCase]:
    """Deceleration of a rolling sphere for each rolling model, and the oscillation of both springs."""
    cases = []
    for name, (model, pair, source) in ROLLING_MODELS.items():
        scene = on_floor({"rolling": model}, pair, SPEED, SPEED / RADIUS, 0.0)
        time, along, _, _ = motion(scene, DURATION / SAMPLES, SAMPLES)
        late = time > 0.1 * DURATION
        is_viscous = name == "viscous"
        values = np.log(along[late] / SPEED) if is_viscous else along[late]
        slope = -float(np.polyfit(time[late], values, 1)[0])
        reference = 5.0 / 7.0 * GRAVITY * (DISSIPATION / RADIUS if is_viscous else ROLLING)
        cases.append(
            ValidationCase(
                "Rolling and twisting models",
                f"{name}: {'decay rate of the velocity' if is_viscous else 'deceleration'} of a rolling "
                "sphere",
                reference,
                source,
                slope,
                "1/s" if is_viscous else "m/s²",
                2.0 * OVERLAP / RADIUS + 6.0 / (SLIP_RATE * 0.9 * DURATION),
                "the overlap shortens the lever arm of both friction and load, and the tangential spring "
                "oscillates: 6 / (w t) of the slope of a line through t",
            )
        )
    return cases + [case for name in ("epsd", "sds") for case in spring_cases(name)]


def spring_cases(name: str) -> list[ValidationCase]:
    """Both oscillations of the tangential spring and that of a rolling model below its limit."""
    model, pair, source = ROLLING_MODELS[name]
    damped = name == "sds"
    expected = coupled_modes(RATIO if damped else 0.0)
    interval = 2.0 * math.pi / expected[-1].imag / PER_CYCLE
    scene = on_floor({"rolling": model}, pair, SLOW, 0.0, 0.0)
    _, along, _, time_step = motion(scene, interval, CYCLES * PER_CYCLE)
    found = modes_of(along, max(round(interval / time_step), 1) * time_step, 2)
    cases = []
    for number, (of, simulated) in enumerate(zip(expected, found, strict=True)):
        error = abs(of) * time_step
        rows = [("angular frequency", of.imag, simulated.imag, error**2 - of.real * time_step)]
        if damped:
            rows.append(("decay rate", -of.real, -simulated.real, error))
        cases += [
            ValidationCase(
                "Rolling and twisting models",
                f"{name}: {quantity} of the {('slower', 'faster')[number]} oscillation of a rolling sphere",
                reference,
                f"{source}; Wensrich & Katterfeld 2012, doi 10.1016/j.powtec.2011.09.057: kr = kt R^2, two "
                "coupled springs",
                value,
                "1/s",
                share + 2.0 * OVERLAP / RADIUS,
                "(w dt)^2, and g dt or w dt for the dashpot, which acts with the velocity at the half step; "
                "and the overlap shortens the lever arm",
            )
            for quantity, reference, value, share in rows
        ]
    return cases


def twisting_cases() -> list[ValidationCase]:
    """Sphere that spins about the normal: deceleration at the limit, and oscillation below it."""
    area_radius = math.sqrt(RADIUS * OVERLAP)
    torques = {
        "marshall": 2.0 / 3.0 * FRICTION * area_radius * MASS * GRAVITY,
        "torsion_spring": LENGTH * MASS * GRAVITY,
    }
    springs = {"marshall": 0.5 * TANGENTIAL * area_radius**2, "torsion_spring": TORSION}
    cases = []
    for name, (model, pair, source) in TWISTING_MODELS.items():
        deceleration = torques[name] / INERTIA
        spring = springs[name]
        frequency = math.sqrt(spring / INERTIA)
        decay = 0.0
        if name == "torsion_spring":
            decay = 0.5 * TORSION_DAMPING / INERTIA
            frequency = math.sqrt(frequency**2 - decay**2)
        spin = SPEED / RADIUS
        end = 0.8 * SPEED / RADIUS / deceleration
        time, _, twist, _ = motion(
            on_floor({"twisting": model}, pair, 0.0, 0.0, spin), end / SAMPLES, SAMPLES
        )
        late = time > 0.1 * end
        slope = -float(np.polyfit(time[late], twist[late], 1)[0])
        slow = 0.05 * deceleration / frequency
        period = 2.0 * math.pi / frequency
        scene = on_floor({"twisting": model}, pair, 0.0, 0.0, slow)
        _, _, twist, time_step = motion(scene, period / PER_CYCLE, CYCLES * PER_CYCLE)
        found = modes_of(twist, max(round(period / PER_CYCLE / time_step), 1) * time_step, 1)[0]
        error = (CONTACT_RATE * time_step) ** 2
        rows = [
            ("deceleration of a spinning sphere", deceleration, slope, error),
            ("angular frequency of a sphere that twists to and fro", frequency, found.imag, error),
        ]
        if decay > 0.0:
            rows.append(
                ("decay rate of a sphere that twists to and fro", decay, -found.real, frequency * time_step)
            )
        cases += [
            ValidationCase(
                "Rolling and twisting models",
                f"{name}: {quantity}",
                reference,
                source,
                value,
                "rad/s²" if quantity.startswith("deceleration") else "1/s",
                allowed,
                "(w dt)^2 with the frequency of the normal contact, or w dt for the dashpot, which acts with "
                "the velocity at the half step",
            )
            for quantity, reference, value, allowed in rows
        ]
    return cases
