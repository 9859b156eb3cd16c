"""Files and checkpoints of runs on MPI ranks, and the end of all ranks after a failure of one."""

import os
import re
import signal
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import psutil
import pytest
import rank_launcher
from rank_launcher import alone, environment, on_ranks
from scene_builders import box, build_scene, moving_lattice, particle_group, vibrating_box

from granflow.engine.kernel_cache import CACHE_VARIABLE as VARIABLE
from granflow.engine.kernel_cache import CACHED_KERNELS as KERNELS
from granflow.io.checkpoint import newest_checkpoint, read_checkpoint

pytestmark = pytest.mark.skipif(
    bool(rank_launcher.MISSING), reason=rank_launcher.MISSING or "ranks can be started"
)

PROGRAM = Path(__file__).parent.parent / "rank_runs.py"
LONGEST_END = 10.0
"""Time [s] in which a failure of one rank must end all ranks."""


@pytest.mark.parametrize(("fault", "rank"), [("failing", 1), ("failing_root", 0), ("failing_start", 1)])
def test_an_exception_in_one_rank_ends_all(tmp_path, fault, rank):
    done = on_ranks(2, PROGRAM, "zhou", tmp_path / "none.npz", fault)
    ended = time.time()
    assert done.returncode != 0
    assert f"rank {rank} failed, which ends all ranks" in done.stderr
    (began,) = re.findall(r"ArithmeticError: a fault of this test at ([\d.]+) s", done.stderr)
    assert ended - float(began) < LONGEST_END
    assert not (tmp_path / "none.npz").exists()


def small_scene(folder, **changes):
    """File of a scene with two particles that collide."""
    groups = {
        "pair": particle_group([[0.0, 0.0, 0.0], [0.0, 0.0, 0.011]], velocity=[[0.0] * 3, [0.0, 0.0, -1.0]])
    }
    scene = build_scene(groups, **({"run": {"duration": 0.002}, "output": {"interval": 0.001}} | changes))
    return scene.save(folder / "scene.yaml")


def run_on_ranks(ranks, *arguments):
    """The completed process of `granflow` on ranks."""
    return on_ranks(ranks, "-m", "granflow", *arguments)


def test_files_of_a_run_on_ranks_equal_those_without_mpi(tmp_path):
    """The first stage ends on a quantity: when the particles touch, after 1 ms."""
    condition = {"quantity": "contact_count", "above": 0}
    stages = [
        {"name": "approach", "until": condition, "max_duration": 1.0},
        {"name": "rest", "duration": 1e-3},
    ]
    output = {"interval": 1e-3, "timeseries_interval": 1e-5}
    scene = small_scene(tmp_path, stages=stages, run={"velocity_max": 1.0}, output=output)
    one = alone("-m", "granflow", "run", scene, "--out", tmp_path / "one")
    two = run_on_ranks(2, "run", scene, "--mpi", "--out", tmp_path / "two")
    assert (one.returncode, two.returncode) == (0, 0), two.stderr[-2000:]
    assert (tmp_path / "one" / "particles_0002.vtu").exists()
    assert_same_files(tmp_path / "one", tmp_path / "two")


def test_ranks_with_different_scenes_are_refused_with_one_sentence(tmp_path):
    """Each rank runs in a folder of its own; the scene of rank 1 has another restitution, or does not
    exist."""
    folders = [tmp_path / "0", tmp_path / "1"]
    for folder, e in zip(folders, (0.8, 0.3), strict=True):
        folder.mkdir()
        groups = {"pair": particle_group([[0.0, 0.0, 0.0], [0.0, 0.0, 0.011]])}
        build_scene(groups, pair={"restitution": e}, run={"duration": 1e-3}).save(folder / "scene.yaml")
    program = (
        "import os, sys; from mpi4py import MPI; os.chdir(sys.argv.pop(1) + str(MPI.COMM_WORLD.rank));"
        "from granflow.cli.main import main; sys.exit(main(sys.argv[1:]))"
    )
    arguments = ("-c", program, f"{tmp_path}/", "run", "scene.yaml", "--mpi")
    done = on_ranks(2, *arguments)
    assert done.returncode != 0 and "Traceback" not in done.stderr
    assert "The scene of rank 1 differs from that of rank 0, scene.yaml, in its values" in done.stderr
    assert not (folders[0] / "out" / "scene" / "result.json").exists()
    (folders[1] / "scene.yaml").unlink()
    done = on_ranks(2, *arguments)
    assert done.returncode != 0 and "Traceback" not in done.stderr
    assert "rank 1 failed, which ends all ranks.\ngranflow: scene.yaml" in done.stderr


def test_ranks_store_their_kernels_for_the_next_run(tmp_path, monkeypatch):
    cache = tmp_path / "cache"
    scene = small_scene(tmp_path)
    monkeypatch.setenv(VARIABLE, str(cache))
    found = []
    for ranks in (1, 2):
        completed(run_on_ranks(ranks, "run", scene, "--mpi", "--out", tmp_path / str(ranks)))
        found.append({path.name for path in cache.glob(KERNELS)})
    assert found[0] and found[0] == found[1]


def resumable_scene(folder):
    """File of a scene with 64 particles, friction, rain, a vibrating floor, a servo wall, and frames of
    contacts."""
    region = {"box": {"min": [0.005, 0.005, 0.032], "max": [0.023, 0.023, 0.05]}}
    rain = {"material": "glass", "count": 20, "diameter": 0.004,
            "insert": {"kind": "rain", "region": region, "rate": 20000.0}}  # fmt: skip
    walls = vibrating_box(0.028)
    del walls["high_z"]
    walls["high_x"]["motion"] = {"kind": "servo", "direction": [-1, 0, 0], "force": 1.0, "velocity_max": 0.2}
    scene = build_scene(
        {"lattice": moving_lattice((4, 4, 4), largest=0.0062, speed=1.0), "rain": rain}, walls,
        normal="zhou", rolling="epsd", gravity=[0.0, 3.0, -9.81], numerics={"chunk_size": 16},
        pair={"friction": 0.4, "rolling_friction": 0.1, "restitution": 0.5},
        output={"interval": 5e-4, "energy_budget": True, "wall_forces": True, "contacts": True,
                "checkpoint": {"interval": 7e-4}},
        run={"duration": 4e-3, "velocity_max": 4.0, "time_step": 2e-6},
    )  # fmt: skip
    return scene.save(folder / "scene.yaml")


def completed(done):
    """Assert that a process has ended successfully."""
    assert done.returncode == 0, done.stderr[-3000:]


def assert_same_files(expected, found):
    """Assert that two runs have written the same frames and the same time series."""
    names, others = (
        sorted(path.name for path in folder.iterdir() if path.suffix in (".vtu", ".pvd", ".csv"))
        for folder in (expected, found)
    )
    assert names == others
    assert any(name.endswith(".vtu") for name in names)
    for name in names:
        assert (expected / name).read_bytes() == (found / name).read_bytes(), name


def test_a_run_on_two_ranks_is_resumed_without_mpi(tmp_path):
    scene = resumable_scene(tmp_path)
    completed(alone("-m", "granflow", "run", scene, "--out", tmp_path / "whole", "--threads", "1"))
    completed(run_on_ranks(2, "run", scene, "--mpi", "--out", tmp_path / "parts", "--until", "0.0021"))
    kept = [*(tmp_path / "parts").glob("checkpoint_*.npz")]
    assert len(kept) == len([*(tmp_path / "parts").glob("rank_*_0001.npz")]) == 2
    counts = [
        len(read_checkpoint(kept[0], part).saved["engine"]["particles"]["id"]) for part in ("root", "all")
    ]
    assert 20 < counts[0] < 64 < counts[1]
    completed(alone("-m", "granflow", "resume", tmp_path / "parts", "--threads", "1"))
    assert_same_files(tmp_path / "whole", tmp_path / "parts")


@pytest.mark.slow
def test_a_run_is_resumed_on_other_numbers_of_ranks(tmp_path):
    scene = resumable_scene(tmp_path)
    parts = tmp_path / "parts"
    completed(alone("-m", "granflow", "run", scene, "--out", tmp_path / "whole", "--threads", "1"))
    completed(alone("-m", "granflow", "run", scene, "--out", parts, "--until", "0.0008"))
    for ranks, until in ((2, "0.0016"), (1, "0.0022"), (3, "0.0029"), (4, "0.004")):
        completed(run_on_ranks(ranks, "resume", parts, "--mpi", "--until", until))
    assert_same_files(tmp_path / "whole", parts)


@pytest.mark.slow
def test_ranks_refuse_a_damaged_file_and_use_the_checkpoint_before_it(tmp_path):
    scene = resumable_scene(tmp_path)
    parts = tmp_path / "parts"
    completed(alone("-m", "granflow", "run", scene, "--out", tmp_path / "whole", "--threads", "1"))
    completed(run_on_ranks(3, "run", scene, "--mpi", "--out", parts, "--until", "0.0021"))
    damaged = max(parts.glob("rank_*.npz"))
    data = bytearray(damaged.read_bytes())
    data[len(data) // 2] ^= 1
    damaged.write_bytes(data)
    done = run_on_ranks(2, "resume", parts, "--mpi")
    assert done.returncode == 2
    sentence = (
        f"{damaged} is damaged: it is truncated, or its bytes have changed. Remove it to use the checkpoint "
    )
    assert done.stderr.count(sentence) == 1
    assert "Traceback" not in done.stderr
    damaged.unlink()
    done = run_on_ranks(2, "resume", parts, "--mpi")
    completed(done)
    assert f"needs the file {damaged.name} of a rank, which cannot be read" in done.stderr
    assert_same_files(tmp_path / "whole", parts)


@pytest.mark.slow
def test_a_run_with_a_killed_rank_is_resumed(tmp_path):
    scene = resumable_scene(tmp_path)
    parts = tmp_path / "parts"
    completed(alone("-m", "granflow", "run", scene, "--out", tmp_path / "whole", "--threads", "1"))
    command = [rank_launcher.MPIRUN, "-n", "2", sys.executable, "-m", "granflow", "run", "--mpi", str(scene)]
    with subprocess.Popen(
        [*command, "--out", str(parts)], env=environment(), stdout=subprocess.PIPE, stderr=subprocess.STDOUT
    ) as launcher:
        while not [*parts.glob("checkpoint_*.npz")]:
            assert launcher.poll() is None
            time.sleep(0.01)
        ranks = [
            each for each in psutil.Process(launcher.pid).children(recursive=True) if "python" in each.name()
        ]
        os.kill(ranks[-1].pid, signal.SIGKILL)
        launcher.wait(timeout=60)
    assert not (parts / "result.json").exists(), "the run has not ended before the kill"
    completed(run_on_ranks(3, "resume", parts, "--mpi"))
    assert_same_files(tmp_path / "whole", parts)


NARROW = {"min": [-1.0, -1.0, -1e-4], "max": [1.0] * 3, "on_exit": "error"}


@pytest.mark.parametrize(
    "changes", [{"numerics": {"max_overlap": 1e-5}}, {"domain": NARROW, "run": {"duration": 0.02}}]
)
def test_an_abort_has_the_message_of_a_run_without_mpi(tmp_path, changes):
    scene = small_scene(tmp_path, **changes)
    one = alone("-m", "granflow", "run", scene, "--out", tmp_path / "one")
    two = run_on_ranks(2, "run", scene, "--mpi", "--out", tmp_path / "two")
    stopped = [[line for line in each.stderr.splitlines() if "Stopped:" in line] for each in (one, two)]
    assert len(stopped[0]) == 1
    assert stopped[0][0].replace("/one", "/two") == stopped[1][0]
    assert one.returncode == two.returncode == 3
    found = [newest_checkpoint(tmp_path / name) for name in ("one", "two")]
    assert (found[0][0] is None) == (found[1][0] is None), "the last good state is a checkpoint on ranks, too"
    assert not found[0][1] and not found[1][1]


def test_mpirun_without_the_flag_is_refused(tmp_path):
    done = run_on_ranks(2, "run", small_scene(tmp_path), "--out", tmp_path / "out")
    assert done.returncode != 0
    assert "mpirun has started 2 processes that would all run the whole scene: add --mpi" in done.stderr
    assert not (tmp_path / "out").exists()


def test_an_invalid_scene_is_reported_once(tmp_path):
    scene = small_scene(tmp_path)
    scene.write_text(scene.read_text().replace("duration:", "durations:"))
    done = run_on_ranks(2, "run", scene, "--mpi")
    assert done.returncode != 0
    assert done.stderr.count("durations") == 1


@contextmanager
def endless_run(folder):
    """The process of mpirun and those of two ranks, which compute the steps of a scene of 50 s."""
    walls = box(0.1)
    positions = 0.012 * (np.argwhere(np.ones((8, 8, 8))) + 0.5)
    scene = build_scene(
        {"bed": particle_group(positions)}, walls, gravity=[0.0, 0.0, -9.81], run={"duration": 50.0}
    )
    command = [rank_launcher.MPIRUN, "-n", "2", sys.executable, "-m", "granflow", "run", "--mpi"]
    command += [str(scene.save(folder / "scene.yaml")), "--out", str(folder / "out")]
    with subprocess.Popen(
        command, env=environment(), stdout=subprocess.PIPE, stderr=subprocess.STDOUT
    ) as launcher:
        while not (folder / "out" / "particles_0000.vtu").exists():
            assert launcher.poll() is None
            time.sleep(0.1)
        ranks = [
            each for each in psutil.Process(launcher.pid).children(recursive=True) if "python" in each.name()
        ]
        assert len(ranks) == 2
        try:
            yield launcher, ranks
        finally:
            for process in [each for each in ranks if each.is_running()]:
                process.kill()


def rank_number(process):
    """Number of an MPI rank from the variables of Open MPI or MPICH."""
    variables = process.environ()
    return int(variables.get("OMPI_COMM_WORLD_RANK", variables.get("PMI_RANK", -1)))


def wait_for_end(launcher, ranks):
    """Assert that all processes end within LONGEST_END."""
    launcher.wait(timeout=LONGEST_END)
    assert not any(each.is_running() and each.status() != psutil.STATUS_ZOMBIE for each in ranks)


@pytest.mark.slow
def test_a_killed_rank_ends_all_within_seconds(tmp_path):
    with endless_run(tmp_path) as (launcher, ranks):
        os.kill(ranks[-1].pid, signal.SIGKILL)
        wait_for_end(launcher, ranks)


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("receives", ["mpirun", "ranks", "rank 1"])
def test_a_signal_writes_a_checkpoint_and_ends_all_within_seconds(tmp_path, number, receives):
    """Ctrl-C in a terminal and mpirun signal all ranks, as batch systems do before the time limit of a job.

    A signal to one rank other than the root stops all.
    """
    if receives == "mpirun" and rank_launcher.is_open_mpi():
        pytest.skip("this mpirun kills the ranks")
    with endless_run(tmp_path) as (launcher, ranks):
        time.sleep(2.0)
        second = [each for each in ranks if rank_number(each) == 1]
        for process in {"mpirun": [launcher], "ranks": ranks, "rank 1": second}[receives]:
            os.kill(process.pid, number)
        wait_for_end(launcher, ranks)
    (checkpoint,) = (tmp_path / "out").glob("checkpoint_*.npz")
    until = read_checkpoint(checkpoint).time + 1e-3
    completed(run_on_ranks(3, "resume", tmp_path / "out", "--mpi", "--until", until))
