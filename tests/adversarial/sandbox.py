"""A temporary directory in which one adversarial case runs the command line, with limits on time and
memory."""

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
"""Folder of compiled kernels, common to all cases except those that test the cache."""

POLL = 0.01
"""Polling interval of running processes [s]."""

IGNORED_LINES = re.compile(r"particle-steps/s|^usage:|^ ")


class Skip(Exception):
    """The case cannot run on this machine; the message is the reason."""


@dataclass
class FinishedProcess:
    """One finished process: exit code (None: it exceeded the time limit), output and peak memory [MB]."""

    command: str
    code: int | None
    out: str
    err: str
    megabytes: float = 0.0

    @property
    def text(self) -> str:
        """Standard output and standard error."""
        return f"{self.out}\n{self.err}"

    @property
    def message(self) -> str:
        """First line on stderr that is neither progress nor the usage of a verb, or an empty string."""
        lines = [line for line in self.err.splitlines() if line.strip() and not IGNORED_LINES.search(line)]
        return lines[0] if lines else ""


@dataclass
class Sandbox:
    """Directory of one case and the processes that ran in it."""

    home: Path
    seconds: float = 600.0
    history: list[FinishedProcess] = field(default_factory=list)

    def path(self, name: str) -> Path:
        """Path in the directory."""
        return self.home / name

    def write(self, name: str, content: str | bytes) -> Path:
        """Writes a file and its parent directories."""
        path = self.home / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content.encode() if isinstance(content, str) else content)
        return path

    def run(self, command: str, fault: tuple[str, str] | None = None, **options) -> FinishedProcess:
        """Runs `granflow COMMAND` to its end; `fault`: arguments of tests/resume/fault_injection.py."""
        return self.finish(self.start(command, fault, **options), command)

    def start(self, command: str, fault: tuple[str, str] | None = None, **options) -> subprocess.Popen:
        """Starts `granflow COMMAND`; its outputs are files next to the directory."""
        program = ["-m", "granflow"] if fault is None else [FAULT_INJECTION, *fault]
        return self.start_program([sys.executable, *program, *shlex.split(command)], **options)

    def start_program(self, arguments: list[str], env=(), **options) -> subprocess.Popen:
        """Starts a program; `env` adds to the environment, a value of None removes a variable."""
        number = len(list(self.home.parent.glob("output_*.out")))
        outputs = [open(self.home.parent / f"output_{number}.{end}", "w+b") for end in ("out", "err")]
        variables = {**os.environ, "GRANFLOW_CACHE": str(CACHE), **dict(env)}
        settings = {
            "cwd": self.home,
            "stdout": outputs[0],
            "stderr": outputs[1],
            "stdin": subprocess.DEVNULL,
        } | options
        saved = {name: value for name, value in variables.items() if value is not None}
        process = subprocess.Popen(arguments, env=saved, **settings)
        process.outputs = outputs
        return process

    def finish(self, process: subprocess.Popen, command: str = "") -> FinishedProcess:
        """Waits for a process; kills it if it exceeds the time limit."""
        deadline = time.monotonic() + self.seconds
        code = None
        megabytes = 0.0
        while code is None:
            pid, status, usage = os.wait4(process.pid, os.WNOHANG)
            if pid:
                code = os.waitstatus_to_exitcode(status)
                megabytes = usage.ru_maxrss / 1024.0
            elif time.monotonic() > deadline:
                os.kill(process.pid, signal.SIGKILL)
                os.wait4(process.pid, 0)
                break
            else:
                time.sleep(POLL)
        process.returncode = -signal.SIGKILL if code is None else code
        finished = FinishedProcess(command, code, *(self._read(file) for file in process.outputs), megabytes)
        self.history.append(finished)
        return finished

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
