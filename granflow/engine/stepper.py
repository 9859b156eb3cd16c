"""The phases of a time step, in order: integration, neighbor-list rebuild if it is due, contact forces.

One launch takes many steps on a CPU and one on a GPU, see `gpu_stepper`. If a particle has moved by half the skin, all
further phases of the launch do nothing until the host has rebuilt the neighbor list, so that no step needs a transfer
to the host. If the list capacity is too small, the host reallocates the fields and repeats the rebuild.
"""

import time as clock
from collections.abc import Callable

import numpy as np

from granflow.engine.contact_histories import HistoryTable
from granflow.engine.exact_sums import shares_rows
from granflow.engine.force.contact_accounting import build_end_wall_work
from granflow.engine.force.external_forces import write_force_inputs
from granflow.engine.host_copy import saved_particle_table
from granflow.engine.host_particles import HostParticles
from granflow.engine.neighbor.rebuild import NeighborListRebuild, Rebuild
from granflow.engine.pair_batch import BATCH, LANES
from granflow.engine.state import State
from granflow.engine.step_kernels import build_steps
from granflow.engine.threads.workers import Workers
from granflow.engine.timing import Timing
from granflow.engine.wall_poses import WallPoses
from granflow.kernel_language import ti
from granflow.plan.capacities import Capacities

LAUNCH_SECONDS = 0.05
"""Wall-clock time of a CPU launch [s]. A launch cannot be interrupted: a stop takes effect between two launches."""

FIRST_LAUNCH = 50_000
"""Particle-steps of the first CPU launch, before the rate is known."""

SAMPLE_EVERY = 256
"""Interval in steps between sampled steps, whose phases are timed separately."""


class Stepper:
    """Advances a State by steps.

    state:       device data
    on_deleted:  see the class of the rebuild, `NeighborListRebuild`

    `interrupted` stops `advance` after the present launch; `stop_signal`: number of the signal that another MPI rank
    has received, otherwise 0. `clock_at_rebuild`: state of the clock at the last rebuild, None before the first.
    """

    def __init__(self, state: State, on_deleted: Callable[..., None]) -> None:
        self.state = state
        self.stop_signal = 0
        self.timing = Timing()
        self.steps_since_rebuild = 0
        self.clock_at_rebuild: dict[str, float] | None = None
        self.interrupted: int = False
        self._since_sample = 0
        self._rebuild = self._new_rebuild(on_deleted)
        self._workers = Workers(state)
        self.poses = WallPoses(state)
        self._step_seconds = 0.0
        self._compile()

    def _new_rebuild(self, on_deleted: Callable[..., None]) -> Rebuild:
        """What rebuilds the neighbor lists."""
        return NeighborListRebuild(self.state, on_deleted, self.grow_neighbor_lists)

    def _compile(self) -> None:
        """Compile all phases, unless the state has them, by launching them on empty ranges."""
        began, state = clock.perf_counter(), self.state
        self._rebuild.compile()
        self._step = state.built(build_steps)
        self._step(0, 1, 0, 0, 0, 0.0, 1, 1)
        self.timing.compile += clock.perf_counter() - began

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
        began, compiled = clock.perf_counter(), self.timing.compile
        self._prepare_workers()
        self._end_wall_work(withdraws=False)
        self._rebuild.run(pose, self._workers.count)
        self.steps_since_rebuild, self.clock_at_rebuild = 0, self.state.clock.state_dict() | {"step_count": step}
        self.timing.neighbor_list += clock.perf_counter() - began - (self.timing.compile - compiled)
        self.timing.rebuild_count += 1

    def restore(self, particles: HostParticles) -> None:
        """Put particles, in the order of their ids, on an empty device with the neighbor lists of the last rebuild.

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
        step = self.state.clock.time_step if history_step is None else history_step
        self._begin_count()
        if self.state.wall_dynamics is not None and shares_rows(self.state):
            self.state.wall_dynamics.wall_force.fill(0)  # otherwise cleared when the walls move
        self._launch_step(1, pose, step, moving=0, forcing=1)

    def refresh(self, step: int, velocities_lag: bool) -> None:
        """Rebuild the neighbor lists and compute forces after step number `step`, after particles or walls changed.

        `velocities_lag`: velocities are half a step behind the positions. Contact displacements do not change.
        """
        pose = self.poses.index_at(step)
        self._end_wall_work(withdraws=True)
        self.rebuild_neighbor_lists(step, pose)
        write_force_inputs(self.state, step, velocities_lag)
        self.forces(pose, history_step=0.0)

    def _end_wall_work(self, withdraws: bool) -> None:
        """Clear the work of moving walls that belongs to the next step, see `build_end_wall_work`."""
        if self.state.control.wall_work_ahead is not None:
            self.state.built(build_end_wall_work)(int(withdraws))

    def advance(self, steps: int, step: int) -> int:
        """Take `steps` steps after step number `step`; returns the number of completed steps.

        It is smaller after an abort, if `interrupted` is set (by a signal handler), and, with an adaptive time step,
        after a neighbor-list rebuild, which adds candidate pairs.

        `interrupted` takes effect between two launches, each of which takes about LAUNCH_SECONDS.
        """
        done, rebuilds = 0, self.timing.rebuild_count
        is_adaptive = self.state.plan.adaptive_time_step is not None
        while done < steps and not self.abort_code and not (is_adaptive and self.timing.rebuild_count > rebuilds):
            if self.interrupted:
                break
            done += self._advance_batch(steps - done, step + done)
        return done

    @property
    def abort_code(self) -> int:
        """0, or the abort code."""
        return int(self.state.control.abort[0])

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

    def _advance_batch(self, steps: int, step: int) -> int:
        """Take up to `steps` steps in one launch; rebuild the neighbor lists if due.

        Returns the number of completed steps.
        """
        state = self.state
        self._prepare_workers()
        if state.plan.has_poses:
            steps = min(steps, self.poses.prepare(step, self.steps_since_rebuild))
        self._begin_count()
        began, rebuild_seconds = clock.perf_counter(), self.timing.neighbor_list
        write_force_inputs(state, step + 1)
        done = self._launch(steps)
        if self._is_rebuild_due and not self.abort_code:
            self.rebuild_neighbor_lists(step + done + 1, self.poses.next + done)
            write_force_inputs(state, step + done + 1)
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

    def _launch(self, steps: int) -> int:
        """Launch up to `steps` steps; returns the number of completed steps."""
        step = self.state.clock.time_step
        if self._since_sample >= SAMPLE_EVERY:
            return self._sampled_step()
        began, wanted = clock.perf_counter(), min(steps, self._steps_per_launch)
        self._launch_step(wanted, self.poses.next, step)
        done = self._steps_done
        if done:
            seconds = clock.perf_counter() - began
            self._step_seconds = seconds / done
            self._workers.record(done, seconds)
        return done

    @property
    def _steps_per_launch(self) -> int:
        """Number of steps that take LAUNCH_SECONDS at the rate of the previous launch."""
        if not self._step_seconds:
            return max(FIRST_LAUNCH // max(self.state.count, 1), 1)
        return max(int(LAUNCH_SECONDS / self._step_seconds), 1)

    def _launch_step(self, steps: int, pose: int, step: float, moving: int = 1, forcing: int = 1) -> None:
        """One launch: `steps` steps on a CPU, one on a GPU. If `moving` or `forcing` is 0, only the other phase."""
        state, workers = self.state, self._workers.count
        self._workers.place(workers)
        self._step(steps, workers, state.chunk_count, state.count, pose, step, moving, forcing)

    def _sampled_step(self) -> int:
        """Take one step and time its phases separately."""
        step, began = self.state.clock.time_step, clock.perf_counter()
        self._since_sample = 0
        self._launch_step(1, self.poses.next, step, forcing=0)
        ti.sync()
        integrated = clock.perf_counter()
        if self._is_rebuild_due or self.abort_code:
            return 0
        forces_began = clock.perf_counter()
        self._launch_step(1, self.poses.next, step, moving=0)
        ti.sync()
        self.timing.sampled_integration += integrated - began
        self.timing.sampled_forces += clock.perf_counter() - forces_began
        return self._steps_done
