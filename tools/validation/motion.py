"""Validation cases of particles on planes: sliding, rolling and bouncing, against closed forms of rigid
spheres.

MFiX verification manual: Garg et al. 2012, doi 10.1016/j.powtec.2011.09.019.
"""

import math
from collections.abc import Mapping
from itertools import combinations_with_replacement
from typing import Any

import numpy as np

from granflow import Scene, Simulation
from granflow.contact import theory
from granflow.contact.material import modulus_eff
from granflow.geometry.sphere import sphere_mass, sphere_volume
from granflow.scene.blocks.materials import Material
from validation.case import ValidationCase, shipped_scene

GRAVITY = 9.81
RADIUS, SOLID = 5e-4, {"young_modulus": 1e7, "poisson_ratio": 0.3, "density": 1e4}
"""Radius [m] and material of the sliding and rolling spheres."""
SPEED, FRICTIONS = 0.1, (0.2, 0.5, 1.0)
"""Initial velocity [m/s] and friction of spheres that slide, then roll."""
ANGLE, SLOPE_FRICTIONS, SLOPE_TIME = math.radians(30.0), (0.1, 0.15, 0.3, 0.6), 0.05
"""Slope [rad] of an incline, friction of its spheres, and duration [s]; slip begins at tan a = 3.5 mu."""
AFTER_SLIP = 1.05
"""Start of the mean velocity of rolling over the time at which slip ends."""
SETTLED = 0.5
"""Share of the duration on the incline after which the acceleration is measured."""
ROLLING_ERROR = 2e-3
"""Allowed deviation of slip and rolling: overlap over radius, 1e-3, changes the lever arm, twice with the
radius."""
STIFF = {"young_modulus": 1e12, "poisson_ratio": 0.3, "density": 2600.0}
BOUNCE_RADIUS, DROP, BOUNCE_RESTITUTION = 0.1, 0.4, 0.9
"""Material, radius [m], fall height [m] and restitution of the bouncing particle of the MFiX manual."""
MFIX = "MFiX verification manual, Garg et al. 2012, doi 10.1016/j.powtec.2011.09.019"
LEVER_ARM = "the overlap, 0.1 % of the radius, shortens the lever arm"
"""Reason of ROLLING_ERROR."""
STACK_STIFFNESS, STACK_RADIUS, STACK_DENSITIES = 1000.0, 5e-4, np.array([2e4, 1e4])
STACK_START, STACK_HEIGHT = np.array([4.5e-4, 1.35e-3]), 1.8e-3
"""Stiffness [N/m], radius, densities, initial heights, and distance of the plates [m] of `mfix_stack`."""


def motion_cases() -> list[ValidationCase]:
    """Bouncing particle, compressed stack, transition from sliding to rolling, and spheres on an incline."""
    return bouncing_cases() + stack_cases() + rolling_cases() + incline_cases()


def resting_overlap(acceleration: float) -> float:
    """Overlap [m] at which a Hertz contact with a floor of the same material balances the weight of a
    sphere."""
    mass = sphere_mass(RADIUS, SOLID["density"])
    return float((mass * acceleration / floor_stiffness(SOLID, RADIUS)) ** (2.0 / 3.0))


def floor_stiffness(solid: Mapping[str, float], radius: float) -> float:
    """Hertz stiffness [N/m^1.5] of a sphere of this radius [m] on a floor of the same material."""
    return float(theory.hertz_stiffness(modulus_eff(Material(**solid), Material(**solid)), radius))


def spheres_on_floor(
    frictions: tuple[float, ...], velocity: float, gravity: tuple[float, ...], end: float
) -> Scene:
    """Spheres on a floor in a row along y, one material for each friction; `gravity` [m/s2], `end` [s]."""
    names = [f"sphere_{number}" for number in range(len(frictions))]
    height = RADIUS - resting_overlap(-gravity[2])
    of_floor = {
        f"{name}-floor": {"restitution": 0.5, "friction": mu}
        for name, mu in zip(names, frictions, strict=True)
    }
    frictionless = {
        f"{a}-{b}": {"restitution": 0.5, "friction": 0.0} for a, b in combinations_with_replacement(names, 2)
    }
    groups = {
        name: group(name, RADIUS, [0.0, 0.005 * number, height], [velocity, 0.0, 0.0])
        for number, name in enumerate(names)
    }
    return scene(dict.fromkeys([*names, "floor"], SOLID), frictionless | of_floor, groups, gravity, end, 0.2)


def group(material: str, radius: float, position: list[float], velocity: list[float]) -> dict[str, Any]:
    """Group of one particle as a block of a scene, in SI units."""
    return {
        "material": material,
        "count": 1,
        "diameter": 2.0 * radius,
        "velocity": velocity,
        "insert": {"kind": "positions", "positions": [position]},
    }


def scene(
    materials: Mapping[str, Any],
    pairs: Mapping[str, Any],
    groups: Mapping[str, Any],
    gravity: tuple[float, ...],
    end: float,
    velocity_max: float,
) -> Scene:
    """Scene of particles above a floor at z = 0 of the material `floor`, with Zhou's model and Mindlin
    friction."""
    floor = {"shape": "plane", "point": [0, 0, 0], "normal": [0, 0, 1], "material": "floor"}
    return Scene.from_dict(
        {
            "title": "Validation",
            "gravity": list(gravity),
            "materials": dict(materials),
            "pairs": dict(pairs),
            "particles": dict(groups),
            "walls": {"floor": floor},
            "contact": {"normal": "zhou", "tangential": "mindlin", "rolling": "none"},
            "domain": {"min": [-1.0] * 3, "max": [1.0] * 3, "on_exit": "error"},
            "run": {"duration": end, "velocity_max": velocity_max, "precision": "f64"},
            "output": {"interval": end},
        }
    )


def states(given: Scene, times: np.ndarray) -> dict[str, np.ndarray]:
    """Positions, velocities and angular velocities (times, n, 3) of a run near `times`, and the exact `time`
    [s]."""
    simulation = Simulation(given)
    found = []
    for time in times:
        simulation.step(max(round((time - simulation.time) / simulation.time_step), 1))
        found.append((simulation.time, simulation.snapshot().particles))
    simulation.free()
    names = ("position", "velocity", "angular_velocity")
    columns = {name: np.array([each[name] for _, each in found]) for name in names}
    return columns | {"time": np.array([time for time, _ in found])}


def rolling_cases() -> list[ValidationCase]:
    """Sliding spheres on a floor: velocity of rolling 5/7 u0, and time of slip 2/7 u0/(mu g)."""
    end = 2.6 / 7.0 * SPEED / (FRICTIONS[0] * GRAVITY)
    found = states(
        spheres_on_floor(FRICTIONS, SPEED, (0.0, 0.0, -GRAVITY), end), np.linspace(0.0, 0.999 * end, 400)
    )
    velocity = found["velocity"][:, :, 0]
    rotation = RADIUS * found["angular_velocity"][:, :, 1]
    slip = velocity - rotation
    cases = []
    for number, mu in enumerate(FRICTIONS):
        sliding = slip[:, number] > 0.2 * SPEED
        line = np.polyfit(found["time"][sliding], slip[sliding, number], 1)
        rolls = found["time"] > AFTER_SLIP * 2.0 / 7.0 * SPEED / (mu * GRAVITY)
        mean = float(velocity[rolls, number].mean())
        for name, reference, value in (
            ("mean velocity of rolling over the initial velocity", 5.0 / 7.0, mean / SPEED),
            ("time of slip, mu g t / u0", 2.0 / 7.0, float(-line[1] / line[0]) * mu * GRAVITY / SPEED),
        ):
            cases.append(
                ValidationCase(
                    "Sliding and rolling",
                    f"mu = {mu:g}: {name}",
                    reference,
                    MFIX,
                    value,
                    "1",
                    ROLLING_ERROR,
                    LEVER_ARM,
                    remark=(
                        "The tangential spring is not damped: the velocity oscillates; its mean is compared."
                    ),
                )
            )
    return cases


def incline_cases() -> list[ValidationCase]:
    """Spheres released on an incline: acceleration 5/7 g sin a without slip, g (sin a - mu cos a) with
    slip."""
    gravity = (GRAVITY * math.sin(ANGLE), 0.0, -GRAVITY * math.cos(ANGLE))
    times = np.linspace(0.0, 0.999 * SLOPE_TIME, 200)
    found = states(spheres_on_floor(SLOPE_FRICTIONS, 0.0, gravity, SLOPE_TIME), times)
    late = found["time"] > SETTLED * SLOPE_TIME
    cases = []
    for number, mu in enumerate(SLOPE_FRICTIONS):
        slips = math.tan(ANGLE) > 3.5 * mu
        rolling = 5.0 / 7.0 * gravity[0]
        sliding = gravity[0] + mu * gravity[2]
        value = float(np.polyfit(found["time"][late], found["velocity"][late, number, 0], 1)[0])
        cases.append(
            ValidationCase(
                "Sliding and rolling",
                f"incline of 30 degrees, mu = {mu:g}: acceleration, {'sliding' if slips else 'rolling'}",
                sliding if slips else rolling,
                "momentum balance: 5/7 g sin a, or g (sin a - mu cos a) for tan a > 7/2 mu",
                value,
                "m/s²",
                ROLLING_ERROR,
                LEVER_ARM,
            )
        )
    return cases


def bouncing_cases() -> list[ValidationCase]:
    """Particle that falls by DROP onto a floor: heights of the apex after each of five bounces, H e^(2n)."""
    pair = {"restitution": BOUNCE_RESTITUTION, "friction": 0.0}
    names = ("ball", "floor")
    pairs = dict.fromkeys(("ball-ball", "ball-floor"), pair)
    groups = {"ball": group("ball", BOUNCE_RADIUS, [0.0, 0.0, DROP + BOUNCE_RADIUS], [0.0, 0.0, 0.0])}
    speed = math.sqrt(2.0 * GRAVITY * DROP)
    given = scene(dict.fromkeys(names, STIFF), pairs, groups, (0.0, 0.0, -GRAVITY), 2.4, 1.05 * speed)
    found = states(given, np.linspace(0.0, 2.3, 240))
    z = found["position"][:, 0, 2]
    velocity = found["velocity"][:, 0, 2]
    flying = z > BOUNCE_RADIUS
    apex = (z - BOUNCE_RADIUS + velocity**2 / (2.0 * GRAVITY))[flying]
    bounces = np.cumsum(np.diff(apex, prepend=apex[0]) < -0.01)
    mass = sphere_mass(BOUNCE_RADIUS, STIFF["density"])
    overlap = float(theory.overlap_max(floor_stiffness(STIFF, BOUNCE_RADIUS), mass, speed))
    return [
        ValidationCase(
            "Bouncing particle",
            f"height of the apex after {n} bounces",
            DROP * BOUNCE_RESTITUTION ** (2 * n),
            f"hard sphere, h e^(2n); {MFIX}",
            float(np.mean(apex[bounces == n])) if np.any(bounces == n) else math.nan,
            "m",
            n * overlap / DROP,
            f"each bounce may change the height by the maximum overlap, {1e3 * overlap:.2g} mm",
            scale=DROP,
            remark="The reference is a hard sphere; here a contact has a finite overlap.",
        )
        for n in range(1, 6)
    ]


def stack_motion(time: float) -> tuple[np.ndarray, float]:
    """Heights (2,) [m] of two stacked spheres between plates, which start at rest, and the higher frequency
    [rad/s].

    m1 z1'' = k (R - z1) - k (2 R - z2 + z1) - m1 g,   m2 z2'' = k (2 R - z2 + z1) - k (z2 + R - H) - m2 g
    """
    mass = STACK_DENSITIES * sphere_volume(STACK_RADIUS)
    coupling = STACK_STIFFNESS * np.array([[2.0, -1.0], [-1.0, 2.0]])
    load = STACK_STIFFNESS * np.array([-STACK_RADIUS, STACK_HEIGHT + STACK_RADIUS]) - mass * GRAVITY
    rest = np.linalg.solve(coupling, load)
    root = np.sqrt(mass)
    squares, modes = np.linalg.eigh(coupling / np.outer(root, root))
    frequency = np.sqrt(squares)
    amplitude = modes.T @ (root * (STACK_START - rest))
    return rest + modes @ (amplitude * np.cos(frequency * time)) / root, float(frequency.max())


def stack_cases() -> list[ValidationCase]:
    """A light sphere on a heavy one, compressed between plates: heights after 1 ms, about three
    oscillations."""
    simulation = Simulation(shipped_scene("verification/mfix_stack"))
    simulation.run()
    time = simulation.time
    step = simulation.time_step
    found = simulation.snapshot().particles["position"][:, 2]
    simulation.free()
    heights, frequency = stack_motion(time)
    overlap = STACK_RADIUS - float(STACK_START[0])
    return [
        ValidationCase(
            "Two stacked spheres",
            f"height of the {name} sphere after 1 ms",
            float(height),
            f"two eigenmodes; {MFIX}",
            float(value),
            "m",
            (frequency * step) ** 2 * frequency * time,
            "phase error of the time step, (w dt)^2 w t, relative to the initial overlap with a plate",
            scale=overlap,
        )
        for name, height, value in zip(("lower", "upper"), heights, np.sort(found), strict=True)
    ]
