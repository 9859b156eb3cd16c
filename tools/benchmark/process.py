"""Running one code in a process of its own: what it said, the memory it took, when it began."""

import os
import subprocess
import time
from dataclasses import dataclass
from pathlib import Path

SAMPLE_EVERY = 0.2  # s between two looks at the memory of a running code
LONGEST = 900.0  # s


@dataclass(frozen=True)
class ProcessResult:
    """`began` [s since 1970] is just before the process was made; `memory` the peak bytes of all its processes."""

    output: str
    code: int
    began: float
    memory: int | None


def run(command: list[str], folder: Path, environment: dict[str, str] | None = None) -> ProcessResult:
    """Run to the end in `folder`; standard output and errors are read together."""
    message = folder / "said.txt"
    peaks: dict[int, int] = {}
    with message.open("w") as file:
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
    return ProcessResult(message.read_text(errors="replace"), process.returncode, began, sum(peaks.values()) or None)


def _peaks_below(root: int) -> dict[int, int]:
    """Peak resident bytes of a process and all it started, by process; empty where /proc does not tell."""
    found: dict[int, int] = {}
    waiting = [root]
    while waiting:
        number = waiting.pop()
        try:
            status = Path(f"/proc/{number}/status").read_text()
            waiting += [int(word) for word in Path(f"/proc/{number}/task/{number}/children").read_text().split()]
        except OSError:
            continue
        peaks = [line.split()[1] for line in status.splitlines() if line.startswith("VmHWM")]
        if peaks:
            found[number] = 1024 * int(peaks[0])
    return found
