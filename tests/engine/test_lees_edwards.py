"""Lees-Edwards boxes: images move along the shear boundary; its position does not change the result."""

import numpy as np
import pytest
from scene_builders import assert_lists_hold, build_scene, particle_group, prepared_simulation, run_to_end
from sheared_scenes import RATE, SIZE, sheared_gas

IMAGE_VELOCITY = RATE * SIZE
"""Velocity of the image above, relative to its particle [m/s]."""


def collision(across):
    """Two rough particles that collide in flight; if `across`, the upper one is an image of one at the
    bottom."""
    height = 0.0372 if across else 0.0172
    positions = np.array([[0.02, height, 0.02], [0.0225, height + 0.012, 0.021]])
    velocity = np.array([[0.3, 0.5, 0.1], [0.1, -0.6, 0.0]])
    shear = {"flow": "x", "gradient": "y", "rate": RATE}
    domain = {
        "min": [0.0] * 3, "max": [SIZE] * 3, "periodic": ["x", "y", "z"], "on_exit": "error", "lees_edwards": shear
    }  # fmt: skip
    if across:
        positions[1, 1] -= SIZE
        velocity[1, 0] -= IMAGE_VELOCITY
    group = particle_group(
        positions, 0.01, velocity=velocity, angular_velocity=[[10.0, 20.0, 30.0], [-5.0, 3.0, 8.0]]
    )
    return build_scene(
        {"balls": group},
        pair={"friction": 0.4, "restitution": 0.6},
        domain=domain,
        numerics={"chunk_size": 16, "skin": 0.001},
        run={"duration": 0.008, "velocity_max": 2.0, "time_step": 2e-6},
        output={"interval": 1.0, "energy_budget": True},
    )


def test_collision_with_a_moving_image_equals_one_inside_the_box(taichi_f64):
    """Velocities relative to the image, angular velocities and final positions agree, after several
    rebuilds."""
    (plain, _), (across, simulation) = run_to_end(collision(False)), run_to_end(collision(True))
    assert simulation.engine.timing.rebuild_count > 5
    assert np.abs(plain.particles["angular_velocity"] - [[10.0, 20.0, 30.0], [-5.0, 3.0, 8.0]]).min() > 0.1
    image = across.particles["velocity"] + [[0.0, 0.0, 0.0], [IMAGE_VELOCITY, 0.0, 0.0]]
    np.testing.assert_allclose(image, plain.particles["velocity"], atol=1e-10)
    np.testing.assert_allclose(
        across.particles["angular_velocity"], plain.particles["angular_velocity"], atol=1e-7
    )
    expected = across.particles["position"] - plain.particles["position"]
    np.testing.assert_allclose(
        expected, [[0.0, 0.02, 0.0], [-IMAGE_VELOCITY * across.time, -0.02, 0.0]], atol=1e-12
    )
    assert across.totals["shear_strain"] == pytest.approx(RATE * 0.008, rel=1e-6)
    assert abs(across.totals["energy_error"]) < 1e-4
    assert abs(across.totals["boundary_work"]) > 1e-5


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
    slope = np.polyfit(low.particles["position"][:, 1], low.particles["velocity"][:, 0], 1)[0]
    assert slope == pytest.approx(RATE, rel=0.15)


@pytest.mark.parametrize(("sizes", "classes"), [((0.0076, 0.0076), "none"), ((0.004, 0.016), "2")])
def test_neighbor_list_holds_the_candidate_pairs_of_moving_images(taichi_f64, sizes, classes):
    """Compared with a search over all pairs after the images have moved; the skin doubles across the shear
    boundary."""
    skin = 0.0005
    simulation = prepared_simulation(sheared_gas(sizes=sizes), step=2656)
    assert simulation.plan.features.size_classes == classes
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
