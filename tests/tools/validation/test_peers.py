"""Comparison with LIGGGHTS and LAMMPS: initial states, stored figures, inputs, runs of the programs and
evaluation."""

import math
import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import cKDTree
from validation import run as validation
from validation.peers import (
    bed,
    case,
    compare,
    drum,
    programs,
    shaken,
    silo,
)
from validation.peers.state import DENSITY, GRAVITY, Particles

from granflow.contact.theory import damping_ratio_for

CASES = tuple(compare.CASES.values())
CODES = tuple(programs.PROGRAMS)


def codes_of(each):
    """Codes that have an input for a case."""
    return [code for code in CODES if programs.simulates(code, each)]


def by_name(each):
    """Name of a case, for pytest."""
    return each.name


@pytest.mark.parametrize("each", CASES, ids=by_name)
def test_particles_of_the_initial_states_do_not_overlap_and_lie_in_the_box(each):
    for repeat in (0, 1):
        state = each.initial_state(repeat)
        low, high = np.array(each.box)
        assert np.all((state.position > low) & (state.position < high))
        pairs = cKDTree(state.position).query_pairs(state.diameter.max(), output_type="ndarray").T
        distance = np.linalg.norm(state.position[pairs[0]] - state.position[pairs[1]], axis=1)
        assert np.all(distance > 0.5 * state.diameter[pairs].sum(axis=0))


@pytest.mark.parametrize("each", CASES, ids=by_name)
def test_scenes_accept_their_initial_states_with_the_time_step_of_the_inputs(each):
    scene = each.scene(each.initial_state(0))
    assert scene.run.time_step == each.time_step
    for code in codes_of(each):
        text = programs.input_path(code, each).read_text(encoding="utf-8")
        assert float(re.search(r"^timestep (\S+)$", text, re.MULTILINE)[1]) == each.time_step
        assert re.search(rf"gravity {GRAVITY} vector 0 (0|-1) (-1|0)$", text, re.MULTILINE)
        steps = sum(int(count) for count in re.findall(r"^run (\d+)$", text, re.MULTILINE))
        assert steps * each.time_step == pytest.approx(each.times[-1])
        dumped = int(re.search(r"^dump frames all custom (\d+)", text, re.MULTILINE)[1]) * each.time_step
        ratio = np.asarray(each.times) / dumped
        np.testing.assert_allclose(ratio, np.round(ratio), atol=1e-6)


def test_entered_restitutions_give_the_viscous_force_of_granflow():
    """The values are those of the table in the guide for other codes."""
    entered = case.entered_restitutions(0.8)
    assert entered["LAMMPS"] == pytest.approx(0.7176, abs=5e-5)
    log = math.log(entered["LIGGGHTS"])
    assert -log / math.hypot(log, math.pi) == pytest.approx(damping_ratio_for(0.8))


def test_stored_figures_belong_to_the_compared_numbers():
    stored = compare.stored_figures()
    assert list(stored) == list(CODES)
    for code, content in stored.items():
        assert set(content) == {each.name for each in CASES if code in codes_of(each)}
        for name, run in content.items():
            samples = list(run["figures"].values())
            assert len({len(each) for each in samples}) == 1
            assert len(samples[0]) > 1 or not compare.CASES[name].equal_law
            assert re.search(r"\d", run["version"]) and re.fullmatch(r"\d{4}-\d\d-\d\d", run["date"])


def flying(times, count=100, velocity=(0.0, 0.0, 0.0), position=(0.0, 0.0, 0.05)):
    """Equal particles that move together."""
    ones = np.ones((count, 1))
    return {
        round(float(time), 6): Particles(
            ones * (np.array(position) + np.array(velocity) * time), ones * np.array(velocity),
            np.full(count, 4e-3)
        ) for time in times
    }  # fmt: skip


def test_figures_of_the_shaken_box():
    """A bed that moves with the box takes no power on average; one whose acceleration follows its velocity
    does."""
    times = shaken.times()
    vibration = 2.0 * math.pi * shaken.FREQUENCY
    frames = flying(times)
    swing = 0.1

    def moving(time, state):
        return replace(state, velocity=state.velocity + [0, 0, swing * math.sin(vibration * time)])

    found = shaken.figures({time: moving(time, state) for time, state in frames.items()})
    mass = 100 * DENSITY * math.pi / 6.0 * 4e-3**3
    power = 0.5 * mass * swing * vibration * shaken.AMPLITUDE * vibration
    np.testing.assert_allclose(found["power of the walls [W]"], power, rtol=2.5e-3)
    np.testing.assert_allclose(found["granular temperature [m2/s2]"], 0.0, atol=1e-20)
    assert len(found["power of the walls [W]"]) == (shaken.PERIODS - shaken.TRANSIENT) // shaken.INTERVAL
    in_phase = {
        t: replace(s, velocity=s.velocity + [0, 0, swing * math.cos(vibration * t)])
        for t, s in frames.items()
    }
    np.testing.assert_allclose(shaken.figures(in_phase)["power of the walls [W]"], 0.0, atol=1e-3 * power)


@pytest.mark.parametrize(("particles", "flow"), [(360, "pass"), (432, "fail")])
def test_the_quick_discharge_fails_if_a_fifth_more_particles_flow_out(monkeypatch, particles, flow):
    """The stored flow of LIGGGHTS, 0.0753 kg/s, is that of 360 particles of 4 mm in 0.4 s."""
    first, last = silo.FLOW_TIMES
    frames = flying((silo.OPENING, first, last), count=silo.COUNT, position=(0.0, 0.0, 0.07))
    below = (np.arange(silo.COUNT) < particles)[:, None]
    frames[last] = replace(frames[last], position=frames[last].position - [0, 0, 1.0] * below)
    monkeypatch.setattr(compare, "our_frames", lambda each, repeat: frames)
    statuses = {each.name: each.status for each in validation.QUICK["discharge of a silo"]()}
    assert statuses["LIGGGHTS: mass flow rate"] == flow


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_figures_of_the_drum(side):
    """The angle does not depend on the sense of rotation."""
    angle = math.radians(30.0)
    distance = 0.02
    position = (side * distance * math.sin(angle), -distance * math.cos(angle), 0.01)
    found = drum.figures(flying(drum.DRUMS[0].times, position=position))
    assert list(found.values()) == pytest.approx([30.0, distance])


def test_evaluation_compares_with_each_code():
    """Three runs of each code with a standard deviation of 0.01: t of Student is 6.62 for four degrees of
    freedom."""
    stored = {
        name: {
            "column": {
                "version": name,
                "date": "2026-01-01",
                "figures": {"height [m]": [value - 0.01, value, value + 0.01]},
            }
        }
        for name, value in (("one", 1.0), ("two", 1.2))
    }
    cases = compare.compared(bed.COLUMN, {"height [m]": [0.99, 1.0, 1.01]}, stored)
    assert [(each.name, each.unit, each.status) for each in cases] == [
        ("one: height", "m", "pass"), ("two: height", "m", "fail")
    ]  # fmt: skip
    assert cases[0].allowed == pytest.approx(0.02 + 6.62 * 0.01 * np.sqrt(2.0 / 3.0), rel=1e-3)


FRAME = (
    "ITEM: TIMESTEP\n{}\nITEM: NUMBER OF ATOMS\n2\nITEM: BOX BOUNDS ff ff ff\n0 1\n0 1\n0 1\nITEM: ATOMS id "
    "x ...\n"
)
ROWS = "2 4 5 6 0 0 0 0.2\n1 1 2 3 7 8 9 0.1\n"


def test_frames_of_a_dump_are_ordered_by_id(tmp_path):
    (tmp_path / "frames.txt").write_text(FRAME.format(0) + ROWS + FRAME.format(10000) + ROWS)
    frames = programs.read_frames(tmp_path / "frames.txt", 1e-5)
    assert list(frames) == [0.0, 0.1]
    np.testing.assert_array_equal(frames[0.1].position, [[1, 2, 3], [4, 5, 6]])
    np.testing.assert_array_equal(frames[0.1].velocity[0], [7, 8, 9])
    np.testing.assert_array_equal(frames[0.1].diameter, [0.1, 0.2])
