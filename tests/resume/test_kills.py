"""Runs killed by SIGKILL, at random times and at writes, resume to the same bits as an undisturbed run."""

import os
import random
import re
import shutil
import signal
import time

import pytest
from resume.faults import assert_complete, granflow, started

pytestmark = pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")


@pytest.fixture(scope="module")
def reference(home):
    """Undisturbed run: directory, number of writes, wall-clock seconds without start-up and compilation."""
    process = granflow(home, "run", "beads.yaml", "--out", "reference")
    assert process.returncode == 0, process.stderr
    writes = int(re.search(r"writes: (\d+)", process.stderr)[1])
    first, last = (
        (home / "reference" / name).stat().st_mtime for name in ("scene_as_run.yaml", "result.json")
    )
    return home / "reference", writes, last - first


def kill_repeatedly(home, out, times, seconds, seed):
    """Starts or resumes a run repeatedly, kills it at a random time after it writes its log; returns the kill
    count."""
    rng = random.Random(seed)
    killed = 0
    for _ in range(times):
        has_begun = (out / "scene_as_run.yaml").exists()
        flags = [] if any(out.glob("checkpoint_*.npz")) else ["--from-start"]
        verb = ["resume", out.name, *flags] if has_begun else ["run", "beads.yaml", "--out", out.name]
        log = out / "run.log"
        before = file_state(log)
        running = started(home, *verb)
        while running.poll() is None and file_state(log) in (None, before):
            time.sleep(0.01)
        time.sleep(rng.uniform(0.0, seconds))
        running.send_signal(signal.SIGKILL)
        running.communicate()
        killed += running.returncode == -signal.SIGKILL
    return killed


def file_state(log):
    """Inode and size of a log, which change when a run replaces it or appends to it; None without content."""
    try:
        found = log.stat()
    except FileNotFoundError:
        return None
    return (found.st_ino, found.st_size) if found.st_size else None


def resumed(home, out):
    """Resumes a run, with --from-start if it was killed between its first frame and its first checkpoint."""
    process = granflow(home, "resume", out.name)
    if process.returncode == 2 and f"granflow resume {out.name} --from-start" in process.stderr:
        process = granflow(home, "resume", out.name, "--from-start")
    assert process.returncode == 0, process.stderr
    assert "Traceback" not in process.stderr
    return process


def test_run_killed_at_random_times_resumes_bit_identically(home, reference):
    """Each run resumes the killed one; the times are spread over the duration of the run."""
    whole, _, seconds = reference
    killed = kill_repeatedly(home, home / "random", 3, 0.25 * seconds, seed=1)
    assert killed >= 2, "the run was over before it could be killed"
    resumed(home, home / "random")
    assert_complete(home / "random", whole)


@pytest.mark.slow
@pytest.mark.timeout(7200)
def test_run_killed_at_a_write_resumes_bit_identically(home, reference):
    """About 40 writes of a run, including each of the first 20; one killed and resumed run for each."""
    whole, writes, _ = reference
    write_numbers = [*range(1, 21), *range(21, writes + 1, max((writes - 20) // 20, 1))]
    for number in write_numbers:
        out = home / f"write{number}"
        killed = granflow(home, "run", "beads.yaml", "--out", out.name, fault=("kill", str(number)))
        assert killed.returncode == -signal.SIGKILL
        if (out / "scene_as_run.yaml").exists():
            resumed(home, out)
        else:
            assert granflow(home, "resume", out.name).returncode == 2
            assert granflow(home, "run", "beads.yaml", "--out", out.name).returncode == 0
        assert_complete(out, whole)
        shutil.rmtree(out)


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_run_killed_during_resume_resumes_bit_identically(home, reference):
    """Resume truncates files; a resume killed during truncation can be repeated."""
    whole, writes, _ = reference
    out = home / "twice"
    for number in range(1, 13):
        shutil.rmtree(out, ignore_errors=True)
        granflow(home, "run", "beads.yaml", "--out", out.name, fault=("kill", str(2 * writes // 3)))
        killed = granflow(home, "resume", out.name, fault=("kill", str(number)))
        assert killed.returncode == -signal.SIGKILL
        resumed(home, out)
        assert_complete(out, whole)
