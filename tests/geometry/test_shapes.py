"""Distance, normal and triangles of every shape: device, reference and elementary geometry, in all precisions."""

import os
import subprocess
import sys

import numpy as np
import pytest
from geometry.surfaces import SHAPES, on_device, points_around

from granflow.geometry.surface import surface_kinds
from granflow.kernel_language import ti
from granflow.scene.blocks.walls.half_space import half_space
from granflow.scene.blocks.walls.rectangle import rectangle
from granflow.scene.blocks.walls.revolved import cone, cylinder, disc
from granflow.scene.blocks.walls.sphere import sphere

EPSILON = np.finfo(float).eps
COORDINATE_SIZE = 4.0
"""Largest intermediate coordinate of the random points; rounding errors are relative to it, not to the
distance."""


def off_axis(shape, points, least=1e-9):
    """Mask of the points with a defined radial direction; all points for flat shapes.

    Near the center of a sphere, rounding of the point turns it.
    """
    if shape.kind == "sphere":
        return np.linalg.norm(points - shape.center, axis=1) > max(least, 0.2)
    if shape.kind != "revolved":
        return np.ones(len(points), bool)
    return np.linalg.norm(np.cross(points - shape.origin, shape.axis), axis=1) > least


@pytest.mark.parametrize("name", SHAPES)
def test_device_equals_reference_and_the_normal_is_the_gradient_of_the_distance(taichi_f64, name):
    """A tangential error of `tolerance` rotates the normal by tolerance / distance; below 1e-9 it is indeterminate.

    Second derivatives are at most 1 / 0.05 away from edges; their jump across an edge adds at most step / 0.05.
    On the axis the radial direction is arbitrary, but the normal is a unit vector. Lower precisions round.
    """
    shape, tolerance, step = SHAPES[name], 4 * EPSILON * COORDINATE_SIZE, 1e-6
    points = points_around(shape, 3_000)
    distance, normal, bare = on_device(shape, points)
    np.testing.assert_array_equal(bare, distance)  # without shared edges
    expected_distance, expected_normal = shape.contacts(points)
    np.testing.assert_allclose(distance, expected_distance, rtol=0, atol=tolerance)
    np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1.0, atol=8 * EPSILON)
    determinate = (np.abs(distance) > 1e-9) & off_axis(shape, points)
    rotation = np.linalg.norm(normal - expected_normal, axis=1)[determinate]
    assert np.all(rotation <= tolerance * (1 + 1 / np.abs(distance[determinate])))
    smooth = (np.abs(distance) > 0.05) & off_axis(shape, points, 0.05)
    ends = [[shape.contacts(points + sign * shift)[0] for shift in step * np.eye(3)] for sign in (1, -1)]
    gradient = (np.array(ends[0]) - ends[1]).T / (2 * step)
    np.testing.assert_allclose(normal[smooth], gradient[smooth], atol=2 * step / 0.05)
    for types in ((ti.f32, ti.f32), (ti.f64, ti.f32)):
        distance, _, _ = on_device(shape, points, *types)
        np.testing.assert_allclose(distance, expected_distance, atol=8 * 2.0**-23 * COORDINATE_SIZE)


def test_default_precision_does_not_narrow_results():
    """With f32 as the default type, f64 points and parameters give f64 results; no literal narrows them."""
    folders = os.pathsep.join(path for path in sys.path if path)
    environment = os.environ | {"PYTHONPATH": folders}
    subprocess.run([sys.executable, "-c", IN_SINGLE_PRECISION], env=environment, check=True)


IN_SINGLE_PRECISION = """
from granflow.kernel_language import ti
ti.init(arch=ti.cpu, default_fp=ti.f32, fast_math=False)
import numpy as np
from geometry.surfaces import SHAPES, on_device, points_around
for shape in SHAPES.values():
    points = points_around(shape, 500)
    distance, normal, _ = on_device(shape, points)
    expected, _ = shape.contacts(points)
    assert np.abs(distance - expected).max() < 1e-14, shape.kind
    assert np.abs(np.linalg.norm(normal, axis=1) - 1).max() < 1e-14, shape.kind
"""

PLATE = rectangle([0, 0, 0], [2, 0, 0], [0, 1, 0])
TUBE = cylinder([0, 0, 0], [0, 0, 1], 1.0)
BALL = sphere([0, 0, 1], 2.0)
ELEMENTARY = {
    "behind half space": (half_space([0, 0, 1], [0, 0, 2]), [5, 5, 0], -1.0, [0, 0, 1]),
    "below rectangle": (PLATE, [1, 0.5, -0.25], 0.25, [0, 0, -1]),
    "beyond corner of rectangle": (PLATE, [5, 5, 0], 5.0, [0.6, 0.8, 0]),
    "on the rectangle": (PLATE, [1, 0.5, 0], 0.0, [0, 0, 1]),
    "inside cylinder": (TUBE, [0.25, 0, 0.5], 0.75, [-1, 0, 0]),
    "beyond cylinder": (TUBE, [0, 4, 5], 5.0, [0, 0.6, 0.8]),
    "inside cone": (cone([0, 0, 0], [0, 0, 4], 0.0, 3.0), [0, 1, 3], 1.0, [0, -0.8, 0.6]),
    "over center of disc": (disc([0, 0, 1], [0, 0, 1], 1.0), [0, 0, 3], 2.0, [0, 0, 1]),
    "in hole of disc": (disc([0, 0, 0], [0, 0, 1], 2.0, 1.0), [0.25, 0, 0], 0.75, [-1, 0, 0]),
    "inside sphere": (BALL, [0, 0.5, 1], 1.5, [0, -1, 0]),
    "in the center of a sphere": (BALL, [0, 0, 1], 2.0, [0, 0, -1]),
}


@pytest.mark.parametrize("case", ELEMENTARY)
def test_distance_and_normal_of_elementary_cases(taichi_f64, case):
    shape, point, expected_distance, expected_normal = ELEMENTARY[case]
    distance, normal, _ = on_device(shape, np.array([point], float))
    assert distance[0] == pytest.approx(expected_distance, abs=1e-15)
    np.testing.assert_allclose(normal[0], expected_normal, atol=1e-15)


AREAS = [
    (half_space([0, 0, 5], [1, 1, 0]), 1.0),
    (PLATE, 2.0),
    (TUBE, 2 * np.pi),
    (cone([0, 0, 0], [0, 0, 4], 0.0, 3.0), np.pi * 3 * 5),
    (disc([0, 0, 0], [1, 0, 1], 1.0, 0.5), np.pi * 0.75),
]


def test_triangles_for_output_lie_on_the_surface_and_cover_its_area():
    """64 facets lack the share 1 - sin(x) / x with x = 2 pi / 64 of the area, at most twice."""
    for shape, area in [*AREAS, *((shape, None) for shape in SHAPES.values())]:
        points, faces = shape.triangles(np.array([0.2, 0.1, 0.3]), 0.5)
        np.testing.assert_allclose(shape.contacts(points)[0], 0.0, atol=1e-14)
        assert set(faces.ravel()) == set(range(len(points)))
        corner, first, second = points[faces].transpose(1, 0, 2)
        areas = np.linalg.norm(np.cross(first - corner, second - corner), axis=1) / 2
        assert areas.min() > 1e-3 * areas.max(), "each triangle has a normal"
        assert area is None or areas.sum() == pytest.approx(area, rel=3e-3)


def test_codes_of_surface_kinds_do_not_depend_on_the_order_of_the_walls():
    kinds = surface_kinds(list(SHAPES.values()))
    assert {"half_space", "rectangle", "revolved"} <= {kind.kind for kind in kinds}
    assert surface_kinds(list(SHAPES.values())[::-1]) == kinds


INVALID = {
    "perpendicular": (rectangle, [0, 0, 0], [1, 0, 0], [1, 1, 0]),
    "no direction": (half_space, [0, 0, 0], [0, 0, 0]),
    "negative": (cone, [0, 0, 0], [0, 0, 1], -1.0, 1.0),
    "smaller than the disc": (disc, [0, 0, 0], [0, 0, 1], 1.0, 1.0),
    "not finite": (disc, [0, 0, float("nan")], [0, 0, 1], 1.0),
}


@pytest.mark.parametrize("message", INVALID)
def test_invalid_shapes_are_rejected(message):
    build, *numbers = INVALID[message]
    with pytest.raises(ValueError, match=message):
        build(*numbers)
