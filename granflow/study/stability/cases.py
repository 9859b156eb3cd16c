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
NOT_OWNED = 0.1
"""An error beyond this must have been warned of, or the case is a defect."""

Kind = Literal["accurate", "error", "refused", "defect"]


@dataclass(frozen=True)
class CaseResult:
    """What a case came to: the number in question, what it should be, what it was, and the error as a fraction."""

    quantity: str
    expected: float
    reached: float
    error: float
    time_step: float
    warnings: tuple[str, ...] = ()
    """What is said of the error before the run: what the plan warns of, what the check does not know."""


@dataclass(frozen=True)
class StabilityCase:
    """One stiff or extreme case: a place in the grid of its family, what it is held against, and the work."""

    family: str
    row: str
    column: str
    reference: str
    run: Callable[[], CaseResult]
    precision: Precision = "f64"

    @property
    def name(self) -> str:
        """Family and place."""
        return f"{self.family}: {self.row}, {self.column}"


@dataclass(frozen=True)
class CaseOutcome:
    """A case with its verdict; numbers are nan where it was refused."""

    family: str
    row: str
    column: str
    precision: str
    reference: str
    quantity: str
    expected: float
    reached: float
    error: float
    time_step: float
    seconds: float
    kind: Kind
    verdict: str


def run_case(case: StabilityCase) -> CaseOutcome:
    """Run a case to its end, whatever that is, and judge it."""
    began = clock.perf_counter()
    case_result = CaseResult("", math.nan, math.nan, math.nan, math.nan)
    try:
        case_result = case.run()
        kind, verdict = verdict_on(case_result)
    except GranflowError as refusal:
        kind, verdict = "refused", f"refused: {' '.join(str(refusal).split())}"
    except Exception as failure:  # whatever it is, it is a defect to be shown and not the end of the study
        kind, verdict = "defect", f"defect: {type(failure).__name__}: {failure}"
    return case_outcome(case, case_result, clock.perf_counter() - began, kind, verdict)


def case_outcome(case: StabilityCase, case_result: CaseResult, seconds: float, kind: Kind, verdict: str) -> CaseOutcome:
    """The case with a verdict."""
    return CaseOutcome(
        case.family, case.row, case.column, case.precision, case.reference, case_result.quantity, case_result.expected,
        case_result.reached, case_result.error, case_result.time_step, seconds, kind, verdict,
    )  # fmt: skip


def verdict_on(case_result: CaseResult) -> tuple[Kind, str]:
    """Verdict on what was found."""
    if not (math.isfinite(case_result.reached) and math.isfinite(case_result.error)):
        return "defect", f"defect: {case_result.quantity} is not a number, and nothing stopped the run"
    if case_result.error <= ACCURATE:
        return "accurate", "stable and accurate"
    statement = f" ({case_result.quantity} {case_result.reached:.4g} for {case_result.expected:.4g})"
    if case_result.warnings:
        return "error", f"stable, error {percent(case_result.error)}{statement}, said: {case_result.warnings[0]}"
    if case_result.error > NOT_OWNED:
        return "defect", f"defect: silent error {percent(case_result.error)}{statement}"
    return "error", f"stable, error {percent(case_result.error)}{statement}"


def percent(share: float) -> str:
    """A fraction in percent, two digits."""
    value = 100.0 * share
    return f"{value:.0f} %" if value >= 10.0 else f"{value:.2g} %"
