"""tools/gpu_check.py without a GPU: failing checks, and one speed measurement."""

import argparse
import importlib.util
import json
from pathlib import Path

import numpy as np
import pytest

TOOLS = Path(__file__).resolve().parents[2] / "tools"


def module(name):
    return importlib.import_module(name)


@pytest.mark.parametrize(
    ("value", "passed"), [(0.9, True), (-0.9, True), (1.1, False), (-1.1, False), (float("nan"), False)]
)
def test_check_passes_within_its_limit_and_fails_for_nan(value, passed):
    assert module("gpu_checks.checks").record("any", value, 1.0)["passed"] is passed


def trajectory(path, offset):
    """File with the state of ten particles of radius 1; `offset` is added to all values."""
    rng = np.random.default_rng(1)
    position, velocity = rng.normal(size=(2, 10, 3))
    scalars = {
        "steps": 1000, "kinetic_energy": 1.0 + offset, "overlap_largest": 0.01 + offset, "contact_count": 20
    }  # fmt: skip
    np.savez(path, position=position + offset, velocity=velocity + offset, radius=np.ones(10), **scalars)
    return path


@pytest.mark.parametrize(("offset", "passed"), [(0.9e-5, True), (1.1e-5, False)])
def test_agreement_limit_follows_from_a_displaced_start(tmp_path, offset, passed):
    """The reference with displaced start deviates by 1e-6, so that the limit with a margin of 10 is 1e-5."""
    reference = trajectory(tmp_path / "reference.npz", 0.0)
    disturbed = trajectory(tmp_path / "disturbed.npz", 1e-6)
    records = module("gpu_checks.checks").agreement(
        trajectory(tmp_path / "here.npz", offset), reference, disturbed, 10.0
    )
    passed_checks = {each["name"].split(" difference")[0]: each["passed"] for each in records}
    assert passed_checks["position"] is passed_checks["velocity"] is passed
    assert passed_checks["steps missing"]


def run_of(tmp_path, answers, **requested):
    """A Run whose jobs return the entries of `answers`, or raise them if they are exceptions."""
    check = module("gpu_check")
    defaults = {
        "arch": "cpu", "part": "all", "precisions": ["f64"], "sizes": [1000], "seconds": 1.0, "quick": True
    }  # fmt: skip
    options = argparse.Namespace(**defaults | {"out": tmp_path / "found.json"} | requested)
    result = {"checks": [], "points": [], "profiles": [], "left_out": []}
    result["device"] = {"name": "host", "driver": None, "memory_free": 10**9, "largest_buffer": 10**8}
    run = check.Run(options, tmp_path, check.Budget(600.0), result)
    (tmp_path / "bed.npz").touch()

    def job(name, environment=None, **order):
        if isinstance(answers[name], Exception):
            raise answers[name]
        return answers[name]

    run.job = job
    return run


def test_failed_job_counts_as_failed_check(tmp_path, monkeypatch, capsys):
    check = module("gpu_check")
    good = module("gpu_checks.checks").record("good", 0.0, 1.0)
    monkeypatch.setattr(check.checks, "displacement", lambda *_: 1e-9)
    monkeypatch.setattr(check.checks, "agreement", lambda *_: [good])
    vibrated_box = {"digest": "a", "checks": [good]}
    answers = {
        "collisions": check.Failed("it ended with code 1"), "momentum": [good], "vibrated box": vibrated_box
    }  # fmt: skip
    answers |= {"scenes": [good], "trajectory": None}
    run = run_of(tmp_path, answers, part="correctness")
    assert check.carry_out(run) == 1
    found = json.loads(run.options.out.read_text())
    assert found["finished"] and [each["passed"] for each in found["checks"]] == [False, *[True] * 5]
    assert "collisions did not run" in capsys.readouterr().out
