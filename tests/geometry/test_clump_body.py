"""Volume, center of mass and moments of inertia of clumps against closed forms and an independent integration."""

import numpy as np
import pytest
from numpy.polynomial import Polynomial

from granflow.geometry.clump import clump_body, matrices, of_matrix, product, random_orientations


def shape_of(centers, radii):
    return clump_body(tuple(map(tuple, np.asarray(centers, float).tolist())), tuple(map(float, radii)))


@pytest.mark.parametrize("distance", [0.3, 1.9])
def test_two_overlapping_spheres_have_the_closed_forms(distance):
    """Body of revolution about x with the radius y(x): V = pi int y^2, I_x = pi/2 int y^4, I_y = pi int (y^4/4 +
    x^2 y^2) with y^2 = R^2 - (x - d/2)^2 for x from 0 to d/2 + R, and the same on the other side.
    """
    scale, x = 2e-3, Polynomial([0.0, 1.0])
    square = 1.0 - (x - 0.5 * distance) ** 2
    parts = (square, square**2 / 2.0, square**2 / 4.0 + x**2 * square)
    integrals = [part.integ()(0.5 * distance + 1.0) - part.integ()(0.0) for part in parts]
    volume, along, across = 2.0 * np.pi * np.array(integrals)
    shape = shape_of(scale * np.array([[0.0, 0.0, 0.0], [distance, 0.0, 0.0]]), [scale, scale])
    assert shape.volume == pytest.approx(scale**3 * volume, rel=1e-12)
    assert shape.moments == pytest.approx(scale**5 * np.array([along, across, across]), rel=1e-12)
    assert shape.center == pytest.approx([0.5 * scale * distance, 0.0, 0.0], abs=1e-12 * scale)
    assert shape.principal_axes.tolist() == [1.0, 0.0, 0.0, 0.0]


def test_disjoint_spheres_have_the_moments_of_the_parallel_axis_theorem():
    """Spheres within another one count once."""
    rng = np.random.default_rng(5)
    centers = 4.0 * np.argwhere(np.ones((2, 2, 2))) + rng.uniform(-0.5, 0.5, (8, 3))
    radii = rng.uniform(0.5, 1.4, 8)
    volumes = 4.0 / 3.0 * np.pi * radii**3
    center = volumes @ centers / volumes.sum()
    branch = centers - center
    second = np.einsum("i,ij,ik->jk", volumes, branch, branch) + np.eye(3) * (volumes @ radii**2) / 5.0
    within = np.concatenate([centers, centers[:2], centers[:1] + 0.1]), np.append(radii, [*radii[:2], 0.2])
    for shape in (shape_of(centers, radii), shape_of(*within)):
        assert shape.volume == pytest.approx(volumes.sum(), rel=1e-12)
        assert shape.center == pytest.approx(center, rel=1e-12)
        moments = np.linalg.eigvalsh(np.trace(second) * np.eye(3) - second)
        assert sorted(shape.moments) == pytest.approx(moments, rel=1e-11)


def chords(centers, radii, lines=500):
    """Volume and center of mass of a union of spheres by the union of its chords along x on a grid of lines."""
    low, high = (centers - radii[:, None]).min(axis=0), (centers + radii[:, None]).max(axis=0)
    edges = [np.linspace(low[axis], high[axis], lines + 1) for axis in (1, 2)]
    y, z = np.meshgrid(*(0.5 * (edge[1:] + edge[:-1]) for edge in edges), indexing="ij")
    y, z = y.ravel()[:, None], z.ravel()[:, None]
    half = np.sqrt(np.maximum(radii**2 - (y - centers[:, 1]) ** 2 - (z - centers[:, 2]) ** 2, 0.0))
    begin, end = centers[:, 0] - half, centers[:, 0] + half
    order = np.argsort(begin, axis=1)
    begin, end = np.take_along_axis(begin, order, axis=1), np.take_along_axis(end, order, axis=1)
    reached = np.maximum.accumulate(np.c_[np.full(len(y), -np.inf), end], axis=1)[:, :-1]
    start = np.maximum(begin, reached)
    length = np.maximum(end - start, 0.0)
    first = [(length * v).sum() for v in (0.5 * (start + end), y, z)]
    area = (edges[0][1] - edges[0][0]) * (edges[1][1] - edges[1][0])
    return area * length.sum(), np.array(first) / length.sum()


def test_spheres_that_overlap_each_other_have_the_volume_of_their_chords_along_all_axes():
    """The stated accuracy of clumps in which three spheres overlap each other is 1e-5."""
    cluster = np.array(
        [[0.0, 0.0, 0.0], [0.9, 0.1, 0.0], [0.3, 0.8, 0.2], [0.2, 0.3, -0.7], [-0.5, 0.4, 0.5]]
    )
    radii = np.array([0.9, 0.7, 0.8, 0.6, 0.75])
    volume, center = chords(cluster, radii)
    one = shape_of(cluster, radii)
    assert one.volume == pytest.approx(volume, rel=3e-5)
    assert one.center == pytest.approx(center, abs=3e-5)
    for rotation in matrices(random_orientations(3, np.random.default_rng(2))):
        other = shape_of(cluster @ rotation.T, radii)
        assert other.volume == pytest.approx(one.volume, rel=1e-5)
        assert sorted(other.moments) == pytest.approx(sorted(one.moments), rel=1e-5)
        back = matrices(other.principal_axes[None])[0]
        assert other.offset @ back.T + other.center == pytest.approx(cluster @ rotation.T, abs=1e-12)


def test_quaternions_match_their_matrices():
    first, second = random_orientations(2, np.random.default_rng(3))
    both = matrices(product(first, second))[0]
    assert both == pytest.approx(matrices(first[None])[0] @ matrices(second[None])[0], abs=1e-14)
    half_turn = np.diag([1.0, -1.0, -1.0])
    for rotation in (both, half_turn):
        assert matrices(of_matrix(rotation)[None])[0] == pytest.approx(rotation, abs=1e-14)
