"""One time step: integrate the particles, move the walls, compute the forces at the new positions.

Integration is the leapfrog form of velocity Verlet. Between two steps, positions and forces are at t,
velocities and angular velocities half a step earlier. A kick changes the velocity, a drift the position:

    v(t + dt/2) = v(t - dt/2) + dt F(t) / m          x(t + dt) = x(t) + dt v(t + dt/2)

Dashpots need the velocity at the time of the positions; it is extrapolated with the force at t:

    velocity_synchronized = v(t + dt/2) + dt F(t) / (2 m)

Walls with a prescribed motion take the next of the poses that the host has uploaded (`walls.py`);
force-controlled walls move by the force that the particles exerted on them (`wall_dynamics.py`). Then the
forces are summed: weight, wall contacts, particle contacts (`contact.py`, on a CPU `batch.py`), external
forces and damping (`particle_forces.py`). All sums are exact (`sums.py`), so that their order does not
matter.

Consecutive particles form a chunk, on a GPU each particle is one. `integrate` and `forces` process one chunk
and write to its particles only: a pair across two chunks is evaluated in both. Therefore chunks can be
processed in any order, by any number of threads, with the same bits. Between the two phases, all threads must
have finished:

    CPU    one launch takes many steps. Workers take one chunk after the other; a barrier separates the two
           phases (`CpuSteps`, `threads.py`).
    GPU    each step is a launch of two dispatches; each chunk is a task (`build_gpu_step`).

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
from typing import Any

from granflow.engine.batch import build_batched_forces, build_load_sums, build_store_sums
from granflow.engine.box import ParticleWrap
from granflow.engine.clumps import build_integrate_clumps, build_kick_clump
from granflow.engine.codes import (
    ABORT_DISPLACEMENT,
    ABORT_FORCE,
    ABORT_NOT_FINITE,
    PHASE_FORCES,
    PHASE_INTEGRATION,
)
from granflow.engine.contact import build_carry_sums, build_clear_wall_work_ahead, build_contact
from granflow.engine.fields import build_tasks_of_thread, thread_count
from granflow.engine.history import CONTACT_ORDER, transfers_history
from granflow.engine.liquid import build_save_film
from granflow.engine.particle_forces import (
    build_add_damping_loss,
    build_add_external_work,
    build_mobility,
    build_set_forces,
)
from granflow.engine.state import CACHE_LINE, CPU_STRIDE, State
from granflow.engine.sums import build_changed, build_to_grid, build_weight_rest, holds_sums, shares_rows
from granflow.engine.threads import arrive, release, wait
from granflow.engine.transported import build_clear_flows, build_integrate_properties
from granflow.engine.wall_dynamics import ForceControlledWalls, WallImpulses
from granflow.geometry.shape import sphere_inertia
from granflow.kernel_language import ti
from granflow.plan.sum_units import SUM_BITS, UNIT_FORCE, UNIT_TORQUE


def build_steps(state: State) -> Callable[..., None]:
    """The kernel of the time steps on the device of the state."""
    build = build_cpu_steps if state.backend.on_cpu else build_gpu_step
    return build(state, build_integrate(state), build_forces(state))


# Integration


def build_integrate(state: State) -> Any:
    """Device function (chunk, count, pose, dt): kick and drift the particles of one chunk.

    Reads:   parameters, position, velocity, angular_velocity, force, torque, mass, radius, fixed,
             position_at_rebuild, reach
    Writes:  velocity, velocity_synchronized, angular_velocity, position, external_work, losses, impulses; as
             `_build_request`, `build_changed`, `ParticleWrap`, `build_save_film`, `build_integrate_clumps`
    """
    particles = state.particles
    features = state.plan.features
    real = state.backend.real
    periodic = features.periodic != "none"
    counts_damping = features.damping != "none" and features.energy_budget
    gravity_parameter = state.parameter("gravity")
    shift_parameter = state.parameter("shift")
    per_unit_parameter = state.parameter("per_unit")
    chunk_size = state.parameter("chunk_size")
    travel_limit_squared = state.parameter("travel_limit_squared")
    mobility = build_mobility(state)
    weight_rest = build_weight_rest(state)
    changed_velocity = build_changed(state, "velocity")
    changed_rotation = build_changed(state, "angular_velocity")
    square_of_sums = _build_square_of_sums(state)
    request = _build_request(state)
    carries_impulses = state.control.impulses is not None and shares_rows(state)
    impulses = state.built(WallImpulses)
    save_film = build_save_film(state) if features.liquid_transfer else None
    has_flows = len(features.transported) > 0
    integrate_properties = build_integrate_properties(state) if has_flows else None
    add_work = build_add_external_work(state)
    add_damping_loss = build_add_damping_loss(state) if counts_damping else None
    particle_wrap = state.built(ParticleWrap)
    integrate_clumps = build_integrate_clumps(state, request, square_of_sums) if features.clumps else None

    @ti.func
    def integrate(chunk, count, pose, dt):
        if ti.static(carries_impulses):
            impulses.carry(chunk)
        size = chunk_size()
        limit_squared = travel_limit_squared()
        gravity = ti.cast(gravity_parameter(), real)
        shift = shift_parameter()[UNIT_FORCE]
        per_unit = per_unit_parameter()
        for i in range(chunk * size, ti.min((chunk + 1) * size, count)):
            if ti.static(features.clumps):
                if particles.clump[i] >= 0:
                    continue
            if ti.static(features.liquid_transfer):
                save_film(i)
            if ti.static(has_flows):
                integrate_properties(i, dt)
            mass = particles.mass[i]
            force = particles.force[i]
            torque = 0.0 * particles.force[i]
            kick = mobility(i) * dt / mass * (force + weight_rest(mass * gravity, shift))
            velocity = changed_velocity(i, kick)
            if ti.static(features.rate_dependent):
                particles.velocity_synchronized[i] = velocity + 0.5 * kick
            particles.velocity[i] = velocity
            if ti.static(features.external_forces and features.energy_budget):
                add_work(chunk, i, particles.external_force[i], velocity, dt)
            step_displacement = dt * velocity
            position = particles.position[i] + step_displacement
            particles.position[i] = position
            if ti.static(features.rotation):
                torque = particles.torque[i]  # a sphere needs no orientation and no gyroscopic term
                inertia = sphere_inertia(mass, particles.radius[i])
                particles.angular_velocity[i] = changed_rotation(i, mobility(i) * dt / inertia * torque)
            if ti.static(counts_damping):
                add_damping_loss(chunk, i, dt)
            displacement_squared = (position - particles.position_at_rebuild[i]).norm_sqr()
            reach_squared = particles.reach[i] * particles.reach[i]
            step_squared = step_displacement.norm_sqr()
            sum_squared = square_of_sums(force, torque, per_unit)
            # One branch per particle: with one for each limit, the whole step takes 8 % longer.
            is_usual = (
                (displacement_squared <= reach_squared)
                & (step_squared <= limit_squared)
                & (sum_squared <= LARGEST_SUM_SQUARED)
            )
            if not is_usual:
                request(i, displacement_squared, reach_squared, step_squared, limit_squared, sum_squared)
            if ti.static(periodic):
                particle_wrap.wrap(chunk, i, pose, dt)
        if ti.static(features.clumps):
            integrate_clumps(chunk, count, pose, dt)

    return integrate


LARGEST_SUM_SQUARED = 2.0 ** (2 * SUM_BITS)
"""Largest squared sum of forces or torques in units: below it, all sums are exact."""


def _build_square_of_sums(state: State) -> Any:
    """Device function (force, torque, per_unit): the larger of their squares in units of the sums."""
    rotation = state.plan.features.rotation

    @ti.func
    def square_of_sums(force, torque, per_unit):
        square = (ti.cast(per_unit[UNIT_FORCE], ti.f64) * ti.cast(force, ti.f64)).norm_sqr()
        if ti.static(rotation):
            square = ti.max(
                square, (ti.cast(per_unit[UNIT_TORQUE], ti.f64) * ti.cast(torque, ti.f64)).norm_sqr()
            )
        return square

    return square_of_sums


def _build_request(state: State) -> Any:
    """Device function: request a rebuild or an abort because of particle i.

    Arguments: i; the squares [m^2] of the displacement since the last rebuild, of the reach, of the
    displacement in this step and of its limit, `plan.travel_limit`; and the result of `square_of_sums`.

    Writes:  rebuild_requested, abort, abort_particle
    """
    particles = state.particles
    control = state.control

    @ti.func
    def request(i, displacement_squared, reach_squared, step_squared, limit_squared, sum_squared):
        abort = 0
        if displacement_squared > reach_squared:
            control.rebuild_requested[0] = 1
        elif not displacement_squared <= reach_squared:  # NaN fails both comparisons
            abort = ti.max(abort, ABORT_NOT_FINITE)
        if sum_squared > LARGEST_SUM_SQUARED:
            abort = ti.max(abort, ABORT_FORCE)
        # Above this limit a particle could pass another one, or a wall, between two force evaluations.
        if step_squared > limit_squared:
            abort = ti.max(abort, ABORT_DISPLACEMENT)
        if abort > 0:
            ti.atomic_max(control.abort[0], abort)
            ti.atomic_min(control.abort_particle[0], particles.id[i])

    return request


# Forces


def build_forces(state: State) -> Any:
    """Device function (worker, chunk, count, pose, dt): force and torque on the particles of one
    chunk, at the time of the positions.

    With batches, the wall contacts of all particles of the chunk are summed first, then the particle
    contacts. External forces and damping need the sum of all others, and are added last by
    `particle_forces.build_set_forces`, as is the weight below f64. In f64 without external forces and damping
    there is nothing to add: the fields of force and torque already hold the total.

    Reads:   position, velocity, velocity_synchronized, angular_velocity, radius, mass, neighbor lists, walls
    Writes:  force, torque, history, losses, impulses, wall forces, abort
    """
    features = state.plan.features
    real = state.backend.real
    batched = state.batch is not None
    sets_forces_last = not holds_sums(state) or features.external_forces or features.damping != "none"
    chunk_size = state.parameter("chunk_size")
    gravity_parameter = state.parameter("gravity")
    start_sums = _build_start_sums(state)
    batched_forces = build_batched_forces(state) if batched else None
    store_sums = build_store_sums(state) if batched else None
    load_sums = build_load_sums(state) if batched else None
    set_forces = build_set_forces(state)
    force_controlled = features.force_controlled_walls
    controlled_walls = state.built(ForceControlledWalls)
    clear_wall_work_ahead = build_clear_wall_work_ahead(state)
    carry_sums = build_carry_sums(state)

    @ti.func
    def forces(worker, chunk, count, pose, dt):
        size = chunk_size()
        gravity = ti.cast(gravity_parameter(), real)
        first = chunk * size
        end = ti.min((chunk + 1) * size, count)
        clear_wall_work_ahead(chunk)
        if ti.static(force_controlled):
            controlled_walls.clear(chunk)
        for i in range(first, end):
            force_sum, torque_sum = start_sums(chunk, i, gravity, pose, dt)
            if ti.static(batched):
                store_sums(worker, i, first, force_sum, torque_sum)
            else:
                set_forces(chunk, i, force_sum, torque_sum, gravity, dt)
        if ti.static(batched):
            batched_forces(worker, chunk, first, end, pose, dt)
        if ti.static(batched and sets_forces_last):
            for i in range(first, end):
                force_sum, torque_sum = load_sums(worker, i, first)
                set_forces(chunk, i, force_sum, torque_sum, gravity, dt)
        carry_sums(chunk)

    return forces


def _build_start_sums(state: State) -> Any:
    """Device function (chunk, i, gravity, pose, dt): sums of force and torque on one particle.

    Summed are the rounded weight in f64, the wall contacts and, without batches, the particle contacts. The
    kick adds what rounding has taken from the weight. (A further loop over the particles, which adds the
    weight to the sums, takes an eighth of the time of the forces.)

    Wall contacts that can pass from one face to another are evaluated in several passes, see `history.py`.

    Reads:   mass, neighbor lists, in_contact, and as `build_contact`
    Writes:  as `build_contact`
    """
    plan = state.plan
    neighbors = state.neighbors
    particles = state.particles
    exact = holds_sums(state)
    batched = state.batch is not None
    transfers = transfers_history(state)
    pass_count = len(CONTACT_ORDER) if transfers else 1
    shift = state.parameter("shift", UNIT_FORCE)
    shift_torque = state.parameter("shift", UNIT_TORQUE)
    to_grid = build_to_grid(state.backend.real)
    wall_contact = build_contact(state, True) if plan.has_walls else None
    particle_contact = None if batched else build_contact(state, False)
    has_flows = len(plan.features.transported) > 0
    clear_flows = build_clear_flows(state) if has_flows else None

    @ti.func
    def in_this_pass(list_index, pass_index):
        chosen = 1
        if ti.static(transfers):
            chosen = ti.cast(neighbors.in_contact[list_index] == ti.Vector(CONTACT_ORDER)[pass_index], ti.i32)
        return chosen

    @ti.func
    def add_contact(force, torque, force_sum, torque_sum):
        force_added = to_grid(force, shift())
        torque_added = to_grid(torque, shift_torque())
        return force_sum + ti.cast(force_added, ti.f64), torque_sum + ti.cast(torque_added, ti.f64)

    @ti.func
    def start_sums(chunk, i, gravity, pose, dt):
        force_sum = ti.Vector.zero(ti.f64, 3)
        torque_sum = ti.Vector.zero(ti.f64, 3)
        if ti.static(has_flows):
            clear_flows(i)
        if ti.static(exact):
            force_sum = to_grid(particles.mass[i] * gravity, shift())
            if ti.static(plan.features.clumps):  # the weight of a clump acts at its center of mass
                force_sum *= ti.cast(particles.clump[i] < 0, ti.f64)
        if ti.static(plan.has_walls):
            for pass_index in range(pass_count):
                for list_index in range(neighbors.list_begin[i], neighbors.list_walls_end[i]):
                    if in_this_pass(list_index, pass_index) == 1:
                        force, torque = wall_contact(
                            chunk, i, list_index, neighbors.partner[list_index], pose, dt
                        )
                        force_sum, torque_sum = add_contact(force, torque, force_sum, torque_sum)
        if ti.static(not batched):
            for list_index in range(neighbors.list_walls_end[i], neighbors.list_end[i]):
                force, torque = particle_contact(
                    chunk, i, list_index, neighbors.partner[list_index], pose, dt
                )
                force_sum, torque_sum = add_contact(force, torque, force_sum, torque_sum)
        return force_sum, torque_sum

    return start_sums


# CPU: one launch for many steps


def build_cpu_steps(state: State, integrate: Any, forces: Any) -> Callable[..., None]:
    """Kernel for up to `steps` steps on a CPU.

    integrate, forces:  device functions of `build_integrate` and `build_forces`

    Arguments: steps, workers, number of chunks, particle count, pose, time step [s], and whether to integrate
    (`moving`) and compute forces (`forcing`).

    Reads:   as the phases
    Writes:  as the phases; rebuild_due, steps_done, running, and the fields of the barrier
    """
    control = state.control
    real = state.backend.real
    cpu_steps = CpuSteps(state, integrate, forces)

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

    def __init__(self, state: State, integrate: Any, forces: Any) -> None:
        self.control = state.control
        self.force_controlled = state.plan.features.force_controlled_walls
        self.controlled_walls = state.built(ForceControlledWalls)
        self.integrate = integrate
        self.forces = forces

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
                    self.integrate(chunk, launch.count, pose_now, launch.dt)
                    chunk = self._next_chunk()
            else:
                while chunk < launch.chunks:
                    self.forces(launch.worker, chunk, launch.count, pose_now, launch.dt)
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
        if ti.static(self.force_controlled):
            if computes_forces == 0:
                pose = launch.pose + self.control.steps_done[0]
                self.controlled_walls.move(launch.chunks, pose, launch.dt)
        if computes_forces == 1 and self.control.rebuild_due[0] == 0 and self.control.abort[0] == 0:
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
        self.control.running[0] = ti.cast(continues, ti.i32)


# GPU: one launch of two dispatches for each step


def build_gpu_step(state: State, integrate: Any, forces: Any) -> Callable[..., None]:
    """Kernel for one step on a GPU.

    integrate, forces:  device functions of `build_integrate` and `build_forces`

    Arguments: number of the launch, number of steps before it since the flags were read, number of chunks,
    particle count, pose, time step [s], and whether to integrate (`moving`) and compute forces (`forcing`).

    The host launches many steps before it reads a flag. A launch whose phase requests a rebuild or aborts
    records its number in `halted_at`; all later launches then do nothing. A phase compares numbers that no
    task of the same phase can change for it, so that all of its tasks decide alike, and no serial task is
    needed between the phases.

    Reads:   as the phases
    Writes:  as the phases; halted_at, steps_done
    """
    control = state.control
    real = state.backend.real
    force_controlled = state.plan.features.force_controlled_walls
    controlled_walls = state.built(ForceControlledWalls)
    most_chunks = state.plan.capacities.chunks
    # The loops have constant lengths: Taichi computes any other length in a dispatch of its own.
    threads = thread_count(most_chunks)

    @ti.func
    def record_halt(phase: ti.template(), number):
        """Record that this launch requests a rebuild or aborts; each task that does so sees its own
        request."""
        if control.abort[0] != 0 or (phase == PHASE_INTEGRATION and control.rebuild_requested[0] == 1):
            if control.halted_at[phase] != number:
                control.halted_at[phase] = number

    @ti.func
    def move_chunk(chunk, launch):
        if chunk == 0:
            control.steps_done[0] = launch.steps_before
            if ti.static(force_controlled):
                controlled_walls.move(launch.chunks, launch.pose, launch.dt)
        integrate(chunk, launch.count, launch.pose, launch.dt)
        record_halt(PHASE_INTEGRATION, launch.number)

    @ti.func
    def compute_forces_of_chunk(chunk, launch):
        forces(0, chunk, launch.count, launch.pose, launch.dt)
        record_halt(PHASE_FORCES, launch.number)

    move = build_tasks_of_thread(move_chunk, most_chunks)
    compute_forces = build_tasks_of_thread(compute_forces_of_chunk, most_chunks)

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
        for thread in range(threads):
            if (
                moving == 1
                and ti.min(control.halted_at[PHASE_INTEGRATION], control.halted_at[PHASE_FORCES]) >= number
            ):
                launch = ti.Struct(
                    number=number, steps_before=steps_before, chunks=chunks, count=count, pose=pose, dt=dt
                )
                move(thread, chunks, launch)
        for thread in range(threads):
            if forcing == 1 and control.halted_at[PHASE_INTEGRATION] > number:
                if control.halted_at[PHASE_FORCES] >= number:
                    launch = ti.Struct(number=number, count=count, pose=pose, dt=dt)
                    compute_forces(thread, chunks, launch)

    return step_on_gpu


# A kick outside of the steps


def build_kick(state: State) -> Callable[..., None]:
    """Kernel (count, time [s]): change velocities by the present forces; backwards if the time is negative.

        v += time F / m,   w += time M / I,   I = (2/5) m R^2

    The start of a run shifts all velocities back by half a step, a change of the time step by half of the
    difference. Fixed particles keep their velocity; of clumps the state changes, not yet the velocities of
    the spheres.

    Reads:   force, torque, mass, radius, fixed, clump
    Writes:  velocity, angular_velocity; clumps as `build_kick_clump`
    """
    particles = state.particles
    rotation = state.plan.features.rotation
    real = state.backend.real
    mobility = build_mobility(state)
    clumps = state.plan.features.clumps
    kick_clump = build_kick_clump(state) if clumps else None

    @ti.kernel
    def kick(count: ti.i32, time: real):
        for i in range(count):
            if ti.static(clumps):
                if particles.clump[i] >= 0:
                    kick_clump(i, time)
                    continue
            particles.velocity[i] = (
                particles.velocity[i] + mobility(i) * time / particles.mass[i] * particles.force[i]
            )
            if ti.static(rotation):
                inertia = sphere_inertia(particles.mass[i], particles.radius[i])
                particles.angular_velocity[i] = (
                    particles.angular_velocity[i] + mobility(i) * time / inertia * particles.torque[i]
                )

    return kick
