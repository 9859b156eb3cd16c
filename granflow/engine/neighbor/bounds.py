"""Reach and bounding boxes of the particles at a neighbor-list rebuild."""

from typing import Any

from granflow.engine.neighbor.cell_grid import build_lay_grids
from granflow.engine.neighbor.phases import Phase, is_count, part_range
from granflow.engine.state import State
from granflow.kernel_language import ti
from granflow.plan.capacities import BOUNDS, SUBPARTS

KEPT_REACH = -1.0
"""Time of the reach for which the particles keep the reach that they have."""


def bounds_phases(state: State) -> list[Phase]:
    """Reach of all particles, bounds of BOUNDS parts of the particle list, and the grids.

        reach = min(skin / 2 + |v| time, reach_max)

    A part holds consecutive particles; its bounds are those of the positions, and the largest reach. A fast particle
    looks further, so that it does not make the rebuilds of all others more frequent. With the time KEPT_REACH, the
    reach is that of an earlier rebuild. On a GPU, SUBPARTS threads first share a part.

    Reads:   position, velocity, reach
    Writes:  reach of the particles; low, high, reach of the cell sort and of the subparts; the grids
    """
    sorting, lay_grids, bounds_of = state.cell_sort, build_lay_grids(state), _build_bounds_of(state)

    @ti.func
    def bounds(task: ti.template(), rebuild: ti.template()):
        low, high, reach = bounds_of(task.begin, task.begin, task.end, rebuild)
        sorting.low[task.index], sorting.high[task.index], sorting.reach[task.index] = low, high, reach

    @ti.func
    def lay(rebuild: ti.template()):
        lay_grids(rebuild.count)

    if state.backend.on_cpu or sorting.subpart_low is None:
        return [Phase(bounds, BOUNDS, serial=lay)]
    subpart_count, subpart_bounds, joined = _build_subparts(state, bounds_of)
    return [Phase(subpart_bounds, BOUNDS * SUBPARTS, subpart_count, per_task=1), Phase(joined, BOUNDS, serial=lay)]


def _build_bounds_of(state: State) -> Any:
    """Device function (first, begin, end, rebuild): low and high corner [m] and largest reach [m] of begin to end.

    first:  a particle within the bounds, which counts also if the range is empty

    Writes:  reach of the particles
    """
    particles, reach_max, real = state.particles, state.parameter("reach_max"), state.backend.position_real
    position = particles.position

    @ti.func
    def bounds_of(first, begin, end, rebuild: ti.template()):
        smallest, largest, reach_largest, limit = position[first], position[first], 0.5 * rebuild.skin, reach_max()
        i = begin
        while (i < end) & is_count(reach_largest):
            smallest, largest = ti.min(smallest, position[i]), ti.max(largest, position[i])
            speed = ti.cast(particles.velocity[i].norm(), real)
            reach = ti.min(0.5 * rebuild.skin + speed * rebuild.reach_time, limit)
            if rebuild.reach_time < 0.0:
                reach = particles.reach[i]
            particles.reach[i] = reach
            reach_largest = ti.max(reach_largest, reach)
            i += 1
        return smallest, largest, reach_largest

    return bounds_of


def _build_subparts(state: State, bounds_of: Any) -> tuple[Any, Any, Any]:
    """Device functions: number of subparts; bounds of a subpart; bounds of a part from those of its subparts."""
    sorting = state.cell_sort

    @ti.func
    def subpart_count(rebuild: ti.template()):
        return ti.min(rebuild.count, BOUNDS) * SUBPARTS

    @ti.func
    def subpart_bounds(task: ti.template(), rebuild: ti.template()):
        subpart = task.index
        first, end = part_range(subpart // SUBPARTS, ti.min(rebuild.count, BOUNDS), rebuild.count)
        begin, last = part_range(subpart % SUBPARTS, SUBPARTS, end - first)
        low, high, reach = bounds_of(first, first + begin, first + last, rebuild)
        sorting.subpart_low[subpart], sorting.subpart_high[subpart], sorting.subpart_reach[subpart] = low, high, reach

    @ti.func
    def joined(task: ti.template(), rebuild: ti.template()):
        part, first = task.index, task.index * SUBPARTS
        low, high, reach = sorting.subpart_low[first], sorting.subpart_high[first], sorting.subpart_reach[first]
        for subpart in range(first + 1, first + SUBPARTS):
            low = ti.min(low, sorting.subpart_low[subpart])
            high = ti.max(high, sorting.subpart_high[subpart])
            reach = ti.max(reach, sorting.subpart_reach[subpart])
        sorting.low[part], sorting.high[part], sorting.reach[part] = low, high, reach

    return subpart_count, subpart_bounds, joined
