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

from adversarial.sandbox import Done, Sandbox, Skip

MEGABYTES = 1500
"""Peak memory of one process [MB]: Taichi and its compiler take about 500."""


@dataclass(frozen=True)
class Case:
    """An input, and what granflow must do with it.

    `commands`: command lines of granflow, run in order; all but the last must succeed. `act`: replaces them by a
    function that returns the process to judge. `says`: regular expressions that must all occur in its output.
    `verify`: further assertions; `verified`: what they establish, for the page. `blur`: a regular expression for the
    part of the message that differs from run to run.
    """

    group: str
    name: str
    input: str
    commands: tuple[str, ...] = ()
    code: int | tuple[int, ...] = 2
    says: tuple[str, ...] = ()
    prepare: Callable[[Sandbox], object] | None = None
    act: Callable[[Sandbox], Done] | None = None
    verify: Callable[[Sandbox, Done], None] | None = None
    verified: str = ""
    blur: str = ""
    seconds: float = 600.0
    megabytes: float = MEGABYTES
    quick: bool = False
    killed: bool = False


@dataclass(frozen=True)
class Outcome:
    """What a case did: the text for the page, and what is wrong with it. `skipped` is the reason it did not run."""

    case: Case
    result: str
    faults: tuple[str, ...] = ()
    skipped: str = ""


def outcome_of(case: Case) -> Outcome:
    """Run one case in a fresh temporary directory and judge it."""
    folder = Path(tempfile.mkdtemp(prefix="granflow-"))
    try:
        folder.chmod(0o755)
        home = folder / "home"
        home.mkdir()
        return _judged(case, Sandbox(home, case.seconds))
    except Skip as skip:
        return Outcome(case, "", skipped=str(skip))
    finally:
        _remove(folder)


def _judged(case: Case, sandbox: Sandbox) -> Outcome:
    if case.prepare is not None:
        case.prepare(sandbox)
    try:
        done = case.act(sandbox) if case.act is not None else _in_order(case, sandbox)
    except (AssertionError, OSError, subprocess.SubprocessError) as error:
        done = sandbox.history[-1] if sandbox.history else Done("", None, "", "")
        return Outcome(case, _result_text(case, done, False), (f"{type(error).__name__}: {error}",))
    faults = [*_faults_of_result(case, done), *_faults_of_processes(case, sandbox)]
    if not case.killed:
        faults += [f"{folder.name}: {damage}" for folder in run_folders(sandbox.home) for damage in damages(folder)]
    if case.verify is not None and not faults:
        try:
            case.verify(sandbox, done)
        except AssertionError as error:
            faults.append(f"verification failed: {error}")
    return Outcome(case, _result_text(case, done, not faults), tuple(faults))


def _in_order(case: Case, sandbox: Sandbox) -> Done:
    for command in case.commands[:-1]:
        before = sandbox.run(command)
        assert before.code == 0, f"granflow {command} exits with {before.code}: {before.err[-1000:]}"
    return sandbox.run(case.commands[-1])


def _faults_of_result(case: Case, done: Done) -> list[str]:
    codes = case.code if isinstance(case.code, tuple) else (case.code,)
    found = []
    if done.code is None:
        found.append(f"does not end within {case.seconds:g} s")
    elif done.code not in codes:
        found.append(f"exit code {done.code}, expected {' or '.join(map(str, codes))}: {done.err[-600:]}")
    text = " ".join(done.text.split())
    missing = [
        f"no {words!r} in the output: {done.text[-600:]}" for words in case.says if not re.search(words, text, re.I)
    ]
    return found + missing


def _faults_of_processes(case: Case, sandbox: Sandbox) -> list[str]:
    found = []
    for done in sandbox.history:
        if re.search(r"Traceback|Logging error|Segmentation|core dumped", done.text):
            found.append(f"granflow {done.command} prints a traceback: {done.text[-400:]}")
        if re.search(r"[\x00-\x08\x0b\x0c\x0e-\x1f\x7f\u202e\u2066-\u2069]", done.text):
            found.append(f"granflow {done.command} prints control characters: {ascii(done.err[:400])}")
        if done.megabytes > case.megabytes:
            found.append(f"granflow {done.command} takes {done.megabytes:.0f} MB, more than {case.megabytes:g}")
    return found


def run_folders(home: Path) -> list[Path]:
    """Directories below `home` that a run has written."""
    return sorted(path.parent for path in home.rglob("scene_as_run.yaml") if path.is_file())


def damages(folder: Path) -> list[str]:
    """What is wrong with the files of a run: temporary files, unreadable or unlisted frames, NaN, unequal rows."""
    found = [f"{path.name} is left over" for path in folder.glob(".*.part")]
    for pvd in folder.glob("*.pvd"):
        try:
            listed = {each.get("file") for each in ElementTree.parse(pvd).iter("DataSet")}
        except ElementTree.ParseError as error:
            found.append(f"{pvd.name} is not XML: {error}")
            continue
        found += [f"{pvd.name} lists {name}, which does not exist" for name in listed if not (folder / name).is_file()]
    for path in folder.glob("*.vtu"):
        if b"</VTKFile>" not in path.read_bytes()[-200:]:
            found.append(f"{path.name} is incomplete")
    for path in folder.glob("result.json"):
        json.loads(path.read_text())
    return found + _damages_of_rows(folder / "timeseries.csv")


def _damages_of_rows(path: Path) -> list[str]:
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
        (i, text) for i, row in enumerate(rows[1:], 1) for text in row if re.fullmatch(r"[-+.\d].*|nan|inf", text)
    ]
    for i, text in numbers:
        try:
            finite = math.isfinite(float(text))
        except ValueError:
            continue
        if not finite:
            found.append(f"row {i} of {path.name} holds {text}")
    return found


def _result_text(case: Case, done: Done, passed: bool) -> str:
    """Exit code, first line of the message, and what was verified; the same text in every run."""
    message = done.message or (
        "" if done.code else next(iter(done.out.splitlines()), "") if len(done.out) < 400 else ""
    )
    for pattern, text in (*BLURRED, *([(case.blur, "...")] if case.blur else [])):
        message = re.sub(pattern, text, message)
    parts = [f"exit code {done.code}" if done.code is not None else f"no end within {case.seconds:g} s"]
    parts += [f"`{plain(message)}`"] if message else []
    parts += [case.verified] if case.verified and passed else []
    return "; ".join(parts)


BLURRED = (
    (r"\(choose from .*\)", "(choose from ...)"),
    (r"(?i)(stopped at|goes on from|continues from) [-+.\de]+ s\b", r"\1 T s"),
    (r"[-+.\de]+ (GB|MB|GiB|MiB)", r"N \1"),
    (r"checkpoint_\d+", "checkpoint_N"),
    (r"/tmp/[^\s:]*", "/tmp/..."),
)
"""What differs from run to run in messages."""


def plain(text: str, longest: int = 300) -> str:
    """Text for one cell of a Markdown table: no control characters, no bars, at most `longest` characters."""
    shown = "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text).replace("|", "\\|").replace("`", "'")
    return shown if len(shown) <= longest else shown[: longest - 4] + " ..."


def _remove(folder: Path) -> None:
    for path in folder.rglob("*"):
        if path.is_dir() and not path.is_symlink():
            os.chmod(path, 0o755)
    shutil.rmtree(folder, ignore_errors=True)
