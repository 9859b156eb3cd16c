"""Runs killed with SIGKILL, at random moments and at every write, go on to the bits of the run nobody disturbed."""

import os
import random
import re
import shutil
import signal
import time

import pytest
from resume.faults import assert_whole, granflow, started

pytestmark = pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")


@pytest.fixture(scope="module")
def reference(home):
    """Undisturbed run: directory, number of writes, wall-clock seconds without start-up and compilation."""
    done = granflow(home, "run", "beads.yaml", "--out", "reference")
    assert done.returncode == 0, done.stderr
    writes = int(re.search(r"writes: (\d+)", done.stderr)[1])
    first, last = ((home / "reference" / name).stat().st_mtime for name in ("scene_as_run.yaml", "result.json"))
    return home / "reference", writes, last - first


def killed_again_and_again(home, out, times, seconds, seed):
    """Start, or go on, and kill at a moment after the first frame or sign of going on; the times it was killed."""
    rng, killed = random.Random(seed), 0
    for _ in range(times):
        has_begun = (out / "scene_as_run.yaml").exists()
        started_over = [] if any(out.glob("checkpoint_*.npz")) else ["--from-start"]
        verb = ["resume", out.name, *started_over] if has_begun else ["run", "beads.yaml", "--out", out.name]
        log = out / "run.log"
        before = state_of(log)
        running = started(home, *verb)
        while running.poll() is None and state_of(log) in (None, before):
            time.sleep(0.01)
        time.sleep(rng.uniform(0.0, seconds))
        running.send_signal(signal.SIGKILL)
        running.communicate()
        killed += running.returncode == -signal.SIGKILL
    return killed


def state_of(log):
    """Changes when a run appends to its log, or replaces it."""
    try:
        found = log.stat()
    except FileNotFoundError:
        return None
    return (found.st_ino, found.st_size) if found.st_size else None


def resumed(home, out):
    """Resume; a run killed after its first frame and before its first checkpoint takes a flag."""
    done = granflow(home, "resume", out.name)
    if done.returncode == 2 and f"granflow resume {out.name} --from-start" in done.stderr:
        done = granflow(home, "resume", out.name, "--from-start")
    assert done.returncode == 0, done.stderr
    assert "Traceback" not in done.stderr
    return done


def test_killed_at_random_moments(home, reference):
    """Each time from where the last one got to; moments spread over what the run takes once begun."""
    whole, _, seconds = reference
    killed = killed_again_and_again(home, home / "random", 5, 0.15 * seconds, seed=1)
    assert killed >= 3, "the run was over before it could be killed"
    resumed(home, home / "random")
    assert_whole(home / "random", whole)


@pytest.mark.slow
@pytest.mark.timeout(7200)
def test_killed_fifty_times(home, reference):
    whole, _, seconds = reference
    killed = 0
    for round_number in range(10):
        out = home / f"fifty{round_number}"
        killed += killed_again_and_again(home, out, 5, 0.15 * seconds, seed=round_number + 2)
        resumed(home, out)
        assert_whole(out, whole)
        shutil.rmtree(out)
    print(f"killed {killed} times")
    assert killed >= 40


@pytest.mark.slow
@pytest.mark.timeout(7200)
def test_killed_at_every_kind_of_write(home, reference):
    """At some 40 writes spread over the run, the first 20 one by one: each in a fresh run that then goes on."""
    whole, writes, _ = reference
    moments = [*range(1, 21), *range(21, writes + 1, max((writes - 20) // 20, 1))]
    for number in moments:
        out = home / f"write{number}"
        killed = granflow(home, "run", "beads.yaml", "--out", out.name, fault=("kill", str(number)))
        assert killed.returncode == -signal.SIGKILL
        again = resumed(home, out) if (out / "scene_as_run.yaml").exists() else None
        if again is None:
            assert granflow(home, "resume", out.name).returncode == 2
            assert granflow(home, "run", "beads.yaml", "--out", out.name).returncode == 0
        assert_whole(out, whole)
        shutil.rmtree(out)


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_killed_while_going_on(home, reference):
    """Going on cuts files back: killed in the middle of that, the next attempt still ends whole."""
    whole, writes, _ = reference
    out = home / "twice"
    for number in range(1, 13):
        shutil.rmtree(out, ignore_errors=True)
        granflow(home, "run", "beads.yaml", "--out", out.name, fault=("kill", str(2 * writes // 3)))
        killed = granflow(home, "resume", out.name, fault=("kill", str(number)))
        assert killed.returncode == -signal.SIGKILL
        resumed(home, out)
        assert_whole(out, whole)
