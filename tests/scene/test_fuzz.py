"""`granflow check` of arbitrary files: a valid scene or messages with positions, in bounded time and
memory."""

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
from fuzzing import SCENES, hypothesis_files, mutated_file, written
from subprocess_runner import in_subprocess

from granflow.cli.main import main
from granflow.errors import SceneError
from granflow.load import load_scene
from granflow.plan import cost as memory_check

CPU_TIME_MAX, WALL_TIME_MAX = 20, 200
"""CPU time and wall time [s] above which one input counts as a hang; a shipped scene takes 0.02 s."""

MEMORY = 2**30
"""Largest memory of one input [bytes]."""

AVAILABLE_MEMORY = 120_000_000
"""Simulated available memory [bytes]; it excludes large packings, which take a long time to generate."""

POSITION = re.compile(r".*scene\.yaml(:\d+:\d+)?: \S.*[.?]")


class Hang(BaseException):
    """The time limit of one input is exceeded."""


def raise_hang(*_):
    raise Hang(f"more than {CPU_TIME_MAX} s of CPU time or {WALL_TIME_MAX} s of wall time")


def set_alarm(cpu_time, wall_time):
    signal.setitimer(signal.ITIMER_PROF, cpu_time)
    signal.setitimer(signal.ITIMER_REAL, wall_time)


def peak():
    """Peak memory of this process [bytes]."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


def check(path):
    """Exit code of `granflow check` and its output on stderr; None and the traceback if it raises an
    exception."""
    message = io.StringIO()
    set_alarm(CPU_TIME_MAX, WALL_TIME_MAX)
    try:
        with contextlib.redirect_stderr(message), contextlib.redirect_stdout(io.StringIO()):
            return main(["check", str(path)]), message.getvalue()
    except BaseException:
        return None, traceback.format_exc()
    finally:
        set_alarm(0, 0)


def checked(path):
    """Exit code of `granflow check` of a file, and a description of incorrect behavior, or None."""
    code, message = check(path)
    lines = [line for line in message.splitlines() if not line.startswith("granflow: warning: ")]
    if code == 0:
        correct = not lines and is_read_back_equal(path)
    else:
        has_count = lines and re.fullmatch(r"\d+ problems? found\.", lines[-1])
        nan_not_in_file = "nan" in message and "nan" not in path.read_text("latin-1")
        positions = all(POSITION.fullmatch(line) for line in lines[:-1])
        correct = code == 2 and has_count and positions and not nan_not_in_file
    return code, None if correct else f"exit code {code}: {message}"


def is_read_back_equal(path):
    """Whether a valid scene equals the one that is read from its resolved form."""
    scene = load_scene(path)
    again = path.with_name("again.yaml")
    again.write_text(scene.to_yaml(), encoding="utf-8")
    return load_scene(again) == scene


def set_limits():
    """Set the time and memory limits of this process, and turn warnings into errors."""
    for each in (signal.SIGALRM, signal.SIGPROF):
        signal.signal(each, raise_hang)
    virtual = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (virtual + MEMORY, virtual + MEMORY))
    memory_check.available_memory = lambda: AVAILABLE_MEMORY
    warnings.simplefilter("error")


def check_files(folder, sources):
    """For each source of files, by name and number: number of valid scenes, and number, content and
    description of failures. Finally the increase of the peak memory [bytes]."""
    path = Path(folder) / "scene.yaml"
    path.write_text(written(SCENES[0], random.Random(0)), encoding="utf-8")
    assert checked(path)[1] is None, "the first check loads modules, which do not count as memory of an input"
    set_limits()
    before = peak()
    found = []
    for name, count in sources:
        failures = []
        accepted = 0
        for number, raw in enumerate(SOURCES[name](count)):
            path.write_bytes(raw)
            code, failure = checked(path)
            accepted += code == 0
            if failure:
                failures.append([number, raw[:300].decode("latin-1"), failure])
        found.append([accepted, failures])
    return *found, peak() - before


SOURCES = {
    "changed scenes": lambda count: (mutated_file(random.Random(number)) for number in range(count)),
    "random trees and bytes": hypothesis_files,
}


def test_fuzzed_files_are_accepted_or_rejected_with_positions(tmp_path):
    sources = (("changed scenes", 30), ("random trees and bytes", 10))
    *found, memory = in_subprocess(check_files, str(tmp_path), sources)
    for (name, count), (accepted, failures) in zip(sources, found, strict=True):
        examples = "\n".join(
            f"--- input {number}\n{raw}\n--- {failure}" for number, raw, failure in failures[:3]
        )
        assert not failures, f"{name}: {len(failures)} of {count} inputs:\n{examples}"
        assert accepted < count
    assert found[0][0] > 1, "some changes result in a valid scene"
    assert memory < MEMORY


GOOD = Path(__file__).parents[1] / "messages" / "good.yaml"
OVERRIDE_KEYS = "walls tube radius stages 0 name gravity 2 particles grit diameter classes x".split() + [""]
OVERRIDE_VALUES = [
    "", "~", "true", "-1", "0", "1e308", ".nan", "-.inf", "[]", "{}", "[1, 2, 3]", "{a: 1}", "'", '"', ":", "- ", "&a ",
    "*a", "\t", "!!int ", "4 Pa", "4 furlong", "1" * 400, "<x>", "[key]", "\x07", "\u2028", "é", "%", "? ", "|",
]  # fmt: skip


def test_random_overrides_give_a_scene_or_messages():
    rng = random.Random(3)
    refused = 0
    for _ in range(100):
        keys = rng.choices(OVERRIDE_KEYS, k=rng.randrange(6))
        try:
            load_scene(GOOD, [f"{'.'.join(keys)}={rng.choice(OVERRIDE_VALUES)}"])
        except SceneError as error:
            refused += 1
            assert error.problems
            for problem in error.problems:
                assert problem.startswith((str(GOOD), "--set")) and problem.endswith((".", "?"))
                assert "\n" not in problem
    assert refused > 50


def test_unreadable_paths_are_reported(tmp_path, capsys):
    (tmp_path / "loop.yaml").symlink_to("loop.yaml")
    (tmp_path / "nowhere.yaml").symlink_to("missing.yaml")
    (tmp_path / "large.yaml").write_bytes(bytes(5 * 2**20))
    for name, words in {
        ".": "this is a directory",
        "loop.yaml": "the file cannot be read",
        "nowhere.yaml": "there is no such file",
        "large.yaml": "this file is larger than 4 MiB",
    }.items():
        assert main(["check", str(tmp_path / name)]) == 2
        assert words in capsys.readouterr().err


def test_symbolic_link_to_a_scene_is_followed(tmp_path):
    scene = Path(__file__).parents[2] / "scenes" / "two_spheres.yaml"
    (tmp_path / "link.yaml").symlink_to(scene)
    assert main(["check", str(tmp_path / "link.yaml")]) == 0


LIMITS_EXCEEDED = {
    "materials:\n" + "".join(f"  m{n}: {{}}\n" for n in range(51)): (
        ":1:1: materials has 51 entries, but the limit is 50.",
    ),
    "title: x\n" + "".join(f"k{n}: 1\n" for n in range(200)): (
        ":93:1: k91 is not a known key.",
        ":201:1: this is the last of 108 more problems, which are not shown.",
    ),
}


@pytest.mark.parametrize("text", LIMITS_EXCEEDED, ids=["entries", "problems"])
def test_messages_state_the_exceeded_limit(tmp_path, text):
    path = tmp_path / "scene.yaml"
    path.write_text(text)
    with pytest.raises(SceneError) as caught:
        load_scene(path)
    problems = caught.value.problems
    assert len(problems) <= 101
    for sentence in LIMITS_EXCEEDED[text]:
        assert any(problem.startswith(f"{path}{sentence}") for problem in problems), problems[-3:]
