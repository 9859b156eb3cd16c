"""Numbers of each metric."""

from dataclasses import replace

from granflow.fields.quantity import Quantity, by_name

_INSTANT_METRICS = (
    Quantity("lacey_index", "M", "1", "Lacey's mixing index: 0 segregated, 1 randomly mixed"),
    Quantity("segregation_intensity", "I", "1", "intensity of segregation by volume: 1 segregated, 0 uniform"),
    Quantity("segregation_intensity_random", "I_R", "1", "the same for a random mixture of the same particles"),
    Quantity("angle_of_repose", "", "rad", "slope of the free surface"),
    Quantity("angle_of_repose_error", "", "rad", "standard error of the slope"),
    Quantity("coordination_number", "Z", "1", "mean number of contacts with particles per particle"),
    Quantity("mechanical_coordination_number", "Zm", "1", "the same without rattlers"),
    Quantity("wall_coordination_number", "", "1", "mean number of contacts with walls per particle"),
    Quantity("center_of_mass_x", "x", "m", "x coordinate of the center of mass"),
    Quantity("center_of_mass_y", "y", "m", "y coordinate of the center of mass"),
    Quantity("center_of_mass_z", "z", "m", "z coordinate of the center of mass"),
    Quantity("position_x", "x", "m", "x component of the position of the particle"),
    Quantity("position_y", "y", "m", "y component of the position of the particle"),
    Quantity("position_z", "z", "m", "z component of the position of the particle"),
    Quantity("velocity_x", "x", "m/s", "x component of the velocity of the particle"),
    Quantity("velocity_y", "y", "m/s", "y component of the velocity of the particle"),
    Quantity("velocity_z", "z", "m/s", "z component of the velocity of the particle"),
    Quantity("angular_velocity_x", "x", "rad/s", "x component of the angular velocity of the particle"),
    Quantity("angular_velocity_y", "y", "rad/s", "y component of the angular velocity of the particle"),
    Quantity("angular_velocity_z", "z", "rad/s", "z component of the angular velocity of the particle"),
    Quantity("sliding_share", "", "1", "share of contacts whose friction force is at the Coulomb limit"),
    Quantity("content_count", "", "1", "number of particles in a box"),
    Quantity("content_mass", "", "kg", "mass of the particles in a box"),
    Quantity("content_volume", "", "m3", "volume of the particles in a box"),
    Quantity("rattler_share", "", "1", "share of particles with no contact or one contact"),
    Quantity("fabric_anisotropy", "a", "1", "anisotropy of the fabric tensor, 0 to 1"),
    Quantity("fabric_xx", "Fxx", "1", "mean square of the x component of contact directions"),
    Quantity("fabric_yy", "Fyy", "1", "mean square of the y component of contact directions"),
    Quantity("fabric_zz", "Fzz", "1", "mean square of the z component of contact directions"),
)


METRIC_QUANTITIES = by_name(
    (
        *_INSTANT_METRICS,
        *(
            replace(each, name=f"{each.name}_mean", meaning=f"{each.meaning}, mean over the rows of the last stage")
            for each in _INSTANT_METRICS
        ),
    )
)
"""Numbers of each metric; with the suffix `_mean` the mean over the rows of the last stage."""
