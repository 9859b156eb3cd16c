"""Faults of the machine, signals, threads, pipes and simultaneous processes."""

import os
import random
import signal
import subprocess
import time
from pathlib import Path

from resume.faults import assert_complete
from subprocess_runner import restore_interrupts

from adversarial.beads import beads
from adversarial.case import Case
from adversarial.runs import (
    IDENTICAL,
    assert_undisturbed,
    case,
    killed_run,
    partial_run,
    reference,
    write_scene,
)
from adversarial.sandbox import FinishedProcess, Sandbox, Skip, limited

RESTARTS = 3
"""Number of times a run is killed before it is resumed to its end."""

# ---------------------------------------------------------------- processes and signals


def signalled(number: int, wait: float = 0.0):
    """Sends a signal after half of the frames; asserts that the process ends within 10 s."""

    def act(sandbox: Sandbox) -> FinishedProcess:
        running = partial_run(sandbox, preexec_fn=restore_interrupts)
        time.sleep(wait)
        running.send_signal(number)
        began = time.monotonic()
        finished = sandbox.finish(running, "run beads.yaml --out out")
        elapsed = time.monotonic() - began
        assert elapsed < 10.0, f"{elapsed:.1f} s from the signal to the end"
        return finished

    return act


def resumes(sandbox: Sandbox, finished: FinishedProcess) -> None:
    """Resumes the run and compares its files with the undisturbed run."""
    again = sandbox.run("resume out")
    assert again.code == 0, again.err
    assert_undisturbed(sandbox)


def early_signal(sandbox: Sandbox) -> FinishedProcess:
    """Sends SIGTERM during imports and compilation."""
    running = sandbox.start(
        "run beads.yaml --out out", env={"GRANFLOW_CACHE": str(sandbox.path("cold"))}.items()
    )
    time.sleep(4.0)
    running.send_signal(signal.SIGTERM)
    began = time.monotonic()
    finished = sandbox.finish(running, "run beads.yaml --out out")
    assert time.monotonic() - began < 20.0, "the signal takes effect too late"
    return finished


def killed_at_random(sandbox: Sandbox) -> FinishedProcess:
    """Kills and resumes the run at random times, the last time after a checkpoint, then resumes it to its
    end."""
    rng = random.Random(7)
    command = "run beads.yaml --out out"
    for remaining in reversed(range(RESTARTS)):
        running = sandbox.start(command)
        log = sandbox.path("out/run.log")
        size = log.stat().st_size if log.exists() else 0
        while running.poll() is None and (log.stat().st_size if log.exists() else 0) <= size:
            time.sleep(0.01)
        while (
            remaining == 0
            and running.poll() is None
            and not any(sandbox.path("out").glob("checkpoint_*.npz"))
        ):
            time.sleep(0.01)
        time.sleep(rng.uniform(0.0, 0.5))
        if running.poll() is None:
            running.send_signal(signal.SIGKILL)
            running.wait()
        command = "resume out"
    return sandbox.run("resume out")


def paused(sandbox: Sandbox) -> FinishedProcess:
    """Sends SIGSTOP in the middle of the run, and SIGCONT after two seconds."""
    running = partial_run(sandbox)
    running.send_signal(signal.SIGSTOP)
    time.sleep(2.0)
    running.send_signal(signal.SIGCONT)
    return sandbox.finish(running, "run beads.yaml --out out")


def pair_of(*commands: str, env=()):
    """Runs two processes simultaneously; returns the one with the larger exit code."""

    def act(sandbox: Sandbox) -> FinishedProcess:
        running = [sandbox.start(command, env=env(sandbox) if callable(env) else env) for command in commands]
        finished = [sandbox.finish(each, command) for each, command in zip(running, commands, strict=True)]
        return max(finished, key=lambda each: 999 if each.code is None else each.code)

    return act


def empty_cache(sandbox: Sandbox):
    return {"GRANFLOW_CACHE": str(sandbox.path("cold"))}.items()


def both_equal(sandbox: Sandbox, finished: FinishedProcess) -> None:
    """Compares the files of both runs with the undisturbed run."""
    assert_complete(sandbox.path("out"), reference())
    assert_complete(sandbox.path("other"), reference())


def two_resumes(sandbox: Sandbox) -> FinishedProcess:
    """Starts a second resume while the first one runs in the same directory."""
    killed_run(sandbox)
    first = sandbox.start("resume out --set stages.1.duration=2s --set output.interval=1s")
    size = sandbox.path("out/run.log").stat().st_size
    while first.poll() is None and sandbox.path("out/run.log").stat().st_size <= size:
        time.sleep(0.01)
    second = sandbox.run("resume out")
    first.send_signal(signal.SIGKILL)
    first.wait()
    return second


def many_threads(sandbox: Sandbox) -> FinishedProcess:
    """More threads than cores, with enough particles to use all threads."""
    return sandbox.run(f"run beads.yaml --out out --threads {4 * (os.cpu_count() or 1)} --until 5ms")


MANY = (
    ("count: 10", "count: 1200"),
    ("max: [2 cm, 2 cm, 1 cm]", "max: [6 cm, 6 cm, 8 cm]"),
    ("max: [3 cm, 3 cm, 3 cm]", "max: [7 cm, 7 cm, 9 cm]"),
)


def piped(command: str, reader: list[str]):
    """Output into a pipe that is closed early."""

    def act(sandbox: Sandbox) -> FinishedProcess:
        run = sandbox.start(command, stdout=subprocess.PIPE)
        head = subprocess.Popen(reader, stdin=run.stdout, stdout=subprocess.DEVNULL)
        run.stdout.close()
        finished = sandbox.finish(run, command)
        head.wait()
        return finished

    return act


# ---------------------------------------------------------------- the machine


def needs_root() -> None:
    if os.name != "posix" or os.geteuid() != 0:
        raise Skip("mounting needs root")


def mounted(sandbox: Sandbox, name: str, options: str) -> Path:
    """Mounts a tmpfs in the directory of the case."""
    needs_root()
    path = sandbox.path(name)
    path.mkdir(exist_ok=True)
    if subprocess.run(
        ["mount", "-t", "tmpfs", "-o", options, "tmpfs", str(path)], stderr=subprocess.DEVNULL
    ).returncode:
        raise Skip("no tmpfs can be mounted here")
    return path


def full_disk(sandbox: Sandbox) -> FinishedProcess:
    """Runs on a disk of 200 kB until it is full; then enlarges the disk and resumes."""
    disk = mounted(sandbox, "out", "size=200k")
    try:
        full = sandbox.run("run beads.yaml --out out")
        subprocess.run(["mount", "-o", "remount,size=50m", str(disk)], check=True)
        again = sandbox.run("resume out")
        assert again.code == 0, again.err
        assert_undisturbed(sandbox)
    finally:
        subprocess.run(["umount", str(disk)], check=True)
    return full


def file_limit(sandbox: Sandbox) -> FinishedProcess:
    """Runs with a file size limit below the size of a checkpoint; then resumes without the limit."""
    size = max(path.stat().st_size for path in reference().glob("checkpoint_*.npz"))
    full = sandbox.run("run beads.yaml --out out", preexec_fn=limited(FSIZE=int(0.7 * size)))
    again = sandbox.run("resume out")
    assert again.code == 0, again.err
    assert_undisturbed(sandbox)
    return full


def read_only(sandbox: Sandbox) -> FinishedProcess:
    """Runs with HOME on a read-only disk and without GRANFLOW_CACHE, thus without a cache."""
    disk = mounted(sandbox, "closed", "ro")
    try:
        env = {"HOME": str(disk), "GRANFLOW_CACHE": None, "XDG_CACHE_HOME": None}
        return sandbox.run("run beads.yaml --out out", env=env.items())
    finally:
        subprocess.run(["umount", str(disk)], check=True)


def read_only_out(sandbox: Sandbox) -> FinishedProcess:
    """An output directory on a read-only disk."""
    disk = mounted(sandbox, "closed", "ro")
    try:
        return sandbox.run("run beads.yaml --out closed/out")
    finally:
        subprocess.run(["umount", str(disk)], check=True)


def damaged_cache(sandbox: Sandbox) -> FinishedProcess:
    """Runs with a cache of truncated kernel files, which are compiled again."""
    env = {"GRANFLOW_CACHE": str(sandbox.path("cache"))}
    assert sandbox.run("run beads.yaml --out first", env=env.items()).code == 0
    for path in sandbox.path("cache").iterdir():
        if path.is_file():
            path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    return sandbox.run("run beads.yaml --out out", env=env.items())


def jumping_clock(sandbox: Sandbox) -> FinishedProcess:
    """The system time jumps by hours and to before 1980 while the run writes checkpoints."""
    command = "run beads.yaml --out out --set 'output.checkpoint={wall_clock: 1 ms}'"
    return sandbox.run(command, fault=("clock", "-"))


def moved_away(sandbox: Sandbox) -> FinishedProcess:
    """Renames the output directory while the run writes into it."""
    running = partial_run(sandbox, frame=6)
    os.rename(sandbox.path("out"), sandbox.path("moved"))
    return sandbox.finish(running, "run beads.yaml --out out")


def signals() -> list[Case]:
    """Signals, threads and pipes."""
    group = "signals, threads and pipes"
    whole = {"verify": resumes, "verified": f"resumed: {IDENTICAL}"}
    return [
        case(
            group,
            "signal_int",
            "SIGINT (Ctrl-C) after half of the frames",
            signalled(signal.SIGINT),
            130,
            ("resume out",),
            **whole,
        ),
        case(
            group,
            "signal_term",
            "SIGTERM after half of the frames",
            signalled(signal.SIGTERM),
            143,
            ("resume out",),
            **whole,
        ),
        case(
            group,
            "signal_kill",
            f"SIGKILL at random times, {RESTARTS} times",
            killed_at_random,
            0,
            ("resumed|continues|resumes",),
            verify=assert_undisturbed,
            verified=IDENTICAL,
        ),
        case(
            group,
            "signal_early",
            "SIGTERM while kernels are compiled",
            early_signal,
            (143, -15),
            killed=True,
            prepare=write_scene,
        ),
        case(
            group,
            "signal_stop",
            "SIGSTOP for two seconds, then SIGCONT",
            paused,
            0,
            verify=assert_undisturbed,
            verified=IDENTICAL,
        ),
        case(
            group,
            "threads",
            "four times as many threads as cores, 1200 particles",
            many_threads,
            0,
            ("threads",),
            prepare=beads(*MANY),
        ),
        case(
            group,
            "pipe_run",
            "`granflow run ... | head -1`",
            piped("run beads.yaml --out out", ["head", "-1"]),
            (0, 141, -13),
            prepare=beads(),
        ),
        case(
            group,
            "stdout_full",
            "output to /dev/full",
            lambda s: s.run("explain beads.yaml", stdout=open("/dev/full", "wb")),
            (1, 2, 4),
            ("No space left",),
        ),
    ]


def machine() -> list[Case]:
    """Disks, caches, limits and clocks."""
    group = "disks, caches, limits and clocks"
    return [
        case(
            group,
            "full_disk",
            "a full disk (tmpfs of 200 kB), then resumed with space",
            full_disk,
            4,
            ("No space left on device",),
            verified=f"resumed: {IDENTICAL}",
            killed=True,
        ),
        case(
            group,
            "file_limit",
            "a limit on the size of a file, then resumed without",
            file_limit,
            4,
            ("File too large",),
            verified=f"resumed: {IDENTICAL}",
        ),
        case(
            group,
            "read_only_home",
            "HOME on a read-only disk",
            read_only,
            0,
            ("cannot be written",),
            prepare=beads(),
            verified="kernels are compiled without a cache",
        ),
        case(
            group,
            "read_only_out",
            "an output directory on a read-only disk",
            read_only_out,
            2,
            ("Read-only file system",),
        ),
        case(
            group,
            "cache_damaged",
            "a cache whose files are cut in half",
            damaged_cache,
            0,
            prepare=beads(("50 ms", "1 ms")),
        ),
        case(
            group,
            "cache_both",
            "two runs that compile into the same empty cache at once",
            pair_of("run beads.yaml --out out", "run beads.yaml --out other", env=empty_cache),
            0,
            verify=both_equal,
            verified=f"twice: {IDENTICAL}",
        ),
        case(
            group,
            "run_both",
            "two runs into the same directory at once",
            pair_of("run beads.yaml --out out", "run beads.yaml --out out"),
            2,
            ("Another run is writing|contains an earlier run",),
            mask=r"(?<=granflow: ).*",
        ),
        case(
            group,
            "resume_both",
            "a second resume of a run that is being resumed",
            two_resumes,
            2,
            ("Another run is writing",),
            killed=True,
        ),
        case(
            group,
            "clock",
            "the clock jumps by hours and to before 1980",
            jumping_clock,
            0,
            verify=assert_undisturbed,
            verified=IDENTICAL,
        ),
        case(
            group,
            "moved",
            "the output directory is renamed during the run",
            moved_away,
            4,
            ("No such file or directory", "resume"),
            killed=True,
        ),
    ]


CASES = [*signals(), *machine()]
