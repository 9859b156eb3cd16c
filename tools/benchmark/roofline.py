"""Roofline estimate of a GPU: memory traffic and operations per particle-step, counted from the arrays of a
plan, and the rates that the data sheets of GPUs permit. Nothing is measured.

    bytes of a step = fields read and written by the integration
                      + fields read by the forces, force and torque written
                      + L (partner and contact flag) + 2 C (history)
                      + (all fields 4 times, 8 integers, 4 L partners, 4 C history) / steps between rebuilds

    rate = min(bandwidth / bytes, operations per second / operations)

with L list entries and C contacts per particle, each contact counted for both particles, as on a GPU. The
fields of a partner count once for each particle: particles are sorted in space, so that partners are in
the cache.
"""

from dataclasses import dataclass

from granflow import Plan
from granflow.plan.arrays import DeviceArray, Precision, neighbor_arrays, particle_arrays

INTEGRATION_READ = (
    "position",
    "velocity",
    "angular_velocity",
    "mass",
    "radius",
    "force",
    "torque",
    "position_at_rebuild",
    "reach",
)
INTEGRATION_WRITTEN = ("position", "velocity", "velocity_synchronized", "angular_velocity")
FORCES_READ = (
    "position",
    "velocity",
    "velocity_synchronized",
    "angular_velocity",
    "radius",
    "mass",
    "material",
)
FORCES_WRITTEN = ("force", "torque")
CONTACTS, LIST_ENTRIES, STEPS_PER_REBUILD = 6.0, 9.0, 50.0
"""Contacts and list entries per particle and steps between rebuilds, as in a settled bed that is agitated."""
INTEGER, LIST_RANGE, SORT_INTEGERS = 4, 3, 8
"""Bytes of an integer; integers per particle of its list range, and of the sort."""
INTEGRATION_OPERATIONS, ENTRY_OPERATIONS, CONTACT_OPERATIONS = 75.0, 10.0, 388.0
"""Per particle, list entry and frictional contact (zhou): sums and products, and 20 for each root or
quotient."""


@dataclass(frozen=True)
class Gpu:
    """A GPU as in its data sheet: memory bandwidth [bytes/s], sums and products [1/s] in f32 and f64."""

    name: str
    bandwidth: float
    f32: float
    f64: float


GPUS = (
    Gpu("H100 SXM", 3.35e12, 67e12, 34e12),
    Gpu("A100 80 GB", 2.04e12, 19.5e12, 9.7e12),
    Gpu("RTX 4090", 1.008e12, 82.6e12, 1.29e12),
    Gpu("RTX A4000", 4.48e11, 19.2e12, 0.6e12),
)


def bytes_per_particle_step(plan: Plan, precision: Precision) -> float:
    """Smallest memory traffic [bytes] of one particle in one step."""
    size = {array.name: _entry_size(array, precision) for array in particle_arrays(plan)}
    history = sum(
        _entry_size(array, precision)
        for array in neighbor_arrays(plan, plan.capacities)
        if array.name.startswith("history.")
    )
    names = (*INTEGRATION_READ, *INTEGRATION_WRITTEN, *FORCES_READ, *FORCES_WRITTEN)
    particle_step = sum(size.get(name, 0) for name in names) + LIST_RANGE * INTEGER
    particle_rebuild = 4 * sum(size.values()) + SORT_INTEGERS * INTEGER
    list_step = LIST_ENTRIES * 2 * INTEGER + CONTACTS * 2 * history
    list_rebuild = LIST_ENTRIES * 4 * INTEGER + CONTACTS * 4 * (INTEGER + history)
    return particle_step + list_step + (particle_rebuild + list_rebuild) / STEPS_PER_REBUILD


def particle_steps_per_second(plan: Plan, precision: Precision, gpu: Gpu) -> float:
    """Largest rate that memory bandwidth and arithmetic allow."""
    operations = INTEGRATION_OPERATIONS + LIST_ENTRIES * ENTRY_OPERATIONS + CONTACTS * CONTACT_OPERATIONS
    arithmetic = (gpu.f64 if precision == "f64" else gpu.f32) / operations
    return min(gpu.bandwidth / bytes_per_particle_step(plan, precision), arithmetic)


def _entry_size(array: DeviceArray, precision: Precision) -> int:
    """Bytes per entry of an array; 0 for an array that the plan does not need."""
    return array.size(precision) // array.shape[0]


def text(plan: Plan) -> str:
    """Memory traffic of a particle-step at the precision of the plan, and the largest rate of each GPU."""
    traffic = bytes_per_particle_step(plan, plan.scene.run.precision)
    rates = [
        f"{gpu.name:12} {1e-6 * particle_steps_per_second(plan, plan.scene.run.precision, gpu):6.0f} million "
        f"particle-steps per second at {1e-9 * gpu.bandwidth:.0f} GB/s"
        for gpu in GPUS
    ]
    title = f"{plan.scene.title}: at least {traffic:.0f} bytes per particle-step with {CONTACTS:g} contacts per particle"
    return "\n".join([f"{title}, {plan.scene.run.precision}", *rates])
