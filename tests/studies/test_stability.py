"""The stability study in reduced form: assessments, rebounds, weights and stability limits against theory."""

import csv
import math
import os
import sys
import time
from functools import partial

import numpy as np
import pytest

from granflow.cli.main import main
from granflow.errors import GranflowError
from granflow.simulation import Simulation
from granflow.studies.stability import cases as bed_cases
from granflow.studies.stability import report
from granflow.studies.stability.cases import (
    POISSON,
    CaseResult,
    ParticlePair,
    StabilityCase,
    all_cases,
    real_bounds,
    rebound,
    rebound_result,
    run_case,
)
from granflow.studies.stability.report import run_cases


def case_of(work, column="the column"):
    return StabilityCase("family", "the row", column, "theory", work)


def finding(reached, error, *warnings):
    return CaseResult("restitution", 0.5, reached, error, 1e-6, warnings)


def raising(error):
    raise error


@pytest.mark.parametrize(
    ("work", "kind", "text"),
    [
        (lambda: finding(0.503, 0.003), "accurate", "stable and accurate"),
        (lambda: finding(0.52, 0.02), "error", "stable, error 2 % (restitution 0.52 for 0.5)"),
        (lambda: finding(0.9, 0.4, "x"), "error", "stable, error 40 % (restitution 0.9 for 0.5), warning: x"),
        (lambda: finding(0.9, 0.4), "defect", "defect: silent error 40 % (restitution 0.9 for 0.5)"),
        (lambda: finding(math.nan, 0.0), "defect", "defect: restitution is not finite, and the run did not abort"),
        (lambda: raising(GranflowError("Too soft.\nRaise it.")), "refused", "refused: Too soft. Raise it."),
        (lambda: raising(IndexError("off the end")), "defect", "defect: IndexError: off the end"),
    ],
)  # fmt: skip
def test_cases_are_classified(work, kind, text):
    outcome = run_case(case_of(work))
    assert (outcome.kind, outcome.assessment) == (kind, text)


def test_a_crash_is_a_defect_and_the_next_case_runs():
    crashed, next_case = run_cases(
        [case_of(partial(os._exit, 3), "a"), case_of(partial(finding, 0.5, 0.0), "b")], print, 60.0
    )
    assert crashed.assessment == "defect: the process ended without a result"
    assert next_case.assessment == "stable and accurate"


def test_a_case_beyond_the_time_limit_is_a_defect():
    (overdue,) = run_cases([case_of(partial(time.sleep, 300.0))], print, 1.0)
    assert overdue.assessment == "defect: not finished in 1 s"


def test_pairs_reach_the_given_or_the_smallest_stable_restitution(taichi_f64):
    """At theta = 0.5 the step permits e with theta^2 M/dt^2 = k sqrt(dmax) / (0.8 e^2), the tangent of a
    small e.

    A restitution of 0 needs no tangent: the contact stops the pair in one step.
    """
    pairs = (
        ParticlePair(restitution=0.005),
        ParticlePair(restitution=0.5),
        ParticlePair(restitution=1.0),
        ParticlePair(restitution=0.5, radius_ratio=5.0),
        ParticlePair(restitution=0.0),
    )
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
    assert [text.split(":")[0] for text in without_target.warnings] == ["a0-b0"]
    assert rebound_result(pairs, 1).warnings == ()


def test_time_step_above_the_stable_one_is_rejected(taichi_f64):
    refused = run_case(case_of(partial(rebound_result, (ParticlePair(),), 0, "f64", 2.0)))
    assert refused.kind == "refused"
    assert "above the stability limit" in refused.assessment


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
        assert found[name].bound / found[name].scale == pytest.approx(
            2.0 / math.sqrt(count * ratio), rel=0.03
        ), name
    for bound in found.values():
        assert 1.0 / 1.02 < bound.ratio < 2.0 * 1.02, bound


def test_light_particle_supports_a_million_times_its_mass(taichi_f64, monkeypatch):
    """The force deviates by the loss of each contact at its first reversal: the overlap rises by at most F/M
    dt^2/8.

    M is the mass of the light particle. At e = 0.5 the unloading tangent is 3.35 times Hertz's 1.5 F/d
    (model, table).
    """
    monkeypatch.setattr(bed_cases, "REST_STEPS", 2000)
    found = bed_cases.column_at_rest("zhou", (2.5e3, 2.5e9), 1e11)
    volume = 4 / 3 * math.pi * 1e-9
    weight = 9.81 * volume * (2.5e3 + 2.5e9)
    assert found.expected == pytest.approx(weight)
    relative_loss = 0.0
    for radius_eff in (1e-3, 0.5e-3):
        k = 4 / 3 * 1e11 / (2.0 * (1.0 - bed_cases.POISSON**2)) * math.sqrt(radius_eff)
        tangent = 3.35 * 1.5 * weight / (weight / k) ** (2 / 3)
        relative_loss += tangent * found.time_step**2 / (8.0 * 2.5e3 * volume)
    assert relative_loss < 3e-3
    assert found.reached == pytest.approx(weight, rel=relative_loss)


def test_initially_overlapping_particles_separate_with_the_returned_energy(taichi_f64):
    """Zhou's model returns e^2 of the energy of loading, (2/5) k d^2.5; the two masses are equal."""
    particles = {"particles": bed_cases.particles_at([[-0.75e-3, 0, 1e-2], [0.75e-3, 0, 1e-2]])}
    weightless = {"gravity": 0.0, "walls": {}}
    scene = bed_cases.scene_with("zhou", particles, 1e-3, **weightless, numerics={"max_overlap": 0.8})
    simulation = Simulation(scene)
    simulation.run()
    k = 4 / 3 * bed_cases.YOUNG / (2.0 * (1.0 - bed_cases.POISSON**2)) * math.sqrt(0.5e-3)
    energy = 0.25 * 0.4 * k * 0.5e-3**2.5
    mass = 4 / 3 * math.pi * 1e-9 * bed_cases.DENSITY
    speed = simulation.snapshot().particles["velocity"][1, 0]
    assert speed == pytest.approx(math.sqrt(energy / mass), rel=0.02)
    simulation.free()


def test_every_case_has_a_unique_row_and_column():
    for cases in (all_cases(), all_cases(full=True)):
        assert len({(case.family, case.row, case.column) for case in cases}) == len(cases)
    named = " ".join(case.name for case in all_cases(full=True))
    for part in ("1e+05 Pa", "1e+12 Pa", "e = 0,", "e = 0.001", "1e-06 m/s", "density 1 : 1e+06", "radius 1 : 100",
                 "R = 1e-06 "
                 "m", "R = 1 m", "f32", "heavy on light", "column of 100", "squeezed", "overlap 50 %",
                 "1 km/s", "friction 0", "friction 10", "no gravity", "Γ = 100", "0.01", ", 5"):  # fmt: skip
        assert part in named, part


def test_missing_matplotlib_omits_only_the_figure(monkeypatch, tmp_path, capsys):
    """The command reports defects, also by its exit code."""
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    results = [partial(finding, 0.503, 0.003), partial(finding, 0.9, 0.4)]
    monkeypatch.setattr(
        report, "all_cases", lambda full: [case_of(work, str(n)) for n, work in enumerate(results)]
    )
    monkeypatch.setattr(report, "run_cases", lambda cases, tell: [run_case(case) for case in cases])
    monkeypatch.setitem(report.EXPLANATIONS, "family", "What it is.")
    assert main(["stability", "--out", str(tmp_path)]) == 1
    message = capsys.readouterr().out
    assert "pip install matplotlib" in message
    assert "family: the row, 1: defect: silent error 40 %" in message
    with (tmp_path / "stability.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [row["verdict"] for row in rows] == [
        "stable and accurate",
        "defect: silent error 40 % (restitution 0.9 for 0.5)",
    ]
    assert "What it is." in (tmp_path / "stability.html").read_text(encoding="utf-8")
    assert not (tmp_path / "stability.png").exists()


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_no_case_is_a_defect(tmp_path):
    pytest.importorskip("matplotlib")
    outcomes, missing = report.stability(tmp_path, False, lambda each: None)
    assert not report.defects(outcomes)
    assert not missing and (tmp_path / "stability.png").exists()
