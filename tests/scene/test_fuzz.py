"""`granflow check` of anything at all ends in a scene or in sentences with places: no traceback, hang or flood."""

import contextlib
import io
import random
import re
import resource
import signal
import traceback
import warnings
from pathlib import Path

import pytest
from child import in_child
from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis import strategies as st
from mutants import mutant, written

from granflow.cli import main

SECONDS = 20
"""Longer than this for one input is a hang; a shipped scene takes a fiftieth of a second."""

MEMORY = 2**30
"""Bytes that one input may take."""

PLACE = re.compile(r".*scene\.yaml(:\d+:\d+)?: \S.*[.?]")


class Hang(BaseException):
    """An input took too long."""


def alarmed(*_):
    raise Hang(f"more than {SECONDS} s")


def peak():
    """Most memory this process has held [bytes]."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


def complaint(path):
    """What is wrong with the way `granflow check` takes a file, or None."""
    said, answer = io.StringIO(), io.StringIO()
    signal.setitimer(signal.ITIMER_REAL, SECONDS)
    try:
        with contextlib.redirect_stderr(said), contextlib.redirect_stdout(answer):
            code = main(["check", str(path)])
    except BaseException:
        return traceback.format_exc()
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
    lines = said.getvalue().splitlines()
    if code == 0:
        wrong = [line for line in lines if not line.startswith("granflow: warning: ")]
        return f"accepted with {wrong}" if wrong or "no problems found" not in answer.getvalue() else None
    if code != 2 or not lines or not re.fullmatch(r"\d+ problems? found\.", lines.pop()):
        return f"exit {code} with {lines}"
    wrong = [line for line in lines if not PLACE.fullmatch(line) or "Error" in line]
    invented = "nan" in said.getvalue() and "nan" not in path.read_text("latin-1")
    return f"refused with {lines}" if wrong or invented or not lines else None


def limited():
    """Set the alarm and the limits of this process, and make warnings errors."""
    signal.signal(signal.SIGALRM, alarmed)
    virtual = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (virtual + MEMORY, virtual + MEMORY))
    warnings.simplefilter("error")


def survivors(folder, first, count, made):
    """How many of `count` inputs end well, and for the others their bytes and what went wrong."""
    main(["check", str(Path(__file__).parents[2] / "scenes" / "hopper.yaml")])
    limited()
    path, failures, accepted = Path(folder) / "scene.yaml", [], 0
    before = peak()
    for number in range(first, first + count):
        raw = MAKERS[made](number)
        path.write_bytes(raw)
        if wrong := complaint(path):
            failures.append([number, raw.decode("latin-1")[:3000], wrong])
    return [failures, peak() - before, accepted]


MAKERS = {"mutants": lambda number: mutant(random.Random(number))}
