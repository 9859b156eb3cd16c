"""Changes of a scene that resume accepts or rejects, and runs that start from the last state of another
run."""

from copy import deepcopy
from dataclasses import replace

import numpy as np
import pytest
from resume.runs import complex_scene
from scene_builders import build_scene, particle_group, plane

from granflow.cli.main import main
from granflow.errors import GranflowError, SceneError
from granflow.io.checkpoint import newest_checkpoint
from granflow.load import scene_of
from granflow.particles.insertion import initial_particles
from granflow.plan.build import plan_for
from granflow.runs.initial_particles import particles_from_run
from granflow.runs.resume import accepted_change, differences, forbidden
from granflow.simulation import Simulation


def changed(**overrides):
    """The scene of `complex_scene` as read from text, unchanged and with overrides; `__` in a key stands for
    a dot."""
    original = scene_of(complex_scene().to_yaml(), "before")
    return original, scene_of(
        complex_scene().to_yaml(), "now", [f"{k.replace('__', '.')}={v}" for k, v in overrides.items()]
    )


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ({"output__interval": "1 ms"}, "output.interval was 0.0028571428571428571 and is 0.001"),
        ({"walls__gate__stages": "[fill, shake]"}, "walls.gate.stages was [fill] and is [fill, shake]"),
        ({"walls__floor__motion__0__end": "1 s"}, "walls.floor.motion.0.end was not given and is 1.0"),
        ({"stages__2__duration": "1 s"}, "stages.2.duration was 0.006666666666666667 and is 1.0"),
        ({"numerics__max_overlap": "0.5"}, "numerics.max_overlap was 0.3 and is 0.5"),
        ({"output__checkpoint__keep": "5"}, "output.checkpoint.keep was 100 and is 5"),
        ({"expect": "[{quantity: particle_count, above: 3}]"}, "expect was [] and is not given"),
    ],
)
def test_accepted_changes_are_listed(override, message):
    original, modified = changed(**override)
    assert not forbidden(original, modified, stages_over=1)
    assert message.replace("0.0028571428571428571", repr(0.02 / 7.0)) in [
        str(each) for each in differences(original, modified)
    ]


@pytest.mark.parametrize(
    "override",
    [
        {"particles__rain__count": "61"},
        {"gravity": "[0, 0, -9.8]"},
        {"seed": "2"},
        {"materials__glass__density": "2501"},
        {"pairs__glass-glass__restitution": "0.5"},
        {"contact__normal": "hertz"},
        {"walls__gate__material": "steel"},
        {"walls__floor__point": "[0, 0, 1 mm]"},
        {"run__precision": "f32"},
        {"domain__on_exit": "error"},
        {"stages__0__duration": "1 s"},
        {"output__energy_budget": "false"},
        {"output__flow_meters": "{}"},
    ],
)
def test_forbidden_changes_are_named(override):
    original, modified = changed(**override)
    key = next(iter(override)).replace("__", ".")
    assert [each.key for each in forbidden(original, modified, stages_over=1)][0].startswith(key)


def falling_particles(friction=0.3, lid_speed=0.1, gate_until=0.02, **parts):
    """Four particles that fall onto a gate, which is removed after 20 ms, far below a rising lid."""
    positions = [[0.0, 0.0, 0.0065], [0.02, 0.0, 0.0066], [0.0, 0.02, 0.0067], [0.02, 0.02, 0.0068]]
    rising = [{"kind": "translation", "velocity": [0, 0, lid_speed], "start": 0.0}]
    walls = {
        "gate": plane([0, 0, 0], [0, 0, 1], vanishes_at=gate_until),
        "lid": plane([0, 0, 0.5], [0, 0, -1], motion=rising),
    }
    defaults = {
        "gravity": [0.0, 0.0, -9.81], "pair": {"friction": friction}, "run": {"time_step": 1e-5, "velocity_max": 1.0},
        "stages": [{"name": "hold", "duration": 0.02}, {"name": "fall", "duration": 0.02}],
    }  # fmt: skip
    return build_scene({"balls": particle_group(positions)}, walls, **(defaults | parts))


@pytest.fixture(scope="module")
def checkpoint(tmp_path_factory, taichi_f64):
    """A checkpoint in the middle of the first stage."""
    out = tmp_path_factory.mktemp("held")
    simulation = Simulation(falling_particles(), out=out)
    simulation.run(until=0.015)
    simulation.free()
    checkpoint, _ = newest_checkpoint(out)
    assert checkpoint.time == pytest.approx(0.015, abs=1.1e-5)
    return checkpoint


def resumed_snapshot(scene, checkpoint, until):
    """Snapshot of a resumed run at a time [s]."""
    simulation = Simulation(scene, resume=checkpoint)
    simulation.run(until)
    last = simulation.snapshot()
    simulation.free()
    return last


@pytest.fixture(scope="module")
def restored_particles(checkpoint):
    """Particles of the checkpoint, with positions and velocities at the same time."""
    return resumed_snapshot(falling_particles(), checkpoint, until=checkpoint.time).particles


def test_gate_removed_on_resume_lets_particles_fall(checkpoint, restored_particles):
    """Without the gate, displacements are v t - 1/2 g t^2, which leapfrog integrates exactly."""
    assert restored_particles["position"][:, 2].min() > 0.005
    last = resumed_snapshot(falling_particles(gate_until=0.01), checkpoint, until=None)
    time = last.time - checkpoint.time
    free_fall = restored_particles["velocity"][:, 2] * time - 0.5 * 9.81 * time**2
    displacement = last.particles["position"][:, 2] - restored_particles["position"][:, 2]
    np.testing.assert_allclose(displacement, free_fall, rtol=1e-9)


def test_displaced_wall_is_rejected_with_a_remedy(checkpoint):
    with pytest.raises(
        GranflowError, match=r"walls.lid.motion would displace the wall by 0.0015 m.*\(start:\)"
    ):
        Simulation(falling_particles(lid_speed=0.2), resume=checkpoint)


def test_changed_domain_is_rejected_without_allow_changes(checkpoint):
    other = falling_particles(domain={"min": [-1.0] * 3, "max": [1.5] * 3, "on_exit": "error"})
    with pytest.raises(GranflowError) as error:
        Simulation(other, resume=checkpoint)
    difference = "domain.max was [1.0, 1.0, 1.0] and is [1.5, 1.5, 1.5]"
    assert str(error.value) == (
        f"{checkpoint.path}: {difference}, which cannot change when a run continues. "
        "Run the scene from the start, or continue despite the change with --allow-changes."
    )
    assert [
        each.key for each in accepted_change(checkpoint, plan_for(other), allow_changes=True).differences
    ] == ["domain.max"]


def test_changed_precision_adds_and_removes_the_remainders_of_velocities(checkpoint):
    continued = replace(checkpoint, saved=deepcopy(checkpoint.saved))
    particles = continued.saved["engine"]["particles"]
    for precision, exists in (("mixed", True), ("f64", False)):
        other = falling_particles(run={"time_step": 1e-5, "velocity_max": 1.0, "precision": precision})
        accepted_change(continued, plan_for(other), allow_changes=True)
        assert ("velocity_remainder" in particles) == ("angular_velocity_remainder" in particles) == exists
        continued = replace(continued, scene=other.to_yaml())


FOUR = [[0.0, 0.0, 0.0065], [0.02, 0.0, 0.0066], [0.0, 0.02, 0.0067], [0.02, 0.02, 0.0068]]
CONTRADICTIONS = {
    "an outlet": (
        {"outlets": {"out": {"box": {"min": [-1.0] * 3, "max": [-0.9] * 3}}}},
        "the outlets were none and are out",
    ),
    "another group": (
        {"particles": {"beads": particle_group(FOUR)}},
        "the particles were balls and are beads",
    ),
    "other sizes": (
        {"particles": {"balls": particle_group(FOUR, 0.004)}},
        "has particles of 0.01 to 0.01 m, but those of the scene are of 0.004 to 0.004 m",
    ),
    "other stages": (
        {"stages": [{"name": "settle", "duration": 0.04}]},
        "the stages were hold and are settle",
    ),
    "an energy budget": (
        {"output": {"interval": 1.0, "energy_budget": True}},
        "energy_budget was False and would be True",
    ),
}


@pytest.mark.parametrize("name", CONTRADICTIONS)
def test_allowed_changes_that_the_state_contradicts_are_rejected(checkpoint, name):
    parts, message = CONTRADICTIONS[name]
    with pytest.raises(GranflowError, match=message):
        Simulation(falling_particles(**parts), resume=checkpoint, allow_changes=True)


def test_changed_time_step_is_rejected_despite_allow_changes(checkpoint):
    with pytest.raises(GranflowError, match="time_step was 1e-05 and would be 5e-06 with this scene"):
        scene = falling_particles(run={"time_step": 5e-6, "velocity_max": 1.0})
        Simulation(scene, resume=checkpoint, allow_changes=True)


def test_disabled_friction_is_rejected(checkpoint):
    with pytest.raises(GranflowError, match="friction was True and would be False with this scene"):
        Simulation(falling_particles(friction=0.0), resume=checkpoint)


@pytest.mark.parametrize("allow_changes", [False, True])
def test_duration_that_has_passed_is_rejected(checkpoint, allow_changes):
    """The checkpoint is at 15 ms of the first stage."""
    stages = [{"name": "hold", "duration": 0.01}, {"name": "fall", "duration": 0.02}]
    message = (
        r"stages.0.duration is 0.01 s, but at .* stage hold has already lasted 0.015\d* s: give at least this"
    )
    with pytest.raises(GranflowError, match=message):
        Simulation(falling_particles(stages=stages), resume=checkpoint, allow_changes=allow_changes)


def files_in(out):
    return {path.name: path.read_bytes() for path in out.iterdir() if path.name != ".lock"}


@pytest.mark.parametrize(("until", "code"), [("5 ms", 2), ("15 ms", 0)])
def test_end_before_the_checkpoint_is_rejected_and_one_at_it_takes_no_step(checkpoint, capsys, until, code):
    out = checkpoint.path.parent
    before = files_in(out)
    assert main(["resume", str(out), "--until", until]) == code
    printed = capsys.readouterr()
    if code:
        assert f"--until is 0.005 s, but {checkpoint.path} is at 0.015" in printed.err
        assert files_in(out) == before
    else:
        assert "The run is at --until 0.015 s, so no step is taken." in printed.out
        assert newest_checkpoint(out)[0].time == checkpoint.time


def complete_run(out, **parts):
    """Runs one particle at rest to the end; returns the simulation and the files."""
    with Simulation(build_scene({"ball": particle_group([[0.0] * 3])}, **parts), out=out) as simulation:
        simulation.run()
    return simulation, files_in(out)


def test_complete_run_is_extended_as_the_message_states(taichi_f64, tmp_path, capsys):
    simulation, files = complete_run(tmp_path, run={"duration": 1e-3})
    assert main(["resume", str(tmp_path), "--until", "3 ms"]) == 2
    message = (
        f"granflow: --until is 0.003 s, but the run is complete at {simulation.time:.6g} s: extend it with "
    )
    assert capsys.readouterr().err == f"{message}--set run.duration=0.003s.\n"
    assert files_in(tmp_path) == files
    assert main(["resume", str(tmp_path)]) == 0
    assert (
        "The run is complete, so no step is taken. To continue it, extend it with" in capsys.readouterr().out
    )
    assert main(["resume", str(tmp_path), "--until", "4 ms", "--set", "run.duration=0.003s"]) == 0
    assert ", before --until 0.004 s." in capsys.readouterr().out
    assert newest_checkpoint(tmp_path)[0].time == pytest.approx(3e-3, abs=simulation.time_step)


def test_extended_run_continues_a_flow_without_count(taichi_f64, tmp_path):
    """At 100 particles per second three enter in 30 ms, and three more in the next 30 ms."""
    region = {"box": {"min": [-0.2, -0.2, -0.2], "max": [0.2, 0.2, 0.2]}}
    feed = {
        "material": "glass",
        "diameter": 0.01,
        "insert": {"kind": "rain", "region": region, "rate": 100.0},
    }
    scene = build_scene({"feed": feed}, run={"duration": 0.03, "time_step": 7e-5})
    with Simulation(scene, out=tmp_path) as simulation:
        simulation.run()
        assert len(simulation.snapshot().particles["id"]) == 3
    assert main(["resume", str(tmp_path), "--set", "run.duration=0.06 s"]) == 0
    assert len(newest_checkpoint(tmp_path)[0].saved["engine"]["particles"]["id"]) == 6


def test_complete_run_whose_last_stage_has_a_condition_needs_another_stage(taichi_f64, tmp_path, capsys):
    stages = [{"name": "rest", "kinetic_energy_below": 1.0, "max_duration": 1e-3}]
    _, files = complete_run(tmp_path, run={}, stages=stages)
    assert main(["resume", str(tmp_path), "--until", "3 ms"]) == 2
    assert f"add a stage after rest in {tmp_path / 'scene_as_run.yaml'}." in capsys.readouterr().err
    assert files_in(tmp_path) == files


def test_start_from_copies_the_last_state_of_another_run(checkpoint, restored_particles):
    """Positions, velocities at the same time and radii are copied; a new group is inserted without
    overlap."""
    groups = {
        "fresh": particle_group([[0.0, 0.0, 0.3]], 0.02),
        "balls": particle_group([[0.0, 0.0, 0.1]] * 4),
    }
    scene = falling_particles(start_from=str(checkpoint.path.parent), particles=groups)
    start = initial_particles(scene, particles_from_run(scene))
    assert list(start.group) == [0, 1, 1, 1, 1]
    np.testing.assert_array_equal(start.position[1:], restored_particles["position"])
    np.testing.assert_array_equal(start.radius[1:], restored_particles["radius"])
    np.testing.assert_allclose(start.velocity[1:], restored_particles["velocity"], rtol=1e-12, atol=1e-15)


def test_mismatch_with_start_from_is_reported(checkpoint, tmp_path):
    with pytest.raises(SceneError, match="contains no usable checkpoint; give the directory"):
        Simulation(falling_particles(start_from=str(tmp_path)))
    with pytest.raises(SceneError, match="does not exist; give the directory"):
        Simulation(falling_particles(start_from=str(tmp_path / "none")))
    small = build_scene(
        {"balls": particle_group([[0, 0, 0.1]], 0.008)}, start_from=str(checkpoint.path.parent)
    )
    with pytest.raises(SceneError) as error:
        Simulation(small)
    count, size = error.value.problems
    assert count.endswith("particles.balls.count is 1, but start_from has 4 particles.")
    assert size.endswith("diameter lies in [0.008, 0.008] m, but start_from has diameters in [0.01, 0.01] m.")


def test_start_from_a_run_whose_particles_are_deleted_is_rejected(tmp_path):
    """One particle leaves a domain of 20 mm at 1 m/s in the run of 40 ms."""
    domain = {"min": [-0.01] * 3, "max": [0.01] * 3, "on_exit": "delete"}
    group = {"ball": particle_group([0.0, 0.0, 0.0], 0.002, velocity=[1.0, 0.0, 0.0])}
    Simulation(build_scene(group, domain=domain, run={"duration": 0.04}), out=tmp_path / "empty").run()
    with pytest.raises(
        SceneError, match=r"at 0.0400\d+ s it has no particles of ball; give a run that ends before"
    ):
        Simulation(build_scene(group, start_from=str(tmp_path / "empty")))
