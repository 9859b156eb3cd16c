"""A worker process of sweeps and calibrations: carries out commands one after the other, with kernels in
memory.

    python -m granflow.cli.run_worker IDLE_SECONDS

Each line of stdin is a JSON list: file for the messages, arguments of granflow. After a command whose exit
code is one of REUSABLE, the worker writes the code to stdout and waits for the next line; otherwise it ends
with the code. It also ends with stdin, and after IDLE_SECONDS without a command.
"""

import json
import os
import sys
from io import FileIO
from queue import Empty, Queue
from threading import Thread

REUSABLE = (0, 1, 2)
"""Exit codes of commands that have ended regularly: an aborted or stopped run ends its process."""


def main(idle_seconds: float) -> int:
    """Carry out the commands of stdin and return the exit code of the process."""
    requests = FileIO(os.dup(0))
    answers = FileIO(os.dup(1), "w")
    with open(os.devnull, "r+b", buffering=0) as nothing:
        os.dup2(nothing.fileno(), 0)
        os.dup2(nothing.fileno(), 1)
    lines: Queue[bytes] = Queue()
    Thread(target=_read, args=(requests, lines), daemon=True).start()
    while True:
        try:
            line = lines.get(timeout=idle_seconds)
        except Empty:
            return 0
        if not line:
            return 0
        messages, *arguments = json.loads(line)
        code = _command(messages, arguments)
        if code not in REUSABLE:
            return code
        answers.write(f"{code}\n".encode())


def _read(requests: FileIO, lines: "Queue[bytes]") -> None:
    """Read lines; an empty one at the end. The stream is not buffered: the process can end during a read."""
    while line := requests.readline():
        lines.put(line)
    lines.put(b"")


def _command(messages: str, arguments: list[str]) -> int:
    """Carry out a command with its messages in a file and return its exit code.

    An exception ends the process.
    """
    from granflow.cli.main import main as run

    with open(messages, "wb", buffering=0) as file:
        os.dup2(file.fileno(), 2)
    return run(arguments)


if __name__ == "__main__":
    sys.exit(main(float(sys.argv[1])))
