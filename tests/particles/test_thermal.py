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
    group = {"count": 3000, "diameter": sizes, "insert": {"kind": "pack", "region": BOX}, "thermal": thermal}
    return initial_particles(scene_with({"gas": group | more}, seed))


def test_speeds_have_the_maxwell_distribution_and_the_given_root_mean_square():
    """Each component has the variance rms^2 / 3; Kolmogorov-Smirnov at 1 %, for a fixed seed."""
    found = particles_with({"velocity_rms": RMS})
    speed = np.linalg.norm(found.velocity, axis=1)
    assert np.sqrt(np.mean(speed**2)) == pytest.approx(RMS, rel=1e-12)
    assert kstest(speed, maxwell(scale=RMS / np.sqrt(3.0)).cdf).pvalue > 0.01
    for component in found.velocity.T:
        assert kstest(component / (RMS / np.sqrt(3.0)), "norm").pvalue > 0.01
    by_temperature = particles_with({"granular_temperature": RMS**2 / 3.0})
    np.testing.assert_allclose(by_temperature.velocity, found.velocity, rtol=1e-12)
    assert not np.any(found.velocity == particles_with({"velocity_rms": RMS}, seed=2).velocity)
    still = particles_with(None)
    np.testing.assert_array_equal(found.position, still.position)
    assert not still.velocity.any()


def test_momentum_is_zero_or_that_of_independent_velocities():
    """The standard deviation of the mean of n independent components is rms / sqrt(3 n)."""
    largest = {}
    for zero in (True, False):
        found = particles_with({"velocity_rms": RMS, "zero_momentum": zero}, velocity=[1.0, 0.0, -2.0])
        mean = found.radius**3 @ (found.velocity - [1.0, 0.0, -2.0]) / np.sum(found.radius**3)
        largest[zero] = np.abs(mean).max()
    assert largest[True] < 1e-14 and 0.0 < largest[False] < 5.0 * RMS / np.sqrt(3.0 * 3000.0)


def test_plan_expects_the_fastest_particle():
    """Of 30 seeds none has a faster particle; the expectation is at most 1.6 times the fastest."""
    thermal = {"thermal": {"velocity_rms": RMS}}
    group = {"count": 300, "diameter": 2e-3, "insert": {"kind": "lattice", "region": BOX}} | thermal
    scenes = [scene_with({"gas": group}, seed) for seed in range(30)]
    fastest = max(np.linalg.norm(initial_particles(scene).velocity, axis=1).max() for scene in scenes)
    assert fastest < scenes[0].particles["gas"].initial_speed < 1.6 * fastest


RAIN = {"kind": "rain", "region": BOX, "rate": 100}


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"fixed": True}, "thermal cannot be combined with fixed; remove thermal"),
        ({"count": 1}, "thermal cannot have zero momentum: one particle has momentum"),
        ({"insert": RAIN}, "thermal cannot be combined with it: insert.kind is rain"),
    ],
)
def test_random_velocities_of_other_particles_are_refused(change, words):
    with pytest.raises(SceneError, match=words):
        particles_with({"velocity_rms": RMS}, **change)
