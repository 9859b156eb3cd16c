"""Triangulation of wall shapes for output: points on the surface, total area; codes of the shape kinds."""

import numpy as np
import pytest
from geometry.surfaces import SHAPES

from granflow.geometry.surface import surface_kinds
from granflow.scene.blocks.walls.half_space import half_space
from granflow.scene.blocks.walls.rectangle import rectangle
from granflow.scene.blocks.walls.revolved import cone, cylinder, disc

CENTER = np.array([0.2, 0.1, 0.3])


@pytest.mark.parametrize("name", SHAPES)
def test_triangle_corners_lie_on_the_surface(name):
    shape = SHAPES[name]
    points, faces = shape.triangles(CENTER, 0.5)
    distance, _ = shape.contacts(points)
    np.testing.assert_allclose(distance, 0.0, atol=1e-14)
    assert set(faces.ravel()) == set(range(len(points)))


@pytest.mark.parametrize(("shape", "expected"), [
    (half_space([0, 0, 5], [1, 1, 0]), 1.0),
    (rectangle([0, 0, 0], [2, 0, 0], [0, 3, 0]), 6.0),
    (cylinder([0, 0, 0], [0, 2, 0], 0.5), 2 * np.pi * 0.5 * 2),
    (cone([0, 0, 0], [0, 0, 4], 0.0, 3.0), np.pi * 3 * 5),
    (disc([0, 0, 0], [1, 0, 1], 1.0, 0.5), np.pi * 0.75)
])  # fmt: skip
def test_triangles_cover_the_area_of_the_shape(shape, expected):
    points, faces = shape.triangles(CENTER, 0.5)
    corner = points[faces[:, 0]]
    first = points[faces[:, 1]]
    second = points[faces[:, 2]]
    areas = np.linalg.norm(np.cross(first - corner, second - corner), axis=1) / 2
    assert areas.min() > 1e-3 * areas.max(), "each triangle has a normal"
    assert areas.sum() == pytest.approx(
        expected, rel=3e-3
    )  # 64 facets: 1 - sin(x) / x with x = 2 pi / 64, at most twice


def test_codes_of_surface_kinds_do_not_depend_on_the_order_of_the_walls():
    kinds = surface_kinds(list(SHAPES.values()))
    assert {"half_space", "rectangle", "revolved"} <= {kind.kind for kind in kinds}
    assert surface_kinds(list(SHAPES.values())[::-1]) == kinds
