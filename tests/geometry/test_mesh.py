"""Stationary meshes: owning triangle of each contact, welding of points, no duplicate contacts."""

import numpy as np
import pytest
from geometry.meshes import cube, mesh, sheet, tube
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from granflow.geometry.connected_parts import connected_parts
from granflow.geometry.mesh import grid_over
from granflow.geometry.mesh_contact import triangle_contacts, triangle_distances
from granflow.geometry.mesh_file import STL_RECORD, read_triangles
from granflow.geometry.motion import rotation_matrices
from granflow.geometry.surface import FAR_AWAY
from granflow.io.files import FormatError


def contacts(surface, points):
    """Gaps (n, t), normals (n, t, 3) and distances without ownership (n, t) of all points and triangles."""
    count = surface.triangle_count
    triangles = np.tile(np.arange(count), len(points))
    repeated = np.repeat(points, count, axis=0)
    gap, normal = triangle_contacts(surface.adjacency, triangles, repeated)
    bare = triangle_distances(surface.adjacency.vertex[triangles], repeated)
    return gap.reshape(-1, count), normal.reshape(-1, count, 3), bare.reshape(-1, count)


def transformed(surface):
    """The mesh in a pose whose coordinates are not round numbers."""
    rotation = rotation_matrices(np.array([1.0, 2.0, 3.0]) / np.sqrt(14.0), np.array([0.7]))[0]
    return surface.placed(0.7, rotation, np.array([0.3, -0.2, 0.9])), rotation


FOLD = [[0, 1, 2], [0, 1, 3], [0, 1, 4]]

SURFACES = {
    "cube": mesh(*cube()),
    "hilly sheet": mesh(*sheet(5, bumps=0.02)),
    "rough sheet": mesh(*sheet(5, bumps=0.15)),
    "tube": mesh(*tube(8)),
    "three triangles at one edge": mesh([[0, 0, 0], [0, 0, 1], [1, 0, 0], [-1, 0.2, 0], [0.3, 1, 0.5]], FOLD),
    "plate on a plate": mesh([[0, 0, 0], [0, 1, 0], [1, 0, 0], [-1, 0, 0], [0, 0.5, 1]], FOLD),
}


@pytest.mark.parametrize("name", SURFACES)
def test_smallest_gap_is_the_distance_to_the_mesh(name):
    surface, _ = transformed(SURFACES[name])
    low, high = surface.points.min(axis=0), surface.points.max(axis=0)
    points = np.random.default_rng(2).uniform(low - 0.3, high + 0.3, (300, 3))
    gap, normal, bare = contacts(surface, points)
    np.testing.assert_allclose(gap.min(axis=1), bare.min(axis=1), rtol=0.0, atol=1e-14)
    np.testing.assert_allclose(np.linalg.norm(normal, axis=2), 1.0, rtol=1e-14)
    owned = gap < FAR_AWAY
    np.testing.assert_allclose(gap[owned], bare[owned], rtol=0.0, atol=1e-14)


def assert_one_owner(surface, positions, rng):
    """Exactly one triangle owns a contact over each position; the gap is the height to the last bit."""
    heights = rng.choice([-0.3, 0.1, 1e-3], (len(positions), 1))
    points = np.concatenate([positions, heights], axis=1)
    gap, _, _ = contacts(surface, points)
    np.testing.assert_array_equal(np.sum(gap < FAR_AWAY, axis=1), 1)
    np.testing.assert_array_equal(gap.min(axis=1), np.abs(points[:, 2]))
    return points


def test_exactly_one_triangle_of_a_flat_mesh_owns_a_contact():
    """Centers over faces, edges and vertices, exactly or within rounding; also along the common edge of a square
    of two triangles and one of 32."""
    rng = np.random.default_rng(3)
    edges = rng.integers(-4, 5, (400, 2)) / 8.0
    near_edges = edges + rng.choice([-1e-17, 0.0, 1e-17, 1e-16, 1e-12], (400, 2))
    diagonal = np.repeat(rng.uniform(-0.5, 0.5, (200, 1)), 2, axis=1)
    positions = np.concatenate([edges, near_edges, diagonal, rng.uniform(-0.5, 0.5, (200, 2))])
    surface = mesh(*sheet(8))
    points = assert_one_owner(surface, np.clip(positions, -0.5, 0.5), rng)
    tilted, rotation = transformed(surface)
    gap, _, _ = contacts(tilted, 0.7 * points @ rotation.T + [0.3, -0.2, 0.9])
    np.testing.assert_array_equal(np.sum(gap < FAR_AWAY, axis=1), 1)
    (coarse, halves), (fine, corners) = sheet(1), sheet(4)
    points = np.concatenate([coarse, fine + [1.0, 0.0, 0.0]])
    surface = mesh(points, np.concatenate([halves, corners + len(coarse)]))
    assert surface.divided_count == 1
    assert (surface.triangle_count, surface.adjacency.open_count) == (2 + 3 + 32, 3 + 12)
    along = np.concatenate([np.linspace(-0.5, 0.5, 9), rng.uniform(-0.5, 0.5, 300)])
    across = rng.choice([0.5, 0.5 + 1e-17, 0.499, 0.501, 0.3], len(along))
    assert_one_owner(surface, np.stack([across, along], axis=1), rng)


def test_convex_bodies_have_one_contact_and_concave_corners_two():
    """Around a cube with the distance and the direction from it; in a faceted tube that of the nearest facet."""
    rng = np.random.default_rng(4)
    points = rng.uniform(-0.4, 1.4, (400, 3))
    points = points[np.any((points < 0.0) | (points > 1.0), axis=1)]
    gap, normal, _ = contacts(SURFACES["cube"], points)
    offset = points - np.clip(points, 0.0, 1.0)
    near = gap < 0.9  # a larger particle also touches the opposite side of the cube from inside
    assert np.all(near.sum(axis=1) == 1)
    np.testing.assert_allclose(gap[near], np.linalg.norm(offset, axis=1), rtol=0.0, atol=1e-15)
    np.testing.assert_allclose(normal[near] * gap[near][:, None], offset, rtol=0.0, atol=1e-15)
    angle, r, z = (rng.uniform(*ends, 400) for ends in ((0.0, 2 * np.pi), (0.05, 0.95), (0.3, 1.7)))
    points = np.stack([r * np.cos(angle), r * np.sin(angle), z], axis=1)
    gap, _, _ = contacts(mesh(*tube(24, rings=3)), points)
    assert np.all(np.sum(gap < 1.0, axis=1) == 1)  # facets beyond the axis are farther
    plates = [[0, 0, 0], [0, 1, 0], [1, 0, 0], [1, 1, 0], [0, 0, 1], [0, 1, 1]]
    corners = [[0, 2, 1], [2, 3, 1], [0, 1, 4], [1, 5, 4]]
    gap, _, _ = contacts(mesh(plates, corners), np.array([[0.2, 0.45, 0.3], [-0.3, 0.45, -0.4]]))
    np.testing.assert_allclose(np.sort(gap)[:, :2], [[0.2, 0.3], [0.5, FAR_AWAY]], rtol=1e-15)
    assert np.sum(gap[0] < FAR_AWAY) == 2


def test_grid_lists_every_triangle_within_reach_once():
    """Against the distances to all triangles."""
    surface = SURFACES["rough sheet"]
    reach = 0.12
    grid = grid_over(surface.adjacency.vertex, reach)
    points = np.random.default_rng(6).uniform(-0.7, 0.7, (200, 3))
    _, _, bare = contacts(surface, points)
    for point, distance in zip(points, bare, strict=True):
        index = np.floor((point - grid.low) / grid.side).astype(int)
        candidates = np.array([], int)
        if np.all((index >= 0) & (index < grid.shape)):
            cell = (index[2] * grid.shape[1] + index[1]) * grid.shape[0] + index[0]
            candidates = grid.triangle[grid.start[cell] : grid.start[cell + 1]]
        assert len(set(candidates)) == len(candidates)
        assert set(np.flatnonzero(distance < reach)) <= set(candidates)


def test_connected_parts_are_those_of_scipy():
    """A chain in random order needs most rounds; random pairs leave things alone."""
    rng = np.random.default_rng(1)
    order = rng.permutation(500)
    for pairs in (np.stack([order[:-3], order[1:-2]], axis=1), rng.integers(0, 500, (170, 2))):
        _, expected = connected_components(coo_array((np.ones(len(pairs)), pairs.T), (500, 500)))
        np.testing.assert_array_equal(connected_parts(pairs, 500), expected)


def test_points_are_welded_and_duplicate_and_degenerate_triangles_are_removed():
    points, corners = sheet(3)
    unwelded = points[corners].reshape(-1, 3)
    unwelded[::2] += 2e-7  # an error of the size of single precision
    unwelded_corners = np.arange(len(unwelded)).reshape(-1, 3)
    with_extra = np.concatenate([unwelded_corners, unwelded_corners[:2][:, ::-1], [[0, 1, 1], [0, 1, 0]]])
    found = mesh(unwelded, with_extra)
    assert len(found.points) == len(points)
    assert found.triangle_count == len(corners)
    assert (found.duplicate_count, found.degenerate_count) == (2, 2)
    assert found.adjacency.open_count == 12
    assert mesh(*cube()).adjacency.open_count == 0


def stl(declared):
    """A binary STL file of three triangles that declares another number of them."""
    records = np.zeros(3, STL_RECORD)
    records["corners"] = np.arange(27.0).reshape(3, 3, 3)
    return bytes(80) + np.uint32(declared).tobytes() + records.tobytes()


def ply(declared):
    """A PLY file of three separate triangles that declares another number of them."""
    header = "ply\nformat binary_little_endian 1.0\nelement vertex 9\n"
    header += "".join(f"property float {axis}\n" for axis in "xyz")
    header += f"element face {declared}\nproperty list uchar int vertex_indices\nend_header\n"
    corners = np.arange(9, dtype=np.int32).reshape(3, 3)
    points = np.arange(27, dtype=np.float32)
    return header.encode() + points.tobytes() + b"".join(b"\x03" + each.tobytes() for each in corners)


FACET = (
    b"solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\n"
)
COUNTS = {
    "below.stl": (stl(1), "declares 1 triangles, but its size is that of 3"),
    "above.stl": (stl(4), "declares 4 triangles, but its size allows 3"),
    "right.stl": (stl(3), None),
    "text.stl": (FACET + b"\nendsolid a\n\n", None),
    "open.stl": (FACET, "does not end with endsolid: it is truncated"),
    "right.ply": (ply(3), None),
    "above.ply": (ply(4), "PLY|declares 4 faces"),
    "solid.obj": (FACET, "cannot be read as OBJ: line 1 begins with 'solid'"),
    "header.ply": (ply(3)[:40], "has no end_header: it is truncated"),
}


@pytest.mark.parametrize("name", COUNTS)
def test_a_mesh_file_has_as_many_triangles_as_it_declares(tmp_path, name):
    """No triangle of an STL file is dropped silently; a truncated PLY file and an STL file as OBJ are refused."""
    content, reason = COUNTS[name]
    (tmp_path / name).write_bytes(content)
    if reason is None:
        assert len(read_triangles(tmp_path / name).corners) == (1 if name == "text.stl" else 3)
    else:
        with pytest.raises(FormatError, match=reason):
            read_triangles(tmp_path / name)


def test_points_inside_a_closed_mesh_are_enclosed():
    """A cube, also on the lattice of its corners, and a cube with a cavity; an open sheet encloses nothing."""
    points, corners = cube()
    lattice = np.stack(np.meshgrid(*[np.linspace(-0.5, 1.5, 9)] * 3), axis=-1).reshape(-1, 3)
    at = np.concatenate([lattice, np.random.default_rng(2).uniform(-0.5, 1.5, (3000, 3))])
    in_cube = ((at > 0.0) & (at < 1.0)).all(axis=1)
    on_face = ((at >= 0.0) & (at <= 1.0)).all(axis=1) & ~in_cube
    assert (mesh(points, corners).encloses(at) == in_cube)[~on_face].all() and in_cube.sum() > 300
    hollow = mesh(
        np.concatenate([points, 0.25 + 0.5 * points]), np.concatenate([corners, corners[:, ::-1] + 8])
    )
    in_cavity = ((at >= 0.25) & (at <= 0.75)).all(axis=1)
    edges = ((at == 0.25) | (at == 0.75)).any(axis=1) & in_cavity
    assert (hollow.encloses(at) == (in_cube & ~in_cavity))[~on_face & ~edges].all()
    assert not mesh(*sheet(3)).encloses(at).any()
