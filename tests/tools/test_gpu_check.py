"""tools/gpu_check.py without a GPU: what it says, what it writes, that its checks can fail, and its speed point."""

import argparse
import importlib
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from subprocess_runner import in_subprocess

TOOLS = Path(__file__).resolve().parents[2] / "tools"
SCRIPT = TOOLS / "gpu_check.py"


@pytest.fixture(autouse=True)
def tools_at_hand(monkeypatch):
    monkeypatch.syspath_prepend(str(TOOLS))


def module(name):
    return importlib.import_module(name)


def test_a_device_that_is_not_there_is_one_sentence(tmp_path):
    import taichi as ti

    if ti._lib.core.with_cuda():
        pytest.skip("CUDA is here")
    command = [sys.executable, str(SCRIPT), "--arch", "cuda", "--out", str(tmp_path / "x.json")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=200)
    assert done.returncode == 2
    assert len(done.stderr.splitlines()) == 1 and "no cuda device" in done.stderr
    assert not (tmp_path / "x.json").exists()


@pytest.mark.parametrize(
    ("value", "passed"), [(0.9, True), (-0.9, True), (1.1, False), (-1.1, False), (float("nan"), False)]
)
def test_a_check_keeps_its_limit(value, passed):
    assert module("gpu.checks").record("any", value, 1.0)["passed"] is passed


def trajectory(path, off):
    """Ten spheres of radius 1 at some speed, everything displaced by `off`."""
    rng = np.random.default_rng(1)
    position, velocity = rng.normal(size=(2, 10, 3))
    scalars = {"steps": 1000, "kinetic_energy": 1.0 + off, "overlap_largest": 0.01 + off, "contact_count": 20}
    np.savez(path, position=position + off, velocity=velocity + off, radius=np.ones(10), **scalars)
    return path


@pytest.mark.parametrize(("off", "passed"), [(0.9e-5, True), (1.1e-5, False)])
def test_agreement_is_judged_by_what_rounding_does(tmp_path, off, passed):
    """A start displaced by rounding ends 1e-6 off: with a margin of 10, less than 1e-5 passes."""
    reference, disturbed = trajectory(tmp_path / "reference.npz", 0.0), trajectory(tmp_path / "disturbed.npz", 1e-6)
    records = module("gpu.checks").agreement(trajectory(tmp_path / "here.npz", off), reference, disturbed, 10.0)
    judged = {each["name"].split(" off")[0]: each["passed"] for each in records}
    assert judged["position"] is judged["velocity"] is passed
    assert judged["steps missing"]


def run_of(tmp_path, answers, **requested):
    """A Run whose jobs answer from a table, or raise what stands there."""
    check = module("gpu_check")
    usual = {"arch": "cpu", "part": "all", "precisions": ["f64"], "sizes": [1000], "seconds": 1.0, "quick": True}
    options = argparse.Namespace(**usual | {"out": tmp_path / "found.json"} | requested)
    result = {"checks": [], "points": [], "profiles": [], "left_out": []}
    result["device"] = {"name": "host", "driver": None, "memory_free": 10**9}
    run = check.Run(options, tmp_path, check.Budget(600.0), result)
    (tmp_path / "bed.npz").touch()

    def job(name, environment=None, **order):
        if isinstance(answers[name], Exception):
            raise answers[name]
        return answers[name]

    run.job = job
    return run


POINT = {
    "count": 1000, "rate": 2e6, "bandwidth_share": 0.5, "copy_bandwidth": 1e10, "bytes_per_particle_step": 600.0,
    "coordination_number": 5.0, "search_seconds": 1e-3,
}  # fmt: skip


def test_a_job_that_breaks_off_is_a_failed_check_and_the_others_go_on(tmp_path, monkeypatch, capsys):
    check, good = module("gpu_check"), module("gpu.checks").record("good", 0.0, 1.0)
    monkeypatch.setattr(check.checks, "displacement", lambda *_: 1e-9)
    monkeypatch.setattr(check.checks, "agreement", lambda *_: [good])
    shaken = {"digest": "a", "checks": [good]}
    answers = {"collisions": check.Failed("it ended with code 1"), "momentum": [good], "shaken": shaken}
    answers |= {"scenes": [good], "trajectory": None}
    run = run_of(tmp_path, answers, part="correctness")
    assert check.carry_out(run) == 1
    found = json.loads(run.options.out.read_text())
    assert found["finished"] and [each["passed"] for each in found["checks"]] == [False, *[True] * 5]
    assert "collisions did not run" in capsys.readouterr().out


def test_what_was_measured_is_in_the_file_although_a_later_point_fails(tmp_path, monkeypatch):
    check = module("gpu_check")
    monkeypatch.setattr(check.speed, "bytes_needed", lambda bed, size, *_: 100 * size)
    run = run_of(tmp_path, {"measure": POINT}, part="bench", sizes=[1000, 10**7])
    check.bench(run, 1000, "f64", {})
    assert json.loads(run.options.out.read_text())["points"] == [{"precision": "f64"} | POINT]
    check.bench(run, 10**7, "f64", {})
    assert "10000000 spheres in f64: fields of 1.0 GB are more than 70% of the 1.0 GB free" in run.result["left_out"]
    # 50 s for 1000 spheres, 1 s of them under the clock: 49 s a thousand for 100 000 are more than 600 s.
    check.bench(run, 100_000, "f64", {"f64": (1000, 50.0)})
    assert run.result["left_out"][-1].startswith("100000 spheres in f64: about 4901 s are needed")
    assert len(run.result["points"]) == 1


def measured_in_subprocess(tools, path):
    sys.path.insert(0, tools)
    from gpu import device, speed

    found = speed.measure("cpu", "mixed", path, 4, 0.05)
    return found | {"gpu_kernels": device._gpu_bandwidth(1 << 16)}  # what a GPU runs must at least compile


def test_a_point_of_speed(tmp_path):
    """Four spheres in mid-air, two of which overlap by 0.1 mm."""
    position = np.array([[2.0, 2.0, 9.0], [5.9, 2.0, 9.0], [12.0, 2.0, 9.0], [2.0, 12.0, 9.0]]) * 1e-3
    case = module("benchmark.cases").Case("bed 4", "bed", np.full(4, 4e-3), position, (0.02, 0.02))
    case.save(tmp_path / "bed.npz")
    found = in_subprocess(measured_in_subprocess, str(TOOLS), str(tmp_path / "bed.npz"))
    assert found["count"] == 4 and found["steps"] % 64 == 0
    assert min(found["gpu_kernels"].values()) > 0.0
    # particle-steps over seconds, and the share of the bandwidth that follows from it
    assert found["rate"] == pytest.approx(4 * found["steps"] / found["seconds"])
    share = found["bytes_per_particle_step"] * found["rate"] / found["copy_bandwidth"]
    assert found["bandwidth_share"] == pytest.approx(share)
    # Mixed, with friction: at least x in f64 and v, w, F, M in f32, read once.
    assert found["bytes_per_particle_step"] > 3 * 8 + 4 * 3 * 4
