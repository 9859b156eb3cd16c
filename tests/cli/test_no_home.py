"""Commands run without the environment variable HOME."""

import os
import subprocess
import sys


def test_run_succeeds_without_home(tmp_path):
    scene = tmp_path / "ball.yaml"
    scene.write_text(SCENE)
    environment = {name: value for name, value in os.environ.items() if name != "HOME"}
    command = [sys.executable, "-m", "granflow", "run", str(scene), "--out", str(tmp_path / "out")]
    finished = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=100)
    assert finished.returncode == 0, finished.stderr
    assert (tmp_path / "out" / "result.json").exists()


SCENE = """\
title: A ball on a floor
gravity: [0, 0, -9.81]
materials: {glass: {preset: glass}}
pairs: {glass-glass: {restitution: 0.8, friction: 0.3, rolling_friction: 0}}
contact: {normal: zhou, tangential: mindlin, rolling: none, cohesion: none}
walls: {floor: {shape: plane, point: [0, 0, 0], normal: [0, 0, 1], material: glass}}
particles: {ball: {material: glass, diameter: 4 mm, insert: {kind: positions, positions: [[0, 0, 0.01]]}}}
domain: {min: [-0.1, -0.1, -0.1], max: [0.1, 0.1, 0.1], on_exit: delete}
run: {duration: 10 ms}
output: {interval: 5 ms}
"""
