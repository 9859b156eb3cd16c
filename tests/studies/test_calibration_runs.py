"""Calibrations with runs: planted parameters are found, and a parameter without influence is reported."""

import csv
import json
import subprocess
import sys

import pytest

pytestmark = [pytest.mark.slow, pytest.mark.timeout(7200)]


SPHERES = """\
title: A sliding and a rolling sphere
gravity: [0, 0, -9.81]
materials: {ball: {young_modulus: 100 MPa, poisson_ratio: 0.3, density: 10000}}
pairs: {ball-ball: {restitution: 0.9, friction: 0.2, rolling_friction: 0.02}}
contact: {normal: zhou, tangential: mindlin, rolling: cdt}
walls:
  floor: {shape: plane, point: [0, 0, 0], normal: [0, 0, 1], material: ball}
particles:
  balls:
    material: ball
    diameter: 1 mm
    velocity: [[0.1, 0, 0], [0.4, 0, 0]]
    angular_velocity: [[0, 200, 0], [0, 0, 0]]
    insert: {kind: positions, positions: [[0, 0, 0.4999005630 mm], [0, 3 mm, 0.4999005630 mm]]}
domain: {min: [-2 mm, -2 mm, -1 mm], max: [30 mm, 5 mm, 3 mm], on_exit: error}
run: {duration: 10 ms, velocity_max: 0.01 m/s}
output: {interval: 2 ms, energy_budget: true, particles: false, walls: false}
"""
"""One sphere slides and dissipates energy by friction, the other rolls against the rolling torque."""

PLANTED = {"friction": 0.37, "rolling_friction": 0.031}

CALIBRATION = """\
scenes: {{plane: {{scene: spheres.yaml}}}}
parameters:
  friction: {{keys: pairs.ball-ball.friction, from: 0.05, to: 0.8}}
  rolling_friction: {{keys: pairs.ball-ball.rolling_friction, from: 0.002, to: 0.2, scale: log}}
targets:
  sliding: {{scene: plane, quantity: friction_dissipation, value: {sliding!r}, tolerance: {sliding_tolerance!r}}}
  rolling: {{scene: plane, quantity: rolling_dissipation, value: {rolling!r}, tolerance: {rolling_tolerance!r}}}
search: {{trials: {trials}}}
"""

ANGLE = """\
scenes:
  heap:
    scene: {scene}
    set:
      expect: []
      output.interval: 0.1 s
      output.particles: false
      stages.0.duration: 0.15 s
      stages.1.duration: 0.6 s
{reduced}
parameters:
  restitution: {{keys: pairs.glass-glass.restitution, from: 0.3, to: 0.9}}
targets:
  angle: {{scene: heap, quantity: angle_of_repose.left, value: 25 deg, tolerance: 2 deg}}
search: {{trials: 12}}
"""


def granflow(folder, *arguments):
    done = subprocess.run(
        [sys.executable, "-m", "granflow", *arguments],
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=7000,
    )
    assert "Traceback" not in done.stderr, done.stderr
    return done


def rows(path):
    with open(path, newline="") as file:
        return list(csv.DictReader(file))


def planted(folder, trials):
    """Write the calibration whose targets are the results of a run with the planted parameters, within 1
    %."""
    (folder / "spheres.yaml").write_text(SPHERES)
    values = [f"--set=pairs.ball-ball.{name}={value}" for name, value in PLANTED.items()]
    assert granflow(folder, "run", "spheres.yaml", *values, "--threads", "1").returncode == 0
    totals = json.loads((folder / "out" / "spheres" / "result.json").read_text())["totals"]
    sliding = totals["friction_dissipation"]
    rolling = totals["rolling_dissipation"]
    text = CALIBRATION.format(
        sliding=sliding, sliding_tolerance=0.01 * sliding, rolling=rolling, rolling_tolerance=0.01 * rolling,
        trials=trials,
    )  # fmt: skip
    (folder / "calibration.yaml").write_text(text)


def test_planted_friction_and_rolling_friction_are_found_within_5_percent(tmp_path):
    pytest.importorskip("optuna")
    planted(tmp_path, 40)
    done = granflow(tmp_path, "calibrate", "calibration.yaml", "--jobs", "2")
    assert done.returncode == 0, done.stdout + done.stderr
    best = {row["parameter"]: row for row in rows(tmp_path / "out" / "calibration" / "best.csv")}
    for name, value in PLANTED.items():
        assert float(best[name]["value"]) == pytest.approx(value, rel=0.05)
        assert best[name]["identified"] == "True"
    assert granflow(tmp_path, "check", "out/calibration/best.yaml").returncode == 0
