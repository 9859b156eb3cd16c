"""Motions in the form of the plan: unit vectors, no optional values."""

from granflow.scene.blocks import motions


def builder(kind, *names):
    """A function that returns a motion for the values of these keys, and for others by name."""

    def numeric(*values, **keys):
        return kind(**dict(zip(names, values, strict=True)), **keys).numeric((0.0, 0.0, 0.0))

    return numeric


vibration = builder(motions.Vibration, "direction", "amplitude", "angular_frequency")
translation = builder(motions.Translation, "velocity")
surface_velocity = builder(motions.SurfaceVelocity, "velocity")
rotation = builder(motions.Rotation, "point", "axis", "angular_velocity")
oscillation = builder(motions.Oscillation, "point", "axis", "amplitude", "angular_frequency")
table = builder(motions.TableMotion, "times")
