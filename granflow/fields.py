"""Every quantity of a run, once: name, symbol, SI unit and meaning.

A `Quantity` defines a column or an array of an output file. The tables below list the arrays of particles,
contacts, grids and walls, and the numbers of a run, its flow meters, outlets, groups and walls; a metric has
its quantities in its class in `scene.blocks.metrics`, and `scene.run_numbers` says which numbers a run of a
scene has. Headings, units in messages and pages of the documentation come from them. A property of the
particles is a `FieldSpec`, which also says how the property is stored on the device.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, Literal

import numpy as np

# Definition of a quantity

Kind = Literal["scalar", "vector", "quaternion", "tensor"]
"""Number of components: 1, 3, 4 or 9."""
FileType = Literal["uint8", "int32", "int64", "float32", "float64"]
"""Data types of arrays in VTU files."""


@dataclass(frozen=True)
class Quantity:
    """Definition of one quantity.

    name:         key in snapshots and files
    symbol:       as in formulas; empty without a common symbol
    unit:         SI, "1" for a dimensionless number
    meaning:      description in a few words
    kind:         array shape (n,), (n, 3), (n, 4) (w, x, y, z) or (n, 9) (xx, xy, xz, yx, ...)
    file_type:    data type in VTU files, float32 where 7 digits are sufficient
    in_snapshot:  False for internal fields, and for quantities that are derived when a file is written
    """

    name: str
    symbol: str
    unit: str
    meaning: str
    kind: Kind = "scalar"
    file_type: FileType = "float32"
    in_snapshot: bool = True

    @property
    def label(self) -> str:
        """Column name with unit: `kinetic_energy [J]`; without brackets for a dimensionless number."""
        return self.name if self.unit == "1" else f"{self.name} [{self.unit}]"

    def label_of(self, part: str) -> str:
        """Return the column name of this quantity of one part: `mass_flow.outlet [kg/s]`."""
        return replace(self, name=f"{self.name}.{part}").label

    @property
    def width(self) -> int:
        """Number of components."""
        return {"scalar": 1, "vector": 3, "quaternion": 4, "tensor": 9}[self.kind]

    def shape(self, count: int) -> tuple[int, ...]:
        """Return the shape of the array of this quantity for `count` particles, contacts or cells."""
        return (count,) if self.kind == "scalar" else (count, self.width)

    def for_file(self, values: np.ndarray) -> np.ndarray:
        """Return the values as a contiguous array with the data type of VTU files; the shape is unchanged."""
        return np.ascontiguousarray(values, dtype=np.dtype(self.file_type))


def by_name(quantities: Iterable[Quantity]) -> Mapping[str, Quantity]:
    """Read-only mapping from name to definition, in the given order."""
    return MappingProxyType({quantity.name: quantity for quantity in quantities})


def units(quantities: Mapping[str, Quantity]) -> Mapping[str, str]:
    """SI units by name, without those of dimensionless quantities."""
    return MappingProxyType({name: each.unit for name, each in quantities.items() if each.unit != "1"})


# Properties of the particles: device fields, arrays of snapshots, files and checkpoints

DeviceType = Literal["position", "real", "f64", "i32", "i64"]
"""Types on the device: "position" is f64, in precision f32 f32; "real" is f64 in precision f64, else f32."""


def _always(features: Any) -> bool:
    return True


@dataclass(frozen=True)
class FieldSpec(Quantity):
    """Definition of one property of the particles: a scalar, a vector, or a quaternion.

    Allocation, sorting, insertion, checkpoints and their validation, snapshots, VTU files and the memory
    estimate are derived from it.

    dtype:      type of the device field; None for a property without one
    condition:  function of the features of a plan: whether the field exists
    block:      fields that follow each other with the same block are interleaved entry by entry, because
                kernels read them together
    of_ghosts:  sent in every step to the MPI ranks that have a ghost of the particle; these fields are one
                block, so that they are sent as one record
    sorted:     permuted with the particles at a neighbor-list rebuild; other fields are computed again after
                it
    saved:      in checkpoints
    displayed:  in particle files, if it is present
    default:    value of inserted particles, unless the insertion provides one
    """

    dtype: DeviceType | None = None
    condition: Callable[[Any], bool] = _always
    block: str = ""
    of_ghosts: bool = False
    sorted: bool = True
    saved: bool = True
    displayed: bool = True
    default: float = 0.0


def _attached(features: Any) -> bool:
    return bool(features.attached_particles)


def _rotation(features: Any) -> bool:
    return bool(features.rotation)


def _clumps(features: Any) -> bool:
    return bool(features.clumps)


def _clumps_with_flows(features: Any) -> bool:
    return bool(features.clumps and features.flows)


def _liquid(features: Any) -> bool:
    return bool(features.liquid_transfer)


_CLUMP_FIELDS = (
    FieldSpec(
        "clump",
        "",
        "1",
        "id of the first sphere of the clump, -1 for a single sphere; only in scenes with clumps",
        file_type="int64",
        dtype="i32",
        condition=_clumps,
        default=-1,
    ),
    FieldSpec(
        "clump_size",
        "",
        "1",
        "number of spheres of the clump",
        file_type="int32",
        dtype="i32",
        condition=_clumps,
        displayed=False,
        default=1,
    ),
    FieldSpec(
        "clump_mass",
        "M",
        "kg",
        "mass of the clump; of a single sphere its own",
        dtype="real",
        condition=_clumps,
        block="clump",
        displayed=False,
    ),
    FieldSpec(
        "clump_inertia",
        "I",
        "kg m2",
        "principal moments of inertia of the clump",
        "vector",
        dtype="real",
        condition=_clumps,
        block="clump",
        displayed=False,
    ),
    FieldSpec(
        "clump_offset",
        "",
        "m",
        "center of the sphere relative to the center of mass, along the principal axes",
        "vector",
        "float64",
        dtype="position",
        condition=_clumps,
        block="clump",
        displayed=False,
    ),
    FieldSpec(
        "clump_position",
        "",
        "m",
        "center of mass of the clump",
        "vector",
        "float64",
        dtype="position",
        condition=_clumps,
        block="clump",
        displayed=False,
    ),
    FieldSpec(
        "clump_velocity",
        "",
        "m/s",
        "velocity of the center of mass; on the device half a step behind",
        "vector",
        dtype="position",
        condition=_clumps,
        block="clump",
        displayed=False,
    ),
    FieldSpec(
        "clump_angular_momentum",
        "L",
        "kg m2/s",
        "angular momentum about the center of mass; on the device half a step behind",
        "vector",
        dtype="position",
        condition=_clumps,
        block="clump",
        displayed=False,
    ),
    FieldSpec(
        "orientation",
        "q",
        "1",
        "quaternion (w, x, y, z) of the rotation from the principal axes of the clump to the "
        "axes of the scene",
        "quaternion",
        dtype="position",
        condition=_clumps,
        block="clump",
        default=0.0,
    ),
    FieldSpec(
        "clump_position_at_rebuild",
        "",
        "m",
        "center of mass at the last neighbor-list rebuild",
        "vector",
        "float64",
        in_snapshot=False,
        dtype="position",
        condition=_clumps,
        sorted=False,
        displayed=False,
    ),
    FieldSpec(
        "index_by_id",
        "",
        "1",
        "index of each particle, by its id, or on MPI ranks of the owned particles in the order of their ids",
        in_snapshot=False,
        dtype="i32",
        condition=_clumps,
        sorted=False,
        saved=False,
        displayed=False,
    ),
    FieldSpec(
        "clump_begin",
        "",
        "1",
        "place of the first sphere of the clump in `index_by_id`, which the others follow",
        in_snapshot=False,
        dtype="i32",
        condition=_clumps,
        sorted=False,
        saved=False,
        displayed=False,
    ),
    FieldSpec(
        "exposed_share",
        "",
        "1",
        "share of the surface of the sphere that lies in no other sphere of its clump; 1 for a single sphere",
        in_snapshot=False,
        dtype="f64",
        condition=_clumps_with_flows,
        displayed=False,
        default=1.0,
    ),
)
_LIQUID_FIELDS = (
    FieldSpec(
        "liquid_film",
        "L",
        "m3",
        "volume of the liquid film; only with a cohesion model that transfers liquid",
        file_type="float64",
        dtype="real",
        condition=_liquid,
        block="liquid",
    ),
    FieldSpec(
        "liquid_film_before",
        "L",
        "m3",
        "volume of the film before the forces of this step, from which bridges take their part",
        in_snapshot=False,
        dtype="real",
        condition=_liquid,
        block="liquid",
        saved=False,
        displayed=False,
    ),
)
_PARTICLE_FIELDS = {
    field.name: field
    for field in (
        FieldSpec(
            "position",
            "x",
            "m",
            "center of the sphere",
            "vector",
            "float64",
            dtype="position",
            block="motion",
            of_ghosts=True,
            displayed=False,
        ),
        FieldSpec("radius", "R", "m", "radius of the sphere", dtype="real", block="motion", of_ghosts=True),
        FieldSpec(
            "mass",
            "m",
            "kg",
            "mass of the sphere",
            dtype="real",
            block="motion",
            of_ghosts=True,
            displayed=False,
        ),
        FieldSpec(
            "velocity",
            "v",
            "m/s",
            "velocity of the center; on the device half a step behind",
            "vector",
            dtype="real",
            block="motion",
            of_ghosts=True,
        ),
        FieldSpec(
            "angular_velocity",
            "w",
            "rad/s",
            "angular velocity; on the device half a step behind",
            "vector",
            dtype="real",
            condition=_rotation,
            block="motion",
            of_ghosts=True,
        ),
        FieldSpec(
            "velocity_synchronized",
            "v",
            "m/s",
            "velocity at the time of the positions, for rate-dependent models",
            "vector",
            in_snapshot=False,
            dtype="real",
            condition=lambda features: features.synchronized,
            block="motion",
            of_ghosts=True,
            displayed=False,
        ),
        FieldSpec(
            "angular_velocity_synchronized",
            "w",
            "rad/s",
            "angular velocity at the time of the positions, for viscous forces of cohesion models",
            "vector",
            in_snapshot=False,
            dtype="real",
            condition=lambda features: features.viscous_cohesion,
            block="motion",
            of_ghosts=True,
            displayed=False,
        ),
        FieldSpec(
            "velocity_remainder",
            "",
            "m/s",
            "part of the velocity that float32 does not resolve",
            "vector",
            in_snapshot=False,
            dtype="real",
            condition=lambda features: features.velocity_remainders,
            block="remainder",
            displayed=False,
        ),
        FieldSpec(
            "angular_velocity_remainder",
            "",
            "rad/s",
            "part of the angular velocity that float32 does not resolve",
            "vector",
            in_snapshot=False,
            dtype="real",
            block="remainder",
            displayed=False,
            condition=lambda features: features.velocity_remainders and features.rotation,
        ),
        FieldSpec(
            "force",
            "F",
            "N",
            "total force, gravity included; of particles that move with a wall, that of their contacts",
            "vector",
            dtype="real",
            block="force",
            sorted=False,
        ),
        FieldSpec(
            "torque",
            "M",
            "N m",
            "total torque about the center",
            "vector",
            dtype="real",
            condition=_rotation,
            block="force",
            sorted=False,
            displayed=False,
        ),
        FieldSpec(
            "external_force",
            "",
            "N",
            "part of the force from functions of a program",
            "vector",
            in_snapshot=False,
            dtype="real",
            condition=lambda features: features.external_forces,
            sorted=False,
            displayed=False,
        ),
        FieldSpec(
            "damping_force",
            "",
            "N",
            "part of the force from the damping of all motion",
            "vector",
            in_snapshot=False,
            dtype="real",
            condition=lambda features: features.damping != "none" and features.energy_budget,
            sorted=False,
            displayed=False,
        ),
        FieldSpec(
            "damping_torque",
            "",
            "N m",
            "part of the torque from the damping of all motion",
            "vector",
            in_snapshot=False,
            dtype="real",
            sorted=False,
            displayed=False,
            condition=lambda features: (
                features.damping != "none" and features.energy_budget and features.rotation
            ),
        ),
        FieldSpec(
            "position_at_rebuild",
            "x",
            "m",
            "position at the last neighbor-list rebuild",
            "vector",
            "float64",
            in_snapshot=False,
            dtype="position",
            block="rebuild",
            sorted=False,
            displayed=False,
        ),
        FieldSpec(
            "reach",
            "",
            "m",
            "displacement since the last neighbor-list rebuild that makes the next one due",
            in_snapshot=False,
            dtype="position",
            block="rebuild",
            displayed=False,
        ),
        FieldSpec("id", "i", "1", "number of the particle, unique in a run", file_type="int64", dtype="i32"),
        FieldSpec(
            "material",
            "",
            "1",
            "index of the material in the scene; on the device, index in the plan",
            file_type="int32",
            dtype="i32",
            condition=lambda features: not features.one_material,
        ),
        FieldSpec(
            "fixed",
            "",
            "1",
            "1 for fixed particles; only in scenes with fixed particles",
            file_type="uint8",
            dtype="i32",
            condition=lambda features: features.fixed_particles,
        ),
        FieldSpec(
            "attached_to",
            "",
            "1",
            "index in the scene of the wall with which a fixed particle moves, -1 for others; only in scenes "
            "with such particles",
            file_type="int32",
            dtype="i32",
            default=-1,
            condition=_attached,
        ),
        FieldSpec(
            "attached_position",
            "",
            "m",
            "position of a particle that moves with a wall, in the frame of the wall at rest",
            "vector",
            "float64",
            in_snapshot=False,
            dtype="position",
            block="attached",
            displayed=False,
            condition=_attached,
        ),
        FieldSpec(
            "attached_normal",
            "",
            "1",
            "normal toward the particle of the wall with which it moves, in the frame of the wall at rest",
            "vector",
            in_snapshot=False,
            dtype="position",
            block="attached",
            displayed=False,
            condition=_attached,
        ),
        FieldSpec(
            "coordination_number",
            "Z",
            "1",
            "number of contacts with other particles, evaluated for snapshots",
            file_type="int32",
            dtype="i32",
            sorted=False,
            saved=False,
        ),
        FieldSpec(
            "wall_contact_count",
            "",
            "1",
            "number of contacts with walls, evaluated for snapshots",
            file_type="int32",
            dtype="i32",
            condition=lambda features: features.walls,
            sorted=False,
            saved=False,
        ),
        *_CLUMP_FIELDS,
        *_LIQUID_FIELDS,
        FieldSpec(
            "loss_heat",
            "",
            "J",
            "heat from the losses of the last step, in units of `plan.loss_heat_unit`",
            file_type="int64",
            in_snapshot=False,
            dtype="i64",
            condition=lambda features: features.loss_heat,
            displayed=False,
        ),
        FieldSpec(
            "loss_heat_ahead",
            "",
            "J",
            "part of `loss_heat` from losses during the next half step, as `losses_ahead` of the budget",
            file_type="int64",
            in_snapshot=False,
            dtype="i64",
            condition=lambda features: features.loss_heat_ahead,
            displayed=False,
        ),
        FieldSpec(
            "group",
            "",
            "1",
            "index of the group of particles in the scene",
            file_type="int32",
            dtype="i32",
            condition=lambda features: features.wall_groups,
        ),
        FieldSpec(
            "insertion_time", "", "s", "simulated time of the insertion", file_type="float64", displayed=False
        ),
        FieldSpec("diameter", "d", "m", "diameter of the sphere, twice the radius", in_snapshot=False),
        FieldSpec("kinetic_energy", "Ek", "J", "translational kinetic energy, m v^2 / 2", in_snapshot=False),
    )
}
PARTICLE_QUANTITIES: Mapping[str, FieldSpec] = MappingProxyType(_PARTICLE_FIELDS)
"""Properties of the particles: device fields in the order of allocation, arrays of Snapshot.particles and of
files.

Vectors are in the frame of the scene.
"""


def add(field: FieldSpec) -> None:
    """Add a property that a contact model or a particle equation declares, behind the others of its block.

    A sum that several contact models declare is added once. Raises ValueError for a property of this name
    with another unit.
    """
    known = _PARTICLE_FIELDS.get(field.name)
    if known is not None:
        if (known.unit, known.dtype, known.block) != (field.unit, field.dtype, field.block):
            raise ValueError(f"a property {field.name} of the particles exists")
        return
    items = list(_PARTICLE_FIELDS.items())
    place = max((k + 1 for k, (_, each) in enumerate(items) if each.block == field.block), default=len(items))
    items.insert(place if field.block else len(items), (field.name, field))
    _PARTICLE_FIELDS.clear()
    _PARTICLE_FIELDS.update(items)


def remove(name: str) -> None:
    """Remove a property that was added."""
    del _PARTICLE_FIELDS[name]


WALL_FLOW_QUANTITIES: dict[str, Quantity] = {}
"""Numbers of each wall that gives something to particles; contact models add them."""


# Arrays of contacts, of fields on grids, and of walls

CONTACT_QUANTITIES = by_name(
    (
        Quantity("id_i", "i", "1", "id of particle i", file_type="int64"),
        Quantity("id_j", "j", "1", "id of particle j, -1 for a contact with a wall", file_type="int64"),
        Quantity("wall", "", "1", "index of the wall in the scene, -1 between particles", file_type="int32"),
        Quantity("triangle", "", "1", "index of the triangle of a mesh wall, else -1", file_type="int32"),
        Quantity("position_i", "xi", "m", "center of particle i", "vector", "float64"),
        Quantity(
            "position_j", "xj", "m", "center of particle j, or contact point on the wall", "vector", "float64"
        ),
        Quantity(
            "force", "F", "N", "total force on particle i, including viscous and friction force", "vector"
        ),
        Quantity("normal_force", "Fn", "N", "repulsive force along the normal"),
        Quantity("tangential_force", "Ft", "N", "magnitude of the friction force"),
        Quantity(
            "overlap",
            "delta",
            "m",
            "sum of the radii minus the distance of the centers; negative for a cohesive force at a distance",
        ),
        Quantity("overlap_max", "delta_max", "m", "largest overlap since the contact began"),
        Quantity("restitution", "e", "1", "coefficient of restitution of the contact"),
        Quantity("unloading", "", "1", "0 loading, 1 unloading", file_type="uint8"),
        Quantity("sliding", "", "1", "1 where the friction force is at the Coulomb limit", file_type="uint8"),
    )
)
"""Arrays of Snapshot.contacts and of contact files."""
FIELD_QUANTITIES = by_name(
    (
        Quantity("density", "rho", "kg/m3", "mass of particles per volume of space"),
        Quantity("solid_fraction", "phi", "1", "volume of particles per volume of space"),
        Quantity("momentum", "rho V", "kg/(m2 s)", "momentum per volume of space", "vector"),
        Quantity("velocity", "V", "m/s", "momentum over density", "vector"),
        Quantity(
            "temperature", "T", "K", "mean temperature of the particles, by mass; only with contact.heat"
        ),
        Quantity("granular_temperature", "T", "m2/s2", "mean square of each component of v - V", "scalar"),
        Quantity(
            "granular_temperature_of_frames",
            "",
            "m2/s2",
            "the same; in means over time without changes of V in time",
        ),
        Quantity("kinetic_stress", "", "Pa", "flux of momentum by v - V, positive in tension", "tensor"),
        Quantity("contact_stress", "", "Pa", "stress of the contact forces, positive in tension", "tensor"),
        Quantity("pressure", "p", "Pa", "minus a third of the trace of both stresses"),
        Quantity("coordination_number", "Z", "1", "mean number of contacts with particles per particle"),
        Quantity(
            "fabric", "", "1", "mean of n n over the contacts between particles, n their direction", "tensor"
        ),
    )
)
"""Arrays of coarse-grained fields, one entry per grid point."""
WALL_ARRAY_QUANTITIES = by_name(
    (
        Quantity("wall", "", "1", "index of the wall in the scene", file_type="int32"),
        Quantity(
            "traction", "", "Pa", "force of the particles per area, with `output.wall_forces`", "vector"
        ),
        Quantity("pressure", "p", "Pa", "normal force of the particles per area, with `output.wall_forces`"),
        Quantity(
            "surface_velocity",
            "",
            "m/s",
            "velocity of a belt along the triangle, if a wall has one",
            "vector",
        ),
        Quantity("wear_depth", "", "m", "worn volume per area since the start, if a wall has `wear`"),
        Quantity("wear_normal_work", "", "J/m2", "work of the normal forces per area, likewise"),
        Quantity("wear_tangential_work", "", "J/m2", "work of the friction forces per area, likewise"),
        Quantity("temperature", "T", "K", "temperature, if a wall has one"),
    )
)
"""Arrays of wall files, one entry per triangle."""
WEAR_ARRAYS = ("wear_depth", "wear_normal_work", "wear_tangential_work")
"""Arrays of wall files with wear, in the order of the columns of `Snapshot.wear`, per area."""


# Numbers of a run, of its flow meters, outlets, groups and walls

_STATE_QUANTITIES = by_name(
    (
        Quantity("particle_count", "N", "1", "particles present"),
        Quantity("inserted_count", "", "1", "particles inserted since the start"),
        Quantity("queued_count", "", "1", "particles due but queued for lack of space; only with insertion"),
        Quantity("deleted_count", "", "1", "particles deleted at the domain boundary, by outlets and stages"),
        Quantity(
            "deleted_mass",
            "",
            "kg",
            "mass of particles deleted at the domain boundary, by outlets and stages",
        ),
        Quantity("contact_count", "Nc", "1", "contacts between particles and with walls, each counted once"),
        Quantity("wall_contact_count", "", "1", "contacts of particles with walls"),
        Quantity("kinetic_energy", "Ek", "J", "translational kinetic energy"),
        Quantity("rotational_energy", "Er", "J", "rotational kinetic energy"),
        Quantity("overlap_mean", "", "1", "mean overlap of the contacts over the smaller radius"),
        Quantity("overlap_largest", "", "1", "largest overlap of the contacts over the smaller radius"),
        Quantity(
            "coordination_number", "Z", "1", "mean number of contacts with particles per mobile particle"
        ),
        Quantity(
            "liquid_film_volume", "", "m3", "liquid in the films of the particles; only with liquid transfer"
        ),
        Quantity("liquid_bridge_volume", "", "m3", "liquid in the bridges; only with liquid transfer"),
        Quantity("shear_strain", "", "1", "shear strain of the box since the start"),
        *(Quantity(f"gravity_{axis}", "", "m/s2", f"gravity along {axis}, if it changes") for axis in "xyz"),
    )
)
BOX_QUANTITIES = by_name(
    (
        *(Quantity(f"box_width_{axis}", "", "m", f"width of a deforming box along {axis}") for axis in "xyz"),
        *(
            Quantity(f"box_strain_{axis}", "", "1", f"logarithmic strain of a deforming box along {axis}")
            for axis in "xyz"
        ),
        *(
            Quantity(
                f"box_pressure_{axis}",
                "",
                "Pa",
                f"mean stress of the contacts of a deforming box along {axis}, compression positive",
            )
            for axis in "xyz"
        ),
        Quantity("box_pressure", "p", "Pa", "mean of the three pressures in a deforming box"),
        Quantity("stress_ratio", "q/p", "1", "deviator of the three pressures over their mean"),
        Quantity(
            "volumetric_strain", "", "1", "sum of the strains of a deforming box, negative in compression"
        ),
        Quantity("solid_fraction", "", "1", "volume of the particles over that of a deforming box"),
    )
)
"""Totals that require a deforming box."""
ENERGY_BUDGET_QUANTITIES = by_name(
    (
        Quantity("gravitational_energy", "Eg", "J", "potential energy in gravity, zero at the origin"),
        Quantity("elastic_energy", "Ee", "J", "recoverable energy stored in contacts"),
        Quantity("plastic_dissipation", "", "J", "energy dissipated by unloading steeper than loading"),
        Quantity("friction_dissipation", "", "J", "energy dissipated by sliding friction"),
        Quantity("rolling_dissipation", "", "J", "energy dissipated by rolling and twisting friction"),
        Quantity(
            "damping_dissipation", "", "J", "energy dissipated by damping: in contacts, and of all motion"
        ),
        Quantity("wall_work", "", "J", "work of moving walls and belts on the particles"),
        Quantity(
            "boundary_work",
            "",
            "J",
            "work at periodic boundaries: of gravity on wrapped particles, and of moving images",
        ),
        Quantity("external_work", "", "J", "work of the forces from functions of a program on the particles"),
        Quantity(
            "gravity_work", "", "J", "work of gravity on the particles beyond that of gravity at the start"
        ),
        Quantity("free_wall_energy", "", "J", "kinetic energy of free walls"),
        Quantity(
            "free_wall_work", "", "J", "work of gravity, damping and the prescribed force on free walls"
        ),
        Quantity("removed_energy", "", "J", "energy of deleted minus energy of inserted particles"),
        Quantity(
            "energy_error",
            "",
            "1",
            "residual of the energy budget over the largest energy input so far",
        ),
    )
)
"""Totals that require `output.energy_budget`."""
TOTAL_QUANTITIES = {**_STATE_QUANTITIES, **BOX_QUANTITIES, **ENERGY_BUDGET_QUANTITIES}
"""Numbers of Snapshot.totals and columns of the time series."""


def _over_stages(total: Quantity) -> dict[str, Quantity]:
    """Mean and largest value of a total over the rows of a stage."""
    return {
        f"{total.name}_{end}": replace(
            total,
            name=f"{total.name}_{end}",
            symbol="",
            meaning=f"{kind} of the rows of a stage: {total.meaning}",
        )
        for end, kind in (("mean", "mean"), ("largest", "largest value"))
    }


STAGE_QUANTITIES = {
    name: each for total in TOTAL_QUANTITIES.values() for name, each in _over_stages(total).items()
}
"""Numbers of the totals over the rows of each stage; the part is the stage, without it the last one."""


def add_total(total: Quantity) -> None:
    """Add a total that a contact model or a particle equation declares."""
    TOTAL_QUANTITIES[total.name] = total
    STAGE_QUANTITIES.update(_over_stages(total))


def remove_total(total: Quantity) -> None:
    """Remove a total that was added."""
    del TOTAL_QUANTITIES[total.name]
    for name in _over_stages(total):
        del STAGE_QUANTITIES[name]


FLOW_METER_QUANTITIES = by_name(
    (
        Quantity("flow_mass", "", "kg", "net mass through the meter since the start"),
        Quantity("flow_count", "", "1", "net number of particles through the meter since the start"),
        Quantity(
            "mass_flow",
            "",
            "kg/s",
            "mass flow rate: between rows in the time series, steady mean in the result",
        ),
        Quantity(
            "mass_flow_error",
            "",
            "kg/s",
            "standard error of the steady mean from the fluctuation of the flow in time, or from the number "
            "of few particles, in the result",
        ),
        Quantity(
            "residence_time",
            "",
            "s",
            "mean time from insertion to passage of the particles that passed forward: since the previous "
            "row in the time series, of all in the result",
        ),
        Quantity("residence_time_deviation", "", "s", "standard deviation of these times, in the result"),
        Quantity("mass_flow_mean", "", "kg/s", "mean mass flow rate over the last stage, in the result"),
        Quantity("mass_flow_error_mean", "", "kg/s", "standard error of this mean, in the result"),
        Quantity(
            "residence_time_mean",
            "",
            "s",
            "mean time from insertion to passage of the particles that passed forward in the last stage, in "
            "the result",
        ),
    )
)
"""Numbers of each flow meter."""
RESIDENCE_QUANTITIES = by_name(
    (
        Quantity("residence_count", "", "1", "particles whose residence time is known"),
        Quantity("residence_mean", "", "s", "mean residence time of `output.residence_time`, by mass"),
        Quantity("residence_deviation", "", "s", "standard deviation of these times, by mass"),
        Quantity("residence_stage_mean", "", "s", "mean of the times that end in the last stage, by mass"),
        Quantity(
            "tanks_in_series",
            "",
            "1",
            "number of ideal mixed tanks in series: mean squared over variance",
        ),
        Quantity("residing_count", "", "1", "particles that have entered and not left"),
        Quantity("residing_mass", "", "kg", "mass of these particles, the hold-up"),
        Quantity("residing_count_mean", "", "1", "mean of residing_count over the rows of the last stage"),
        Quantity("residing_mass_mean", "", "kg", "mean of the hold-up over the rows of the last stage"),
    )
)
"""Numbers of `output.residence_time`, in the result; the part is the flow meter at its end."""
HOLD_UP = ("residing_count", "residing_mass")
"""Those of RESIDENCE_QUANTITIES that the time series has as columns."""
OUTLET_QUANTITIES = by_name(
    (
        Quantity("outlet_count", "", "1", "particles deleted by the outlet since the start"),
        Quantity("outlet_mass", "", "kg", "mass deleted by the outlet since the start"),
    )
)
"""Numbers of each outlet."""
INSERTION_QUANTITIES = by_name(
    (
        Quantity("inserted_count", "", "1", "inserted particles of the group"),
        Quantity("inserted_mass", "", "kg", "mass of the inserted particles of the group"),
        Quantity("not_inserted_count", "", "1", "particles of the group not inserted at the end"),
    )
)
"""Numbers of each inserted particle group, in the result."""
WALL_FORCE_QUANTITIES = by_name(
    (
        Quantity(
            "wall_force_x", "Fx", "N", "x component of the force of the particles on a wall, time average"
        ),
        Quantity("wall_force_y", "Fy", "N", "y component"),
        Quantity("wall_force_z", "Fz", "N", "z component"),
        Quantity(
            "wall_torque_x", "Mx", "N m", "x component of the torque about the reference point of the wall"
        ),
        Quantity("wall_torque_y", "My", "N m", "y component"),
        Quantity("wall_torque_z", "Mz", "N m", "z component"),
        Quantity(
            "wall_pressure", "p", "Pa", "sum of the normal forces of the particles over the area of the wall"
        ),
        Quantity(
            "wall_power",
            "P",
            "W",
            "power of the motions and of the belt of a wall on the particles, time average",
        ),
        Quantity("wall_force", "F", "N", "magnitude of the mean force, in the result"),
        Quantity("wall_torque", "M", "N m", "magnitude of the mean torque, in the result"),
        Quantity("wall_force_largest", "", "N", "largest magnitude of the force in a row, in the result"),
        Quantity("wall_pressure_largest", "", "Pa", "largest pressure in a row, in the result"),
        Quantity("wall_power_largest", "", "W", "largest magnitude of the power in a row, in the result"),
        *(
            Quantity(
                f"wall_{name}_{axis}_last",
                "",
                unit,
                f"{axis} component of the {name} in the last row, in the result",
            )
            for name, unit in (("force", "N"), ("torque", "N m"))
            for axis in "xyz"
        ),
        Quantity("wall_pressure_last", "", "Pa", "pressure in the last row, in the result"),
        Quantity("wall_power_last", "", "W", "power in the last row, in the result"),
    )
)
"""Numbers of each measured wall."""
WALL_QUANTITIES = by_name(
    (
        Quantity(
            "wall_displacement",
            "",
            "m",
            "displacement of a controlled wall along its direction, of all motions",
        ),
        Quantity(
            "wall_velocity", "", "m/s", "velocity of a controlled wall along its direction, of all motions"
        ),
    )
)
"""Numbers of each controlled wall."""
WEAR_QUANTITIES = by_name(
    (
        Quantity("wear_volume", "", "m3", "volume worn from a wall since the start, see `wear` of walls"),
        Quantity(
            "wear_depth_largest",
            "",
            "m",
            "largest worn volume over area of the triangles of a mesh, or that of a wall of another shape",
        ),
        Quantity("wear_normal_work", "", "J", "work of the normal forces on a worn wall, without its sign"),
        Quantity("wear_tangential_work", "", "J", "work of the friction forces on a worn wall, likewise"),
    )
)
"""Numbers of each wall with wear."""
RUN_QUANTITIES = by_name(
    (
        Quantity("simulated_time", "t", "s", "simulated time at the end"),
        Quantity("step_count", "", "1", "number of completed steps"),
        Quantity("time_step", "dt", "s", "time step"),
        Quantity("rebuild_count", "", "1", "rebuilds of the neighbor list"),
        Quantity("wall_clock", "", "s", "wall-clock time of the whole run, including compilation"),
        Quantity("warning_count", "", "1", "number of different warnings of the run"),
        Quantity(
            "steps_per_second",
            "",
            "1/s",
            "steps per second of computing time: without compilation and output",
        ),
        Quantity("particle_steps_per_second", "", "1/s", "particle-steps per second of computing time"),
        Quantity(
            "steps_per_second_of_wall_clock",
            "",
            "1/s",
            "steps per second of `wall_clock`: with compilation and output",
        ),
    )
)
"""Numbers of a whole run, in the result."""
METRIC_QUANTITIES: dict[str, Quantity] = {}
"""Numbers of each metric of the bed, and their means over the last stage; the kinds of metrics add them."""
TIMING_QUANTITIES = by_name((Quantity("timings", "", "s", "wall-clock time of a phase of the run"),))
"""Numbers of each phase of a run."""


@dataclass(frozen=True, eq=False)
class PartQuantities:
    """Quantities that a run has for each part of one kind; QUANTITY.PART as in `mass_flow.outlet`.

    kind:        of the parts, in messages
    quantities:  by name
    part:        what follows the point, in messages
    in_rows:     whether rows of the time series have the quantity of a name; all of them are in the result
    """

    kind: str
    quantities: Mapping[str, Quantity]
    part: str
    in_rows: Callable[[str], bool] = lambda name: True


METRIC_PARTS = PartQuantities(
    "metric", METRIC_QUANTITIES, "the name of a metric", lambda name: not name.endswith("_mean")
)
FLOW_METER_PARTS = PartQuantities(
    "flow meter",
    FLOW_METER_QUANTITIES,
    "the name of a flow meter",
    lambda name: not name.endswith(("_error", "_deviation", "_mean")),
)
STAGE_PARTS = PartQuantities("stage", STAGE_QUANTITIES, "the name of a stage", lambda name: False)
OUTLET_PARTS = PartQuantities("outlet", OUTLET_QUANTITIES, "the name of an outlet")
RESIDENCE_PARTS = PartQuantities(
    "flow meter", RESIDENCE_QUANTITIES, "the name of the flow meter `to`", lambda name: name in HOLD_UP
)
INSERTION_PARTS = PartQuantities(
    "inserted group",
    INSERTION_QUANTITIES,
    "the name of a particle group",
    lambda name: name == "inserted_count",
)
WALL_FORCE_PARTS = PartQuantities(
    "wall",
    WALL_FORCE_QUANTITIES,
    "the name of a wall",
    lambda name: name not in ("wall_force", "wall_torque") and not name.endswith(("_largest", "_last")),
)
CONTROLLED_WALL_PARTS = PartQuantities("wall moved by forces", WALL_QUANTITIES, "the name of a wall")
WALL_FLOW_PARTS = PartQuantities(
    "wall with a temperature or heat flux", WALL_FLOW_QUANTITIES, "the name of a wall"
)
WEAR_PARTS = PartQuantities("worn wall", WEAR_QUANTITIES, "the name of a wall")
TIMING_PARTS = PartQuantities("phase", TIMING_QUANTITIES, "forces or another phase", lambda name: False)
PART_KINDS = (
    METRIC_PARTS, FLOW_METER_PARTS, STAGE_PARTS, OUTLET_PARTS, RESIDENCE_PARTS, INSERTION_PARTS,
    WALL_FORCE_PARTS, CONTROLLED_WALL_PARTS, WALL_FLOW_PARTS, WEAR_PARTS, TIMING_PARTS,
)  # fmt: skip
"""All kinds of parts; if two have a quantity of one name, messages name the first."""


def parts_with(quantity: str) -> Iterator[PartQuantities]:
    """The kinds of parts that have a quantity of this name."""
    return (each for each in PART_KINDS if quantity in each.quantities)


def whole_quantity(name: str) -> Quantity | None:
    """Definition of a number of the whole run, or of its last stage; None if there is none of this name."""
    return TOTAL_QUANTITIES.get(name) or STAGE_QUANTITIES.get(name) or RUN_QUANTITIES.get(name)


def quantity_of(name: str) -> Quantity | None:
    """Definition of a number of a run with the name QUANTITY or QUANTITY.PART; None if there is none."""
    quantity, point, _ = name.partition(".")
    if not point:
        return whole_quantity(name)
    return next((each.quantities[quantity] for each in parts_with(quantity)), None)
