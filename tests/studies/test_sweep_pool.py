"""Sweeps from end to end, with a program that replaces the runs: local pool, Dask, stop, continuation."""

import csv
import os
import signal
import subprocess
import sys
import threading
import time
from contextlib import ExitStack

import pytest
from studies.conftest import STAND_IN
from studies.sweep_files import SWEEP, write_sweep

from granflow.studies.run_pool import Workers
from granflow.studies.sweep import SweepStopped, read_sweep, run_sweep

STATUSES = ["done"] * 3 + ["aborted"] + ["expectation missed"] * 3 + ["aborted"] + ["refused"] * 4


@pytest.fixture
def sweep(tmp_path, monkeypatch, stand_in):
    monkeypatch.chdir(tmp_path)
    return read_sweep(write_sweep(tmp_path, SWEEP).name)


def wait_after(out, count):
    """Let each run wait once a number of runs have results; stated before the first run starts."""
    out.mkdir()
    (out / "wait").write_text(str(count))


def rows(out):
    with open(out / "sweep.csv", newline="") as file:
        return [
            {name: cell for name, cell in row.items() if name != "seconds"} for row in csv.DictReader(file)
        ]


def starts(out):
    file = out / "starts.txt"
    return file.read_text().splitlines() if file.exists() else []


def test_sweep_with_an_abort_and_a_refusal_has_twelve_rows_and_repeats_nothing(sweep, tmp_path):
    out = tmp_path / "out"
    events = []
    assert not run_sweep(
        sweep, out, Workers(jobs=2), report=lambda _, event: events.append(event)
    ).is_complete
    found = rows(out)
    assert [row["status"] for row in found] == STATUSES
    assert [row["kinetic_energy [J]"] for row in found[:3]] == [
        repr(0.5 + k) for k in (0.1, 0.2, 0.30000000000000004)
    ]
    assert (
        found[0]["rotational_energy [J]"] == ""
        and found[3]["reason"] == f"Stopped: overlap above the limit. State in runs/{found[3]['runs']}."
    )
    assert "1, but should be below 1." in found[4]["reason"] and len(starts(out)) == 8
    assert found[0]["reason"] == f"runs/{found[0]['runs']}: rotational_energy is NaN."
    assert [row["warnings"] for row in found] == ["A wall has moved away."] * 3 + [""] + [
        "A wall has moved away."
    ] * 3 + [""] * 5
    run_sweep(sweep, out, Workers(jobs=2))
    assert rows(out) == found and len(starts(out)) == 8
    text = f"steel-steel.restitution = 0.5, steel-steel.friction = 0.1 ({found[0]['runs']}) done"
    assert events.count(text) == 1


def test_stopped_sweep_resumes_from_checkpoints_to_the_same_table(sweep, tmp_path):
    out = tmp_path / "out"
    whole = tmp_path / "whole"
    run_sweep(sweep, whole, Workers(jobs=1))
    stop = threading.Event()
    wait_after(out, 2)

    def hold_and_stop():
        """After two results, the next run waits; then the sweep is stopped."""
        while len(starts(out)) < 3:
            time.sleep(0.01)
        time.sleep(0.3)
        stop.set()

    thread = threading.Thread(target=hold_and_stop)
    thread.start()
    run_sweep(sweep, out, Workers(jobs=1), stop=stop)
    thread.join()
    before = {path: path.stat().st_mtime_ns for path in (out / "runs").glob("*/result.json")}
    assert "not run" in {row["status"] for row in rows(out)}
    (out / "wait").unlink()
    run_sweep(sweep, out, Workers(jobs=1))
    assert rows(out) == rows(whole)
    assert {path: path.stat().st_mtime_ns for path in before} == before
    assert [line.split()[0] for line in starts(out)].count("resume") == 1


def test_run_whose_scene_was_edited_after_its_check_is_not_kept(sweep, tmp_path):
    """The scene is edited after the first result: the other runs would have the results of another scene."""
    out = tmp_path / "out"
    scene = tmp_path / "spheres.yaml"
    original = scene.read_text()

    def edit(_, event):
        if event.endswith("done"):
            scene.write_text(original.replace("8000", "9000"))

    run_sweep(sweep, out, Workers(jobs=1), report=edit)
    found = rows(out)
    assert [row["status"] for row in found[:8]] == ["done"] + ["not run"] * 7
    assert found[1]["reason"] == f"{scene} has changed since the run was checked; repeat the command."
    assert [path.parent.name for path in (out / "runs").glob("*/result.json")] == [found[0]["runs"]]
    run_sweep(sweep, out, Workers(jobs=1))
    again = rows(out)
    assert [row["status"] for row in again] == STATUSES and again[0]["runs"] != found[0]["runs"]


def test_a_run_with_a_truncated_result_is_repeated(sweep, tmp_path):
    content = '{"run": {"wall_clock": 1.0'
    out = tmp_path / "out"
    run_sweep(sweep, out, Workers(jobs=1))
    before = rows(out)
    count = len(starts(out))
    (out / "runs" / before[0]["runs"] / "result.json").write_text(content)
    (out / "runs" / before[3]["runs"] / "outcome.json").write_text(content)
    run_sweep(sweep, out, Workers(jobs=1))
    assert rows(out) == before and len(starts(out)) == count + 2


def test_run_waits_for_a_process_that_still_writes_into_its_directory(sweep, tmp_path):
    """A lost worker may leave its run behind: the run is not started twice, its result is used."""
    from granflow.io.lock import locked

    out = tmp_path / "out"
    run_sweep(sweep, out, Workers(jobs=1))
    directory = out / "runs" / rows(out)[0]["runs"]
    result = (directory / "result.json").read_text()
    (directory / "result.json").unlink()
    count = len(starts(out))

    def orphan():
        with locked(directory):
            held.set()
            time.sleep(1.0)
            (directory / "result.json").write_text(result)

    held = threading.Event()
    thread = threading.Thread(target=orphan)
    thread.start()
    held.wait()
    events = []
    run_sweep(sweep, out, Workers(jobs=1), report=lambda _, event: events.append(event))
    thread.join()
    assert events[1].startswith(f"runs/{directory.name} is carried out by process {os.getpid()} on ")
    assert len(starts(out)) == count and rows(out)[0]["status"] == "done"


DRIVER = f"""
import signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell ignores it in background jobs, such as these tests
from granflow.cli.main import main
from granflow.studies import run_process
run_process.PROGRAM = {STAND_IN!r}
sys.exit(main(sys.argv[1:]))
"""
"""Program of a process with the command line, in which the stand-in replaces the runs."""


def driver(folder, out, *arguments):
    command = [sys.executable, "-c", DRIVER, "sweep", "sweep.yaml", "--out", str(out), *arguments]
    return subprocess.Popen(command, cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)


def results_before_waiting(out, process):
    """Time stamps of the results once the next run waits."""
    count = int((out / "wait").read_text())
    while len(starts(out)) <= count:
        assert process.poll() is None, process.stderr.read()
        time.sleep(0.01)
    time.sleep(0.5)
    return {path: path.stat().st_mtime_ns for path in (out / "runs").glob("*/result.json")}


def test_killed_sweep_continues_to_the_same_table(sweep, tmp_path):
    """The driver and its run are killed by SIGKILL."""
    out = tmp_path / "out"
    run_sweep(sweep, tmp_path / "whole", Workers(jobs=1))
    wait_after(out, 2)
    first = driver(tmp_path, out, "--jobs", "1")
    before = results_before_waiting(out, first)
    running = subprocess.run(["pgrep", "-P", str(first.pid)], capture_output=True, text=True).stdout.split()
    assert len(running) == 1
    for each in (first.pid, *map(int, running)):
        os.kill(each, signal.SIGKILL)
    first.wait()
    (out / "wait").unlink()
    second = driver(tmp_path, out, "--jobs", "1")
    assert second.wait(100) == 1, second.stderr.read()
    assert {path: path.stat().st_mtime_ns for path in before} == before
    assert rows(out) == rows(tmp_path / "whole")


def test_stop_signal_leaves_a_table_and_a_checkpoint(sweep, tmp_path):
    out = tmp_path / "out"
    wait_after(out, 1)
    process = driver(tmp_path, out, "--jobs", "1")
    results_before_waiting(out, process)
    process.send_signal(signal.SIGINT)
    _, messages = process.communicate(timeout=60)
    assert process.returncode == 130 and "repeating the command continues it" in messages
    assert "not run" in {row["status"] for row in rows(out)}
    assert len(list((out / "runs").glob("*/checkpoint_1.npz"))) == 1


def test_stop_ends_the_check_of_many_points(sweep, tmp_path):
    stop = threading.Event()
    stop.set()
    with pytest.raises(SweepStopped, match="0 of 12 points are checked, and no run has begun"):
        run_sweep(sweep, tmp_path / "out", Workers(jobs=1), stop=stop)


@pytest.mark.slow
def test_external_scheduler_gives_the_same_table_although_a_worker_is_killed(sweep, tmp_path):
    """Scheduler and workers are processes of their own; the first worker and its run are killed during the
    run."""
    pytest.importorskip("distributed")
    run_sweep(sweep, tmp_path / "local", Workers(jobs=1))
    out = tmp_path / "out"
    file = tmp_path / "scheduler.json"
    preload = tmp_path / "preload.py"
    preload.write_text(
        DRIVER.replace("sys.exit(main(sys.argv[1:]))", "").replace("from granflow.cli.main import main", "")
    )
    dask = [sys.executable, "-m", "dask"]
    where = ["--scheduler-file", str(file)]
    worker = [
        *dask,
        "worker",
        *where,
        "--nthreads",
        "1",
        "--no-nanny",
        "--no-dashboard",
        "--preload",
        str(preload),
    ]
    with ExitStack() as stack:
        scheduler = started(stack, [*dask, "scheduler", *where, "--port", "0", "--no-dashboard"], tmp_path)
        while not file.exists():
            assert scheduler.poll() is None
            time.sleep(0.1)
        first = started(stack, worker, tmp_path)
        with distributed_client(file) as client:
            client.wait_for_workers(1, timeout=100)
        wait_after(out, 2)
        process = driver(tmp_path, out, *where)
        before = results_before_waiting(out, process)
        running = subprocess.run(
            ["pgrep", "-P", str(first.pid)], capture_output=True, text=True
        ).stdout.split()
        for each in (first.pid, *map(int, running)):
            os.kill(each, signal.SIGKILL)
        (out / "wait").unlink()
        started(stack, worker, tmp_path)
        assert process.wait(200) == 1, process.stderr.read()
    assert {path: path.stat().st_mtime_ns for path in before} == before
    assert rows(out) == rows(tmp_path / "local")


def started(stack, command, folder):
    """A process that ends with the stack."""
    process = subprocess.Popen(command, cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    stack.callback(process.wait)
    stack.callback(process.terminate)
    return process


def distributed_client(file):
    from distributed import Client

    return Client(scheduler_file=str(file))


def test_workers_of_dask_give_the_same_table(sweep, tmp_path):
    distributed = pytest.importorskip("distributed")
    run_sweep(sweep, tmp_path / "local", Workers(jobs=1))
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, processes=False, dashboard_address=None
    ) as cluster:
        run_sweep(sweep, tmp_path / "dask", Workers(scheduler=cluster.scheduler_address))
    assert rows(tmp_path / "dask") == rows(tmp_path / "local")


def test_unreachable_scheduler_is_refused(sweep, tmp_path, monkeypatch):
    pytest.importorskip("distributed")
    from granflow.errors import GranflowError
    from granflow.studies import run_pool as executors

    monkeypatch.setattr(executors, "CONNECT_TIMEOUT", 0.5)
    with pytest.raises(GranflowError, match="The scheduler tcp://127.0.0.1:9 does not answer"):
        run_sweep(sweep, tmp_path / "out", Workers(scheduler="tcp://127.0.0.1:9"))
