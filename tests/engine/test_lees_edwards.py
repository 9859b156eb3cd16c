"""Lees-Edwards boxes: images move along the shear boundary; its position does not change the result."""

import numpy as np
import pytest
from scene_builders import assert_lists_hold, prepared_simulation, run_to_end
from sheared_scenes import RATE, SIZE, sheared_gas

IMAGE_VELOCITY = RATE * SIZE
"""Velocity of the image above, relative to its particle [m/s]."""


def test_result_does_not_depend_on_the_position_of_the_boundary(taichi_f64):
    """Compares a gas with the same gas 13.7 mm higher in a box of 40 mm, in the comoving frame; v(y) stays
    linear."""
    height = 0.0137
    (low, simulation), (high, _) = run_to_end(sheared_gas()), run_to_end(sheared_gas(height))
    assert simulation.engine.timing.rebuild_count > 20
    assert low.totals["friction_dissipation"] > 1e-5
    periodic_box = simulation.plan.periodic_box.at(low.time)
    expected = low.particles["position"] + [RATE * height * low.time, height, 0.0]
    images = periodic_box.nearest_images(high.particles["position"], expected)
    np.testing.assert_allclose(images, expected, atol=1e-8)
    crossings = np.round((images - high.particles["position"])[:, 1] / SIZE)
    velocity = high.particles["velocity"] + np.outer(
        crossings * IMAGE_VELOCITY - RATE * height, [1.0, 0.0, 0.0]
    )
    np.testing.assert_allclose(velocity, low.particles["velocity"], atol=1e-6)
    np.testing.assert_allclose(
        high.particles["angular_velocity"], low.particles["angular_velocity"], atol=1e-3
    )
    for totals in (low.totals, high.totals):
        assert abs(totals["energy_error"]) < 1e-3
    assert low.totals["shear_strain"] == pytest.approx(RATE * low.time, rel=1e-6)
    slope = np.polyfit(low.particles["position"][:, 1], low.particles["velocity"][:, 0], 1)[0]
    assert slope == pytest.approx(RATE, rel=0.15)


def test_neighbor_list_holds_the_candidate_pairs_of_moving_images(taichi_f64):
    """Compared with a search over all pairs after the images have moved; the skin doubles across the shear
    boundary."""
    skin = 0.0005
    simulation = prepared_simulation(sheared_gas(sizes=(0.004, 0.016)), step=2656)
    assert simulation.plan.features.size_classes == "2"
    particles = simulation.snapshot().particles
    position, radius = particles["position"], particles["radius"]
    periodic_box = simulation.plan.periodic_box.at(simulation.time)
    assert abs(periodic_box.offset) > 0.005
    first, second = np.triu_indices(len(radius), 1)
    separation = position[first] - periodic_box.nearest_images(position[second], position[first])
    crossed = np.abs(np.round((position[first] - position[second])[:, 1] / SIZE))
    candidates = np.linalg.norm(separation, axis=1) < radius[first] + radius[second] + skin * (1.0 + crossed)
    assert_lists_hold(simulation, zip(first[candidates], second[candidates], strict=True))
    assert np.any(crossed[candidates] > 0)
    simulation.free()
