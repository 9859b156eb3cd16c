"""Forces of the particles on walls: force-controlled walls, which move by them, and measured walls.

A force-controlled wall has one or more motions of the kinds of `scene.blocks.motions.ForceControlledMotion`.
The kind has the velocity at the next half step, given the force f [N] of the wall on the particles along its
direction; all kinds have x(t + dt) = x(t) + dt v(t + dt/2). As in the leapfrog scheme of the particles, the
velocity of a wall is half a step behind its position, and both are integrated in the same phase of the step.

The force phase of a step sums f exactly per chunk, and the integration phase of the next one moves the walls
(`ForceControlledWalls`). Measured walls have time integrals of their forces (`WallImpulses`), from which the
host computes means over any interval.
"""

from types import SimpleNamespace

import numpy as np

from granflow.engine.codes import ABORT_WALL
from granflow.engine.gravity import Gravity, present_gravity
from granflow.engine.state import State
from granflow.engine.sums import carried, energy_words, exact_totals, shares_rows, to_units
from granflow.kernel_language import ti
from granflow.plan.sum_units import (
    CARRY_BITS,
    IMPULSE_SIZE,
    UNIT_ANGULAR_IMPULSE,
    UNIT_ENERGY,
    UNIT_IMPULSE,
    UNIT_WALL_FORCE,
)
from granflow.scene.blocks.motions import poses_at

# Force-controlled walls on the device


class ControlledMotion:
    """One force-controlled motion: its parameters and its integration.

    Reads:   velocity, was_active
    Writes:  work_on_particles, work
    """

    def __init__(self, state: State, index: int) -> None:
        planned = state.plan.controlled_motions[index]
        readers = {name: state.parameter(f"motion.{index}.{name}") for name in planned.numbers}
        numbers = SimpleNamespace(**readers)
        self.r = index
        self.fields = state.wall_dynamics
        if planned.section is not None:
            self.force_at_start = numbers.force
            self.pairs = [
                [(r, state.parameter(f"motion.{index}.strain.{pair}.{r}")) for r in strains]
                for pair, strains in enumerate(planned.section.strains)
            ]
            numbers.force = self.present_force
        self.wall = state.parameter(f"motion.{index}.wall")
        self.direction = state.parameter(f"motion.{index}.direction")
        self.velocity_of_kind = planned.spec.build_velocity(numbers)
        self.is_body = planned.spec.is_body
        self.weight_changes = self.is_body and state.plan.features.changing_gravity
        self.mass = numbers.mass if self.weight_changes else None
        self.gravity = state.built(Gravity)
        self.other_force = planned.spec.build_other_force(numbers) if self.is_body else None

    @ti.func
    def present_force(self):
        """Target force [N] of a servo between walls: the pressure times the present section.

        Reads:  offset
        """
        ratio = ti.cast(1.0, ti.f64)
        for pair in ti.static(self.pairs):
            stretch = ti.cast(1.0, ti.f64)
            for r, strain in ti.static(pair):
                stretch += strain() * self.fields.offset[r]
            ratio *= stretch
        return ti.cast(self.force_at_start(), ti.f64) * ratio

    @ti.func
    def velocity_after(self, force_on_wall, dt):
        """Velocity [m/s] at the next half step; `force_on_wall` [N] contains `added_weight`."""
        is_first = self.fields.was_active[self.r] == 0
        return self.velocity_of_kind(self.fields.velocity[self.r], force_on_wall, dt, is_first)

    @ti.func
    def added_weight(self, pose):
        """Weight [N] of a body along its direction at the begin of a step beyond that at the start, which its
        numbers contain; 0 for other motions."""
        weight = ti.cast(0.0, ti.f64)
        if ti.static(self.weight_changes):
            change = self.gravity.before(pose) - self.gravity.at_start()
            weight = ti.cast(self.mass(), ti.f64) * change.dot(ti.cast(self.direction(), ti.f64))
        return weight

    @ti.func
    def add_work(self, force_on_wall, added_weight, velocity, dt):
        """Add the work on the particles, and of other forces on a body, with the mean velocity: exact for it.

        velocity:  at the next half step [m/s]
        """
        velocity_mean = 0.5 * (self.fields.velocity[self.r] + velocity)
        displacement = dt * velocity_mean
        if self.fields.was_active[self.r] == 0:
            displacement = 0.5 * displacement
        self.fields.work_on_particles[self.r] = (
            self.fields.work_on_particles[self.r] - force_on_wall * displacement
        )
        if ti.static(self.is_body):
            self.fields.work[self.r] = (
                self.fields.work[self.r] + (self.other_force(velocity_mean) + added_weight) * displacement
            )


class ForceControlledWalls:
    """Device functions of the force-controlled walls; r is the number of a motion."""

    def __init__(self, state: State) -> None:
        self.motions = [ControlledMotion(state, index) for index in range(len(state.plan.controlled_motions))]
        self.numbers = range(len(self.motions))
        self.fields = state.wall_dynamics
        self.control = state.control
        self.per_unit = state.parameter("per_unit", UNIT_WALL_FORCE)
        self.displacement_limit = state.parameter("wall_displacement_limit")
        self.travel_limit = state.parameter("wall_travel_limit")
        self.shared = shares_rows(state)
        self.rows = state.capacities.wall_rows
        self.position_real = state.backend.position_real

    @ti.func
    def clear(self, chunk):
        """Clear the forces of a chunk; rows that chunks share are cleared when the walls move.

        Writes:  wall_force
        """
        if ti.static(not self.shared):
            for r in ti.static(self.numbers):
                self.fields.wall_force[chunk, r] = 0

    @ti.func
    def add(self, chunk, w, force):
        """Add the force [N] of one contact with wall w on a particle.

        The component along the direction of each motion of the wall counts, with opposite sign.

        Writes:  wall_force
        """
        for r in ti.static(self.numbers):
            if w == self.motions[r].wall():
                force_along = ti.cast(force, ti.f64).dot(self.motions[r].direction())
                in_units = to_units(ti.cast(self.per_unit(), ti.f64) * force_along)
                if ti.static(self.shared):
                    ti.atomic_sub(self.fields.wall_force[chunk % self.rows, r], in_units)
                else:
                    self.fields.wall_force[chunk, r] = self.fields.wall_force[chunk, r] - in_units

    @ti.func
    def move(self, chunks, pose, dt_real):
        """Move all walls by one step, on one thread.

        Reads:   was_active, active, offset_at_rebuild
        Writes:  wall_force, velocity, offset, was_active, work_on_particles, work, rebuild_requested, abort
        """
        dt = ti.cast(dt_real, ti.f64)
        for r in ti.static(self.numbers):
            velocity = ti.cast(0.0, ti.f64)
            force_on_wall = ti.cast(self._force_units(chunks, r), ti.f64) / ti.cast(self.per_unit(), ti.f64)
            if self.fields.active[pose, r] == 1:
                added_weight = self.motions[r].added_weight(pose)
                velocity = self.motions[r].velocity_after(force_on_wall + added_weight, dt)
                self.motions[r].add_work(force_on_wall, added_weight, velocity, dt)
            self.fields.velocity[r] = velocity
            self.fields.was_active[r] = self.fields.active[pose, r]
            self.fields.offset[r] = self.fields.offset[r] + dt * velocity
        # A second loop, because a wall can have several motions.
        for r in ti.static(self.numbers):
            self._check_displacements(r, dt)

    @ti.func
    def _force_units(self, chunks, r: ti.template()):
        """Force of the particles on the wall of motion r in units; clears rows that chunks share."""
        total = ti.cast(0, ti.i64)
        rows = chunks
        if ti.static(self.shared):
            rows = self.rows
        for row in range(rows):
            total += self.fields.wall_force[row, r]
            if ti.static(self.shared):
                self.fields.wall_force[row, r] = 0
        return total

    @ti.func
    def _check_displacements(self, r: ti.template(), dt):
        displacement, step_displacement = self._displacements(self.motions[r].wall(), dt)
        # The negations are also true for NaN.
        if not displacement <= self.displacement_limit():
            self.control.rebuild_requested[0] = 1
        if not step_displacement <= self.travel_limit():
            ti.atomic_max(self.control.abort[0], ABORT_WALL)

    @ti.func
    def _displacements(self, wall, dt):
        """Largest displacement of a wall since the rebuild, and in this step [m]."""
        displacement = ti.cast(0.0, ti.f64)
        step_displacement = ti.cast(0.0, ti.f64)
        for r in ti.static(self.numbers):
            if self.motions[r].wall() == wall:
                displacement += ti.abs(self.fields.offset[r] - self.fields.offset_at_rebuild[r])
                step_displacement += ti.abs(dt * self.fields.velocity[r])
        return displacement, step_displacement

    @ti.func
    def sum_of(self, values: ti.template(), w):
        """Sum over the motions of wall w of a field times the direction; zero for other walls.

        values:  field with an entry per motion, such as `offset` [m] or `velocity` [m/s]

        Reads:  values
        """
        total = ti.Vector.zero(self.position_real, 3)
        for r in ti.static(self.numbers):
            if w == self.motions[r].wall():
                total += ti.cast(values[r] * self.motions[r].direction(), self.position_real)
        return total


# Force-controlled walls on the host


def upload_running(state: State, times: np.ndarray) -> None:
    """Set which motions are active in the steps that end at each pose. A wall that is not present does not
    move.

    times:  (POSE_COUNT,) [s], middle of each step

    Writes:  active
    """
    if state.wall_dynamics is None:
        return
    running = [
        state.wall_motions[controlled.wall][controlled.motion].is_running(times)
        & bool(state.walls.present[controlled.wall])
        for controlled in state.plan.controlled_motions
    ]
    state.wall_dynamics.active.from_numpy(np.stack(running, axis=1).astype(np.int32))


def shift_bodies(state: State, change: np.ndarray) -> None:
    """Shift the velocities of free walls, half a step behind the positions, for a jump of gravity (3,)
    [m/s2].

    The velocity at the present time remains, because the kick after the jump is that of the new gravity.

    Writes:  velocity, work
    """
    for r, controlled in enumerate(state.plan.controlled_motions):
        if controlled.spec.is_body and state.wall_dynamics.was_active[r]:
            before = float(state.wall_dynamics.velocity[r])
            after = before - 0.5 * state.clock.time_step * float(change @ np.array(controlled.direction))
            state.wall_dynamics.velocity[r] = after
            # The work is counted between half steps, and the last half step had the gravity before the jump.
            gained = 0.5 * controlled.numbers["mass"] * (after**2 - before**2)
            state.wall_dynamics.work[r] = float(state.wall_dynamics.work[r]) + gained


def mark_rebuild(state: State) -> None:
    """Measure the displacements of force-controlled walls from the present positions.

    Reads:   offset
    Writes:  offset_at_rebuild
    """
    if state.wall_dynamics is not None:
        state.wall_dynamics.offset_at_rebuild.copy_from(state.wall_dynamics.offset)


def controlled_displacements(state: State) -> np.ndarray:
    """Displacement (walls, 3) [m] of each wall by force-controlled motions."""
    return _per_wall(state, "offset")


def controlled_velocities(state: State) -> np.ndarray:
    """Velocity (walls, 3) [m/s] of each wall by force-controlled motions, half a step behind its position."""
    return _per_wall(state, "velocity")


def synchronized_velocities(state: State) -> np.ndarray:
    """As `controlled_velocities`, at the time of the positions."""
    if state.wall_dynamics is None:
        return np.zeros((len(state.plan.walls), 3))
    return _summed_per_wall(state, _synchronized(state)[0])


def _per_wall(state: State, name: str) -> np.ndarray:
    """Sum over the motions of each wall of a field times the direction (walls, 3)."""
    if state.wall_dynamics is None:
        return np.zeros((len(state.plan.walls), 3))
    return _summed_per_wall(state, getattr(state.wall_dynamics, name).to_numpy())


def _summed_per_wall(state: State, values: np.ndarray) -> np.ndarray:
    """Sum over the motions of each wall of values (motions,) times the direction (walls, 3)."""
    found = np.zeros((len(state.plan.walls), 3))
    for controlled, value in zip(state.plan.controlled_motions, values, strict=True):
        found[controlled.wall] += value * np.array(controlled.direction)
    return found


def controlled_totals(state: State) -> dict[str, float]:
    """Displacement [m] and velocity [m/s] of force-controlled walls; with the energy budget, energies [J].

    Both are those of all motions of the wall, along the direction of its first force-controlled motion; a
    rotation does not contribute. Keys as `wall_displacement.NAME`; velocities at the time of the positions.
    Empty without force-controlled walls.
    """
    if state.wall_dynamics is None:
        return {}
    controlled_motions = state.plan.controlled_motions
    velocity, _, work = _synchronized(state)
    displacements = controlled_displacements(state)
    velocities = _summed_per_wall(state, velocity)
    found: dict[str, float] = {}
    for controlled in controlled_motions:
        if f"wall_displacement.{controlled.name}" not in found:
            direction = np.array(controlled.direction)
            wall = controlled.wall
            prescribed = poses_at(state.wall_motions[wall], np.array([state.clock.time]))
            displacement = prescribed.offset[0] + displacements[wall]
            found[f"wall_displacement.{controlled.name}"] = float(displacement @ direction)
            found[f"wall_velocity.{controlled.name}"] = float(
                (prescribed.velocity[0] + velocities[wall]) @ direction
            )
    if state.plan.features.energy_budget:
        bodies = [r for r, controlled in enumerate(controlled_motions) if controlled.spec.is_body]
        found["free_wall_energy"] = sum(
            controlled_motions[r].spec.kinetic_energy(controlled_motions[r].numbers, float(velocity[r]))
            for r in bodies
        )
        found["free_wall_work"] = float(work[bodies].sum())
    return found


def target_forces(state: State) -> list[float]:
    """Force [N] that each motion prescribes at present, along its direction."""
    offsets = np.zeros(0) if state.wall_dynamics is None else state.wall_dynamics.offset.to_numpy()
    return [
        each.force * (1.0 if each.section is None else each.section.ratio(offsets))
        for each in state.plan.controlled_motions
    ]


def controlled_forces(state: State) -> np.ndarray:
    """Force (motions,) [N] of the wall of each motion on the particles, along its direction, in the last
    step."""
    return 0.0 - _forces_on_walls(state) if state.plan.controlled_motions else np.zeros(0)


def _forces_on_walls(state: State) -> np.ndarray:
    """Force (motions,) [N] of the particles on the wall of each motion, along its direction."""
    units = state.wall_dynamics.wall_force.to_numpy()[: state.wall_row_count].sum(axis=0)
    return np.asarray(units * state.plan.sum_units.wall_force)


def controlled_work(state: State) -> float:
    """Work [J] of all force-controlled walls on the particles since the start."""
    return 0.0 if state.wall_dynamics is None else float(_synchronized(state)[1].sum())


def _synchronized(state: State) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Velocity [m/s], work on particles and other work [J] of each motion (motions,) at the time of the
    positions."""
    fields = state.wall_dynamics
    half = 0.5 * state.clock.time_step
    velocity_half = fields.velocity.to_numpy()
    work_on_particles = fields.work_on_particles.to_numpy()
    work = fields.work.to_numpy()
    force_on_wall = _forces_on_walls(state)
    velocity = velocity_half.copy()
    for r in np.flatnonzero(fields.was_active.to_numpy()):
        controlled = state.plan.controlled_motions[r]
        spec = controlled.spec
        added_weight = 0.0
        if spec.is_body:
            added = present_gravity(state) - np.array(state.plan.scene.gravity_at_start)
            added_weight = controlled.numbers["mass"] * float(added @ np.array(controlled.direction))
        force = force_on_wall[r] + added_weight
        velocity[r] = spec.velocity_at_positions(controlled.numbers, velocity_half[r], force, half)
        velocity_mean = 0.5 * (velocity_half[r] + velocity[r])
        work_on_particles[r] -= half * velocity_mean * force_on_wall[r]
        if spec.is_body:
            other = spec.other_force(controlled.numbers, velocity_mean) + added_weight
            work[r] += half * velocity_mean * other
    return velocity, work_on_particles, work


# Measured walls: time integrals of the forces of the particles, summed exactly per chunk


class WallImpulses:
    """Time integrals of the forces of the particles on measured walls, and the work of the walls.

        J += -F dt        L += -[(x - p) x F + M] dt        N += F . n dt        W += P dt

    with the power P of prescribed motions and belts on the particle (`Accounting`), and p the `torque_point`
    of the wall, by default that of its first rotation at this step, which forces move with the wall. Sums are
    exact, because a wall force is the difference of two sums. Chunks of one particle share rows by atomic
    additions.

    Reads:   position, impulse_row, torque_point, has_axis, offset
    Writes:  impulses
    """

    def __init__(self, state: State) -> None:
        self.position = state.particles.position
        self.walls = state.walls
        self.impulses = state.control.impulses
        self.per_unit = state.parameter("per_unit")
        self.shared = shares_rows(state)
        self.rows = state.capacities.wall_rows
        self.measured = state.capacities.measured_walls
        self.moving = state.plan.features.moving_walls
        self.moved_by_forces = state.plan.features.force_controlled_walls
        self.dynamics = state.wall_dynamics
        self.controlled_walls = state.built(ForceControlledWalls)

    @ti.func
    def add(self, chunk, w, i, pose, normal, force, torque, power, dt):
        """Add one contact of particle i with wall w in one step: force [N], torque [N m] and power [W] on
        i."""
        row = self.walls.impulse_row[w]
        if row >= 0:
            time = ti.cast(dt, ti.f64)
            impulse = -time * ti.cast(force, ti.f64)
            angular_impulse = -time * ti.cast(torque, ti.f64)
            arm = ti.cast(self.position[i], ti.f64) - ti.cast(self._torque_point(w, pose), ti.f64)
            angular_impulse += arm.cross(impulse)
            units = ti.cast(self.per_unit(), ti.f64)
            terms = ti.Vector.zero(ti.i64, 2 * IMPULSE_SIZE)
            for axis in ti.static(range(3)):
                terms[axis] = to_units(units[UNIT_IMPULSE] * impulse[axis])
                terms[3 + axis] = to_units(units[UNIT_ANGULAR_IMPULSE] * angular_impulse[axis])
            terms[6] = -to_units(units[UNIT_IMPULSE] * impulse.dot(ti.cast(normal, ti.f64)))
            if ti.static(self.moving):
                work = units[UNIT_ENERGY] * time * ti.cast(power, ti.f64)
                terms[7], terms[IMPULSE_SIZE + 7] = energy_words(work)
            if ti.static(self.shared):
                self._add_to_shared(chunk, row, terms)
            else:
                self.impulses[chunk, row] = carried(self.impulses[chunk, row] + terms, IMPULSE_SIZE)

    @ti.func
    def _torque_point(self, w, pose):
        """Point [m] to which the torque on a wall refers."""
        row = 0
        if ti.static(self.moving):
            row = pose
        point = self.walls.torque_point[row, w]
        if ti.static(self.moved_by_forces):
            if self.walls.has_axis[w] == 1:
                point += self.controlled_walls.sum_of(self.dynamics.offset, w)
        return point

    @ti.func
    def _add_to_shared(self, chunk, row, terms):
        for k in ti.static(range(IMPULSE_SIZE)):
            high = terms[k] >> CARRY_BITS
            ti.atomic_add(self.impulses[chunk % self.rows, row][k], terms[k] - (high << CARRY_BITS))
            ti.atomic_add(
                self.impulses[chunk % self.rows, row][IMPULSE_SIZE + k], terms[IMPULSE_SIZE + k] + high
            )

    @ti.func
    def carry(self, chunk):
        """Move the carries of a row that chunks share, once per step and not beside additions."""
        if chunk < self.rows:
            for row in range(self.measured):
                self.impulses[chunk, row] = carried(self.impulses[chunk, row], IMPULSE_SIZE)


def wall_impulses(state: State) -> dict[str, np.ndarray]:
    """Time integrals since the start of each measured wall by name.

    Returns:  arrays (8,) float64: impulse (3) [N s], angular impulse (3) [N m s] and normal impulse [N s] of
              the particles on the wall, and work [J] of the wall, with that of motions by forces, on the
              particles; empty without measured walls
    """
    if state.control.impulses is None:
        return {}
    sums = state.ranks.total(state.control.impulses.to_numpy())
    units = state.plan.sum_units
    unit = np.array([units.impulse] * 3 + [units.angular_impulse] * 3 + [units.impulse, units.energy])
    found = {
        name: exact_totals(sums[:, row], unit) for row, name in enumerate(state.plan.scene.measured_walls)
    }
    if state.wall_dynamics is not None:
        for controlled, work in zip(state.plan.controlled_motions, _synchronized(state)[1], strict=True):
            if controlled.name in found:
                found[controlled.name][7] += work
    return found
