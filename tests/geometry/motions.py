"""Motions in the form of the plan: unit vectors, no optional values."""

from granflow.scene.blocks.motions import (
    Oscillation,
    Rotation,
    SurfaceVelocity,
    TableMotion,
    Translation,
    Vibration,
)

NO_GRAVITY = (0.0, 0.0, 0.0)


def vibration(direction, amplitude, angular_frequency, **keys):
    given = {"amplitude": amplitude, "angular_frequency": angular_frequency}
    return Vibration(direction=direction, **given, **keys).numeric(NO_GRAVITY)


def translation(velocity, **keys):
    return Translation(velocity=velocity, **keys).numeric(NO_GRAVITY)


def surface_velocity(velocity, **keys):
    return SurfaceVelocity(velocity=velocity, **keys).numeric(NO_GRAVITY)


def rotation(point, axis, angular_velocity, **keys):
    given = {"point": point, "axis": axis, "angular_velocity": angular_velocity}
    return Rotation(**given, **keys).numeric(NO_GRAVITY)


def oscillation(point, axis, amplitude, angular_frequency, **keys):
    given = {"point": point, "axis": axis, "amplitude": amplitude, "angular_frequency": angular_frequency}
    return Oscillation(**given, **keys).numeric(NO_GRAVITY)


def table(times, **keys):
    return TableMotion(times=times, **keys).numeric(NO_GRAVITY)
