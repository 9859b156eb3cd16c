"""Distance and normal of every shape: device against reference and against elementary geometry, in all
precisions."""

import os
import subprocess
import sys

import numpy as np
import pytest
from geometry.surfaces import SHAPES, on_device, points_around

from granflow.kernel_language import ti
from granflow.scene.blocks.walls.half_space import half_space
from granflow.scene.blocks.walls.rectangle import rectangle
from granflow.scene.blocks.walls.revolved import cone, cylinder, disc
from granflow.scene.blocks.walls.sphere import sphere

EPSILON = np.finfo(float).eps
COORDINATE_SIZE = 4.0
"""Largest intermediate coordinate of the random points; rounding errors are relative to it, not to the
distance."""


@pytest.mark.parametrize("name", SHAPES)
def test_device_equals_reference(taichi_f64, name):
    shape = SHAPES[name]
    points = points_around(shape, 10_000)
    distance, normal, bare = on_device(shape, points)
    np.testing.assert_array_equal(bare, distance)  # without shared edges
    expected_distance, expected_normal = shape.contacts(points)
    tolerance = 4 * EPSILON * COORDINATE_SIZE
    np.testing.assert_allclose(distance, expected_distance, rtol=0, atol=tolerance)
    # A tangential error of `tolerance` rotates the normal by tolerance / distance; below 1e-9 it is
    # indeterminate.
    determinate = (np.abs(distance) > 1e-9) & off_axis(shape, points)
    rotation = np.linalg.norm(normal - expected_normal, axis=1)[determinate]
    assert np.all(rotation <= tolerance * (1 + 1 / np.abs(distance[determinate])))


@pytest.mark.parametrize("name", SHAPES)
def test_normal_is_the_unit_gradient_of_the_distance(taichi_f64, name):
    shape = SHAPES[name]
    points = points_around(shape, 2_000)
    distance, normal, _ = on_device(shape, points)
    assert np.all(np.isfinite(normal)) and np.all(np.isfinite(distance))
    np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1.0, atol=8 * EPSILON)
    step = 1e-6
    smooth = (np.abs(distance) > 0.05) & off_axis(shape, points, 0.05)
    gradient = np.empty_like(points)
    for axis, shift in enumerate(step * np.eye(3)):
        ahead, _, _ = on_device(shape, points + shift)
        behind, _, _ = on_device(shape, points - shift)
        gradient[:, axis] = (ahead - behind) / (2 * step)
    # Second derivatives are at most 1 / 0.05 away from edges; their jump across an edge adds at most step /
    # 0.05.
    np.testing.assert_allclose(normal[smooth], gradient[smooth], atol=2 * step / 0.05)


def off_axis(shape, points, least=1e-9):
    """Mask of the points with a defined radial direction; all points for flat shapes.

    Near the center of a sphere, rounding of the point turns it.
    """
    if shape.kind == "sphere":
        return np.linalg.norm(points - shape.center, axis=1) > max(least, 0.2)
    if shape.kind != "revolved":
        return np.ones(len(points), bool)
    return np.linalg.norm(np.cross(points - shape.origin, shape.axis), axis=1) > least


ELEMENTARY = {
    "above half space": (half_space([0, 0, 1], [0, 0, 2]), [5, 5, 3], 2.0, [0, 0, 1]),
    "behind half space": (half_space([0, 0, 1], [0, 0, 2]), [5, 5, 0], -1.0, [0, 0, 1]),
    "below rectangle": (rectangle([0, 0, 0], [2, 0, 0], [0, 1, 0]), [1, 0.5, -0.25], 0.25, [0, 0, -1]),
    "beyond corner of rectangle": (rectangle([0, 0, 0], [2, 0, 0], [0, 1, 0]), [5, 5, 0], 5.0, [0.6, 0.8, 0]),
    "on the rectangle": (rectangle([0, 0, 0], [2, 0, 0], [0, 1, 0]), [1, 0.5, 0], 0.0, [0, 0, 1]),
    "inside cylinder": (cylinder([0, 0, 0], [0, 0, 1], 1.0), [0.25, 0, 0.5], 0.75, [-1, 0, 0]),
    "outside cylinder": (cylinder([0, 0, 0], [0, 0, 1], 1.0), [0, 3, 0.5], 2.0, [0, 1, 0]),
    "beyond cylinder": (cylinder([0, 0, 0], [0, 0, 1], 1.0), [0, 4, 5], 5.0, [0, 0.6, 0.8]),
    "inside cone": (cone([0, 0, 0], [0, 0, 4], 0.0, 3.0), [0, 1, 3], 1.0, [0, -0.8, 0.6]),
    "over disc": (disc([0, 0, 1], [0, 0, 1], 1.0), [0.5, 0, 3], 2.0, [0, 0, 1]),
    "over center of disc": (disc([0, 0, 1], [0, 0, 1], 1.0), [0, 0, 3], 2.0, [0, 0, 1]),
    "under disc": (disc([0, 0, 1], [0, 0, 1], 1.0), [0.5, 0, 0], 1.0, [0, 0, -1]),
    "inside sphere": (sphere([0, 0, 1], 2.0), [0, 0.5, 1], 1.5, [0, -1, 0]),
    "outside sphere": (sphere([0, 0, 1], 2.0), [3, 0, 5], 3.0, [0.6, 0, 0.8]),
    "in the center of a sphere": (sphere([0, 0, 1], 2.0), [0, 0, 1], 2.0, [0, 0, -1]),
    "in hole of disc": (disc([0, 0, 0], [0, 0, 1], 2.0, 1.0), [0.25, 0, 0], 0.75, [-1, 0, 0]),
}


@pytest.mark.parametrize("case", ELEMENTARY)
def test_distance_and_normal_of_elementary_cases(taichi_f64, case):
    shape, point, expected_distance, expected_normal = ELEMENTARY[case]
    distance, normal, _ = on_device(shape, np.array([point], float))
    assert distance[0] == pytest.approx(expected_distance, abs=1e-15)
    np.testing.assert_allclose(normal[0], expected_normal, atol=1e-15)


@pytest.mark.parametrize("name", SHAPES)
def test_normal_on_the_axis_is_a_unit_vector(taichi_f64, name):
    """At r = 0 the radial direction is arbitrary, but the distance and the length of the normal are
    defined."""
    shape = SHAPES[name]
    axis = np.array([0.6, 0.0, 0.8]) if shape.kind == "sphere" else shape.numbers[3:6]
    points = shape.numbers[0:3] + np.linspace(-2, 2, 9)[:, None] * axis
    distance, normal, _ = on_device(shape, points)
    expected, _ = shape.contacts(points)
    np.testing.assert_allclose(distance, expected, atol=4 * EPSILON * COORDINATE_SIZE)
    np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1.0, atol=8 * EPSILON)


@pytest.mark.parametrize("types", [(ti.f32, ti.f32), (ti.f64, ti.f32)], ids=["f32", "mixed"])
@pytest.mark.parametrize("name", SHAPES)
def test_distance_in_lower_precisions_is_within_rounding(taichi_f64, name, types):
    shape = SHAPES[name]
    points = points_around(shape, 2_000)
    distance, _, _ = on_device(shape, points, *types)
    expected, _ = shape.contacts(points.astype(float))
    np.testing.assert_allclose(distance, expected, atol=8 * np.finfo(np.float32).eps * COORDINATE_SIZE)


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


def test_invalid_shapes_are_rejected():
    with pytest.raises(ValueError, match="perpendicular"):
        rectangle([0, 0, 0], [1, 0, 0], [1, 1, 0])
    with pytest.raises(ValueError, match="no direction"):
        half_space([0, 0, 0], [0, 0, 0])
    with pytest.raises(ValueError, match="negative"):
        cone([0, 0, 0], [0, 0, 1], -1.0, 1.0)
    with pytest.raises(ValueError, match="smaller than the disc"):
        disc([0, 0, 0], [0, 0, 1], 1.0, 1.0)
    with pytest.raises(ValueError, match="not finite"):
        disc([0, 0, float("nan")], [0, 0, 1], 1.0)
