"""Full disks, removed folders, damaged checkpoints, simultaneous runs, clock jumps: messages and files.

After each fault, the resumed run ends with the files of the undisturbed run.
"""

import os
import resource
import shutil
import signal
import subprocess

import pytest
from resume.faults import assert_complete, granflow, started, wait_for

pytestmark = [
    pytest.mark.skipif(os.name != "posix", reason="limits and signals of POSIX"),
    pytest.mark.slow,
    pytest.mark.timeout(1800),
]


@pytest.fixture(scope="module")
def reference(home):
    process = granflow(home, "run", "beads.yaml", "--out", "reference")
    assert process.returncode == 0, process.stderr
    return home / "reference"


def killed_run(home, name):
    """Directory of a run that is killed after half of its frames."""
    running = started(home, "run", "beads.yaml", "--out", name)
    wait_for(home / name / "particles_0009.vtu", running)
    running.kill()
    running.communicate()
    assert len(list((home / name).glob("checkpoint_*.npz"))) == 2
    return home / name


def resumed(home, out, *arguments):
    process = granflow(home, "resume", out.name, *arguments)
    assert process.returncode == 0, process.stderr
    return process


def file_size_limit(bytes_allowed):
    """A `preexec_fn` that limits the size of files, as a quota does."""

    def limit():
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (bytes_allowed, bytes_allowed))

    return limit


def messages(process):
    assert "Traceback" not in process.stderr and "--- Logging error ---" not in process.stderr, process.stderr
    return [line for line in process.stderr.splitlines() if line.startswith("granflow:")]


@pytest.mark.parametrize("fraction", [0.2, 0.7, 0.95])
def test_run_beyond_a_file_size_limit_can_be_resumed(home, reference, fraction):
    """The checkpoint is the largest file, followed by frames of contacts and the log."""
    size = max(path.stat().st_size for path in reference.glob("checkpoint_*.npz"))
    out = home / f"quota{fraction}"
    failed = granflow(
        home, "run", "beads.yaml", "--out", out.name, preexec_fn=file_size_limit(int(fraction * size))
    )
    assert failed.returncode == 4, failed.stderr
    assert any("File too large" in message for message in messages(failed))
    resumed(home, out, *[] if any(out.glob("checkpoint_*.npz")) else ["--from-start"])
    assert_complete(out, reference)


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() != 0, reason="mounting needs root")
@pytest.mark.parametrize("free_space", ["100k", "200k", "300k"])
def test_run_on_a_full_disk_can_be_resumed(home, reference, free_space):
    out = home / f"full{free_space}"
    out.mkdir()
    if subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={free_space}", "tmpfs", str(out)]).returncode:
        pytest.skip("no tmpfs can be mounted here")
    try:
        failed = granflow(home, "run", "beads.yaml", "--out", out.name)
        assert failed.returncode == 4, failed.stderr
        assert any("No space left on device" in message for message in messages(failed))
        subprocess.run(["mount", "-o", "remount,size=50m", str(out)], check=True)
        resumed(home, out, *[] if any(out.glob("checkpoint_*.npz")) else ["--from-start"])
        assert_complete(out, reference)
    finally:
        subprocess.run(["umount", str(out)], check=True)


def test_unwritable_output_directory_is_rejected(home):
    """The run is rejected before any computation, in one sentence. For root this requires a read-only
    disk."""
    read_only = home / "closed"
    read_only.mkdir()
    read_only.chmod(0o555)
    root = os.geteuid() == 0
    if root and subprocess.run(["mount", "-t", "tmpfs", "-o", "ro", "tmpfs", str(read_only)]).returncode:
        pytest.skip("no tmpfs can be mounted here")
    try:
        process = granflow(home, "run", "beads.yaml", "--out", "closed/run")
    finally:
        if root:
            subprocess.run(["umount", str(read_only)], check=True)
    assert process.returncode == 2, process.stderr
    assert messages(process) == [
        f"granflow: {read_only / 'run'}: {'Read-only file system' if root else 'Permission denied'}."
    ]


def test_run_in_a_renamed_directory_can_be_resumed(home, reference):
    """The message names the present path of the directory, in which no row and no frame is missing."""
    out = home / "vanishing"
    moved = home / "moved"
    running = started(home, "run", "beads.yaml", "--out", out.name)
    wait_for(out / "particles_0006.vtu", running)
    os.rename(out, moved)
    _, message = running.communicate(timeout=120)
    assert running.returncode == 4, message
    assert "the directory was moved or deleted during the run" in message
    assert f"granflow resume {moved} continues from" in message
    assert "Traceback" not in message and not out.exists()
    resumed(home, moved)
    assert_complete(moved, reference)


@pytest.mark.parametrize("damage", ["truncated", "flipped", "empty"])
def test_resume_skips_a_damaged_checkpoint(home, reference, damage):
    out = killed_run(home, damage)
    newest = max(out.glob("checkpoint_*.npz"))
    whole = newest.read_bytes()
    half = len(whole) // 2
    flipped = whole[:half] + bytes([whole[half] ^ 1]) + whole[half + 1 :]
    newest.write_bytes({"truncated": whole[:half], "flipped": flipped, "empty": b""}[damage])
    process = resumed(home, out)
    assert f"granflow: warning: {damage}/{newest.name} is damaged" in process.stderr
    assert_complete(out, reference)


def test_resume_without_usable_checkpoint_requires_from_start(home, reference):
    out = killed_run(home, "ruined")
    for path in out.glob("checkpoint_*.npz"):
        path.write_bytes(b"nonsense")
    frames = {path.name: path.read_bytes() for path in out.glob("*.vtu")}
    rejected = granflow(home, "resume", out.name)
    assert rejected.returncode == 2 and "granflow resume ruined --from-start" in rejected.stderr
    assert frames == {path.name: path.read_bytes() for path in out.glob("*.vtu")}
    resumed(home, out, "--from-start")
    assert_complete(out, reference)


def test_failed_overwrite_keeps_the_previous_run(home, reference):
    """No file may exceed 100 bytes, so that the first frame of the new run cannot be written."""
    out = home / "replaced"
    shutil.copytree(reference, out)
    before = {path.name: path.read_bytes() for path in out.iterdir()}
    failed = granflow(
        home, "run", "beads.yaml", "--out", out.name, "--overwrite", preexec_fn=file_size_limit(100)
    )
    assert failed.returncode == 4, failed.stderr
    assert any("File too large" in message for message in messages(failed))
    assert before == {path.name: path.read_bytes() for path in out.iterdir()}


def test_simultaneous_runs_are_rejected(home, reference):
    """A second `run` or `resume` is rejected; the lock ends with its process."""
    out = home / "shared"
    running = started(home, "run", "beads.yaml", "--out", out.name)
    wait_for(out / "particles_0001.vtu", running)
    os.kill(running.pid, signal.SIGSTOP)
    for verb in (["resume", out.name], ["run", "beads.yaml", "--out", out.name, "--overwrite"]):
        rejected = granflow(home, *verb)
        assert rejected.returncode == 2
        assert "Another run is writing into shared" in rejected.stderr
    os.kill(running.pid, signal.SIGKILL)
    running.communicate()
    resumed(home, out)
    assert_complete(out, reference)


def test_clock_jumps_do_not_affect_the_results(home, reference):
    """Checkpoints by wall clock use the monotonic clock and do not affect the result files."""
    checkpoints = ("--set", "output.checkpoint={wall_clock: 1 ms}")
    process = granflow(home, "run", "beads.yaml", "--out", "jumping", *checkpoints, fault=("clock", "-"))
    assert process.returncode == 0, process.stderr
    assert_complete(home / "jumping", reference)


@pytest.mark.parametrize(("signal_number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_signal_writes_a_checkpoint(home, reference, signal_number, code):
    """The run finishes its step, writes its state and exits with 128 + signal number."""
    out = home / signal_number.name
    running = started(home, "run", "beads.yaml", "--out", out.name, "--set", "output.checkpoint.interval=1 h",
                      preexec_fn=lambda: signal.signal(signal_number, signal.default_int_handler))  # fmt: skip
    wait_for(out / "particles_0004.vtu", running)
    running.send_signal(signal_number)
    _, message = running.communicate(timeout=60)
    assert running.returncode == code
    assert message.splitlines()[-1].endswith(
        f"granflow resume {out.name} continues. {out.name} contains the run up to this time."
    )
    assert len(list(out.glob("checkpoint_*.npz"))) == 1
    resumed(home, out)
    assert_complete(out, reference)


def test_resume_removes_temporary_files(home, reference):
    """Resume deletes the temporary files of a killed run."""
    out = killed_run(home, "scraps")
    (out / ".particles_0010.vtu.99999.part").write_bytes(b"half a fr")
    shutil.copy(out / "particles_0001.vtu", out / "particles_0999.vtu")
    resumed(home, out)
    assert_complete(out, reference)
