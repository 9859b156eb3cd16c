"""One adversarial case: an input or a fault, the command lines, and the expected result."""

import csv
import json
import math
import os
import re
import shutil
import subprocess
import tempfile
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from adversarial.sandbox import FinishedProcess, Sandbox, Skip

MEGABYTES = 1500
"""Peak memory of one process [MB]: Taichi and its compiler take about 500."""


@dataclass(frozen=True)
class Case:
    """An input and the expected behavior of granflow.

    `commands`: command lines of granflow, run in order; all but the last must succeed. `act`: replaces them
    by a function that returns the process to check. `patterns`: regular expressions that must occur in its
    output. `verify`: further assertions; `verified`: their meaning, for the page. `blur`: a regular
    expression for the part of the message that differs from run to run.
    """

    group: str
    name: str
    input: str
    commands: tuple[str, ...] = ()
    code: int | tuple[int, ...] = 2
    patterns: tuple[str, ...] = ()
    prepare: Callable[[Sandbox], object] | None = None
    act: Callable[[Sandbox], FinishedProcess] | None = None
    verify: Callable[[Sandbox, FinishedProcess], None] | None = None
    verified: str = ""
    mask: str = ""
    seconds: float = 600.0
    megabytes: float = MEGABYTES
    quick: bool = False
    killed: bool = False


@dataclass(frozen=True)
class Outcome:
    """Result of a case as text for the page, and its faults. `skipped`: the reason if it did not run."""

    case: Case
    result: str
    faults: tuple[str, ...] = ()
    skipped: str = ""


def outcome_of(case: Case) -> Outcome:
    """Runs one case in a new temporary directory and checks its result."""
    folder = Path(tempfile.mkdtemp(prefix="granflow-"))
    try:
        folder.chmod(0o755)
        home = folder / "home"
        home.mkdir()
        return _checked(case, Sandbox(home, case.seconds))
    except Skip as skip:
        return Outcome(case, "", skipped=str(skip))
    finally:
        _remove(folder)


def _checked(case: Case, sandbox: Sandbox) -> Outcome:
    if case.prepare is not None:
        case.prepare(sandbox)
    try:
        finished = case.act(sandbox) if case.act is not None else _in_order(case, sandbox)
    except (AssertionError, OSError, subprocess.SubprocessError) as error:
        finished = sandbox.history[-1] if sandbox.history else FinishedProcess("", None, "", "")
        return Outcome(case, _result_text(case, finished, False), (f"{type(error).__name__}: {error}",))
    faults = [*_faults_of_result(case, finished), *_faults_of_processes(case, sandbox)]
    if not case.killed:
        faults += [
            f"{folder.name}: {defect}" for folder in run_folders(sandbox.home) for defect in defects(folder)
        ]
    if case.verify is not None and not faults:
        try:
            case.verify(sandbox, finished)
        except AssertionError as error:
            faults.append(f"verification failed: {error}")
    return Outcome(case, _result_text(case, finished, not faults), tuple(faults))


def _in_order(case: Case, sandbox: Sandbox) -> FinishedProcess:
    for command in case.commands[:-1]:
        before = sandbox.run(command)
        assert before.code == 0, f"granflow {command} exits with {before.code}: {before.err[-1000:]}"
    return sandbox.run(case.commands[-1])


def _faults_of_result(case: Case, finished: FinishedProcess) -> list[str]:
    codes = case.code if isinstance(case.code, tuple) else (case.code,)
    found = []
    if finished.code is None:
        found.append(f"does not end within {case.seconds:g} s")
    elif finished.code not in codes:
        found.append(
            f"exit code {finished.code}, expected {' or '.join(map(str, codes))}: {finished.err[-600:]}"
        )
    text = " ".join(finished.text.split())
    missing = [
        f"no {pattern!r} in the output: {finished.text[-600:]}"
        for pattern in case.patterns
        if not re.search(pattern, text, re.I)
    ]
    return found + missing


def _faults_of_processes(case: Case, sandbox: Sandbox) -> list[str]:
    found = []
    for finished in sandbox.history:
        if re.search(r"Traceback|Logging error|Segmentation|core dumped", finished.text):
            found.append(f"granflow {finished.command} prints a traceback: {finished.text[-400:]}")
        if re.search(r"[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f]", finished.text):
            found.append(
                f"granflow {finished.command} prints control characters: {ascii(finished.err[:400])}"
            )
        if finished.megabytes > case.megabytes:
            found.append(
                f"granflow {finished.command} takes {finished.megabytes:.0f} MB, more than {case.megabytes:g}"
            )
    return found


def run_folders(home: Path) -> list[Path]:
    """Directories below `home` that a run has written."""
    return sorted(path.parent for path in home.rglob("scene_as_run.yaml") if path.is_file())


UNDEFINED = "residence_time"
"""Start of the columns that are NaN as long as no particle has passed the flow meter."""


def defects(folder: Path) -> list[str]:
    """Defects of the files of a run: temporary files, unreadable or unlisted frames, NaN, rows of unequal
    length."""
    found = [f"the temporary file {path.name} remains" for path in folder.glob(".*.part")]
    for pvd in folder.glob("*.pvd"):
        try:
            listed = {each.get("file") for each in ElementTree.parse(pvd).iter("DataSet")}
        except ElementTree.ParseError as error:
            found.append(f"{pvd.name} is not XML: {error}")
            continue
        found += [
            f"{pvd.name} lists {name}, which does not exist"
            for name in listed
            if not (folder / name).is_file()
        ]
    for path in folder.glob("*.vtu"):
        if b"</VTKFile>" not in path.read_bytes()[-200:]:
            found.append(f"{path.name} is incomplete")
    for path in folder.glob("result.json"):
        json.loads(path.read_text())
    return found + _row_defects(folder / "timeseries.csv")


def _row_defects(path: Path) -> list[str]:
    if not path.is_file():
        return []
    with path.open(newline="") as file:
        rows = list(csv.reader(file))
    found = [
        f"row {i} of {path.name} has {len(row)} of {len(rows[0])} columns"
        for i, row in enumerate(rows)
        if len(row) != len(rows[0])
    ]
    numbers = [
        (i, text)
        for i, row in enumerate(rows[1:], 1)
        for name, text in zip(rows[0], row, strict=False)
        if re.fullmatch(r"[-+.\d].*|nan|inf", text) and not name.startswith(UNDEFINED)
    ]
    for i, text in numbers:
        try:
            finite = math.isfinite(float(text))
        except ValueError:
            continue
        if not finite:
            found.append(f"row {i} of {path.name} contains {text}")
    return found


def _result_text(case: Case, finished: FinishedProcess, passed: bool) -> str:
    """Exit code, first line of the message, and verified properties; the text is equal in all runs."""
    message = finished.message or (
        "" if finished.code else next(iter(finished.out.splitlines()), "") if len(finished.out) < 400 else ""
    )
    for pattern, text in (*VARIABLE_PARTS, *([(case.mask, "...")] if case.mask else [])):
        message = re.sub(pattern, text, message)
    parts = [
        f"exit code {finished.code}" if finished.code is not None else f"no end within {case.seconds:g} s"
    ]
    parts += [f"`{plain(message)}`"] if message else []
    parts += [case.verified] if case.verified and passed else []
    return "; ".join(parts)


VARIABLE_PARTS = (
    (r"\(choose from .*\)", "(choose from ...)"),
    (r"(?i)(stopped at|resumed from|continues from) [-+.\de]+ s\b", r"\1 T s"),
    (r"[-+.\de]+ (GB|MB|GiB|MiB)", r"N \1"),
    (r"checkpoint_\d+", "checkpoint_N"),
    (r"/tmp/[^\s:]*", "/tmp/..."),
)
"""Patterns of values that differ from run to run, and their replacements."""


def plain(text: str, longest: int = 300) -> str:
    """Text for one cell of a Markdown table: no control characters, no bars, at most `longest` characters."""
    shown = (
        "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text).replace("|", "\\|").replace("`", "'")
    )
    return shown if len(shown) <= longest else shown[: longest - 4] + " ..."


def _remove(folder: Path) -> None:
    for path in folder.rglob("*"):
        if path.is_dir() and not path.is_symlink():
            os.chmod(path, 0o755)
    shutil.rmtree(folder, ignore_errors=True)
