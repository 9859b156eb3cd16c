"""The table of all adversarial cases in docs/pages/reference/invalid_inputs.md; one function writes and
compares it."""

from collections.abc import Mapping

from adversarial import cases_faults, cases_physics, cases_resume, cases_scene
from adversarial.case import Case, Outcome, plain
from adversarial.sandbox import ROOT

PAGE = ROOT / "docs" / "pages" / "reference" / "invalid_inputs.md"
MODULES = (cases_scene, cases_physics, cases_faults, cases_resume)
CASES: list[Case] = [case for module in MODULES for case in module.CASES]
INTRODUCTION = """\
# Invalid inputs and faults

Behavior of granflow with invalid scene files and with faults of the machine. `python
tools/adversarial.py` runs each case in separate processes and writes this table; `python3 tools/dev.py slow
tests/adversarial` compares it. In each case, the terminal shows neither a traceback nor control characters, the process
ends within its time limit and uses at most 1.5 GB of memory, and the files of a run are complete: no temporary file, no
unlisted frame, no NaN but for residence times before the first passage.

Exit codes: 0 success; 1 an expectation is not satisfied; 2 input rejected; 3 aborted by a limit; 4 files cannot be
written; 130 and 143 stopped by SIGINT and SIGTERM; negative: killed by that signal.

| group | input | result |
|---|---|---|
"""


def row_of(outcome: Outcome) -> str:
    """One line of the table; failed cases are marked."""
    failed = f"**fails: {plain(outcome.faults[0])}**; " if outcome.faults else ""
    return f"| {outcome.case.group} | {cell(outcome.case.input)} | {failed}{outcome.result} |"


def cell(text: str) -> str:
    """Description of an input for a table cell; it may contain code in backticks and bars."""
    return text.replace("|", "\\|").replace("\n", " ")


def page_of(outcomes: Mapping[str, Outcome], before: str) -> str:
    """The page; a case without outcome, or skipped on this machine, keeps its line of `before`."""
    return INTRODUCTION + "\n".join(_line(case, outcomes.get(case.name), before) for case in CASES) + "\n"


def _line(case: Case, outcome: Outcome | None, before: str) -> str:
    if outcome is not None and not outcome.skipped:
        return row_of(outcome)
    head = f"| {case.group} | {cell(case.input)} |"
    found = [line for line in before.splitlines() if line.startswith(head)]
    return found[0] if found else f"{head} not run |"


def page_text() -> str:
    """Text of the page in the repository."""
    return PAGE.read_text(encoding="utf-8") if PAGE.exists() else ""
