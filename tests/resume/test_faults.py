"""Full disks, folders that go, damaged checkpoints, two runs at once, clocks that jump: what is seen, and what is left.

After each, going on ends with the files of the run that nothing happened to.
"""

import os
import resource
import shutil
import signal
import subprocess

import pytest
from resume.faults import assert_whole, granflow, started, wait_for

pytestmark = [
    pytest.mark.skipif(os.name != "posix", reason="limits and signals of POSIX"),
    pytest.mark.slow,
    pytest.mark.timeout(1800),
]


@pytest.fixture(scope="module")
def reference(home):
    done = granflow(home, "run", "beads.yaml", "--out", "reference")
    assert done.returncode == 0, done.stderr
    return home / "reference"


def stopped_half_way(home, name):
    """A run killed when it has written half of its frames."""
    running = started(home, "run", "beads.yaml", "--out", name)
    wait_for(home / name / "particles_0009.vtu", running)
    running.kill()
    running.communicate()
    assert len(list((home / name).glob("checkpoint_*.npz"))) == 2
    return home / name


def resumed(home, out, *more):
    done = granflow(home, "resume", out.name, *more)
    assert done.returncode == 0, done.stderr
    return done


def largest_file(bytes_allowed):
    """Before a process begins: no file of it may be larger, as with a quota."""

    def limit():
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (bytes_allowed, bytes_allowed))

    return limit


def sentences(done):
    assert "Traceback" not in done.stderr and "--- Logging error ---" not in done.stderr, done.stderr
    return [line for line in done.stderr.splitlines() if line.startswith("granflow:")]


@pytest.mark.parametrize("share", [0.2, 0.7, 0.95])
def test_no_room_for_files_of_a_size(home, reference, share):
    """The largest file is the checkpoint, then come frames of contacts and the log."""
    size = max(path.stat().st_size for path in reference.glob("checkpoint_*.npz"))
    out = home / f"quota{share}"
    full = granflow(home, "run", "beads.yaml", "--out", out.name, preexec_fn=largest_file(int(share * size)))
    assert full.returncode == 4, full.stderr
    assert any("File too large" in sentence for sentence in sentences(full))
    resumed(home, out, *[] if any(out.glob("checkpoint_*.npz")) else ["--from-start"])
    assert_whole(out, reference)


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() != 0, reason="mounting needs root")
@pytest.mark.parametrize("free_space", ["100k", "200k", "300k"])
def test_a_full_disk(home, reference, free_space):
    out = home / f"full{free_space}"
    out.mkdir()
    if subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={free_space}", "tmpfs", str(out)]).returncode:
        pytest.skip("no tmpfs can be mounted here")
    try:
        full = granflow(home, "run", "beads.yaml", "--out", out.name)
        assert full.returncode == 4, full.stderr
        assert any("No space left on device" in sentence for sentence in sentences(full))
        subprocess.run(["mount", "-o", "remount,size=50m", str(out)], check=True)
        resumed(home, out, *[] if any(out.glob("checkpoint_*.npz")) else ["--from-start"])
        assert_whole(out, reference)
    finally:
        subprocess.run(["umount", str(out)], check=True)


def test_a_place_that_cannot_be_written(home):
    """Refused before anything is computed, in one sentence. Root may write anywhere but on a read-only disk."""
    closed = home / "closed"
    closed.mkdir()
    closed.chmod(0o555)
    root = os.geteuid() == 0
    if root and subprocess.run(["mount", "-t", "tmpfs", "-o", "ro", "tmpfs", str(closed)]).returncode:
        pytest.skip("no tmpfs can be mounted here")
    try:
        done = granflow(home, "run", "beads.yaml", "--out", "closed/run")
    finally:
        if root:
            subprocess.run(["umount", str(closed)], check=True)
    assert done.returncode == 2, done.stderr
    assert sentences(done) == [f"granflow: closed/run: {'Read-only file system' if root else 'Permission denied'}."]


def test_a_directory_that_vanishes(home, reference):
    """The state is in memory still: it is written where the directory was. Rows and frames that are gone stay gone."""
    out = home / "vanishing"
    running = started(home, "run", "beads.yaml", "--out", out.name)
    wait_for(out / "particles_0006.vtu", running)
    os.rename(out, home / "moved")
    _, message = running.communicate(timeout=120)
    assert running.returncode == 4, message
    assert "No such file or directory" in message and "granflow resume vanishing continues from" in message
    assert "Traceback" not in message
    refused = granflow(home, "resume", out.name)
    assert refused.returncode == 2 and "timeseries.csv lacks rows" in refused.stderr
    resumed(home, out, "--allow-changes")
    for name in ("particles_0020.vtu", "contacts_0020.vtu"):
        assert (out / name).read_bytes() == (reference / name).read_bytes()
    resumed(home, home / "moved")
    assert_whole(home / "moved", reference)


@pytest.mark.parametrize("damage", ["truncated", "flipped", "empty"])
def test_a_damaged_checkpoint(home, reference, damage):
    out = stopped_half_way(home, damage)
    newest = max(out.glob("checkpoint_*.npz"))
    whole = newest.read_bytes()
    half = len(whole) // 2
    flipped = whole[:half] + bytes([whole[half] ^ 1]) + whole[half + 1 :]
    newest.write_bytes({"truncated": whole[:half], "flipped": flipped, "empty": b""}[damage])
    message = resumed(home, out)
    assert f"granflow: warning: {damage}/{newest.name} is damaged" in message.stderr
    assert_whole(out, reference)


def test_all_checkpoints_damaged(home, reference):
    out = stopped_half_way(home, "ruined")
    for path in out.glob("checkpoint_*.npz"):
        path.write_bytes(b"nonsense")
    frames = {path.name: path.read_bytes() for path in out.glob("*.vtu")}
    refused = granflow(home, "resume", out.name)
    assert refused.returncode == 2 and "granflow resume ruined --from-start" in refused.stderr
    assert frames == {path.name: path.read_bytes() for path in out.glob("*.vtu")}
    resumed(home, out, "--from-start")
    assert_whole(out, reference)


def test_a_forced_run_that_finds_no_room_leaves_the_previous_run(home, reference):
    """No file may exceed 100 bytes, so that the first frame of the new run cannot be written."""
    out = home / "replaced"
    shutil.copytree(reference, out)
    before = {path.name: path.read_bytes() for path in out.iterdir()}
    full = granflow(home, "run", "beads.yaml", "--out", out.name, "--overwrite", preexec_fn=largest_file(100))
    assert full.returncode == 4, full.stderr
    assert any("File too large" in sentence for sentence in sentences(full))
    assert before == {path.name: path.read_bytes() for path in out.iterdir()}


def test_two_runs_at_once(home, reference):
    """The second is refused whatever it is; the lock of one that is dead holds nobody up."""
    out = home / "shared"
    running = started(home, "run", "beads.yaml", "--out", out.name)
    wait_for(out / "particles_0001.vtu", running)
    os.kill(running.pid, signal.SIGSTOP)
    for verb in (["resume", out.name], ["run", "beads.yaml", "--out", out.name, "--overwrite"]):
        refused = granflow(home, *verb)
        assert refused.returncode == 2
        assert "Another run is writing into shared" in refused.stderr
    os.kill(running.pid, signal.SIGKILL)
    running.communicate()
    resumed(home, out)
    assert_whole(out, reference)


def test_clocks_that_jump(home, reference):
    """Checkpoints by the wall clock come by a clock that nobody sets, and leave no trace in the files."""
    often = ("--set", "output.checkpoint={wall_clock: 1 ms}")
    done = granflow(home, "run", "beads.yaml", "--out", "jumping", *often, fault=("clock", "-"))
    assert done.returncode == 0, done.stderr
    assert_whole(home / "jumping", reference)


@pytest.mark.parametrize(("sent", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_told_to_stop(home, reference, sent, code):
    """The step is finished, the state is written, the code is that of the signal."""
    out = home / sent.name
    running = started(home, "run", "beads.yaml", "--out", out.name, "--set", "output.checkpoint.interval=1 h",
                      preexec_fn=lambda: signal.signal(sent, signal.default_int_handler))  # fmt: skip
    wait_for(out / "particles_0004.vtu", running)
    running.send_signal(sent)
    _, message = running.communicate(timeout=60)
    assert running.returncode == code
    assert message.splitlines()[-1].endswith(
        f"granflow resume {out.name} continues. {out.name} contains the run up to this time."
    )
    assert len(list(out.glob("checkpoint_*.npz"))) == 1
    resumed(home, out)
    assert_whole(out, reference)


def test_another_process_id_left_scraps(home, reference):
    """Temporary files of a killed run go when it is gone on with."""
    out = stopped_half_way(home, "scraps")
    (out / ".particles_0010.vtu.99999.part").write_bytes(b"half a fr")
    shutil.copy(out / "particles_0001.vtu", out / "particles_0999.vtu")
    resumed(home, out)
    assert_whole(out, reference)
