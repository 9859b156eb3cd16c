"""A case of the stability study, its execution, and its assessment."""

import math
import time as clock
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from granflow import GranflowError
from granflow.studies.tables import percent

ACCURATE = 0.01
"""Largest error of an accurate case."""
SILENT_LIMIT = 0.1
"""Largest error without a warning; a larger silent error is a defect."""

Kind = Literal["accurate", "error", "refused", "defect"]
"""Assessment of a case: accurate, stable with an error, refused with a message, or a defect."""


@dataclass(frozen=True)
class CaseResult:
    """Result of a case: quantity, expected and reached value, relative error, and time step [s]."""

    quantity: str
    expected: float
    reached: float
    error: float
    time_step: float
    warnings: tuple[str, ...] = ()
    """Warnings that announce the error: those of the plan, and known limitations of the check."""


@dataclass(frozen=True)
class StabilityCase:
    """One stiff or extreme case: row and column in the grid of its family, reference, and function to run.

    `reference`: noun phrase for the expected value. The function must be importable in another process.
    """

    family: str
    row: str
    column: str
    reference: str
    run: Callable[[], CaseResult]
    precision: str = "f64"

    @property
    def name(self) -> str:
        """Family, row and column."""
        return f"{self.family}: {self.row}, {self.column}"


@dataclass(frozen=True)
class CaseOutcome:
    """A case with its assessment; numbers are nan for refused cases.

    `error` is relative; `time_step` and wall time `seconds` [s].
    """

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
    assessment: str


def run_case(case: StabilityCase) -> CaseOutcome:
    """Run a case and return its outcome with the wall time.

    No exception is raised: GranflowError means refused, every other exception a defect.
    """
    began = clock.perf_counter()
    case_result = CaseResult("", math.nan, math.nan, math.nan, math.nan)
    try:
        case_result = case.run()
        kind, assessment = assess(case_result)
    except GranflowError as refusal:
        kind, assessment = "refused", f"refused: {' '.join(str(refusal).split())}"
    except Exception as failure:  # any failure is a defect of the case and must not end the study
        kind, assessment = "defect", f"defect: {type(failure).__name__}: {failure}"
    return case_outcome(case, case_result, clock.perf_counter() - began, kind, assessment)


def case_outcome(
    case: StabilityCase, case_result: CaseResult, seconds: float, kind: Kind, assessment: str
) -> CaseOutcome:
    """Combine a case, its result and its assessment."""
    return CaseOutcome(
        case.family, case.row, case.column, case.precision, case.reference, case_result.quantity, case_result.expected,
        case_result.reached, case_result.error, case_result.time_step, seconds, kind, assessment,
    )  # fmt: skip


def assess(case_result: CaseResult) -> tuple[Kind, str]:
    """Kind of assessment and its text for a result.

    Accurate up to ACCURATE; a larger error needs a warning above SILENT_LIMIT, otherwise it is a defect.
    """
    if not (math.isfinite(case_result.reached) and math.isfinite(case_result.error)):
        return "defect", f"defect: {case_result.quantity} is not finite, and the run did not abort"
    if case_result.error <= ACCURATE:
        return "accurate", "stable and accurate"
    statement = f" ({case_result.quantity} {case_result.reached:.4g} for {case_result.expected:.4g})"
    if case_result.warnings:
        return "error", f"stable, error {percent(case_result.error)}{statement}, warning: {case_result.warnings[0]}"
    if case_result.error > SILENT_LIMIT:
        return "defect", f"defect: silent error {percent(case_result.error)}{statement}"
    return "error", f"stable, error {percent(case_result.error)}{statement}"
