"""Mutation test: inserts one error at a time into a copy of the source and runs the tests that must detect
it.

python tools/mutate.py                  all mutations of tools/mutations.py, one line each; exit code 1 if one
survives python tools/mutate.py "unit N/cm"      only the given mutations
python tools/mutate.py --check          only checks that the text of each mutation occurs once in its file
"""

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

from mutations import MUTATIONS, Mutation

ROOT = Path(__file__).resolve().parents[1]
PARTS = ("granflow", "tests", "tools", "scenes", "docs", "pyproject.toml", "README.md", "CHANGELOG.md")
LONGEST = 300.0
"""Time limit [s] for the tests of one mutation; a mutation that exceeds it counts as killed."""

PASSED, FAILED = 0, 1
"""Exit codes of pytest."""


def problems(mutations: Iterable[Mutation], root: Path = ROOT) -> list[str]:
    """Messages for the mutations whose text does not occur exactly once in their file."""
    found = []
    for each in mutations:
        path = root / each.file
        count = path.read_text(encoding="utf-8").count(each.old) if path.is_file() else None
        if count is None:
            found.append(f"{each.name}: {each.file} does not exist; update tools/mutations.py.")
        elif count != 1:
            found.append(
                f"{each.name}: {each.file} contains the text {each.old!r} {count} times instead of once; "
                "update tools/mutations.py."
            )
    return found


def copy_to(folder: Path, root: Path = ROOT) -> Path:
    """Copies the source, the tests and the files that they read."""
    for name in PARTS:
        source = root / name
        if source.is_dir():
            shutil.copytree(
                source, folder / name, ignore=shutil.ignore_patterns("__pycache__", ".pytest_cache")
            )
        elif source.is_file():
            shutil.copy2(source, folder / name)
    return folder


def pytest_code(copy: Path, tests: Sequence[str], kernels: Path) -> int | None:
    """Exit code of pytest in a copy; None if it exceeds the time limit."""
    environment = os.environ | {"PYTHONPATH": str(copy), "GRANFLOW_CACHE": str(kernels)}
    command = [sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", *tests]
    try:
        return subprocess.run(
            command, cwd=copy, env=environment, capture_output=True, timeout=LONGEST
        ).returncode
    except subprocess.TimeoutExpired:
        return None


@contextmanager
def mutated(copy: Path, mutation: Mutation) -> Iterator[None]:
    """Applies a mutation to the copy and restores the file on exit."""
    path = copy / mutation.file
    text = path.read_text(encoding="utf-8")
    write_later(path, text.replace(mutation.old, mutation.new))
    try:
        yield
    finally:
        write_later(path, text)


def write_later(path: Path, text: str) -> None:
    """Replaces the text and sets a time of change 1 s or more after the previous one.

    Python takes stored bytecode as valid if the size of the source and its time of change in whole seconds
    agree; two mutations of equal length within one second would otherwise run the code of the first.
    """
    later = path.stat().st_mtime + 1.0
    path.write_text(text, encoding="utf-8")
    os.utime(path, (later, later))


def status_of(copy: Path, mutation: Mutation, kernels: Path) -> str:
    """`killed`, `SURVIVED`, or `ERROR` if pytest cannot run the tests."""
    with mutated(copy, mutation):
        code = pytest_code(copy, mutation.tests, kernels)
    if code is None:
        return "killed (time limit)"
    return {PASSED: "SURVIVED", FAILED: "killed"}.get(code, f"ERROR (pytest ended with {code})")


def run(mutations: Sequence[Mutation], workers: int) -> list[tuple[Mutation, str]]:
    """Status of each mutation, printed as soon as it is known. The tests must pass without a mutation."""
    with tempfile.TemporaryDirectory() as folder:
        copies = [copy_to(Path(folder) / f"copy_{number}") for number in range(workers)]
        kernels = Path(folder) / "kernels"
        tests = sorted({test for each in mutations for test in each.tests})
        code = code_without_mutation(copies[0], tests, kernels)
        if code != PASSED:
            raise SystemExit(f"Without a mutation, pytest ends with {code}: repair the tests first.")
        with ThreadPoolExecutor(workers) as pool:
            parts = [mutations[number::workers] for number in range(workers)]
            found = pool.map(lambda copy, part: [report(copy, each, kernels) for each in part], copies, parts)
            by_name = dict(pair for part in found for pair in part)
    return [(each, by_name[each.name]) for each in mutations]


def code_without_mutation(copy: Path, tests: Sequence[str], kernels: Path) -> int | None:
    """Exit code of the tests without a mutation, file by file, so that the time limit applies to one file."""
    files = sorted({test.partition("::")[0] for test in tests})
    for file in files:
        code = pytest_code(copy, [test for test in tests if test.partition("::")[0] == file], kernels)
        if code != PASSED:
            print(f"{file}: failed without a mutation", flush=True)
            return code
    return PASSED


def report(copy: Path, mutation: Mutation, kernels: Path) -> tuple[str, str]:
    """Name and status of one mutation; prints them."""
    found = status_of(copy, mutation, kernels)
    print(f"{found:24} {mutation.name:32} {mutation.file}", flush=True)
    return mutation.name, found


def main() -> int:
    """Runs the mutations; returns 1 if one is not killed."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("names", nargs="*", help="names of mutations; default: all")
    parser.add_argument(
        "--check", action="store_true", help="only check that the mutations apply to the source"
    )
    parser.add_argument("--jobs", type=int, default=2, help="number of copies tested simultaneously (2)")
    options = parser.parse_args()
    unknown = sorted(set(options.names) - {each.name for each in MUTATIONS})
    chosen = [each for each in MUTATIONS if not options.names or each.name in options.names]
    stale = [f"{name} is not the name of a mutation." for name in unknown] + problems(chosen)
    if stale:
        print("\n".join(stale), file=sys.stderr)
        return 1
    if options.check:
        print(f"{len(chosen)} mutations fit the source.")
        return 0
    statuses = run(chosen, max(min(options.jobs, len(chosen)), 1))
    surviving = [each.name for each, found in statuses if not found.startswith("killed")]
    print(
        f"{len(statuses) - len(surviving)} of {len(statuses)} killed"
        + (f"; not: {', '.join(surviving)}" if surviving else "")
    )
    return 1 if surviving else 0


if __name__ == "__main__":
    sys.exit(main())
