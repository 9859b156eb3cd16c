"""Output into a closed pipe or onto a full disk: an exit code, at most one sentence, no traceback.

`resume` closes the pipe of a run, which continues.
"""

import io
import os
import subprocess
import sys

import pytest

from granflow.cli.process import compiling_shown

pytestmark = pytest.mark.skipif(os.name != "posix", reason="pipes and devices of POSIX")

CACHE = [sys.executable, "-m", "granflow", "cache"]
LONG = "from granflow.cli.process import standard_streams\nwith standard_streams(): print('x\\n' * 10**6)"


@pytest.mark.parametrize(("command", "lines"), [(CACHE, 0), ([sys.executable, "-c", LONG], 1)])
def test_a_pipe_that_is_closed_ends_the_command_silently(command, lines):
    """At once, or after the first line, as by `head`."""
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    for _ in range(lines):
        assert process.stdout.readline() == b"x\n"
    process.stdout.close()
    assert (process.stderr.read(), process.wait(60)) == (b"", 141)


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="requires /dev/full of Linux")
@pytest.mark.parametrize("command", [CACHE, [*CACHE, "--help"]])
def test_full_disk_is_reported_in_one_sentence(command):
    with open("/dev/full", "w") as full:
        process = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True)
    assert (process.returncode, process.stderr) == (2, "granflow: <stdout>: No space left on device.\n")


def test_compilation_is_shown_on_a_terminal_and_removed(monkeypatch):
    stream = io.StringIO()
    stream.isatty = lambda: True
    monkeypatch.setattr(sys, "stderr", stream)
    with compiling_shown():
        assert stream.getvalue().startswith("Compiling kernels")
    assert stream.getvalue().endswith("\r\x1b[2K")
