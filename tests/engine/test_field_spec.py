"""A property of the particles is one entry of `granflow.fields`: everything else derives from the table."""

import meshio
import numpy as np
import pytest
from scene_builders import box, build_scene, moving_lattice

from granflow import fields
from granflow.engine.host import copy_to_host, particle_table
from granflow.io.checkpoint import newest_checkpoint
from granflow.simulation import Simulation

ROOM, HOT = 293.15, 400.0
"""Default of inserted particles, and temperature of particle 0 [K]."""


@pytest.fixture
def with_temperature(monkeypatch):
    """The table with a temperature, a charge (the fourth scalar real) and an integer property."""
    for name, more in {
        "temperature": {"dtype": "real", "default": ROOM},
        "charge": {"dtype": "real"},
        "visits": {"file_type": "int32", "dtype": "i32", "default": 3},
    }.items():
        spec = fields.FieldSpec(name, "", "1", f"{name} of the particle", **more)
        monkeypatch.setitem(fields._PARTICLE_FIELDS, name, spec)


def rain_on_a_lattice():
    """Particles that fall, and are sorted again, while others rain on them."""
    region = {"box": {"min": [0.0, 0.0, 0.03], "max": [0.042, 0.042, 0.042]}}
    rain = {
        "material": "glass", "count": 30, "diameter": 0.005,
        "insert": {"kind": "rain", "region": region, "rate": 4000.0},
    }  # fmt: skip
    output = {"interval": 0.006, "checkpoint": {"interval": 0.003, "keep": 9}}
    return build_scene(
        {"lattice": moving_lattice((6, 6, 3), largest=0.006, speed=0.5), "rain": rain}, walls=box(0.042),
        gravity=[0.0, 0.0, -9.81], numerics={"chunk_size": 16, "skin": 4e-4}, output=output,
        run={"duration": 0.02, "velocity_max": 4.0, "time_step": 4e-6},
    )  # fmt: skip


def test_added_property_is_carried_saved_restored_and_written(taichi_f64, with_temperature, tmp_path):
    """HOT + id for the particles that were heated, the default for those inserted later."""
    scene = rain_on_a_lattice()
    simulation = Simulation(scene, out=tmp_path / "run")
    state = simulation.engine.state
    initial = state.count

    def assert_carried(found):
        expected = np.where(found["id"] < initial, HOT + found["id"], ROOM)
        np.testing.assert_allclose(found["temperature"], expected, rtol=1e-6)

    before = copy_to_host(state, ("id", "temperature", "visits"))
    assert set(before["temperature"]) == {ROOM} and set(before["visits"]) == {3}, "defaults at insertion"
    heated = {"temperature": HOT + before["id"], "charge": before["id"]}
    particle_table(state, ("temperature", "charge")).put(np.arange(initial), heated)
    simulation.run(0.012)
    now = copy_to_host(state, ("id", "temperature", "charge"))
    assert not np.array_equal(before["id"], now["id"][:initial]), "they were sorted"
    assert now["id"].max() >= initial, "particles were inserted during the run"
    np.testing.assert_array_equal(now["charge"], np.where(now["id"] < initial, now["id"], 0))
    frame = meshio.read(sorted((tmp_path / "run").glob("particles_*.vtu"))[-1]).point_data
    checkpoint, _ = newest_checkpoint(tmp_path / "run")
    for found in (now, simulation.snapshot().particles, frame, checkpoint.saved["engine"]["particles"]):
        assert_carried(found)
    simulation.free()
    resumed = Simulation(scene, out=tmp_path / "run", resume=checkpoint)
    restored = resumed.snapshot().particles
    assert_carried(restored)
    assert set(restored["visits"]) == set(frame["visits"]) == {3}
    resumed.free()


def test_the_properties_of_ghosts_are_one_block():
    """They are sent as records of that block: another property in it would be sent as well."""
    of_ghosts = {each.name for each in fields.PARTICLE_QUANTITIES.values() if each.of_ghosts}
    (block,) = {fields.PARTICLE_QUANTITIES[name].block for name in of_ghosts}
    assert of_ghosts == {each.name for each in fields.PARTICLE_QUANTITIES.values() if each.block == block}
