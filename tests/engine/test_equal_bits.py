"""Outputs, snapshots, stage boundaries, friction coefficients of 0 and the form in which radius and mass are stored
do not change the motion."""

import numpy as np
import pytest
from scene_builders import (
    DASHPOTS,
    SPRINGS,
    build_scene,
    moving_lattice,
    particle_group,
    plane,
    run_to_end,
    vibrating_box,
)

from granflow.plan import features
from granflow.plan.build import plan_for
from granflow.simulation import Simulation


def assert_equal(first, second):
    """All arrays and numbers of two snapshots are the same."""
    for part in ("particles", "contacts", "impulses"):
        assert getattr(first, part).keys() == getattr(second, part).keys()
        for name, values in getattr(first, part).items():
            np.testing.assert_array_equal(values, getattr(second, part)[name], err_msg=f"{part}.{name}")
    assert first.totals == second.totals


FAR = {"far": plane([0, 0, -0.5], [0, 0, 1], "steel")}
"""A wall out of reach; with it, scenes without output and those with friction have the same kernels."""


def gas(lattice, friction=0.4, far=None, **parts):
    """A lattice in a box with a vibrating floor, friction and gravity; `far`: walls that it does not reach."""
    run = {"duration": 4e-3, "velocity_max": 4.0, "time_step": 4e-6}
    return build_scene(
        {"gas": lattice}, walls=vibrating_box(0.042) | (far or {}), pair={"friction": friction, "restitution": 0.7},
        run=run, gravity=[0.0, 0.0, -9.81], numerics={"chunk_size": 16}, **parts,
    )  # fmt: skip


ALL = {
    "interval": 1e-3, "energy_budget": True, "wall_forces": True,
    "collision_energies": {"min": 1e-9, "max": 1e-2, "classes": 14},
}  # fmt: skip


def end_in_parts(scene, snapshots):
    """The end of a run in four parts, with a number of additional snapshots after each of them."""
    with Simulation(scene) as simulation:
        for _ in range(4):
            simulation.run(simulation.time + 1e-3)
            for _ in range(snapshots):
                simulation.snapshot(contacts=True)
        return simulation.snapshot(contacts=True)


def test_outputs_and_snapshots_do_not_change_the_motion(taichi_f64):
    """Energy budget, wall forces and collision energies are extras, without which their arrays do not exist."""
    lattice = moving_lattice((6, 6, 3), largest=0.006, speed=0.5)
    plain, full = gas(lattice, far=FAR, output={"interval": 1.0}), gas(lattice, output=ALL)
    end = end_in_parts(full, 0)
    assert_equal(end, end_in_parts(full, 2))
    assert end.collisions["particle"].sum() > 10 and abs(end.totals["energy_error"]) < 1e-3
    without = end_in_parts(plain, 2)
    assert without.impulses == without.collisions == {} and "energy_error" not in without.totals
    for name, values in without.particles.items():
        np.testing.assert_array_equal(values, end.particles[name], err_msg=name)


def test_friction_coefficient_0_is_bit_identical_to_disabled_friction(taichi_f64):
    """A rough wall out of reach enables friction; all pairs in contact have the coefficient 0."""
    lattice = moving_lattice((6, 6, 3), largest=0.006, speed=0.5)
    rough = {"glass-steel": {"restitution": 0.8, "friction": 0.5}}
    scenes = gas(lattice, 0.0, FAR), gas(lattice, 0.0, FAR, pairs=rough)
    assert [plan_for(scene).laws.names["tangential"] for scene in scenes] == ["none", "mindlin"]
    without, idle = (run_to_end(scene)[0].particles for scene in scenes)
    for name in ("position", "velocity", "force"):
        np.testing.assert_array_equal(idle[name], without[name])
    assert not idle["angular_velocity"].any()


def test_radius_and_mass_of_equal_spheres_as_two_numbers_give_the_bits_of_arrays(taichi_f64, monkeypatch):
    scene = gas(moving_lattice((6, 6, 3), 0.004, 0.5) | {"diameter": 0.006}, output=ALL)
    assert plan_for(scene).features.one_size
    with_numbers = end_in_parts(scene, 0)
    monkeypatch.setattr(features, "_one_size", lambda *_: (False, "switched off"))
    assert not plan_for(scene).features.one_size
    assert with_numbers.totals["friction_dissipation"] > 0.0
    assert_equal(with_numbers, end_in_parts(scene, 0))


def test_unequal_or_fixed_particles_have_arrays_of_radius_and_mass():
    def setting(pair=None, **single):
        one = particle_group([[0.04, 0.0, 0.0]]) | single
        pair = particle_group([[0.0, 0.0, 0.0], [0.02, 0.0, 0.0]]) | (pair or {})
        return plan_for(build_scene({"pair": pair, "single": one})).features.one_size

    assert setting()
    assert not setting(material="steel") and not setting(diameter=[0.011]) and not setting(fixed=True)
    assert not setting({"diameter": [0.01, 0.0100001]})


@pytest.mark.parametrize("models", [DASHPOTS, SPRINGS], ids=["dashpots", "springs"])
def test_stage_boundaries_do_not_change_the_motion(taichi_f64, models):
    """Forces are evaluated again there. Two rotating particles, one on the other, overlap from the start."""
    stack = particle_group(
        [[0.0, 0.0, 0.00495], [0.0005, 0.0, 0.0148]],
        velocity=[0.05, 0.0, -0.02],
        angular_velocity=[1.0, 5.0, 3.0],
    )
    run = {"velocity_max": 1.0, "time_step": 2e-6}
    stages = [{"name": name, "duration": 6e-4} for name in ("first", "second", "third", "fourth")]
    floor = {"floor": plane([0.0] * 3, [0.0, 0.0, 1.0])}
    given = {"gravity": [0.0, 0.0, -9.81], **models}
    whole, _ = run_to_end(build_scene({"stack": stack}, floor, run=run | {"duration": 2.4e-3}, **given))
    parts, _ = run_to_end(build_scene({"stack": stack}, floor, run=run, stages=stages, **given))
    for name in ("position", "velocity", "angular_velocity"):
        scale = np.abs(whole.particles[name]).max()
        np.testing.assert_allclose(parts.particles[name], whole.particles[name], rtol=0.0, atol=1e-9 * scale)
