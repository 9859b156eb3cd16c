"""Device flags, counters and constants that kernels and host share."""

from typing import Any

import numpy as np

from granflow.engine.backend import Backend
from granflow.engine.field_block import FieldBlock, Fields, write_padded
from granflow.engine.limits import NO_PARTICLE, NOT_HALTED
from granflow.kernel_language import ti
from granflow.plan.capacities import WALL_BATCH
from granflow.plan.device_arrays import sum_arrays
from granflow.plan.external_forces import parameter_count
from granflow.plan.plan import Plan

CACHE_LINE = 16
"""Integers per cache line; contended counters occupy separate lines."""


class Control(Fields):
    """Flags, counters and constants shared by kernels and host.

    rebuild_requested:          set by the integration if a particle or wall has moved too far
    rebuild_due:                copy of it at the end of the phase; all further phases of the launch do nothing
    steps_done, running:        completed steps of a launch; 1 while it continues
    worker_count:               workers that have not left the launch
    started_count:              of them, those at the first barrier of the launch
    halted_at:                  on a GPU, number of the launch whose integration, or forces, halted the following ones
    patience:                   number of polls after which a worker leaves, and that of the first barrier of a launch
    next_chunk:                 number of chunks that workers have taken in this phase
    arrived, released:          counters of the barrier, see `barrier`
    list_length_needed:         largest number of entries of a segment, plus TOO_LONG if a list exceeds the batch
    abort, abort_particle:      abort code and smallest id above the limit
    pair_constants:             row per pair of materials
    law_parameters:             one row, the parameters of the contact laws
    losses:                     terms LOSSES of each chunk, see `exact_sums`
    impulses:                   time integrals of the wall forces of each chunk, see `exact_sums`
    collisions, collision_edges:  numbers of collisions by kind and energy class, and edges of the classes [J]
    wall_work_ahead:            part of the work of moving walls of each chunk that belongs to the next step, see
                                `contact_accounting`
    boundary_work:              work at periodic boundaries of each chunk, see `exact_sums`
    external_work:              work of external forces of each chunk, see `exact_sums`
    force_parameters:           parameters of all external forces
    force_clock:                since_time, time_step, steps since since_time of the next force evaluation, and the
                                time by which velocities lag behind positions there [s]
    damping:                    Cundall ratio and drag rate [1/s] of the present stage
    image_offset, image_speed:  of a sheared box, for WALL_BATCH steps [m], [m/s]
    """

    def __init__(self, block: FieldBlock, plan: Plan, backend: Backend) -> None:
        self.rebuild_due = block.scalar(ti.i32, 1)
        self.rebuild_requested = block.scalar(ti.i32, 1)
        self.steps_done, self.running = (block.scalar(ti.i32, 1) for _ in range(2))
        self.worker_count, self.started_count = (block.scalar(ti.i32, 1) for _ in range(2))
        self.patience = block.scalar(ti.i32, 2)
        self.next_chunk, self.released = (block.scalar(ti.i32, 2 * CACHE_LINE) for _ in range(2))
        self.arrived = block.scalar(ti.i32, 3 * CACHE_LINE)
        self.list_length_needed = block.scalar(ti.i32, 1)
        self.halted_at: Any = None if backend.on_cpu else block.scalar(ti.i32, 2)
        self.abort = block.scalar(ti.i32, 1)
        self.abort_particle = block.scalar(ti.i32, 1)
        self.pair_constants = block.vector(backend.real, plan.capacities.pairs, count=plan.pair_constants.shape[1])
        self.law_parameters = block.vector(backend.real, 1, count=max(len(plan.law_parameters), 1))
        super().__init__(block.arrays(sum_arrays(plan), backend))
        edges = max(plan.capacities.energy_classes - 1, 1)
        self.collision_edges: Any = block.scalar(ti.f64, edges) if plan.features.collision_energies else None
        external, parameters = plan.features.external_forces, parameter_count(plan.external_forces)
        self.force_parameters: Any = block.scalar(ti.f64, max(parameters, 1)) if external else None
        damped = plan.damping is not None
        self.force_clock: Any = block.scalar(ti.f64, 4) if external or damped else None
        self.damping: Any = block.scalar(ti.f64, 2) if damped else None
        sheared, position_real = plan.features.lees_edwards, backend.position_real
        self.image_offset: Any = block.scalar(position_real, WALL_BATCH) if sheared else None
        self.image_speed: Any = block.scalar(backend.real, WALL_BATCH) if sheared else None

    def fill(self, plan: Plan) -> None:
        """Write the constant arrays."""
        write_padded(self.pair_constants, plan.pair_constants)
        if plan.law_parameters:
            write_padded(self.law_parameters, np.array([plan.law_parameters]))
        if self.collision_edges is not None:
            write_padded(self.collision_edges, plan.collision_edges)
        self.abort_particle[0] = NO_PARTICLE
        if self.halted_at is not None:
            write_padded(self.halted_at, np.full(2, NOT_HALTED, np.int32))
