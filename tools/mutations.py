"""Random mutations of the source: which tests detect which error.

    python tools/mutations.py draw 400 --seed 1 --out mutations.json [--places FILE ...]
    python tools/mutations.py run mutations.json results.jsonl [--executed FOLDER] [ARGUMENT of pytest ...]
    python tools/mutations.py cover results.jsonl durations.txt

`draw` chooses statements, operators, numbers and conditions of the core at random, each place with the same
probability, and one error at each place: the operators of Cosmic Ray (`pip install cosmic-ray`), and the
removal of a statement. `run` inserts one error at a time into a copy of the clone, runs pytest there, and
appends the tests that fail; a repetition goes on where the last one ended. Test files that name the module
of the error run first, then those of its part; with `-x` among the arguments, `run` thus soon knows whether
an error is detected. With the files of `tools/executed_lines.py`, only tests run that execute the line of the
error or inline its device function; an error on a line that no test executes survives at once, and one on a
line outside of functions concerns all tests that execute another line of the module. The tests must pass
without an error, which only a run without these files verifies first. `cover` names the tests
that suffice for all detected errors, by their time (a file written by `pytest --durations=0
--durations-min=0`), and the rate of detection.
"""

import argparse
import ast
import json
import os
import random
import re
import subprocess
import sys
import tempfile
from collections import defaultdict
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

import parso
from cosmic_ray.ast import ast_nodes
from cosmic_ray.mutating import MutationVisitor
from cosmic_ray.operators.operator import Operator
from cosmic_ray.plugins import get_operator, operator_names
from source_copy import copy_to, write_later

ROOT = Path(__file__).resolve().parents[1]
CORE = tuple(
    f"granflow/{name}"
    for name in ("contact", "engine", "geometry", "particles", "plan", "scene", "io", "observers", "runs")
)
LEFT_OUT = re.compile(
    r"RemoveDecorator|ExceptionReplacer|Variable|_(BitXor|BitOr|BitAnd|LShift|RShift|FloorDiv|Mod|Pow|Is|IsNot)$"
)
"""Operators of Cosmic Ray whose errors do not occur in practice, such as a name that does not exist."""
LONGEST = 7200.0
"""Time limit [s] of pytest; an error that exceeds it counts as detected. A single test has its own limit."""


class RemoveStatement(Operator):
    """Replaces a call, or an assignment to a name that has another value before, by `pass`."""

    def mutation_positions(self, node: Any) -> Iterator[tuple]:
        """See Operator; docstrings are no statements."""
        function = node.search_ancestor("funcdef")
        if function is None or node.parent.type != "simple_stmt":
            return
        target = node.children[0] if node.type == "expr_stmt" else None
        if target is not None and target.type == "name" and "=" in node.children:
            others = re.findall(rf"\b{target.value} *(?:[-+*/]?=(?!=)|,|\))", function.get_code())
            if len(others) < 2:  # the name would not exist
                return
        if node.type in ("expr_stmt", "atom_expr"):
            yield node.start_pos, node.end_pos

    def mutate(self, node: Any, index: int) -> parso.tree.Leaf:
        """See Operator."""
        return parso.python.tree.Keyword("pass", node.start_pos, prefix=node.get_first_leaf().prefix)

    @classmethod
    def examples(cls) -> tuple:
        """See Operator."""
        return ()


@cache
def operators() -> dict[str, Operator]:
    """All operators by name."""
    found = {name: get_operator(name) for name in operator_names() if not LEFT_OUT.search(name)}
    return {name: each() for name, each in found.items() if not each.arguments()} | {
        "RemoveStatement": RemoveStatement()
    }


def annotation_lines(source: str) -> set[tuple[int, int]]:
    """Positions (line, column) at which annotations of types begin and end."""
    found = set()
    for node in ast.walk(ast.parse(source)):
        for name in ("annotation", "returns"):
            each = getattr(node, name, None)
            if each is not None:
                for line in range(each.lineno, each.end_lineno + 1):
                    begin = each.col_offset if line == each.lineno else 0
                    end = each.end_col_offset if line == each.end_lineno else 1000
                    found |= {(line, column) for column in range(begin, end)}
    return found


def mutations_of(path: Path, known: dict[str, Operator]) -> dict[tuple, list[dict]]:
    """The possible errors of one file by their position."""
    source = path.read_text(encoding="utf-8")
    ignored = annotation_lines(source)
    found = defaultdict(list)
    count: dict[str, int] = defaultdict(int)
    for node in ast_nodes(parso.parse(source)):
        for name, operator in known.items():
            for begin, _end in operator.mutation_positions(node):
                if begin not in ignored:
                    file = path.relative_to(ROOT).as_posix()
                    found[begin].append({"file": file, "operator": name, "occurrence": count[name]})
                count[name] += 1
    return found


def draw(count: int, seed: int, places: Iterable[str]) -> list[dict]:
    """Errors at `count` different positions; `line` is where each one is."""
    known = operators()
    paths = [each for place in places for each in sorted([ROOT / place, *(ROOT / place).rglob("*.py")])]
    every = [
        [each | {"line": position[0]} for each in mutations]
        for path in paths
        if path.is_file()
        for position, mutations in sorted(mutations_of(path, known).items())
    ]
    chosen = random.Random(seed)
    return [chosen.choice(mutations) for mutations in chosen.sample(every, min(count, len(every)))]


def mutated(source: str, mutation: dict) -> str:
    """The source of a file with an error."""
    return MutationVisitor.mutate_code(source, operators()[mutation["operator"]], mutation["occurrence"])


def nearest_first(copy: Path, file: str, tests: Iterable[str] | None = None) -> list[str]:
    """These tests, or all files: those that name the module of a source file, those of its part, all others.

    Tests of one file keep their order, because some share a simulation.
    """
    module = file.removesuffix(".py").replace("/", ".")
    text = cache(lambda path: (copy / path).read_text(encoding="utf-8"))

    def place(test: str) -> tuple[int, str, int]:
        path, _, name = test.partition("::")
        is_of_part = Path(path).parent.name == Path(file).parts[1]
        distance = 0 if module in text(path) else 1 if is_of_part else 2
        return distance, path, text(path).find(f"def {name}(")

    if tests is None:
        tests = [path.relative_to(copy).as_posix() for path in (copy / "tests").rglob("test_*.py")]
    return sorted(tests, key=place)


class Executed:
    """Tests by the line and by the device function that they execute, see `tools/executed_lines.py`."""

    def __init__(self, folder: Path) -> None:
        self._lines: dict[str, set[str]] = defaultdict(set)
        self._functions: dict[str, set[str]] = defaultdict(set)
        for path in folder.glob("*.json"):
            found = json.loads(path.read_text(encoding="utf-8"))
            for into, part in ((self._lines, "lines"), (self._functions, "functions")):
                for place, tests in found[part].items():
                    into[place] |= {test.split("[")[0] for test in tests}

    def tests_of(self, file: str, line: int) -> set[str]:
        """Tests that execute a line, without the cases of their parameters."""
        tree = ast.parse((ROOT / file).read_text(encoding="utf-8"))
        found = set()
        inside = False
        for node in ast.walk(tree):
            if isinstance(node, ast.FunctionDef) and node.lineno <= line <= (node.end_lineno or 0):
                inside = True
                first = min([node.lineno, *(each.lineno for each in node.decorator_list)])
                found |= self._functions[f"{file}:{first}"]
            elif isinstance(node, ast.stmt) and not hasattr(node, "body"):
                if node.lineno <= line <= (node.end_lineno or 0):
                    found |= self._lines[f"{file}:{node.lineno}"]
        found |= self._lines[f"{file}:{line}"]
        if not inside:
            found |= {
                test for place, tests in self._lines.items() if place.startswith(f"{file}:") for test in tests
            }
        return found - {""}


def failed_tests(copy: Path, arguments: Iterable[str]) -> list[str]:
    """Tests of a copy of the clone that fail; "" for a failure outside of the tests or a timeout."""
    environment = os.environ | {"PYTHONPATH": str(copy), "GRANFLOW_CACHE": str(copy / "kernels")}
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *arguments]
    try:
        done = subprocess.run(
            command, cwd=copy, env=environment, capture_output=True, text=True, timeout=LONGEST
        )
    except subprocess.TimeoutExpired:
        return [""]
    found = re.findall(r"^(?:FAILED|ERROR) (\S+(?: .*?)?)(?: - .*)?$", done.stdout, re.MULTILINE)
    return found or ([""] if done.returncode else [])


def run(mutations: list[dict], results: Path, executed: Executed | None, arguments: list[str]) -> None:
    """Append the failed tests of each error to the results."""
    done = results.read_text(encoding="utf-8").splitlines() if results.is_file() else []
    with tempfile.TemporaryDirectory() as folder:
        copy_to(Path(folder))
        if executed is None and (failed := failed_tests(Path(folder), arguments)):
            raise SystemExit(f"Without an error, these tests fail: {failed}")
        for mutation in mutations[len(done) :]:
            path = Path(folder, mutation["file"])
            source = path.read_text(encoding="utf-8")
            write_later(path, mutated(source, mutation))
            tests = executed.tests_of(mutation["file"], mutation["line"]) if executed else None
            chosen = any(each.startswith("tests") for each in arguments)
            order = [] if chosen else nearest_first(Path(folder), mutation["file"], tests)
            failed = failed_tests(Path(folder), [*arguments, *order]) if chosen or order else []
            write_later(path, source)
            with results.open("a", encoding="utf-8") as file:
                file.write(json.dumps(mutation | {"failed": failed}) + "\n")
            print("detected" if failed else "SURVIVED", *mutation.values(), flush=True)


def cover(results: list[dict], seconds: dict[str, float]) -> list[str]:
    """Tests that suffice for all detected errors: again and again the one with most of the rest per time."""
    left = [set(each["failed"]) for each in results if each["failed"]]
    found: list[str] = []
    while left := [each for each in left if not each & set(found)]:
        gains: dict[str, float] = defaultdict(float)
        for tests in left:
            for test in tests:
                gains[test] += 1.0 / (seconds.get(test, 0.0) + 0.1)
        found.append(max(sorted(gains), key=gains.__getitem__))
    return found


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    one = commands.add_parser("draw")
    one.add_argument("count", type=int)
    one.add_argument("--seed", type=int, default=1)
    one.add_argument("--out", type=Path, required=True)
    one.add_argument("--places", nargs="+", default=CORE)
    one = commands.add_parser("run")
    one.add_argument("mutations", type=Path)
    one.add_argument("results", type=Path)
    one.add_argument("--executed", type=Path)
    one = commands.add_parser("cover")
    one.add_argument("results", type=Path)
    one.add_argument("durations", type=Path)
    options, arguments = parser.parse_known_args()
    if options.command == "draw":
        options.out.write_text(json.dumps(draw(options.count, options.seed, options.places), indent=0))
    elif options.command == "run":
        executed = Executed(options.executed) if options.executed else None
        run(json.loads(options.mutations.read_text()), options.results, executed, arguments)
    else:
        results = [json.loads(line) for line in options.results.read_text().splitlines()]
        times = re.findall(r"^([\d.]+)s (?:call|setup) +(\S.*)$", options.durations.read_text(), re.MULTILINE)
        seconds: dict[str, float] = defaultdict(float)
        for time, test in times:
            seconds[test] += float(time)
        detected = sum(bool(each["failed"]) for each in results)
        print(*cover(results, seconds), sep="\n")
        print(f"{detected} of {len(results)} errors are detected.")


if __name__ == "__main__":
    main()
