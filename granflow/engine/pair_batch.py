"""Columns in which each CPU thread collects the contacts that it evaluates together."""

from typing import Any

from granflow.engine.backend import Backend
from granflow.engine.field_block import FieldBlock
from granflow.kernel_language import ti
from granflow.plan.capacities import WORKERS, Capacities, rounded_capacity
from granflow.plan.plan import Plan

BATCH = 128
"""Number of contacts at which a batch is complete; no further neighbor list is added."""

LANES = 16
"""Batches are padded to a multiple of this number, so that the compiled loop has no scalar remainder."""

STAGGER = 24
"""Offset between columns: columns a multiple of 4096 bytes apart evict each other from the cache."""


class PairBatch:
    """Columns with an entry per contact of the present batch, and a part of each column per CPU thread.

    longest_list:  largest number of candidate pairs of one particle for which a batch suffices
    sums:          contact force and torque on each particle of the chunk of a worker; None in f64

    The names are those of the variables in `pair_force.py`; `evaluate` overwrites inputs with results.
    """

    def __init__(self, block: FieldBlock, plan: Plan, capacities: Capacities, backend: Backend) -> None:
        features, real = plan.features, backend.real
        page = 4096 // 8
        self.capacity = -(-capacities.batch // page) * page + STAGGER
        self.longest_list = self.capacity - BATCH - LANES
        worker_parts = block.parts(rounded_capacity(backend.worker_count, WORKERS))

        def columns(number: int, dtype: Any = real) -> list[Any]:
            return [block.column(worker_parts, dtype, self.capacity) for _ in range(number)]

        self.list_index, self.owner, self.partner = columns(3, ti.i32)
        self.radius, self.radius_partner, self.mass, self.mass_partner = columns(4)
        self.branch, self.velocity_rel_half = columns(3), columns(3)
        self.velocity_rel = columns(3 * features.rate_dependent)
        self.angular_velocity, self.angular_velocity_partner = (
            columns(3 * features.rotation),
            columns(3 * features.rotation),
        )
        self.history = {slot: columns(size) for slot, size in plan.history.items()}
        self.constants = columns(0 if features.one_material else plan.pair_constants.shape[1])
        self.losses = columns(3 * features.energy_budget)
        size = 6 if features.rotation else 3
        workers = rounded_capacity(backend.worker_count, WORKERS)
        self.sums = None
        if real != ti.f64:  # otherwise the fields of forces and torques hold the sums
            self.sums = block.vector(ti.f64, workers, plan.capacities.chunk_particles, count=size)
