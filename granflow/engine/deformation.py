"""Periodic boxes whose widths change: by given strain rates, or by the pressure of the contacts.

The control of `scene.blocks.deformation` gives each axis a strain rate, with the widths W and the pressure of
the contacts at the begin of a step (J. Christoffersen, M. M. Mehrabadi, S. Nemat-Nasser, J. Appl. Mech. 48
(1981) 339),

    P_k = (1/V) sum over contacts of F_k b_k,     F: force on particle i, b: branch vector from j to i

and the velocity W' of the upper face, the lower one stays. As in the leapfrog scheme of the particles, W' is
half a step behind W, and both are advanced before the particles (`DeformingBox.move`). The rate acts on the
width at the middle of the step, so that ln W changes by rate dt to the second order:

    W' = rate (W(t) + W(t + dt)) / 2 = rate W(t) / (1 - rate dt / 2)

The image above a particle moves with W' relative to it. A particle receives the change of the affine velocity
field at its position, so that the box compresses a packing everywhere, and not from its faces:

    v += (W'(t + dt/2) - W'(t - dt/2)) (x - low) / W            W(t + dt) = W(t) + dt W'(t + dt/2)

A particle without forces that has the affine velocity keeps its relative position (x - low) / W exactly. The
energies of these kicks, of moving images and of particles that cross a face are boundary work. The images do
the work W' B dt in a step, with the force B of the contacts across the face at the begin of the step and the
mean of W' before and after that time.

The affine motion alone shrinks all distances at most by the smallest ratio s of a width to that at the last
rebuild of the neighbor lists. Pairs that are not listed remain apart as long as the displacement u of each
particle relative to the affine motion, with its radius R, half the range of forces g and its reach r, is

    |u| <= min(s, 1) (R + g + r) - (R + g)
"""

from collections.abc import Mapping

import numpy as np

from granflow.engine.box import DeviceBox
from granflow.engine.codes import ABORT_BOX
from granflow.engine.host import copy_to_host
from granflow.engine.state import State
from granflow.engine.sums import (
    SHARES,
    add_energy,
    build_list_shares,
    build_to_grid,
    exact_sum,
    shares_rows,
    to_units,
)
from granflow.geometry.periodic_box import AXES
from granflow.geometry.sphere import sphere_volume
from granflow.kernel_language import ti
from granflow.plan.sum_units import UNIT_ENERGY, UNIT_FORCE, UNIT_WALL_FORCE
from granflow.scene.blocks.deformation import Deformation
from granflow.scene.blocks.metrics import deviatoric_stress


class DeformingBox:
    """Device functions of the deformation.

    Reads:   position, velocity, mass, radius, position_at_rebuild, reach, target, rate, gain,
             width_at_rebuild
    Writes:  width, width_velocity, kick, stretch, work, virial, face_force, boundary_work, abort
    """

    def __init__(self, state: State) -> None:
        self.features = state.plan.features
        self.particles = state.particles
        self.fields = state.deformation
        self.control = state.control
        self.box = state.built(DeviceBox)
        self.axes = state.plan.periodic_box.axes
        self.other_axes = [axis for axis in range(3) if axis not in self.axes]
        self.low = state.parameter("domain_low")
        self.constant_width = state.parameter("box_width")
        self.narrowest = state.parameter("narrowest_box")
        self.force_range = state.parameter("force_range")
        self.per_unit = state.parameter("per_unit.virial")
        self.per_newton = state.parameter("per_unit", UNIT_WALL_FORCE)
        self.shift = state.parameter("shift", UNIT_FORCE)
        self.high_words_per_joule = state.parameter("per_unit", UNIT_ENERGY)
        self.list_shares = build_list_shares(state)
        self.to_grid = build_to_grid(state.backend.real)
        self.shared = shares_rows(state)
        self.rows = state.capacities.wall_rows
        self.real = state.backend.real
        self.position_real = state.backend.position_real

    # The box: once per step, on one thread

    @ti.func
    def move(self, chunks, dt_real):
        """Advance the widths by one step, before the particles."""
        dt = ti.cast(dt_real, ti.f64)
        volume = ti.cast(1.0, ti.f64)
        for axis in ti.static(self.axes):
            volume *= self.fields.width[axis]
        for axis in ti.static(self.other_axes):
            volume *= ti.cast(self.constant_width()[axis], ti.f64)
        for axis in ti.static(self.axes):
            width = self.fields.width[axis]
            pressure = self._sum(self.fields.virial, chunks, axis) / (self.per_unit() * volume)
            force = self._sum(self.fields.face_force, chunks, axis) / ti.cast(self.per_newton(), ti.f64)
            rate = self.fields.rate[axis]
            if self.fields.gain[axis] > 0.0:
                largest = rate
                rate = self.fields.gain[axis] * (pressure - self.fields.target[axis])
                rate = ti.max(ti.min(rate, largest), -largest)
            velocity = rate * width / (1.0 - 0.5 * rate * dt)
            mean_velocity = 0.5 * (self.fields.width_velocity[axis] + velocity)
            self.fields.work[axis] = self.fields.work[axis] + dt * mean_velocity * force
            self.fields.kick[axis] = (velocity - self.fields.width_velocity[axis]) / width
            self.fields.width_velocity[axis] = velocity
            self.fields.width[axis] = width + dt * velocity
            self.fields.stretch[axis] = self.fields.width[axis] / self.fields.width_at_rebuild[axis]
            if not self.fields.width[axis] >= self.narrowest():  # true for NaN
                ti.atomic_max(self.control.abort[0], ABORT_BOX)

    @ti.func
    def _sum(self, sums: ti.template(), chunks, axis: ti.template()):
        """Sum of all contacts along an axis in units; clears rows that chunks share."""
        total = ti.cast(0, ti.i64)
        rows = chunks
        if ti.static(self.shared):
            rows = self.rows
        for row in range(rows):
            total += sums[row, axis]
            if ti.static(self.shared):
                sums[row, axis] = 0
        return ti.cast(total, ti.f64) / SHARES

    # Contacts

    @ti.func
    def clear(self, chunk):
        """Clear the sums of a chunk; rows that chunks share are cleared when the box moves."""
        if ti.static(not self.shared):
            for axis in ti.static(self.axes):
                self.fields.virial[chunk, axis] = 0
                self.fields.face_force[chunk, axis] = 0

    @ti.func
    def add(self, chunk, i, j, force, pose):
        """Add a contact to the sums of a chunk; `force` [N]: on particle i.

        The force is rounded as in the sums of forces: its last bits depend on the instructions that computed
        it.
        """
        branch = self.box.minimum_image(self.particles.position[i], self.particles.position[j], pose)
        rounded = ti.cast(self.to_grid(force, self.shift()), ti.f64)
        shares = self.list_shares(chunk, j)
        for axis in ti.static(self.axes):
            term = to_units(self.per_unit() * rounded[axis] * ti.cast(branch[axis], ti.f64))
            self._add(self.fields.virial, chunk, axis, shares * term)
            index = self.box.image_index_along(axis, self.particles.position[i], self.particles.position[j])
            if index != 0:
                term = index * to_units(ti.cast(self.per_newton(), ti.f64) * rounded[axis])
                self._add(self.fields.face_force, chunk, axis, shares * term)

    @ti.func
    def _add(self, sums: ti.template(), chunk, axis: ti.template(), units):
        if ti.static(self.shared):
            ti.atomic_add(sums[chunk % self.rows, axis], units)
        else:
            sums[chunk, axis] = sums[chunk, axis] + units

    # Particles

    @ti.func
    def kick(self, chunk, i, kick_of_force):
        """Change [m/s] of the affine velocity of particle i in this step, whose energy is boundary work.

            W = m (v . a + a^2 / 2)      with the velocity v at the time of the position, and the change a

        kick_of_force:  of the whole step [m/s]
        """
        change = ti.Vector.zero(self.real, 3)
        for axis in ti.static(self.axes):
            height = self.particles.position[i][axis] - self.low()[axis]
            change[axis] = ti.cast(self.fields.kick[axis] * ti.cast(height, ti.f64), self.real)
        if ti.static(self.features.energy_budget):
            change_f64 = ti.cast(change, ti.f64)
            velocity = ti.cast(self.particles.velocity[i] + 0.5 * kick_of_force, ti.f64)
            gained = velocity.dot(change_f64) + 0.5 * change_f64.dot(change_f64)
            scale = ti.cast(self.high_words_per_joule() * self.particles.mass[i], ti.f64)
            add_energy(self.control.boundary_work, chunk, 0, 1, SHARES, scale * gained)
        return change

    @ti.func
    def affine_position(self, i):
        """Position [m] that particle i would have if it had moved affinely since the last rebuild."""
        point = self.particles.position_at_rebuild[i]
        for axis in ti.static(self.axes):
            stretch = ti.cast(self.fields.stretch[axis], self.position_real)
            point[axis] = self.low()[axis] + stretch * (point[axis] - self.low()[axis])
        return point

    @ti.func
    def reach_squared(self, i):
        """Square [m2] of the displacement relative to the affine motion above which particle i requests a
        rebuild; negative if it requests one in any case."""
        smallest = ti.cast(1.0, self.position_real)
        for axis in ti.static(self.axes):
            smallest = ti.min(smallest, ti.cast(self.fields.stretch[axis], self.position_real))
        radius = ti.cast(self.particles.radius[i], self.position_real) + 0.5 * self.force_range()
        reach = smallest * (radius + self.particles.reach[i]) - radius
        return reach * ti.abs(reach)


# On the host


def write_deformation(state: State, stage: str) -> None:
    """Write the control of a stage.

    Writes:  target, rate, gain
    """
    if state.deformation is None:
        return
    target, rate, gain = np.zeros((3, 3))
    acting = state.plan.scene.deformation_in(stage)
    deformation = acting[1] if acting else Deformation.model_construct()
    for axis, given in deformation.by_axis.items():
        k = AXES.index(axis)
        if given.pressure is None:
            rate[k] = given.strain_rate
        else:
            target[k] = given.pressure
            rate[k] = deformation.largest_rate(axis)
            gain[k] = state.plan.gain_of(deformation)
    for name, values in {"target": target, "rate": rate, "gain": gain}.items():
        getattr(state.deformation, name).from_numpy(values)


def mark_rebuild_of_box(state: State) -> None:
    """Measure the affine motion from the present widths.

    Writes:  width_at_rebuild, stretch
    """
    if state.deformation is not None:
        state.deformation.width_at_rebuild.copy_from(state.deformation.width)
        state.deformation.stretch.fill(1.0)


def deformation_work(state: State) -> float:
    """Work [J] of the moving images on the particles up to the time of the positions."""
    if state.deformation is None:
        return 0.0
    fields = state.deformation
    units = fields.face_force.to_numpy()[: state.wall_row_count].sum(axis=0)
    force = units * (state.plan.sum_units.wall_force / SHARES)
    half = 0.5 * state.clock.time_step * fields.width_velocity.to_numpy() * force
    return float((fields.work.to_numpy() + half).sum())


def at_rebuild(saved: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The saved arrays of a deforming box with the widths of the last neighbor-list rebuild."""
    if not saved:
        return {}
    return {**saved, "width": saved["width_at_rebuild"], "stretch": np.ones(3)}


def target_pressures(state: State) -> dict[int, float]:
    """Target pressure [Pa] by number of the axis, of those whose strain rate follows a pressure."""
    if state.deformation is None:
        return {}
    gain, target = state.deformation.gain.to_numpy(), state.deformation.target.to_numpy()
    return {k: float(target[k]) for k in range(len(AXES)) if gain[k] > 0.0}


def box_pressures(state: State) -> np.ndarray:
    """Pressure (3,) [Pa] of the contacts along each axis of a deforming box, 0 along axes that are not
    periodic; (0,) if the widths are constant."""
    if state.deformation is None:
        return np.zeros(0)
    sums = state.deformation.virial.to_numpy()[: state.wall_row_count].sum(axis=0)
    volume = float(np.prod(state.deformation.width.to_numpy()))
    return np.asarray(sums * (state.plan.virial_unit / SHARES) / volume)


def deformation_totals(state: State) -> dict[str, float]:
    """Width [m], logarithmic strain and pressure [Pa] of each periodic axis, solid fraction and volumetric
    strain.

        strain = ln(W / W0)             p = (Px + Py + Pz) / 3            q = sqrt(3/2 s:s)

    with the deviator s of the three pressures; p and q/p require three periodic axes. Empty if the widths are
    constant.
    """
    if state.deformation is None:
        return {}
    plan = state.plan
    width = state.deformation.width.to_numpy()
    volume = float(np.prod(width))
    pressure = box_pressures(state)
    strain = np.log(width / plan.periodic_box.width)
    found: dict[str, float] = {}
    for k in plan.periodic_box.axes:
        found |= {
            f"box_width_{AXES[k]}": float(width[k]),
            f"box_strain_{AXES[k]}": float(strain[k]),
            f"box_pressure_{AXES[k]}": float(pressure[k]),
        }
    found["volumetric_strain"] = float(strain.sum())
    radius = copy_to_host(state, ("radius",))["radius"].astype(float)
    found["solid_fraction"] = exact_sum(sphere_volume(radius)) / volume
    if len(plan.periodic_box.axes) == len(AXES):
        mean = float(pressure.mean())
        found["box_pressure"] = mean
        found["stress_ratio"] = deviatoric_stress(np.diag(pressure)) / mean if mean > 0.0 else 0.0
    return found
