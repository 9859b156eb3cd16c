"""Given and simulated restitution: `granflow restitution`, warnings of `granflow run`, and `granflow collide`."""

import re

import numpy as np
import pytest
from scene_builders import build_scene, particle_group, plane

from granflow.cli.main import main
from granflow.errors import GranflowError
from granflow.plan.build import plan_for
from granflow.plan.restitution import (
    impact_of,
    name_of,
    pairings,
    reference_restitution,
    restitution_warnings,
)
from granflow.simulation import Simulation
from granflow.studies.collide import collide
from granflow.studies.restitution import measure

STEEL = {"preset": "stainless_316"}
FIT = {"sigma": 3.0432, "psi": 0.54, "limit_velocity": 340.3}


def two_materials():
    """Steel particles of two sizes, glass particles, and a steel floor."""
    groups = {
        "fine": particle_group([[0.0, 0.0, 0.1], [0.0, 0.0, 0.2]], 0.004, "steel"),
        "coarse": particle_group([[0.1, 0.0, 0.2]], 0.01, "steel"),
        "beads": particle_group([[0.2, 0.0, 0.2]], 0.006, "glass"),
        "rough": particle_group([[0.3, 0.0, 0.2]], 0.001, "steel") | {"fixed": True},
    }
    return build_scene(
        groups, walls={"floor": plane([0, 0, 0], [0, 0, 1], "steel")},
        materials={"steel": STEEL, "glass": {"preset": "glass"}},
        pairs={"steel-steel": {"restitution": FIT, "friction": 0.3}, "steel-glass": {"restitution": 0.6, "friction": 0.3}},
        run={"duration": 1.0, "velocity_max": 5.0}, numerics={"time_step_fraction": 0.01, "rayleigh_fraction": 1.0},
    )  # fmt: skip


def coarse_hertz(fraction=0.3):
    """A damped Hertz contact resolved by few steps: the rebound velocity is too small."""
    groups = {"beads": particle_group([[0.0, 0.0, 0.1]], 0.01, "steel")}
    return build_scene(
        groups, walls={"floor": plane([0, 0, 0], [0, 0, 1], "steel")}, materials={"steel": STEEL}, normal="hertz",
        pair={"restitution": 0.8}, run={"duration": 1.0, "velocity_max": 2.0},
        numerics={"time_step_fraction": fraction, "rayleigh_fraction": 1.0},
    )  # fmt: skip


def test_small_time_steps_reach_the_given_restitution(taichi_f64):
    """Eq. 12 from sigma and psi, or the constant of a pair; within 0.1 % over three decades of velocity. Each
    possible pair of materials collides with its smallest radii of mobile particles."""
    scene = two_materials()
    found = {(name_of(each), each.radius, each.other_radius) for each in pairings(plan_for(scene))}
    assert found == {
        ("steel-steel", 0.002, 0.002), ("steel-glass", 0.002, 0.003), ("glass-glass", 0.003, 0.003),
        ("steel-steel wall", 0.002, None), ("glass-steel wall", 0.003, None)
    }  # fmt: skip
    rows, _ = measure(scene)
    velocity = np.array([row.velocity for row in rows])
    fit = np.exp(-FIT["sigma"] * (velocity / (FIT["limit_velocity"] - velocity)) ** FIT["psi"])
    numbers = [0.6 if "glass-steel" in row.pair or "steel-glass" in row.pair else 0.8 for row in rows]
    requested = np.where(["steel-steel" in row.pair for row in rows], fit, numbers)
    np.testing.assert_allclose([row.requested for row in rows], requested, rtol=1e-14)
    np.testing.assert_allclose([row.reached for row in rows], requested, rtol=1e-3)
    assert (velocity.min(), velocity.max()) == pytest.approx((0.005, 5.0), rel=1e-12)
    assert len({row.pair for row in rows}) == 5


def test_warning_states_pair_velocity_restitution_and_a_sufficient_time_step(tmp_path, taichi_f64):
    scene = coarse_hertz()
    (sentence,) = restitution_warnings(plan_for(scene))  # one particle: no collision between particles
    numbers = re.search(
        r"steel-steel wall: the given restitution is (\S+) at (\S+) m/s, but the time step of (\S+) s results in (\S+), "
        r"which changes the energy lost in a collision by (\S+)%\. Use numerics\.time_step_fraction: (\S+)\.$",
        sentence,
    )
    requested, velocity, step, reached, error, remedy = map(float, numbers.groups())
    assert (requested, velocity) == (0.8, 2.0)
    assert error == pytest.approx(100.0 * (0.64 - reached**2) / 0.36, abs=0.51)
    assert step == pytest.approx(plan_for(scene).time_step, rel=5e-3)
    rows, _ = measure(scene)
    fastest = next(row for row in rows if row.pair == "steel-steel wall" and row.velocity == 2.0)
    assert fastest.min_reached * 0.99 <= reached <= fastest.max_reached * 1.01
    assert restitution_warnings(plan_for(coarse_hertz(fraction=remedy))) == []
    simulation = Simulation(scene, out=tmp_path / "out")
    assert simulation.warnings[-1] == sentence
    simulation.free()


def test_command_prints_a_table_and_writes_csv(tmp_path, taichi_f64, capsys):
    path = tmp_path / "coarse.yaml"
    path.write_text(coarse_hertz().to_yaml(), encoding="utf-8")
    assert main(["restitution", str(path), "--out", str(tmp_path)]) == 0
    lines = (tmp_path / "restitution.csv").read_text(encoding="utf-8").splitlines()
    assert lines[0] == "pair,velocity,requested,min_reached,max_reached,difference"
    assert len(lines) - 1 == capsys.readouterr().out.count("0.80000") == 2 * 13


@pytest.mark.parametrize(("law", "restitution", "fraction", "largest"), [
    ("zhou", 0.5, 0.05, 0.25), ("hertz", 0.8, 0.2, 1.7), ({"law": "linear", "stiffness": "onset"}, 0.8, 0.05, 0.25)
])  # fmt: skip
def test_restitution_error_of_a_time_step_fraction_is_as_documented(law, restitution, fraction, largest):
    """accuracy.md: largest deviation [%] of a collision over the phases of first contact."""
    scene = build_scene(
        {"beads": particle_group([[0, 0, 0.1], [0, 0, 0.2]])}, normal=law, pair={"restitution": restitution},
        run={"duration": 1.0, "velocity_max": 1.0}, numerics={"time_step_fraction": fraction, "rayleigh_fraction": 1.0},
    )  # fmt: skip
    plan = plan_for(scene)
    impact = impact_of(plan, next(iter(pairings(plan))), 1.0)
    reached = [reference_restitution(plan, impact, plan.time_step, phase) for phase in np.arange(16) / 16]
    assert 100.0 * np.abs(np.array(reached) / restitution - 1.0).max() < largest


BALLS = {"material": "stainless_316", "diameter": 0.0254, "velocity": 0.5}


def test_dashpot_of_a_collision_that_begins_with_touching_surfaces_acts_from_the_first_contact(taichi_f64):
    """Within 1 % with the default time step, 24 steps; without the first half step 5 % too high."""
    assert collide("hertz", restitution=0.05, **BALLS)["restitution"] == pytest.approx(0.05, rel=0.01)


@pytest.mark.parametrize(("law", "given", "sentence"), [
    ("torton", {}, "Unknown contact model torton. Did you mean thornton?"),
    ("thornton", {"restitution": 0.5}, "derives the restitution from the materials"),
    ("thornton", {"material": "glass"}, "requires a yield strength, which glass lacks"),
    ("hertz", {}, "requires a restitution coefficient"),
    ("zhou", {"velocity": 1e30}, "the overlap would reach .* m, more than the radius"),
    ("thornton", {"settings": ["yeld_ratio=1"]}, "is not a known key. Did you mean yield_ratio?")
])  # fmt: skip
def test_unsupported_input_of_a_contact_model_is_rejected(taichi_f64, law, given, sentence):
    with pytest.raises(GranflowError, match=sentence):
        collide(law, **(BALLS | given))
