"""Edges shared by surfaces of revolution: one contact at a convex edge, no edge contact in a concave
corner."""

import numpy as np
import pytest
from geometry.surfaces import on_device

from granflow.geometry.surface import FAR_AWAY, assign_shared_edges
from granflow.scene.blocks.walls.revolved import cone, cylinder, disc

REACH = 0.03
"""Distance [m] below which a point counts as a contact."""


def contacts(shapes, point, reach=REACH):
    """Indices of the shapes within reach of the point (x, 0, z); device and reference agree."""
    points = np.array([[point[0], 0.0, point[1]]])
    found = []
    for index, shape in enumerate(shapes):
        distance, _ = shape.contacts(points)
        on_the_device, _, _ = on_device(shape, points)
        assert on_the_device[0] == pytest.approx(distance[0], abs=1e-15)
        if distance[0] < reach:
            found.append(index)
    return found


def hopper(flip):
    """Cone over an outlet tube; `flip` reverses the axis of the tube."""
    tube_ends = [[0, 0, -0.2], [0, 0, 0]]
    return [cone([0, 0, 0], [0, 0, 1], 0.1, 0.6), cylinder(*(tube_ends[::-1] if flip else tube_ends), 0.1)]


@pytest.mark.parametrize("flip", [False, True])
def test_convex_edge_has_one_contact(taichi_f64, flip):
    """The edge of the orifice from inside: between the normals of cone and tube the edge is the nearest
    feature."""
    shapes = assign_shared_edges(hopper(flip), [0, 0])
    cone_normal = np.array([-2.0, 1.0]) / np.sqrt(5)
    tube_normal = np.array([-1.0, 0.0])
    middle = cone_normal + tube_normal
    edge = np.array([0.1, 0.0])
    assert len(contacts(hopper(flip), edge + 0.02 * middle / np.linalg.norm(middle))) == 2
    assert len(contacts(shapes, edge + 0.02 * middle / np.linalg.norm(middle))) == 1


@pytest.mark.parametrize("flip", [False, True])
def test_concave_corner_has_two_face_contacts(taichi_f64, flip):
    """Outside the hopper, in the corner between cone and tube: contacts with both faces, none with the
    edge."""
    shapes = assign_shared_edges(hopper(flip), [0, 0])
    assert contacts(shapes, (0.12, -0.001)) == [0, 1]
    assert contacts(shapes, (0.12, -0.02)) == [1]
    assert contacts(hopper(flip), (0.12, -0.02)) == [0, 1]


def test_joined_shapes_keep_the_distance_around_a_convex_edge(taichi_f64):
    """The distance to the union of both surfaces is exact, and no two contacts have the same contact
    point."""
    shapes = assign_shared_edges(hopper(False), [0, 0])
    angle = np.linspace(0, 2 * np.pi, 721)
    points = np.stack([0.1 + 0.02 * np.cos(angle), 0 * angle, 0.02 * np.sin(angle)], axis=1)
    free = np.array([on_device(shape, points)[0] for shape in hopper(False)])
    joined = np.array([on_device(shape, points)[0] for shape in shapes])
    np.testing.assert_allclose(joined.min(axis=0), free.min(axis=0), rtol=1e-15)
    contact_points = [
        points - d[:, None] * on_device(s, points)[1] for d, s in zip(joined, shapes, strict=True)
    ]
    both = np.all(joined < FAR_AWAY, axis=0)
    assert both.any()
    assert np.linalg.norm(contact_points[0] - contact_points[1], axis=1)[both].min() > 1e-6


def test_gate_at_the_end_of_a_cone_shares_its_edge(taichi_f64):
    shapes = assign_shared_edges(
        [cone([0, 0, 0], [0, 0, 1], 0.1, 0.6), disc([0, 0, 0], [0, 0, -1], 0.1)], ["still", "still"]
    )
    assert contacts(shapes, (0.099, 0.01)) == [0, 1]
    assert contacts(shapes, (0.05, 0.01)) == [1]
    assert len(contacts(shapes, (0.11, -0.01))) == 1
    opened = assign_shared_edges(shapes[:1], ["still"])
    assert contacts(opened, (0.1, -0.01)) == [0]


def test_split_cylinder_acts_as_one_cylinder(taichi_f64):
    """Two halves end to end: one contact and no gap at the joint."""
    shapes = assign_shared_edges(
        [cylinder([0, 0, 0], [0, 0, 0.5], 0.2), cylinder([0, 0, 0.5], [0, 0, 1], 0.2)], [0, 0]
    )
    for z in (0.499, 0.5, 0.501):
        assert len(contacts(shapes, (0.19, z))) == 1
    assert len(contacts(shapes, (0.19, 1.01))) == 1


def test_edge_of_three_shapes_has_one_owner(taichi_f64):
    """Cone, tube and an outward shelf: only the two shapes adjacent to the widest opening can own the
    edge."""
    shapes = assign_shared_edges([*hopper(False), disc([0, 0, 0], [0, 0, 1], 0.5, 0.1)], [0, 0, 0])
    assert (
        sum(
            getattr(shape, name)
            for shape, name in zip(shapes, ["start_owned", "end_owned", "start_owned"], strict=True)
        )
        == 1
    )
    assert len(contacts(shapes, (0.085, 0.003))) == 1
    assert contacts(shapes, (0.11, -0.01)) == [1, 2]


def test_edge_of_a_tube_on_a_plate_is_not_shared(taichi_f64):
    shapes = assign_shared_edges(
        [cylinder([0, 0, 0], [0, 0, 1], 0.2), disc([0, 0, 0], [0, 0, 1], 0.5)], [0, 0]
    )
    assert contacts(shapes, (0.2, -0.01)) == [1]
    assert contacts(shapes, (0.19, 0.01)) == [0, 1]


def test_walls_with_different_motions_share_no_edge(taichi_f64):
    free = hopper(False)
    for groups in ([0, 1], ["still", ("still", "gate")]):
        for shape, before in zip(assign_shared_edges(free, groups), free, strict=True):
            np.testing.assert_array_equal(shape.numbers, before.numbers)
