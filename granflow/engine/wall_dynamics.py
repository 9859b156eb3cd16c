"""Forces of the particles on walls: force-controlled walls, which move by them, and measured walls.

A force-controlled wall has one or more motions of the kinds servo and free:

    servo   v(t + dt/2) = v(t - dt/2) + {gain [F - f(t)] - v(t - dt/2)} / (1 + lag), limited to +-velocity_max
    free    v(t + dt/2) = [(1 - a) v(t - dt/2) + dt/M (F - f(t))] / (1 + a),   a = c dt / 2M
    both    x(t + dt) = x(t) + dt v(t + dt/2)

with f [N] the force of the wall on the particles along its direction, and F [N] the target force of a servo,
or the weight and the applied force of a free wall; gain [m/(N s)], lag [steps], mass M [kg] and damping c [N
s/m] are those of the plan. As in the leapfrog scheme of the particles, the velocity of a wall is half a step
behind its position, and both are integrated in the same phase of the step.

The force phase of a step sums f exactly per chunk (`build_add_wall_force`); the integration phase of the next
one moves the walls (`build_move_walls`). Measured walls have time integrals of their forces
(`build_add_impulse`), from which the host computes means over any interval.
"""

from typing import Any

import numpy as np

from granflow.engine.codes import ABORT_WALL
from granflow.engine.state import State
from granflow.engine.sums import carried, exact_totals, shares_rows, to_units
from granflow.kernel_language import ti
from granflow.plan.sum_units import (
    CARRY_BITS,
    IMPULSE_SIZE,
    UNIT_ANGULAR_IMPULSE,
    UNIT_IMPULSE,
    UNIT_WALL_FORCE,
)
from granflow.scene.blocks.motions import pose

# Force-controlled walls on the device


class MotionParameters:
    """Device functions (): the parameters of one force-controlled motion, and its kind."""

    def __init__(self, state: State, index: int) -> None:
        self.is_servo = state.plan.controlled_motions[index].kind == "servo"
        self.wall = state.parameter(f"motion.{index}.wall")
        self.direction = state.parameter(f"motion.{index}.direction")
        self.force = state.parameter(f"motion.{index}.force")
        self.gain = state.parameter(f"motion.{index}.gain")
        self.lag = state.parameter(f"motion.{index}.lag")
        self.velocity_max = state.parameter(f"motion.{index}.velocity_max")
        self.mass = state.parameter(f"motion.{index}.mass")
        self.damping = state.parameter(f"motion.{index}.damping")


def _motions(state: State) -> list[MotionParameters]:
    return [MotionParameters(state, index) for index in range(len(state.plan.controlled_motions))]


def build_clear_wall_forces(state: State) -> Any:
    """Device function (chunk): clear the forces of a chunk; rows that chunks share are cleared when the walls
    move.

    Writes:  wall_force
    """
    fields = state.wall_dynamics
    motion_count = len(state.plan.controlled_motions)
    shared = shares_rows(state)

    @ti.func
    def clear_wall_forces(chunk):
        if ti.static(not shared):
            for r in ti.static(range(motion_count)):
                fields.wall_force[chunk, r] = 0

    return clear_wall_forces


def build_add_wall_force(state: State) -> Any:
    """Device function (chunk, wall, force on a particle [N]): add the force of one contact.

    The component along the direction of each motion of the wall counts, with opposite sign.

    Writes:  wall_force
    """
    motions = _motions(state)
    fields = state.wall_dynamics
    per_unit = state.parameter("per_unit", UNIT_WALL_FORCE)
    shared = shares_rows(state)
    rows = state.capacities.wall_rows

    @ti.func
    def add_wall_force(chunk, w, force):
        for r in ti.static(range(len(motions))):
            if w == motions[r].wall():
                force_along = ti.cast(force, ti.f64).dot(motions[r].direction())
                in_units = to_units(ti.cast(per_unit(), ti.f64) * force_along)
                if ti.static(shared):
                    ti.atomic_sub(fields.wall_force[chunk % rows, r], in_units)
                else:
                    fields.wall_force[chunk, r] = fields.wall_force[chunk, r] - in_units

    return add_wall_force


def build_move_walls(state: State) -> Any:
    """Device function (chunks, pose, dt): move all force-controlled walls by one step, on one thread.

    Reads:   was_active, active
    Writes:  wall_force, velocity, offset, was_active, work_on_particles, work, rebuild_requested, abort
    """
    motions = _motions(state)
    fields = state.wall_dynamics
    control = state.control
    displacement_limit = state.parameter("wall_displacement_limit")
    travel_limit = state.parameter("wall_travel_limit")
    per_unit = state.parameter("per_unit", UNIT_WALL_FORCE)
    shared = shares_rows(state)
    shared_rows = state.capacities.wall_rows

    @ti.func
    def force_units(chunks, r: ti.template()):
        """Force of the particles on the wall of motion r in units; clears rows that chunks share."""
        total = ti.cast(0, ti.i64)
        rows = chunks
        if ti.static(shared):
            rows = shared_rows
        for row in range(rows):
            total += fields.wall_force[row, r]
            if ti.static(shared):
                fields.wall_force[row, r] = 0
        return total

    @ti.func
    def check_displacements(r: ti.template(), dt):
        displacement, step_displacement = _wall_displacements(fields, motions, motions[r].wall(), dt)
        # The negations are also true for NaN.
        if not displacement <= displacement_limit():
            control.rebuild_requested[0] = 1
        if not step_displacement <= travel_limit():
            ti.atomic_max(control.abort[0], ABORT_WALL)

    @ti.func
    def move_walls(chunks, pose, dt_real):
        dt = ti.cast(dt_real, ti.f64)
        for r in ti.static(range(len(motions))):
            velocity = ti.cast(0.0, ti.f64)
            force_on_wall = ti.cast(force_units(chunks, r), ti.f64) / ti.cast(per_unit(), ti.f64)
            if fields.active[pose, r] == 1:
                velocity = _controlled_velocity(fields, motions[r], r, force_on_wall, dt)
                _add_work(fields, motions[r], r, force_on_wall, velocity, dt)
            fields.velocity[r] = velocity
            fields.was_active[r] = fields.active[pose, r]
            fields.offset[r] = fields.offset[r] + dt * velocity
        # A second loop, because a wall can have several motions.
        for r in ti.static(range(len(motions))):
            check_displacements(r, dt)

    return move_walls


@ti.func
def _controlled_velocity(fields: ti.template(), motion: ti.template(), r: ti.template(), force_on_wall, dt):
    """Velocity [m/s] of motion r at the next half step; the first kick of a free wall is half a step."""
    velocity = fields.velocity[r]
    if ti.static(motion.is_servo):
        velocity += (motion.gain() * (motion.force() + force_on_wall) - velocity) / (1.0 + motion.lag())
        velocity = ti.max(ti.min(velocity, motion.velocity_max()), -motion.velocity_max())
    else:
        kick = dt / motion.mass() * (motion.force() + force_on_wall)
        if fields.was_active[r] == 0:
            kick = 0.5 * kick
        drag = 0.5 * motion.damping() * dt / motion.mass()
        velocity = ((1.0 - drag) * velocity + kick) / (1.0 + drag)
    return velocity


@ti.func
def _add_work(fields: ti.template(), motion: ti.template(), r: ti.template(), force_on_wall, velocity, dt):
    """Add the work on the particles, and of other forces on a free wall, with the mean velocity: exact for
    it."""
    velocity_mean = 0.5 * (fields.velocity[r] + velocity)
    displacement = dt * velocity_mean
    if fields.was_active[r] == 0:
        displacement = 0.5 * displacement
    fields.work_on_particles[r] = fields.work_on_particles[r] - force_on_wall * displacement
    if ti.static(not motion.is_servo):
        fields.work[r] = fields.work[r] + (motion.force() - motion.damping() * velocity_mean) * displacement


@ti.func
def _wall_displacements(fields: ti.template(), motions: ti.template(), wall, dt):
    """Largest displacement of a wall since the rebuild, and in this step [m]."""
    displacement = ti.cast(0.0, ti.f64)
    step_displacement = ti.cast(0.0, ti.f64)
    for r in ti.static(range(len(motions))):
        if motions[r].wall() == wall:
            displacement += ti.abs(fields.offset[r] - fields.offset_at_rebuild[r])
            step_displacement += ti.abs(dt * fields.velocity[r])
    return displacement, step_displacement


def build_controlled_vector(state: State, values: Any) -> Any:
    """Device function (w): sum over the force-controlled motions of wall w of a field times the direction.

    values:  field with an entry per motion, such as `offset` [m] or `velocity` [m/s]

    The vector is zero for other walls.

    Reads:  values
    """
    motions = _motions(state)
    real = state.backend.position_real

    @ti.func
    def controlled_vector(w):
        total = ti.Vector.zero(real, 3)
        for r in ti.static(range(len(motions))):
            if w == motions[r].wall():
                total += ti.cast(values[r] * motions[r].direction(), real)
        return total

    return controlled_vector


# Force-controlled walls on the host


def upload_running(state: State, times: np.ndarray) -> None:
    """Set which motions are active in the steps that end at each pose. A wall that is not present does not
    move.

    times:  (WALL_BATCH,) [s], middle of each step

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
            prescribed = pose(state.wall_motions[wall], np.array([state.clock.time]))
            displacement = prescribed.offset[0] + displacements[wall]
            found[f"wall_displacement.{controlled.name}"] = float(displacement @ direction)
            found[f"wall_velocity.{controlled.name}"] = float(
                (prescribed.velocity[0] + velocities[wall]) @ direction
            )
    if state.plan.features.energy_budget:
        free = [r for r, controlled in enumerate(controlled_motions) if controlled.kind == "free"]
        found["free_wall_energy"] = sum(
            0.5 * controlled_motions[r].mass * float(velocity[r]) ** 2 for r in free
        )
        found["free_wall_work"] = float(work[free].sum())
    return found


def controlled_forces(state: State) -> np.ndarray:
    """Force (motions,) [N] of the wall of each motion on the particles, along its direction, in the last
    step."""
    return 0.0 - _forces_on_walls(state)


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
        is_free = controlled.kind == "free"
        if is_free:
            drag = 0.5 * controlled.damping * half / controlled.mass
            velocity[r] = (
                (1.0 - drag) * velocity_half[r]
                + half / controlled.mass * (controlled.force + force_on_wall[r])
            ) / (1.0 + drag)
        velocity_mean = 0.5 * (velocity_half[r] + velocity[r])
        work_on_particles[r] -= half * velocity_mean * force_on_wall[r]
        if is_free:
            work[r] += half * velocity_mean * (controlled.force - controlled.damping * velocity_mean)
    return velocity, work_on_particles, work


# Measured walls: time integrals of the forces of the particles, summed exactly per chunk


def build_add_impulse(state: State) -> Any:
    """Device function (chunk, wall, i, normal, force on i, torque on i, dt): add one contact in one
    step.

        J += -F dt        L += -[(x - p) x F + M] dt        N += F . n dt

    with p the point of the wall's rotation in the scene, or the origin without rotation. Sums are exact,
    because a wall force is the difference of two sums. Chunks of one particle share rows by atomic additions.

    Reads:   position, impulse_row, pivot
    Writes:  impulses
    """
    particles = state.particles
    walls = state.walls
    impulses = state.control.impulses
    per_unit = state.parameter("per_unit")
    shared = shares_rows(state)
    rows = state.capacities.wall_rows

    @ti.func
    def add_to_shared(chunk, row, terms):
        for k in ti.static(range(IMPULSE_SIZE)):
            high = terms[k] >> CARRY_BITS
            ti.atomic_add(impulses[chunk % rows, row][k], terms[k] - (high << CARRY_BITS))
            ti.atomic_add(impulses[chunk % rows, row][IMPULSE_SIZE + k], high)

    @ti.func
    def add_impulse(chunk, w, i, normal, force, torque, dt):
        row = walls.impulse_row[w]
        if row >= 0:
            time = ti.cast(dt, ti.f64)
            impulse = -time * ti.cast(force, ti.f64)
            angular_impulse = -time * ti.cast(torque, ti.f64)
            arm = ti.cast(particles.position[i], ti.f64) - ti.cast(walls.pivot[w], ti.f64)
            angular_impulse += arm.cross(impulse)
            units = ti.cast(per_unit(), ti.f64)
            terms = ti.Vector.zero(ti.i64, 2 * IMPULSE_SIZE)
            for axis in ti.static(range(3)):
                terms[axis] = to_units(units[UNIT_IMPULSE] * impulse[axis])
                terms[3 + axis] = to_units(units[UNIT_ANGULAR_IMPULSE] * angular_impulse[axis])
            terms[6] = -to_units(units[UNIT_IMPULSE] * impulse.dot(ti.cast(normal, ti.f64)))
            if ti.static(shared):
                add_to_shared(chunk, row, terms)
            else:
                impulses[chunk, row] = carried(impulses[chunk, row] + terms, IMPULSE_SIZE)

    return add_impulse


def build_carry_impulses(state: State) -> Any:
    """Device function (chunk): move the carries of a row that chunks share, once per step and not beside
    additions.

    Writes:  impulses
    """
    impulses = state.control.impulses
    rows = state.capacities.wall_rows
    measured = state.capacities.measured_walls

    @ti.func
    def carry_impulses(chunk):
        if chunk < rows:
            for row in range(measured):
                impulses[chunk, row] = carried(impulses[chunk, row], IMPULSE_SIZE)

    return carry_impulses


def wall_impulses(state: State) -> dict[str, np.ndarray]:
    """Time integrals since the start of each measured wall by name.

    Returns:  arrays (7,) float64: impulse (3) [N s], angular impulse (3) [N m s] and normal impulse [N s] of
              the particles on the wall; empty without measured walls
    """
    if state.control.impulses is None:
        return {}
    sums = state.ranks.total(state.control.impulses.to_numpy())
    units = state.plan.sum_units
    unit = np.array([units.impulse] * 3 + [units.angular_impulse] * 3 + [units.impulse])
    return {
        name: exact_totals(sums[:, row], unit) for row, name in enumerate(state.plan.scene.measured_walls)
    }
