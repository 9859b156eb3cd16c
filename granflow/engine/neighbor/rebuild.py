"""Neighbor-list rebuild: save histories, sort the particles, fill their lists and restore the histories.

`RebuildKernel` lists the phases in order: wrap the particles and save their contact histories (here); the
grid of cells and the order of the particles by cell (`sort.py`); all fields permuted to that order (here);
the lists, with the contact histories restored (`list.py`). `NeighborListRebuild` launches them when a
particle has requested it, and again with larger arrays if a list does not fit.
"""

from collections.abc import Callable
from typing import Any, Protocol

import numpy as np

from granflow.engine.box import ParticleWrap
from granflow.engine.clumps import index_phase
from granflow.engine.codes import ABORT_FAR
from granflow.engine.deformation import mark_rebuild_of_box
from granflow.engine.fields import components
from granflow.engine.history import SavedHistory
from granflow.engine.host import HistoryTable, HostParticles, copy_to_host, saved_particle_table
from granflow.engine.liquid import LiquidFilms
from granflow.engine.neighbor.list import TOO_LONG, fill_phase
from granflow.engine.neighbor.phases import Phase, RebuildLaunch, build_rebuild, granularity, is_count
from granflow.engine.neighbor.sort import KEPT_REACH, SortByCell, SortByClass, bounds_phases, find_farthest
from granflow.engine.state import DeviceFlags, State, read_flags
from granflow.engine.wall_dynamics import mark_rebuild
from granflow.errors import GranflowError
from granflow.kernel_language import ti
from granflow.plan.capacities import REACH_STEPS


class RebuildKernel:
    """The kernel of a rebuild.

    launch:  see `build_rebuild`
    fill:    number of the phase that fills the lists
    """

    def __init__(self, state: State) -> None:
        phases = bounds_phases(state)
        if not state.plan.has_ghosts:  # ranks sort their particles on the host
            phases = [*_chunk_phases(state), *phases, *SortByCell(state).phases(), *reorder_phases(state)]
        if state.plan.features.clumps:
            phases.append(index_phase(state))
        if state.cell_sort.class_order is not None:
            phases += SortByClass(state).phases()
        self.fill = len(phases)
        self.launch = build_rebuild(state, [*phases, fill_phase(state)])

    def compile(self) -> None:
        """Compile the kernel by launching it on an empty range."""
        self.launch(*RebuildLaunch(first=self.fill))


class ChunkKernel:
    """The kernel that prepares the owned particles of an MPI rank for a rebuild without migration.

    launch:  see `build_rebuild`; None if there is nothing to prepare
    """

    def __init__(self, state: State) -> None:
        phases = _chunk_phases(state)
        self.launch = build_rebuild(state, phases) if phases else None


# On the host


class Rebuild(Protocol):
    """Rebuild of the neighbor lists."""

    def compile(self) -> None:
        """Compile the kernels, unless the state has them."""

    def run(self, pose: int, workers: int) -> None:
        """Rebuild the lists at an index of the wall poses, with a number of workers."""

    def put(self, particles: HostParticles) -> None:
        """Put particles on an empty device; the next rebuild lists them."""

    def restore(self, particles: HostParticles, pose: int, workers: int) -> None:
        """Put particles on an empty device with the lists of the last rebuild, at which the wall poses are
        given."""

    def ids(self) -> np.ndarray:
        """Ids of all particles that lists can contain, by index."""


class NeighborListRebuild:
    """Runs the phases of a rebuild.

    state:       device data
    on_deleted:  receives the index range (first, last), `last` exclusive, of the particles to delete, before
                 they are deleted
    grow:        increases the list entries per segment, and the batch, to at least these numbers and compiles
                 all kernels again
    """

    def __init__(
        self, state: State, on_deleted: Callable[[int, int], None], grow: Callable[[int, int], None]
    ) -> None:
        self._state = state
        self._on_deleted = on_deleted
        self._grow = grow

    def compile(self) -> None:
        """Compile the kernel, unless the state has it."""
        self._kernel = self._state.built(RebuildKernel)
        self._kernel.compile()

    def run(self, pose: int, workers: int) -> None:
        """Sort the particles, fill the neighbor lists, remove particles outside the domain or in an outlet.

        pose:     index of the wall poses at the time of the positions
        workers:  number of workers of the launch
        """
        mark_rebuild(self._state)  # displacements of walls, and the affine motion, count from here
        mark_rebuild_of_box(self._state)
        self._delete(self._launch(pose, workers, REACH_STEPS * self._state.clock.time_step))

    def put(self, particles: HostParticles) -> None:
        """Put particles, in the order of their ids, on a device without particles; the next rebuild lists
        them."""
        state = self._state
        histories = HistoryTable(state)
        state.count = len(particles.arrays["id"])
        needed = histories.longest_segment(particles.histories)
        if needed > state.capacities.list_entries_per_segment:
            self._grow(needed, 0)
        saved_particle_table(state).put(np.arange(state.count), particles.arrays)
        histories.write_lists(particles.histories, particles.arrays["id"])

    def restore(self, particles: HostParticles, pose: int, workers: int) -> None:
        """Put particles on a device without particles, with the neighbor lists of the last rebuild.

        particles:      in the order of their ids
        pose, workers:  as for `run`; poses at the last rebuild
        Raises:         GranflowError if that rebuild would have deleted one of the particles
        """
        state = self._state
        self.put(particles.at_rebuild(state.periodic_box))
        flags = self._launch(pose, workers, KEPT_REACH)
        if state.count and flags.present < state.count:
            raise GranflowError(
                "The checkpoint contains particles that were in an outlet or outside the domain."
            )
        present = particles.of(np.searchsorted(particles.arrays["id"], self.ids()))
        saved_particle_table(state).put(np.arange(state.count), present.arrays)

    def ids(self) -> np.ndarray:
        """Ids of all particles by index."""
        return copy_to_host(self._state, ("id",))["id"]

    def _launch(self, pose: int, workers: int, reach_time: float) -> DeviceFlags:
        """Launch the kernel, again after the capacities have grown; particles to delete are then behind the
        others.

        Returns the flags after the last launch.
        """
        state = self._state
        first = 0 if state.count else self._kernel.fill
        while True:
            launch = RebuildLaunch(
                workers=workers,
                first=first,
                particle_count=state.count,
                skin=state.plan.skin,
                reach_time=reach_time,
                dt=state.clock.time_step,
                pose=pose,
            )
            self._kernel.launch(*launch)
            flags = read_flags(state)
            needed = flags.list_length_needed
            if first < self._kernel.fill and flags.running == 0:  # the histories do not fit
                self._grow(state.capacities.list_capacity_for(needed), 0)
            elif needed > state.capacities.list_entries_per_segment:
                too_long, length = divmod(needed, TOO_LONG)
                self._grow(length, length * too_long)
                first = self._kernel.fill
            else:
                return flags

    def _delete(self, flags: DeviceFlags) -> None:
        """Account for the deleted particles, which are behind the others; find one that is too far away."""
        state = self._state
        if not state.count:
            return
        if flags.present < state.count:
            self._on_deleted(flags.present, state.count)
            state.count = flags.present
        if state.plan.scene.domain.on_exit == "expand" and flags.abort == ABORT_FAR:
            find_farthest(state)


# Phase before the sort, chunk by chunk


def _chunk_phases(state: State) -> list[Phase]:
    """Wrap the particles, prepare films and save the contact histories, chunk by chunk; none if none is
    needed.

    If the histories do not fit, this phase is the last one.

    Reads:   as `ParticleWrap`, `LiquidFilms` and `SavedHistory`
    Writes:  as these; running, list_length_needed
    """
    control = state.control
    wraps = state.plan.features.periodic != "none"
    saves = bool(state.neighbors.history)
    particle_wrap = state.built(ParticleWrap)
    saved_history = state.built(SavedHistory)
    chunk_size = state.parameter("chunk_size")
    saved_capacity = state.parameter("saved_capacity")
    liquid = state.plan.features.liquid_transfer
    films: Any = state.built(LiquidFilms) if liquid else None

    @ti.func
    def chunk_count(rebuild: ti.template()):
        return (rebuild.count + chunk_size() - 1) // chunk_size()

    @ti.func
    def prepare(task: ti.template(), rebuild: ti.template()):
        chunk = task.index
        first = chunk * chunk_size()
        end = ti.min((chunk + 1) * chunk_size(), rebuild.count)
        if ti.static(wraps):
            for i in range(first, end):
                particle_wrap.wrap(chunk, i, rebuild.pose, rebuild.dt)
        if ti.static(liquid):
            for i in range(first, end):
                films.prepare(chunk, i)
        if ti.static(saves):
            saved_history.save(chunk, first, end)

    @ti.func
    def check_capacity(rebuild: ti.template()):
        if ti.static(saves):
            if control.list_length_needed[0] > saved_capacity():
                control.running[0] = 0
            else:
                control.list_length_needed[0] = 0

    phase = Phase(prepare, state.plan.capacities.chunks, chunk_count, per_task=1, serial=check_capacity)
    return [phase] if wraps or saves else []


# Phases that permute all particle fields into cell order


def reorder_phases(state: State) -> list[Phase]:
    """Move all particle fields to the new order: copied to buffers, then back.

    Fields that are written again before they are read serve as buffers. A vector buffer takes a vector or
    three numbers. `position_at_rebuild` keeps the positions; before, it takes the reals that are wider than a
    force.

    Reads:   order
    Writes:  all fields of `Particles.sorted_fields`, position_at_rebuild, force, torque, coordination_number
    """
    particles = state.particles
    phases = []
    fields = [field for field in particles.sorted_fields() if field is not particles.position]
    reals = [component for field in fields if field.dtype != ti.i32 for component in components(field)]
    at_rebuild = components(particles.position_at_rebuild)
    widest = at_rebuild[0].dtype if at_rebuild[0].dtype != particles.force.dtype else None
    wide = [each for each in reals if each.dtype == widest]
    reals = [each for each in reals if each.dtype != widest]
    for k in range(0, len(wide), len(at_rebuild)):
        phases += _copy_phases(state, [*zip(wide[k:], at_rebuild, strict=False)])
    integers = [field for field in fields if field.dtype == ti.i32]
    buffers = components(particles.force)
    if particles.torque is not None:
        buffers += components(particles.torque)
    first = [*zip(components(particles.position), at_rebuild, strict=True)]
    while reals or integers:
        pairs = [*first, *zip(reals, buffers, strict=False)]
        pairs += zip(integers, [particles.coordination_number], strict=False)
        reals = reals[len(buffers) :]
        integers = integers[1:]
        first = []
        phases += _copy_phases(state, pairs)
    return phases


def _copy_phases(state: State, pairs: list[Any]) -> list[Phase]:
    """Phases that permute some components: to the buffers in the new order, then back.

    pairs:  scalar fields (field, buffer)

    Reads:   order
    Writes:  fields and buffers of `pairs`
    """
    order = state.cell_sort.order
    per_task, _ = granularity(state)

    @ti.func
    def gather(task: ti.template(), rebuild: ti.template()):
        source = 0
        k = task.begin
        while (k < task.end) & is_count(source):
            source = order[k]
            for field, buffer in ti.static(pairs):
                buffer[k] = ti.cast(field[source], buffer.dtype)
            k += 1

    @ti.func
    def copy_back(task: ti.template(), rebuild: ti.template()):
        k = task.begin
        while k < task.end and is_count(order[k]):
            for field, buffer in ti.static(pairs):
                field[k] = ti.cast(buffer[k], field.dtype)
            k += 1

    most = order.shape[0]
    return [Phase(gather, most, per_task=per_task), Phase(copy_back, most, per_task=per_task)]
