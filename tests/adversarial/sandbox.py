"""A temporary directory in which one adversarial case runs the command line, with limits on time and memory."""

import os
import re
import resource
import shlex
import signal
import subprocess
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path

from resume.faults import FAULT_INJECTION

ROOT = Path(__file__).parents[2]
CACHE = ROOT / ".pytest_cache" / "kernels"
"""Compiled kernels that all cases share, unless a case is about the cache."""

POLL = 0.01
"""Seconds between two looks at a running process."""

PASSED_OVER = re.compile(r"particle-steps/s|^usage:|^ ")


class Skip(Exception):
    """The case cannot run on this machine; the message is the reason."""


@dataclass
class Done:
    """One finished process: exit code (None: it exceeded the time limit), output and peak memory [MB]."""

    command: str
    code: int | None
    out: str
    err: str
    megabytes: float = 0.0

    @property
    def text(self) -> str:
        """Both outputs."""
        return f"{self.out}\n{self.err}"

    @property
    def message(self) -> str:
        """First line on stderr that is neither progress nor the usage of a verb, or an empty string."""
        lines = [line for line in self.err.splitlines() if line.strip() and not PASSED_OVER.search(line)]
        return lines[0] if lines else ""


@dataclass
class Sandbox:
    """The directory of one case and everything that ran in it."""

    home: Path
    seconds: float = 600.0
    history: list[Done] = field(default_factory=list)

    def path(self, name: str) -> Path:
        """A path in the directory."""
        return self.home / name

    def write(self, name: str, content: str | bytes) -> Path:
        """Write a file, with its parent directories."""
        path = self.home / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content.encode() if isinstance(content, str) else content)
        return path

    def run(self, command: str, fault: tuple[str, str] | None = None, **options) -> Done:
        """`granflow COMMAND` to its end; `fault`: in a process with that fault, see tests/resume/fault_injection.py."""
        return self.finish(self.start(command, fault, **options), command)

    def start(self, command: str, fault: tuple[str, str] | None = None, **options) -> subprocess.Popen:
        """`granflow COMMAND` as a running process, its outputs in files beside the directory."""
        program = ["-m", "granflow"] if fault is None else [FAULT_INJECTION, *fault]
        return self.start_program([sys.executable, *program, *shlex.split(command)], **options)

    def start_program(self, words: list[str], env=(), **options) -> subprocess.Popen:
        """Any program as a running process; `env` adds to the environment, a value of None removes a variable."""
        number = len(list(self.home.parent.glob("output_*.out")))
        outputs = [open(self.home.parent / f"output_{number}.{end}", "w+b") for end in ("out", "err")]
        variables = {**os.environ, "GRANFLOW_CACHE": str(CACHE), **dict(env)}
        given = {"cwd": self.home, "stdout": outputs[0], "stderr": outputs[1], "stdin": subprocess.DEVNULL} | options
        saved = {name: value for name, value in variables.items() if value is not None}
        process = subprocess.Popen(words, env=saved, **given)
        process.outputs = outputs
        return process

    def finish(self, process: subprocess.Popen, command: str = "") -> Done:
        """Wait for a process within the time limit; kills it when it exceeds the limit."""
        give_up, code, megabytes = time.monotonic() + self.seconds, None, 0.0
        while code is None:
            pid, status, usage = os.wait4(process.pid, os.WNOHANG)
            if pid:
                code, megabytes = os.waitstatus_to_exitcode(status), usage.ru_maxrss / 1024.0
            elif time.monotonic() > give_up:
                os.kill(process.pid, signal.SIGKILL)
                os.wait4(process.pid, 0)
                break
            else:
                time.sleep(POLL)
        process.returncode = -signal.SIGKILL if code is None else code
        done = Done(command, code, *(self._read(file) for file in process.outputs), megabytes)
        self.history.append(done)
        return done

    def _read(self, file) -> str:
        file.seek(0)
        text = file.read().decode("utf-8", "backslashreplace")
        file.close()
        return text.replace(f"{self.home}/", "").replace(str(self.home), ".")


def limited(**limits: int):
    """A `preexec_fn` that sets resource limits, named as in the module resource without RLIMIT_."""

    def limit() -> None:
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        for name, value in limits.items():
            resource.setrlimit(getattr(resource, f"RLIMIT_{name}"), (value, value))

    return limit


def as_nobody() -> None:
    """A `preexec_fn`: root ignores permissions, the user nobody does not."""
    if os.geteuid() == 0:
        os.setgid(65534)
        os.setuid(65534)


def hear_interrupts() -> None:
    """A `preexec_fn`: a shell in the background lets its processes ignore SIGINT; the run must not inherit that."""
    signal.signal(signal.SIGINT, signal.default_int_handler)
