"""One time step: integrate the particles, move the walls, compute the forces at the new positions.

Integration is the leapfrog form of velocity Verlet. Between two steps, positions and forces are at t,
velocities and angular velocities half a step earlier. A kick changes the velocity, a drift the position:

    v(t + dt/2) = v(t - dt/2) + dt F(t) / m          x(t + dt) = x(t) + dt v(t + dt/2)

Dashpots need the velocity at the time of the positions; it is extrapolated with the force at t:

    velocity_synchronized = v(t + dt/2) + dt F(t) / (2 m)

and for viscous forces of cohesion models the angular velocity as well.

Walls with a prescribed motion take the next of the poses that the host has uploaded (`walls.py`);
force-controlled walls move by the force that the particles exerted on them (`wall_dynamics.py`), and
particles that are attached to a wall move with it (`attached.py`). The widths of a deforming box change
before the particles move (`deformation.py`). Then the forces are summed: weight, wall
contacts, particle contacts (`contact.py`, on a CPU `batch.py`), external forces and damping
(`particle_forces.py`). All sums are exact (`sums.py`), so that their order does not matter.

Consecutive particles form a chunk, on a GPU each particle is one. `integrate` and `forces` process one chunk
and write to its particles only: a pair across two chunks is evaluated in both. Therefore chunks can be
processed in any order, by any number of threads, with the same bits. Between the two phases, all threads must
have finished:

    CPU    one launch takes many steps. Workers take one chunk after the other; a barrier separates the two
           phases (`CpuSteps`, `threads.py`).
    GPU    each step is a launch of two dispatches; each chunk is a task (`GpuStep`).

A particle that has moved by more than its reach since the last neighbor-list rebuild requests the next one;
a force, a displacement or a position beyond its limit requests an abort. All later phases of the launch, or
all later launches on a GPU, then do nothing until the host has reacted (`stepper.py`). No step
transfers anything to the host.

In all device functions, `dt` is the time step [s] of the integration or force evaluation; it is 0 in a force
evaluation without motion. The member `time_step` of the structs for contact models is `dt`, or for normal
models the longest time step of the run instead of 0.

Device functions write `a[i] = a[i] + b`: Taichi compiles `a[i] += b` on a field to an atomic operation, which
costs more than the whole contact model and is not needed within a chunk.
"""

from collections.abc import Callable
from typing import NamedTuple

from granflow.engine.attached import AttachedParticles
from granflow.engine.batch import BatchedContacts, ContactSums
from granflow.engine.box import ParticleWrap
from granflow.engine.clumps import ClumpMotion
from granflow.engine.codes import (
    ABORT_DISPLACEMENT,
    ABORT_FORCE,
    ABORT_NOT_FINITE,
    ABORT_OVERLAP,
    PHASE_FORCES,
    PHASE_INTEGRATION,
)
from granflow.engine.contact import Accounting, Contact
from granflow.engine.deformation import DeformingBox
from granflow.engine.fields import build_tasks_of_thread, thread_count
from granflow.engine.flows import Flows
from granflow.engine.gravity import Gravity
from granflow.engine.history import CONTACT_ORDER, transfers_history
from granflow.engine.liquid import LiquidFilms
from granflow.engine.pair import normal_time_step
from granflow.engine.particle_forces import Damping, ExternalForces
from granflow.engine.state import CACHE_LINE, CPU_STRIDE, State
from granflow.engine.sums import VelocitySum, build_to_grid, holds_sums, shares_rows
from granflow.engine.threads import arrive, release, wait
from granflow.engine.wall_dynamics import ForceControlledWalls, WallImpulses
from granflow.geometry.sphere import sphere_inertia
from granflow.kernel_language import ti
from granflow.plan.sum_units import SUM_BITS, UNIT_FORCE, UNIT_TORQUE


def build_steps(state: State) -> Callable[..., None]:
    """The kernel of the time steps on the device of the state."""
    return build_cpu_steps(state) if state.backend.on_cpu else build_gpu_step(state)


LARGEST_SUM_SQUARED = 2.0 ** (2 * SUM_BITS)
"""Largest squared sum of forces or torques in units: below it, all sums are exact."""


class TimeStep:
    """The phases of a step: `integrate` for each chunk, `move_walls` once, `forces` for each chunk.

    Reads:   position, velocity, velocity_synchronized, angular_velocity, angular_velocity_synchronized,
             force, torque, mass, radius, fixed, attached_to, clump, external_force, position_at_rebuild,
             reach, neighbor lists, history, in_contact, walls; as `AttachedParticles`, `ClumpMotion`,
             `Gravity`, `ForceControlledWalls`, `ParticleWrap`, `Contact`, `BatchedContacts`,
             `ExternalForces`, `Damping` and `Flows`
    Writes:  position, velocity, velocity_synchronized, angular_velocity, angular_velocity_synchronized,
             force, torque, rebuild_requested, abort, abort_particle; as these, `Accounting`, `WallImpulses`,
             `LiquidFilms` and `VelocitySum`
    """

    def __init__(self, state: State) -> None:
        features = state.plan.features
        self.features = features
        self.particles = state.particles
        self.neighbors = state.neighbors
        self.control = state.control
        self.real = state.backend.real
        self.chunk_size = state.parameter("chunk_size")
        self.gravity = state.built(Gravity)
        self.shift = state.parameter("shift")
        self.per_unit = state.parameter("per_unit")
        # Integration
        self.travel_limit_squared = state.parameter("travel_limit_squared")
        self.carries_impulses = state.control.impulses is not None and shares_rows(state)
        self.impulses = state.built(WallImpulses)
        self.films = state.built(LiquidFilms) if features.liquid_transfer else None
        self.has_flows = len(features.flows) > 0
        self.flows = state.built(Flows) if self.has_flows else None
        self.longest_time_step = state.parameter("longest_time_step")
        self.clumps = state.built(ClumpMotion)
        self.equal_spheres = state.parameter("equal_spheres") if features.one_size else None
        self.velocity_sum = VelocitySum(state, "velocity")
        self.rotation_sum = VelocitySum(state, "angular_velocity")
        self.counts_damping = features.damping != "none" and features.energy_budget
        self.periodic = features.periodic != "none"
        self.particle_wrap = state.built(ParticleWrap)
        # Walls
        self.force_controlled = features.force_controlled_walls
        self.controlled_walls = state.built(ForceControlledWalls)
        self.attaches = features.attached_particles
        self.attached = state.built(AttachedParticles) if self.attaches else None
        self.deforms = features.deforming_box
        self.deformation = state.built(DeformingBox) if self.deforms else None
        self.moves_walls_first = (self.attaches and self.force_controlled) or self.deforms
        # Forces
        self.exact = holds_sums(state)
        self.batched = state.batch is not None
        self.sets_forces_last = not self.exact or features.external_forces or features.damping != "none"
        self.has_walls = state.plan.features.walls
        self.transfers = transfers_history(state)
        self.accounting = state.built(Accounting)
        self.to_grid = build_to_grid(state.backend.real)
        self.wall_contact = state.built(Contact, True) if self.has_walls else None
        self.particle_contact = None if self.batched else state.built(Contact, False)
        self.batched_contacts = state.built(BatchedContacts) if self.batched else None
        self.sums = state.built(ContactSums) if self.batched else None
        self.external_forces = state.built(ExternalForces) if features.external_forces else None
        self.damping = state.built(Damping) if features.damping != "none" else None

    # Integration

    @ti.func
    def integrate(self, chunk, count, pose, dt):
        """Kick and drift the particles of one chunk, check their limits, wrap them into the periodic box."""
        if ti.static(self.carries_impulses):
            self.impulses.carry(chunk)
        if ti.static(self.has_flows):
            self.flows.begin_step(chunk)
        size = self.chunk_size()
        gravity = ti.cast(self.gravity.before(pose), self.real)
        shift = self.shift()[UNIT_FORCE]
        per_unit = self.per_unit()
        limit_squared = self.travel_limit_squared()
        spheres = ti.Vector.zero(self.real, 2)
        if ti.static(self.features.one_size):
            spheres = self.equal_spheres()
        for i in range(chunk * size, ti.min((chunk + 1) * size, count)):
            if ti.static(self.features.liquid_transfer):
                self.films.save(i)
            if ti.static(self.features.clumps):
                displacement = 0.0 * self.particles.position[i]
                if self.clumps.moves(i):
                    if ti.static(self.has_flows):
                        self.flows.integrate(i, dt)
                    displacement = self.clumps.move(chunk, i, pose, dt)
                    if ti.static(self.features.external_forces and self.features.energy_budget):
                        velocity = self.particles.velocity[i]
                        self.external_forces.add_work(
                            chunk, i, self.particles.external_force[i], velocity, dt
                        )
                else:
                    displacement = self._kick_and_drift(chunk, i, spheres, gravity, shift, pose, dt)
                self._check_limits(i, displacement, limit_squared, per_unit)
            else:
                displacement = self._kick_and_drift(chunk, i, spheres, gravity, shift, pose, dt)
                self._check_limits(i, displacement, limit_squared, per_unit)
            if ti.static(self.periodic):
                self.particle_wrap.wrap(chunk, i, pose, dt)

    @ti.func
    def _kick_and_drift(self, chunk, i, spheres, gravity, shift, pose, dt):
        """Kick and drift a sphere that is in no clump or a fixed one, or move it with its wall; returns its
        displacement [m].

        spheres:  radius [m] and mass [kg] of all particles with the feature `one_size`
        """
        if ti.static(self.has_flows):
            self.flows.integrate(i, dt)
        radius, mass = spheres[0], spheres[1]
        if ti.static(not self.features.one_size):
            radius, mass = self.particles.radius[i], self.particles.mass[i]
        force = self.particles.force[i] + self._weight_rest(mass * gravity, shift)
        kick = self.particles.mobility(i) * dt / mass * force
        change = kick
        if ti.static(self.deforms):
            change = kick + self.deformation.kick(chunk, i, kick)
        velocity = self.velocity_sum.changed(i, change)
        self.particles.velocity[i] = velocity
        if ti.static(self.features.synchronized):
            self.particles.velocity_synchronized[i] = velocity + 0.5 * kick
        if ti.static(self.features.external_forces and self.features.energy_budget):
            self.external_forces.add_work(chunk, i, self.particles.external_force[i], velocity, dt)
        if ti.static(self.features.changing_gravity):
            self.gravity.add_work(chunk, i, velocity, pose, dt)
        displacement = dt * velocity
        before = self.particles.position[i]
        self.particles.position[i] = before + displacement
        if ti.static(self.features.rotation):  # a sphere needs no orientation and no gyroscopic term
            inertia = sphere_inertia(mass, radius)
            kick_of_rotation = self.particles.mobility(i) * dt / inertia * self.particles.torque[i]
            angular_velocity = self.rotation_sum.changed(i, kick_of_rotation)
            self.particles.angular_velocity[i] = angular_velocity
            if ti.static(self.features.viscous_cohesion):
                self.particles.angular_velocity_synchronized[i] = angular_velocity + 0.5 * kick_of_rotation
        if ti.static(self.counts_damping):
            self.damping.add_loss(chunk, i, dt)
        if ti.static(self.attaches):
            if self.particles.attached_to[i] >= 0:
                displacement = self.attached.move(i, before, pose, dt)
        return displacement

    @ti.func
    def _weight_rest(self, weight, shift):
        """What rounding takes from the weight [N] in a sum of forces; 0 unless `holds_sums`.

        It is below 2e-14 of the largest force of a contact.
        """
        rest = 0.0 * weight
        if ti.static(self.exact):
            rest = weight - self.to_grid(weight, shift)
        return rest

    @ti.func
    def _check_limits(self, i, displacement, limit_squared, per_unit):
        """Request a rebuild if a particle has moved by more than its reach, an abort if it exceeds a limit.

        displacement:   in this step [m]
        limit_squared:  of the displacement [m2], see `plan.travel_limit`
        """
        total_squared = (self.particles.position[i] - self.particles.position_at_rebuild[i]).norm_sqr()
        reach_squared = self.particles.reach[i] * self.particles.reach[i]
        if ti.static(self.deforms):
            total_squared = (self.particles.position[i] - self.deformation.affine_position(i)).norm_sqr()
            reach_squared = self.deformation.reach_squared(i)
        step_squared = displacement.norm_sqr()
        sum_squared = self._square_of_sums(i, per_unit)
        # One branch per particle: with one for each limit, the whole step takes 8 % longer.
        is_usual = (
            (total_squared <= reach_squared)
            & (step_squared <= limit_squared)
            & (sum_squared <= LARGEST_SUM_SQUARED)
        )
        if not is_usual:
            abort = 0
            if total_squared > reach_squared:
                self.control.rebuild_requested[0] = 1
            elif not total_squared <= reach_squared:  # NaN fails both comparisons
                abort = ti.max(abort, ABORT_NOT_FINITE)
            if sum_squared > LARGEST_SUM_SQUARED:
                abort = ti.max(abort, ABORT_FORCE)
            # Above this limit a particle could pass another one, or a wall, between two force evaluations.
            if step_squared > limit_squared:
                abort = ti.max(abort, ABORT_DISPLACEMENT)
            if abort > 0:
                ti.atomic_max(self.control.abort[0], abort)
                ti.atomic_min(self.control.abort_particle[0], self.particles.id[i])

    @ti.func
    def _square_of_sums(self, i, per_unit):
        """The larger of the squared force and torque in units of the sums."""
        square = (ti.cast(per_unit[UNIT_FORCE], ti.f64) * ti.cast(self.particles.force[i], ti.f64)).norm_sqr()
        if ti.static(self.features.rotation):
            torque = ti.cast(self.particles.torque[i], ti.f64)
            square = ti.max(square, (ti.cast(per_unit[UNIT_TORQUE], ti.f64) * torque).norm_sqr())
        return square

    # Walls

    @ti.func
    def move_walls(self, chunks, pose, dt):
        """Move the force-controlled walls, and the faces of a deforming box, by one step, on one thread.

        It follows the integration, which does not read walls; it precedes that of particles that are attached
        to walls, or in a deforming box.
        """
        if ti.static(self.force_controlled):
            self.controlled_walls.move(chunks, pose, dt)
        if ti.static(self.deforms):
            self.deformation.move(chunks, dt)

    # Forces

    @ti.func
    def forces(self, worker, chunk, count, pose, dt):
        """Force and torque on the particles of one chunk, at the time of the positions.

        With batches, the wall contacts of all particles of the chunk are summed first, then the particle
        contacts. External forces and damping need the sum of all others, and are added last by `set_forces`,
        as is the weight below f64. In f64 without external forces and damping there is nothing to add: the
        fields of force and torque already hold the total.
        """
        size = self.chunk_size()
        gravity = ti.cast(self.gravity.after(pose), self.real)
        first = chunk * size
        end = ti.min((chunk + 1) * size, count)
        self.accounting.clear_ahead(chunk)
        if ti.static(self.force_controlled):
            self.controlled_walls.clear(chunk)
        if ti.static(self.deforms):
            self.deformation.clear(chunk)
        for i in range(first, end):
            force_sum, torque_sum = self._sum_scalar_contacts(chunk, i, gravity, pose, dt)
            if ti.static(self.batched):
                self.sums.store(worker, i, first, force_sum, torque_sum)
            else:
                self._set_forces(chunk, i, force_sum, torque_sum, gravity, dt)
        if ti.static(self.batched):
            self.batched_contacts.add(worker, chunk, first, end, pose, dt)
        if ti.static(self.batched and self.sets_forces_last):
            for i in range(first, end):
                force_sum, torque_sum = self.sums.load(worker, i, first)
                self._set_forces(chunk, i, force_sum, torque_sum, gravity, dt)
        if ti.static(self.attaches):
            for i in range(first, end):
                if self.particles.attached_to[i] >= 0:
                    self.attached.add_to_wall(chunk, i, pose, dt)
                    if ti.static(self.has_flows):
                        self.flows.give_to_wall(chunk, i, normal_time_step(dt, self.longest_time_step()))
        self.accounting.carry(chunk)

    @ti.func
    def _sum_scalar_contacts(self, chunk, i, gravity, pose, dt):
        """Sums of force and torque on one particle over its wall contacts and, without batches, its particle
        contacts; in f64 also the rounded weight.

        The kick adds what rounding has taken from the weight. (A further loop over the particles, which adds
        the weight to the sums, takes an eighth of the time of the forces.)

        Wall contacts that can pass from one face to another are evaluated in several passes, see
        `history.py`.
        """
        force_sum = ti.Vector.zero(ti.f64, 3)
        torque_sum = ti.Vector.zero(ti.f64, 3)
        if ti.static(self.has_flows):
            self.flows.begin(chunk, i, normal_time_step(dt, self.longest_time_step()), dt)
        if ti.static(self.exact):
            force_sum = self.to_grid(self.particles.mass[i] * gravity, self.shift()[UNIT_FORCE])
            if ti.static(self.features.clumps):  # the weight of a clump acts at its center of mass
                if self.particles.clump[i] >= 0:
                    force_sum = ti.Vector.zero(ti.f64, 3)
            if ti.static(self.attaches):  # the wall carries the weight
                if self.particles.attached_to[i] >= 0:
                    force_sum = ti.Vector.zero(ti.f64, 3)
        if ti.static(self.has_walls):
            for pass_index in range(ti.static(len(CONTACT_ORDER) if self.transfers else 1)):
                for list_index in range(self.neighbors.list_begin[i], self.neighbors.list_walls_end[i]):
                    if self._is_in_pass(list_index, pass_index) == 1:
                        force, torque = self.wall_contact.evaluate(
                            chunk, i, list_index, self.neighbors.partner[list_index], pose, dt
                        )
                        force_sum, torque_sum = self._with_contact(force, torque, force_sum, torque_sum)
        if ti.static(not self.batched):
            for list_index in range(self.neighbors.list_walls_end[i], self.neighbors.list_end[i]):
                force, torque = self.particle_contact.evaluate(
                    chunk, i, list_index, self.neighbors.partner[list_index], pose, dt
                )
                force_sum, torque_sum = self._with_contact(force, torque, force_sum, torque_sum)
        return force_sum, torque_sum

    @ti.func
    def _is_in_pass(self, list_index, pass_index):
        chosen = 1
        if ti.static(self.transfers):
            wanted = ti.Vector(CONTACT_ORDER)[pass_index]
            chosen = ti.cast(self.neighbors.in_contact[list_index] == wanted, ti.i32)
        return chosen

    @ti.func
    def _with_contact(self, force, torque, force_sum, torque_sum):
        """The sums with the rounded force and torque of one contact."""
        force_added = self.to_grid(force, self.shift()[UNIT_FORCE])
        torque_added = self.to_grid(torque, self.shift()[UNIT_TORQUE])
        return force_sum + ti.cast(force_added, ti.f64), torque_sum + ti.cast(torque_added, ti.f64)

    @ti.func
    def _set_forces(self, chunk, i, force_sum, torque_sum, gravity, dt):
        """Set force and torque from the sums over the contacts; below f64 with the weight, which in f64 the
        sums contain; with external forces and damping."""
        force = ti.cast(force_sum, self.real)
        torque = ti.cast(torque_sum, self.real)
        if ti.static(self.attaches):
            if self.particles.attached_to[i] < 0:
                force = self._with_body_forces(chunk, i, force, gravity, dt)
        else:
            force = self._with_body_forces(chunk, i, force, gravity, dt)
        if ti.static(self.features.damping != "none"):
            is_damped = True
            if ti.static(self.features.clumps):  # the damping of a clump is added to the sum over its spheres
                is_damped = self.particles.clump[i] < 0
            if is_damped:
                damping_force, damping_torque = self.damping.forces(chunk, i, force, torque, dt)
                force += damping_force
                torque += damping_torque
        self.particles.force[i] = force
        if ti.static(self.features.rotation):
            self.particles.torque[i] = torque

    @ti.func
    def _with_body_forces(self, chunk, i, force_sum, gravity, dt):
        """The force with the weight, which sums in f64 contain, and external forces."""
        force = force_sum
        if ti.static(self.features.clumps and not self.exact):
            if self.particles.clump[i] < 0:  # the weight of a clump acts at its center of mass
                force += self.particles.mass[i] * gravity
        elif ti.static(not self.exact):
            force += self.particles.mass[i] * gravity
        if ti.static(self.features.external_forces):
            force += self.external_forces.force(chunk, i, force, dt)
        return force


# CPU: one launch for many steps


class CpuLaunch(NamedTuple):
    """Arguments of the kernel for up to `steps` steps on a CPU, in their order; the defaults do nothing.

    pose:             index of the poses of the walls in the first step
    dt:               time step [s]
    moving, forcing:  whether to integrate, and to compute forces
    """

    steps: int = 0
    workers: int = 1
    chunk_count: int = 0
    particle_count: int = 0
    pose: int = 0
    dt: float = 0.0
    moving: int = 1
    forcing: int = 1


def build_cpu_steps(state: State) -> Callable[..., None]:
    """Kernel for several steps on a CPU; its arguments are those of `CpuLaunch`.

    Reads:   as the phases
    Writes:  as the phases; rebuild_due, steps_done, running, and the fields of the barrier
    """
    control = state.control
    real = state.backend.real
    cpu_steps = CpuSteps(state)

    @ti.kernel
    def step_on_cpu(
        steps: ti.i32,
        workers: ti.i32,
        chunks: ti.i32,
        count: ti.i32,
        pose: ti.i32,
        dt: real,
        moving: ti.i32,
        forcing: ti.i32,
    ):
        control.worker_count[0] = workers
        control.next_chunk[CACHE_LINE] = 0
        control.arrived[CACHE_LINE] = 0
        control.arrived[2 * CACHE_LINE] = 0
        control.released[CACHE_LINE] = 0
        control.running[0] = ti.cast(
            steps > 0 and control.rebuild_due[0] == 0 and control.abort[0] == 0, ti.i32
        )
        if ti.static(cpu_steps.step.moves_walls_first):
            if moving == 1 and control.running[0] == 1:
                cpu_steps.step.move_walls(chunks, pose, dt)
        for task in range(workers * CPU_STRIDE):
            if task % CPU_STRIDE == 0:
                launch = ti.Struct(
                    worker=task // CPU_STRIDE,
                    steps=steps,
                    chunks=chunks,
                    count=count,
                    pose=pose,
                    dt=dt,
                    moving=moving,
                    forcing=forcing,
                )
                cpu_steps.work(launch)

    return step_on_cpu


class CpuSteps:
    """What one worker does in a launch: `launch` is a struct of its number and the arguments of the kernel.

    Workers process one chunk after the other; a barrier separates the phases. Taking chunks dynamically
    balances the load, and does not affect the results, because each chunk writes to its particles only.
    """

    def __init__(self, state: State) -> None:
        self.control = state.control
        self.step = TimeStep(state)

    @ti.func
    def work(self, launch: ti.template()):
        """Steps of one worker, until the launch ends or the worker leaves it."""
        barrier_number = 0
        left = 0
        computes_forces = 1 - launch.moving
        while left == 0 and self.control.running[0] == 1:
            pose_now = launch.pose + self.control.steps_done[0]
            chunk = self._next_chunk()
            if computes_forces == 0:
                while chunk < launch.chunks:
                    self.step.integrate(chunk, launch.count, pose_now, launch.dt)
                    chunk = self._next_chunk()
            else:
                while chunk < launch.chunks:
                    self.step.forces(launch.worker, chunk, launch.count, pose_now, launch.dt)
                    chunk = self._next_chunk()
            barrier_number += 1  # one barrier in the code for both phases: compiled once
            left = self._barrier(launch, barrier_number, computes_forces)
            if launch.moving == 1:
                computes_forces = 1 - computes_forces

    @ti.func
    def _next_chunk(self):
        """Index of the next chunk of this phase; at least the number of chunks if none is left."""
        return ti.atomic_add(self.control.next_chunk[CACHE_LINE], 1)

    @ti.func
    def _barrier(self, launch: ti.template(), number, computes_forces):
        """Wait for all workers; the last one prepares the next phase. Returns 1 if this worker leaves the
        launch.

        Polling atomic counters takes 1 us; waking the threads of Taichi for each phase takes 60 us.
        """
        left = 0
        if arrive(self.control, number) == 1:
            self._prepare_phase(launch, number, computes_forces)
            release(self.control, number)
        else:
            left = wait(self.control, number)
        return left

    @ti.func
    def _prepare_phase(self, launch: ti.template(), number, computes_forces):
        """Move the walls after the integration, count the step after the forces, and decide whether to
        continue."""
        self.control.next_chunk[CACHE_LINE] = 0
        if ti.static(self.step.force_controlled and not self.step.moves_walls_first):
            if computes_forces == 0:
                pose = launch.pose + self.control.steps_done[0]
                self.step.move_walls(launch.chunks, pose, launch.dt)
        # A step that ends with an overlap above the limit is complete: the host decides how to go on.
        is_valid = self.control.abort[0] == 0 or self.control.abort[0] == ABORT_OVERLAP
        if computes_forces == 1 and self.control.rebuild_due[0] == 0 and is_valid:
            self.control.steps_done[0] = self.control.steps_done[0] + 1
        self.control.rebuild_due[0] = self.control.rebuild_requested[0]
        # A launch without force phases (forcing 0) ends at its first barrier.
        continues = self.control.steps_done[0] < launch.forcing * launch.steps
        continues = continues and self.control.rebuild_due[0] == 0 and self.control.abort[0] == 0
        if number == 1:
            self.control.started_count[0] = self.control.worker_count[0]
        if computes_forces == 1 and self.control.worker_count[0] < self.control.started_count[0]:
            # Without a worker the rest of a launch costs more than the start of the next one.
            continues = False
        if ti.static(self.step.moves_walls_first):
            if computes_forces == 1 and launch.moving == 1 and continues:
                pose = launch.pose + self.control.steps_done[0]
                self.step.move_walls(launch.chunks, pose, launch.dt)
        self.control.running[0] = ti.cast(continues, ti.i32)


# GPU: one launch of two dispatches for each step


class GpuLaunch(NamedTuple):
    """Arguments of the kernel for one step on a GPU, in their order; the defaults do nothing.

    number:        number of the launch
    steps_before:  number of steps before it since the flags were read

    The others are those of `CpuLaunch`.
    """

    number: int = 0
    steps_before: int = 1
    chunk_count: int = 0
    particle_count: int = 0
    pose: int = 0
    dt: float = 0.0
    moving: int = 1
    forcing: int = 1


def build_gpu_step(state: State) -> Callable[..., None]:
    """Kernel for one step on a GPU; its arguments are those of `GpuLaunch`.

    The host launches many steps before it reads a flag. A launch whose phase requests a rebuild or aborts
    records its number in `halted_at`; all later launches then do nothing. A phase compares numbers that no
    task of the same phase can change for it, so that all of its tasks decide alike, and no serial task is
    needed between the phases.

    Reads:   as the phases
    Writes:  as the phases; halted_at, steps_done
    """
    control = state.control
    real = state.backend.real
    most_chunks = state.plan.capacities.chunks
    gpu_step = GpuStep(state)
    integrate = build_tasks_of_thread(gpu_step.integrate, most_chunks)
    compute_forces = build_tasks_of_thread(gpu_step.forces, most_chunks)
    # The loops have constant lengths: Taichi computes any other length in a dispatch of its own.
    threads = thread_count(most_chunks)

    @ti.kernel
    def step_on_gpu(
        number: ti.i32,
        steps_before: ti.i32,
        chunks: ti.i32,
        count: ti.i32,
        pose: ti.i32,
        dt: real,
        moving: ti.i32,
        forcing: ti.i32,
    ):
        if ti.static(gpu_step.step.moves_walls_first):  # a dispatch of its own
            if (
                moving == 1
                and ti.min(control.halted_at[PHASE_INTEGRATION], control.halted_at[PHASE_FORCES]) >= number
            ):
                gpu_step.step.move_walls(chunks, pose, dt)
        for thread in range(threads):
            if (
                moving == 1
                and ti.min(control.halted_at[PHASE_INTEGRATION], control.halted_at[PHASE_FORCES]) >= number
            ):
                launch = ti.Struct(
                    number=number, steps_before=steps_before, chunks=chunks, count=count, pose=pose, dt=dt
                )
                integrate(thread, chunks, launch)
        for thread in range(threads):
            if forcing == 1 and control.halted_at[PHASE_INTEGRATION] > number:
                if control.halted_at[PHASE_FORCES] >= number:
                    launch = ti.Struct(number=number, count=count, pose=pose, dt=dt)
                    compute_forces(thread, chunks, launch)

    return step_on_gpu


class GpuStep:
    """What one task does in a launch: `launch` is a struct of the arguments of the kernel."""

    def __init__(self, state: State) -> None:
        self.control = state.control
        self.step = TimeStep(state)

    @ti.func
    def integrate(self, chunk, launch):
        """Integrate one chunk; the first task also moves the walls, which the integration does not read."""
        if chunk == 0:
            self.control.steps_done[0] = launch.steps_before
            if ti.static(not self.step.moves_walls_first):
                self.step.move_walls(launch.chunks, launch.pose, launch.dt)
        self.step.integrate(chunk, launch.count, launch.pose, launch.dt)
        self._record_halt(PHASE_INTEGRATION, launch.number)

    @ti.func
    def forces(self, chunk, launch):
        """Compute the forces of one chunk."""
        self.step.forces(0, chunk, launch.count, launch.pose, launch.dt)
        self._record_halt(PHASE_FORCES, launch.number)

    @ti.func
    def _record_halt(self, phase: ti.template(), number):
        """Record that this launch requests a rebuild or aborts; each task that does so sees its own
        request."""
        if self.control.abort[0] != 0 or (
            phase == PHASE_INTEGRATION and self.control.rebuild_requested[0] == 1
        ):
            if self.control.halted_at[phase] != number:
                self.control.halted_at[phase] = number


# A kick outside of the steps


def build_kick(state: State) -> Callable[..., None]:
    """Kernel (count, time [s], pose, first_id): change velocities by the present forces; backwards if the
    time is negative.

        v += time F / m,   w += time M / I,   I = (2/5) m R^2

    The start of a run shifts all velocities back by half a step, a change of the time step by half of the
    difference, an insertion those of the particles with ids from `first_id` on. Fixed particles keep their
    velocity; of clumps the state changes, not yet the velocities of the spheres. `pose` is the index of the
    poses at the present time.

    Reads:   id, force, torque, mass, radius, fixed, clump; as `ClumpMotion`
    Writes:  velocity, angular_velocity; clump_velocity, clump_angular_momentum
    """
    particles = state.particles
    rotation = state.plan.features.rotation
    real = state.backend.real
    clumps = state.plan.features.clumps
    clump_motion = state.built(ClumpMotion)

    @ti.kernel
    def kick(count: ti.i32, time: real, pose: ti.i32, first_id: ti.i32):
        for i in range(count):
            if particles.id[i] < first_id:
                continue
            if ti.static(clumps):
                if clump_motion.moves(i):
                    clump_motion.kick(i, time, pose)
                    continue
            particles.velocity[i] = (
                particles.velocity[i] + particles.mobility(i) * time / particles.mass[i] * particles.force[i]
            )
            if ti.static(rotation):
                inertia = sphere_inertia(particles.mass[i], particles.radius[i])
                particles.angular_velocity[i] = (
                    particles.angular_velocity[i]
                    + particles.mobility(i) * time / inertia * particles.torque[i]
                )

    return kick
