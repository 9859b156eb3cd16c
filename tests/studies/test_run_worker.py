"""Workers carry out several runs one after the other, and a run that crashes ends its worker only."""

import json
import os
import signal
import sys
import time
from pathlib import Path

import pytest
from studies.sweep_files import SCENE

from granflow.studies import run_process as run_worker
from granflow.studies.run_process import (
    ABORTED,
    CRASHED,
    DONE,
    MISSED,
    REFUSED,
    RunRequest,
    close_workers,
    execute,
    worker,
)


@pytest.fixture(autouse=True)
def no_workers_are_left():
    yield
    close_workers()


@pytest.fixture
def stand_in(monkeypatch):
    monkeypatch.setattr(
        run_worker, "PROGRAM", (sys.executable, "-S", str(Path(__file__).with_name("stand_in.py")))
    )


def request(folder, name, **values):
    """A run of two spheres; `values`: of the pair."""
    (folder / "spheres.yaml").write_text(SCENE)
    settings = tuple(f"pairs.steel-steel.{key}={value}" for key, value in values.items())
    directory = folder / "runs" / name
    directory.mkdir(parents=True, exist_ok=True)
    return RunRequest(str(folder / "spheres.yaml"), settings, str(directory), 1, "cpu", str(folder / "stop"))


def pid():
    """Process of the worker that the next run takes."""
    with worker() as taken:
        return taken._process.pid


@pytest.mark.slow
def test_runs_of_one_worker_equal_runs_of_separate_processes(tmp_path):
    """Expectations that are missed and input errors leave the worker usable."""
    separate = request(tmp_path, "separate", friction=0.2)
    assert execute(separate).status == DONE
    close_workers()
    assert execute(request(tmp_path, "first", friction=0.3)).status == DONE
    process = pid()
    assert execute(request(tmp_path, "refused", friction=-1.0)).status == REFUSED
    assert execute(request(tmp_path, "missed", restitution=0.99)).status == MISSED
    assert execute(request(tmp_path, "again", friction=0.2)).status == DONE
    assert pid() == process
    results = [
        json.loads((tmp_path / "runs" / name / "result.json").read_text()) for name in ("separate", "again")
    ]
    for key in ("totals", "expect", "warnings"):
        assert results[0][key] == results[1][key]
    series = [(tmp_path / "runs" / name / "timeseries.csv").read_bytes() for name in ("separate", "again")]
    assert series[0] == series[1]
    assert results[1]["timings"]["compile"] < 0.3
    messages = {name: (tmp_path / "runs" / name / "stderr.txt").read_text() for name in ("refused", "again")}
    assert "friction is -1.0" in messages["refused"] and "friction" not in messages["again"]


def test_aborted_run_ends_its_worker(stand_in, tmp_path):
    assert execute(request(tmp_path, "first", friction=0.2, restitution=0.5)).status == DONE
    process = pid()
    assert execute(request(tmp_path, "aborted", friction=0.4, restitution=0.5)).status == ABORTED
    assert execute(request(tmp_path, "next", friction=0.2, restitution=0.5)).status == DONE
    assert pid() != process


def test_crash_concerns_one_run_only(stand_in, tmp_path):
    assert execute(request(tmp_path, "first", friction=0.2, restitution=0.5)).status == DONE
    process = pid()
    (tmp_path / "wait").touch()

    def kill():
        if (tmp_path / "starts.txt").read_text().count("crashed"):
            os.kill(process, signal.SIGKILL)
        return False

    outcome = execute(request(tmp_path, "crashed", friction=0.2, restitution=0.5), kill)
    assert (outcome.status, outcome.is_lost) == (CRASHED, True)
    assert outcome.reason == "The process was ended by SIGKILL."
    (tmp_path / "wait").unlink()
    assert execute(request(tmp_path, "next", friction=0.2, restitution=0.5)).status == DONE


def test_worker_that_was_killed_while_idle_is_replaced(stand_in, tmp_path):
    execute(request(tmp_path, "first", friction=0.2, restitution=0.5))
    os.kill(pid(), signal.SIGKILL)
    time.sleep(0.1)
    assert execute(request(tmp_path, "next", friction=0.2, restitution=0.5)).status == DONE


def test_worker_ends_without_commands(monkeypatch):
    """It serves a driver that is gone, such as a worker of Dask after the end of a sweep."""
    monkeypatch.setattr(run_worker, "IDLE_SECONDS", 0.05)
    with worker() as taken:
        assert taken._process.wait(20.0) == 0
