"""Changes of a scene that resume accepts or rejects, and runs that start from the last state of another
run."""

from copy import deepcopy
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from resume.runs import balls
from scene_builders import build_scene, particle_group, run_to_end

import granflow as gf
from granflow.cli.main import main
from granflow.engine.host import new_particle_arrays
from granflow.errors import GranflowError, SceneError
from granflow.io.checkpoint import newest_checkpoint
from granflow.load import scene_of
from granflow.particles.insertion import initial_particles
from granflow.runs.initial_particles import (
    _refuse_displaced_images,
    _refuse_other_widths,
    particles_from_run,
    refuse_other_particles,
)
from granflow.runs.resume import accepted_change, differences, forbidden

STAGES = [{"name": "hold", "duration": 0.02}, {"name": "fall", "duration": 0.02}]
RUN = {"time_step": 1e-5, "velocity_max": 1.0}


def falling(**parts):
    """Four balls above a gate that vanishes after 20 ms, in two stages."""
    return balls(**{"gate_until": 0.02, "stages": STAGES, "run": RUN} | parts)


@pytest.fixture(scope="module")
def checkpoint(tmp_path_factory, taichi_f64):
    """A checkpoint in the middle of the first stage."""
    out = tmp_path_factory.mktemp("held")
    with gf.Simulation(falling(), out=out) as simulation:
        simulation.run(until=0.015)
    checkpoint, _ = newest_checkpoint(out)
    assert checkpoint.time == pytest.approx(0.015, abs=1.1e-5)
    return checkpoint


def resumed_snapshot(scene, checkpoint, until):
    """Snapshot of a resumed run at a time [s]."""
    with gf.Simulation(scene, resume=checkpoint) as simulation:
        simulation.run(until)
        return simulation.snapshot()


@pytest.fixture(scope="module")
def restored(checkpoint):
    """Particles of the checkpoint, with positions and velocities at the same time."""
    return resumed_snapshot(falling(), checkpoint, until=checkpoint.time).particles


ACCEPTED = [
    "title=Other", "expect=[{quantity: particle_count, above: 3}]", "output.interval=1 ms", "output.compression=none",
    "output.checkpoint.keep=5", "stages.1.duration=1 s", "stages.2={name: more, duration: 1 s}",
    "walls.gate.vanishes_at=2 s", "walls.lid.motion.0.end=1 s", "pairs.glass-glass.friction=0.2",
    "numerics.max_overlap=0.5",
]  # fmt: skip
REFUSED = [
    "particles.balls.diameter=2 cm", "gravity=[0, 0, -9.8]", "seed=2", "materials.glass.density=2501",
    "pairs.glass-glass.restitution=0.4", "contact.normal=hertz", "walls.lid.point=[0, 0, 1 m]", "run.precision=f32",
    "domain.on_exit=error", "stages.0.duration=1 s", "output.energy_budget=false",
]  # fmt: skip


@pytest.mark.parametrize("override", ACCEPTED + REFUSED)
def test_some_keys_may_change_in_the_second_stage(override):
    text = falling().to_yaml()
    before, now = scene_of(text, "before"), scene_of(text, "now", [override])
    key = override.partition("=")[0]
    assert differences(before, now)[0].key.startswith(key)
    refused = [each.key for each in forbidden(before, now, stages_over=1)]
    assert not refused if override in ACCEPTED else refused[0].startswith(key)


UPWARD = {"kind": "translation", "velocity": [0, 0, 0.1]}


@pytest.mark.parametrize(
    ("key", "value", "affects"),
    [
        ("walls.gate.vanishes_at", 0.018, False),
        ("walls.gate.vanishes_at", 0.01, True),
        ("walls.lid.motion", [UPWARD | {"end": 0.5}, UPWARD | {"start": 0.5}], False),
        ("walls.lid.motion.0.end", 0.01497, True),
    ],
)
def test_walls_that_differ_later_do_not_affect_the_present_forces(checkpoint, key, value, affects):
    """Forces that are computed again between two steps differ from those of an uninterrupted run by the
    corrections within the step. The last motion has ended 30 us before the checkpoint."""
    change = accepted_change(checkpoint, gf.plan_for(falling().with_values({key: value})), False)
    assert change.affects_walls and change.affects_forces is affects


def test_gate_removed_on_resume_lets_particles_fall(checkpoint, restored):
    """Without the gate, displacements are v t - 1/2 g t^2, which leapfrog integrates exactly."""
    assert restored["position"][:, 2].min() > 0.005
    last = resumed_snapshot(falling(gate_until=0.01), checkpoint, until=None)
    time = last.time - checkpoint.time
    free_fall = restored["velocity"][:, 2] * time - 0.5 * 9.81 * time**2
    displacement = last.particles["position"][:, 2] - restored["position"][:, 2]
    np.testing.assert_allclose(displacement, free_fall, rtol=1e-9)


def test_changed_domain_needs_allow_changes(checkpoint):
    other = falling(domain={"min": [-1.0] * 3, "max": [1.5] * 3, "on_exit": "delete"})
    message = r"domain.max was \[1.0, 1.0, 1.0\] and is \[1.5, 1.5, 1.5\], which cannot .* --allow-changes\.$"
    with pytest.raises(GranflowError, match=message):
        gf.Simulation(other, resume=checkpoint)
    accepted = accepted_change(checkpoint, gf.plan_for(other), allow_changes=True)
    assert [each.key for each in accepted.differences] == ["domain.max"]


def test_changed_precision_adds_and_removes_the_remainders_of_velocities(checkpoint):
    continued = replace(checkpoint, saved=deepcopy(checkpoint.saved))
    particles = continued.saved["engine"]["particles"]
    for precision, exists in (("mixed", True), ("f64", False)):
        other = falling(run=RUN | {"precision": precision})
        accepted_change(continued, gf.plan_for(other), allow_changes=True)
        assert ("velocity_remainder" in particles) == ("angular_velocity_remainder" in particles) == exists
        continued = replace(continued, scene=other.to_yaml())


CONTRADICTIONS = {
    "the particles were balls and are beads": {"groups": {"beads": particle_group([[0.0, 0.0, 0.1]] * 4)}},
    "has particles of 0.01 to 0.01 m, but those of the scene are of 0.004 to 0.004 m": {
        "groups": {"balls": particle_group([[0.0, 0.0, 0.1]] * 4, 0.004)}
    },
    "the stages were hold and are settle": {"stages": [{"name": "settle", "duration": 0.04}]},
    "energy_budget was True and would be False": {"output": {"interval": 1.0, "wall_forces": True}},
    "time_step was 1e-05 and would be 5e-06 with this scene": {"run": RUN | {"time_step": 5e-6}},
    r"walls.lid.motion would displace the wall by 0.0015 m.*motion.0.end=.* --set 'walls.lid.motion.1=": {
        "lid_speed": 0.2
    },
    r"stages.0.duration is 0.01 s, but at .* stage hold has already lasted 0.015\d* s: give at least this": {
        "stages": [{"name": "hold", "duration": 0.01}, {"name": "fall", "duration": 0.02}]
    },
}  # fmt: skip
"""Changes that the state contradicts: the message, and parts of the scene."""


@pytest.mark.parametrize("message", CONTRADICTIONS)
def test_changes_that_the_state_contradicts_are_rejected_also_if_allowed(checkpoint, message):
    with pytest.raises(GranflowError, match=message):
        gf.Simulation(falling(**CONTRADICTIONS[message]), resume=checkpoint, allow_changes=True)


def files_in(out):
    return {path.name: path.read_bytes() for path in out.iterdir() if path.name != ".lock"}


def test_end_before_the_checkpoint_is_rejected_and_one_at_it_takes_no_step(checkpoint, capsys):
    out = checkpoint.path.parent
    before = files_in(out)
    assert main(["resume", str(out), "--until", "5 ms", "--threads", "2"]) == 2
    assert f"--until is 0.005 s, but {checkpoint.path} is at 0.015" in capsys.readouterr().err
    assert files_in(out) == before
    assert main(["resume", str(out), "--until", "15 ms", "--threads", "2"]) == 0
    assert "The run is at --until 0.015 s, so no step is taken." in capsys.readouterr().out
    assert newest_checkpoint(out)[0].time == checkpoint.time


def test_complete_run_is_extended_as_the_message_states(taichi_f64, tmp_path, capsys):
    """A flow without count continues, too: 1000 particles per second, three in each 3 ms."""
    region = {"box": {"min": [-0.2, -0.2, 0.2], "max": [0.2, 0.2, 0.4]}}
    insertion = {"kind": "rain", "region": region, "rate": 1000.0}
    feed = {"material": "glass", "diameter": 0.01, "insert": insertion}
    run_to_end(balls(groups={"feed": feed}, run=RUN | {"duration": 3e-3}), out=tmp_path)
    files = files_in(tmp_path)
    assert main(["resume", str(tmp_path), "--until", "6 ms"]) == 2
    assert files_in(tmp_path) == files
    assert capsys.readouterr().err.endswith(" s: extend it with --set run.duration=0.006s.\n")
    assert main(["resume", str(tmp_path), "--threads", "2"]) == 0
    assert "The run is complete, so no step is taken. To continue it, extend" in capsys.readouterr().out
    assert len(newest_checkpoint(tmp_path)[0].saved["engine"]["particles"]["id"]) == 3
    extend = ["--until", "7 ms", "--set", "run.duration=0.006s", "--threads", "2"]
    assert main(["resume", str(tmp_path), *extend]) == 0
    assert ", before --until 0.007 s." in capsys.readouterr().out
    last = newest_checkpoint(tmp_path)[0]
    assert last.time == pytest.approx(6e-3, abs=1e-5)
    assert len(last.saved["engine"]["particles"]["id"]) == 6


def test_complete_run_whose_last_stage_has_a_condition_needs_another_stage(taichi_f64, tmp_path, capsys):
    stages = [{"name": "rest", "kinetic_energy_below": 1.0, "max_duration": 1e-3}]
    run_to_end(balls(run=RUN, stages=stages), out=tmp_path)
    files = files_in(tmp_path)
    assert main(["resume", str(tmp_path), "--until", "3 ms"]) == 2
    assert f"add a stage after rest in {tmp_path / 'scene_as_run.yaml'}." in capsys.readouterr().err
    assert files_in(tmp_path) == files


# ---------------------------------------------------------------- start_from


def test_start_from_copies_the_last_state_of_another_run(checkpoint, restored):
    """Positions, velocities at the same time and radii are copied; a new group is inserted without overlap. The
    run had no temperatures: each particle has that of its group."""
    groups = {
        "fresh": particle_group([[0.0, 0.0, 0.3]], 0.02),
        "balls": particle_group([[0.0, 0.0, 0.1]] * 4),
    }
    scene = falling(start_from=str(checkpoint.path.parent), groups=groups)
    start = initial_particles(scene, particles_from_run(scene))
    assert list(start.group) == [0, 1, 1, 1, 1]
    np.testing.assert_array_equal(start.position[1:], restored["position"])
    np.testing.assert_array_equal(start.radius[1:], restored["radius"])
    np.testing.assert_allclose(start.velocity[1:], restored["velocity"], rtol=1e-12, atol=1e-15)

    warm = scene.to_dict()
    warm["contact"]["heat"] = "conduction"
    warm["materials"]["glass"] |= {"thermal_conductivity": 1.0, "heat_capacity": 500.0}
    for name, temperature in (("fresh", 300.0), ("balls", 400.0)):
        warm["particles"][name]["temperature"] = temperature
    plan = gf.plan_for(gf.Scene.from_dict(warm))
    arrays = new_particle_arrays(plan, initial_particles(plan.scene, particles_from_run(plan.scene)), 0)
    assert arrays["temperature"].tolist() == [300.0, *[400.0] * 4]
    other = replace(start, initial_values={"temperature": np.array([300.0, np.nan, -1.0, 300.0, 300.0])})
    with pytest.raises(GranflowError, match="has a temperature of -1: a temperature must be above 0"):
        refuse_other_particles(plan, other)
    with pytest.raises(GranflowError, match="has temperature, but the scene has no particle equation; leave"):
        refuse_other_particles(gf.plan_for(scene), other)


def test_start_from_requires_the_last_widths_of_a_deforming_box():
    """The box of 20 mm has ended at 19.6 mm; widths of the scene may be rounded."""

    def scene(side):
        domain = {"min": [0.0] * 3, "max": [side] * 3, "periodic": ["x", "y", "z"], "on_exit": "error"}
        return build_scene({"ball": particle_group([[0.0, 0.0, 0.0]], 0.002)}, domain=domain)

    saved = SimpleNamespace(saved={"engine": {"deformation": {"width": np.full(3, 0.0196)}}})
    with pytest.raises(SceneError, match=r"max: \[0\.0196, 0\.0196, 0\.0196\]\}; give these"):
        _refuse_other_widths(scene(0.01963), scene(0.02), saved, "start_from is x, but")
    _refuse_other_widths(scene(0.0196001), scene(0.02), saved, "start_from is x, but")


def test_start_from_requires_aligned_images_of_a_sheared_box():
    """Images that move at 10/s times 20 mm begin at 10 ms: at 0.03 s they are displaced by 4 mm, and at 0.11 s by the
    width of the box, but for one time step. Without periodic boundaries there are no images."""

    def scene(**domain):
        domain = {"min": [0.0] * 3, "max": [0.02] * 3, "on_exit": "error"} | domain
        return build_scene({"ball": particle_group([[0.01, 0.01, 0.01]], 0.002)}, domain=domain)

    def refuse(time, scene):
        saved = {"engine": {"clock": {"time_step": 1e-4}}}
        _refuse_displaced_images(
            scene, before, SimpleNamespace(time=time, saved=saved), "start_from is x, but"
        )

    periodic = scene(periodic=["x", "y", "z"])
    shear = {"flow": "x", "gradient": "z", "rate": 10.0, "start": 0.01}
    before = scene(periodic=["x", "y", "z"], lees_edwards=shear)
    with pytest.raises(SceneError, match=r"displaced by 0\.004 m along x, .* such as at 0\.11 s\.$"):
        refuse(0.03, periodic)
    refuse(0.11 + 0.9e-4, periodic)
    refuse(0.005, periodic)
    refuse(0.03, scene())


def test_mismatch_with_start_from_is_reported(checkpoint, tmp_path):
    with pytest.raises(SceneError, match="contains no usable checkpoint; give the directory"):
        gf.Simulation(falling(start_from=str(tmp_path)))
    small = {"balls": particle_group([[0, 0, 0.1]], 0.008)}
    with pytest.raises(SceneError) as error:
        gf.Simulation(falling(groups=small, start_from=str(checkpoint.path.parent)))
    count, size = error.value.problems
    assert count.endswith("particles.balls.count is 1, but start_from has 4 particles.")
    assert "diameter lies in [0.008, 0.008] m, but balls of the run in start_from has diameters in" in size
