"""Static types of the public names, as a type checker of a user sees them."""

import subprocess
import sys
from pathlib import Path

import pytest

import granflow as gf

ROOT = Path(__file__).resolve().parents[2]
PROGRAM = """\
import numpy as np
import granflow as gf

def report(snapshot: gf.Snapshot) -> None:
    print(snapshot.time, snapshot.totals["kinetic_energy"], snapshot.particles["velocity"][:, 2].min())

scene: gf.Scene = gf.load_scene("beads.yaml", ["run.duration=2"])
wall = gf.Plane(material="glass", point=[0, 0, 0], normal=[0, 0, 1])
observer = gf.on_interval("1 ms", report)
with gf.Simulation(scene, precision="mixed", threads=2, out="out", observers=[observer]) as simulation:
    particles = simulation.particles
    ids = particles.add(position=np.zeros((3, 3)), diameter=0.004, velocity=[0, 0, 1])
    result: gf.Result = simulation.run(until=0.2)
    particles.velocity[particles.group == "feed"] *= 0.5
    particles.velocity = np.zeros((3, 3))
    particles.remove(particles.position[:, 0] < 0)
    simulation.walls["gate"].motion = [gf.Translation(velocity=[0, 0, 1])]
    snapshot: gf.Snapshot = simulation.snapshot(contacts=True)
run: gf.Run = gf.read_run("out")
print(run.status, run.timeseries_arrays["time"][-1], run.frames[-1].time, run.result and run.result.totals)
"""
WRONG = """\
import granflow as gf
gf.Scene.from_dict(1)
gf.Plane(material='glass')
gf.read_run(1)
gf.Simulation('a.yaml')
"""


@pytest.mark.slow
def test_programs_of_users_pass_a_strict_type_check(tmp_path):
    """`mypy --strict` with the plugin of pydantic; a wrong program has errors in each line, no public name is
    Any."""
    (tmp_path / "mypy.ini").write_text("[mypy]\nplugins = pydantic.mypy\nfollow_imports = silent\n")
    names = "\n".join(f"reveal_type(gf.{name})" for name in gf.__all__)
    (tmp_path / "names.py").write_text(f"from typing import reveal_type\nimport granflow as gf\n{names}\n")
    (tmp_path / "program.py").write_text(PROGRAM)
    (tmp_path / "wrong.py").write_text(WRONG)
    command = [sys.executable, "-m", "mypy", "--strict", "--config-file", "mypy.ini", "--cache-dir", "cache"]
    environment = {"MYPYPATH": str(ROOT), "PATH": ""}
    done = subprocess.run(
        [*command, "program.py", "names.py", "wrong.py"],
        capture_output=True, text=True, cwd=tmp_path, env=environment,
    )  # fmt: skip
    lines = done.stdout.splitlines()
    errors = {":".join(line.split(":")[:2]) for line in lines if ": error: " in line}
    assert errors == {f"wrong.py:{number}" for number in (2, 3, 4, 5)}, done.stdout
    revealed = [line for line in lines if "Revealed type" in line]
    assert len(revealed) == len(gf.__all__) and not any('is "Any"' in line for line in revealed), done.stdout
