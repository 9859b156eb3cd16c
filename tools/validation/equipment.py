"""Validation cases of process equipment: wear of walls, residence times, and motions of walls and gravity.

Except for impacts that erode, the scenes are shipped ones, whose numbers are compared with closed forms.
"""

import math

import numpy as np
from scipy.integrate import quad
from scipy.special import ellipk

from granflow import Scene, Simulation
from granflow.geometry.sphere import sphere_mass
from validation.case import ValidationCase, cases_of, shipped_scene

GRAVITY = 9.81
SOLID = {"young_modulus": 1e8, "poisson_ratio": 0.25, "density": 2500.0}
SLIDING, FRICTION, WEAR, HARDNESS = 0.5, 0.2, 1e-3, 1e9
"""Initial velocity [m/s] and friction of the sled of `sliding_wear`, wear coefficient, hardness [Pa]."""
ANGLES, EROSION, IMPACT_STEP = (10.0, 45.0), 0.1, 2e-7
"""Angles of impact [deg], below and above that of tan a = 1/3, at 1 m/s; coefficient; time step [s]."""
PASSAGES = {"fast": (1.0, 40), "slow": (0.5, 40)}
"""Velocity [m/s] and number of particles of both streams of `residence_time`, whose meters are 0.1 m apart."""
TURN_RATE, TURN_TIME, TURN_STEP = 100.0, 0.02, 2e-5
"""Angular velocity of gravity [rad/s], duration and time step [s] of `turning_gravity`."""


def wear_cases() -> list[ValidationCase]:
    """A sled that slides to rest on a wall (Archard), and impacts at two angles (Finnie)."""
    return [*_archard_cases(), *(_finnie_case(angle) for angle in ANGLES)]


def _archard_cases() -> list[ValidationCase]:
    """Friction takes the kinetic energy: the worn volume is k / H times this energy over the friction."""
    with Simulation(shipped_scene("verification/sliding_wear")) as simulation:
        start = simulation.snapshot()
        simulation.run()
        totals = simulation.snapshot().totals
    sled = start.particles["group"] == 0
    energy = 0.5 * float(start.particles["mass"][sled].sum()) * SLIDING**2
    # the sled falls onto its overlap at rest and rocks: its energy then is that of the normal work
    rocking = totals["wear_normal_work.bench"] / energy
    rows = (
        ("tangential work", energy, totals["wear_tangential_work.bench"], "J"),
        ("worn volume", WEAR / HARDNESS * energy / FRICTION, totals["wear_volume.bench"], "m3"),
    )
    return cases_of(
        "Wear of walls",
        "sled that slides to rest",
        "Archard 1953, doi 10.1063/1.1721448: V = k F s / H",
        rocking,
        "work of the normal forces over the kinetic energy: the sled rocks",
        rows,
    )


def _finnie_case(degrees: float) -> ValidationCase:
    """Impact of a sphere without friction: the force is the rate of the momentum m u toward the wall.

    V = 2 k m / H * integral of v f(a) du from 0 to the velocity of approach,     v^2 = u^2 + w^2,  tan a = u / w
    """
    angle = math.radians(degrees)
    approach, passing = math.sin(angle), math.cos(angle)
    radius = 5e-3

    def of_speed(u: float) -> float:
        a = math.atan2(u, passing)
        share = math.sin(2.0 * a) - 3.0 * math.sin(a) ** 2 if 3.0 * u <= passing else math.cos(a) ** 2 / 3.0
        return math.hypot(u, passing) * share

    integral, _ = quad(of_speed, 0.0, approach, points=[min(passing / 3.0, approach)])
    mass = sphere_mass(radius, SOLID["density"])
    modulus = SOLID["young_modulus"] / (2.0 * (1.0 - SOLID["poisson_ratio"] ** 2))
    stiffness = 4.0 / 3.0 * modulus * math.sqrt(radius)
    overlap = (1.25 * mass * approach**2 / stiffness) ** 0.4  # 2/5 k d^(5/2) = m u^2 / 2
    acceleration = stiffness * overlap**1.5 / mass
    floor = {"shape": "plane", "point": [0, 0, 0], "normal": [0, 0, 1], "material": "solid"}
    ball = {
        "material": "solid",
        "diameter": 2.0 * radius,
        "velocity": [passing, 0.0, -approach],
        "insert": {"kind": "positions", "positions": [[0.0, 0.0, radius + 1e-5]]},
    }
    scene = {
        "title": "Impact on a wall that wears",
        "gravity": [0, 0, 0],
        "materials": {"solid": SOLID},
        "pairs": {"solid-solid": {"restitution": 1.0, "friction": 0.0}},
        "particles": {"ball": ball},
        "walls": {"floor": floor | {"wear": {"law": "finnie", "coefficient": EROSION, "hardness": HARDNESS}}},
        "contact": {"normal": "hertz", "tangential": "none", "rolling": "none"},
        "domain": {"min": [-1.0] * 3, "max": [1.0] * 3, "on_exit": "error"},
        "run": {"duration": 2e-3, "velocity_max": 2.0, "time_step": IMPACT_STEP, "precision": "f64"},
        "output": {"interval": 1.0},
    }
    with Simulation(Scene.from_dict(scene)) as simulation:
        simulation.run()
        last = simulation.snapshot()
    assert last.particles["velocity"][0, 2] > 0.0
    return ValidationCase(
        kind="Wear of walls",
        name=f"impact at {degrees:g} deg: worn volume",
        reference=2.0 * EROSION / HARDNESS * float(mass) * integral,
        source="Finnie 1960, doi 10.1016/0043-1648(60)90055-7, Eqs. 8 and 9, integrated over the approach",
        value=last.totals["wear_volume.floor"],
        unit="m3",
        allowed=IMPACT_STEP * acceleration / approach,
        derivation="velocity that the wall takes in one step at the largest force, over that of the approach",
    )


def residence_cases() -> list[ValidationCase]:
    """Mean and deviation of two streams in plug flow."""
    with Simulation(shipped_scene("verification/residence_time")) as simulation:
        found = simulation.run().residence_time["out"]
    times = np.repeat(
        [0.1 / speed for speed, _ in PASSAGES.values()], [count for _, count in PASSAGES.values()]
    )
    rows = (
        ("number of particles", float(len(times)), found["residence_count"], "1"),
        ("mean", float(times.mean()), found["residence_mean"], "s"),
        ("standard deviation", float(times.std()), found["residence_deviation"], "s"),
        (
            "tanks in series",
            float((times.mean() / times.std()) ** 2),
            found["tanks_in_series"],
            "1",
        ),
    )
    return cases_of(
        "Residence times",
        "two streams in plug flow",
        "distance over velocity; moments of Danckwerts 1953, doi 10.1016/0009-2509(53)80001-1",
        1e-9,
        "rounding: the velocities are constant, and passages are interpolated between samples",
        rows,
    )


def equipment_motion_cases() -> list[ValidationCase]:
    """A chain of three motions, servos on the present section, gravity that turns, and a sphere that oscillates
    in a spherical wall."""
    return [*_chain_cases(), *_servo_cases(), *_gravity_cases(), _pendulum_case()]


def _servo_cases() -> list[ValidationCase]:
    """Overlaps d in `servo_section`: F = 4/3 E* sqrt(R) d^(3/2) = P L1 L2 with the distances L = D - 2 d."""
    diameter, gap, pressures = 0.01, 0.002, np.array([2e4, 3e4, 4e4])
    modulus = SOLID["young_modulus"] / (2.0 * (1.0 - SOLID["poisson_ratio"] ** 2))
    stiffness = 4.0 / 3.0 * modulus * math.sqrt(0.5 * diameter)
    expected = np.zeros(3)
    for _ in range(100):
        length = diameter - 2.0 * expected
        expected = (pressures * length.prod() / length / stiffness) ** (2.0 / 3.0)
    with Simulation(shipped_scene("verification/servo_section")) as simulation:
        simulation.run()
        totals = simulation.snapshot().totals
    walls = ("right", "back", "top")
    return [
        ValidationCase(
            kind="Motions of walls and gravity",
            name=f"servo, {1e-3 * pressure:g} kPa on the present section: overlap at the wall {wall}",
            reference=float(overlap),
            source="Hertz 1882, and the balance of forces",
            value=0.5 * (totals[f"wall_displacement.{wall}"] - gap),
            unit="m",
            allowed=1e-6,
            derivation="rounding of the forces, which are added on a grid",
        )
        for wall, pressure, overlap in zip(walls, pressures, expected, strict=True)
    ]


def _turned(axis: int, angle: float, point: np.ndarray) -> np.ndarray:
    """A point (3,) turned about an axis through the origin."""
    first, second = (axis + 1) % 3, (axis + 2) % 3
    found = point.copy()
    found[first] = math.cos(angle) * point[first] - math.sin(angle) * point[second]
    found[second] = math.sin(angle) * point[first] + math.cos(angle) * point[second]
    return found


def _chain_cases() -> list[ValidationCase]:
    """x = Rx(0.2 sin 2 pi t) Rz(6 t) (c + Rz(-10 t) (p - c)) at the end of `planetary_motion`."""
    with Simulation(shipped_scene("verification/planetary_motion")) as simulation:
        start = simulation.snapshot().particles["position"][0]
        simulation.run()
        last = simulation.snapshot()
    center = np.array([0.1, 0.0, 0.0])
    expected = center + _turned(2, -10.0 * last.time, start - center)
    expected = _turned(2, 6.0 * last.time, expected)
    expected = _turned(0, 0.2 * math.sin(2.0 * math.pi * last.time), expected)
    return cases_of(
        "Motions of walls and gravity",
        "point of a planetary wall on a frame that rocks",
        "kinematics of rigid bodies: product of three rotations",
        1e-9,
        "rounding: the pose is a closed form of the time",
        [
            (axis, each, x, "m")
            for axis, each, x in zip("xyz", expected, last.particles["position"][0], strict=True)
        ],
    )


def _gravity_cases() -> list[ValidationCase]:
    """Free particle from rest, with gravity that turns about y by the angle a = w t.

    v = -g/w (1 - cos a, 0, sin a),     x = -g/w (t - sin a / w, 0, (1 - cos a) / w)
    """
    with Simulation(shipped_scene("verification/turning_gravity")) as simulation:
        simulation.run()
        found = simulation.snapshot().particles
    w, angle = TURN_RATE, TURN_RATE * TURN_TIME
    velocity = -GRAVITY / w * np.array([1.0 - math.cos(angle), math.sin(angle)])
    fall = -GRAVITY / w * np.array([TURN_TIME - math.sin(angle) / w, (1.0 - math.cos(angle)) / w])
    rows = [
        (f"{quantity} {axis}", reference, value, unit)
        for quantity, references, values, unit in (
            ("velocity", velocity, found["velocity"][0, [0, 2]], "m/s"),
            ("position", fall, found["position"][0, [0, 2]], "m"),
        )
        for axis, reference, value in zip("xz", references, values, strict=True)
    ]
    return cases_of(
        "Motions of walls and gravity",
        f"free particle, gravity that turns by {angle:g} rad",
        "-g (sin w t, 0, cos w t), integrated",
        (TURN_RATE * TURN_STEP) ** 2,
        "(w dt)^2: the scheme is of second order",
        rows,
    )


def _pendulum_case() -> ValidationCase:
    """Half the period of a sphere in a spherical wall, 2 sqrt(L / g) K(sin(a / 2)), between two passages of the
    lowest point."""
    length, amplitude = 0.1, 0.1
    steps = 50
    rows = []
    with Simulation(shipped_scene("verification/spherical_bowl")) as simulation:
        while simulation.time < 0.47:
            simulation.step(steps)
            snapshot = simulation.snapshot()
            overlap = math.dist(snapshot.particles["position"][0], [0.0, 0.0, 0.102]) - length
            rows.append((simulation.time, snapshot.particles["position"][0, 0], overlap))
        simulation.run()
        last = simulation.snapshot()
    rows.append((last.time, last.particles["position"][0, 0], 0.0))
    time, x, overlap = np.array(rows).T
    before = np.flatnonzero(x[1:] * x[:-1] < 0.0)
    crossing = time[before] - x[before] * (time[before + 1] - time[before]) / (x[before + 1] - x[before])
    return ValidationCase(
        kind="Motions of walls and gravity",
        name="sphere in a spherical wall, amplitude 0.1 rad: half of the period",
        reference=2.0 * math.sqrt(length / GRAVITY) * float(ellipk(math.sin(0.5 * amplitude) ** 2)),
        source="mathematical pendulum, complete elliptic integral",
        value=float(crossing[1] - crossing[0]),
        unit="s",
        allowed=float(overlap.max()) / length,
        derivation="largest overlap with the wall over the length of the pendulum",
    )
