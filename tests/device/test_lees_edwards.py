"""Uniform shear: images across the border move along it, and nobody can tell where the border is."""

import hashlib

import numpy as np
import pytest
from scene_builders import build_scene, neighbors_of, particle_group, prepared_simulation, run_to_end
from sheared_scenes import RATE, SIZE, sheared_gas
from subprocess_runner import in_subprocess

from granflow.device import stepper
from granflow.scene.periodic_box import PeriodicBox

SPEED = RATE * SIZE
"""Velocity of the image above over what it is one of [m/s]."""


def collision(across):
    """Two rough spheres that meet in flight; `across`: the upper one is the image of one at the bottom of the box."""
    height = 0.0372 if across else 0.0172
    positions = np.array([[0.02, height, 0.02], [0.0225, height + 0.012, 0.021]])
    velocity = np.array([[0.3, 0.5, 0.1], [0.1, -0.6, 0.0]])
    domain = {"min": [0.0] * 3, "max": [SIZE] * 3, "periodic": ["x", "y", "z"], "on_exit": "error"}
    if across:
        domain |= {"lees_edwards": {"flow": "x", "gradient": "y", "rate": RATE}}
        positions[1, 1] -= SIZE
        velocity[1, 0] -= SPEED
    group = particle_group(positions, 0.01, velocity=velocity, angular_velocity=[[10.0, 20.0, 30.0], [-5.0, 3.0, 8.0]])
    return build_scene(
        {"balls": group},
        pair={"friction": 0.4, "restitution": 0.6},
        domain=domain,
        numerics={"skin": 0.001},
        run={"duration": 0.008, "velocity_max": 2.0, "time_step": 2e-6},
        output={"interval": 1.0, "energy_budget": True},
    )


def test_a_collision_with_a_moving_image_is_one_without_a_border(taichi_f64):
    """Velocities but for the image's, spins, and where they are then; many searches lie between."""
    (plain, _), (across, simulation) = run_to_end(collision(False)), run_to_end(collision(True))
    assert simulation.engine.timing.rebuild_count > 5
    assert np.abs(plain.particles["angular_velocity"] - [[10.0, 20.0, 30.0], [-5.0, 3.0, 8.0]]).min() > 0.1
    image = across.particles["velocity"] + [[0.0, 0.0, 0.0], [SPEED, 0.0, 0.0]]
    np.testing.assert_allclose(image, plain.particles["velocity"], atol=1e-10)
    np.testing.assert_allclose(across.particles["angular_velocity"], plain.particles["angular_velocity"], atol=1e-7)
    moved = across.particles["position"] - plain.particles["position"]
    np.testing.assert_allclose(moved, [[0.0, 0.02, 0.0], [-SPEED * across.time, -0.02, 0.0]], atol=1e-12)
    assert across.totals["shear_strain"] == pytest.approx(RATE * 0.008, rel=1e-6)
    assert abs(across.totals["energy_error"]) < 1e-4
    assert abs(across.totals["boundary_work"]) > 1e-5


def test_nobody_can_tell_where_the_border_is(taichi_f64):
    """The same gas a good third of the box higher up, in the frame that moves along with it; v(y) stays linear."""
    height = 0.0137
    (low, simulation), (high, _) = run_to_end(sheared_gas()), run_to_end(sheared_gas(height))
    assert simulation.engine.timing.rebuild_count > 20
    assert low.totals["friction_dissipation"] > 1e-5
    periodic_box = PeriodicBox.of(simulation.scene.domain).at(low.time)
    moved = low.particles["position"] + [RATE * height * low.time, height, 0.0]
    there = periodic_box.nearest_images(high.particles["position"], moved)
    np.testing.assert_allclose(there, moved, atol=1e-8)
    turns = np.round((there - high.particles["position"])[:, 1] / SIZE)
    velocity = high.particles["velocity"] + np.outer(turns * SPEED - RATE * height, [1.0, 0.0, 0.0])
    np.testing.assert_allclose(velocity, low.particles["velocity"], atol=1e-6)
    np.testing.assert_allclose(high.particles["angular_velocity"], low.particles["angular_velocity"], atol=1e-3)
    for totals in (low.totals, high.totals):
        assert abs(totals["energy_error"]) < 1e-3
    slope = np.polyfit(low.particles["position"][:, 1], low.particles["velocity"][:, 0], 1)[0]
    assert slope == pytest.approx(RATE, rel=0.15)


@pytest.mark.parametrize(("sizes", "classes"), [((0.0076, 0.0076), "none"), ((0.004, 0.016), "2")])
def test_rows_hold_the_near_pairs_of_moving_images(taichi_f64, sizes, classes):
    """Against a search over all pairs, when images have moved; across the border the skin is double."""
    skin = 0.0005
    simulation = prepared_simulation(sheared_gas(sizes=sizes), step=2656)
    assert simulation.plan.features.size_classes == classes
    there = simulation.engine.host_copy.copy_to_host(("id", "position", "radius"))
    order = np.argsort(there["id"])
    position, radius = there["position"][order], there["radius"][order]
    periodic_box = PeriodicBox.of(simulation.scene.domain).at(simulation.engine.time)
    assert abs(periodic_box.offset) > 0.005
    first, second = np.triu_indices(len(radius), 1)
    separation = position[first] - periodic_box.nearest_images(position[second], position[first])
    turn = np.abs(np.round((position[first] - position[second])[:, 1] / SIZE))
    near = np.linalg.norm(separation, axis=1) < radius[first] + radius[second] + skin * (1.0 + turn)
    rows = neighbors_of(simulation.engine)
    within = [tuple(sorted(row[:2])) for row in rows if row[2]]
    across = [row[:2] for row in rows if not row[2]]
    assert len(within) == len(set(within))
    assert len(across) == len(set(across))
    assert {(j, i) for i, j in across} == set(across)
    assert set(within) | {tuple(sorted(pair)) for pair in across} == set(zip(first[near], second[near], strict=True))
    assert np.any(turn[near] > 0)
    simulation.free()


def fingerprint(threads, precision):
    """Digest of what a run leaves behind, and its energy error."""
    if threads > 1:  # a scene this small would be stepped on one thread
        stepper.SINGLE_WORKER_PARTICLES = 0
    scene = sheared_gas(duration=0.004, sizes=(0.002, 0.0065))
    last, _ = run_to_end(scene, threads=threads, precision=precision)
    arrays = (last.particles[name] for name in ("position", "velocity", "angular_velocity", "force", "torque"))
    digest = hashlib.sha256(b"".join(np.ascontiguousarray(each).tobytes() for each in arrays))
    return [digest.hexdigest(), last.totals["boundary_work"], abs(last.totals["energy_error"]) < 5e-3]


@pytest.mark.parametrize("precision", ["f64", "mixed", "f32"])
def test_bits_do_not_depend_on_threads(precision):
    one, two = (in_subprocess(fingerprint, threads, precision) for threads in (1, 2))
    assert one == two
    assert one[2]
