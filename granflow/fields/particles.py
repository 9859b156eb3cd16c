"""Properties of the particles: fields on the device, arrays of snapshots, files and checkpoints."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Literal

from granflow.fields.quantity import Quantity

DeviceType = Literal["position", "real", "f64", "i32", "i64"]
"""Types on the device: "position" is f64, in precision f32 f32; "real" is f64 in precision f64, else f32."""


def _always(features: Any) -> bool:
    return True


@dataclass(frozen=True)
class FieldSpec(Quantity):
    """Definition of one property of the particles, a scalar or a vector.

    Allocation, sorting, insertion, checkpoints and their validation, snapshots, VTU files and the memory estimate are
    derived from it.

    dtype:      type of the device field; None for a property without one
    condition:  function of the features of a plan: whether the field exists
    block:      fields that follow each other with the same block are interleaved entry by entry, because kernels read
                them together
    sorted:     permuted with the particles at a neighbor-list rebuild; other fields are computed again after it
    saved:      in checkpoints
    displayed:  in particle files, if it is present
    default:    value of inserted particles, unless the insertion provides one
    """

    dtype: DeviceType | None = None
    condition: Callable[[Any], bool] = _always
    block: str = ""
    sorted: bool = True
    saved: bool = True
    displayed: bool = True
    default: float = 0.0


def _rotation(features: Any) -> bool:
    return bool(features.rotation)


def _clumps(features: Any) -> bool:
    return bool(features.clumps)


def _liquid(features: Any) -> bool:
    return bool(features.liquid_transfer)


_CLUMP_FIELDS = (
    FieldSpec(
        "clump", "", "1", "id of the first sphere of the clump, -1 for a single sphere; only in scenes with "
        "clumps", file_type="int64", dtype="i32", condition=_clumps, default=-1,
    ),
    FieldSpec(
        "clump_size", "", "1", "number of spheres of the clump", file_type="int32", dtype="i32", condition=_clumps,
        displayed=False, default=1,
    ),
    FieldSpec(
        "clump_mass", "M", "kg", "mass of the clump; of a single sphere its own", dtype="real", condition=_clumps,
        block="clump", displayed=False,
    ),
    FieldSpec(
        "clump_inertia", "I", "kg m2", "principal moments of inertia of the clump", "vector", dtype="real",
        condition=_clumps, block="clump", displayed=False,
    ),
    FieldSpec(
        "clump_offset", "", "m", "center of the sphere relative to the center of mass, along the principal axes",
        "vector", "float64", dtype="position", condition=_clumps, block="clump", displayed=False,
    ),
    FieldSpec(
        "clump_position", "", "m", "center of mass of the clump", "vector", "float64", dtype="position",
        condition=_clumps, block="clump", displayed=False,
    ),
    FieldSpec(
        "clump_velocity", "", "m/s", "velocity of the center of mass; on the device half a step behind", "vector",
        dtype="position", condition=_clumps, block="clump", displayed=False,
    ),
    FieldSpec(
        "clump_angular_momentum", "L", "kg m2/s", "angular momentum about the center of mass; on the device half a "
        "step behind", "vector", dtype="position", condition=_clumps, block="clump", displayed=False,
    ),
    FieldSpec(
        "orientation", "q", "1", "quaternion (w, x, y, z) of the rotation from the principal axes of the clump to the "
        "axes of the scene", "quaternion", dtype="position", condition=_clumps, block="clump", default=0.0,
    ),
    FieldSpec(
        "clump_position_at_rebuild", "", "m", "center of mass at the last neighbor-list rebuild", "vector", "float64",
        in_snapshot=False, dtype="position", condition=_clumps, sorted=False, displayed=False,
    ),
    FieldSpec(
        "index_of_id", "", "1", "index of the particle with an id, since the last neighbor-list rebuild",
        in_snapshot=False, dtype="i32", condition=_clumps, sorted=False, saved=False, displayed=False,
    ),
)  # fmt: skip

_LIQUID_FIELDS = (
    FieldSpec(
        "liquid_film", "L", "m3", "volume of the liquid film; only with a cohesion model that transfers liquid",
        file_type="float64", dtype="real", condition=_liquid, block="liquid",
    ),
    FieldSpec(
        "liquid_film_before", "L", "m3", "volume of the film before the forces of this step, from which bridges take "
        "their part", in_snapshot=False, dtype="real", condition=_liquid, block="liquid", saved=False, displayed=False,
    ),
)  # fmt: skip

_PARTICLE_FIELDS = {
    field.name: field
    for field in (
        FieldSpec(
            "position", "x", "m", "center of the sphere", "vector", "float64",
            dtype="position", block="motion", displayed=False,
        ),
        FieldSpec("radius", "R", "m", "radius of the sphere", dtype="real", block="motion"),
        FieldSpec("mass", "m", "kg", "mass of the sphere", dtype="real", block="motion", displayed=False),
        FieldSpec(
            "velocity", "v", "m/s", "velocity of the center; on the device half a step behind", "vector",
            dtype="real", block="motion",
        ),
        FieldSpec(
            "angular_velocity", "w", "rad/s", "angular velocity; on the device half a step behind", "vector",
            dtype="real", condition=_rotation, block="motion",
        ),
        FieldSpec(
            "velocity_synchronized", "v", "m/s", "velocity at the time of the positions, for rate-dependent models",
            "vector", in_snapshot=False, dtype="real", condition=lambda features: features.rate_dependent,
            block="motion", displayed=False,
        ),
        FieldSpec(
            "velocity_remainder", "", "m/s", "part of the velocity that float32 does not resolve", "vector",
            in_snapshot=False, dtype="real", condition=lambda features: features.velocity_remainders,
            block="remainder", displayed=False,
        ),
        FieldSpec(
            "angular_velocity_remainder", "", "rad/s", "part of the angular velocity that float32 does not resolve",
            "vector", in_snapshot=False, dtype="real", block="remainder", displayed=False,
            condition=lambda features: features.velocity_remainders and features.rotation,
        ),
        FieldSpec(
            "force", "F", "N", "total force, gravity included", "vector", dtype="real", block="force", sorted=False
        ),
        FieldSpec(
            "torque", "M", "N m", "total torque about the center", "vector",
            dtype="real", condition=_rotation, block="force", sorted=False, displayed=False,
        ),
        FieldSpec(
            "external_force", "", "N", "part of the force from functions of a program", "vector", in_snapshot=False,
            dtype="real", condition=lambda features: features.external_forces, sorted=False, displayed=False,
        ),
        FieldSpec(
            "damping_force", "", "N", "part of the force from the damping of all motion", "vector", in_snapshot=False,
            dtype="real", condition=lambda features: features.damping != "none" and features.energy_budget,
            sorted=False, displayed=False,
        ),
        FieldSpec(
            "damping_torque", "", "N m", "part of the torque from the damping of all motion", "vector",
            in_snapshot=False, dtype="real", sorted=False, displayed=False,
            condition=lambda features: features.damping != "none" and features.energy_budget and features.rotation,
        ),
        FieldSpec(
            "position_at_rebuild", "x", "m", "position at the last neighbor-list rebuild", "vector", "float64",
            in_snapshot=False, dtype="position", block="rebuild", sorted=False, displayed=False,
        ),
        FieldSpec(
            "reach", "", "m", "displacement since the last neighbor-list rebuild that makes the next one due",
            in_snapshot=False, dtype="position", block="rebuild", displayed=False,
        ),
        FieldSpec("id", "i", "1", "number of the particle, unique in a run", file_type="int64", dtype="i32"),
        FieldSpec(
            "material", "", "1", "index of the material in the scene; on the device, index in the plan",
            file_type="int32", dtype="i32", condition=lambda features: not features.one_material,
        ),
        FieldSpec(
            "fixed", "", "1", "1 for fixed particles; only in scenes with fixed particles", file_type="uint8",
            dtype="i32", condition=lambda features: features.fixed_particles,
        ),
        FieldSpec(
            "coordination_number", "Z", "1", "number of contacts with other particles, evaluated for snapshots",
            file_type="int32", dtype="i32", sorted=False, saved=False,
        ),
        FieldSpec(
            "wall_contact_count", "", "1", "number of contacts with walls, evaluated for snapshots",
            file_type="int32", dtype="i32", condition=lambda features: features.walls, sorted=False, saved=False,
        ),
        *_CLUMP_FIELDS,
        *_LIQUID_FIELDS,
        FieldSpec("group", "", "1", "index of the group of particles in the scene", file_type="int32"),
        FieldSpec("insertion_time", "", "s", "simulated time of the insertion", file_type="float64", displayed=False),
        FieldSpec("diameter", "d", "m", "diameter of the sphere, twice the radius", in_snapshot=False),
        FieldSpec("kinetic_energy", "Ek", "J", "translational kinetic energy, m v^2 / 2", in_snapshot=False),
    )
}  # fmt: skip


PARTICLE_QUANTITIES: Mapping[str, FieldSpec] = MappingProxyType(_PARTICLE_FIELDS)
"""Properties of the particles: device fields in the order of allocation, arrays of Snapshot.particles and of files.

Vectors are in the frame of the scene.
"""
