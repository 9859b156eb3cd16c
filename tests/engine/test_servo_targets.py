"""Warnings of servo walls that are off their target when a stage ends."""

import json
import logging
import shutil

import pytest
from engine.test_wall_dynamics import balls_below, lid

from granflow.io.checkpoint import read_checkpoint
from granflow.runs.stages import off_target
from granflow.simulation import Simulation

RADIUS, TARGET = 0.005, 0.5


def lid_scene(gap, press, release=0.0, velocity_max=0.5, **servo):
    """Four particles on a floor, and a lid `gap` [m] above them that presses with 0.5 N in the stage press."""
    motion = {
        "kind": "servo", "direction": [0, 0, -1], "force": TARGET, "velocity_max": velocity_max, "stages": ["press"],
    } | servo  # fmt: skip
    stages = [{"name": "press", "duration": press}]
    stages += [{"name": "release", "duration": release}] if release else []
    return balls_below(
        lid(2.0 * RADIUS + gap, motion), positions=[[0.006 * x, 0.006 * y, RADIUS] for x in (-1, 1) for y in (-1, 1)],
        pair={"restitution": 0.1}, stages=stages, run={"velocity_max": 1.0}, gravity=[0.0] * 3,
        output={"interval": 1.0, "checkpoint": {"interval": 0.004}, "energy_budget": True, "wall_forces": True},
    )  # fmt: skip


def warned(scene, tmp_path, **options):
    """The warnings on servos at the end of a stage, in result.json after the run."""
    with Simulation(scene, out=tmp_path / "run", **options) as simulation:
        simulation.run()
    warnings = json.loads((tmp_path / "run" / "result.json").read_text())["warnings"]
    return [each for each in warnings if "at the end of stage" in each]


@pytest.mark.slow
def test_servo_that_never_touches_the_bed_is_reported_once(taichi_f64, tmp_path, caplog):
    """The stage press ends before the lid arrives; the servo is not active in the stage release."""
    with caplog.at_level(logging.WARNING, "granflow"):
        found = warned(lid_scene(0.003, 0.005, release=0.001), tmp_path)
    assert len(found) == 1 and found == [
        each for each in caplog.messages if "does not touch the particles" in each
    ]
    assert "walls.lid.motion" in found[0] and "stage press (0.005" in found[0]
    assert "0 N (0 Pa) instead of 0.5 N (312 Pa)" in found[0]
    assert (
        "less than velocity_max 0.5 m/s. Give it more time, a larger gain or a higher target force, start"
        in found[0]
    )


@pytest.mark.parametrize("is_reached", [True, False])
def test_servo_is_reported_if_it_still_approaches_its_target_also_by_a_resumed_run(
    taichi_f64, tmp_path, is_reached
):
    """With a gain so small that the force is still increasing at the end of the stage."""
    scene = lid_scene(0.0, 0.03, velocity_max=0.05) if is_reached else lid_scene(0.0, 0.01, gain=2e-4)
    whole = warned(scene, tmp_path)
    if is_reached:
        assert whole == []
    else:
        (sentence,) = whole
        assert 0.0 < float(sentence.split("target: ")[1].split(" N")[0]) < 0.95 * TARGET
        assert "less than velocity_max 0.5 m/s. Give it more time or a larger gain." in sentence
    shutil.move(tmp_path / "run", tmp_path / "whole")
    shutil.copytree(tmp_path / "whole", tmp_path / "run")
    saved = read_checkpoint(sorted((tmp_path / "run").glob("checkpoint_*.npz"))[0])
    assert saved.time > 0.0 and len(saved.saved["stage_progress"]["controls"]["samples"]) == 20
    assert warned(scene, tmp_path, resume=saved) == whole


def test_fluctuations_about_the_target_are_tolerated_and_a_deviation_of_the_mean_is_not(taichi_f64):
    """The force at the end is 0: off its target; the samples decide whether it fluctuates about it."""
    with Simulation(lid_scene(0.003, 0.005)) as simulation:
        simulation.run(until=0.004)
        about = [[TARGET * (1.0 + 0.5 * (-1) ** k)] for k in range(20)]
        below = [[0.6 * sample[0]] for sample in about]
        assert list(off_target(simulation.engine, "press", about)) == []
        (sentence,) = off_target(simulation.engine, "press", below)
    assert "is off its target: 0 N" in sentence
