"""The phases of a time step, in order: integration, neighbor-list rebuild if it is due, contact forces.

One launch takes many steps on a CPU and one on a GPU, see `GpuStepper`. If a particle has moved by more than
its reach, all further phases of the launch do nothing until the host has rebuilt the neighbor list, so that
no step needs a transfer to the host. If the list capacity is too small, the host reallocates the fields and
repeats the rebuild.
"""

import time as clock
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

from granflow.engine.attached import attach
from granflow.engine.backend import free_device_memory
from granflow.engine.codes import ABORT_LEFT_DOMAIN, ABORT_OVERLAP, NO_PARTICLE, NOT_HALTED, PHASE_FORCES
from granflow.engine.contact import build_end_ahead
from granflow.engine.flows import build_withdraw
from granflow.engine.host import HistoryTable, HostParticles, saved_particle_table
from granflow.engine.neighbor.rebuild import NeighborListRebuild, Rebuild
from granflow.engine.particle_forces import write_force_inputs
from granflow.engine.state import BATCH, LANES, DeviceFlags, State, read_flags
from granflow.engine.step import CpuLaunch, GpuLaunch, build_steps
from granflow.engine.sums import shares_rows
from granflow.engine.threads import Workers
from granflow.engine.walls import WallPoses
from granflow.kernel_language import ti
from granflow.plan.capacities import Capacities
from granflow.plan.cost import estimate_memory, refuse_growth

SAMPLE_EVERY = 256
"""Interval in steps between sampled steps, whose phases are timed separately."""


class Stepper:
    """Advances a State by steps.

    state:       device data
    on_deleted:  see the class of the rebuild, `NeighborListRebuild`

    `stop_signal`: number of the signal that another MPI rank has received, otherwise 0. `clock_at_rebuild`:
    state of the clock at the last rebuild, None before the first.
    """

    LONGEST_LAUNCH = 2**30
    """Largest number of steps of a launch: the kernel counts them in 32 bits."""
    EMPTY_LAUNCH: CpuLaunch | GpuLaunch = CpuLaunch()

    def __init__(self, state: State, on_deleted: Callable[..., None]) -> None:
        self.state = state
        self.stop_signal = 0
        self.timing = Timing()
        self.steps_since_rebuild = 0
        self.clock_at_rebuild: dict[str, float] | None = None
        self._since_sample = 0
        self._rebuild = self._new_rebuild(on_deleted)
        self._workers = Workers(state)
        self.poses = WallPoses(state)
        self._compile()

    def _new_rebuild(self, on_deleted: Callable[..., None]) -> Rebuild:
        """What rebuilds the neighbor lists."""
        return NeighborListRebuild(self.state, on_deleted, self.grow_neighbor_lists)

    def _compile(self) -> None:
        """Compile all phases, unless the state has them, by launching them on empty ranges."""
        began = clock.perf_counter()
        state = self.state
        self._rebuild.compile()
        self._take_steps = state.built(build_steps)
        self._take_steps(*self.EMPTY_LAUNCH)
        self.timing.compile += clock.perf_counter() - began

    @contextmanager
    def _completing(self) -> Iterator[None]:
        """In the block, forces are computed also if a rebuild has aborted the run because a particle has left
        the domain: the state that is written is then that of the other particles at the end of this step."""
        if self.abort_code != ABORT_LEFT_DOMAIN:
            yield
            return
        particle = int(self.state.control.abort_particle[0])
        self._set_abort(0, NO_PARTICLE)
        yield
        self._set_abort(ABORT_LEFT_DOMAIN, particle)

    def _set_abort(self, code: int, particle: int) -> None:
        """Set the abort code and the id of its particle."""
        control = self.state.control
        control.abort[0], control.abort_particle[0] = code, particle

    def _prepare_workers(self) -> None:
        """Measure the pool of threads, if the next launch is the first with several workers."""
        began = clock.perf_counter()
        self._workers.prepare()
        self.timing.compile += clock.perf_counter() - began

    def rebuild_neighbor_lists(self, step: int, pose: int = 0) -> None:
        """Sort the particles, delete those outside the domain or in an outlet, and fill the neighbor lists.

        step:  number of the step to which the positions belong
        pose:  index of the wall poses at that time
        """
        began = clock.perf_counter()
        compiled = self.timing.compile
        self._prepare_workers()
        self._end_ahead(withdraws=False)
        self._rebuild.run(pose, self._workers.count)
        self.steps_since_rebuild = 0
        self.clock_at_rebuild = self.state.clock.state_dict() | {"step_count": step}
        self.timing.neighbor_list += clock.perf_counter() - began - (self.timing.compile - compiled)
        self.timing.rebuild_count += 1

    def restore(self, particles: HostParticles) -> None:
        """Put particles, in the order of ids, on an empty device with the lists of the last rebuild.

        The clock and the force-controlled walls are those of that rebuild; `clock_at_rebuild` is set here.
        """
        self.poses.discard()
        pose = self.poses.index_at(self.state.clock.step_count)
        self._prepare_workers()
        self._rebuild.restore(particles, pose, self._workers.count)
        self.clock_at_rebuild = self.state.clock.state_dict()
        self.poses.discard()

    def put(self, particles: HostParticles) -> None:
        """Put particles, in the order of their ids, on an empty device; `refresh` must follow."""
        self._rebuild.put(particles)

    def ids(self) -> np.ndarray:
        """Ids of all particles that neighbor lists can contain, in device order."""
        return self._rebuild.ids()

    def saved_particles(self) -> HostParticles:
        """The particles of the device, of this rank if there are several."""
        arrays = saved_particle_table(self.state).take(slice(0, self.state.count))
        return HostParticles(arrays, HistoryTable(self.state).read(self.ids(), self.state.count))

    def grow_neighbor_lists(self, needed: int, longest: int = 0) -> None:
        """Increase the arrays of the neighbor lists and build all kernels again.

        needed:   smallest number of list entries per segment
        longest:  smallest length of a list for which a batch suffices
        """
        self.timing.growth_count += 1
        self._grow(self.state.capacities.grown(needed, longest + BATCH + LANES))

    def _grow(self, capacities: Capacities) -> None:
        self.state.grow_neighbor_list(capacities, self._compile)

    def forces(self, pose: int = 0, history_step: float | None = None) -> None:
        """Forces at the present positions.

        pose:          index of the wall poses
        history_step:  time step [s] by which contact displacements change; 0: no change; None: the time step
        """
        self._prepare_workers()
        time_step = self.state.clock.time_step if history_step is None else history_step
        self._begin_count()
        if self.state.wall_dynamics is not None and shares_rows(self.state):
            self.state.wall_dynamics.wall_force.fill(0)  # otherwise cleared when the walls move
        if self.state.deformation is not None and shares_rows(self.state):
            self.state.deformation.virial.fill(0)
            self.state.deformation.face_force.fill(0)
        with self._completing():
            self._launch_step(1, pose, time_step, moving=0, forcing=1)

    def refresh(self, step: int, velocities_lag: bool) -> None:
        """Rebuild the neighbor lists and compute forces after step number `step`.

        It follows a change of particles or walls.

        `velocities_lag`: velocities are half a step behind the positions. Contact displacements do not
        change.
        """
        pose = self.poses.index_at(step)
        self._end_ahead(withdraws=True)
        if self.state.control.wall_flows is not None:
            self.state.built(build_withdraw)()
        self.rebuild_neighbor_lists(step, pose)
        self._attach(pose)
        self._write_force_inputs(step, velocities_lag)
        self.forces(pose, history_step=0.0)

    def _attach(self, pose: int) -> None:
        """Attach particles to their walls, see `attached.build_attach`."""
        attach(self.state, pose)

    def _write_force_inputs(self, step: int, velocities_lag: bool = True) -> None:
        """Write the clock of external forces and damping, for forces after step number `step`, if any."""
        if self.state.control.force_clock is not None:
            write_force_inputs(self.state, step, velocities_lag)

    def _end_ahead(self, withdraws: bool) -> None:
        """Clear the parts of losses and work that belong to the next step, see `build_end_ahead`."""
        if self.state.control.losses_ahead is not None:
            self.state.built(build_end_ahead)(int(withdraws))

    def advance(self, steps: int, step: int) -> int:
        """Take `steps` steps after step number `step`; returns the number of completed steps.

        It is smaller after an abort and, with an adaptive time step, after a neighbor-list rebuild, which
        adds candidate pairs.
        """
        done = 0
        rebuilds = self.timing.rebuild_count
        is_adaptive = self.state.plan.adaptive_time_step is not None
        while (
            done < steps
            and not self.abort_code
            and not (is_adaptive and self.timing.rebuild_count > rebuilds)
        ):
            done += self._advance_once(steps - done, step + done)
        return done

    def _clear_loss_heat(self) -> None:
        """Clear the heat of losses that the integration has taken, before a rebuild deletes particles."""
        for field in (self.state.particles.loss_heat, self.state.particles.loss_heat_ahead):
            if field is not None:
                field.fill(0)

    @property
    def abort_code(self) -> int:
        """0, or the abort code."""
        return int(self.state.control.abort[0])

    def permit_overlap(self, limit: float) -> None:
        """Go on after a step that has ended with an overlap above the limit, with a higher limit."""
        self.state.control.overlap_limit[0] = limit
        self.state.control.clear_abort()

    @property
    def _is_rebuild_due(self) -> bool:
        """Whether the last launch ended because the neighbor lists must be rebuilt."""
        return bool(self.state.control.rebuild_due[0])

    @property
    def _steps_done(self) -> int:
        """Number of completed steps since `_begin_count`."""
        return int(self.state.control.steps_done[0])

    def _begin_count(self) -> None:
        """Count the completed steps from 0."""
        self.state.control.steps_done[0] = 0

    def _advance_once(self, steps: int, step: int) -> int:
        """Take up to `steps` steps in one launch; rebuild the neighbor lists if due.

        Returns the number of completed steps.
        """
        state = self.state
        self._prepare_workers()
        steps = self._steps_of_launch(steps, step)
        self._begin_count()
        began = clock.perf_counter()
        rebuild_seconds = self.timing.neighbor_list
        self._write_force_inputs(step + 1)
        done = self._sampled_step() if self._is_sample_due else self._launch(steps)
        if self._is_rebuild_due and not self.abort_code:
            self._clear_loss_heat()
            self.rebuild_neighbor_lists(step + done + 1, self.poses.next + done)
            self._write_force_inputs(step + done + 1)
            self.forces(pose=self.poses.next + done)
            done += self._steps_done
        else:
            self.steps_since_rebuild += done
        self.poses.advance(done)
        self._since_sample += done
        self.timing.advance += clock.perf_counter() - began - (self.timing.neighbor_list - rebuild_seconds)
        self.timing.step_count += done
        self.timing.particle_steps += done * state.count
        return done

    def _steps_of_launch(self, steps: int, step: int) -> int:
        """Number of steps after step number `step` that the next launch takes, at most `steps`.

        Steps are split into launches here only, for three reasons: the device holds the poses of moving walls
        for POSE_COUNT steps, and they may move up to a limit between two rebuilds; a sampled step has its own
        launches; and a GPU takes STEPS_BETWEEN_READS steps until the host reads its flags.
        """
        steps = min(steps, self.LONGEST_LAUNCH)
        if self.state.plan.has_poses:
            steps = min(steps, self.poses.prepare(step, self.steps_since_rebuild))
        return 1 if self._is_sample_due else steps

    @property
    def _is_sample_due(self) -> bool:
        """Whether the phases of the next step are timed separately."""
        return self._since_sample >= SAMPLE_EVERY

    def _launch(self, steps: int) -> int:
        """Launch `steps` steps; returns the number of completed steps."""
        began = clock.perf_counter()
        self._launch_step(steps, self.poses.next, self.state.clock.time_step)
        done = self._steps_done
        if done:
            self._workers.record(done, clock.perf_counter() - began)
        return done

    def _launch_step(
        self, steps: int, pose: int, time_step: float, moving: int = 1, forcing: int = 1
    ) -> None:
        """One launch: `steps` steps on a CPU, one on a GPU.

        If `moving` or `forcing` is 0, only the other phase.
        """
        state = self.state
        workers = self._workers.count
        self._workers.place(workers)
        launch = CpuLaunch(
            steps=steps,
            workers=workers,
            chunk_count=state.chunk_count,
            particle_count=state.count,
            pose=pose,
            dt=time_step,
            moving=moving,
            forcing=forcing,
        )
        self._take_steps(*launch)

    def _sampled_step(self) -> int:
        """Take one step and time its phases separately, without the time of a launch.

        In a small scene a launch takes longer than the integration.
        """
        self._since_sample = 0
        launch = self._seconds_of_launch(0, moving=0, forcing=0)
        moving = self._seconds_of_launch(1, moving=1, forcing=0)
        if self._is_rebuild_due or self.abort_code:
            return 0
        forcing = self._seconds_of_launch(1, moving=0, forcing=1)
        self.timing.sampled_integration += max(moving - launch, 0.0)
        self.timing.sampled_forces += max(forcing - launch, 0.0)
        return self._steps_done

    def _seconds_of_launch(self, steps: int, moving: int, forcing: int) -> float:
        """Launch, and wait for its end; returns its wall-clock time [s]."""
        began = clock.perf_counter()
        self._launch_step(steps, self.poses.next, self.state.clock.time_step, moving, forcing)
        ti.sync()
        return clock.perf_counter() - began


# The stepper of a GPU: two dispatches per step, and one transfer to the host for several steps.
#
# The kernels compare numbers of launches, see `engine.step`, so that the host resets no flag after it has
# read them.

STEPS_BETWEEN_READS = 16
"""Number of steps between two reads of the flags."""


class GpuStepper(Stepper):
    """Advances a State on a GPU by steps, each of them a launch."""

    LONGEST_LAUNCH = STEPS_BETWEEN_READS
    EMPTY_LAUNCH = GpuLaunch()

    _launches = 0
    """Number of the next launch that computes forces."""
    _first_launch = 0
    """Its value at the last `_begin_count`."""
    _read: DeviceFlags | None = None
    """Flags after the last launch; None if they have not been read."""

    @property
    def abort_code(self) -> int:
        """0, or the abort code."""
        return self._flags.abort

    def permit_overlap(self, limit: float) -> None:
        """As `Stepper.permit_overlap`."""
        super().permit_overlap(limit)
        self.state.control.halted_at[PHASE_FORCES] = NOT_HALTED
        self._read = None

    def _set_abort(self, code: int, particle: int) -> None:
        """As `Stepper._set_abort`."""
        super()._set_abort(code, particle)
        self._read = None

    @property
    def _flags(self) -> DeviceFlags:
        """Flags after the last launch."""
        if self._read is None:
            self._read = read_flags(self.state)
        return self._read

    @property
    def _is_rebuild_due(self) -> bool:
        return self._flags.integration_halted_at != NOT_HALTED

    @property
    def _steps_done(self) -> int:
        flags = self._flags
        # The step of a launch that has ended with an overlap above the limit is complete.
        forces_end = flags.forces_halted_at + int(flags.abort == ABORT_OVERLAP)
        return min(flags.integration_halted_at, forces_end, self._launches) - self._first_launch

    def _begin_count(self) -> None:
        self._first_launch = self._launches

    def _prepare_workers(self) -> None:
        """A GPU has no workers."""

    def rebuild_neighbor_lists(self, step: int, pose: int = 0) -> None:
        """As `Stepper.rebuild_neighbor_lists`."""
        super().rebuild_neighbor_lists(step, pose)
        self._read = None

    def _grow(self, capacities: Capacities) -> None:
        """Reallocate the fields; on the device if the old and the new ones fit, else over the host.

        Raises SceneError if the new ones do not fit.
        """
        plan = self.state.plan
        state = self.state
        free = free_device_memory(state.backend.arch)
        grown = estimate_memory(plan, plan.scene.run.precision, capacities).total
        present = estimate_memory(plan, plan.scene.run.precision, state.capacities).total
        refuse_growth(
            plan, capacities, None if free is None else free + present, state.backend.largest_buffer
        )
        if free is None or grown < free:
            state.grow_on_device(capacities, self._compile)
        else:
            super()._grow(capacities)

    def forces(self, pose: int = 0, history_step: float | None = None) -> None:
        """As `Stepper.forces`."""
        if self.state.control.force_clock is not None:
            self.state.control.steps_done[0] = 0
        super().forces(pose, history_step)

    def _launch(self, steps: int) -> int:
        """Launch `steps` steps one after the other; returns the number of completed steps."""
        for index in range(steps):
            self._launch_step(1, self.poses.next + index, self.state.clock.time_step)
        return self._steps_done

    def _launch_step(
        self, steps: int, pose: int, time_step: float, moving: int = 1, forcing: int = 1
    ) -> None:
        """Launch one step. If `moving` or `forcing` is 0, only the other phase."""
        state = self.state
        launch = GpuLaunch(
            number=self._launches,
            steps_before=self._launches - self._first_launch,
            chunk_count=state.chunk_count,
            particle_count=state.count,
            pose=pose,
            dt=time_step,
            moving=moving,
            forcing=forcing,
        )
        self._take_steps(*launch)
        self._launches += forcing
        self._read = None


# Wall-clock time of a run by phase.


@dataclass
class Timing:
    """Wall-clock time [s] by phase, and counts.

    neighbor_list:        neighbor-list rebuilds
    advance:              all other phases of the steps
    sampled_forces:       forces of the sampled steps
    sampled_integration:  integration of the sampled steps; the ratio of both divides `advance`
    rebuild_count:        number of neighbor-list rebuilds
    step_count:           number of completed steps
    particle_steps:       sum of the particle counts of all steps
    growth_count:         number of reallocations with a larger list capacity
    compile:              compilation of kernels
    exchange:             part of `advance`: messages between MPI ranks
    waiting:              part of `advance`: agreement of MPI ranks on each step, which waits for the slowest
                          rank
    """

    neighbor_list: float = 0.0
    advance: float = 0.0
    sampled_forces: float = 0.0
    sampled_integration: float = 0.0
    rebuild_count: int = 0
    step_count: int = 0
    particle_steps: int = 0
    growth_count: int = 0
    compile: float = 0.0
    exchange: float = 0.0
    waiting: float = 0.0

    @property
    def _computing(self) -> float:
        """Wall-clock time [s] of forces and integration."""
        return self.advance - self.exchange - self.waiting

    @property
    def forces(self) -> float:
        """Wall-clock time [s] of contact forces."""
        sampled = self.sampled_forces + self.sampled_integration
        return self._computing * self.sampled_forces / sampled if sampled else self._computing

    @property
    def integration(self) -> float:
        """Wall-clock time [s] of time integration."""
        return self._computing - self.forces
