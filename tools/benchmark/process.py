"""Runs one code in a separate process and returns its output, peak memory and start time."""

import os
import subprocess
import time
from dataclasses import dataclass
from pathlib import Path

SAMPLE_EVERY = 0.2  # s between two samples of the memory of a running code
LONGEST = 900.0  # s


@dataclass(frozen=True)
class ProcessResult:
    """`began`: time just before the start [s since 1970]; `memory`: peak memory of all its processes
    [bytes]."""

    output: str
    code: int
    began: float
    memory: int | None


def run(command: list[str], folder: Path, environment: dict[str, str] | None = None) -> ProcessResult:
    """Runs a command to its end in `folder`; captures stdout and stderr in one file."""
    output_file = folder / "output.txt"
    peaks: dict[int, int] = {}
    with output_file.open("w") as file:
        began = time.time()
        process = subprocess.Popen(
            command, cwd=folder, env=os.environ | (environment or {}), stdout=file, stderr=subprocess.STDOUT
        )
        try:
            while process.poll() is None and time.time() - began < LONGEST:
                peaks |= _peaks_below(process.pid)
                time.sleep(SAMPLE_EVERY)
        finally:
            if process.poll() is None:
                process.kill()
                process.wait()
    return ProcessResult(
        output_file.read_text(errors="replace"), process.returncode, began, sum(peaks.values()) or None
    )


def _peaks_below(root: int) -> dict[int, int]:
    """Peak resident memory [bytes] of a process and its descendants, by process id; empty without /proc."""
    found: dict[int, int] = {}
    pending = [root]
    while pending:
        number = pending.pop()
        try:
            status = Path(f"/proc/{number}/status").read_text()
            pending += [
                int(word) for word in Path(f"/proc/{number}/task/{number}/children").read_text().split()
            ]
        except OSError:
            continue
        peaks = [line.split()[1] for line in status.splitlines() if line.startswith("VmHWM")]
        if peaks:
            found[number] = 1024 * int(peaks[0])
    return found
