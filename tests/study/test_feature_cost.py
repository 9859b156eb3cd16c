"""What leaving out saves: every variant is what its name says, starts alike, and is smaller where it leaves out."""

from pathlib import Path

import numpy as np
import pytest
from subprocess_runner import in_subprocess

from granflow.cli import main
from granflow.plan import plan_for
from granflow.plan.memory_estimate import estimate_memory
from granflow.scene import load
from granflow.study.feature_cost.variants import variants_of

TEXT = """\
title: Beads on a floor
gravity: [0, 0, -9.81]
materials:
  glass: {young_modulus: 10 MPa, poisson_ratio: 0.23, density: 2500}
  steel: {young_modulus: 10 MPa, poisson_ratio: 0.3, density: 7850}
pairs:
  glass-glass: {restitution: 0.7, friction: 0.4, rolling_friction: 0.02}
  glass-steel: {restitution: 0.7, friction: 0.4, rolling_friction: 0.02}
  steel-steel: {restitution: 0.7, friction: 0.4, rolling_friction: 0.02}
contact: {normal: zhou, tangential: mindlin, rolling: epsd}
walls:
  floor: {shape: plane, point: [0, 0, 0], normal: [0, 0, 1], material: steel}
particles:
  beads: {material: glass, count: 60, diameter: 4 mm,
    insert: {kind: lattice, region: {box: {min: [0, 0, 0], max: [2 cm, 2 cm, 2 cm]}}}}
domain: {min: [-1 cm, -1 cm, -1 cm], max: [3 cm, 3 cm, 3 cm], on_exit: error}
run: {duration: 30 ms, velocity_max: 1 m/s}
output: {interval: 10 ms, energy_budget: true}
"""
IN_CONTACT_NEIGHBORS = ("contact.rolling=none", "contact.normal=hertz", "output.energy_budget=false", "walls={}")
SMOOTH = tuple(
    f"pairs.{pair}={{restitution: 0.7, friction: 0}}" for pair in ("glass-glass", "glass-steel", "steel-steel")
)
MIXED = "particles.more={material: steel, diameter: 4 mm, insert: {kind: positions, positions: [[0, 0, 25 mm]]}}"


def plans(directory, *overrides):
    """Plans of all variants by name."""
    path = directory / "beads.yaml"
    path.write_text(TEXT)
    base = plan_for(load(path, overrides))
    return {variant.name: variant.plan(base, on_gpu=False) for variant in variants_of(base)}


@pytest.mark.parametrize(
    ("name", "saved", "changed"),
    [
        ("without friction", {"rotation": True, "rolling": "epsd"}, {"friction": False}),
        ("without rolling friction", {"rotation": True, "friction": True}, {"rolling": "none"}),
        ("without rotation", {"walls": True}, {"rotation": False, "friction": False, "rolling": "none"}),
        ("without walls", {"friction": True}, {"walls": False}),
        ("without ledger", {"friction": True}, {"energy_budget": False}),
        ("with several materials", {"friction": True}, {"one_material": False}),
        ("with moving walls", {"walls": True}, {"moving_walls": True}),
        ("without any history", {"rotation": True}, {"friction": False, "rolling": "none"}),
        (
            "without all of these",
            {"one_material": True},
            {"friction": False, "rotation": False, "walls": False, "energy_budget": False, "rate_dependent": False},
        ),
    ],
)
def test_a_variant_has_its_feature_the_other_way_and_what_it_names_as_it_was(tmp_path, name, saved, changed):
    found = plans(tmp_path)
    as_it_is, other = found["as it stands"].features, found[name].features
    for feature, value in saved.items():
        assert getattr(other, feature) == getattr(as_it_is, feature) == value, feature
    for feature, value in changed.items():
        assert getattr(other, feature) == value, feature
        if name != "without all of these" or feature != "rate_dependent":
            assert getattr(as_it_is, feature) != value, feature


def test_without_history_a_contact_remembers_nothing(tmp_path):
    found = plans(tmp_path)
    assert set(found["as it stands"].history) == {"normal", "tangential", "rolling"}
    assert set(found["without normal history"].history) == {"tangential", "rolling"}
    assert found["without any history"].history == {}


def test_what_a_scene_has_not_is_added(tmp_path):
    found = plans(tmp_path, *IN_CONTACT_NEIGHBORS, *SMOOTH)
    assert found["with friction"].features.friction and found["with rolling friction"].features.rolling == "epsd"
    assert found["with ledger"].features.energy_budget
    assert "without damping" in found and not {"without walls", "without friction"} & set(found)


def test_several_materials_become_that_of_the_most_particles(tmp_path):
    found = plans(tmp_path, MIXED)
    assert not found["as it stands"].features.one_material
    assert found["with one material"].features.one_material
    assert found["with one material"].materials[0] == "glass"


def test_every_variant_steps_and_looks_for_neighbors_alike(tmp_path):
    found = plans(tmp_path)
    assert len({(plan.time_step, plan.skin, plan.particle_capacity) for plan in found.values()}) == 1


def test_bytes_are_fewer_by_the_fields_that_are_left_out(tmp_path):
    """A vector of 3 float64 is 24 bytes; a slot holds the history of its contact and 4 bytes that say if there is."""
    found = {name: estimate_memory(plan, "f64") for name, plan in plans(tmp_path).items()}
    whole = found["as it stands"]
    spin_and_torque, material, rolling_history = 2 * 24, 4, 24
    assert whole.per_particle - found["without rotation"].per_particle == spin_and_torque
    assert found["with several materials"].per_particle - whole.per_particle == material
    assert whole.per_neighbor - found["without rolling friction"].per_neighbor >= rolling_history
    assert all(memory.total <= whole.total for name, memory in found.items() if name.startswith("without"))


def test_size_of_particles_is_no_feature(tmp_path):
    one = plans(tmp_path)["as it stands"]
    spread = plans(tmp_path, "particles.beads.diameter={distribution: uniform, min: 3 mm, max: 4 mm}")["as it stands"]
    assert spread.features == one.features
    assert estimate_memory(spread, "f64").per_particle == estimate_memory(one, "f64").per_particle


def measured(directory):
    """A short run of the study itself, and where the particles of every variant stand before any step."""
    from granflow.study.feature_cost import cost_rows, measure, write_feature_costs

    path = Path(directory) / "beads.yaml"
    path.write_text(TEXT)
    positions, restore = [], measure.restore

    def restore_and_sample(engine, *others):
        restore(engine, *others)
        copied = engine.host_copy.copy_to_host(("id", "position"))
        positions.append(copied["position"][np.argsort(copied["id"])].tolist())

    measure.restore = restore_and_sample
    scene = load(path)
    found = measure.feature_costs(scene, until=0.02, rounds=2, only=("as it stands", "without walls"))
    write_feature_costs(Path(directory) / "out", found, scene.title)
    written = {each.name: each.read_text() for each in (Path(directory) / "out").iterdir()}
    return {"rows": cost_rows(found), "positions": positions, "written": written}


def test_every_timing_begins_with_the_same_particles_and_gives_one_row(tmp_path):
    found = in_subprocess(measured, str(tmp_path))
    assert [row[0] for row in found["rows"]] == ["as it stands", "without walls"]
    assert found["rows"][0][2] == "1.00 (1.00-1.00)"
    assert len(found["positions"]) == 2 * (1 + 2), "two variants, a round to warm up and two that count"
    fallen = np.array(found["positions"][0])
    assert len(fallen) == 60 and fallen[:, 2].min() < 0.004, "some beads are down after 20 ms"
    for positions in found["positions"]:
        np.testing.assert_array_equal(positions, fallen)
    table = found["written"]["feature_cost.md"]
    for row in found["rows"]:
        assert " | ".join(row) in table
    assert len(found["written"]["feature_cost.csv"].splitlines()) == 1 + len(found["rows"])


def test_until_without_measure_is_refused(tmp_path, capsys):
    path = tmp_path / "beads.yaml"
    path.write_text(TEXT)
    assert main(["explain", str(path), "--until", "1s"]) == 2
    assert "requires --measure" in capsys.readouterr().err
