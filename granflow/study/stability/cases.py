"""What a case is, how it is run to an end, and the verdict on it."""

import math
import time as clock
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from granflow.device.backend import Precision
from granflow.errors import GranflowError

ACCURATE = 0.01
"""An error up to this is none."""
SILENT = 0.1
"""An error beyond this must have been warned of, or the case is a defect."""

Kind = Literal["accurate", "error", "refused", "defect"]


@dataclass(frozen=True)
class Finding:
    """What a case came to: the number in question, what it should be, what it was, and the error as a fraction."""

    quantity: str
    expected: float
    reached: float
    error: float
    time_step: float
    warnings: tuple[str, ...] = ()
    """What is said of the error before the run: what the plan warns of, what the check does not know."""


@dataclass(frozen=True)
class Case:
    """One stiff or extreme case: a place in the grid of its family, what it is held against, and the work."""

    family: str
    row: str
    column: str
    against: str
    work: Callable[[], Finding]
    precision: Precision = "f64"

    @property
    def name(self) -> str:
        """Family and place."""
        return f"{self.family}: {self.row}, {self.column}"


@dataclass(frozen=True)
class Outcome:
    """A case with its verdict; numbers are nan where it was refused."""

    family: str
    row: str
    column: str
    precision: str
    against: str
    quantity: str
    expected: float
    reached: float
    error: float
    time_step: float
    seconds: float
    kind: Kind
    verdict: str


def attempt(case: Case) -> Outcome:
    """Run a case to its end, whatever that is, and judge it."""
    began = clock.perf_counter()
    finding = Finding("", math.nan, math.nan, math.nan, math.nan)
    try:
        finding = case.work()
        kind, verdict = judged(finding)
    except GranflowError as refusal:
        kind, verdict = "refused", f"refused: {' '.join(str(refusal).split())}"
    except Exception as failure:  # whatever it is, it is a defect to be shown and not the end of the study
        kind, verdict = "defect", f"defect: {type(failure).__name__}: {failure}"
    return outcome(case, finding, clock.perf_counter() - began, kind, verdict)


def outcome(case: Case, finding: Finding, seconds: float, kind: Kind, verdict: str) -> Outcome:
    """The case with a verdict."""
    return Outcome(
        case.family, case.row, case.column, case.precision, case.against, finding.quantity, finding.expected,
        finding.reached, finding.error, finding.time_step, seconds, kind, verdict,
    )  # fmt: skip


def judged(finding: Finding) -> tuple[Kind, str]:
    """Verdict on what was found."""
    if not (math.isfinite(finding.reached) and math.isfinite(finding.error)):
        return "defect", f"defect: {finding.quantity} is not a number, and nothing stopped the run"
    if finding.error <= ACCURATE:
        return "accurate", "stable and accurate"
    said = f" ({finding.quantity} {finding.reached:.4g} for {finding.expected:.4g})"
    if finding.warnings:
        return "error", f"stable, error {percent(finding.error)}{said}, said: {finding.warnings[0]}"
    if finding.error > SILENT:
        return "defect", f"defect: silent error {percent(finding.error)}{said}"
    return "error", f"stable, error {percent(finding.error)}{said}"


def percent(share: float) -> str:
    """A fraction in percent, two digits."""
    value = 100.0 * share
    return f"{value:.0f} %" if value >= 10.0 else f"{value:.2g} %"
