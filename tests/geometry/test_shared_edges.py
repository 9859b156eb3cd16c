"""Edges shared by surfaces of revolution: one contact at a convex edge, no edge contact in a concave corner."""

import numpy as np
import pytest
from geometry.surfaces import on_device

from granflow.geometry.surface import FAR_AWAY, assign_shared_edges
from granflow.scene.blocks.walls.revolved import cone, cylinder, disc


def contacts(shapes, point):
    """Indices of the shapes within 30 mm of the point (x, 0, z); device and reference agree."""
    points = np.array([[point[0], 0.0, point[1]]])
    distances = [shape.contacts(points)[0][0] for shape in shapes]
    assert [on_device(shape, points)[0][0] for shape in shapes] == pytest.approx(distances, abs=1e-15)
    return [index for index, distance in enumerate(distances) if distance < 0.03]


HOPPER = cone([0, 0, 0], [0, 0, 1], 0.1, 0.6)
UP, DOWN = (cylinder(*ends, 0.1) for ends in ([[0, 0, -0.2], [0, 0, 0]], [[0, 0, 0], [0, 0, -0.2]]))
GATE = disc([0, 0, 0], [0, 0, -1], 0.1)
SHELF = disc([0, 0, 0], [0, 0, 1], 0.5, 0.1)
HALVES = [cylinder([0, 0, 0], [0, 0, 0.5], 0.2), cylinder([0, 0, 0.5], [0, 0, 1], 0.2)]
PLATE = [cylinder([0, 0, 0], [0, 0, 1], 0.2), disc([0, 0, 0], [0, 0, 1], 0.5)]
BISECTOR = np.array([-2.0 / np.sqrt(5) - 1.0, 1.0 / np.sqrt(5)])
AT_EDGE = np.array([0.1, 0.0]) + 0.02 * BISECTOR / np.linalg.norm(BISECTOR)
"""At the orifice from inside: between the normals of cone and tube, the edge is the nearest feature."""

CASES = {
    "convex edge": ([HOPPER, UP], AT_EDGE, 1, 2),
    "convex edge of a reversed tube": ([HOPPER, DOWN], AT_EDGE, 1, 2),
    "concave corner, near both faces": ([HOPPER, UP], (0.12, -0.001), 2, 2),
    "concave corner, near the tube": ([HOPPER, UP], (0.12, -0.02), 1, 2),
    "gate, corner inside": ([HOPPER, GATE], (0.099, 0.01), 2, 2),
    "gate, edge from outside": ([HOPPER, GATE], (0.11, -0.01), 1, 2),
    "open gate": ([HOPPER], (0.1, -0.01), 1, 1),
    "halves of a tube, joint": (HALVES, (0.19, 0.5), 1, 2),
    "halves of a tube, end": (HALVES, (0.19, 1.01), 1, 1),
    "tube, cone and shelf, from inside": ([HOPPER, UP, SHELF], (0.085, 0.003), 1, 3),
    "shelf, tube and cone, over the cone": ([SHELF, UP, HOPPER], (0.096, 0.02), 1, 3),
    "tube, cone and shelf, from outside": ([HOPPER, UP, SHELF], (0.11, -0.01), 2, 3),
    "a plate beyond a tube shares no edge": (PLATE, (0.19, 0.01), 2, 2),
}
"""Shapes, a point, and the numbers of contacts with and without shared edges."""


@pytest.mark.parametrize("name", CASES)
def test_number_of_contacts_at_edges(taichi_f64, name):
    shapes, point, joined, separate = CASES[name]
    assert len(contacts(assign_shared_edges(shapes, ["still"] * len(shapes)), point)) == joined
    assert len(contacts(shapes, point)) == separate


def test_joined_shapes_keep_the_distance_around_a_convex_edge(taichi_f64):
    """The distance to the union of both surfaces is exact, and no two contacts have the same contact point."""
    angle = np.linspace(0, 2 * np.pi, 721)
    points = np.stack([0.1 + 0.02 * np.cos(angle), 0 * angle, 0.02 * np.sin(angle)], axis=1)
    free = [on_device(shape, points)[0] for shape in (HOPPER, UP)]
    joined = [on_device(shape, points)[:2] for shape in assign_shared_edges([HOPPER, UP], [0, 0])]
    distances = np.array([distance for distance, _ in joined])
    np.testing.assert_allclose(distances.min(axis=0), np.min(free, axis=0), rtol=1e-15)
    one, other = (points - distance[:, None] * normal for distance, normal in joined)
    both = np.all(distances < FAR_AWAY, axis=0)
    assert both.any() and np.linalg.norm(one - other, axis=1)[both].min() > 1e-6


def test_walls_with_different_motions_share_no_edge():
    for shape, before in zip(assign_shared_edges([HOPPER, UP], ["still", "gate"]), (HOPPER, UP), strict=True):
        np.testing.assert_array_equal(shape.numbers, before.numbers)
