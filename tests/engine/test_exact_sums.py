"""Bits do not depend on the neighbor lists: not on skin, rebuild times, chunk size, batches or number of
threads."""

import hashlib

import numpy as np
import pytest
from scene_builders import build_scene, particle_group, plane, run_to_end, vibrating_box
from sheared_scenes import sheared_gas
from subprocess_runner import each_in_subprocess

from granflow.engine import threads as workers
from granflow.engine.sums import CARRY_BITS, build_to_grid, exact_sum, exact_totals
from granflow.errors import RunError
from granflow.kernel_language import ti
from granflow.observers.observer import on_interval
from granflow.plan import sum_units
from granflow.plan.build import plan_for
from granflow.simulation import Simulation

ARRAYS = ("id", "position", "velocity", "angular_velocity", "force", "torque", "coordination_number")


def particles(seed=4):
    """128 particles of different sizes on a lattice, with random velocities."""
    rng = np.random.default_rng(seed)
    positions = 0.0065 * (np.argwhere(np.ones((8, 8, 2))) + 0.75)
    velocity = rng.normal(0.0, 0.3, positions.shape)
    return particle_group(positions, rng.uniform(0.004, 0.006, len(positions)), velocity=velocity)


def walled(numerics):
    """Particles fall into a vibrating box below a servo wall; insertion, rolling friction, wall forces,
    budget."""
    walls = vibrating_box(0.06)
    walls["lid"] = plane(
        [0.0, 0.0, 0.03],
        [0, 0, -1],
        motion={"kind": "servo", "direction": [0, 0, -1], "force": 0.5, "velocity_max": 0.2},
    )
    return build_scene(
        {"lattice": particles()}, walls=walls, rolling="epsd", gravity=[0.0, 0.0, -9.81], normal="hertz",
        pair={"friction": 0.4, "rolling_friction": 0.1, "restitution": 0.3}, numerics=numerics,
        run={"duration": 0.01, "velocity_max": 2.0, "time_step": 2e-6},
        output={"interval": 1.0, "wall_forces": True, "energy_budget": True},
    )  # fmt: skip


def periodic(numerics):
    """Particles that fall through the faces of a periodic box."""
    return build_scene(
        {"lattice": particles()}, gravity=[3.0, 0.0, -9.81], pair={"friction": 0.4, "restitution": 0.5},
        numerics=numerics, run={"duration": 0.01, "velocity_max": 2.0, "time_step": 2e-6},
        domain={"min": [0.0] * 3, "max": [0.055, 0.055, 0.02], "periodic": ["x", "y", "z"], "on_exit": "error"},
        output={"interval": 1.0, "energy_budget": True},
    )  # fmt: skip


def sheared(numerics):
    """A sheared box; particles cross its faces between the rebuilds."""
    scene = sheared_gas(duration=0.005)
    return scene.model_copy(update={"numerics": scene.numerics.model_copy(update=numerics)})


def fingerprint(name, chunk_size, skin, threads, rebuild_steps, precision):
    """Digest of particles and wall forces and the totals at the end, and number of rebuilds."""
    workers.SINGLE_WORKER_PARTICLES = 0
    scene = globals()[name]({"chunk_size": chunk_size, "skin": skin})

    def request_rebuild(snapshot):
        if rebuild_steps:
            simulation.engine.state.control.rebuild_requested[0] = 1

    interval = (rebuild_steps or 100) * 2e-6
    simulation = Simulation(
        scene,
        observers=[on_interval(interval, request_rebuild, ("walls",))],
        threads=threads,
        precision=precision,
    )
    simulation.run()
    last = simulation.snapshot()
    arrays = [np.ascontiguousarray(last.particles[each]) for each in ARRAYS] + list(last.impulses.values())
    digest = hashlib.sha256(b"".join(each.tobytes() for each in arrays)).hexdigest()
    return [digest, dict(last.totals)], simulation.engine.timing.rebuild_count


@pytest.mark.parametrize(
    ("name", "precision"),
    [
        pytest.param("walled", "f64", marks=pytest.mark.slow),
        pytest.param("periodic", "f64", marks=pytest.mark.slow),
        pytest.param("sheared", "f64", marks=pytest.mark.slow),
        pytest.param("walled", "mixed", marks=pytest.mark.slow),
        pytest.param("walled", "f32", marks=pytest.mark.slow),
    ],
)
def test_neighbor_lists_do_not_change_the_bits(name, precision):
    settings = [(64, 0.0004, 1, 0), (37, 0.002, 2, 0), (1, 0.0013, 1, 30)]
    found = each_in_subprocess(fingerprint, [(name, *each, precision) for each in settings], seconds=600)
    (batched, many), (others, few), (one_by_one, forced) = found
    assert batched[1]["contact_count"] > 0.0 and batched[1]["friction_dissipation"] > 0.0
    assert many > 1.5 * few and forced > few
    assert others == batched
    assert one_by_one == batched


@pytest.mark.parametrize(("name", "bits"), [("f32", 45), ("f64", 50)])
def test_rounding_to_the_grid_is_odd_and_exact_in_half_units(taichi_f64, name, bits):
    """Numbers up to 2^bits units: of the two precisions, the one with the larger eps needs all branches."""
    numpy_type = getattr(np, name.replace("f", "float"))
    real = getattr(ti, name)
    unit = 2.0**-40
    to_grid = build_to_grid(real)
    external = ti.types.ndarray()
    shift = 1.5 * unit / np.finfo(numpy_type).eps

    @ti.kernel
    def round_all(values: external, rounded: external, by: real):
        for k in values:
            rounded[k] = to_grid(values[k], by)

    rng = np.random.default_rng(3)
    positive = (unit * rng.uniform(1.0, 2.0, 20_000) * 2.0 ** rng.uniform(-5.0, bits - 1.0, 20_000)).astype(
        numpy_type
    )
    values = np.concatenate([positive, -positive])
    rounded = np.zeros_like(values)
    round_all(values, rounded, shift)
    up, down = np.split(rounded.astype(float) / unit, 2)
    np.testing.assert_array_equal(down, -up)
    np.testing.assert_array_equal(2.0 * up, np.rint(2.0 * up))
    assert np.abs(up - positive.astype(float) / unit).max() <= 0.5


def test_force_above_the_range_of_the_sums_aborts_the_run(taichi_f64, monkeypatch):
    monkeypatch.setattr(sum_units, "FORCE_BITS", 70)  # sums are exact up to 2^(50 - 70) of the largest force
    positions = [[0.0, 0.0, 0.0], [0.0101, 0.0, 0.0]]
    velocity = [[1.0, 0.0, 0.0], [0.0, 0.0, 0.0]]
    scene = build_scene({"pair": particle_group(positions, velocity=velocity)}, run={"duration": 0.001})
    with pytest.raises(RunError, match=r"the contact force on particle 0 \(glass, .* is above .* N"):
        run_to_end(scene)


def test_sums_on_the_host_do_not_depend_on_the_order():
    rng = np.random.default_rng(1)
    values = rng.normal(size=1000) * 10.0 ** rng.integers(-6, 3, 1000)
    total = exact_sum(values)
    assert total == pytest.approx(values.sum(), rel=1e-13)
    assert all(exact_sum(rng.permutation(values)) == total for _ in range(20))
    assert exact_sum(np.zeros(0)) == 0.0


def test_two_word_sums_give_the_exact_total():
    low, high = np.array([[3, -5], [2**41, 7]]), np.array([[2**30, 0], [1, -(2**20)]])
    totals = exact_totals(np.concatenate([low, high], axis=1), 0.25)
    expected = [3 + 2**41 + (2**30 + 1) * 2**CARRY_BITS, 2 - 2**20 * 2**CARRY_BITS]
    assert totals.tolist() == [float(each) * 0.25 for each in expected]


def test_weight_of_a_large_sphere_among_small_ones_does_not_abort(taichi_f64):
    """A sphere of 10 cm weighs 13 N; the largest force of a contact with one of 0.1 mm is below 10 mN."""
    groups = {
        "large": particle_group([[0.0, 0.0, 0.0]], 0.1),
        "small": particle_group([[0.0, 0.0, 0.2], [0.0, 0.0, 0.3]], 1e-4),
    }
    scene = build_scene(groups, gravity=[0.0, 0.0, -9.81], run={"duration": 2e-6, "velocity_max": 0.2})
    assert plan_for(scene).sum_units.largest_force > 30.0 * 13.0
    last, _ = run_to_end(scene)
    np.testing.assert_allclose(last.particles["velocity"][:, 2], -9.81 * last.time, rtol=1e-12)
