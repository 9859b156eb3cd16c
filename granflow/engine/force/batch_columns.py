"""Columns of a batch of contacts, one per component of a vector, and sums over the contacts of a particle."""

from typing import Any

from granflow.engine.exact_sums import holds_sums
from granflow.engine.state import State
from granflow.kernel_language import ti


@ti.func
def store_vector(columns: ti.template(), worker, entry, vector):
    """Write the components of a vector into columns, one column [worker, entry] per component."""
    for k in ti.static(range(len(columns))):
        columns[k][worker, entry] = vector[k]


def build_add_to_sums(state: State) -> Any:
    """Device function (worker, i, first, component, terms): add three terms to the sums of particle i.

    `first`: first particle of the chunk; `component`: of the first term, 0 for a force and 3 for a torque.

    Writes:  force, torque; or the sums of the batch, see `holds_sums`
    """
    batch, particles, exact = state.batch, state.particles, holds_sums(state)

    @ti.func
    def add_to_sums(worker, i, first, component: ti.template(), terms):
        if ti.static(not exact):
            for k in ti.static(range(3)):
                number = ti.static(component + k)
                batch.sums[worker, i - first][number] = batch.sums[worker, i - first][number] + terms[k]
        elif ti.static(component == 0):
            particles.force[i] = particles.force[i] + terms
        else:
            particles.torque[i] = particles.torque[i] + terms

    return add_to_sums
