"""Initial particles: exact counts, positions inside the region, no overlap, reproducible."""

import re

import numpy as np
import pytest
from particles.scenes import BOX, TUBE, UNIFORM, clearance, scene_with, smallest_gap

from granflow.errors import SceneError
from granflow.geometry import packing
from granflow.geometry.close_pairs import near_pairs
from granflow.geometry.packing import Spheres
from granflow.geometry.region import BoxSampler
from granflow.particles.insertion import initial_particles

TOUCHING = -1e-12
"""Smallest gap [m] between touching particles, negative because of rounding."""
CUBE = {"box": {"min": [0, 0, 0], "max": [0.1, 0.1, 0.1]}}


def group(kind, count, diameter=0.004, region=BOX, **more):
    """A group of particles in a region."""
    return {"count": count, "diameter": diameter, "insert": {"kind": kind, "region": region} | more}


def packed(**groups):
    return initial_particles(scene_with(groups))


COARSE_AND_FINE = [{"diameter": 0.03, "fraction": 0.7}, {"diameter": 0.003, "fraction": 0.3}]
CASES = {
    "lattice": group("lattice", 1000),
    "lattice in a tube": group("lattice", 1000, UNIFORM, TUBE, jitter=1.0),
    "lattice of one": group("lattice", 1, 0.09),
    "pack": group("pack", 1000),
    "pack in a tube": group("pack", 6000, UNIFORM, TUBE),
    "dense pack": group("pack", 3500, 0.008, {"box": {"min": [0, 0, 0], "max": [0.1, 0.1, 0.19]}}),
    "pack of very different sizes": group(
        "pack", 2000, {"distribution": "classes", "by": "mass", "classes": COARSE_AND_FINE}
    ),
    "pack of one": group("pack", 1, 0.1),
}


@pytest.mark.parametrize("name", CASES)
def test_packing_has_the_exact_count_inside_the_region_without_overlap(name):
    case = CASES[name]
    particles = packed(beads=case)
    assert len(particles) == case["count"]
    assert smallest_gap(particles.position, particles.radius) >= TOUCHING
    assert clearance(case["insert"]["region"], particles.position, particles.radius) >= TOUCHING


def test_packing_is_reproducible_and_depends_on_the_seed():
    """The particles of a group do not depend on the groups after it."""
    groups = {"beads": group("pack", 1000, UNIFORM), "more": group("lattice", 20, 0.003, TUBE, jitter=1.0)}
    first, again = packed(**groups), packed(**groups)
    for name in first.__dataclass_fields__:
        np.testing.assert_array_equal(getattr(first, name), getattr(again, name))
    np.testing.assert_array_equal(first.position[:1000], packed(beads=groups["beads"]).position)
    assert not np.any(first.position == initial_particles(scene_with(groups, seed=2)).position)


def test_groups_do_not_overlap():
    particles = packed(
        loose=group("pack", 2000),
        grid=group("lattice", 300, 0.006, jitter=1.0),
        one={"diameter": 0.05, "insert": {"kind": "positions", "positions": [[0.05, 0.05, 0.05]]}},
        second=group("pack", 1000, 0.003),
    )
    assert np.bincount(particles.group).tolist() == [2000, 300, 1, 1000]
    assert smallest_gap(particles.position, particles.radius) >= TOUCHING
    assert np.all(np.diff(particles.group) >= 0)


def test_given_positions_are_used_unchanged():
    given = {
        "material": "other",
        "diameter": [0.004, 0.005],
        "velocity": [[1, 0, 0], [-1, 0, 0]],
        "angular_velocity": [0, 0, 3],
        "insert": {"kind": "positions", "positions": [[0, 0, 0], [0.004, 0, 0]]},
    }
    particles = packed(rain=group("rain", 5, rate=10), two=given)
    np.testing.assert_array_equal(particles.position, given["insert"]["positions"])
    np.testing.assert_array_equal(particles.radius, [0.002, 0.0025])
    np.testing.assert_array_equal(particles.velocity, given["velocity"])
    np.testing.assert_array_equal(particles.angular_velocity, [[0, 0, 3], [0, 0, 3]])
    assert particles.material.tolist() == [0, 0] and particles.group.tolist() == [1, 1]


ROD = {"spheres": [{"position": [x, 0.0, 0.0], "radius": 0.002} for x in (-0.003, 0.0, 0.003)]}
TOO_MANY = {
    "lattice": (group("lattice", 40_000), "is 40000, but only 31250 fit in its region"),
    "pack": (group("pack", 1_000_000), "is 1000000, but about 30000 fit in its region"),
    "too large": (group("pack", 3, 0.11), "is 3, but none fits in its region"),
    "no lattice": (group("lattice", 3, 0.11), "is 3, but none fits in its region"),
    "two of three": (group("pack", 3, 0.06, CUBE), "is 3, but about 2 fit in its region"),
    "clumps": (
        group("pack", 100_000, None) | {"clump": ROD},
        "the spheres around them count, here of 0.01 m",
    ),
}


@pytest.mark.parametrize("name", TOO_MANY)
def test_message_about_too_many_particles_states_how_many_fit(name):
    """Centers of spheres of 60 mm lie in a cube of 40 mm: two on its diagonal of 69 mm, but not three, which
    would need diagonals of faces of 57 mm. A rod of three spheres of 4 mm at 3 mm is in one of 10 mm."""
    case, message = TOO_MANY[name]
    with pytest.raises(SceneError, match=r"particles\.beads\.count") as caught:
        packed(beads=case, other=group("lattice", 40_000, region=CUBE))
    first, second = sorted(caught.value.problems)
    assert message in first and second.startswith("particles.other.count is 40000, but only 15625 fit")


def test_message_names_the_groups_between_which_a_group_does_not_fit():
    """Small spheres of 10 % leave no hole of 20 mm; large ones of 8 % leave room for them."""
    region = {"box": {"min": [0, 0, 0], "max": [0.05] * 3}}
    fine, coarse = group("pack", 375, 0.004, region), group("pack", 2, 0.02, region)
    with pytest.raises(SceneError, match="between the particles of fine, which are placed before. Without"):
        packed(fine=fine, coarse=coarse)
    assert len(packed(coarse=coarse, fine=fine)) == 377


def test_the_number_in_the_message_about_a_full_region_can_be_packed():
    """In a box of 3 x 3 x 6 diameters, 60 spheres would fill 58 % and are refused at once."""
    region = {"box": {"min": [0, 0, 0], "max": [0.03, 0.03, 0.06]}}
    with pytest.raises(SceneError, match=r"about \d+ fit") as caught:
        packed(beads=group("pack", 60, 0.01, region))
    fit = int(re.search(r"about (\d+) fit", str(caught.value))[1])
    particles = packed(beads=group("pack", fit, 0.01, region))
    assert fit >= 35 and smallest_gap(particles.position, particles.radius) >= TOUCHING


def test_particles_spread_over_the_region():
    """Each tenth of the height of a pack has a tenth of the particles, within five binomial deviations."""
    lattice = packed(beads=group("lattice", 16))
    assert smallest_gap(lattice.position, lattice.radius) > 0.03
    pack = packed(beads=group("pack", 4000, 0.004, TUBE))
    along = (pack.position - np.array([0, 0, 0.1])) @ np.array([0.6, 0, 0.8])
    counts = np.histogram(along, bins=10, range=(0.002, 0.098))[0]
    assert np.all(np.abs(counts - 400) < 5 * np.sqrt(4000 * 0.1 * 0.9))


def test_near_pairs_equal_brute_force():
    random = np.random.default_rng(8)
    position = random.uniform(0, 1, (400, 3))
    radius = np.exp(random.uniform(np.log(0.003), np.log(0.1), 400))
    found = np.sort(np.stack(near_pairs(position, radius, 0.01), axis=1), axis=1)
    i, j = np.triu_indices(400, 1)
    gap = np.linalg.norm(position[i] - position[j], axis=1) - radius[i] - radius[j]
    expected = np.stack([i, j], axis=1)[gap < 0.01]
    np.testing.assert_array_equal(found[np.lexsort(found.T[::-1])], expected)


def test_spheres_trapped_between_obstacles_are_placed_elsewhere():
    """A cluster of fixed spheres at distances of 4.1 mm fills 6 % of the box. What begins in a gap of it, of
    4.1 sqrt(3) - 4 = 3.1 mm, cannot leave: spheres of 3.6 mm fit nowhere in the cluster."""
    steps = 0.0041 * np.arange(10)
    corner = np.stack(np.meshgrid(steps, steps, steps), axis=-1).reshape(-1, 3)
    obstacles = Spheres(corner + 0.002, np.full(len(corner), 0.002))
    region = BoxSampler(np.zeros(3), np.full(3, 0.1))
    radius = np.full(400, 0.0018)
    centers = packing.pack_at_random(region, radius, obstacles, np.random.default_rng(2))
    together = Spheres(centers, radius).joined(obstacles)
    assert not len(packing.overlapping_pairs(together, len(radius)))
