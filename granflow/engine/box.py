"""Periodic box: the nearest image of a partner, its velocity, and wrapping of particles that leave the box.

Positions are wrapped into the box in the step in which they leave it: the rounding of a coordinate depends on
its size, so that wrapping at rebuilds would make the bits depend on the rebuilds. In a sheared box
(Lees-Edwards) the image above moves with an offset and a velocity, and the image below with the opposite
ones; both are stored by pose, as wall positions are.
"""

from typing import Any

import numpy as np

from granflow.engine.state import State
from granflow.engine.sums import SHARES, add_energy
from granflow.geometry.periodic_box import PeriodicBox
from granflow.kernel_language import ti
from granflow.plan.capacities import WALL_BATCH
from granflow.plan.sum_units import UNIT_ENERGY

# Images


def build_minimum_image(state: State) -> Any:
    """Device function (one, other, pose): branch vector [m] from `other` to `one` by the minimum image
    convention.

    Exchanged points give exactly the opposite vector. Without periodic axes it is the plain difference.

    Reads:  image_offset
    """
    real = state.backend.position_real
    periodic_box = state.plan.periodic_box
    width = state.parameter("box_width")
    sheared = periodic_box.image_motion is not None
    flow, _ = _lees_edwards_axes(periodic_box)
    image_index = build_image_index(state) if sheared else None
    offset = state.control.image_offset

    @ti.func
    def minimum_image(one, other, pose):
        branch = one - other
        widths = width()
        if ti.static(sheared):
            # The flow axis needs rounding: with the offset, the distance can be more than one and a half
            # widths.
            branch[flow] = branch[flow] - ti.cast(image_index(one, other), real) * offset[pose]
            branch[flow] = branch[flow] - widths[flow] * ti.round(branch[flow] / widths[flow])
        for axis in ti.static([axis for axis in periodic_box.axes if not sheared or axis != flow]):
            half = 0.5 * widths[axis]
            # One width suffices, because positions are inside the box.
            above = ti.select(branch[axis] > half, widths[axis], 0.0 * widths[axis])
            below = ti.select(branch[axis] < -half, widths[axis], 0.0 * widths[axis])
            branch[axis] = branch[axis] - above + below
        return branch

    return minimum_image


def build_image_index(state: State) -> Any:
    """Device function (one, other): 1 if the image of `other` above is nearest to `one`, -1 if that below,
    else 0.

    Above and below refer to the gradient axis of a sheared box. Points are in m, inside the box.
    """
    _, gradient = _lees_edwards_axes(state.plan.periodic_box)
    width = state.parameter("box_width")

    @ti.func
    def image_index(one, other):
        branch = one[gradient] - other[gradient]
        half = 0.5 * width()[gradient]
        return ti.cast(branch > half, ti.i32) - ti.cast(branch < -half, ti.i32)

    return image_index


def _lees_edwards_axes(periodic_box: PeriodicBox) -> tuple[int, int]:
    """Axes of flow and gradient; arbitrary for a box without shear."""
    motion = periodic_box.image_motion
    if motion is None:
        return 0, 0
    return motion.flow, motion.gradient


def build_image_velocity(state: State) -> Any:
    """Device function (i, j, pose): velocity [m/s] of the image of j nearest to i, relative to j itself.

    Zero except in a sheared box. The velocity is at the half step.

    Reads:  position, image_speed
    """
    real = state.backend.real
    position = state.particles.position
    periodic_box = state.plan.periodic_box
    sheared = periodic_box.image_motion is not None
    speed = state.control.image_speed
    flow, _ = _lees_edwards_axes(periodic_box)
    image_index = build_image_index(state) if sheared else None

    @ti.func
    def image_velocity(i, j, pose):
        velocity = ti.Vector.zero(real, 3)
        if ti.static(sheared):
            velocity[flow] = ti.cast(image_index(position[i], position[j]), real) * speed[pose]
        return velocity

    return image_velocity


def build_shift_by_images(state: State) -> Any:
    """Device function (point, n, pose): position [m] of a point relative to the n-th image box along the
    gradient.

    The point itself in a box without shear.

    Reads:  image_offset
    """
    real = state.backend.position_real
    periodic_box = state.plan.periodic_box
    offset = state.control.image_offset
    sheared = periodic_box.image_motion is not None
    flow, gradient = _lees_edwards_axes(periodic_box)
    width = state.parameter("box_width")

    @ti.func
    def shift_by_images(point, image_index, pose):
        wrapped = point
        if ti.static(sheared):
            image_count = ti.cast(image_index, real)
            wrapped[flow] = wrapped[flow] - image_count * offset[pose]
            wrapped[gradient] = wrapped[gradient] - image_count * width()[gradient]
        return wrapped

    return shift_by_images


def build_near_image(state: State) -> Any:
    """Device function (point in the box, number, reach [m]) -> (image of the point [m], whether it is near).

    Numbers are 0 to 3^n - 1 for n periodic axes; number 0 is the point itself. An image is near if the point
    is within `reach` of each boundary that it has crossed.
    """
    periodic_axes = state.plan.periodic_box.axes
    low = state.parameter("domain_low")
    width = state.parameter("box_width")

    @ti.func
    def near_image(point, number, reach):
        image = point
        is_near = True
        rest = number
        for axis in ti.static(periodic_axes):
            height = point[axis] - low()[axis]
            across = width()[axis]
            if rest % 3 == 1:
                image[axis] = point[axis] + across
                is_near = is_near and height < reach
            elif rest % 3 == 2:
                image[axis] = point[axis] - across
                is_near = is_near and across - height < reach
            rest = rest // 3
        return image, is_near

    return near_image


def upload_offsets(state: State, step: int) -> None:
    """Upload offset [m] and velocity [m/s] of the images for WALL_BATCH steps after step number `step`.

    Velocities refer to the middle of each step, because particle velocities are half a step behind.

    Writes:  image_offset, image_speed
    """
    periodic_box = state.plan.periodic_box
    clock = state.clock
    control = state.control
    times = np.asarray(clock.time_after(step + np.arange(WALL_BATCH)))
    position_real = np.float32 if state.backend.precision == "f32" else np.float64
    real = np.float64 if state.backend.precision == "f64" else np.float32
    control.image_offset.from_numpy(periodic_box.offsets(times).astype(position_real))
    control.image_speed.from_numpy(periodic_box.speeds(times - 0.5 * clock.time_step).astype(real))


# Wrapping


def build_wrap(state: State) -> Any:
    """Device function (chunk, i, pose, dt): wrap a particle into the box; its energy gain is boundary
    work.

        W = -m g . (x' - x) + m (v'^2 - v^2) / 2        at the time of the positions

    Reads:   position, velocity, mass, force, image_offset, image_speed
    Writes:  position, position_at_rebuild, velocity, velocity_synchronized, boundary_work
    """
    plan = state.plan
    particles = state.particles
    axes = state.plan.periodic_box.axes
    wrap_position = build_wrap_position(state)
    sheared = plan.periodic_box.image_motion is not None
    cross_boundary = _build_cross_boundary(state) if sheared else None
    add_energy_gain = build_add_energy_gain(state)
    clumps = plan.features.clumps
    low = state.parameter("domain_low")
    width = state.parameter("box_width")

    @ti.func
    def is_outside(point):
        outside = False
        lows = low()
        widths = width()
        for axis in ti.static(axes):
            outside = outside | (ti.floor((point[axis] - lows[axis]) / widths[axis]) != 0.0)
        return outside

    @ti.func
    def wrap(chunk, i, pose, dt):
        before = particles.position[i]
        if is_outside(before):
            velocity_shift = 0.0 * particles.velocity[i]
            wrapped = before
            if ti.static(sheared):
                wrapped, velocity_shift = cross_boundary(before, pose)
            wrapped = wrap_position(wrapped)  # after the shear, which shifts along the flow axis
            particles.position[i] = wrapped
            particles.position_at_rebuild[i] = particles.position_at_rebuild[i] + (wrapped - before)
            if ti.static(plan.features.energy_budget and clumps):
                if particles.clump[i] < 0:  # the energy of a clump is that of its center of mass
                    add_energy_gain(chunk, i, wrapped - before, velocity_shift, dt)
            elif ti.static(plan.features.energy_budget):
                add_energy_gain(chunk, i, wrapped - before, velocity_shift, dt)
            if ti.static(sheared):
                particles.velocity[i] = particles.velocity[i] - velocity_shift
                if ti.static(plan.features.rate_dependent):
                    particles.velocity_synchronized[i] = particles.velocity_synchronized[i] - velocity_shift

    return wrap


def build_wrap_position(state: State) -> Any:
    """Device function (point): the image of the point [m] inside the box, without shear.

    Coordinates along axes that are not periodic are unchanged.
    """
    periodic_axes = state.plan.periodic_box.axes
    low = state.parameter("domain_low")
    width = state.parameter("box_width")

    @ti.func
    def wrap_position(point):
        wrapped = point
        lows = low()
        widths = width()
        for axis in ti.static(periodic_axes):
            wrapped[axis] = point[axis] - widths[axis] * ti.floor((point[axis] - lows[axis]) / widths[axis])
        return wrapped

    return wrap_position


def _build_cross_boundary(state: State) -> Any:
    """Device function (point, pose): point [m] wrapped across the sheared faces, and decrease of its velocity
    [m/s].

    Reads:  image_offset, image_speed
    """
    real = state.backend.real
    control = state.control
    low = state.parameter("domain_low")
    width = state.parameter("box_width")
    flow, gradient = _lees_edwards_axes(state.plan.periodic_box)

    @ti.func
    def cross_boundary(point, pose):
        image_count = ti.floor((point[gradient] - low()[gradient]) / width()[gradient])
        wrapped = point
        velocity_shift = ti.Vector.zero(real, 3)
        wrapped[gradient] = point[gradient] - width()[gradient] * image_count
        wrapped[flow] = point[flow] - image_count * control.image_offset[pose]
        velocity_shift[flow] = ti.cast(image_count, real) * control.image_speed[pose]
        return wrapped, velocity_shift

    return cross_boundary


def build_add_energy_gain(state: State) -> Any:
    """Device function (chunk, i, shift [m], decrease of the velocity [m/s], dt): add the energy gain.

    The gain of potential energy, and of kinetic energy at the time of the positions.

    Reads:   velocity, mass, force
    Writes:  boundary_work
    """
    particles = state.particles
    control = state.control
    sheared = state.plan.periodic_box.image_motion is not None
    gravity = state.parameter("gravity")
    high_words_per_joule = state.parameter("per_unit", UNIT_ENERGY)

    @ti.func
    def add_energy_gain(chunk, i, shift, velocity_shift, dt):
        mass = ti.cast(particles.mass[i], ti.f64)
        gained = -mass * gravity().dot(ti.cast(shift, ti.f64))
        if ti.static(sheared):
            velocity_synchronous = ti.cast(
                particles.velocity[i] + 0.5 * dt / particles.mass[i] * particles.force[i], ti.f64
            )
            velocity_shift_f64 = ti.cast(velocity_shift, ti.f64)
            gained += mass * (
                0.5 * velocity_shift_f64.dot(velocity_shift_f64)
                - velocity_synchronous.dot(velocity_shift_f64)
            )
        scale = ti.cast(high_words_per_joule(), ti.f64)
        add_energy(control.boundary_work, chunk, 0, 1, SHARES, scale * gained)

    return add_energy_gain
