"""The bench for binary collisions: pairs and walls in one simulation, repetition, and settings of
`collide`."""

from dataclasses import replace

import numpy as np
import pytest

from granflow.geometry.sphere import sphere_mass
from granflow.studies.bench import Collision, CollisionBench

SOLID = {"young_modulus": 1e8, "poisson_ratio": 0.25, "density": 2500.0}
PAIRS = {"soft-soft": 0.5, "soft-heavy": 0.7, "heavy-heavy": 0.9}
COLLISIONS = [
    Collision("soft", "soft", 1e-3, 2e-3, 1.0),
    Collision("soft", "heavy", 1e-3, None, 0.5, share=1.0, first_contact=1e-6),
    Collision("heavy", "soft", 2e-3, 1e-3, 1.0, share=0.2),
    Collision("heavy", "heavy", 1e-3, None, 0.8, share=1.0),
]


@pytest.fixture(scope="module")
def bench(taichi_f64):
    materials = {"soft": SOLID, "heavy": SOLID | {"density": 7800.0}}
    pairs = {key: {"restitution": e, "friction": 0} for key, e in PAIRS.items()}
    run = {"duration": 1.0, "velocity_max": 1.0, "time_step": 2e-7}
    found = CollisionBench(materials, pairs, {"normal": "zhou"}, COLLISIONS, run, contact_x=0.02)
    yield found
    found.free()


def test_pairs_and_walls_rebound_with_the_restitution_of_their_materials(bench):
    samples = bench.run(every=5)
    e = samples[-1, 1] / -np.array([each.velocity for each in COLLISIONS])
    np.testing.assert_allclose(e, [0.5, 0.7, 0.7, 0.9], rtol=2e-3)
    velocity, _ = bench.motions()
    for each, after in zip(COLLISIONS, velocity[:, :, 0], strict=True):
        if each.other_radius is not None:
            masses = [sphere_mass(radius, bench.scene.materials[name].density)
                      for radius, name in ((each.radius, each.first), (each.other_radius, each.second))]  # fmt: skip
            before = np.array([each.share, each.share - 1.0]) * each.velocity
            assert masses @ after == pytest.approx(masses @ before, rel=1e-12)


def test_a_restart_repeats_the_collisions_and_changes_the_time_step(bench):
    bench.restart(COLLISIONS)
    samples = bench.run(every=10)
    bench.restart(COLLISIONS)
    np.testing.assert_array_equal(bench.run(every=10), samples)
    bench.restart([replace(each, velocity=0.5 * each.velocity) for each in COLLISIONS], 1e-7)
    assert len(bench.run(every=10)) > 2 * len(samples)
