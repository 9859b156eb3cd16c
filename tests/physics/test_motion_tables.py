"""Walls that follow a table: the particles on them, the files, and the continuation of a run."""

import numpy as np
import pytest
from resume.runs import files_of, resume_copy, run_to_end, states_of
from scene_builders import few_spheres, particle_group, plane, run_and_sample

from granflow.errors import SceneError
from granflow.load import load_scene
from granflow.plan.build import plan_for
from granflow.schema.document import yaml_text
from granflow.simulation import Simulation

GRAVITY, RADIUS = 9.81, 0.005
OVERLAP = 1e-5
"""Upper bound of the overlap with the floor [m]: 1.9e-6 at rest (Hertz), 3.9e-6 at the load 2 m (g + 5
m/s2)."""


def scene_on(motion):
    """A sphere at rest on a floor that follows a table."""
    walls = {"floor": plane([0, 0, 0], [0, 0, 1], motion={"kind": "table", **motion})}
    run = {"duration": 0.05, "velocity_max": 0.5}
    ball = particle_group([0, 0, RADIUS - 1e-7])
    output = {"interval": 1.0, "energy_budget": True, "wall_forces": True}
    return few_spheres(
        {"ball": ball}, walls, {"restitution": 0.0}, gravity=[0.0, 0.0, -GRAVITY], run=run, output=output
    )


def test_a_sphere_follows_a_lifted_floor(taichi_f64):
    """A lift by 2 mm in 40 ms with accelerations of 5 m/s2, below g: s = (5/2) t^2 up to half of it.

    The work is m g h, and the sphere is at rest again at the end.
    """
    height = 2e-3
    lift = {"direction": [0, 0, 2], "times": [0, 0.02, 0.04], "velocities": [0, 0.1, 0]}
    snapshots = run_and_sample(scene_on(lift), 0.01)
    mass = snapshots[0].particles["mass"][0]
    for snapshot in snapshots:
        t = snapshot.time
        expected = 2.5 * t**2 if t < 0.02 else height - 2.5 * max(0.04 - t, 0.0) ** 2
        assert snapshot.walls["floor"].offset[2] == pytest.approx(expected, abs=1e-12)
        assert snapshot.particles["position"][0, 2] == pytest.approx(RADIUS + expected, abs=OVERLAP)
    assert snapshots[-1].totals["wall_work"] == pytest.approx(mass * GRAVITY * height, rel=2e-3)
    assert snapshots[-1].totals["kinetic_energy"] < 1e-6 * mass * GRAVITY * height


FILE = "# recorded\ntime [ms]; displacement [mm]\n0; 0\n10; 0,1\n20; 0,4\n50; 0,1\n"


def saved_scene(folder, text=FILE):
    """File of a scene whose floor follows lift.csv."""
    (folder / "lift.csv").write_text(text)
    given = scene_on({"direction": [0, 0, 1], "times": [0, 1], "displacements": [0, 0]}).to_dict()
    given["walls"]["floor"]["motion"] = [{"kind": "table", "file": "lift.csv", "direction": [0, 0, 1]}]
    path = folder / "scene.yaml"
    path.write_text(yaml_text(given))
    return path


def test_a_csv_file_is_read_with_its_units(tmp_path):
    scene = load_scene(saved_scene(tmp_path))
    (motion,) = scene.walls["floor"].motion
    assert motion.times == pytest.approx((0, 0.01, 0.02, 0.05))
    assert motion.displacements == pytest.approx((0, 1e-4, 4e-4, 1e-4))
    assert ("walls.floor.motion.0.file", "lift.csv") in list(scene.input_names())
    again = tmp_path / "again"
    again.mkdir()
    (again / "lift.csv").write_text(FILE)
    assert load_scene(scene.save(again / "scene.yaml")) == scene


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("", "lift.csv: the table has no rows"),
        ("time, displacment\n0, 1\n1, 2\n", "lift.csv:1: the columns are .*mean displacement instead of"),
        ("time, velocity, angle\n0, 1, 2\n", "lift.csv:1: the columns are time, velocity, angle, but"),
        (
            "time [m], velocity\n0, 1\n",
            r"lift.csv:1: the unit of time \[m\] is invalid: m is a unit of length",
        ),
        ("time, velocity\n0, 1\n\n2\n", "lift.csv:4: the row must have 2 values"),
        ("time, velocity\n0, 1\n1, x\n", "lift.csv:3: a finite number is expected"),
        ("time, velocity\n0, 1\n2, 1\n2, 3\n", "lift.csv:4: times must ascend"),
        ("time, velocity\n0, 1\n", "lift.csv: the table must have at least two rows"),
        (
            "time, angle\n0, 0\n1, 1\n",
            "lift.csv:1: angle requires point and axis, but the motion has direction",
        ),
    ],
)
def test_invalid_files_are_refused_with_their_line(tmp_path, text, problem):
    path = saved_scene(tmp_path, text)
    with pytest.raises(SceneError, match=problem):
        load_scene(path)


def test_rows_closer_than_the_time_step_are_refused():
    motion = {"direction": [0, 0, 1], "times": [0, 1e-7, 1e-3], "velocities": [0, 1e-3, 0]}
    with pytest.raises(SceneError, match="rows that are 1e-07 s apart, less than the time"):
        plan_for(scene_on(motion))


def test_restart_within_a_table_is_bit_identical_without_the_file(tmp_path, taichi_f64):
    """The checkpoint contains the rows: the run continues after the file was changed in the folder of the
    scene."""
    source = tmp_path / "source"
    source.mkdir()
    path = saved_scene(source)
    options = ["output.checkpoint.interval=5 ms", "output.checkpoint.keep=100", "output.interval=5 ms"]
    scene = load_scene(path, options)
    checkpoints = run_to_end(scene, tmp_path / "whole")
    assert (tmp_path / "whole" / "lift.csv").read_text() == FILE
    resume_copy(scene, tmp_path / "whole", tmp_path / "parts", checkpoints[3])
    assert files_of(tmp_path / "parts") == files_of(tmp_path / "whole")
    assert states_of(tmp_path / "parts") == states_of(tmp_path / "whole")
    with Simulation(load_scene(tmp_path / "whole" / "scene_as_run.yaml")) as simulation:
        simulation.run(until=0.02)
        np.testing.assert_allclose(simulation.walls["floor"].pose.offset, [0, 0, 4e-4], atol=1e-9)
