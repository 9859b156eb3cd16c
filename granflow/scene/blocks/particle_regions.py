"""Regions that choose particles at the start of a stage. A kind of region is one class below.

A class has the keys of the kind and its signed distance, from which follows which part of a particle is
inside. `ParticleRegion` at the end lists the kinds.
"""

from typing import Annotated

import numpy as np
from pydantic import Field

from granflow.geometry.vectors import unit
from granflow.scene.blocks.outlets import HalfSpaceGiven
from granflow.scene.blocks.primitives import Box, CylinderShape
from granflow.schema import quantities as q
from granflow.schema.model import Model, choose_by_first_key


class RegionOfParticles(Model):
    """A region whose particles are chosen. Base class of the kinds."""

    def distance(self, points: np.ndarray) -> np.ndarray:
        """Distance [m] (n,) of points (n, 3) [m] from the surface, negative inside."""
        raise NotImplementedError


def _outside_of(excess: np.ndarray) -> np.ndarray:
    """Signed distance (n,) from a convex body whose faces are at right angles; `excess` (n, k): from each
    pair of faces, negative between them."""
    return np.asarray(np.linalg.norm(np.maximum(excess, 0.0), axis=1) + np.minimum(excess.max(axis=1), 0.0))


class InBox(RegionOfParticles):
    """Particles in a box."""

    box: Box = Field(description="a box along the coordinate axes, {min: [..], max: [..]}")

    def distance(self, points: np.ndarray) -> np.ndarray:
        """See `RegionOfParticles`."""
        return _outside_of(np.maximum(self.box.min - points, points - self.box.max))


class InHalfSpace(RegionOfParticles):
    """Particles on one side of a plane."""

    half_space: HalfSpaceGiven = Field(description="a half space, {point: [..], normal: [..]}")

    def distance(self, points: np.ndarray) -> np.ndarray:
        """See `RegionOfParticles`."""
        return np.asarray((self.half_space.point - points) @ unit(self.half_space.normal))


class InCylinder(RegionOfParticles):
    """Particles in a cylinder."""

    cylinder: CylinderShape = Field(description="a cylinder, {from: [..], to: [..], radius: ..}")

    def distance(self, points: np.ndarray) -> np.ndarray:
        """See `RegionOfParticles`."""
        start = np.array(self.cylinder.from_)
        axis = np.array(self.cylinder.to) - start
        length = np.linalg.norm(axis)
        along = (points - start) @ axis / length
        radial = np.linalg.norm(points - start - along[:, None] * axis / length, axis=1)
        ends = np.maximum(-along, along - length)
        return _outside_of(np.stack([radial - self.cylinder.radius, ends], axis=1))


class SphereShape(Model):
    """A solid sphere."""

    center: q.Point = Field(description="center [m]")
    radius: q.PositiveLength = Field(description="radius [m]")


class InSphere(RegionOfParticles):
    """Particles in a sphere."""

    sphere: SphereShape = Field(description="a sphere, {center: [..], radius: ..}")

    def distance(self, points: np.ndarray) -> np.ndarray:
        """See `RegionOfParticles`."""
        return np.asarray(np.linalg.norm(points - self.sphere.center, axis=1) - self.sphere.radius)


ParticleRegion = Annotated[
    InBox | InHalfSpace | InCylinder | InSphere,
    choose_by_first_key(
        "it must be {box: {min: [..], max: [..]}}, {half_space: {point: [..], normal: [..]}}, "
        "{cylinder: {from: [..], to: [..], radius: ..}} or {sphere: {center: [..], radius: ..}}"
    ),
]
"""A region of any kind, selected by its key."""
