"""Files and checkpoints of runs on MPI ranks, and the end of all ranks after a failure of one."""

import csv
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import psutil
import pytest
import rank_launcher
from rank_launcher import alone, environment, on_ranks
from rank_scenes import pair, resumable
from resume.runs import files_of

from granflow.cli.main import main
from granflow.io.checkpoint import CheckpointError, newest_checkpoint, read_checkpoint, remove_after
from granflow.runs.run_directory import CheckpointWriter
from granflow.scene.blocks.output import Checkpoints

pytestmark = pytest.mark.skipif(
    bool(rank_launcher.MISSING), reason=rank_launcher.MISSING or "ranks can be started"
)

FAULTS = Path(rank_launcher.__file__).with_name("rank_runs.py")
LONGEST_END = 10.0
"""Time [s] in which a failure of one rank must end all ranks."""

SESSION = """
import contextlib, io, json, os, sys
from mpi4py import MPI
from granflow.cli.main import main
folder, rank = sys.argv[1], MPI.COMM_WORLD.rank
os.chdir(f"{folder}/{rank}")
found = {}
for name, arguments in json.load(open(f"{folder}/commands.json")).items():
    with contextlib.redirect_stdout(io.StringIO()) as out, contextlib.redirect_stderr(io.StringIO()) as err:
        code = main(arguments)
    found[name] = [code, out.getvalue(), err.getvalue()]
    MPI.COMM_WORLD.Barrier()
    json.dump(found, open(f"{folder}/{rank}/results.json", "w"))
"""
"""Runs several command lines on the same ranks, each rank in a folder of its own."""

ABORTS = {
    "overlap": {"numerics": {"max_overlap": 1e-5}},
    "domain": {"domain": {"min": [-1.0, -1.0, -1e-4], "max": [1.0] * 3, "on_exit": "error"}},
}
"""Changes of the scene of two particles that lead to an abort. Each command on ranks restarts Taichi, so that the
scene of the other commands would take longer."""

EFFECTS = ("outlet_count.corner", "wear_volume.low_z", "wall_heat.low_z", "source_heat", "heat_content_set")
"""Totals that are not 0 because the features of the scene have had an effect."""


@pytest.fixture(scope="module")
def session(tmp_path_factory):
    """Folder of several runs on two ranks; exit code, stdout and stderr of each rank for each command."""
    folder = tmp_path_factory.mktemp("ranks")
    scene = str(resumable().save(folder / "scene.yaml"))
    (folder / "invalid.yaml").write_text(Path(scene).read_text().replace("chunk_size:", "chunksize:"))
    for rank, restitution in enumerate((0.5, 0.3)):
        (folder / str(rank)).mkdir()
        pair(pair={"restitution": restitution}).save(folder / str(rank) / "own.yaml")
    for name, changes in ABORTS.items():
        pair(**changes).save(folder / f"{name}.yaml")
    part = str(folder / "part")
    commands = {
        "begin": ["run", scene, "--mpi", "--out", part, "--until", "0.0012"],
        "part": ["resume", part, "--mpi", "--until", "0.0021"],
        **{
            name: ["run", str(folder / f"{name}.yaml"), "--mpi", "--out", str(folder / name)]
            for name in (*ABORTS, "invalid")
        },
        "unmarked": ["run", scene, "--out", str(folder / "unmarked")],
        "different": ["run", "own.yaml", "--mpi", "--out", str(folder / "different")],
    }
    (folder / "commands.json").write_text(json.dumps(commands))
    done = on_ranks(2, "-c", SESSION, folder)
    assert done.returncode == 0, done.stderr[-3000:]
    return folder, [json.loads((folder / str(rank) / "results.json").read_text()) for rank in range(2)]


@pytest.fixture
def part(session, tmp_path):
    """A copy of the run on two ranks that ended before its last stage, and its two checkpoints."""
    out = shutil.copytree(session[0] / "part", tmp_path / "part")
    kept = sorted(out.glob("checkpoint_*.npz"))
    assert len(kept) == len([*out.glob("rank_*_0001.npz")]) == len([*out.glob("rank_*")]) == 2
    return out, *kept


def test_a_run_on_two_ranks_is_resumed_there_and_without_mpi(session, part, taichi_f64):
    """The first stage ends on a quantity; each rank writes a file of each checkpoint.

    Heat, wear, an outlet, and the settings and deletions of a stage have acted on the ranks: `bits` compares
    other scenes on ranks in slow tests only.
    """
    folder, ranks = session
    out, _, newest = part
    for name in ("begin", "part"):
        assert ranks[0][name][0] == 0, ranks[0][name]
        assert ranks[1][name] == [0, "", ""], "only the root prints"
    counts = [
        len(read_checkpoint(newest, each).saved["engine"]["particles"]["id"]) for each in ("root", "all")
    ]
    assert 0 < counts[0] < counts[1] and counts[1] > 64 + 27, "both ranks have some, and some are inserted"
    with open(out / "timeseries.csv", newline="") as file:
        *_, row = csv.DictReader(file)
    last = {name.partition(" [")[0]: value for name, value in row.items()}
    assert last["stage"] == "mix" and float(last["deleted_count"]) > float(last["outlet_count.corner"])
    assert all(float(last[name]) for name in EFFECTS)
    whole = folder / "whole"
    assert main(["run", str(folder / "scene.yaml"), "--out", str(whole), "--threads", "2"]) == 0
    assert main(["resume", str(out), "--threads", "2"]) == 0
    assert files_of(out) == files_of(whole)
    stages = [row.split(",")[1] for row in (whole / "timeseries.csv").read_text().splitlines()[1:]]
    assert 10 < stages.count("approach") < 100, "the condition ends the first stage"


def flip_a_bit(path):
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)


@pytest.mark.parametrize(
    ("damage", "reason"),
    [
        (Path.unlink, "needs the file rank_.* of a rank, which cannot be read"),
        (
            lambda path: os.truncate(path, 1000),
            "needs the file rank_.* of a rank, which is another one or truncated",
        ),
        (flip_a_bit, "rank_.* is damaged: it is truncated, or its bytes have changed"),
    ],
)
def test_the_previous_checkpoint_replaces_one_with_an_invalid_file_of_a_rank(part, damage, reason):
    out, before, newest = part
    damage(max(out.glob("rank_*")))
    found, skipped = newest_checkpoint(out)
    assert found.path == before
    with pytest.raises(
        CheckpointError, match=f"{reason}.*Remove it to use the checkpoint before it.$"
    ) as error:
        read_checkpoint(newest)
    assert skipped == [str(error.value)]


def test_files_of_ranks_are_replaced_and_removed_with_their_checkpoint(part):
    """A checkpoint of the same step, without files of ranks, replaces the newest one, which remains usable until
    then."""
    out, before, newest = part
    state = read_checkpoint(newest)
    writer = CheckpointWriter(out, Checkpoints(), state.scene)

    def saved(_):
        assert len(read_checkpoint(newest, "root").rank_files) == 1
        return state.saved | {"rank_files": []}

    writer.write(state.time, int(newest.stem[-12:]), saved)
    (file,) = out.glob("rank_*")
    assert file.name.startswith(f"rank_{before.stem[-12:]}")
    ids = [
        read_checkpoint(newest).saved["engine"]["particles"]["id"],
        state.saved["engine"]["particles"]["id"],
    ]
    np.testing.assert_array_equal(*ids)
    before.unlink()
    remove_after(out, newest)
    assert newest.exists() and not list(out.glob("rank_*"))


@pytest.mark.parametrize("name", ABORTS)
def test_an_abort_has_the_message_of_a_run_without_mpi(session, taichi_f64, tmp_path, capsys, name):
    folder, ranks = session
    arguments = ["run", str(folder / f"{name}.yaml"), "--out", str(tmp_path / name)]
    assert main([*arguments, "--threads", "2"]) == ranks[0][name][0] == 3
    # The time of the last good state, which is kept every two seconds of wall-clock time, ends the line.
    alone, root = (
        [line.rpartition(", at ")[0] for line in text.splitlines() if "Stopped:" in line]
        for text in (capsys.readouterr().err, ranks[0][name][2])
    )
    assert [line.replace(str(tmp_path), str(folder)) for line in alone] == root and len(root) == 1
    assert ranks[1][name] == [0, "", ""]
    found = [newest_checkpoint(parent / name) for parent in (tmp_path, folder)]
    assert (found[0][0] is None) == (found[1][0] is None), "the last good state is a checkpoint on ranks, too"
    assert not found[0][1] and not found[1][1]


def test_wrong_use_is_refused_with_one_sentence(session):
    """Without --mpi each of both ranks refuses; otherwise the root reports what the ranks have read."""
    folder, ranks = session
    refused = "mpirun has started 2 processes that would all run the whole scene: add --mpi"
    assert all(each["unmarked"][0] == 2 and refused in each["unmarked"][2] for each in ranks)
    assert ranks[0]["invalid"][0] == 2 and ranks[0]["invalid"][2].count("chunksize") == 1
    differs = "The scene of rank 1 differs from that of rank 0, own.yaml, in its values"
    assert ranks[0]["different"][0] == 2 and differs in ranks[0]["different"][2]
    assert ranks[1]["invalid"] == ranks[1]["different"] == [0, "", ""]
    assert not any((folder / name / "result.json").exists() for name in ("unmarked", "invalid", "different"))


@pytest.mark.parametrize(
    ("kind", "failed", "message"),
    [
        ("failing", 1, "ArithmeticError: a fault of this test"),
        ("failing_root", 0, "ArithmeticError: a fault of this test"),
        ("refused", None, "Changes from Python do not work on MPI ranks"),
    ],
)
def test_an_exception_in_one_rank_ends_all(tmp_path, kind, failed, message):
    """Within a command; or of the root outside of one, while the files of its run are open."""
    done = on_ranks(2, FAULTS, kind, tmp_path / "out", seconds=120)
    time_of_end = time.time()
    assert done.returncode != 0 and message in done.stderr
    for began in re.findall(r"a fault of this test at ([\d.]+) s", done.stderr):
        assert time_of_end - float(began) < LONGEST_END
    ended = "The other ranks have ended" if failed is None else f"rank {failed} failed, which ends all ranks"
    assert ended in done.stderr


def test_a_scene_that_one_rank_cannot_read_ends_all(session):
    (session[0] / "1" / "own.yaml").unlink()
    chdir = "import os, sys; from mpi4py import MPI; os.chdir(sys.argv.pop(1) + str(MPI.COMM_WORLD.rank));"
    start = "from granflow.cli.main import main; sys.exit(main(sys.argv[1:]))"
    done = on_ranks(2, "-c", chdir + start, f"{session[0]}/", "run", "own.yaml", "--mpi")
    assert done.returncode != 0 and "Traceback" not in done.stderr
    assert "rank 1 failed, which ends all ranks.\ngranflow: own.yaml" in done.stderr


# ---------------------------------------------------------------- slow


def completed(done):
    """Assert that a process has ended successfully."""
    assert done.returncode == 0, done.stderr[-3000:]


def run_on_ranks(ranks, *arguments):
    """The completed process of `granflow` on ranks."""
    return on_ranks(ranks, "-m", "granflow", *arguments)


@pytest.mark.slow
def test_a_run_is_resumed_on_other_numbers_of_ranks(tmp_path):
    """At last a file of a rank is damaged: all ranks refuse it, then use the checkpoint before it."""
    scene = resumable().save(tmp_path / "scene.yaml")
    completed(alone("-m", "granflow", "run", scene, "--out", tmp_path / "whole", "--threads", "1"))
    parts = tmp_path / "parts"
    completed(alone("-m", "granflow", "run", scene, "--out", parts, "--until", "0.0008"))
    for ranks, until in ((2, "0.0013"), (1, "0.0017"), (3, "0.0024")):
        completed(run_on_ranks(ranks, "resume", parts, "--mpi", "--until", until))
    damaged = max(parts.glob("rank_*.npz"))
    flip_a_bit(damaged)
    done = run_on_ranks(4, "resume", parts, "--mpi")
    assert done.returncode == 2 and done.stderr.count(f"{damaged} is damaged") == 1
    damaged.unlink()
    completed(run_on_ranks(4, "resume", parts, "--mpi"))
    assert files_of(parts) == files_of(tmp_path / "whole")


def rank_number(process):
    """Number of an MPI rank from the variables of Open MPI or MPICH."""
    variables = process.environ()
    return int(variables.get("OMPI_COMM_WORLD_RANK", variables.get("PMI_RANK", -1)))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("receives", "number"),
    [
        ("mpirun", signal.SIGINT),
        ("ranks", signal.SIGTERM),
        ("rank 1", signal.SIGTERM),
        ("rank 1", signal.SIGKILL),
    ],
)
def test_a_signal_ends_all_within_seconds_and_the_run_is_resumed(tmp_path, receives, number):
    """Ctrl-C in a terminal and mpirun signal all ranks, as batch systems do before the time limit of a job.

    A signal to one rank other than the root, or its death, stops all.
    """
    if receives == "mpirun" and rank_launcher.is_open_mpi():
        pytest.skip("this mpirun kills the ranks")
    out = tmp_path / "out"
    scene = resumable().save(tmp_path / "scene.yaml")
    granflow = ["-m", "granflow", "run", scene, "--mpi", "--out", out, "--set", "stages.1.duration=50 s"]
    command = [rank_launcher.MPIRUN, "-n", "2", sys.executable, *map(str, granflow)]
    with subprocess.Popen(
        command, env=environment(), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    ) as launcher:
        while not [*out.glob("checkpoint_*.npz")]:
            assert launcher.poll() is None
            time.sleep(0.01)
        children = psutil.Process(launcher.pid).children(recursive=True)
        ranks = [each for each in children if "python" in each.name()]
        assert len(ranks) == 2
        second = [each for each in ranks if rank_number(each) == 1]
        try:
            for process in {"mpirun": [launcher], "ranks": ranks, "rank 1": second}[receives]:
                os.kill(process.pid, number)
            launcher.wait(timeout=LONGEST_END)
            assert not any(each.is_running() and each.status() != psutil.STATUS_ZOMBIE for each in ranks)
        finally:
            for process in [each for each in ranks if each.is_running()]:
                process.kill()
    newest = newest_checkpoint(out)[0]
    completed(run_on_ranks(3, "resume", out, "--mpi", "--until", newest.time + 1e-3))
