"""A small run with frequent output for fault injection, and helpers to start, wait for and compare such
runs."""

import json
import os
import re
import subprocess
import sys
import time
from pathlib import Path

from resume.runs import files_of

FAULT_INJECTION = str(Path(__file__).with_name("fault_injection.py"))
START_TIMEOUT = 120.0
"""Longest wait [s] for the first frame of a process."""

SCENE = """\
title: Beads rain on a shaken floor
gravity: [0, 0, -9.81]
materials: {glass: {young_modulus: 10 MPa, poisson_ratio: 0.23, density: 2500}}
pairs: {glass-glass: {restitution: 0.8, friction: 0.4}}
contact: {normal: zhou, tangential: mindlin, rolling: none}
walls:
  floor:
    {shape: plane, point: [0, 0, 0], normal: [0, 0, 1], material: glass, stages: [pour],
    motion: {kind: vibration, direction: [0, 0, 1], amplitude: 1 mm, frequency: 50 Hz}}
particles:
  beads:
    material: glass
    count: 40
    diameter: 4 mm
    insert: {kind: rain, rate: 2000 1/s, region: {box: {min: [0, 0, 1 cm], max: [2 cm, 2 cm, 3 cm]}}}
domain: {min: [-3 cm, -3 cm, -1 cm], max: [5 cm, 5 cm, 4 cm], on_exit: delete}
stages: [{name: pour, duration: 40 ms}, {name: fall, duration: 40 ms}]
output:
  interval: 4 ms
  timeseries_interval: 1 ms
  contacts: true
  energy_budget: true
  flow_meters: {low: {point: [0, 0, 0], normal: [0, 0, -1]}}
  checkpoint: {interval: 3 ms}
numerics: {max_overlap: 0.4}
run: {velocity_max: 1 m/s}
"""


def granflow(home, *arguments, fault=("count", "-"), **options):
    """Runs the command line to its end in a separate process."""
    command = [sys.executable, FAULT_INJECTION, *fault, *arguments]
    return subprocess.run(
        command, cwd=home, capture_output=True, text=True, timeout=START_TIMEOUT * 2, **options
    )


def started(home, *arguments, **options):
    """Starts the command line in a separate process and returns the running process."""
    command = [sys.executable, "-m", "granflow", *arguments]
    return subprocess.Popen(
        command, cwd=home, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True, **options
    )


def wait_for(path, running):
    """Waits until a process has written a file or has ended."""
    deadline = time.monotonic() + START_TIMEOUT
    while not path.exists() and running.poll() is None and time.monotonic() < deadline:
        time.sleep(0.01)


def assert_complete(out, reference):
    """Asserts that a directory contains the files of the undisturbed run and no temporary files."""
    assert files_of(out) == files_of(reference)
    listed = {name for pvd in out.glob("*.pvd") for name in re.findall(r'file="([^"]+)"', pvd.read_text())}
    assert listed == {path.name for path in out.glob("*.vtu")}
    rows = (out / "timeseries.csv").read_text().splitlines()
    times = [float(row.split(",")[0]) for row in rows[1:]]
    assert times == sorted(set(times))
    assert not [path.name for path in out.iterdir() if path.name.endswith(".part")]
    assert json.loads((out / "result.json").read_text())["totals"]["inserted_count"] == 40
    assert os.path.getsize(out / "run.log") > 0
