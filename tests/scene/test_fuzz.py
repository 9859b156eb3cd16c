"""`granflow check` of anything at all ends in a scene or in sentences with places: no traceback, hang or flood."""

import contextlib
import io
import os
import random
import re
import resource
import signal
import traceback
import warnings
from pathlib import Path

import pytest
from fuzzing import SCENES, hypothesis_files, mutated_file, written
from subprocess_runner import in_subprocess

from granflow.cli import main
from granflow.errors import SceneError
from granflow.plan import memory_check
from granflow.scene import load

SECONDS, WAITING = 20, 200
"""More computing, or more waiting, than this for one input is a hang; a shipped scene takes a fiftieth of a second."""

MEMORY = 2**30
"""Bytes that one input may take."""

FREE = 120_000_000
"""Memory [bytes] that the machine is made to have, so that no great pack is placed: that takes time by right."""

PLACE = re.compile(r".*scene\.yaml(:\d+:\d+)?: \S.*[.?]")


class Hang(BaseException):
    """An input took too long."""


def alarmed(*_):
    raise Hang(f"more than {SECONDS} s of computing or {WAITING} s of waiting")


def set_alarm(computing, queued):
    signal.setitimer(signal.ITIMER_PROF, computing)
    signal.setitimer(signal.ITIMER_REAL, queued)


def peak():
    """Most memory this process has held [bytes]."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


def check(path):
    """Exit code of `granflow check` and what it says on stderr."""
    message = io.StringIO()
    set_alarm(SECONDS, WAITING)
    try:
        with contextlib.redirect_stderr(message), contextlib.redirect_stdout(io.StringIO()):
            return main(["check", str(path)]), message.getvalue()
    except BaseException:
        return None, traceback.format_exc()
    finally:
        set_alarm(0, 0)


def complaint(path):
    """Exit code of `granflow check` of a file, and what is wrong with the way it takes the file, or None."""
    code, message = check(path)
    lines = message.splitlines()
    if code == 0:
        right = all(line.startswith("granflow: warning: ") for line in lines)
    else:
        counted = lines and re.fullmatch(r"\d+ problems? found\.", lines[-1])
        invented = "nan" in message and "nan" not in path.read_text("latin-1")
        right = code == 2 and counted and all(PLACE.fullmatch(line) for line in lines[:-1]) and not invented
    return code, None if right else f"exit code {code}: {message}"


def limited():
    """Set the alarm and the limits of this process, and make warnings errors."""
    for each in (signal.SIGALRM, signal.SIGPROF):
        signal.signal(each, alarmed)
    virtual = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (virtual + MEMORY, virtual + MEMORY))
    memory_check.available_memory = lambda: FREE
    warnings.simplefilter("error")


def outcome(folder, files):
    """How many files are scenes, the most memory taken [bytes]; of failures number, bytes and what went wrong."""
    path, failures, accepted = Path(folder) / "scene.yaml", [], 0
    path.write_text(written(SCENES[0], random.Random(0)), encoding="utf-8")
    assert complaint(path)[1] is None, "what is loaded on first use must not count"
    limited()
    before = peak()
    for number, raw in enumerate(files):
        path.write_bytes(raw)
        code, wrong = complaint(path)
        accepted += code == 0
        if wrong:
            failures.append([number, raw[:300].decode("latin-1"), wrong])
    return accepted, peak() - before, failures


def mutants_outcome(folder, first, count):
    return outcome(folder, (mutated_file(random.Random(number)) for number in range(first, first + count)))


def hypothesis_outcome(folder, count):
    return outcome(folder, hypothesis_files(count))


def survives(found, count):
    accepted, memory, failures = found
    shown = "\n".join(f"--- input {number}\n{raw}\n--- {wrong}" for number, raw, wrong in failures[:3])
    assert not failures, f"{len(failures)} of {count} inputs:\n{shown}"
    assert memory < MEMORY
    assert accepted < count
    return accepted


def test_changed_scenes(tmp_path):
    accepted = survives(in_subprocess(mutants_outcome, str(tmp_path), 0, 300), 300)
    assert accepted > 20, "some changes leave a scene"


def test_anything(tmp_path):
    survives(in_subprocess(hypothesis_outcome, str(tmp_path), 200), 200)


@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("first", range(1000, 13_000, 3000))
def test_many_changed_scenes(tmp_path, first):
    survives(in_subprocess(mutants_outcome, str(tmp_path), first, 3000, seconds=3500), 3000)


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_much_of_anything(tmp_path):
    survives(in_subprocess(hypothesis_outcome, str(tmp_path), 8000, seconds=3500), 8000)


MANY = 3000
LAUGHS = "a0: &a0 [x, x]\n" + "".join(f"a{n + 1}: &a{n + 1} [*a{n}, *a{n}]\n" for n in range(60))
TRAPS = {
    "aliases that double": LAUGHS,
    "an anchor in itself": "title: &a [*a]",
    "an anchor in itself, further down": "title: &a {b: {c: [1, *a]}}",
    "merge key": "a: &a {b: 1}\nc: {<<: *a}",
    "python tag": "title: !!python/object/apply:os.system ['touch pwned']",
    "pickle": "title: !!binary gASVBQAAAAAAAACMAWGULg==",
    "nothing": "",
    "only comments": "# a\n" * MANY,
    "only a tab": "\t",
    "tabs": "title: x\nrun:\n\tduration: 1\n",
    "NUL": "title: a\0b",
    "deep lists": "[" * 100_000,
    "deep mappings": "{a: " * 100_000,
    "deep blocks": "".join(" " * n + f"k{n}:\n" for n in range(MANY)),
    "deep dashes": "- " * 100_000,
    "questions": "? " * 100_000,
    "a long integer": "seed: " + "9" * 1_000_000,
    "a long hexadecimal": "seed: 0x" + "f" * 1_000_000,
    "a long key": "k" * 1_000_000 + ": 1",
    "a long word": "title: " + "x" * 1_000_000,
    "a key that begins with a space": '" title": x',
    "the same key": "title: x\n" * MANY,
    "many keys": "".join(f"k{n}: 1\n" for n in range(6000)),
    "many documents": "---\n" * MANY,
    "many anchors": "title: [" + ", ".join(f"&a{n} x" for n in range(MANY)) + "]",
    "many tags": "%TAG ! tag:x,2000:\n" * MANY + "---\na: 1",
    "half a surrogate": 'title: "\\ud800"',
    "infinities": "gravity: [.inf, -.inf, .nan]",
    "beyond floats": "gravity: [1e308, 1e400, -1e999]",
    "materials without end": "materials:\n" + "".join(f"  m{n}: {{density: 1}}\n" for n in range(MANY)),
    "particles without end": "particles:\n" + "".join(f"  m{n}: {{material: x{n}}}\n" for n in range(MANY)),
}


def traps_outcome(folder, kind):
    return outcome(folder, (text.encode() for text in (TRAPS if kind == "small" else floods()).values()))


def test_traps(tmp_path):
    """Bombs, loops, tags, depth and length: each is refused."""
    assert survives(in_subprocess(traps_outcome, str(tmp_path), "small"), len(TRAPS)) == 0
    assert not list(tmp_path.glob("pwned"))


def floods():
    """Files of 10 MB, and of almost the 4 MiB that are read."""
    return {f"{name}, {scale}": text for scale in (10**7, 2**22 - 200) for name, text in floods_of(scale).items()}


def floods_of(scale):
    shapes = {
        "scalars": ("title: [", "0,", "0]"), "lists": ("title: [", "[],", "0]"), "dashes": ("title:\n", "- a\n", ""),
        "text": ("title: '", "a", "'"), "words": ("title: ", "a ", "a"), "block": ("title: |\n", " b\n", ""),
        "lines": ("", "\n", ""), "comments": ("", "#\n", ""), "quote": ("a: '", "\n", ""),
        "digits": ("seed: ", "9", ""), "colons": ("", ":", ""), "anchors": ("title: [", "&a 1,", "0]"),
        "keys": ("", "k: 1\n", ""),
        "positions": ("title: x\nparticles: {a: {insert: {kind: positions, positions: [", "[0,0,0],", "]}}}"),
        "bad items": ("particles: {a: {insert: {kind: positions, positions: [", "0," + 15 * " ", "0]}}}"),
        "bad walls": ("walls:\n", "  w: {" + ", ".join(f"k{k}: 1" for k in range(48)) + "}\n", ""),
    }  # fmt: skip
    found = {name: head + body * (scale // len(body)) + tail for name, (head, body, tail) in shapes.items()}
    return found | {"bad walls": renumbered(found["bad walls"])}


def renumbered(text):
    """Walls with names of their own."""
    return "".join(line.replace("  w:", f"  w{n}:", 1) for n, line in enumerate(text.splitlines(True)))


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_floods(tmp_path):
    assert survives(in_subprocess(traps_outcome, str(tmp_path), "large", seconds=3500), len(floods())) == 0


def odd_files(folder):
    """Things that are no scene files, by what must be said of them."""
    folder = Path(folder)
    os.mkfifo(folder / "fifo.yaml")
    (folder / "loop.yaml").symlink_to("loop.yaml")
    (folder / "nowhere.yaml").symlink_to("gone.yaml")
    (folder / "zero.yaml").symlink_to("/dev/zero")
    (folder / "up.yaml").symlink_to(folder)
    (folder / "sparse.yaml").write_bytes(b"")
    os.truncate(folder / "sparse.yaml", 2**40)
    return {
        str(folder): "this is a directory",
        "/dev/zero": "this is not a regular file",
        "/proc/self/pagemap": "this file is larger than 4 MiB",
        str(folder / "fifo.yaml"): "this is not a regular file",
        str(folder / "loop.yaml"): "the file cannot be read",
        str(folder / "nowhere.yaml"): "there is no such file",
        str(folder / "zero.yaml"): "this is not a regular file",
        str(folder / "up.yaml"): "this is a directory",
        str(folder / "sparse.yaml"): "this file is larger than 4 MiB",
        str(folder / ("n" * 300)): "the file cannot be read",
        "scene\0.yaml": "the file cannot be read",
        "": "this is a directory",
    }


def said_of_odd_files(folder):
    files, answers = odd_files(folder), []
    limited()
    for name, words in files.items():
        code, message = check(name)
        answers.append([name, code, words in message, message])
    return answers


def test_files_that_are_none(tmp_path):
    for name, code, reported, message in in_subprocess(said_of_odd_files, str(tmp_path)):
        assert code == 2, name
        assert reported, f"{name}: {message}"
        assert message.endswith("1 problem found.\n")


def test_a_link_to_a_scene_is_that_scene(tmp_path):
    scene = Path(__file__).parents[2] / "scenes" / "two_spheres.yaml"
    (tmp_path / "link.yaml").symlink_to(scene)
    assert main(["check", str(tmp_path / "link.yaml")]) == 0


TOO_MUCH = {
    "walls:\n" + "".join(f"  w{n}: 1\n" for n in range(5001)): (
        ":5002:3: this mapping has more than 5000 keys, too many for a scene.",
    ),
    "seed: [" + "0, " * 250_000 + "0]": (
        ":1:750002: the file has more than 250000 values up to here, too many for a scene.",
    ),
    "materials:\n" + "".join(f"  m{n}: {{}}\n" for n in range(51)): (
        ":1:1: materials has 51 entries, but the limit is 50.",
    ),
    "title: x\n" + "".join(f"k{n}: 1\n" for n in range(200)): (
        ":93:1: k91 is not a known key.",
        ":201:1: this is the last of 108 more problems, which are not shown.",
    ),
}


@pytest.mark.parametrize("text", TOO_MUCH, ids=["keys", "values", "entries", "problems"])
def test_what_is_said_of_too_much(tmp_path, text):
    path = tmp_path / "scene.yaml"
    path.write_text(text)
    with pytest.raises(SceneError) as refused:
        load(path)
    message = refused.value.problems
    assert len(message) <= 101
    for sentence in TOO_MUCH[text]:
        assert any(problem.startswith(f"{path}{sentence}") for problem in message), message[-3:]
