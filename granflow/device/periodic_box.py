"""Where the partner of a particle stands: in a periodic box, its image that is nearest.

Positions are brought into the box at a search only; in between they may stand out of it by less than the skin. In a
sheared box the image above moves along with its offset and its speed, the one below the other way; both are looked up
by pose, as where walls stand.
"""

from typing import Any

import numpy as np
import taichi as ti

from granflow.device.state import WALL_BATCH, State
from granflow.scene.periodic_box import PeriodicBox


def _lees_edwards_axes(periodic_box: PeriodicBox) -> tuple[int, int]:
    """Axes of velocity and gradient; of a box without shear, any."""
    return (
        (0, 0)
        if periodic_box.image_motion is None
        else (periodic_box.image_motion.flow, periodic_box.image_motion.gradient)
    )


def build_image_index(state: State) -> Any:
    """Device function (one, other): 1 where the other's image above is the nearest to the one, -1 the one below, or 0.

    Of a sheared box, along the axis of its gradient.
    """
    real, periodic_box = state.backend.position_real, state.plan.periodic_box
    _, gradient = _lees_edwards_axes(periodic_box)
    half = 0.5 * float(periodic_box.width[gradient])

    @ti.func
    def image_index(one, other):
        branch = one[gradient] - other[gradient]
        return ti.cast(branch > real(half), ti.i32) - ti.cast(branch < -real(half), ti.i32)

    return image_index


def build_minimum_image(state: State) -> Any:
    """Device function (one, other, pose): vector [m] from the other point to the first, in its nearest image.

    Points that change places give exactly the opposite. Without periodic axes it is the difference and nothing else.
    """
    real, periodic_box = state.backend.position_real, state.plan.periodic_box
    widths, sheared = [float(width) for width in periodic_box.width], periodic_box.image_motion is not None
    flow, _ = _lees_edwards_axes(periodic_box)
    image_index, offset = build_image_index(state) if sheared else None, state.control.image_offset

    @ti.func
    def minimum_image(one, other, pose):
        branch = one - other
        if ti.static(sheared):
            branch[flow] = branch[flow] - ti.cast(image_index(one, other), real) * offset[pose]
            branch[flow] = branch[flow] - real(widths[flow]) * ti.round(branch[flow] / real(widths[flow]))
        for axis in ti.static([axis for axis in periodic_box.axes if not sheared or axis != flow]):
            width, half = real(widths[axis]), real(0.5 * widths[axis])
            above = ti.select(branch[axis] > half, width, 0.0 * width)
            below = ti.select(branch[axis] < -half, width, 0.0 * width)
            branch[axis] = branch[axis] - above + below
        return branch

    return minimum_image


def build_shift_by_images(state: State) -> Any:
    """Device function (point, turn, pose): where the box has the point [m] that is so many images above it."""
    real, periodic_box, offset = state.backend.position_real, state.plan.periodic_box, state.control.image_offset
    sheared = periodic_box.image_motion is not None
    flow, gradient = _lees_edwards_axes(periodic_box)
    height = float(periodic_box.width[gradient])

    @ti.func
    def shift_by_images(point, image_index, pose):
        wrapped = point
        if ti.static(sheared):
            image_count = ti.cast(image_index, real)
            wrapped[flow] = wrapped[flow] - image_count * offset[pose]
            wrapped[gradient] = wrapped[gradient] - image_count * real(height)
        return wrapped

    return shift_by_images


def build_image_velocity(state: State) -> Any:
    """Device function (i, j, pose): velocity [m/s] of the image of j nearest to i, over that of j itself.

    Only in a sheared box is there any.
    """
    real, position, periodic_box = state.backend.real, state.particles.position, state.plan.periodic_box
    sheared, speed = periodic_box.image_motion is not None, state.control.image_speed
    flow, _ = _lees_edwards_axes(periodic_box)
    image_index = build_image_index(state) if sheared else None

    @ti.func
    def image_velocity(i, j, pose):
        velocity = ti.Vector.zero(real, 3)
        if ti.static(sheared):
            velocity[flow] = ti.cast(image_index(position[i], position[j]), real) * speed[pose]
        return velocity

    return image_velocity


def build_wrap_position(state: State) -> Any:
    """Device function (point): the image of the point [m] that stands in a box that is not sheared."""
    real, periodic_box = state.backend.position_real, state.plan.periodic_box
    lows, widths = [float(low) for low in periodic_box.low], [float(width) for width in periodic_box.width]

    @ti.func
    def wrap_position(point):
        wrapped = point
        for axis in ti.static(periodic_box.axes):
            width = real(widths[axis])
            wrapped[axis] = point[axis] - width * ti.floor((point[axis] - real(lows[axis])) / width)
        return wrapped

    return wrap_position


def build_wrap(state: State) -> Any:
    """Kernel (count, pose, time_step): bring every particle into the box; what it gains by that is work of the border.

    Reads:   position, velocity, mass, force
    Writes:  position, velocity, velocity_now, boundary_work
    """
    plan, particles, real = state.plan, state.particles, state.backend.real
    boundary_work: Any = state.control.boundary_work
    wrap_position, stride, chunk_size = build_wrap_position(state), state.stride, plan.chunk_size
    gravity, sheared = [float(g) for g in plan.gravity], plan.periodic_box.image_motion is not None
    cross_boundary = _build_cross_boundary(state) if sheared else None

    @ti.func
    def add_energy_gain(chunk, i, shift, velocity_shift, dt):
        """Potential energy, and kinetic energy at the time of the positions, by the forces of the step before."""
        mass = ti.cast(particles.mass[i], ti.f64)
        gained = -mass * ti.Vector(gravity, dt=ti.f64).dot(ti.cast(shift, ti.f64))
        if ti.static(sheared):
            velocity_synchronous = ti.cast(
                particles.velocity[i] + 0.5 * dt / particles.mass[i] * particles.force[i], ti.f64
            )
            velocity_shift_f64 = ti.cast(velocity_shift, ti.f64)
            gained += mass * (
                0.5 * velocity_shift_f64.dot(velocity_shift_f64) - velocity_synchronous.dot(velocity_shift_f64)
            )
        boundary_work[chunk] = boundary_work[chunk] + gained

    @ti.kernel
    def wrap(count: ti.i32, pose: ti.i32, dt: real):
        for task in range((count + chunk_size - 1) // chunk_size * stride):
            if task % stride == 0:
                chunk = task // stride
                for i in range(chunk * chunk_size, ti.min((chunk + 1) * chunk_size, count)):
                    before = particles.position[i]
                    velocity_shift = 0.0 * particles.velocity[i]
                    wrapped = before
                    if ti.static(sheared):
                        wrapped, velocity_shift = cross_boundary(before, pose)
                    wrapped = wrap_position(wrapped)
                    particles.position[i] = wrapped
                    if ti.static(plan.features.energy_budget):
                        add_energy_gain(chunk, i, wrapped - before, velocity_shift, dt)
                    if ti.static(sheared):
                        particles.velocity[i] = particles.velocity[i] - velocity_shift
                        if ti.static(plan.features.rate_dependent):
                            particles.velocity_synchronized[i] = particles.velocity_synchronized[i] - velocity_shift

    return wrap


def _build_cross_boundary(state: State) -> Any:
    """Device function (point, pose): where the point comes in through the sheared faces, and how much slower [m/s]."""
    real, position_real, periodic_box, control = (
        state.backend.real,
        state.backend.position_real,
        state.plan.periodic_box,
        state.control,
    )
    flow, gradient = _lees_edwards_axes(periodic_box)
    low, width = float(periodic_box.low[gradient]), float(periodic_box.width[gradient])

    @ti.func
    def cross_boundary(point, pose):
        image_count = ti.floor((point[gradient] - position_real(low)) / position_real(width))
        wrapped, velocity_shift = point, ti.Vector.zero(real, 3)
        wrapped[gradient] = point[gradient] - position_real(width) * image_count
        wrapped[flow] = point[flow] - image_count * control.image_offset[pose]
        velocity_shift[flow] = ti.cast(image_count, real) * control.image_speed[pose]
        return wrapped, velocity_shift

    return cross_boundary


def upload_offsets(state: State, step: int) -> None:
    """Put offset and speed of the images after WALL_BATCH steps from number `step` on the device.

    Speeds are of the middle of each step, since velocities are half a step behind.
    """
    periodic_box, clock, control = state.plan.periodic_box, state.clock, state.control
    times = np.asarray(clock.time_after(step + np.arange(WALL_BATCH)))
    wide = np.float32 if state.backend.precision == "f32" else np.float64
    narrow = np.float64 if state.backend.precision == "f64" else np.float32
    control.image_offset.from_numpy(periodic_box.offsets(times).astype(wide))
    control.image_speed.from_numpy(periodic_box.speeds(times - 0.5 * clock.time_step).astype(narrow))
