"""The glossary as data: every quantity that a `Snapshot` can hold, with its unit and what it means.

One word per thing: the name here is the key in a `Snapshot`, the name of the array in a VTU file and, for
totals, the name of the column in `timeseries.csv` and of the quantity in a scene's `expect:` block. All units
are SI.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Literal

import numpy as np

Kind = Literal["scalar", "vector", "tensor"]
FileType = Literal["uint8", "int32", "int64", "float32", "float64"]


@dataclass(frozen=True)
class Quantity:
    """One word of the glossary.

    `unit` is SI, "1" for a pure number. `kind` tells (n,), (n, 3) and (n, 9) (xx, xy, xz, yx, ...) apart.
    `file_type` is the width written to VTU files: float32 wherever its 7 digits are enough to look at and to
    post-process. `stored` is False for what is worked out from other arrays when a file is written.
    """

    name: str
    symbol: str
    unit: str
    meaning: str
    kind: Kind = "scalar"
    file_type: FileType = "float32"
    stored: bool = True

    @property
    def vtu_name(self) -> str:
        """Name of the array in VTU files: the name itself, so that there is one word per thing."""
        return self.name

    @property
    def label(self) -> str:
        """Name with its unit for the head of a table: `kinetic_energy [J]`; a pure number has no brackets."""
        return self.name if self.unit == "1" else f"{self.name} [{self.unit}]"

    def label_of(self, part: str) -> str:
        """Name of this quantity of one part, with its unit: `mass_flow.outlet [kg/s]`."""
        return replace(self, name=f"{self.name}.{part}").label

    def shape(self, count: int) -> tuple[int, ...]:
        """Shape of the array that holds this quantity for `count` particles, contacts or cells."""
        return {"scalar": (count,), "vector": (count, 3), "tensor": (count, 9)}[self.kind]

    def for_file(self, values: np.ndarray) -> np.ndarray:
        """Give the values the width in which they are written to VTU files."""
        return np.ascontiguousarray(values, dtype=np.dtype(self.file_type))


def _by_name(quantities: Iterable[Quantity]) -> Mapping[str, Quantity]:
    return MappingProxyType({quantity.name: quantity for quantity in quantities})


PARTICLE_QUANTITIES = _by_name(
    (
        Quantity("id", "i", "1", "number of the particle, never used twice in a run", file_type="int64"),
        Quantity("position", "x", "m", "center of the sphere", "vector", "float64"),
        Quantity("radius", "R", "m", "radius of the sphere"),
        Quantity("mass", "m", "kg", "mass of the sphere"),
        Quantity("velocity", "v", "m/s", "velocity of the center", "vector"),
        Quantity("angular_velocity", "w", "rad/s", "angular velocity", "vector"),
        Quantity("force", "F", "N", "total force, gravity included", "vector"),
        Quantity("torque", "M", "N m", "total torque about the center", "vector"),
        Quantity("material", "", "1", "index of the material in the scene", file_type="int32"),
        Quantity("group", "", "1", "index of the group of particles in the scene", file_type="int32"),
        Quantity("coordination_number", "Z", "1", "number of contacts of the particle", file_type="int32"),
        Quantity("fixed", "", "1", "1 for particles that never move; only where a scene has such", file_type="uint8"),
        Quantity("diameter", "d", "m", "diameter of the sphere, twice the radius", stored=False),
        Quantity("kinetic_energy", "Ek", "J", "kinetic energy of the center, m v^2 / 2", stored=False),
    )
)

CONTACT_QUANTITIES = _by_name(
    (
        Quantity("id_i", "i", "1", "id of particle i", file_type="int64"),
        Quantity("id_j", "j", "1", "id of particle j, -1 where i touches a wall", file_type="int64"),
        Quantity("wall", "", "1", "index of the wall in the scene, -1 between particles", file_type="int32"),
        Quantity("triangle", "", "1", "index of the triangle of a wall that is a mesh, else -1", file_type="int32"),
        Quantity("position_i", "xi", "m", "center of particle i", "vector", "float64"),
        Quantity("position_j", "xj", "m", "center of j, or foot point on the wall", "vector", "float64"),
        Quantity("force", "F", "N", "total force on particle i, viscous and friction force included", "vector"),
        Quantity("normal_force", "Fn", "N", "repulsion along the normal"),
        Quantity("tangential_force", "Ft", "N", "magnitude of the friction force"),
        Quantity("overlap", "delta", "m", "sum of the radii less the distance of the centers"),
        Quantity("overlap_max", "delta_max", "m", "largest overlap since the contact began"),
        Quantity("restitution", "e", "1", "coefficient of restitution of the contact"),
        Quantity("unloading", "", "1", "0 loading, 1 unloading", file_type="uint8"),
        Quantity("sliding", "", "1", "1 where the friction force is at the Coulomb limit", file_type="uint8"),
    )
)

FIELD_QUANTITIES = _by_name(
    (
        Quantity("density", "rho", "kg/m3", "mass of the grains per volume of space"),
        Quantity("solid_fraction", "phi", "1", "volume of the grains per volume of space"),
        Quantity("momentum", "rho V", "kg/(m2 s)", "momentum per volume of space", "vector"),
        Quantity("velocity", "V", "m/s", "momentum over density", "vector"),
        Quantity("granular_temperature", "T", "m2/s2", "mean square of each component of v - V", "scalar"),
        Quantity("kinetic_stress", "", "Pa", "flux of momentum by v - V, positive in tension", "tensor"),
        Quantity("contact_stress", "", "Pa", "stress of the contact forces, positive in tension", "tensor"),
        Quantity("pressure", "p", "Pa", "minus a third of the trace of both stresses"),
        Quantity("coordination_number", "Z", "1", "mean number of contacts per particle"),
        Quantity("fabric", "", "1", "mean of n n over contacts, n their direction; its trace is 1", "tensor"),
    )
)

TOTAL_QUANTITIES = _by_name(
    (
        Quantity("particle_count", "N", "1", "particles present"),
        Quantity("inserted_count", "", "1", "particles inserted since the start"),
        Quantity("queued_count", "", "1", "particles due that wait for room to come in; where some come in"),
        Quantity("deleted_count", "", "1", "particles that left the domain, or that outlets took"),
        Quantity("deleted_mass", "", "kg", "mass of the particles that left the domain, or that outlets took"),
        Quantity("contact_count", "Nc", "1", "contacts, each counted once"),
        Quantity("kinetic_energy", "Ek", "J", "kinetic energy of the centers"),
        Quantity("rotational_energy", "Er", "J", "kinetic energy of the spins"),
        Quantity("overlap_mean", "", "1", "mean overlap over radius of the contacts"),
        Quantity("overlap_largest", "", "1", "largest overlap over radius of the contacts"),
        Quantity("coordination_number", "Z", "1", "mean number of contacts per particle that can move"),
        Quantity("shear_strain", "", "1", "shear of the box since its start"),
        Quantity("gravitational_energy", "Eg", "J", "potential energy in gravity, from the origin"),
        Quantity("elastic_energy", "Ee", "J", "energy stored in contacts that they can give back"),
        Quantity("plastic_dissipation", "", "J", "energy lost in steeper unloading"),
        Quantity("friction_dissipation", "", "J", "energy lost in sliding"),
        Quantity("rolling_dissipation", "", "J", "energy lost in rolling friction"),
        Quantity("damping_dissipation", "", "J", "energy lost in viscous damping"),
        Quantity("wall_work", "", "J", "work done by moving walls on the particles"),
        Quantity(
            "boundary_work",
            "",
            "J",
            "work of the border of a periodic box: by gravity on who passes, and by moving images",
        ),
        Quantity("free_wall_energy", "", "J", "kinetic energy of free walls"),
        Quantity("free_wall_work", "", "J", "work of gravity, damping and their own force on free walls"),
        Quantity("removed_energy", "", "J", "energy taken by deleted less brought by inserted particles"),
        Quantity(
            "energy_error",
            "",
            "1",
            "residual of the energy budget over the largest energy put in so far (docs/energy.md)",
        ),
    )
)

FLOW_METER_QUANTITIES = _by_name(
    (
        Quantity("flow_mass", "", "kg", "net mass through the meter since the start"),
        Quantity("flow_count", "", "1", "net number of particles through the meter since the start"),
        Quantity("mass_flow", "", "kg/s", "mass flow: between rows in the table, steady mean in the result"),
    )
)

OUTLET_QUANTITIES = _by_name(
    (
        Quantity("outlet_count", "", "1", "particles that the outlet took since the start"),
        Quantity("outlet_mass", "", "kg", "mass that the outlet took since the start"),
    )
)

INSERTION_QUANTITIES = _by_name(
    (
        Quantity("inserted_count", "", "1", "particles of the group that came in"),
        Quantity("inserted_mass", "", "kg", "mass of the particles of the group that came in"),
        Quantity("not_inserted_count", "", "1", "particles of the group that had not come at the end"),
    )
)

WALL_FORCE_QUANTITIES = _by_name(
    (
        Quantity("wall_force_x", "Fx", "N", "x component of the force of the grains on a wall, a mean over time"),
        Quantity("wall_force_y", "Fy", "N", "its y component"),
        Quantity("wall_force_z", "Fz", "N", "its z component"),
        Quantity("wall_torque_x", "Mx", "N m", "x component of their torque about the wall's point of reference"),
        Quantity("wall_torque_y", "My", "N m", "its y component"),
        Quantity("wall_torque_z", "Mz", "N m", "its z component"),
        Quantity("wall_pressure", "p", "Pa", "normal forces of the grains over the area of the wall"),
        Quantity("wall_force", "F", "N", "magnitude of the mean force, in the result"),
        Quantity("wall_torque", "M", "N m", "magnitude of the mean torque, in the result"),
        Quantity("wall_force_largest", "", "N", "largest magnitude of the force in a row, in the result"),
        Quantity("wall_pressure_largest", "", "Pa", "largest pressure in a row, in the result"),
    )
)

WALL_QUANTITIES = _by_name(
    (
        Quantity("wall_displacement", "", "m", "way of a driven wall along its direction since the start"),
        Quantity("wall_velocity", "", "m/s", "velocity of a driven wall along its direction"),
    )
)

_INSTANT_METRICS = (
    Quantity("lacey_index", "M", "1", "Lacey's mixing index: 0 segregated, 1 mixed at random"),
    Quantity("angle_of_repose", "", "rad", "slope of the free surface"),
    Quantity("angle_of_repose_error", "", "rad", "its standard error"),
    Quantity("coordination_number", "Z", "1", "mean number of contacts per particle"),
    Quantity("mechanical_coordination_number", "Zm", "1", "the same without rattlers and their contacts"),
    Quantity("content_count", "", "1", "number of grains in a box"),
    Quantity("content_mass", "", "kg", "their mass"),
    Quantity("content_volume", "", "m3", "volume of the spheres"),
    Quantity("rattler_share", "", "1", "share of particles with no contact or one"),
    Quantity("fabric_anisotropy", "a", "1", "size of the deviator of the fabric tensor, 0 to 1"),
    Quantity("fabric_xx", "Fxx", "1", "mean square of the x component of contact directions"),
    Quantity("fabric_yy", "Fyy", "1", "of their y component"),
    Quantity("fabric_zz", "Fzz", "1", "of their z component"),
)

METRIC_QUANTITIES = _by_name(
    (
        *_INSTANT_METRICS,
        *(
            replace(each, name=f"{each.name}_mean", meaning=f"{each.meaning}, mean of the last stage's rows")
            for each in _INSTANT_METRICS
        ),
    )
)

RUN_QUANTITIES = _by_name(
    (
        Quantity("simulated_time", "t", "s", "simulated time at the end"),
        Quantity("step_count", "", "1", "steps done"),
        Quantity("time_step", "dt", "s", "time step"),
        Quantity("wall_clock", "", "s", "seconds that the whole run took, compilation included"),
        Quantity("steps_per_second", "", "1/s", "steps per second of wall clock, without compilation"),
        Quantity("particle_steps_per_second", "", "1/s", "particle-steps per second, without compilation"),
    )
)


def unit_of(name: str) -> str:
    """Unit of a number of a finished run, a part's as `mass_flow.outlet`; "" for pure and for unknown numbers."""
    base, _, part = name.partition(".")
    if base == "timings" and part:
        return "s"
    parts = {**FLOW_METER_QUANTITIES, **WALL_FORCE_QUANTITIES, **WALL_QUANTITIES, **METRIC_QUANTITIES}
    parts |= {**INSERTION_QUANTITIES, **OUTLET_QUANTITIES}
    known = parts if part else {**TOTAL_QUANTITIES, **RUN_QUANTITIES}
    return known[base].unit if base in known and known[base].unit != "1" else ""
