"""Every adversarial case has its expected result, and docs/adversarial.md shows it."""

import functools

import pytest
from adversarial.case import Case, Outcome, outcome_of
from adversarial.page import CASES, page_of, page_text

NAMES = {case.name: case for case in CASES}


@functools.cache
def outcome(name: str) -> Outcome:
    """The outcome of a case, run once per session."""
    return outcome_of(NAMES[name])


def judge(case: Case) -> None:
    found = outcome(case.name)
    if found.skipped:
        pytest.skip(found.skipped)
    assert not found.faults, "\n".join(found.faults)


def test_the_table_is_large_and_names_are_unique():
    assert len(NAMES) == len(CASES) >= 100
    assert len({(case.group, case.input) for case in CASES}) == len(CASES)


@pytest.mark.parametrize("case", [case for case in CASES if case.quick], ids=lambda case: case.name)
def test_a_few_inputs_are_refused(case):
    judge(case)


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_every_input_and_fault(case):
    judge(case)


@pytest.mark.slow
@pytest.mark.timeout(7200)
def test_the_page_shows_the_results():
    before = page_text()
    after = page_of({name: outcome(name) for name in NAMES}, before)
    assert after.splitlines() == before.splitlines(), "python tools/adversarial.py writes docs/adversarial.md"
