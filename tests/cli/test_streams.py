"""Output into a closed pipe or onto a full disk: an exit code, at most one sentence, no traceback."""

import io
import os
import subprocess
import sys

import pytest

from granflow.cli.process import compiling_shown

pytestmark = pytest.mark.skipif(os.name != "posix", reason="pipes and devices of POSIX")

MAIN = "import sys; from granflow.cli import main; sys.exit(main())"
OPTIONAL_OUTPUT = """
import errno, sys
from granflow.cli.process import standard_streams
with standard_streams() as output:
    output.needed = False
    for line in range(1000):
        print("a line of progress", file=sys.stderr)
        print("a line of results", flush=True)
sys.exit(7)
"""
"""Output to both streams, as by `granflow run`, with results that are not required."""


def with_closed_pipes(program, *arguments, stderr):
    """Exit code and stderr of a process with a closed pipe as stdout; `stderr`: `separate_pipe` or
    `same_pipe`."""
    reading, writing = os.pipe()
    os.close(reading)
    try:
        process = subprocess.Popen(
            [sys.executable, "-c", program, *arguments], stdout=writing, stderr=stderr(writing)
        )
    finally:
        os.close(writing)
    _, message = process.communicate(timeout=60)
    return process.returncode, (message or b"").decode()


def separate_pipe(_):
    return subprocess.PIPE


def same_pipe(descriptor):
    return descriptor


@pytest.mark.parametrize("arguments", [["schema"], ["--version"]])
def test_closed_pipe_ends_a_command_silently(arguments):
    assert with_closed_pipes(MAIN, *arguments, stderr=separate_pipe) == (141, "")


def test_pipe_closed_after_the_first_line_ends_the_command():
    program = (
        "from granflow.cli.process import standard_streams\nwith standard_streams(): print('x\\n' * 10**6)"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", program], stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    assert process.stdout.read(2) == b"x\n"
    process.stdout.close()
    assert (process.stderr.read(), process.wait(60)) == (b"", 141)


@pytest.mark.parametrize("stderr", [separate_pipe, same_pipe])
def test_optional_output_is_dropped(stderr):
    code, message = with_closed_pipes(OPTIONAL_OUTPUT, stderr=stderr)
    assert code == 7
    assert message == ("a line of progress\n" * 1000 if stderr is separate_pipe else "")


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="requires /dev/full of Linux")
def test_full_disk_is_reported_in_one_sentence():
    with open("/dev/full", "w") as full:
        process = subprocess.run(
            [sys.executable, "-c", MAIN, "schema"], stdout=full, stderr=subprocess.PIPE, text=True
        )
    assert (process.returncode, process.stderr) == (2, "granflow: <stdout>: No space left on device.\n")


@pytest.mark.parametrize("is_terminal", [True, False])
def test_compilation_is_shown_on_a_terminal_and_removed(monkeypatch, is_terminal):
    stream = io.StringIO()
    stream.isatty = lambda: is_terminal
    monkeypatch.setattr(sys, "stderr", stream)
    with pytest.raises(ValueError), compiling_shown():
        assert stream.getvalue().startswith("Compiling kernels") == is_terminal
        raise ValueError
    assert stream.getvalue().endswith("\r\x1b[2K") == is_terminal
