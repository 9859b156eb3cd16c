"""The section of the report on collisions by impact energy."""

import numpy as np
import pytest
from scene_builders import build_scene, particle_group, plane

from granflow import read_run
from granflow.observers.timeseries import CollisionEnergies
from granflow.simulation import Simulation
from granflow.snapshot import Snapshot
from granflow.studies.report import collision_topics, report_text


def snapshot(time, particle, wall):
    counts = {"particle": np.array(particle), "wall": np.array(wall)}
    return Snapshot(time, 0, "run", {}, None, {}, {}, {}, counts)


def test_section_shows_the_collisions_since_the_start(tmp_path):
    observer = CollisionEnergies(tmp_path, 1.0, np.array([1e-6, 1e-4, 1e-2]))
    for time, particle, wall in (
        (0.0, [0] * 4, [0] * 4),
        (1.0, [0, 1, 2, 0], [0] * 4),
        (2.0, [0, 5, 7, 1], [3, 0, 0, 0]),
    ):
        observer.observe(snapshot(time, particle, wall))
    observer.finish()
    (topic,) = collision_topics(tmp_path, True)
    (table,) = topic.folded
    assert table.rows == [
        ("0 to 1e-06 J", "0", "3"), ("1e-06 to 0.0001 J", "5", "0"), ("0.0001 to 0.01 J", "7", "0"),
        ("0.01 to inf J", "1", "0")
    ]  # fmt: skip
    particle, wall = topic.plots[0].figure["data"]
    assert particle["x"] == pytest.approx([1e-5, 1e-3], rel=1e-5) and particle["y"] == [5, 7]
    assert wall["y"] == [None, None], "a logarithmic axis has no 0"


def test_report_of_a_run_has_the_section(tmp_path, taichi_f64):
    output = {"interval": 0.05, "collision_energies": {"min": 1e-9, "max": 1e-2}}
    scene = build_scene(
        {"ball": particle_group([[0.0, 0.0, 0.01]], 0.01)}, {"floor": plane([0, 0, 0], [0, 0, 1])},
        gravity=[0.0, 0.0, -9.81], run={"duration": 0.1}, output=output,
    )  # fmt: skip
    simulation = Simulation(scene, out=tmp_path / "run")
    simulation.run()
    simulation.close()
    assert "Collisions by impact energy" in report_text(read_run(tmp_path / "run"), "", None)
