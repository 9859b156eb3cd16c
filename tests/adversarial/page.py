"""The table of all adversarial cases in docs/adversarial.md: written and compared by the same function."""

from collections.abc import Mapping

from adversarial import (
    cases_commands,
    cases_faults,
    cases_input,
    cases_long,
    cases_physics,
    cases_resume,
    cases_scene,
    cases_values,
)
from adversarial.case import Case, Outcome, plain
from adversarial.sandbox import ROOT

PAGE = ROOT / "docs" / "adversarial.md"
MODULES = (
    *(cases_scene, cases_commands, cases_input, cases_values),
    *(cases_physics, cases_faults, cases_resume, cases_long),
)
CASES: list[Case] = [case for module in MODULES for case in module.CASES]
INTRODUCTION = """\
# Invalid inputs and faults

What granflow does with invalid files, values and command lines, and with faults of the machine. `python
tools/adversarial.py` runs every case in a process of its own and writes this table; `python3 tools/dev.py slow
tests/adversarial` compares it. In every case no traceback and no control character reaches the terminal, the process
ends within its time limit and takes at most 1.5 GB of memory, and the files of a run are complete: no temporary
file, no unlisted frame, no NaN.

Exit codes: 0 done; 1 an expectation is not satisfied; 2 refused; 3 aborted by a limit; 4 files cannot be written;
130 and 143 stopped by SIGINT and SIGTERM; negative: ended by that signal.

| group | input | result |
|---|---|---|
"""


def row_of(outcome: Outcome) -> str:
    """One line of the table; a case that fails says so."""
    failed = f"**fails: {plain(outcome.faults[0])}**; " if outcome.faults else ""
    return f"| {outcome.case.group} | {cell(outcome.case.input)} | {failed}{outcome.result} |"


def cell(text: str) -> str:
    """The description of an input; it may contain code in backticks and bars."""
    return text.replace("|", "\\|").replace("\n", " ")


def page_of(outcomes: Mapping[str, Outcome], before: str) -> str:
    """The whole page; a case that has no outcome, or did not run on this machine, keeps its line of `before`."""
    return INTRODUCTION + "\n".join(_line(case, outcomes.get(case.name), before) for case in CASES) + "\n"


def _line(case: Case, outcome: Outcome | None, before: str) -> str:
    if outcome is not None and not outcome.skipped:
        return row_of(outcome)
    head = f"| {case.group} | {cell(case.input)} |"
    found = [line for line in before.splitlines() if line.startswith(head)]
    return found[0] if found else f"{head} not run |"


def page_text() -> str:
    """The page as it is in the repository."""
    return PAGE.read_text(encoding="utf-8") if PAGE.exists() else ""
