"""Kernel of a time step on a GPU, in two dispatches: integration, then contact forces; each chunk is a task.

The host launches many steps before it reads a flag. A step that requests a rebuild, or aborts, records the
number of its launch in `halted_at`; all later launches then do nothing. A phase compares numbers that no task
of the same phase can change for it, so that all of its tasks decide alike, and no serial task is needed
between the phases.
"""

from collections.abc import Callable
from typing import Any

from granflow.engine.batch import build_batched_forces
from granflow.engine.box import build_wrap
from granflow.engine.clumps import build_integrate_clumps, build_kick_clump
from granflow.engine.codes import ABORT_DISPLACEMENT, ABORT_FORCE, ABORT_NOT_FINITE, FORCES, INTEGRATION
from granflow.engine.contact import build_carry_sums, build_clear_wall_work_ahead, build_contact
from granflow.engine.fields import build_tasks_of_thread, thread_count
from granflow.engine.history import CONTACT_ORDER, transfers_history
from granflow.engine.liquid import build_begin_step
from granflow.engine.pair import build_mobility
from granflow.engine.particle_forces import build_add_damping_loss, build_add_external_work, build_set_forces
from granflow.engine.state import CACHE_LINE, CPU_STRIDE, State
from granflow.engine.sums import build_changed, build_to_grid, build_weight_rest, holds_sums
from granflow.engine.threads import arrive, release, wait
from granflow.engine.wall_dynamics import build_add_wall_force, build_carry_impulses, build_move_walls
from granflow.kernel_language import ti
from granflow.plan.capacities import FORCE, SUM_BITS, TORQUE

# Contact forces on one chunk of particles: wall contacts one at a time, particle contacts in batches on a
# CPU.
#
# Forces and torques are summed exactly, see `exact_sums`. Sums are written `a[i] = a[i] + b`: Taichi
# compiles `a[i] += b` on a field to an atomic operation, which costs more than the whole contact model and
# is not needed within a chunk.


def _build_passes(state: State) -> tuple[int, Any]:
    """Number of passes over the walls of a particle, and device function (list index, pass number).

    The function returns 1 if the entry is evaluated in this pass; see CONTACT_ORDER.

    Reads:  in_contact
    """
    neighbors = state.neighbors
    pass_count = len(CONTACT_ORDER) if transfers_history(state) else 1

    @ti.func
    def in_this_pass(list_index, pass_index):
        chosen = 1
        if ti.static(pass_count > 1):
            chosen = ti.cast(neighbors.in_contact[list_index] == ti.Vector(CONTACT_ORDER)[pass_index], ti.i32)
        return chosen

    return pass_count, in_this_pass


def _build_particle_forces(state: State) -> Any:
    """Device function (chunk, i, acceleration, pose, time_step): sums of the forces and torques on one
    particle.

    Those of walls and, without batches, of particles; in f64 with the rounded weight. Integration adds the
    rest of the weight. A further loop over the particles, which adds the weight to the sums, takes an eighth
    of the time of the forces.

    Reads:   mass, neighbor lists, and as `build_contact`
    Writes:  as `build_contact`
    """
    plan = state.plan
    neighbors = state.neighbors
    particles = state.particles
    exact = holds_sums(state)
    batched = state.batch is not None
    shift = state.parameter("shift", FORCE)
    shift_torque = state.parameter("shift", TORQUE)
    to_grid = build_to_grid(state.backend.real)
    particle_contact = None if batched else build_contact(state, False)
    wall_contact = build_contact(state, True) if plan.has_walls else None
    pass_count, in_this_pass = _build_passes(state)

    @ti.func
    def add_contact(force, torque, force_sum, torque_sum):
        force_added, torque_added = to_grid(force, shift()), to_grid(torque, shift_torque())
        return force_sum + ti.cast(force_added, ti.f64), torque_sum + ti.cast(torque_added, ti.f64)

    @ti.func
    def particle_forces(chunk, i, acceleration, pose, dt):
        force_sum, torque_sum = ti.Vector.zero(ti.f64, 3), ti.Vector.zero(ti.f64, 3)
        if ti.static(exact):
            force_sum = to_grid(particles.mass[i] * acceleration, shift())
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

    return particle_forces


def _build_sums_of(state: State) -> Any:
    """Device function (worker, i, place in the chunk): sums of the forces and torques on a particle after the
    batches.

    Reads:  force, torque; or the sums of the batch, see `holds_sums`
    """
    particles = state.particles
    batch = state.batch
    exact = holds_sums(state)
    rotation = state.plan.features.rotation

    @ti.func
    def sums_of(worker, i, local):
        force_sum, torque_sum = ti.Vector.zero(ti.f64, 3), ti.Vector.zero(ti.f64, 3)
        if ti.static(exact):
            force_sum = particles.force[i]
            if ti.static(rotation):
                torque_sum = particles.torque[i]
        else:
            sums = batch.sums[worker, local]
            force_sum = ti.Vector([sums[0], sums[1], sums[2]])
            if ti.static(rotation):
                torque_sum = ti.Vector([sums[3], sums[4], sums[5]])
        return force_sum, torque_sum

    return sums_of


def build_forces(state: State) -> Any:
    """Device function (worker, chunk, count, pose, time_step): force and torque on the particles of one
    chunk.

    Forces are at the time of the positions and include the weight. A pair across two chunks is evaluated in
    both, so that no two workers write to the same particle.

    Reads:   position, velocity, velocity_synchronized, angular_velocity, radius, mass, neighbor lists, walls
    Writes:  force, torque, history, losses, impulses, wall forces, abort
    """
    features = state.plan.features
    particles = state.particles
    batch = state.batch
    exact = holds_sums(state)
    adds_others = features.external_forces or features.damping != "none"
    chunk_size = state.parameter("chunk_size")
    gravity = state.parameter("gravity")
    real = state.backend.real
    batched = batch is not None
    set_forces = build_set_forces(state)
    carry_sums = build_carry_sums(state)
    batched_forces = build_batched_forces(state) if batched else None
    particle_forces = _build_particle_forces(state)
    sums_of = _build_sums_of(state)
    force_controlled = features.force_controlled_walls
    clear_wall_work_ahead = build_clear_wall_work_ahead(state)
    clear_wall_forces, _add = build_add_wall_force(state) if force_controlled else (None, None)

    @ti.func
    def forces(worker, chunk, count, pose, dt):
        size = chunk_size()
        acceleration = ti.cast(gravity(), real)
        first, last = chunk * size, ti.min((chunk + 1) * size, count)
        clear_wall_work_ahead(chunk)
        if ti.static(force_controlled):
            clear_wall_forces(chunk)
        for i in range(first, last):
            force_sum, torque_sum = particle_forces(chunk, i, acceleration, pose, dt)
            if ti.static(batched and exact):
                particles.force[i] = force_sum
                if ti.static(features.rotation):
                    particles.torque[i] = torque_sum
            elif ti.static(batched):
                for axis in ti.static(range(3)):
                    batch.sums[worker, i - first][axis] = force_sum[axis]
                    if ti.static(features.rotation):
                        batch.sums[worker, i - first][3 + axis] = torque_sum[axis]
            else:
                set_forces(chunk, i, force_sum, torque_sum, acceleration, dt)
        if ti.static(batched):
            batched_forces(worker, chunk, first, last, pose, dt)
        if ti.static(batched and (adds_others or not exact)):
            for i in range(first, last):
                force_sum, torque_sum = sums_of(worker, i, i - first)
                set_forces(chunk, i, force_sum, torque_sum, acceleration, dt)
        carry_sums(chunk)

    return forces


def build_gpu_step(state: State, integrate: Any, forces: Any) -> Callable[..., None]:
    """Kernel for one step on a GPU.

    integrate, forces:  device functions of `build_integrate` and `build_forces`

    Arguments: number of the launch, number of steps before it since the flags were read, number of chunks,
    particle count, pose, time step [s], and whether to integrate (`moving`) and compute forces (`forcing`).

    The loops have constant lengths: Taichi computes any other length in a dispatch of its own.

    Reads:   as the phases
    Writes:  as the phases; halted_at, steps_done
    """
    control = state.control
    real = state.backend.real
    most_chunks = state.plan.capacities.chunks
    threads = thread_count(most_chunks)
    move, compute_forces = (
        build_tasks_of_thread(body, most_chunks) for body in _build_phases(state, integrate, forces)
    )

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
            if moving == 1 and ti.min(control.halted_at[INTEGRATION], control.halted_at[FORCES]) >= number:
                launch = ti.Struct(
                    number=number, steps_before=steps_before, chunks=chunks, count=count, pose=pose, dt=dt
                )
                move(thread, chunks, launch)
        for thread in range(threads):
            if forcing == 1 and control.halted_at[INTEGRATION] > number:
                if control.halted_at[FORCES] >= number:
                    launch = ti.Struct(number=number, count=count, pose=pose, dt=dt)
                    compute_forces(thread, chunks, launch)

    return step_on_gpu


def _build_phases(state: State, integrate: Any, forces: Any) -> tuple[Any, Any]:
    """Device functions (chunk, launch) of the integration and of the forces; `launch`: arguments of the
    kernel."""
    control = state.control
    force_controlled = state.plan.features.force_controlled_walls
    move_walls = build_move_walls(state) if force_controlled else None

    @ti.func
    def record_halt(phase: ti.template(), number):
        """Record that this launch requests a rebuild or aborts; each task that does so sees its own
        request."""
        if control.abort[0] != 0 or (phase == INTEGRATION and control.rebuild_requested[0] == 1):
            if control.halted_at[phase] != number:
                control.halted_at[phase] = number

    @ti.func
    def move(chunk, launch):
        if chunk == 0:
            control.steps_done[0] = launch.steps_before
            if ti.static(force_controlled):
                move_walls(launch.chunks, launch.pose, launch.dt)
        integrate(chunk, launch.count, launch.pose, launch.dt)
        record_halt(INTEGRATION, launch.number)

    @ti.func
    def compute_forces(chunk, launch):
        forces(0, chunk, launch.count, launch.pose, launch.dt)
        record_halt(FORCES, launch.number)

    return move, compute_forces


# Time integration of one chunk of particles: the leapfrog form of velocity Verlet.
#
# Before a step, positions and forces are at t, velocities and angular velocities half a step earlier:
#
#     v(t + dt/2) = v(t - dt/2) + dt F(t) / m          x(t + dt) = x(t) + dt v(t + dt/2)
#
# Dashpots need the velocity at the time of the positions; it is extrapolated with the force at t:
#
#     velocity_synchronized = v(t + dt/2) + dt F(t) / (2 m)

LIMIT_SQUARED = 2.0 ** (2 * SUM_BITS)
"""Largest squared sum of forces or torques in units: below it, all sums are exact."""


def build_integrate(state: State) -> Any:
    """Device function (chunk, count, pose, time_step): kick and drift the particles of one chunk.

    Requests a rebuild if a particle has moved by more than its reach since the last one; aborts if a position
    is not finite, a displacement in one step exceeds `plan.travel_limit`, or a force the range of exact sums.

    Reads:   parameters, force, torque, mass, radius, fixed, position_at_rebuild, reach
    Writes:  velocity, velocity_synchronized, angular_velocity, position, rebuild_requested, abort,
             abort_particle, external_work, losses, impulses; as `build_changed`, `build_wrap`,
             `build_begin_step`, `build_move_clump`
    """
    particles = state.particles
    features = state.plan.features
    periodic = features.periodic != "none"
    counts_damping = features.damping != "none" and features.energy_budget
    step_limit = state.parameter("travel_limit_squared")
    wrap = build_wrap(state) if periodic else None
    add_work = build_add_external_work(state)
    carry_impulses = build_carry_impulses(state)
    add_damping_loss = build_add_damping_loss(state) if counts_damping else None
    weight_rest = build_weight_rest(state)
    begin_step = build_begin_step(state)
    mobility = build_mobility(state)
    square_of_sums = _build_square_of_sums(state)
    request = _build_request(state)
    real = state.backend.real
    changed_velocity, changed_rotation = (
        build_changed(state, name) for name in ("velocity", "angular_velocity")
    )
    integrate_clumps = build_integrate_clumps(state, request, square_of_sums) if features.clumps else None
    gravity, shift, per_unit, chunk_size = map(
        state.parameter, ("gravity", "shift", "per_unit", "chunk_size")
    )

    @ti.func
    def integrate(chunk, count, pose, dt):
        carry_impulses(chunk)
        size = chunk_size()
        step_squared_limit = step_limit()
        acceleration = ti.cast(gravity(), real)
        shift_of_force = shift()[FORCE]
        units = per_unit()
        for i in range(chunk * size, ti.min((chunk + 1) * size, count)):
            if ti.static(features.clumps):
                if particles.clump[i] >= 0:
                    continue
            begin_step(i)
            mass = particles.mass[i]
            force = particles.force[i]
            torque = 0.0 * particles.force[i]
            kick = mobility(i) * dt / mass * (force + weight_rest(mass * acceleration, shift_of_force))
            velocity = changed_velocity(i, kick)
            if ti.static(features.rate_dependent):
                particles.velocity_synchronized[i] = velocity + 0.5 * kick
            particles.velocity[i] = (
                velocity  # an assignment: Taichi compiles `+=` on a field to an atomic operation
            )
            if ti.static(features.external_forces and features.energy_budget):
                add_work(chunk, i, particles.external_force[i], velocity, dt)
            step_displacement = dt * velocity
            position = particles.position[i] + step_displacement
            particles.position[i] = position
            if ti.static(features.rotation):
                torque = particles.torque[i]  # a sphere needs no orientation and no gyroscopic term
                inertia = 0.4 * mass * particles.radius[i] * particles.radius[i]
                particles.angular_velocity[i] = changed_rotation(i, mobility(i) * dt / inertia * torque)
            if ti.static(counts_damping):
                add_damping_loss(chunk, i, dt)
            displacement = (position - particles.position_at_rebuild[i]).norm_sqr()
            reach = particles.reach[i]
            step = step_displacement.norm_sqr()
            sums = square_of_sums(force, torque, units)
            # One branch per particle: with one for each limit, the whole step takes 8 % longer.
            is_usual = (
                (displacement <= reach * reach) & (step <= step_squared_limit) & (sums <= LIMIT_SQUARED)
            )
            if not is_usual:
                request(i, displacement, reach * reach, step, step_squared_limit, sums)
            if ti.static(periodic):
                wrap(chunk, i, pose, dt)
        if ti.static(features.clumps):
            integrate_clumps(chunk, count, pose, dt)

    return integrate


def _build_request(state: State) -> Any:
    """Device function: request a rebuild or an abort because of particle i.

    Arguments: i, squares of the displacement since the last rebuild and of the reach [m^2], squares of the
    displacement in this step and of its limit [m^2], `square_of_sums`.

    Writes:  rebuild_requested, abort, abort_particle
    """
    particles = state.particles
    control = state.control

    @ti.func
    def request(i, displacement, reach, step, step_squared_limit, sums):
        abort = 0
        if displacement > reach:
            control.rebuild_requested[0] = 1
        elif not displacement <= reach:  # NaN fails both comparisons
            abort = ti.max(abort, ABORT_NOT_FINITE)
        if sums > LIMIT_SQUARED:
            abort = ti.max(abort, ABORT_FORCE)
        # Above this limit a particle could pass another one, or a wall, between two force evaluations.
        if step > step_squared_limit:
            abort = ti.max(abort, ABORT_DISPLACEMENT)
        if abort > 0:
            ti.atomic_max(control.abort[0], abort)
            ti.atomic_min(control.abort_particle[0], particles.id[i])

    return request


def _build_square_of_sums(state: State) -> Any:
    """Device function (force, torque, per_unit): the larger of their squares in units; sums are exact below a
    limit."""
    rotation = state.plan.features.rotation

    @ti.func
    def square_of_sums(force, torque, units):
        square = (ti.cast(units[FORCE], ti.f64) * ti.cast(force, ti.f64)).norm_sqr()
        if ti.static(rotation):
            square = ti.max(square, (ti.cast(units[TORQUE], ti.f64) * ti.cast(torque, ti.f64)).norm_sqr())
        return square

    return square_of_sums


def build_kick(state: State) -> Any:
    """Kernel (count, time [s]): change velocities by the present forces; backwards if the time is negative.

        v += time F / m,   w += time M / I,   I = (2/5) m R^2

    Fixed particles keep their velocity; of clumps the state changes, not yet the velocities of the spheres.

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
                inertia = 0.4 * particles.mass[i] * particles.radius[i] * particles.radius[i]
                particles.angular_velocity[i] = (
                    particles.angular_velocity[i] + mobility(i) * time / inertia * particles.torque[i]
                )

    return kick


# Kernels of the time step: integration, wall motion and contact forces, in one launch for many steps on a
# CPU.
#
# If a neighbor-list rebuild is due, all further phases of a launch do nothing.


def build_steps(state: State) -> Callable[..., None]:
    """The kernel of the time steps on the device of the state."""
    build = build_cpu_steps if state.backend.on_cpu else build_gpu_step
    return build(state, build_integrate(state), build_forces(state))


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
    """Device functions of one worker in a launch; `launch` is a struct of its number and the arguments of the
    kernel.

    Workers process one chunk after the other; a barrier separates the phases. Taking chunks dynamically
    balances the load, and does not affect the results, because each chunk writes to its particles only.
    """

    def __init__(self, state: State, integrate: Any, forces: Any) -> None:
        self.control = state.control
        self.force_controlled = state.plan.features.force_controlled_walls
        self.move_walls = build_move_walls(state) if self.force_controlled else None
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
                self.move_walls(launch.chunks, pose, launch.dt)
        if computes_forces == 1 and self.control.rebuild_due[0] == 0 and self.control.abort[0] == 0:
            self.control.steps_done[0] = self.control.steps_done[0] + 1
        self.control.rebuild_due[0] = self.control.rebuild_requested[0]
        continues = self.control.steps_done[0] < launch.forcing * launch.steps
        continues = continues and self.control.rebuild_due[0] == 0 and self.control.abort[0] == 0
        if number == 1:
            self.control.started_count[0] = self.control.worker_count[0]
        if computes_forces == 1 and self.control.worker_count[0] < self.control.started_count[0]:
            continues = (
                False  # without a worker the rest of a launch costs more than the start of the next one
            )
        self.control.running[0] = ti.cast(continues, ti.i32)
