"""What the machine code of a plan depends on: plans of equal structure differ in parameters only."""

from collections.abc import Hashable
from dataclasses import replace

from granflow.geometry.catalog import surface_code
from granflow.plan.capacities import Capacities
from granflow.plan.device_arrays import mesh_arrays, particle_arrays
from granflow.plan.plan import Plan


def structure_of(plan: Plan) -> Hashable:
    """Features, contact laws, kinds of walls, outlets and motions, arrays, and their lengths but the neighbor lists'.

    Contact laws count without their numbers, see `contact.law.Law.structure`; external forces with their functions and
    names of parameters.
    """
    return (
        plan.precision,
        plan.features,
        plan.laws.structure,
        plan.external_forces,
        plan.periodic_box.axes,
        _shear_axes(plan),
        plan.domain.on_exit == "expand",
        plan.chunk_size == 1,
        plan.has_ghosts,
        frozenset(surface_code(wall.shape) for wall in plan.walls),
        tuple(outlet.kind for outlet in plan.outlets),
        tuple(motion.kind for motion in plan.controlled_motions),
        tuple((array.name, array.dtype, array.width) for array in particle_arrays(plan) if array.wanted),
        _without_lists(plan.capacities),
        tuple(array.shape for array in mesh_arrays(plan)) if plan.meshes else (),
    )


def fits_lists(available: Capacities, needed: Capacities) -> bool:
    """True if arrays of equal structure hold the neighbor lists; lists that have grown hold more than needed."""
    lengths = [(each.list_entries, each.saved_entries, each.batch) for each in (available, needed)]
    return all(length >= least for length, least in zip(*lengths, strict=True))


def _without_lists(capacities: Capacities) -> Capacities:
    return replace(capacities, segments=1, list_entries=0, batch=0, history_share=0.0)


def _shear_axes(plan: Plan) -> tuple[int, ...]:
    motion = plan.periodic_box.image_motion
    return () if motion is None else (motion.flow, motion.gradient)
