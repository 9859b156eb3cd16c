"""Sweeps with runs: complete, killed and continued, on a local pool and on Dask; calibration of planted
values."""

import csv
import os
import signal
import subprocess
import sys
import time

import pytest
from studies.sweep_files import SCENE, SWEEP, write_sweep

from granflow.io.lock import locked

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


def results(folder, out):
    """Time stamps of the results of the completed runs."""
    return {
        path.parent.name: path.stat().st_mtime_ns for path in (folder / out / "runs").glob("*/result.json")
    }


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


def test_same_command_repeats_no_run(home):
    folder, _ = home
    before = results(folder, "local")
    rows = table(folder, "local")
    assert granflow(folder, "sweep", "sweep.yaml", "--out", "local").returncode == 1
    assert results(folder, "local") == before and table(folder, "local") == rows


def test_killed_sweep_continues_to_the_same_table(home):
    """The driver and all its runs are killed after the second result."""
    folder, _ = home
    command = [sys.executable, "-m", "granflow", "sweep", "sweep.yaml", "--out", "killed", "--jobs", "1"]
    driver = subprocess.Popen(command, cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    while len(results(folder, "killed")) < 2:
        assert driver.poll() is None, "the sweep was over before it could be killed"
        time.sleep(0.1)
    before = results(folder, "killed")
    workers = subprocess.run(["pgrep", "-P", str(driver.pid)], capture_output=True, text=True).stdout.split()
    for process in (driver.pid, *map(int, workers)):
        os.kill(process, signal.SIGKILL)
    driver.wait()
    assert granflow(folder, "sweep", "sweep.yaml", "--out", "killed").returncode == 1
    after = results(folder, "killed")
    assert {name: after[name] for name in before} == before
    assert table(folder, "killed") == table(folder, "local")


def test_interrupted_sweep_stops_with_a_table_and_continues(home):
    """The third run cannot start, because its directory is locked; then the sweep is stopped."""
    folder, _ = home
    third = folder / "stopped" / "runs" / table(folder, "local")[2]["runs"]
    third.mkdir(parents=True)
    command = [sys.executable, "-m", "granflow", "sweep", "sweep.yaml", "--out", "stopped", "--jobs", "1"]
    with locked(third):
        driver = subprocess.Popen(
            command, cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
        )
        while len(results(folder, "stopped")) < 2:
            assert driver.poll() is None
            time.sleep(0.1)
        driver.send_signal(signal.SIGINT)
        _, messages = driver.communicate(timeout=300)
    assert driver.returncode == 130 and "repeating the command continues it" in messages
    assert "not run" in {row["status"] for row in table(folder, "stopped")}
    granflow(folder, "sweep", "sweep.yaml", "--out", "stopped")
    assert table(folder, "stopped") == table(folder, "local")


def test_dask_cluster_gives_the_same_table(home):
    distributed = pytest.importorskip("distributed")
    folder, _ = home
    with distributed.LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=None) as cluster:
        address = cluster.scheduler_address
        done = granflow(folder, "sweep", "sweep.yaml", "--out", "dask", "--scheduler", address)
    assert done.returncode == 1, done.stderr
    assert table(folder, "dask") == table(folder, "local")


def test_external_scheduler_gives_the_same_table_although_a_worker_is_killed(home, tmp_path):
    """The scheduler and its workers are separate processes; the first worker is killed during a run."""
    pytest.importorskip("distributed")
    folder, _ = home
    file = tmp_path / "scheduler.json"
    start = [sys.executable, "-m", "dask"]
    where = ["--scheduler-file", str(file)]
    worker = [*start, "worker", *where, "--nthreads", "1", "--no-nanny", "--no-dashboard"]
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    processes = [
        subprocess.Popen(
            [*start, "scheduler", *where, "--port", "0", "--no-dashboard"], cwd=tmp_path, **quiet
        ),
        subprocess.Popen(worker, cwd=tmp_path, **quiet),
    ]
    try:
        time.sleep(20.0)
        command = [sys.executable, "-m", "granflow", "sweep", "sweep.yaml", "--out", "external", *where]
        driver = subprocess.Popen(
            command, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        while not results(folder, "external"):
            assert driver.poll() is None, driver.communicate()
            time.sleep(0.1)
        processes[1].kill()
        processes.append(subprocess.Popen(worker, cwd=tmp_path, **quiet))
        output, messages = driver.communicate(timeout=2000)
    finally:
        for process in reversed(processes):
            process.terminate()
            process.wait()
    assert driver.returncode == 1, output + messages
    assert table(folder, "external") == table(folder, "local")


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
