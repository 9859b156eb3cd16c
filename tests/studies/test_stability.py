"""The stability study in reduced form: assessments, rebounds and stability limits against theory."""

import math
import sys
from functools import partial

import numpy as np
import pytest

from granflow.cli.main import main
from granflow.errors import GranflowError
from granflow.studies.stability import report
from granflow.studies.stability.cases import (
    POISSON,
    CaseResult,
    ParticlePair,
    StabilityCase,
    real_bounds,
    rebound,
    rebound_result,
    run_case,
)


def finding(reached, error, *warnings):
    return CaseResult("restitution", 0.5, reached, error, 1e-6, warnings)


def raising(error):
    raise error


CASES = [
    (partial(finding, 0.503, 0.003), "accurate", "stable and accurate"),
    (partial(finding, 0.9, 0.4, "x"), "error", "stable, error 40 % (restitution 0.9 for 0.5), warning: x"),
    (partial(finding, 0.9, 0.4), "defect", "defect: silent error 40 % (restitution 0.9 for 0.5)"),
    (partial(raising, GranflowError("Too soft.")), "refused", "refused: Too soft."),
    (partial(raising, IndexError("off the end")), "defect", "defect: IndexError: off the end"),
]


def test_cases_are_classified_and_defects_reported_by_the_exit_code(monkeypatch, tmp_path, capsys):
    """A missing matplotlib omits only the figure."""
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    cases = [StabilityCase("family", "row", str(n), "theory", work) for n, (work, *_) in enumerate(CASES)]
    outcomes = [run_case(case) for case in cases]
    assert [(found.kind, found.assessment) for found in outcomes] == [each[1:] for each in CASES]
    monkeypatch.setattr(report, "all_cases", lambda full: cases)
    monkeypatch.setattr(report, "run_cases", lambda *_: outcomes)
    monkeypatch.setitem(report.EXPLANATIONS, "family", "What it is.")
    assert main(["stability", "--out", str(tmp_path)]) == 1
    assert "family: row, 2: defect: silent error 40 %" in capsys.readouterr().out
    assert "What it is." in (tmp_path / "stability.html").read_text(encoding="utf-8")


def test_pairs_reach_the_given_or_the_smallest_stable_restitution(taichi_f64):
    """At theta = 0.5 the step permits e with theta^2 M/dt^2 = k sqrt(dmax) / (0.8 e^2), the tangent of a
    small e.

    A restitution of 0 needs no tangent: the contact stops the pair in one step.
    """
    pairs = (
        ParticlePair(restitution=0.005), ParticlePair(restitution=0.5), ParticlePair(restitution=1.0),
        ParticlePair(restitution=0.5, radius_ratio=5.0), ParticlePair(restitution=0.0)
    )  # fmt: skip
    found = rebound(pairs)
    assert found.restitution[1:] == pytest.approx([0.5, 1.0, 0.5, 0.0], abs=2e-3)
    assert abs(found.restitution[4]) < 1e-12
    assert np.all(found.momentum < 1e-12)
    mass = 4 / 3 * math.pi * 1e-9 * 2500.0 / 2.0
    k = 4 / 3 * 1e8 / (2.0 * (1.0 - 0.25**2)) * math.sqrt(0.5e-3)
    tangent = k * math.sqrt((5.0 * mass / (4.0 * k)) ** 0.4) / 0.8
    least_restitution = math.sqrt(tangent * found.time_step**2 / (0.25 * mass))
    assert found.restitution[0] == pytest.approx(least_restitution, rel=0.05)
    without_target = rebound_result(pairs, 0)
    assert without_target.error == pytest.approx(least_restitution - 0.005, rel=0.05)
    assert without_target.warnings and rebound_result(pairs, 1).warnings == ()


def test_measured_stability_limit_matches_theory_and_exceeds_the_checked_one(taichi_f64):
    """Elastic particles without sliding: 2 sqrt(M / (S Kt)), S of a particle rotating between others,
    Mindlin's Kt / K.

    Between z anchors: torque z sin^2 Kt R^2, inertia (2/5) m R^2, M = m: S = 2.5 z <sin^2>. All particles of
    a straight chain rotate in the same direction, which doubles the tangential displacement; M = m/2: S = 5
    again.
    """
    ratio = 2.0 * (1.0 - POISSON) / (2.0 - POISSON)
    modes = {"between 2": 5.0, "between 6": 10.0, "between 12": 20.0, "chain of 10": 5.0}
    found = {bound.lattice: bound for bound in real_bounds("hertz, e 1", True)}
    for name, count in modes.items():
        expected = 2.0 / math.sqrt(count * ratio)
        assert found[name].bound / found[name].scale == pytest.approx(expected, rel=0.03), name
    for bound in found.values():
        assert 1.0 / 1.02 < bound.ratio < 2.0 * 1.02, bound
