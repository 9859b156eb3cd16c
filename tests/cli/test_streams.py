"""Output into a pipe whose reader leaves, or onto a full disk: an exit code, at most one sentence, no traceback."""

import os
import subprocess
import sys

import pytest

pytestmark = pytest.mark.skipif(os.name != "posix", reason="pipes and devices of POSIX")

MAIN = "import sys; from granflow.cli import main; sys.exit(main())"
WITHOUT_ANY_NEED = """
import errno, sys
from granflow.cli.streams import standard_streams
with standard_streams() as output:
    output.needed = False
    for line in range(1000):
        print("a line of progress", file=sys.stderr)
        print("a line of results", flush=True)
sys.exit(7)
"""
"""What `run` does with its streams."""


def with_closed_pipes(program, *arguments, stderr):
    """Exit code and stderr of a process with a stdout that has no reader; `stderr` is `read` or the `same` pipe."""
    reading, writing = os.pipe()
    os.close(reading)
    try:
        process = subprocess.Popen([sys.executable, "-c", program, *arguments], stdout=writing, stderr=stderr(writing))
    finally:
        os.close(writing)
    _, message = process.communicate(timeout=60)
    return process.returncode, (message or b"").decode()


def read(_):
    return subprocess.PIPE


def same(descriptor):
    return descriptor


@pytest.mark.parametrize("arguments", [["schema"], ["--help"], ["run", "--help"], ["--version"], ["cache"]])
def test_a_command_whose_reader_left_ends_quietly(arguments):
    assert with_closed_pipes(MAIN, *arguments, stderr=read) == (141, "")


def test_a_reader_that_leaves_after_the_first_line():
    program = "from granflow.cli.streams import standard_streams\nwith standard_streams(): print('x\\n' * 10**6)"
    process = subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    assert process.stdout.read(2) == b"x\n"
    process.stdout.close()
    assert (process.stderr.read(), process.wait(60)) == (b"", 141)


@pytest.mark.parametrize("stderr", [read, same])
def test_output_that_is_not_needed_is_dropped(stderr):
    code, message = with_closed_pipes(WITHOUT_ANY_NEED, stderr=stderr)
    assert code == 7
    assert message == ("a line of progress\n" * 1000 if stderr is read else "")


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="a device of Linux that is always full")
def test_a_full_disk_behind_stdout_is_one_sentence():
    with open("/dev/full", "w") as full:
        done = subprocess.run([sys.executable, "-c", MAIN, "schema"], stdout=full, stderr=subprocess.PIPE, text=True)
    assert (done.returncode, done.stderr) == (2, "granflow: <stdout>: No space left on device.\n")


def test_streams_are_those_of_before_afterwards():
    program = (
        "import sys, granflow.cli.streams as s\nbefore = sys.stdout, sys.stderr\n"
        "with s.standard_streams(): assert sys.stdout is sys.__stdout__ and sys.stdout is not before[0]; print('in')\n"
        "assert (sys.stdout, sys.stderr) == before == (sys.__stdout__, sys.__stderr__)\nprint('after')"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert (done.stdout, done.stderr) == ("in\nafter\n", "")
