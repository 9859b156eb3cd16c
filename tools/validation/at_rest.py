"""Validation cases of contacts that last: reloading, damping at rest, stiffness of a bed, and static columns.

Zhou (2011) describes binary collisions. A contact that is compressed again follows its unloading curve up to
the largest overlap so far, then the Hertz curve (ours): F = min(k d^(3/2), unloading curve of dmax). Nothing
is imported from `granflow.contact`.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from granflow import Scene, Simulation
from validation.case import ValidationCase
from validation.rolling_models import modes_of
from validation.theory_of_collisions import Pair, Partner, zhou_tangent, zhou_unloading

GRAVITY, RADIUS = 9.81, 2e-3
SOLID = {"young_modulus": 1e7, "poisson_ratio": 0.25, "density": 2500.0}
"""Radius [m] and material of spheres and walls."""
FLOOR = Pair(Partner(SOLID, RADIUS), Partner(SOLID, math.inf))
TWO = Pair(Partner(SOLID, RADIUS), Partner(SOLID, RADIUS))
"""A sphere on a wall, and two spheres."""
MASS = FLOOR.mass
ZHOU_2011 = "Zhou 2011, doi 10.1063/2.1104106, Eqs. 4, 7 and 8"

HEAVY = SOLID | {"density": 1e13}
"""A sphere that does not move during a cyclic compression."""
CYCLES, DEEP, SWAY, PERIOD, STEPS = 4.5, 5e-5, 0.1, 0.02, 4000
"""Cycles, final overlap [m], amplitude over it, period [s] and time steps of the cyclic compression."""
CYCLIC_RESTITUTION = 0.5

RATIO, VISCOUS, NUDGE = 0.1, 0.05, 1e-3
"""Default of `rest_damping`, a `damping_ratio`, and relative excess of the initial overlap over that at
rest."""

BED, BED_RESTITUTIONS, STRAIN, RETREAT = 10, (0.3, 0.5, 0.8), 2e-3, 0.02
"""Spheres in a row, restitutions, compression over the length, and its decrease over the elastic recovery."""

PUSH = 0.2
"""Time [s] in which the plate moves."""

COLUMN, COLUMN_RESTITUTIONS = 50, (0.0, 0.05, 0.3, 1.0)
"""Spheres of a column, and restitutions."""
DRAG, BED_DRAG = 300.0, 100.0
"""Drag [1/s] while the column is let down, and while the row is compressed."""


def scene_of(
    contact: Mapping[str, Any],
    e: float,
    positions: Sequence[Sequence[float]],
    walls: Mapping[str, Any],
    run: Mapping[str, Any],
    gravity: float = 0.0,
    solid: Mapping[str, float] = SOLID,
    **blocks: Any,
) -> Scene:
    """Spheres at rest without friction, and walls of the same elastic constants."""
    group = {
        "material": "ball",
        "count": len(positions),
        "diameter": 2.0 * RADIUS,
        "insert": {"kind": "positions", "positions": [list(each) for each in positions]},
    }
    size = 2.0 * RADIUS * (len(positions) + 2)
    return Scene.from_dict(
        {
            "title": "Contacts that last",
            "gravity": [0.0, 0.0, -gravity],
            "materials": {"ball": dict(solid)},
            "pairs": {"ball-ball": {"restitution": e, "friction": 0.0}},
            "particles": {"balls": group},
            "contact": {"tangential": "none", "rolling": "none", **contact},
            "walls": dict(walls),
            "domain": {"min": [-size] * 3, "max": [size] * 3, "on_exit": "error"},
            "run": {"precision": "f64", **run},
            "output": {"interval": 1e3},
            **blocks,
        }
    )


def plane(z: float, up: float, motion: Any = None) -> dict[str, Any]:
    """Wall at a height [m] with the normal +z or -z."""
    wall = {"shape": "plane", "point": [0.0, 0.0, z], "normal": [0.0, 0.0, up], "material": "ball"}
    return wall | ({} if motion is None else {"motion": motion})


def reloading_cases() -> list[ValidationCase]:
    """A plate that presses a sphere deeper and deeper, to and fro: force and work of each cycle."""
    end = CYCLES * PERIOD
    motion = [
        {"kind": "translation", "velocity": [0.0, 0.0, -DEEP / end]},
        {
            "kind": "vibration",
            "direction": [0.0, 0.0, 1.0],
            "amplitude": SWAY * DEEP,
            "frequency": 1.0 / PERIOD,
            "phase": 0.5 * math.pi,
        },
    ]
    scene = scene_of(
        {"normal": {"law": "zhou", "rest_damping": 0.0}},
        CYCLIC_RESTITUTION,
        [[0.0, 0.0, 0.0]],
        {"plate": plane(RADIUS, -1.0, motion)},
        {"duration": end, "time_step": end / STEPS, "velocity_max": 0.1},
        solid=HEAVY,
    )
    simulation = Simulation(scene)
    rows = []
    for _ in range(STEPS - 1):
        simulation.step(1)
        state = simulation.snapshot().particles
        rows.append((simulation.time, float(state["position"][0, 2]), -float(state["force"][0, 2])))
    simulation.free()
    time, z, found = np.array(rows).T
    overlap = DEEP * time / end + SWAY * DEEP * (1.0 - np.cos(2.0 * math.pi * time / PERIOD)) + z
    expected = np.zeros(len(time))
    largest = 0.0
    for n, d in enumerate(overlap):
        largest = max(largest, d)
        if d > 0.0:
            curve = zhou_unloading(FLOOR.k, CYCLIC_RESTITUTION, largest, d)
            expected[n] = min(FLOOR.k * d**1.5, max(curve, 0.0))
    step = 2.0 * math.pi * (end / STEPS) / PERIOD
    change = np.diff(overlap)
    works = [float(np.sum(0.5 * (force[1:] + force[:-1]) * change)) for force in (expected, found)]
    reason = "(w dt)^2 times the slope of unloading over that of loading"
    allowed = step**2 * zhou_tangent(CYCLIC_RESTITUTION)
    return [
        ValidationCase(
            "Contacts that last",
            "reloading: largest difference of the force over the largest force",
            0.0,
            f"{ZHOU_2011}, reloading along the unloading curve",
            float(np.max(np.abs(found - expected)) / expected.max()),
            "1",
            allowed,
            reason,
            scale=1.0,
        ),
        ValidationCase(
            "Contacts that last",
            f"reloading: work of the plate in {CYCLES:g} cycles",
            works[0],
            f"{ZHOU_2011}, reloading along the unloading curve",
            works[1],
            "J",
            allowed,
            reason,
        ),
    ]


def resting_cases() -> list[ValidationCase]:
    """Oscillations of a sphere on a floor: `rest_damping`, which acts on approach only, and
    `damping_ratio`."""
    at_rest = (MASS * GRAVITY / FLOOR.k) ** (2.0 / 3.0)
    tangent = 1.5 * FLOOR.k * math.sqrt(at_rest)
    cases = []
    for e, options in ((0.5, {}), (1.0, {"damping_ratio": VISCOUS})):
        start = (1.0 + NUDGE) * at_rest
        scene = scene_of(
            {"normal": {"law": "zhou", **options}},
            e,
            [[0.0, 0.0, RADIUS - start]],
            {"floor": plane(0.0, 1.0)},
            {"duration": 1.0, "velocity_max": 0.1},
            GRAVITY,
            numerics={"time_step_fraction": 0.01},
        )
        frequency = math.sqrt(tangent * zhou_tangent(e) / MASS)
        simulation = Simulation(scene)
        every = max(round(2.0 * math.pi / frequency / 200 / simulation.time_step), 1)
        velocity = []
        for _ in range(1200):
            simulation.step(every)
            velocity.append(float(simulation.snapshot().particles["velocity"][0, 2]))
        time_step = simulation.time_step
        simulation.free()
        values = np.array(velocity)
        error = frequency * time_step
        if options:
            found = modes_of(values[::4], 4 * every * time_step, 1)[0]
            cases.append(
                _rest_case(
                    "damping_ratio: decay rate over the angular frequency, both of the damped sphere",
                    VISCOUS / math.sqrt(1.0 - VISCOUS**2),
                    -found.real / found.imag,
                    error + NUDGE,
                    "w dt, since the damping acts with the velocity at the half step, and the amplitude over "
                    "the overlap",
                    "contact_models/zhou.md: damping ratio with the Hertz tangent",
                )
            )
            continue
        tops = [n for n in range(1, len(values) - 1) if values[n - 1] < values[n] >= values[n + 1]]
        heights = [
            values[n]
            + 0.125 * (values[n + 1] - values[n - 1]) ** 2 / (2.0 * values[n] - values[n + 1] - values[n - 1])
            for n in tops
        ]
        decrement = -float(np.polyfit(np.arange(len(heights)), np.log(heights), 1)[0])
        cases.append(
            _rest_case(
                "rest_damping: logarithmic decrement of the velocity per oscillation",
                math.pi * RATIO / math.sqrt(1.0 - RATIO**2),
                decrement,
                error + NUDGE,
                "w dt, since the damping acts with the velocity at the half step, and the amplitude over the "
                "overlap",
                "contact_models/zhou.md: damping ratio 0.1 with the unloading tangent, in the half of each "
                "oscillation in which the sphere approaches",
            )
        )
    return cases


def _rest_case(
    name: str, reference: float, value: float, allowed: float, reason: str, source: str
) -> ValidationCase:
    """A case of `resting_cases`."""
    return ValidationCase("Contacts that last", name, reference, source, value, "1", allowed, reason)


def bed_cases() -> list[ValidationCase]:
    """A row of spheres between plates: force of the first compression, and stiffness when it decreases."""
    length = 2.0 * RADIUS * BED
    cases = []
    for e in BED_RESTITUTIONS:
        depth = STRAIN * length
        force = _force_of_row(depth)
        overlaps = [(force / pair.k) ** (2.0 / 3.0) for pair in (FLOOR, TWO)]
        stiffness = [
            1.5 * pair.k * math.sqrt(d) * zhou_tangent(e)
            for pair, d in zip((FLOOR, TWO), overlaps, strict=True)
        ]
        series = 1.0 / (2.0 / stiffness[0] + (BED - 1) / stiffness[1])
        back = RETREAT * force / series
        motion = [_smooth_step(-depth, 0.0), _smooth_step(back, 0.25)]
        scene = scene_of(
            {"normal": "zhou"},
            e,
            [[0.0, 0.0, (2 * n + 1) * RADIUS] for n in range(BED)],
            {"floor": plane(0.0, 1.0), "lid": plane(length, -1.0, motion)},
            {"duration": 1.0, "velocity_max": 0.1},
            damping={"drag": BED_DRAG},
        )
        simulation = Simulation(scene)
        forces = []
        for until in (0.25, 0.5):
            simulation.step(round((until - simulation.time) / simulation.time_step))
            contacts = simulation.snapshot(contacts=True).contacts
            assert contacts is not None
            forces.append(float(contacts["normal_force"][contacts["wall"] == 0][0]))
        simulation.free()
        mass = 0.5 * BED * MASS
        excess = mass * (BED_DRAG * 2.0 * depth / PUSH + 2.0 * math.pi * depth / PUSH**2) / force
        reason = f"drag and inertia of the spheres while the plate moves, {100 * excess:.2g} % of the force"
        rows = (
            ("force of the first compression", force, forces[0], "N", excess, reason),
            (
                "stiffness when the plate retreats",
                series,
                (forces[0] - forces[1]) / back,
                "N/m",
                RETREAT + excess / 3.0,
                f"{reason}, a third of which is that of the tangent; decrease of the force by "
                f"{100 * RETREAT:g} %",
            ),
        )
        cases += [
            ValidationCase(
                "Contacts that last",
                f"row of {BED} spheres, e = {e:g}: {name}",
                reference,
                f"{ZHOU_2011}, {BED + 1} contacts in series",
                value,
                unit,
                allowed,
                reason,
            )
            for name, reference, value, unit, allowed, reason in rows
        ]
    return cases


def _force_of_row(depth: float) -> float:
    """Force [N] of the row compressed by a depth [m]: 2 contacts with plates and BED - 1 between spheres."""
    # depth = F^(2/3) (2 k1^(-2/3) + (n - 1) k2^(-2/3))
    return float((depth / (2.0 * FLOOR.k ** (-2.0 / 3.0) + (BED - 1) * TWO.k ** (-2.0 / 3.0))) ** 1.5)


def _smooth_step(distance: float, start: float) -> dict[str, Any]:
    """Motion of a plate by a distance [m] from a time [s] on, within PUSH and without a jump of the
    velocity."""
    times = np.linspace(0.0, PUSH, 101)
    share = times / PUSH
    displacement = distance * (share - np.sin(2.0 * math.pi * share) / (2.0 * math.pi))
    return {
        "kind": "table",
        "start": start,
        "direction": [0.0, 0.0, 1.0],
        "times": times.tolist(),
        "displacements": displacement.tolist(),
    }


def column_cases() -> list[ValidationCase]:
    """Column of COLUMN spheres that is let down: overlap with the floor, and settlement of the uppermost
    sphere."""
    weight = MASS * GRAVITY * np.arange(COLUMN, 0, -1)
    stiffness = 1.5 * TWO.k ** (2.0 / 3.0) * (0.5 * COLUMN * MASS * GRAVITY) ** (1.0 / 3.0)
    slowest = math.pi / (2.0 * COLUMN) * math.sqrt(stiffness / MASS)
    ratio = DRAG / (6.0 * slowest)  # of the second mode, whose frequency is three times the lowest
    overshoot = math.exp(-math.pi * ratio / math.sqrt(1.0 - ratio**2)) / 27.0
    overlaps = (weight / np.r_[FLOOR.k, np.full(COLUMN - 1, TWO.k)]) ** (2.0 / 3.0)
    cases = []
    for e in COLUMN_RESTITUTIONS:
        scene = scene_of(
            {"normal": "zhou"},
            e,
            [[0.0, 0.0, (2 * n + 1) * RADIUS] for n in range(COLUMN)],
            {"floor": plane(0.0, 1.0)},
            {"duration": 0.6, "velocity_max": 0.3},
            GRAVITY,
            damping={"drag": DRAG},
        )
        simulation = Simulation(scene)
        simulation.run()
        z = np.sort(simulation.snapshot().particles["position"][:, 2])
        simulation.free()
        rows = (
            ("overlap with the floor", float(overlaps[0]), RADIUS - float(z[0])),
            (
                "settlement of the uppermost sphere",
                float(overlaps.sum()),
                (2 * COLUMN - 1) * RADIUS - float(z[-1]),
            ),
        )
        cases += [
            ValidationCase(
                "Contacts that last",
                f"column of {COLUMN} spheres, e = {e:g}: {name}",
                reference,
                "Hertz 1882: k d^(3/2) carries the weight above",
                value,
                "m",
                overshoot,
                "overshoot of the second mode, exp(-pi D / sqrt(1 - D^2)) with the damping ratio D of the "
                "drag, times its share 1/27 of the settlement; the slowest mode has D > 1",
            )
            for name, reference, value in rows
        ]
    return cases
