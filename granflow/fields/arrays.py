"""Arrays of contacts, and of coarse-grained fields."""

from granflow.fields.quantity import Quantity, by_name

CONTACT_QUANTITIES = by_name(
    (
        Quantity("id_i", "i", "1", "id of particle i", file_type="int64"),
        Quantity("id_j", "j", "1", "id of particle j, -1 for a contact with a wall", file_type="int64"),
        Quantity("wall", "", "1", "index of the wall in the scene, -1 between particles", file_type="int32"),
        Quantity("triangle", "", "1", "index of the triangle of a mesh wall, else -1", file_type="int32"),
        Quantity("position_i", "xi", "m", "center of particle i", "vector", "float64"),
        Quantity("position_j", "xj", "m", "center of particle j, or contact point on the wall", "vector", "float64"),
        Quantity("force", "F", "N", "total force on particle i, including viscous and friction force", "vector"),
        Quantity("normal_force", "Fn", "N", "repulsive force along the normal"),
        Quantity("tangential_force", "Ft", "N", "magnitude of the friction force"),
        Quantity("overlap", "delta", "m", "sum of the radii minus the distance of the centers"),
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
        Quantity("granular_temperature", "T", "m2/s2", "mean square of each component of v - V", "scalar"),
        Quantity(
            "granular_temperature_of_frames", "", "m2/s2", "the same; in means over time without changes of V in time"
        ),
        Quantity("kinetic_stress", "", "Pa", "flux of momentum by v - V, positive in tension", "tensor"),
        Quantity("contact_stress", "", "Pa", "stress of the contact forces, positive in tension", "tensor"),
        Quantity("pressure", "p", "Pa", "minus a third of the trace of both stresses"),
        Quantity("coordination_number", "Z", "1", "mean number of contacts with particles per particle"),
        Quantity("fabric", "", "1", "mean of n n over contacts, n their direction; its trace is 1", "tensor"),
    )
)
"""Arrays of coarse-grained fields, one entry per grid point."""


WALL_ARRAY_QUANTITIES = by_name(
    (
        Quantity("wall", "", "1", "index of the wall in the scene", file_type="int32"),
        Quantity("traction", "", "Pa", "force of the particles per area, with `output.wall_forces`", "vector"),
        Quantity("pressure", "p", "Pa", "normal force of the particles per area, with `output.wall_forces`"),
        Quantity("surface_velocity", "", "m/s", "velocity of a belt along the triangle, if a wall has one", "vector"),
    )
)
"""Arrays of wall files, one entry per triangle."""
