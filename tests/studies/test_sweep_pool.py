"""Sweeps from end to end, with a program that replaces the runs, and one with real runs."""

import csv
import os
import shutil
import signal
import subprocess
import sys
import time

import pytest
from studies.conftest import STAND_IN
from studies.sweep_files import write_sweep

import granflow as gf
from granflow.cli.main import main
from granflow.studies import run_process, sweep
from granflow.studies.run_pool import Workers
from granflow.studies.sweep import read_sweep, run_sweep

GRANFLOW, PAGE = run_process.PROGRAM, sweep.write_sweep_page
STATUSES = ["done", "aborted", "expectation missed", "aborted", "refused", "refused"]


@pytest.fixture(scope="module")
def home(tmp_path_factory):
    """The current folder, with sweep.yaml, and `whole`, the directory of its uninterrupted execution; without the
    page, whose figures take longer than the runs."""
    folder = tmp_path_factory.mktemp("sweep")
    write_sweep(folder)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.setattr(run_process, "PROGRAM", STAND_IN)
        patch.setattr(sweep, "write_sweep_page", lambda *_: None)
        executed(folder / "whole", jobs=2)
        yield folder


def executed(out, jobs=1):
    """Execute or continue the sweep."""
    run_sweep(read_sweep("sweep.yaml"), out, Workers(jobs=jobs), report=lambda *_: None)


def rows(out):
    """The table, without wall-clock times."""
    with open(out / "sweep.csv", newline="") as file:
        return [
            {name: cell for name, cell in row.items() if name != "seconds"} for row in csv.DictReader(file)
        ]


def starts(out):
    file = out / "starts.txt"
    return file.read_text().splitlines() if file.exists() else []


def results(out):
    """Time stamps of the results."""
    return {path: path.stat().st_mtime_ns for path in (out / "runs").glob("*/result.json")}


def test_sweep_with_aborts_and_refusals_has_all_rows_and_repeats_nothing(home):
    out = home / "whole"
    found = rows(out)
    assert [row["status"] for row in found] == STATUSES
    assert [row["kinetic_energy [J]"] for row in found] == ["0.6", "", "1.0", "", "", ""]
    assert found[0]["rotational_energy [J]"] == "" and "rotational_energy is NaN" in found[0]["reason"]
    assert found[1]["reason"].startswith("Stopped: overlap above the limit.")
    assert "1, but should be below 1." in found[2]["reason"]
    assert [bool(row["warnings"]) for row in found] == [status.startswith(("d", "e")) for status in STATUSES]
    executed(out)
    assert rows(out) == found and len(starts(out)) == 4


def test_parts_carry_out_their_runs_and_the_whole_sweep_writes_the_same_table(home, capsys):
    """4 of 6 points have a run: part 1 of 3 has two, parts 2 and 3 one."""
    out = home / "parts"
    command = ["sweep", "sweep.yaml", "--out", str(out)]
    assert main([*command, "--dry-run"]) == 1, "refused points"
    assert "4 runs are to do, 0 have ended, 2 are refused." in capsys.readouterr().out and not starts(out)
    for number, count in ((3, 1), (1, 3)):
        main([*command, "--jobs", "2", "--part", f"{number}/3"])
        assert len(starts(out)) == count and not (out / "sweep.csv").exists()
    assert f"State in {out}/runs/" in capsys.readouterr().out
    executed(out)
    assert len(starts(out)) == 4 and rows(out) == rows(home / "whole")


def test_run_whose_scene_was_edited_after_its_check_is_not_kept(home, tmp_path, monkeypatch):
    """The scene is edited after the first result: the other runs would have the results of another scene."""
    monkeypatch.chdir(tmp_path)
    write_sweep(tmp_path)
    out = tmp_path / "out"
    scene = tmp_path / "spheres.yaml"

    def edit(_, event):
        if event.endswith("done"):
            scene.write_text(scene.read_text().replace("8000", "9000"))

    run_sweep(read_sweep("sweep.yaml"), out, Workers(jobs=1), report=edit)
    found = rows(out)
    assert [row["status"] for row in found[:4]] == ["done"] + ["not run"] * 3
    assert [path.parent.name for path in results(out)] == [found[0]["runs"]]
    executed(out)
    again = rows(out)
    assert [row["status"] for row in again] == STATUSES and again[0]["runs"] != found[0]["runs"]


def test_runs_with_truncated_files_are_repeated(home):
    out = shutil.copytree(home / "whole", home / "truncated")
    before = rows(out)
    for row, name in ((before[0], "result.json"), (before[1], "outcome.json")):
        (out / "runs" / row["runs"] / name).write_text('{"run": {"wall_clock": 1.0')
    executed(out)
    assert rows(out) == before and len(starts(out)) == 4 + 2


DRIVER = f"""
import signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell ignores it in background jobs, such as these tests
from granflow.cli.main import main
from granflow.studies import run_process, sweep
run_process.PROGRAM = {STAND_IN!r}
sweep.write_sweep_page = lambda *_: None
sys.exit(main(sys.argv[1:]))
"""
"""Program of a process with the command line, in which the stand-in replaces the runs."""


def driver_of_waiting_run(out, count):
    """A process with the command line whose run waits, as `count` runs have results."""
    (out / "wait").write_text(str(count))
    before = len(starts(out))
    process = subprocess.Popen(
        [sys.executable, "-c", DRIVER, "sweep", "sweep.yaml", "--out", str(out), "--jobs", "1"],
        stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    while len(results(out)) < count or len(starts(out)) == before:
        assert process.poll() is None, process.stderr.read()
        time.sleep(0.01)
    time.sleep(0.5)
    return process


def test_killed_and_stopped_sweep_continues_to_the_same_table(home):
    """Driver and run are killed by SIGKILL; their continuation is stopped by SIGINT, then continued again."""
    out = home / "killed"
    out.mkdir()
    killed = driver_of_waiting_run(out, 1)
    running = subprocess.run(["pgrep", "-P", str(killed.pid)], capture_output=True, text=True).stdout.split()
    assert len(running) == 1
    for each in (killed.pid, *map(int, running)):
        os.kill(each, signal.SIGKILL)
    killed.wait()
    first = results(out)
    stopped = driver_of_waiting_run(out, 1)
    stopped.send_signal(signal.SIGINT)
    _, messages = stopped.communicate(timeout=60)
    assert stopped.returncode == 130 and "repeating the command continues it" in messages
    assert "not run" in {row["status"] for row in rows(out)}
    assert len(list((out / "runs").glob("*/checkpoint_1.npz"))) == 1
    second = results(out)
    assert len(first) == 1 and second == first
    (out / "wait").unlink()
    executed(out)
    assert rows(out) == rows(home / "whole") and results(out).items() >= second.items()
    assert [line.split()[0] for line in starts(out)].count("resume") == 1


def test_workers_of_dask_give_the_same_table(home):
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, processes=False, dashboard_address=None
    ) as cluster:
        run_sweep(read_sweep("sweep.yaml"), home / "dask", Workers(scheduler=cluster.scheduler_address))
    assert rows(home / "dask") == rows(home / "whole")


def test_sweep_from_python_with_real_runs(tmp_path, monkeypatch):
    """One run misses its expectation, the other one is aborted by the overlap limit."""
    pytest.importorskip("pandas")
    monkeypatch.setattr(run_process, "PROGRAM", GRANFLOW)
    monkeypatch.setattr(sweep, "write_sweep_page", PAGE)
    vary = "{numerics.max_overlap: [0.1, 1e-6]}"
    text = f"scene: spheres.yaml\nset: {{pairs.steel-steel.restitution: 0.9}}\nvary: {vary}\nread: kinetic_energy\n"
    found = gf.sweep(write_sweep(tmp_path, text), out=tmp_path / "out", jobs=1)
    assert list(found["status"]) == ["expectation missed", "aborted"]
    assert 0.0015 < found["kinetic_energy [J]"][0] < 0.0021
    assert "numerics.max_overlap" in found["reason"][1]
    assert (tmp_path / "out" / "sweep.html").stat().st_size > 10_000
