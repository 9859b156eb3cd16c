"""Mutation test: puts one wrong text after another into a copy of the source and runs the tests that must notice.

python tools/mutate.py                  all mutations of tools/mutations.py, one line each; exit code 1 if one survives
python tools/mutate.py "unit N/cm"      these only
python tools/mutate.py --check          only whether the text of every mutation occurs once in its file
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
"""Seconds for the tests of one mutation; more counts as killed, since a loop that does not end is noticed."""

PASSED, FAILED = 0, 1
"""Exit codes of pytest."""


def problems(mutations: Iterable[Mutation], root: Path = ROOT) -> list[str]:
    """One sentence for each mutation whose text does not occur exactly once in its file."""
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
    """A copy of the source, the tests and what they read."""
    for name in PARTS:
        source = root / name
        if source.is_dir():
            shutil.copytree(source, folder / name, ignore=shutil.ignore_patterns("__pycache__", ".pytest_cache"))
        elif source.is_file():
            shutil.copy2(source, folder / name)
    return folder


def outcome(copy: Path, tests: Sequence[str], kernels: Path) -> int | None:
    """Exit code of pytest in a copy; None where it takes too long."""
    environment = os.environ | {"PYTHONPATH": str(copy), "GRANFLOW_CACHE": str(kernels)}
    command = [sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", *tests]
    try:
        return subprocess.run(command, cwd=copy, env=environment, capture_output=True, timeout=LONGEST).returncode
    except subprocess.TimeoutExpired:
        return None


@contextmanager
def mutated(copy: Path, mutation: Mutation) -> Iterator[None]:
    """The copy with the wrong text in it; the right one afterwards."""
    path = copy / mutation.file
    text = path.read_text(encoding="utf-8")
    path.write_text(text.replace(mutation.old, mutation.new), encoding="utf-8")
    try:
        yield
    finally:
        path.write_text(text, encoding="utf-8")


def verdict(copy: Path, mutation: Mutation, kernels: Path) -> str:
    """killed, SURVIVED, or ERROR where pytest could not run the tests."""
    with mutated(copy, mutation):
        code = outcome(copy, mutation.tests, kernels)
    if code is None:
        return "killed (took too long)"
    return {PASSED: "SURVIVED", FAILED: "killed"}.get(code, f"ERROR (pytest ended with {code})")


def run(mutations: Sequence[Mutation], workers: int) -> list[tuple[Mutation, str]]:
    """Verdicts on all mutations; prints each as it is known. The tests must pass without a mutation first."""
    with tempfile.TemporaryDirectory() as folder:
        copies = [copy_to(Path(folder) / f"copy_{number}") for number in range(workers)]
        kernels = Path(folder) / "kernels"
        tests = sorted({test for each in mutations for test in each.tests})
        code = outcome_without(copies[0], tests, kernels)
        if code != PASSED:
            raise SystemExit(f"Without a mutation, pytest ends with {code}: repair the tests first.")
        with ThreadPoolExecutor(workers) as pool:
            parts = [mutations[number::workers] for number in range(workers)]
            found = pool.map(lambda copy, part: [report(copy, each, kernels) for each in part], copies, parts)
            by_name = dict(pair for part in found for pair in part)
    return [(each, by_name[each.name]) for each in mutations]


def outcome_without(copy: Path, tests: Sequence[str], kernels: Path) -> int | None:
    """Exit code of the tests without a mutation, file by file: several at once could exceed the time for one."""
    files = sorted({test.partition("::")[0] for test in tests})
    for file in files:
        code = outcome(copy, [test for test in tests if test.partition("::")[0] == file], kernels)
        if code != PASSED:
            print(f"{file}: failed without a mutation", flush=True)
            return code
    return PASSED


def report(copy: Path, mutation: Mutation, kernels: Path) -> tuple[str, str]:
    """Name and verdict of one mutation, printed."""
    found = verdict(copy, mutation, kernels)
    print(f"{found:24} {mutation.name:32} {mutation.file}", flush=True)
    return mutation.name, found


def main() -> int:
    """Run the mutations; 1 where one is not killed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", help="names of mutations; left out: all")
    parser.add_argument("--check", action="store_true", help="only compare the mutations with the source")
    parser.add_argument("--jobs", type=int, default=2, help="copies that run side by side (default 2)")
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
    verdicts = run(chosen, max(min(options.jobs, len(chosen)), 1))
    alive = [each.name for each, found in verdicts if not found.startswith("killed")]
    print(f"{len(verdicts) - len(alive)} of {len(verdicts)} killed" + (f"; not: {', '.join(alive)}" if alive else ""))
    return 1 if alive else 0


if __name__ == "__main__":
    sys.exit(main())
