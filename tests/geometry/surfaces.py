"""Shapes for tests, random points around them, and evaluation of the device functions over arrays."""

from functools import cache
from pathlib import Path

import numpy as np
from ruamel.yaml import YAML

from granflow.geometry.surface import reader_of_numbers
from granflow.kernel_language import ti
from granflow.scene.blocks.walls.box import BoxWall
from granflow.scene.blocks.walls.half_space import half_space
from granflow.scene.blocks.walls.kinds import WALLS
from granflow.scene.blocks.walls.mesh import MeshWall
from granflow.scene.blocks.walls.rectangle import rectangle
from granflow.scene.blocks.walls.revolved import cone, cylinder, disc
from granflow.scene.blocks.walls.sphere import sphere
from granflow.scene.reference import example_of, keys

NUMPY_TYPES = {ti.f64: np.float64, ti.f32: np.float32}

TILTED = np.array([0.3, -0.5, 0.8])

SHAPES = {
    "half_space": half_space([0.1, 0.2, -0.1], TILTED),
    "rectangle": rectangle([-0.5, 0.1, 0.2], [1.0, 0.5, 0.0], [-0.3, 0.6, 0.8]),
    "cylinder": cylinder([0.1, 0.0, -0.4], [0.1, 0.0, 0.6], 0.5),
    "tilted_cylinder": cylinder([0.1, 0.0, -0.4], [0.1, 0.9, 0.6], 0.5),
    "cone": cone([0.0, 0.1, -0.5], [0.2, 0.3, 0.5], 0.1, 0.7),
    "cone_with_tip": cone([0.0, 0.0, 0.0], [0.7, 0.0, 0.0], 0.0, 0.6),
    "disc": disc([0.1, -0.1, 0.2], TILTED, 0.8),
    "sphere": sphere([0.1, -0.1, 0.2], 0.7),
    "disc_with_hole": disc([0.1, -0.1, 0.2], [0.0, 1.0, 0.0], 0.8, 0.3),
}


def example_of_wall(kind):
    """The shape of a kind of wall, with the examples of its keys in the reference."""
    required = {each.alias or name for name, each in kind.model_fields.items() if each.is_required()}
    examples = [example_of(key) for key in keys(kind.__name__) if key.name in required - {"material"}]
    given = YAML(typ="safe").load("\n".join(examples))
    return kind.model_validate({"material": "glass", **given}).surface(Path())


SHAPES |= {kind.__name__: example_of_wall(kind) for kind in WALLS if kind not in (BoxWall, MeshWall)}


def on_device(shape, points, dtype=ti.f64, parameter_dtype=ti.f64):
    """Distances (n,), normals (n, 3) and distances without shared edges (n,) from the device."""
    number = NUMPY_TYPES[dtype]
    parameter_number = NUMPY_TYPES[parameter_dtype]
    distance, bare = np.zeros((2, len(points)), dtype=number)
    normal = np.zeros((len(points), 3), dtype=number)
    measure = kernel_for(type(shape), dtype, parameter_dtype)
    measure(points.astype(number), shape.numbers.astype(parameter_number), distance, normal, bare)
    return distance, normal, bare


@cache
def kernel_for(kind, dtype, parameter_dtype):
    """A kernel that evaluates the device functions of a kind over arrays."""
    indices = range(kind.count())
    numbers_by_name = reader_of_numbers(kind)

    @ti.kernel
    def measure(
        points: ti.types.ndarray(dtype, 2),
        parameters: ti.types.ndarray(parameter_dtype, 1),
        distance: ti.types.ndarray(dtype, 1),
        normal: ti.types.ndarray(dtype, 2),
        bare: ti.types.ndarray(dtype, 1),
    ):
        for i in range(points.shape[0]):
            point = ti.Vector([points[i, 0], points[i, 1], points[i, 2]])
            numbers = numbers_by_name([parameters[k] for k in ti.static(indices)])
            found, direction = kind.contact(point, numbers)
            distance[i] = found
            bare[i] = kind.distance(point, numbers)
            for k in ti.static(range(3)):
                normal[i, k] = direction[k]

    return measure


def points_around(shape, count, seed=1):
    """Random points in a cube around the shape; the first points are on its axis, face and edges."""
    points = np.random.default_rng(seed).uniform(-1.2, 1.2, (count, 3))
    origin = shape.numbers[0:3]
    direction = shape.numbers[3:6]
    on_axis = origin + np.linspace(-1.0, 1.0, 11)[:, None] * direction
    corners, _ = shape.triangles(np.zeros(3), 0.5)
    midpoints = (corners + np.roll(corners, 1, axis=0)) / 2
    special = np.concatenate([on_axis, corners, midpoints])
    special = special[:: -(-len(special) // count)]
    points[: len(special)] = special
    return points
