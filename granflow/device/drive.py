"""Driven walls on the device: the forces of the grains on a wall, and where they move it.

    servo   v(t + dt/2) = gain [F - f(t)], at most velocity_max either way
    free    v(t + dt/2) = [(1 - a) v(t - dt/2) + dt/M (F - f(t))] / (1 + a),   a = c dt / 2M
    both    x(t + dt) = x(t) + dt v(t + dt/2)

with f the force of the wall on the grains along its direction, F what a servo holds, or the weight and the own
force of a free wall. As grains do in the leapfrog, a wall has its velocity half a step behind its place, and moves when
they do.
"""

from typing import Any

import numpy as np
import taichi as ti

from granflow.device.guards import GUARD_WALL
from granflow.device.state import State
from granflow.walls.motion import is_running

KEPT = ("offset", "offset_at_search", "velocity", "was_on", "push", "given", "work")
"""What of it goes into checkpoints."""


def build_enter_push(state: State) -> tuple[Any, Any]:
    """Device functions (chunk) and (chunk, wall, force on a grain): forget, and add up, the forces on driven walls."""
    drives, fields = state.plan.drives, state.drive

    @ti.func
    def forget_pushes(chunk):
        for r in ti.static(range(len(drives))):
            fields.push[chunk, r] = 0.0

    @ti.func
    def enter_push(chunk, w, force):
        for r in ti.static(range(len(drives))):
            if w == drives[r].wall:
                along = ti.cast(force, ti.f64).dot(ti.Vector(drives[r].direction, dt=ti.f64))
                fields.push[chunk, r] = fields.push[chunk, r] - along

    return forget_pushes, enter_push


def build_drive(state: State) -> Any:
    """Device function (chunks, pose, time_step): move all driven walls by one step, on one thread.

    Reads:   push, was_on, on
    Writes:  velocity, offset, was_on, given, work, search_wanted, guard
    """
    drives, fields, control = state.plan.drives, state.drive, state.control
    near, farthest = state.plan.wall_way, state.plan.wall_travel_limit

    @ti.func
    def velocity_of(r: ti.template(), pushed, dt):
        velocity = fields.velocity[r]
        if ti.static(drives[r].kind == "servo"):
            velocity = drives[r].gain * (drives[r].force + pushed)
            velocity = ti.max(ti.min(velocity, drives[r].velocity_max), -drives[r].velocity_max)
        else:
            kick = dt / drives[r].mass * (drives[r].force + pushed)
            if fields.was_on[r] == 0:
                kick = 0.5 * kick
            drag = 0.5 * drives[r].damping * dt / drives[r].mass
            velocity = ((1.0 - drag) * velocity + kick) / (1.0 + drag)
        return velocity

    @ti.func
    def enter_work(r: ti.template(), pushed, velocity, dt):
        """Of the wall on the grains, and of all else on a free wall, with the mean of the velocities: exact for it."""
        middle = 0.5 * (fields.velocity[r] + velocity)
        way = dt * middle
        if fields.was_on[r] == 0:
            way = 0.5 * way
        fields.given[r] = fields.given[r] - pushed * way
        if ti.static(drives[r].kind == "free"):
            fields.work[r] = fields.work[r] + (drives[r].force - drives[r].damping * middle) * way

    @ti.func
    def ways_of(wall: ti.template(), dt):
        """Largest distance since the search, and in this step [m]."""
        way, step_way = ti.cast(0.0, ti.f64), ti.cast(0.0, ti.f64)
        for r in ti.static(range(len(drives))):
            if ti.static(drives[r].wall == wall):
                way += ti.abs(fields.offset[r] - fields.offset_at_search[r])
                step_way += ti.abs(dt * fields.velocity[r])
        return way, step_way

    @ti.func
    def drive_walls(chunks, pose, dt_real):
        dt = ti.cast(dt_real, ti.f64)
        for r in ti.static(range(len(drives))):
            pushed, velocity = ti.cast(0.0, ti.f64), ti.cast(0.0, ti.f64)
            for chunk in range(chunks):
                pushed += fields.push[chunk, r]
            if fields.on[pose, r] == 1:
                velocity = velocity_of(r, pushed, dt)
                enter_work(r, pushed, velocity, dt)
            fields.velocity[r] = velocity
            fields.was_on[r] = fields.on[pose, r]
            fields.offset[r] = fields.offset[r] + dt * velocity
        for r in ti.static(range(len(drives))):
            way, step_way = ways_of(drives[r].wall, dt)
            if not way <= near:
                control.search_wanted[0] = 1
            if not step_way <= farthest:
                ti.atomic_max(control.guard[0], GUARD_WALL)

    return drive_walls


def build_displacement(state: State) -> tuple[Any, Any]:
    """Device functions (wall): displacement [m] and velocity [m/s] of a wall by its drives, zero without."""
    drives, fields, real = state.plan.drives, state.drive, state.backend.position_real

    def along_its_drives(values: Any) -> Any:
        @ti.func
        def total_of(w):
            total = ti.Vector.zero(real, 3)
            for r in ti.static(range(len(drives))):
                if w == drives[r].wall:
                    total += ti.cast(values[r] * ti.Vector(drives[r].direction, dt=ti.f64), real)
            return total

        return total_of

    return along_its_drives(fields.offset), along_its_drives(fields.velocity)


def upload_running(state: State, times: np.ndarray) -> None:
    """Say which drives run in the steps that end at each pose; `times` (WALL_BATCH,) [s] from the middle of the steps.

    A wall that is not there stands still.
    """
    if state.drive is None:
        return
    running = [
        is_running(state.wall_motions[drive.wall][drive.motion], times) & bool(state.walls.present[drive.wall])
        for drive in state.plan.drives
    ]
    state.drive.on.from_numpy(np.stack(running, axis=1).astype(np.int32))


def mark_search(state: State) -> None:
    """Count the way of driven walls from here."""
    if state.drive is not None:
        state.drive.offset_at_search.copy_from(state.drive.offset)


def driven_offsets(state: State) -> np.ndarray:
    """Displacement (walls, 3) [m] of every wall by its drives."""
    return _summed(state, "offset")


def driven_velocities(state: State) -> np.ndarray:
    """Velocity (walls, 3) [m/s] of every wall by its drives, half a step behind its place."""
    return _summed(state, "velocity")


def _summed(state: State, name: str) -> np.ndarray:
    found = np.zeros((len(state.plan.walls), 3))
    if state.drive is not None:
        values = getattr(state.drive, name).to_numpy()
        for drive, value in zip(state.plan.drives, values, strict=True):
            found[drive.wall] += value * np.array(drive.direction)
    return found


def drive_totals(state: State) -> dict[str, float]:
    """Travel [m] and velocity [m/s] of every driven wall along its direction; with the ledger what free walls hold."""
    if state.drive is None:
        return {}
    drives, (velocity, _given, work) = state.plan.drives, _brought_forward(state)
    offset = state.drive.offset.to_numpy()
    found: dict[str, float] = {}
    for r, drive in enumerate(drives):
        for quantity, values in (("wall_travel", offset), ("wall_velocity", velocity)):
            name = f"{quantity}.{drive.name}"
            found[name] = found.get(name, 0.0) + float(values[r])
    if state.plan.features.ledger:
        free = [r for r, drive in enumerate(drives) if drive.kind == "free"]
        found["free_wall_energy"] = sum(0.5 * drives[r].mass * float(velocity[r]) ** 2 for r in free)
        found["free_wall_work"] = float(work[free].sum())
    return found


def driven_work(state: State) -> float:
    """Work of all driven walls on the grains since the start [J]."""
    return 0.0 if state.drive is None else float(_brought_forward(state)[1].sum())


def _brought_forward(state: State) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Velocity [m/s], work on grains and own work [J] of every drive at the time of the places: half a step on."""
    fields, half = state.drive, 0.5 * state.clock.time_step
    late, given, work = (field.to_numpy() for field in (fields.velocity, fields.given, fields.work))
    pushed = fields.push.to_numpy()[: state.chunk_count].sum(axis=0)
    velocity = late.copy()
    for r in np.flatnonzero(fields.was_on.to_numpy()):
        drive = state.plan.drives[r]
        if drive.kind == "free":
            drag = 0.5 * drive.damping * half / drive.mass
            velocity[r] = ((1.0 - drag) * late[r] + half / drive.mass * (drive.force + pushed[r])) / (1.0 + drag)
        middle = 0.5 * (late[r] + velocity[r])
        given[r] -= half * middle * pushed[r]
        work[r] += half * middle * (drive.force - drive.damping * middle) * (drive.kind == "free")
    return velocity, given, work


def keep_drive(state: State) -> dict[str, np.ndarray]:
    """All that decides how driven walls go on, by name."""
    return {} if state.drive is None else {name: getattr(state.drive, name).to_numpy() for name in KEPT}


def put_drive_back(state: State, kept: dict[str, np.ndarray]) -> None:
    """Put what was kept back."""
    for name, values in kept.items():
        getattr(state.drive, name).from_numpy(values)
