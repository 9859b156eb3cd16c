"""Shapes to try, random points about them, and the device functions run over arrays."""

import numpy as np
import taichi as ti

from granflow.walls import PARAMETER_COUNT, cone, cylinder, disc, half_space, rectangle

TILTED = np.array([0.3, -0.5, 0.8])

SHAPES = {
    "half_space": half_space([0.1, 0.2, -0.1], TILTED),
    "rectangle": rectangle([-0.5, 0.1, 0.2], [1.0, 0.5, 0.0], [-0.3, 0.6, 0.8]),
    "cylinder": cylinder([0.1, 0.0, -0.4], [0.1, 0.0, 0.6], 0.5),
    "tilted_cylinder": cylinder([0.1, 0.0, -0.4], [0.1, 0.9, 0.6], 0.5),
    "cone": cone([0.0, 0.1, -0.5], [0.2, 0.3, 0.5], 0.1, 0.7),
    "cone_with_tip": cone([0.0, 0.0, 0.0], [0.7, 0.0, 0.0], 0.0, 0.6),
    "disc": disc([0.1, -0.1, 0.2], TILTED, 0.8),
    "disc_with_hole": disc([0.1, -0.1, 0.2], [0.0, 1.0, 0.0], 0.8, 0.3),
}


def on_device(shape, points, dtype=ti.f64, parameter_dtype=None, function="closest"):
    """Distances (n,) and normals (n, 3) from the device function, computed in the given types."""
    point = ti.Vector.field(3, dtype, shape=len(points))
    parameters = ti.Vector.field(PARAMETER_COUNT, parameter_dtype or dtype, shape=())
    distance = ti.field(dtype, shape=len(points))
    normal = ti.Vector.field(3, dtype, shape=len(points))
    point.from_numpy(points)
    parameters.from_numpy(shape.parameters)
    closest = shape.kind.closest
    bare_distance = shape.kind.bare_distance

    @ti.kernel
    def measure():
        for i in point:
            distance[i], normal[i] = closest(point[i], parameters[None])

    @ti.kernel
    def measure_bare():
        for i in point:
            distance[i] = bare_distance(point[i], parameters[None])

    (measure if function == "closest" else measure_bare)()
    return distance.to_numpy(), normal.to_numpy()


def points_around(shape, count, seed=1):
    """Random points in a cube about the shape, with the awkward ones in front: on the axis, the face, the rims."""
    scattered = np.random.default_rng(seed).uniform(-1.2, 1.2, (count, 3))
    origin = shape.parameters[0:3]
    direction = shape.parameters[3:6]
    awkward = origin + np.linspace(-1.0, 1.0, 11)[:, None] * direction
    corners, _ = shape.kind.triangles(shape.parameters, np.zeros(3), 0.5)
    middles = (corners + np.roll(corners, 1, axis=0)) / 2
    special = np.concatenate([awkward, corners, middles])
    scattered[: len(special)] = special
    return scattered
