"""Settings of stages: properties that particles take when a stage begins, such as another temperature.

The keys of the properties are those of particle equations and of sources of flows, which `use_registry` adds,
so that a registered equation has its key here, too.
"""

from collections.abc import Iterator, Mapping
from typing import Annotated

import numpy as np
from pydantic import Field
from pydantic.fields import FieldInfo

from granflow.contact import registry
from granflow.geometry.vectors import unit
from granflow.scene.blocks.outlets import HalfSpaceGiven
from granflow.scene.blocks.primitives import Box, CylinderShape
from granflow.schema import quantities as q
from granflow.schema.faults import Fault, whole
from granflow.schema.model import Model, Names, add_keys, choose_by_first_key, optional, optional_key
from granflow.visible_text import alternatives

# Regions: particles with their center inside, or on the surface


class SettingRegion(Model):
    """A region whose particles a setting changes. Base class of the kinds."""

    def contains(self, points: np.ndarray) -> np.ndarray:
        """Whether points (n, 3) [m] are in the region."""
        raise NotImplementedError


class InBox(SettingRegion):
    """Particles whose center is in a box."""

    box: Box = Field(description="a box along the coordinate axes, {min: [..], max: [..]}")

    def contains(self, points: np.ndarray) -> np.ndarray:
        """See `SettingRegion`."""
        return np.asarray(((points >= self.box.min) & (points <= self.box.max)).all(axis=1))


class InHalfSpace(SettingRegion):
    """Particles whose center is on one side of a plane."""

    half_space: HalfSpaceGiven = Field(description="a half space, {point: [..], normal: [..]}")

    def contains(self, points: np.ndarray) -> np.ndarray:
        """See `SettingRegion`."""
        plane = self.half_space
        return np.asarray((points - plane.point) @ unit(plane.normal) >= 0.0)


class InCylinder(SettingRegion):
    """Particles whose center is in a cylinder."""

    cylinder: CylinderShape = Field(description="a cylinder, {from: [..], to: [..], radius: ..}")

    def contains(self, points: np.ndarray) -> np.ndarray:
        """See `SettingRegion`."""
        start = np.array(self.cylinder.from_)
        axis = np.array(self.cylinder.to) - start
        along = (points - start) @ axis / (axis @ axis)
        radial = points - start - along[:, None] * axis
        near = (radial * radial).sum(axis=1) <= self.cylinder.radius**2
        return np.asarray(near & (along >= 0.0) & (along <= 1.0))


class SphereShape(Model):
    """A solid sphere."""

    center: q.Point = Field(description="center [m]")
    radius: q.PositiveLength = Field(description="radius [m]")


class InSphere(SettingRegion):
    """Particles whose center is in a sphere."""

    sphere: SphereShape = Field(description="a sphere, {center: [..], radius: ..}")

    def contains(self, points: np.ndarray) -> np.ndarray:
        """See `SettingRegion`."""
        from_center = points - self.sphere.center
        return np.asarray((from_center * from_center).sum(axis=1) <= self.sphere.radius**2)


# The record


class StageSetting(Model):
    """Properties that particles take when a stage begins; later they change as in any stage.

    It applies to the particles that are present then, of some groups or of all, in a region or everywhere;
    not to those that are inserted later.

    >>> gf.StageSetting(temperature="800 K", groups=["beads"]).groups
    ('beads',)
    """

    groups: Names | None = optional("groups whose particles are set", "all", examples=[["beads"]])
    region: (
        Annotated[
            InBox | InHalfSpace | InCylinder | InSphere,
            choose_by_first_key(
                "it must be {box: {min: [..], max: [..]}}, {half_space: {point: [..], normal: [..]}}, "
                "{cylinder: {from: [..], to: [..], radius: ..}} or {sphere: {center: [..], radius: ..}}"
            ),
        ]
        | None
    ) = optional(
        "region in which the centers of the particles are",
        "everywhere",
        examples=[{"half_space": {"point": [0, 0, 0], "normal": [1, 0, 0]}}],
    )

    @property
    def values(self) -> Mapping[str, float]:
        """The values that are given, by property."""
        names = (each for each in type(self).model_fields if each not in ("groups", "region"))
        return {name: value for name in names if (value := getattr(self, name)) is not None}

    def faults(self) -> Iterator[Fault]:
        """Yield a fault unless a property is given."""
        if not self.values:
            yield whole((), f"sets no property; give {alternatives(list(_keys()))}")


def _keys() -> dict[str, FieldInfo]:
    """Keys of the properties."""
    values = {each.name: (each.initial, each.meaning) for each in registry.equations()}
    sources = {name: (each.type, each.meaning) for name, (_, each) in registry.sources().items()}
    return {
        name: optional_key(Annotated[float, number], f"value that the particles take: {meaning}")
        for name, (number, meaning) in (values | sources).items()
    }


def use_registry() -> None:
    """Add the properties of particle equations, and sources of flows.

    A schema that is built must be rebuilt afterwards.
    """
    add_keys(StageSetting, _keys())


use_registry()
