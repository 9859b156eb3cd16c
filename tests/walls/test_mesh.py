"""Meshes at rest: which triangle answers, how triangles are read and welded, and that nothing is answered twice."""

import numpy as np
import pytest
from walls.meshes import cube, mesh, sheet, tube

from granflow.walls.mesh_contact import reference_contact, triangle_distances
from granflow.walls.mesh_grid import grid_over
from granflow.walls.motion import rotation_matrices
from granflow.walls.shape import FAR_AWAY


def contacts(surface, points):
    """Gaps and normals (n, t) of every point with every triangle, and bare distances."""
    count = surface.triangle_count
    triangles, repeated = np.tile(np.arange(count), len(points)), np.repeat(points, count, axis=0)
    gap, normal = reference_contact(surface.adjacency, triangles, repeated)
    bare = triangle_distances(surface.adjacency.vertex[triangles], repeated)
    return gap.reshape(-1, count), normal.reshape(-1, count, 3), bare.reshape(-1, count)


def turned(surface):
    """The mesh in a position that no coordinate is round in."""
    rotation = rotation_matrices(np.array([1.0, 2.0, 3.0]) / np.sqrt(14.0), np.array([0.7]))[0]
    return surface.placed(0.7, rotation, np.array([0.3, -0.2, 0.9])), rotation


FOLD = [[0, 1, 2], [0, 1, 3], [0, 1, 4]]

SURFACES = {
    "cube": mesh(*cube()),
    "sheet": mesh(*sheet(5)),
    "hilly sheet": mesh(*sheet(5, bumps=0.02)),
    "rough sheet": mesh(*sheet(5, bumps=0.15)),
    "tube": mesh(*tube(24, rings=2)),
    "tube of eight": mesh(*tube(8)),
    "three at one edge": mesh([[0, 0, 0], [0, 0, 1], [1, 0, 0], [-1, 0.2, 0], [0.3, 1, 0.5]], FOLD),
    "plate on a plate": mesh([[0, 0, 0], [0, 1, 0], [1, 0, 0], [-1, 0, 0], [0, 0.5, 1]], FOLD),
}


@pytest.mark.parametrize("name", SURFACES)
def test_the_nearest_point_of_a_mesh_is_always_answered_for(name):
    """Against all triangles tried one by one: the smallest gap is the distance, and no gap is smaller than it."""
    surface, _ = turned(SURFACES[name])
    low, high = surface.points.min(axis=0), surface.points.max(axis=0)
    points = np.random.default_rng(2).uniform(low - 0.3, high + 0.3, (300, 3))
    gap, normal, bare = contacts(surface, points)
    np.testing.assert_allclose(gap.min(axis=1), bare.min(axis=1), rtol=0.0, atol=1e-14)
    np.testing.assert_allclose(np.linalg.norm(normal, axis=2), 1.0, rtol=1e-14)
    answered = gap < FAR_AWAY
    np.testing.assert_allclose(gap[answered], bare[answered], rtol=0.0, atol=1e-14)


def test_one_triangle_answers_on_a_plane_wherever_the_center_is():
    """Over faces, exactly over seams and corners, and where rounding decides; the gap is the height to the last bit."""
    surface = mesh(*sheet(8))
    rng = np.random.default_rng(3)
    seams = rng.integers(-4, 5, (400, 2)) / 8.0
    beside = seams + rng.choice([-1e-17, 0.0, 1e-17, 1e-16, 1e-12], (400, 2))
    diagonal = np.repeat(rng.uniform(-0.5, 0.5, (200, 1)), 2, axis=1)
    positions = np.concatenate([seams, beside, diagonal, rng.uniform(-0.5, 0.5, (200, 2))])
    positions = np.clip(positions, -0.5, 0.5)
    points = np.concatenate([positions, rng.choice([-0.3, 0.1, 1e-3], (len(positions), 1))], axis=1)
    gap, _, _ = contacts(surface, points)
    np.testing.assert_array_equal(np.sum(gap < FAR_AWAY, axis=1), 1)
    np.testing.assert_array_equal(gap.min(axis=1), np.abs(points[:, 2]))
    tilted, rotation = turned(surface)
    gap, _, _ = contacts(tilted, 0.7 * points @ rotation.T + [0.3, -0.2, 0.9])
    np.testing.assert_array_equal(np.sum(gap < FAR_AWAY, axis=1), 1)


def test_one_triangle_answers_about_a_convex_body():
    """About a cube each point nearer than 1 has one contact, with the distance and the direction from the body."""
    points = np.random.default_rng(4).uniform(-0.4, 1.4, (400, 3))
    points = points[np.any((points < 0.0) | (points > 1.0), axis=1)]
    gap, normal, _ = contacts(SURFACES["cube"], points)
    away = points - np.clip(points, 0.0, 1.0)
    near = gap < 0.9  # the far side of the cube is felt from within, too, by a sphere that large
    assert np.all(near.sum(axis=1) == 1)
    np.testing.assert_allclose(gap[near], np.linalg.norm(away, axis=1), rtol=0.0, atol=1e-15)
    np.testing.assert_allclose(normal[near] * gap[near][:, None], away, rtol=0.0, atol=1e-15)


def test_a_round_tube_of_facets_is_touched_once_from_within():
    """Whatever the size of the ball: the gap is that of the nearest facet, and no second one doubles the stiffness."""
    surface = mesh(*tube(24, rings=3))
    rng = np.random.default_rng(5)
    angle, r, z = rng.uniform(0.0, 2 * np.pi, 400), rng.uniform(0.05, 0.95, 400), rng.uniform(0.3, 1.7, 400)
    points = np.stack([r * np.cos(angle), r * np.sin(angle), z], axis=1)
    gap, _, bare = contacts(surface, points)
    assert np.all(np.sum(gap < 1.0, axis=1) == 1)  # beyond the axis are the facets opposite
    np.testing.assert_allclose(gap.min(axis=1), bare.min(axis=1), rtol=0.0, atol=1e-15)


def test_a_corner_is_touched_on_both_sides():
    """Two plates at 90 degrees hold a ball in the hollow twice, and by the edge alone from outside."""
    points, corners = [[0, 0, 0], [0, 1, 0], [1, 0, 0], [1, 1, 0], [0, 0, 1], [0, 1, 1]], [
        [0, 2, 1], [2, 3, 1], [0, 1, 4], [1, 5, 4],
    ]  # fmt: skip
    gap, _, _ = contacts(mesh(points, corners), np.array([[0.2, 0.45, 0.3], [-0.3, 0.45, -0.4]]))
    assert sorted(gap[0])[:2] == [0.2, 0.3]
    assert np.sum(gap[0] < FAR_AWAY) == 2
    np.testing.assert_allclose(np.sort(gap[1])[:2], [0.5, FAR_AWAY], rtol=1e-15)


def test_the_grid_lists_every_triangle_within_reach_once():
    """Against all triangles tried one by one."""
    surface, reach = SURFACES["rough sheet"], 0.12
    grid = grid_over(surface.adjacency.vertex, reach)
    points = np.random.default_rng(6).uniform(-0.7, 0.7, (200, 3))
    _, _, bare = contacts(surface, points)
    for point, distance in zip(points, bare, strict=True):
        insertion = np.floor((point - grid.low) / grid.side).astype(int)
        listed = np.array([], int)
        if np.all((insertion >= 0) & (insertion < grid.shape)):
            cell = (insertion[2] * grid.shape[1] + insertion[1]) * grid.shape[0] + insertion[0]
            listed = grid.triangle[grid.start[cell] : grid.start[cell + 1]]
        assert len(set(listed)) == len(listed)
        assert set(np.flatnonzero(distance < reach)) <= set(listed)


def test_parts_meshed_one_by_one_join_without_a_seam():
    """A square of two triangles beside one of 32: one triangle answers wherever the center is, also along the seam."""
    coarse, halves = sheet(1)
    fine, corners = sheet(4)
    surface = mesh(np.concatenate([coarse, fine + [1.0, 0.0, 0.0]]), np.concatenate([halves, corners + len(coarse)]))
    assert surface.divided_count == 1
    assert (surface.triangle_count, surface.adjacency.open_count) == (2 + 3 + 32, 3 + 12)
    rng = np.random.default_rng(8)
    positions = np.stack([rng.choice([0.5, 0.5 + 1e-17, 0.499, 0.501, 0.3], 300), rng.uniform(-0.5, 0.5, 300)], axis=1)
    points = np.concatenate([positions, rng.choice([-0.2, 0.1], (300, 1))], axis=1)
    points[:10, 1] = np.linspace(-0.5, 0.5, 9)[[0, 1, 2, 3, 4, 5, 6, 7, 8, 4]]
    gap, _, _ = contacts(surface, points)
    np.testing.assert_array_equal(np.sum(gap < FAR_AWAY, axis=1), 1)
    np.testing.assert_array_equal(gap.min(axis=1), np.abs(points[:, 2]))


def test_points_are_welded_and_useless_triangles_left_out():
    points, corners = sheet(3)
    loose = points[corners].reshape(-1, 3)
    loose[::2] += 2e-7  # as single precision would
    soup_corners = np.arange(len(loose)).reshape(-1, 3)
    twice = np.concatenate([soup_corners, soup_corners[:2][:, ::-1], [[0, 1, 1], [0, 1, 0]]])
    found = mesh(loose, twice)
    assert len(found.points) == len(points)
    assert found.triangle_count == len(corners)
    assert (found.duplicate_count, found.degenerate_count) == (2, 2)
    assert found.adjacency.open_count == 12
    assert mesh(*cube()).adjacency.open_count == 0
