"""Where the partner of a particle stands: in a periodic box, its image that is nearest.

Positions are brought into the box at a search only; in between they may stand out of it by less than the skin. In a
sheared box the image above moves along with its offset and its speed, the one below the other way; both are looked up
by pose, as where walls stand.
"""

from typing import Any

import numpy as np
import taichi as ti

from granflow.device.state import WALL_BATCH, State
from granflow.scene.border import Border


def _sheared_axes(border: Border) -> tuple[int, int]:
    """Axes of velocity and gradient; of a box without shear, any."""
    return (0, 0) if border.shear is None else (border.shear.along, border.shear.across)


def build_turn(state: State) -> Any:
    """Device function (one, other): 1 where the other's image above is the nearest to the one, -1 the one below, or 0.

    Of a sheared box, along the axis of its gradient.
    """
    real, border = state.backend.position_real, state.plan.border
    _, across = _sheared_axes(border)
    half = 0.5 * float(border.width[across])

    @ti.func
    def turn(one, other):
        between = one[across] - other[across]
        return ti.cast(between > real(half), ti.i32) - ti.cast(between < -real(half), ti.i32)

    return turn


def build_apart(state: State) -> Any:
    """Device function (one, other, pose): vector [m] from the other point to the first, in its nearest image.

    Points that change places give exactly the opposite. Without periodic axes it is the difference and nothing else.
    """
    real, border = state.backend.position_real, state.plan.border
    widths, sheared = [float(width) for width in border.width], border.shear is not None
    along, _ = _sheared_axes(border)
    turn, offset = build_turn(state) if sheared else None, state.control.border_offset

    @ti.func
    def apart(one, other, pose):
        between = one - other
        if ti.static(sheared):
            between[along] = between[along] - ti.cast(turn(one, other), real) * offset[pose]
            between[along] = between[along] - real(widths[along]) * ti.round(between[along] / real(widths[along]))
        for axis in ti.static([axis for axis in border.axes if not sheared or axis != along]):
            width, half = real(widths[axis]), real(0.5 * widths[axis])
            above = ti.select(between[axis] > half, width, 0.0 * width)
            below = ti.select(between[axis] < -half, width, 0.0 * width)
            between[axis] = between[axis] - above + below
        return between

    return apart


def build_seen_from(state: State) -> Any:
    """Device function (point, turn, pose): where the box has the point [m] that is so many images above it."""
    real, border, offset = state.backend.position_real, state.plan.border, state.control.border_offset
    sheared = border.shear is not None
    along, across = _sheared_axes(border)
    height = float(border.width[across])

    @ti.func
    def seen_from(point, turn, pose):
        found = point
        if ti.static(sheared):
            turns = ti.cast(turn, real)
            found[along] = found[along] - turns * offset[pose]
            found[across] = found[across] - turns * real(height)
        return found

    return seen_from


def build_drift(state: State) -> Any:
    """Device function (i, j, pose): velocity [m/s] of the image of j nearest to i, over that of j itself.

    Only in a sheared box is there any.
    """
    real, position, border = state.backend.real, state.particles.position, state.plan.border
    sheared, speed = border.shear is not None, state.control.border_speed
    along, _ = _sheared_axes(border)
    turn = build_turn(state) if sheared else None

    @ti.func
    def drift(i, j, pose):
        velocity = ti.Vector.zero(real, 3)
        if ti.static(sheared):
            velocity[along] = ti.cast(turn(position[i], position[j]), real) * speed[pose]
        return velocity

    return drift


def build_inside(state: State) -> Any:
    """Device function (point): the image of the point [m] that stands in a box that is not sheared."""
    real, border = state.backend.position_real, state.plan.border
    lows, widths = [float(low) for low in border.low], [float(width) for width in border.width]

    @ti.func
    def inside(point):
        found = point
        for axis in ti.static(border.axes):
            width = real(widths[axis])
            found[axis] = point[axis] - width * ti.floor((point[axis] - real(lows[axis])) / width)
        return found

    return inside


def build_wrap(state: State) -> Any:
    """Kernel (count, pose, time_step): bring every particle into the box; what it gains by that is work of the border.

    Reads:   position, velocity, mass, force
    Writes:  position, velocity, velocity_now, border_work
    """
    plan, particles, real = state.plan, state.particles, state.backend.real
    border_work: Any = state.control.border_work
    inside, stride, chunk_size = build_inside(state), state.stride, plan.chunk_size
    gravity, sheared = [float(g) for g in plan.gravity], plan.border.shear is not None
    step_over = _build_step_over(state) if sheared else None

    @ti.func
    def enter_gain(chunk, i, shift, slower, dt):
        """Potential energy, and kinetic energy at the time of the positions, by the forces of the step before."""
        mass = ti.cast(particles.mass[i], ti.f64)
        gained = -mass * ti.Vector(gravity, dt=ti.f64).dot(ti.cast(shift, ti.f64))
        if ti.static(sheared):
            now = ti.cast(particles.velocity[i] + 0.5 * dt / particles.mass[i] * particles.force[i], ti.f64)
            change = ti.cast(slower, ti.f64)
            gained += mass * (0.5 * change.dot(change) - now.dot(change))
        border_work[chunk] = border_work[chunk] + gained

    @ti.kernel
    def wrap(count: ti.i32, pose: ti.i32, dt: real):
        for task in range((count + chunk_size - 1) // chunk_size * stride):
            if task % stride == 0:
                chunk = task // stride
                for i in range(chunk * chunk_size, ti.min((chunk + 1) * chunk_size, count)):
                    before = particles.position[i]
                    slower = 0.0 * particles.velocity[i]
                    found = before
                    if ti.static(sheared):
                        found, slower = step_over(before, pose)
                    found = inside(found)
                    particles.position[i] = found
                    if ti.static(plan.features.ledger):
                        enter_gain(chunk, i, found - before, slower, dt)
                    if ti.static(sheared):
                        particles.velocity[i] = particles.velocity[i] - slower
                        if ti.static(plan.features.rate_dependent):
                            particles.velocity_now[i] = particles.velocity_now[i] - slower

    return wrap


def _build_step_over(state: State) -> Any:
    """Device function (point, pose): where the point comes in through the sheared faces, and how much slower [m/s]."""
    real, position_real, border, control = (
        state.backend.real,
        state.backend.position_real,
        state.plan.border,
        state.control,
    )
    along, across = _sheared_axes(border)
    low, width = float(border.low[across]), float(border.width[across])

    @ti.func
    def step_over(point, pose):
        turns = ti.floor((point[across] - position_real(low)) / position_real(width))
        found, slower = point, ti.Vector.zero(real, 3)
        found[across] = point[across] - position_real(width) * turns
        found[along] = point[along] - turns * control.border_offset[pose]
        slower[along] = ti.cast(turns, real) * control.border_speed[pose]
        return found, slower

    return step_over


def upload_offsets(state: State, step: int) -> None:
    """Put offset and speed of the images after WALL_BATCH steps from number `step` on the device.

    Speeds are of the middle of each step, since velocities are half a step behind.
    """
    border, clock, control = state.plan.border, state.clock, state.control
    times = np.asarray(clock.time_after(step + np.arange(WALL_BATCH)))
    wide = np.float32 if state.backend.precision == "f32" else np.float64
    narrow = np.float64 if state.backend.precision == "f64" else np.float32
    control.border_offset.from_numpy(border.offsets(times).astype(wide))
    control.border_speed.from_numpy(border.speeds(times - 0.5 * clock.time_step).astype(narrow))
