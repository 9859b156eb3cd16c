"""Sweeps with real runs: complete, from Python, and continued after a kill."""

import csv
import os
import signal
import subprocess
import sys
import time

import pytest
from studies.sweep_files import SCENE, SWEEP, write_sweep

pytestmark = [pytest.mark.slow, pytest.mark.timeout(3000)]

TWELVE = """\
scene: spheres.yaml
vary:
  pairs.steel-steel.restitution: [0.5, 0.9, 1.2]
  pairs.steel-steel.friction: {values: [0.1, 0.2, 0.3, 0.4], with: {numerics.max_overlap: [0.1, 0.1, 0.1, 1e-6]}}
read: [kinetic_energy, rotational_energy]
"""
"""Twelve points: a restitution of 1.2 is refused, and a run with the last friction is aborted by the overlap
limit."""


def granflow(folder, *arguments, check=True):
    command = [sys.executable, "-m", "granflow", *arguments]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=2500)
    assert "Traceback" not in done.stderr, done.stderr
    return done


def table(folder, out):
    """Rows of the table without the wall-clock times, which differ from run to run."""
    with open(folder / out / "sweep.csv", newline="") as file:
        return [
            {name: cell for name, cell in row.items() if name != "seconds"} for row in csv.DictReader(file)
        ]


@pytest.fixture(scope="module")
def home(tmp_path_factory):
    """Folder with a sweep of twelve points, and its exit code with the local pool."""
    folder = tmp_path_factory.mktemp("sweep")
    write_sweep(folder, TWELVE)
    return folder, granflow(folder, "sweep", "sweep.yaml", "--out", "local").returncode


def test_sweep_has_a_row_for_each_point_and_a_nonzero_exit_code(home):
    folder, code = home
    rows = table(folder, "local")
    assert code == 1 and len(rows) == 12
    assert [row["status"] for row in rows] == [
        "done", "done", "done", "aborted",
        "expectation missed", "expectation missed", "expectation missed", "aborted", *["refused"] * 4,
    ]  # fmt: skip
    assert "numerics.max_overlap" in rows[3]["reason"] and "but should be below 0.0015" in rows[4]["reason"]
    assert "sweep.yaml:3:3: pairs.steel-steel.restitution is 1.2" in rows[-1]["reason"]
    assert (folder / "local" / "sweep.html").stat().st_size > 10_000


def test_sweep_from_python_returns_the_table(home, monkeypatch):
    pytest.importorskip("pandas")
    import granflow as gf

    folder, _ = home
    monkeypatch.chdir(folder)
    found = gf.sweep("sweep.yaml", out="local")
    assert len(found) == 12 and list(found["status"]).count("refused") == 4
    assert found["kinetic_energy [J]"].notna().sum() == 6


def test_killed_run_resumes_from_its_checkpoint(tmp_path):
    """A run that was killed after its first checkpoint gives the same numbers as an undisturbed run."""
    long = SCENE.replace("duration: 2 ms", "duration: 0.1 s").replace(
        "walls: false", "walls: false, checkpoint: {interval: 5 ms}"
    )
    path = write_sweep(
        tmp_path, SWEEP.replace("[0.5, 0.9, 1.2]", "[0.5]").replace("count: 4", "count: 2"), long
    )
    command = [sys.executable, "-m", "granflow", "sweep", path.name, "--out", "killed", "--jobs", "1"]
    driver = subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    while not any((tmp_path / "killed" / "runs").glob("[0-9a-f]*/checkpoint_*.npz")):
        assert driver.poll() is None
        time.sleep(0.05)
    workers = subprocess.run(["pgrep", "-P", str(driver.pid)], capture_output=True, text=True).stdout.split()
    for process in (driver.pid, *map(int, workers)):
        os.kill(process, signal.SIGKILL)
    driver.wait()
    for out in ("killed", "whole"):
        granflow(tmp_path, "sweep", path.name, "--out", out)
    assert table(tmp_path, "killed") == table(tmp_path, "whole")
    assert "resumed from" in "".join(
        each.read_text() for each in (tmp_path / "killed" / "runs").glob("*/run.log")
    )
