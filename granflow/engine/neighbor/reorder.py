"""Permutation of all particle fields into cell order at a neighbor-list rebuild."""

from typing import Any

from granflow.engine.host_fields import components
from granflow.engine.neighbor.phases import Phase, granularity, is_count
from granflow.engine.state import State
from granflow.kernel_language import ti


def reorder_phases(state: State) -> list[Phase]:
    """Move all particle fields to the new order: copied to buffers, then back.

    Fields that are written again before they are read serve as buffers. A vector buffer takes a vector or three
    numbers. `position_at_rebuild` keeps the positions; before, it takes the reals that are wider than a force.

    Reads:   order
    Writes:  all fields of `Particles.sorted_fields`, position_at_rebuild, force, torque, coordination_number
    """
    particles, phases = state.particles, []
    fields = [field for field in particles.sorted_fields() if field is not particles.position]
    reals = [component for field in fields if field.dtype != ti.i32 for component in components(field)]
    at_rebuild = components(particles.position_at_rebuild)
    widest = at_rebuild[0].dtype if at_rebuild[0].dtype != particles.force.dtype else None
    wide, reals = [each for each in reals if each.dtype == widest], [each for each in reals if each.dtype != widest]
    for k in range(0, len(wide), len(at_rebuild)):
        phases += _copy_phases(state, [*zip(wide[k:], at_rebuild, strict=False)])
    integers = [field for field in fields if field.dtype == ti.i32]
    buffers = [*components(particles.force), *(components(particles.torque) if particles.torque is not None else ())]
    first = [*zip(components(particles.position), at_rebuild, strict=True)]
    while reals or integers:
        pairs = [*first, *zip(reals, buffers, strict=False)]
        pairs += zip(integers, [particles.coordination_number], strict=False)
        reals, integers, first = reals[len(buffers) :], integers[1:], []
        phases += _copy_phases(state, pairs)
    return phases


def _copy_phases(state: State, pairs: list[Any]) -> list[Phase]:
    """Phases that permute some components: to the buffers in the new order, then back.

    pairs:  scalar fields (field, buffer)

    Reads:   order
    Writes:  fields and buffers of `pairs`
    """
    order, (per_task, _) = state.cell_sort.order, granularity(state)

    @ti.func
    def gather(task: ti.template(), rebuild: ti.template()):
        source, k = 0, task.begin
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
