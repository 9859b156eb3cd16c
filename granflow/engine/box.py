"""Periodic box: the nearest image of a partner, its velocity, and wrapping of particles that leave the box.

Positions are wrapped into the box in the step in which they leave it: the rounding of a coordinate depends on
its size, so that wrapping at rebuilds would make the bits depend on the rebuilds. In a sheared box
(Lees-Edwards) the image above moves with an offset and a velocity, and the image below with the opposite
ones; both are stored by pose, as wall positions are. In a box whose widths change (`deformation.py`), the
images move with the velocities of the widths.
"""

import numpy as np

from granflow.engine.state import State
from granflow.engine.sums import SHARES, add_energy
from granflow.kernel_language import ti
from granflow.plan.capacities import POSE_COUNT
from granflow.plan.sum_units import UNIT_ENERGY


class DeviceBox:
    """The periodic box in device functions: images of points, their motion, and wrapping of points.

    Points are in m, inside the box unless noted; `pose` is the index of the present offset of the images.

    Reads:  position, image_offset, image_speed, width, width_velocity
    """

    def __init__(self, state: State) -> None:
        periodic_box = state.plan.periodic_box
        motion = periodic_box.image_motion
        self.axes = periodic_box.axes
        self.sheared = motion is not None
        # Axes of the shear: flow and gradient; not used without shear.
        self.flow, self.gradient = (motion.flow, motion.gradient) if motion is not None else (0, 0)
        self.axes_of_whole_widths = [axis for axis in self.axes if not self.sheared or axis != self.flow]
        self.low = state.parameter("domain_low")
        self.deforming = state.plan.features.deforming_box
        self.fields = state.deformation
        self.width = self._present_width if self.deforming else state.parameter("box_width")
        self.domain_high = state.parameter("domain_high")
        self.position = state.particles.position
        self.offset = state.control.image_offset
        self.speed = state.control.image_speed
        self.real = state.backend.real
        self.position_real = state.backend.position_real

    @ti.func
    def _present_width(self):
        """Widths [m] of a box that deforms."""
        width = ti.Vector.zero(self.position_real, 3)
        for axis in ti.static(range(3)):
            width[axis] = ti.cast(self.fields.width[axis], self.position_real)
        return width

    @ti.func
    def high(self):
        """Upper corner of the domain [m]."""
        high = self.domain_high()
        if ti.static(self.deforming):
            for axis in ti.static(self.axes):
                high[axis] = self.low()[axis] + self.width()[axis]
        return high

    @ti.func
    def minimum_image(self, one, other, pose):
        """Branch vector [m] from `other` to `one` by the minimum image convention.

        Exchanged points give exactly the opposite vector. Without periodic axes it is the plain difference.
        """
        branch = one - other
        widths = self.width()
        if ti.static(self.sheared):
            # The flow axis needs rounding: with the offset, the distance can be more than one and a half
            # widths.
            flow = ti.static(self.flow)
            branch[flow] = (
                branch[flow] - ti.cast(self.image_index(one, other), self.position_real) * self.offset[pose]
            )
            branch[flow] = branch[flow] - widths[flow] * ti.round(branch[flow] / widths[flow])
        for axis in ti.static(self.axes_of_whole_widths):
            half = 0.5 * widths[axis]
            # One width suffices, because positions are inside the box.
            above = ti.select(branch[axis] > half, widths[axis], 0.0 * widths[axis])
            below = ti.select(branch[axis] < -half, widths[axis], 0.0 * widths[axis])
            branch[axis] = branch[axis] - above + below
        return branch

    @ti.func
    def image_index(self, one, other):
        """As `image_index_along`, along the gradient axis of a sheared box."""
        return self.image_index_along(self.gradient, one, other)

    @ti.func
    def image_index_along(self, axis: ti.template(), one, other):
        """1 if the image of `other` above along an axis is nearest to `one`, -1 if that below, else 0."""
        branch = one[axis] - other[axis]
        half = 0.5 * self.width()[axis]
        return ti.cast(branch > half, ti.i32) - ti.cast(branch < -half, ti.i32)

    @ti.func
    def image_velocity(self, i, j, pose):
        """Velocity [m/s] of the image of particle j nearest to particle i, relative to j itself.

        Zero except in a sheared or deforming box. The velocity is at the half step.
        """
        velocity = ti.Vector.zero(self.real, 3)
        if ti.static(self.deforming):
            for axis in ti.static(self.axes):
                index = self.image_index_along(axis, self.position[i], self.position[j])
                velocity[axis] = ti.cast(index * self.fields.width_velocity[axis], self.real)
        if ti.static(self.sheared):
            velocity[self.flow] = (
                ti.cast(self.image_index(self.position[i], self.position[j]), self.real) * self.speed[pose]
            )
        return velocity

    @ti.func
    def shift_by_images(self, point, image_index, pose):
        """Position [m] of a point relative to the n-th image box along the gradient.

        The point itself in a box without shear.
        """
        shifted = point
        if ti.static(self.sheared):
            flow, gradient = ti.static(self.flow, self.gradient)
            image_count = ti.cast(image_index, self.position_real)
            shifted[flow] = shifted[flow] - image_count * self.offset[pose]
            shifted[gradient] = shifted[gradient] - image_count * self.width()[gradient]
        return shifted

    @ti.func
    def near_image(self, point, number, reach):
        """An image [m] of the point, and whether it is near: the point is within `reach` [m] of each boundary
        that the image has crossed.

        Numbers are 0 to 3^n - 1 for n periodic axes; number 0 is the point itself.
        """
        image = point
        is_near = True
        rest = number
        for axis in ti.static(self.axes):
            height = point[axis] - self.low()[axis]
            across = self.width()[axis]
            if rest % 3 == 1:
                image[axis] = point[axis] + across
                is_near = is_near and height < reach
            elif rest % 3 == 2:
                image[axis] = point[axis] - across
                is_near = is_near and across - height < reach
            rest = rest // 3
        return image, is_near

    @ti.func
    def is_outside(self, point):
        """Whether a point is outside of the box along a periodic axis."""
        outside = False
        lows = self.low()
        widths = self.width()
        for axis in ti.static(self.axes):
            outside = outside | (ti.floor((point[axis] - lows[axis]) / widths[axis]) != 0.0)
        return outside

    @ti.func
    def wrap_position(self, point):
        """The image inside the box of a point outside, without shear.

        Coordinates along axes that are not periodic are unchanged.
        """
        wrapped = point
        lows = self.low()
        widths = self.width()
        for axis in ti.static(self.axes):
            wrapped[axis] = point[axis] - widths[axis] * ti.floor((point[axis] - lows[axis]) / widths[axis])
        return wrapped

    @ti.func
    def velocity_shift(self, point):
        """Decrease [m/s] of the velocity of a point outside a deforming box that is wrapped into it."""
        shift = ti.Vector.zero(self.real, 3)
        for axis in ti.static(self.axes):
            count = ti.floor((point[axis] - self.low()[axis]) / self.width()[axis])
            shift[axis] = ti.cast(ti.cast(count, ti.f64) * self.fields.width_velocity[axis], self.real)
        return shift

    @ti.func
    def cross_sheared_faces(self, point, pose):
        """A point outside, wrapped across the sheared faces, and the decrease of its velocity [m/s]."""
        flow, gradient = ti.static(self.flow, self.gradient)
        image_count = ti.floor((point[gradient] - self.low()[gradient]) / self.width()[gradient])
        wrapped = point
        velocity_shift = ti.Vector.zero(self.real, 3)
        wrapped[gradient] = point[gradient] - self.width()[gradient] * image_count
        wrapped[flow] = point[flow] - image_count * self.offset[pose]
        velocity_shift[flow] = ti.cast(image_count, self.real) * self.speed[pose]
        return wrapped, velocity_shift


class ParticleWrap:
    """Wraps particles that have left the box; their energy gain is boundary work.

        W = -m g . (x' - x) + m (v'^2 - v^2) / 2        at the time of the positions

    Reads:   position, velocity, mass, force, clump, image_offset, image_speed, width, width_velocity, stretch
    Writes:  position, position_at_rebuild, velocity, velocity_synchronized, boundary_work
    """

    def __init__(self, state: State) -> None:
        self.particles = state.particles
        self.features = state.plan.features
        self.box = state.built(DeviceBox)
        self.boundary_work = state.control.boundary_work
        self.gravity = state.parameter("gravity")
        self.high_words_per_joule = state.parameter("per_unit", UNIT_ENERGY)

    @ti.func
    def wrap(self, chunk, i, pose, dt):
        """Wrap particle i into the box, if it is outside."""
        before = self.particles.position[i]
        if self.box.is_outside(before):
            velocity_shift = 0.0 * self.particles.velocity[i]
            wrapped = before
            if ti.static(self.box.sheared):
                wrapped, velocity_shift = self.box.cross_sheared_faces(before, pose)
            if ti.static(self.box.deforming):
                velocity_shift = self.box.velocity_shift(before)
            wrapped = self.box.wrap_position(wrapped)  # after the shear, which shifts along the flow axis
            self.particles.position[i] = wrapped
            shift = wrapped - before
            if ti.static(self.box.deforming):  # by widths of the last rebuild
                for axis in ti.static(self.box.axes):
                    shift[axis] = shift[axis] / ti.cast(self.box.fields.stretch[axis], self.box.position_real)
            self.particles.position_at_rebuild[i] = self.particles.position_at_rebuild[i] + shift
            if ti.static(self.features.energy_budget and self.features.clumps):
                if self.particles.clump[i] < 0:  # the energy of a clump is that of its center of mass
                    self.add_energy_gain(chunk, i, wrapped - before, velocity_shift, dt)
            elif ti.static(self.features.energy_budget):
                self.add_energy_gain(chunk, i, wrapped - before, velocity_shift, dt)
            if ti.static(self.features.moving_images):
                self.particles.velocity[i] = self.particles.velocity[i] - velocity_shift
                if ti.static(self.features.synchronized):
                    self.particles.velocity_synchronized[i] = (
                        self.particles.velocity_synchronized[i] - velocity_shift
                    )

    @ti.func
    def add_energy_gain(self, chunk, i, shift, velocity_shift, dt):
        """Add the energy gain of particle i by a shift [m] and a decrease of its velocity [m/s]."""
        mass = ti.cast(self.particles.mobility(i) * self.particles.mass[i], ti.f64)
        gained = -mass * self.gravity().dot(ti.cast(shift, ti.f64))
        if ti.static(self.features.moving_images):
            velocity_synchronous = ti.cast(
                self.particles.velocity[i] + 0.5 * dt / self.particles.mass[i] * self.particles.force[i],
                ti.f64,
            )
            velocity_shift_f64 = ti.cast(velocity_shift, ti.f64)
            gained += mass * (
                0.5 * velocity_shift_f64.dot(velocity_shift_f64)
                - velocity_synchronous.dot(velocity_shift_f64)
            )
        scale = ti.cast(self.high_words_per_joule(), ti.f64)
        add_energy(self.boundary_work, chunk, 0, 1, SHARES, scale * gained)


def upload_offsets(state: State, step: int) -> None:
    """Upload offset [m] and velocity [m/s] of the images for POSE_COUNT steps after step number `step`.

    Velocities refer to the middle of each step, because particle velocities are half a step behind.

    Writes:  image_offset, image_speed
    """
    periodic_box = state.plan.periodic_box
    clock = state.clock
    control = state.control
    times = np.asarray(clock.time_after(step + np.arange(POSE_COUNT)))
    position_real = np.float32 if state.backend.precision == "f32" else np.float64
    real = np.float64 if state.backend.precision == "f64" else np.float32
    control.image_offset.from_numpy(periodic_box.offsets(times).astype(position_real))
    control.image_speed.from_numpy(periodic_box.speeds(times - 0.5 * clock.time_step).astype(real))
