"""Time steps of one MPI rank: integration, exchange of ghosts, rebuild if any rank requests it, contact forces."""

import time as clock
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace

from granflow.engine.force.external_forces import write_force_inputs
from granflow.engine.ranks import Arrays
from granflow.engine.state import State
from granflow.engine.stepper import Stepper
from granflow.parallel.communicator import Communicator
from granflow.parallel.rank_rebuild import RankRebuild, grown_plan_capacity


class RankStepper(Stepper):
    """As `Stepper`, for the particles of one rank; all ranks call each function together.

    Each phase of a step is a separate launch. The ranks agree on rebuilds, aborts and stops after the integration and
    after the forces, so that all of them take the same steps.
    """

    def __init__(self, state: State, communicator: Communicator, on_deleted: Callable[[Arrays], None]) -> None:
        self._requested = self._agreed = 0
        self._communicator = communicator
        super().__init__(state, on_deleted)

    def _new_rebuild(self, on_deleted: Callable[[Arrays], None]) -> RankRebuild:
        self._rank_rebuild = RankRebuild(self.state, self._communicator, on_deleted, self._grow_capacities)
        return self._rank_rebuild

    @property
    def pending(self) -> list[Arrays]:
        """Particles that the next rebuild appends, all saved fields."""
        return self._rank_rebuild.pending

    def holds(self, particle: int) -> bool:
        """Whether this rank owns the particle with this id, or has deleted it at the last rebuild."""
        return self._rank_rebuild.holds(particle)

    @property
    def interrupted(self) -> int:
        """Whether all ranks stop; a request of one rank takes effect when they have agreed on it.

        The value is 1 for a request of the root, otherwise the number of a signal.
        """
        return self._agreed

    @interrupted.setter
    def interrupted(self, requested: int) -> None:
        self._requested = int(requested)

    def begin_advance(self) -> None:
        """Clear the stop of the last call of `advance`, after which the root has continued."""
        self._agreed, self.stop_signal = 0, 0

    def end_advance(self) -> None:
        """Clear the request of this rank, if all ranks have stopped; the root clears its own."""
        self.stop_signal = self._agreed if self._agreed > 1 else 0
        if self._agreed and not self._communicator.is_root:
            self._requested = 0

    def update_ghosts(self) -> None:
        """Update the ghosts from their owners."""
        self._rank_rebuild.ghosts.update()

    def _grow_capacities(self, particles: int, needed: int, longest: int) -> None:
        """Increase the arrays to at least these capacities, and build all kernels again."""
        state, self.timing.growth_count = self.state, self.timing.growth_count + 1
        grown_plan_capacity(state, particles)
        capacities = state.capacities.grown(max(needed, state.capacities.list_entries_per_segment), longest)
        if particles:
            planned = state.plan.capacities
            lists = max(planned.list_entries, planned.segments * capacities.list_entries_per_segment)
            capacities = replace(planned, list_entries=lists, batch=capacities.batch)
        state.grow_neighbor_list(capacities, self._compile)

    def forces(self, pose: int = 0, history_step: float | None = None) -> None:
        """As `Stepper.forces`; an abort of one rank becomes that of all."""
        super().forces(pose, history_step)
        self._agree()
        self._sum_wall_forces()

    def _sum_wall_forces(self) -> None:
        """Write the force of all ranks on each force-controlled wall as that of the first chunk of each rank."""
        if self.state.wall_dynamics is None:
            return
        field = self.state.wall_dynamics.wall_force
        by_chunk = field.to_numpy()
        total = self._communicator.sums(by_chunk[: self.state.wall_row_count].sum(axis=0))
        by_chunk[...] = 0
        by_chunk[0] = total
        field.from_numpy(by_chunk)

    def _agree(self, rebuild: bool = False) -> bool:
        """Whether any rank requests a rebuild; also agrees on an abort and a stop. Waits for the slowest rank."""
        is_due, self._agreed = self._rank_rebuild.ghosts.agree(self._requested, rebuild)
        return is_due

    def _advance_batch(self, steps: int, step: int) -> int:
        """Take one step; returns the number of completed steps, 0 after an abort."""
        state = self.state
        self._prepare_workers()
        self.poses.prepare(step, self.steps_since_rebuild)
        state.control.steps_done[0] = 0
        began, rebuild_seconds = clock.perf_counter(), self.timing.neighbor_list
        write_force_inputs(state, step + 1)
        moving = self._launch_phase(forcing=0)
        with self._recorded("waiting"):
            is_due = self._agree(bool(state.control.rebuild_requested[0]))
        if not is_due or self.abort_code:  # a rebuild selects other ghosts
            with self._recorded("exchange"):
                self.update_ghosts()
        done = 0 if self.abort_code else self._finish_step(is_due, step, moving)
        self.poses.advance(done)
        self.timing.sampled_integration += moving
        self.timing.advance += clock.perf_counter() - began - (self.timing.neighbor_list - rebuild_seconds)
        self.timing.step_count += done
        self.timing.particle_steps += done * self._rank_rebuild.total_count
        return done

    @contextmanager
    def _recorded(self, phase: str) -> Iterator[None]:
        """Adds the wall-clock time of a block to a phase of `Timing`."""
        began = clock.perf_counter()
        yield
        setattr(self.timing, phase, getattr(self.timing, phase) + clock.perf_counter() - began)

    def _launch_phase(self, moving: int = 1, forcing: int = 1) -> float:
        """Launch one phase of a step; returns its wall-clock time [s]."""
        began = clock.perf_counter()
        self._launch_step(1, self.poses.next, self.state.clock.time_step, moving, forcing)
        return clock.perf_counter() - began

    def _finish_step(self, is_due: bool, step: int, moving: float) -> int:
        """Rebuild if it is due, and compute the forces; returns 0 after an abort, else 1.

        moving:  time [s] of the integration
        """
        if is_due:
            self.rebuild_neighbor_lists(step + 1, self.poses.next)
            write_force_inputs(self.state, step + 1)
        forcing = self._launch_phase(moving=0)
        self._rank_rebuild.balance.record(moving + forcing)
        self.timing.sampled_forces += forcing
        with self._recorded("waiting"):
            self._agree()
        with self._recorded("exchange"):
            self._sum_wall_forces()
        if self.abort_code:
            return 0
        if not is_due:
            self.steps_since_rebuild += 1
        return 1
