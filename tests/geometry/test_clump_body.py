"""Volume, center of mass and moments of inertia of clumps against closed forms and an independent
integration."""

import numpy as np
import pytest
from numpy.polynomial import Polynomial

from granflow.geometry.clump import clump_body, matrices, of_matrix, product, random_orientations


def shape_of(centers, radii):
    return clump_body(tuple(map(tuple, np.asarray(centers, float).tolist())), tuple(map(float, radii)))


def two_spheres(radius, distance):
    """Volume and moments (along, across the axis) of two equal overlapping spheres about their center.

    Body of revolution about x with the radius y(x): V = pi int y^2, I_x = pi/2 int y^4, I_y = pi int (y^4/4 +
    x^2 y^2) with y^2 = R^2 - (x - d/2)^2 for x from 0 to d/2 + R, and the same on the other side.
    """
    x = Polynomial([0.0, 1.0])
    square = radius**2 - (x - 0.5 * distance) ** 2
    parts = (square, square**2 / 2.0, square**2 / 4.0 + x**2 * square)
    return [2.0 * np.pi * (part.integ()(0.5 * distance + radius) - part.integ()(0.0)) for part in parts]


@pytest.mark.parametrize("distance", [0.3, 1.1, 1.9, 2.0])
def test_two_overlapping_spheres_have_the_closed_forms(distance):
    radius = 1.0
    scale = 2e-3
    volume, along, across = two_spheres(radius, distance)
    shape = shape_of(scale * np.array([[0.0, 0.0, 0.0], [distance, 0.0, 0.0]]), [scale, scale])
    assert shape.volume == pytest.approx(scale**3 * volume, rel=1e-12)
    assert shape.moments == pytest.approx(scale**5 * np.array([along, across, across]), rel=1e-12)
    assert shape.center == pytest.approx([0.5 * scale * distance, 0.0, 0.0], abs=1e-12 * scale)
    assert shape.principal_axes.tolist() == [1.0, 0.0, 0.0, 0.0]


def test_disjoint_spheres_have_the_moments_of_the_parallel_axis_theorem():
    rng = np.random.default_rng(5)
    centers = 4.0 * np.argwhere(np.ones((2, 2, 2))) + rng.uniform(-0.5, 0.5, (8, 3))
    radii = rng.uniform(0.5, 1.4, 8)
    volumes = 4.0 / 3.0 * np.pi * radii**3
    center = volumes @ centers / volumes.sum()
    branch = centers - center
    second = np.einsum("i,ij,ik->jk", volumes, branch, branch) + np.eye(3) * (volumes @ radii**2) / 5.0
    shape = shape_of(centers, radii)
    assert shape.volume == pytest.approx(volumes.sum(), rel=1e-12)
    assert shape.center == pytest.approx(center, rel=1e-12)
    moments = np.linalg.eigvalsh(np.trace(second) * np.eye(3) - second)
    assert sorted(shape.moments) == pytest.approx(moments, rel=1e-11)


def test_a_contained_or_repeated_sphere_counts_once():
    alone = shape_of([[0.0, 0.0, 0.0]], [2.0])
    for centers, radii in (([[0.0] * 3] * 3, [2.0] * 3), ([[0.0] * 3, [0.5, 0.3, 0.0]], [2.0, 1.0])):
        shape = shape_of(centers, radii)
        assert shape.volume == pytest.approx(alone.volume, rel=1e-12)
        assert shape.moments == pytest.approx([0.4 * alone.volume * 4.0] * 3, rel=1e-12)


def chords(centers, radii, lines=500):
    """Volume and center of mass of a union of spheres by the union of its chords along x on a grid of
    lines."""
    low, high = (centers - radii[:, None]).min(axis=0), (centers + radii[:, None]).max(axis=0)
    edges = [np.linspace(low[axis], high[axis], lines + 1) for axis in (1, 2)]
    y, z = np.meshgrid(*(0.5 * (edge[1:] + edge[:-1]) for edge in edges), indexing="ij")
    y = y.ravel()[:, None]
    z = z.ravel()[:, None]
    half = np.sqrt(np.maximum(radii**2 - (y - centers[:, 1]) ** 2 - (z - centers[:, 2]) ** 2, 0.0))
    begin, end = centers[:, 0] - half, centers[:, 0] + half
    order = np.argsort(begin, axis=1)
    begin, end = np.take_along_axis(begin, order, axis=1), np.take_along_axis(end, order, axis=1)
    reached = np.maximum.accumulate(np.c_[np.full(len(y), -np.inf), end], axis=1)[:, :-1]
    start = np.maximum(begin, reached)
    length = np.maximum(end - start, 0.0)
    area = (edges[0][1] - edges[0][0]) * (edges[1][1] - edges[1][0])
    volume = area * length.sum()
    first = [
        area * (length * 0.5 * (start + end))[length > 0.0].sum(),
        *(area * (length * v).sum() for v in (y, z)),
    ]
    return volume, np.array(first) / volume


CLUSTER = np.array([[0.0, 0.0, 0.0], [0.9, 0.1, 0.0], [0.3, 0.8, 0.2], [0.2, 0.3, -0.7], [-0.5, 0.4, 0.5]])
RADII = np.array([0.9, 0.7, 0.8, 0.6, 0.75])


def test_spheres_that_overlap_each_other_have_the_volume_of_their_chords():
    volume, center = chords(CLUSTER, RADII)
    shape = shape_of(CLUSTER, RADII)
    assert shape.volume == pytest.approx(volume, rel=3e-5)
    assert shape.center == pytest.approx(center, abs=3e-5)


def test_the_shape_does_not_depend_on_the_axes_of_the_given_positions():
    """The stated accuracy of clumps in which three spheres overlap each other is 1e-5."""
    one = shape_of(CLUSTER, RADII)
    for rotation in matrices(random_orientations(5, np.random.default_rng(2))):
        other = shape_of(CLUSTER @ rotation.T, RADII)
        assert other.volume == pytest.approx(one.volume, rel=1e-5)
        assert sorted(other.moments) == pytest.approx(sorted(one.moments), rel=1e-5)
        assert np.linalg.norm(other.offset, axis=1) == pytest.approx(
            np.linalg.norm(one.offset, axis=1), rel=1e-5
        )
        back = matrices(other.principal_axes[None])[0]
        assert other.offset @ back.T + other.center == pytest.approx(CLUSTER @ rotation.T, abs=1e-12)


def test_quaternions_match_their_matrices():
    first, second = random_orientations(2, np.random.default_rng(3))
    both = matrices(product(first, second))[0]
    assert both == pytest.approx(matrices(first[None])[0] @ matrices(second[None])[0], abs=1e-14)
    sign = np.sign(first[0])
    assert of_matrix(matrices(first[None])[0]) == pytest.approx(sign * first, abs=1e-14)
    half_turn = np.diag([1.0, -1.0, -1.0])
    assert matrices(of_matrix(half_turn)[None])[0] == pytest.approx(half_turn, abs=1e-15)
