"""Random initial velocities with the Maxwell distribution."""

import numpy as np
import pytest
from particles.scenes import BOX, scene_with
from scipy.stats import kstest, maxwell

from granflow.errors import SceneError
from granflow.particles.insertion import initial_particles

RMS = 0.3


def particles_with(thermal, seed=1, **more):
    """Initial particles of one group of 3000."""
    sizes = {"distribution": "uniform", "min": 1e-3, "max": 3e-3}
    group = {
        "count": 3000,
        "diameter": sizes,
        "insert": {"kind": "pack", "region": BOX},
        "thermal": thermal,
    } | more
    return initial_particles(scene_with({"gas": group}, seed))


def test_speeds_have_the_maxwell_distribution_and_the_given_root_mean_square():
    """Each component has the variance rms^2 / 3; Kolmogorov-Smirnov at 1 %, for a fixed seed."""
    velocity = particles_with({"velocity_rms": RMS}).velocity
    speed = np.linalg.norm(velocity, axis=1)
    assert np.sqrt(np.mean(speed**2)) == pytest.approx(RMS, rel=1e-12)
    assert kstest(speed, maxwell(scale=RMS / np.sqrt(3.0)).cdf).pvalue > 0.01
    by_temperature = particles_with({"granular_temperature": RMS**2 / 3.0})
    np.testing.assert_allclose(by_temperature.velocity, velocity, rtol=1e-12)
    for component in velocity.T:
        assert kstest(component / (RMS / np.sqrt(3.0)), "norm").pvalue > 0.01


def test_momentum_is_zero_or_that_of_independent_velocities():
    """The standard deviation of the mean of n independent components is rms / sqrt(3 n)."""
    velocities = {}
    for zero in (True, False):
        found = particles_with({"velocity_rms": RMS, "zero_momentum": zero}, velocity=[1.0, 0.0, -2.0])
        velocities[zero] = found.radius**3 @ (found.velocity - [1.0, 0.0, -2.0]) / np.sum(found.radius**3)
    assert np.abs(velocities[True]).max() < 1e-14
    assert 0.0 < np.abs(velocities[False]).max() < 5.0 * RMS / np.sqrt(3.0 * 3000.0)


def test_velocities_follow_from_the_seed_and_leave_positions_unchanged():
    first, same, other = (particles_with({"velocity_rms": RMS}, seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first.velocity, same.velocity)
    assert not np.any(first.velocity == other.velocity)
    still = particles_with(None)
    np.testing.assert_array_equal(first.position, still.position)
    assert not still.velocity.any()


def test_plan_expects_the_fastest_particle():
    """With 30 seeds no particle is faster than expected, and the expectation is at most 1.6 times the
    fastest."""
    group = {
        "count": 300,
        "diameter": 2e-3,
        "insert": {"kind": "lattice", "region": BOX},
        "thermal": {"velocity_rms": RMS},
    }
    fastest = []
    for seed in range(30):
        scene = scene_with({"gas": group}, seed)
        fastest.append(np.linalg.norm(initial_particles(scene).velocity, axis=1).max())
    expected = scene.particles["gas"].initial_speed
    assert max(fastest) < expected < 1.6 * max(fastest)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"fixed": True}, "thermal cannot be combined with fixed; remove thermal"),
        (
            {"count": 1},
            "thermal cannot have zero momentum: one particle has momentum; write zero_momentum: false",
        ),
        (
            {"insert": {"kind": "rain", "region": BOX, "rate": 100}},
            "thermal cannot be combined with it: insert.kind is rain; random velocities require lattice, "
            "pack",
        ),
    ],
)
def test_random_velocities_of_other_particles_are_refused(change, words):
    with pytest.raises(SceneError, match=words):
        particles_with({"velocity_rms": RMS}, **change)
