"""Comparison with LIGGGHTS and LAMMPS: initial states, stored figures, inputs and evaluation."""

import importlib
import re
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree

from granflow.studies.validation import peers

TOOLS = Path(__file__).resolve().parents[2] / "tools" / "validation"
CASES = tuple(peers.ENDS)


@pytest.mark.parametrize("case", CASES)
def test_particles_of_the_initial_state_do_not_overlap(case):
    state = peers.initial_state(case)
    assert state.position.shape == (peers.COUNT, 3)
    closest = cKDTree(state.position).query(state.position, k=2)[0][:, 1]
    assert closest.min() > peers.LARGEST
    assert state.position[:, 2].min() > 0.5 * peers.LARGEST


@pytest.mark.parametrize("case", CASES)
def test_stored_figures_belong_to_the_compared_numbers(case):
    state = peers.initial_state(case)
    frames = {0.1 * tenth: state for tenth in range(3, 10)}
    names = list(peers.figures(case, frames))
    stored = peers.stored_figures()
    assert list(stored) == ["LIGGGHTS", "LAMMPS"]
    for content in stored.values():
        assert list(content["figures"][case]) == names
        assert re.search(r"\d", content["version"]) and re.fullmatch(r"\d{4}-\d\d-\d\d", content["date"])


@pytest.mark.parametrize("case", CASES)
def test_both_inputs_run_until_the_end_of_the_case_with_its_numbers(case):
    for code in ("liggghts", "lammps"):
        text = (TOOLS / f"in.{case}.{code}").read_text(encoding="utf-8")
        steps = [int(count) for count in re.findall(r"^run (\d+)$", text, re.MULTILINE)]
        assert sum(steps) * peers.TIME_STEP == pytest.approx(peers.ENDS[case])
        assert steps[0] * peers.TIME_STEP == pytest.approx(peers.OPENING)
        assert f"timestep {peers.TIME_STEP:.0e}".replace("e-05", "e-5") in text
        assert f"gravity {peers.GRAVITY} vector 0 0 -1" in text


def test_evaluation_compares_with_each_code():
    stored = {
        name: {"version": name, "date": "2026-01-01", "figures": {"column": {"height [m]": value}}}
        for name, value in (("one", 1.0), ("two", 1.2))
    }
    cases = peers.compared("column", [{"height [m]": 1.0 + change} for change in (-0.01, 0.0, 0.01)], stored)
    assert [(each.name, each.unit, each.status) for each in cases] == [
        ("one: height", "m", "pass"), ("two: height", "m", "fail")
    ]  # fmt: skip
    assert cases[0].allowed == pytest.approx(0.02 + 0.03 * np.sqrt(4.0 / 3.0))


def test_frames_of_a_dump_are_ordered_by_id(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(str(TOOLS))
    head = (
        "ITEM: TIMESTEP\n{}\nITEM: NUMBER OF ATOMS\n2\nITEM: BOX BOUNDS ff ff ff\n0 1\n0 1\n0 1\nITEM: ATOMS id x ...\n"
    )
    rows = "2 4 5 6 0 0 0 0.2\n1 1 2 3 7 8 9 0.1\n"
    (tmp_path / "frames.txt").write_text(head.format(0) + rows + head.format(10000) + rows)
    frames = importlib.import_module("run_peers").read_frames(tmp_path / "frames.txt")
    assert list(frames) == [0.0, 0.1]
    np.testing.assert_array_equal(frames[0.1].position, [[1, 2, 3], [4, 5, 6]])
    np.testing.assert_array_equal(frames[0.1].velocity[0], [7, 8, 9])
    np.testing.assert_array_equal(frames[0.1].diameter, [0.1, 0.2])


def test_hopper_of_triangles_lies_on_cone_and_tube(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(str(TOOLS))
    importlib.import_module("run_peers").write_hopper(tmp_path / "hopper.stl")
    text = (tmp_path / "hopper.stl").read_text()
    vertex = np.array([line.split()[1:] for line in text.splitlines() if line.startswith("vertex")], dtype=float)
    slope = (peers.TUBE - peers.ORIFICE) / peers.CONE_HEIGHT
    expected = np.minimum(peers.TUBE, peers.ORIFICE + slope * vertex[:, 2])
    np.testing.assert_allclose(np.hypot(vertex[:, 0], vertex[:, 1]), expected, atol=1e-9)


def test_scenes_of_the_cases_accept_their_initial_states():
    for case in CASES:
        scene = peers.peer_scene(case, peers.initial_state(case))
        assert scene.run.time_step == peers.TIME_STEP
