"""Outlets delete and count the particles inserted by inlets; a resumed run keeps the counts."""

from math import pi

import numpy as np
import pytest
from resume.runs import files_of, states_of
from scene_builders import SOFT, build_scene, particle_group

from granflow.io.checkpoint import read_checkpoint
from granflow.scene.blocks.outlets import outlet_of
from granflow.simulation import Simulation

MASSES = {diameter: pi / 6.0 * diameter**3 * SOFT["density"] for diameter in (0.004, 0.005)}


def chute(**parts):
    """Two size classes are inserted downward, fall past fixed particles, and reach a box or a half-space
    outlet."""
    classes = [{"diameter": diameter, "fraction": 1} for diameter in MASSES]
    face = {"disc": {"center": [0, 0, 0.05], "normal": [0, 0, -1], "radius": 0.015}}
    inflow = {
        "material": "glass", "velocity": [0, 0, -1.5], "mass": 0.02,
        "diameter": {"distribution": "classes", "by": "number", "classes": classes},
        "insert": {"kind": "inlet", "face": face, "mass_flow": 1.0, "start": 0.001},
    }  # fmt: skip
    row = particle_group([[0.012 * k - 0.012, 0, 0] for k in range(3)] + [[0.5, 0, 0]], 0.006) | {
        "fixed": True
    }
    defaults = {
        "outlets": {
            "side": {"box": {"min": [0.0, -1.0, -0.05], "max": [1.0, 1.0, 0.001]}},
            "below": {"half_space": {"point": [0, 0, -0.02], "normal": [0, 0, -3]}},
            "nowhere": {"disc": {"center": [0, 0, 0.1], "normal": [0, 0, 1], "radius": 0.01}},
        },
        "gravity": [0.0, 0.0, -9.81], "pair": {"friction": 0.3, "restitution": 0.7},
        "run": {"duration": 0.25, "velocity_max": 3.0, "time_step": 1e-5}, "numerics": {"chunk_size": 32},
        "output": {"interval": 0.05, "energy_budget": True, "checkpoint": {"interval": 0.009, "keep": 100}},
    }  # fmt: skip
    return build_scene({"inflow": inflow, "row": row}, **(defaults | parts))


def test_outlets_delete_and_count_all_inserted_particles_also_after_restart(tmp_path, taichi_f64):
    whole = tmp_path / "whole"
    resumed = tmp_path / "again"
    simulation = Simulation(chute(), out=whole)
    result = simulation.run()
    last = simulation.snapshot()
    simulation.free()
    count = round(0.02 / np.mean(list(MASSES.values())))
    assert (
        result.numbers["inserted_count.inflow"] == count
        and result.numbers["not_inserted_count.inflow"] == 0.0
    )
    counts = {name: result.numbers[f"outlet_count.{name}"] for name in ("side", "below", "nowhere")}
    assert sum(counts.values()) == count == result.totals["deleted_count"] and counts["nowhere"] == 0.0
    assert counts["side"] > 20 and counts["below"] > 20
    masses = [result.numbers[f"outlet_mass.{name}"] for name in counts]
    assert (
        sum(masses)
        == pytest.approx(result.numbers["inserted_mass.inflow"])
        == pytest.approx(0.02, abs=MASSES[0.005])
    )
    assert last.particles["fixed"].tolist() == [1] * 4, (
        "outlets keep fixed particles, and no particle left the domain"
    )
    assert abs(result.totals["energy_error"]) < 1e-3
    head = (whole / "timeseries.csv").read_text().splitlines()[0]
    assert "queued_count,deleted_count" in head and "outlet_count.side,outlet_mass.side [kg]" in head
    saved = sorted(whole.glob("checkpoint_*.npz"))
    during_insertion = read_checkpoint(saved[1])
    assert 0 < during_insertion.saved["insertion"]["inflow"]["due_count"] < count
    resumed.mkdir()
    for path in [*whole.glob("*.vtu"), *whole.glob("*.pvd"), whole / "timeseries.csv", saved[1]]:
        (resumed / path.name).write_bytes(path.read_bytes())
    simulation = Simulation(chute(), out=resumed, resume=read_checkpoint(resumed / saved[1].name))
    simulation.run()
    simulation.free()
    assert files_of(resumed) == files_of(whole)
    assert states_of(resumed).items() <= states_of(whole).items() and len(states_of(resumed)) > 4


def test_deepest_outlet_takes_a_particle_despite_rounding():
    """Positions 20 mm beyond the plane, 4 mm inside the box, 1e-12 m outside the box, and far from both."""
    outlets = chute().outlets
    names = list(outlets)
    position = np.array([[0.5, 0, -0.04], [0.5, 0, -0.003], [0.5, 0, 0.001 + 1e-12], [0.5, 0, 0.5]])
    inside = np.array([True, True, True, False])
    assert [names[k] for k in outlet_of(outlets.values(), position, inside)[:3]] == ["below", "side", "side"]
    assert outlet_of(outlets.values(), position, inside)[3] == -1
    disc = outlets[names[2]].depth(np.array([[0, 0, 0.103], [0.009, 0, 0.2], [0.02, 0, 0.2], [0, 0, 0.0]]))
    np.testing.assert_allclose(disc, [0.003, 0.001, -0.01, -0.1], atol=1e-15)
