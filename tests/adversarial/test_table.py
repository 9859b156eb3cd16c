"""Adversarial cases have their expected results, and docs/pages/reference/invalid_inputs.md lists them."""

import functools

import pytest

from adversarial.case import Case, Outcome, outcome_of
from adversarial.page import CASES, page_of, page_text

NAMES = {case.name: case for case in CASES}


@functools.cache
def outcome(name: str) -> Outcome:
    """Outcome of a case, which runs once per session."""
    return outcome_of(NAMES[name])


def assert_passed(case: Case) -> None:
    found = outcome(case.name)
    if found.skipped:
        pytest.skip(found.skipped)
    assert not found.faults, "\n".join(found.faults)


@pytest.mark.parametrize("case", [case for case in CASES if case.quick], ids=lambda case: case.name)
def test_selected_inputs_are_rejected(case):
    assert_passed(case)


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_case_has_the_expected_result(case):
    assert_passed(case)


@pytest.mark.slow
@pytest.mark.timeout(7200)
def test_page_matches_the_results():
    before = page_text()
    after = page_of({name: outcome(name) for name in NAMES}, before)
    assert after.splitlines() == before.splitlines(), "run tools/adversarial.py to update the page"
