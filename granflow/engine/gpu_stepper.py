"""The stepper of a GPU: two dispatches per step, and one transfer to the host per batch of steps.

The kernels compare numbers of launches, see `gpu_step`, so that the host resets no flag between two batches.
"""

from granflow.engine.device_flags import DeviceFlags, read_flags
from granflow.engine.device_memory import free_device_memory
from granflow.engine.limits import NOT_HALTED
from granflow.engine.stepper import SAMPLE_EVERY, Stepper
from granflow.plan.capacities import Capacities
from granflow.plan.memory_check import refuse_growth
from granflow.plan.memory_estimate import estimate_memory

GPU_BATCH = 16
"""Number of steps between two reads of the flags."""


class GpuStepper(Stepper):
    """Advances a State on a GPU by steps, each of them a launch."""

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
        return min(flags.integration_halted_at, flags.forces_halted_at, self._launches) - self._first_launch

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
        plan, state = self.state.plan, self.state
        free, grown = free_device_memory(state.backend.arch), estimate_memory(plan, plan.precision, capacities).total
        present = estimate_memory(plan, plan.precision, state.capacities).total
        refuse_growth(plan, capacities, None if free is None else free + present, state.backend.largest_buffer)
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
        """Launch up to GPU_BATCH steps; returns the number of completed steps."""
        if self._since_sample >= SAMPLE_EVERY:
            return self._sampled_step()
        for index in range(min(steps, GPU_BATCH)):
            self._launch_step(1, self.poses.next + index, self.state.clock.time_step)
        return self._steps_done

    def _launch_step(self, steps: int, pose: int, step: float, moving: int = 1, forcing: int = 1) -> None:
        """Launch one step. If `moving` or `forcing` is 0, only the other phase."""
        state, before = self.state, self._launches - self._first_launch
        self._step(self._launches, before, state.chunk_count, state.count, pose, step, moving, forcing)
        self._launches += forcing
        self._read = None
