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


def group(kind, count, diameter=0.004, region=BOX, **more):
    """A group of particles in a region."""
    return {"count": count, "diameter": diameter, "insert": {"kind": kind, "region": region} | more}


CASES = {
    "lattice": group("lattice", 1000),
    "lattice with jitter": group("lattice", 1000, jitter=1.0),
    "lattice in a tube": group("lattice", 1000, UNIFORM, TUBE, jitter=1.0),
    "lattice of many sizes": group("lattice", 3000, UNIFORM, jitter=0.5),
    "lattice of one": group("lattice", 1, 0.09),
    "pack": group("pack", 1000),
    "pack in a tube": group("pack", 6000, UNIFORM, TUBE),
    "dense pack": group("pack", 3500, 0.008, {"box": {"min": [0, 0, 0], "max": [0.1, 0.1, 0.19]}}),
    "pack of very different sizes": group(
        "pack",
        2000,
        {
            "distribution": "classes",
            "by": "mass",
            "classes": [{"diameter": 0.03, "fraction": 0.7}, {"diameter": 0.003, "fraction": 0.3}],
        },
    ),
    "pack of one": group("pack", 1, 0.1),
}


@pytest.mark.parametrize("name", CASES)
def test_packing_has_the_exact_count_inside_the_region_without_overlap(name):
    case = CASES[name]
    particles = initial_particles(scene_with({"beads": case}))
    assert len(particles) == case["count"]
    assert smallest_gap(particles.position, particles.radius) >= TOUCHING
    assert clearance(case["insert"]["region"], particles.position, particles.radius) >= TOUCHING
    assert (
        particles.position.shape
        == particles.velocity.shape
        == particles.angular_velocity.shape
        == (case["count"], 3)
    )


def test_packing_is_reproducible_and_depends_on_the_seed():
    scene = scene_with({"beads": CASES["pack"], "more": group("lattice", 20, 0.003, TUBE, jitter=1.0)})
    first = initial_particles(scene)
    again = initial_particles(scene)
    for name in first.__dataclass_fields__:
        np.testing.assert_array_equal(getattr(first, name), getattr(again, name))
    other = initial_particles(scene_with({"beads": CASES["pack"]}, seed=2))
    assert not np.any(first.position[:1000] == other.position)
    one_group = initial_particles(scene_with({"beads": group("pack", 100, UNIFORM)}))
    two_groups = initial_particles(
        scene_with({"beads": group("pack", 100, UNIFORM), "more": group("lattice", 5)})
    )
    np.testing.assert_array_equal(one_group.radius, two_groups.radius[:100])


def test_groups_do_not_overlap():
    scene = scene_with(
        {
            "loose": group("pack", 2000),
            "grid": group("lattice", 300, 0.006, jitter=1.0),
            "one": {"diameter": 0.05, "insert": {"kind": "positions", "positions": [[0.05, 0.05, 0.05]]}},
            "second": group("pack", 1000, 0.003),
        }
    )
    particles = initial_particles(scene)
    assert np.bincount(particles.group).tolist() == [2000, 300, 1, 1000]
    assert smallest_gap(particles.position, particles.radius) >= TOUCHING
    assert np.all(np.diff(particles.group) >= 0)


def test_given_positions_are_used_unchanged():
    positions = [[0, 0, 0], [0.004, 0, 0]]
    scene = scene_with(
        {
            "rain": group("rain", 5, rate=10),
            "two": {
                "material": "other",
                "diameter": [0.004, 0.005],
                "velocity": [[1, 0, 0], [-1, 0, 0]],
                "angular_velocity": [0, 0, 3],
                "insert": {"kind": "positions", "positions": positions},
            },
        }
    )
    particles = initial_particles(scene)
    np.testing.assert_array_equal(particles.position, positions)
    np.testing.assert_array_equal(particles.radius, [0.002, 0.0025])
    np.testing.assert_array_equal(particles.velocity, [[1, 0, 0], [-1, 0, 0]])
    np.testing.assert_array_equal(particles.angular_velocity, [[0, 0, 3], [0, 0, 3]])
    np.testing.assert_array_equal(particles.material, np.array([0, 0], dtype=np.int32))
    np.testing.assert_array_equal(particles.group, np.array([1, 1], dtype=np.int32))
    assert len(initial_particles(scene_with({"rain": group("rain", 5, rate=10)}))) == 0


def test_message_names_the_groups_between_which_a_group_does_not_fit():
    """Small spheres of 10 % leave no hole of 20 mm; large ones of 8 % leave room for them."""
    box = {"box": {"min": [0, 0, 0], "max": [0.1, 0.1, 0.1]}}
    fine, coarse = group("pack", 3000, 0.004, box), group("pack", 20, 0.02, box)
    with pytest.raises(SceneError) as caught:
        initial_particles(scene_with({"fine": fine, "coarse": coarse}))
    assert (
        "particles.coarse.count is 20, but none fits in its region between the particles of fine, which are "
        "placed before. Without them it fits: write the group with the largest particles first"
        in str(caught.value)
    )
    assert len(initial_particles(scene_with({"coarse": coarse, "fine": fine}))) == 3020


@pytest.mark.parametrize(
    ("case", "fit"),
    [
        (group("lattice", 40_000), "only 31250 fit"),
        (group("pack", 1_000_000), "about 30000 fit"),
        (group("pack", 3, 0.11), "none fits"),
        (group("lattice", 3, 0.11), "none fits"),
        (group("pack", 3, 0.06, {"box": {"min": [0, 0, 0], "max": [0.1, 0.1, 0.1]}}), "about 2 fit"),
    ],
)
def test_message_about_too_many_particles_states_how_many_fit(case, fit):
    """Centers of spheres of 60 mm lie in a cube of 40 mm: two on its diagonal of 69 mm, but not three, which
    would need diagonals of faces of 57 mm."""
    with pytest.raises(
        SceneError, match=rf"particles\.beads\.count is {case['count']}, but {fit} in its region\. "
    ):
        initial_particles(scene_with({"beads": case}))


@pytest.mark.parametrize("count", [60, 110])
def test_the_number_in_the_message_about_a_full_region_can_be_packed(count):
    """In a box of 3 x 3 x 6 diameters, 60 spheres would fill 58 % and are refused at once; so are 110."""
    region = {"box": {"min": [0, 0, 0], "max": [0.03, 0.03, 0.06]}}
    with pytest.raises(SceneError, match=r"about \d+ fit") as caught:
        initial_particles(scene_with({"beads": group("pack", count, 0.01, region)}))
    fit = int(re.search(r"about (\d+) fit", str(caught.value))[1])
    assert fit >= 35
    particles = initial_particles(scene_with({"beads": group("pack", fit, 0.01, region)}))
    assert smallest_gap(particles.position, particles.radius) >= TOUCHING


def test_message_about_too_many_clumps_states_that_the_spheres_around_them_count():
    """A rod of three spheres of 4 mm at a distance of 3 mm is in a sphere of 10 mm."""
    spheres = [{"position": [x, 0.0, 0.0], "radius": 0.002} for x in (-0.003, 0.0, 0.003)]
    rods = group("pack", 100_000) | {"clump": {"spheres": spheres}}
    del rods["diameter"]
    with pytest.raises(SceneError, match=r"the spheres around them count, here of 0\.01 m, .*as rain"):
        initial_particles(scene_with({"rods": rods}))


def test_all_groups_that_do_not_fit_are_reported():
    scene = scene_with({"a": group("lattice", 40_000), "b": group("pack", 5, 0.2), "c": CASES["pack"]})
    with pytest.raises(SceneError) as caught:
        initial_particles(scene)
    assert len(caught.value.problems) == 2


def test_lattice_spreads_over_the_region():
    particles = initial_particles(scene_with({"beads": group("lattice", 16, region=BOX)}))
    assert smallest_gap(particles.position, particles.radius) > 0.03


def test_pack_is_homogeneous():
    """Each tenth of the height contains a tenth of the particles, within five binomial standard
    deviations."""
    particles = initial_particles(scene_with({"beads": group("pack", 4000, 0.004, TUBE)}))
    axis = np.array([0.6, 0, 0.8])
    along = (particles.position - np.array([0, 0, 0.1])) @ axis
    counts = np.histogram(along, bins=10, range=(0.002, 0.098))[0]
    assert np.all(np.abs(counts - 400) < 5 * np.sqrt(4000 * 0.1 * 0.9))


def test_near_pairs_equal_brute_force():
    random = np.random.default_rng(8)
    position = random.uniform(0, 1, (400, 3))
    radius = np.exp(random.uniform(np.log(0.003), np.log(0.1), 400))
    first, second = near_pairs(position, radius, 0.01)
    i, j = np.triu_indices(400, 1)
    gap = np.linalg.norm(position[i] - position[j], axis=1) - radius[i] - radius[j]
    expected = {(a, b) for a, b in zip(i[gap < 0.01], j[gap < 0.01], strict=True)}
    found = [(min(a, b), max(a, b)) for a, b in zip(first, second, strict=True)]
    assert len(found) == len(set(found)) and set(found) == expected


def test_packing_ends_early_if_a_sphere_cannot_leave_an_obstacle(monkeypatch):
    """An obstacle that fills the box confines the sphere to a corner, where the overlap does not decrease."""
    sweeps = []
    separation = packing.separation
    monkeypatch.setattr(packing, "separation", lambda *given: sweeps.append(1) or separation(*given))
    box = BoxSampler(np.zeros(3), np.ones(3))
    obstacle = Spheres(np.full((1, 3), 0.5), np.array([0.8]))
    with pytest.raises(packing.RegionFullError, match="none fits"):
        packing.pack_at_random(box, np.array([0.1]), obstacle, np.random.default_rng(1))
    assert len(sweeps) < packing.MAX_SWEEPS / 4


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
