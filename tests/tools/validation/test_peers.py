"""Comparison with LIGGGHTS and LAMMPS: initial states, inputs, and evaluation."""

import math
import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import cKDTree
from validation import run as validation
from validation.peers import bed, case, compare, programs, silo
from validation.peers.state import GRAVITY, Particles

from granflow.contact.theory import damping_ratio_for


@pytest.mark.parametrize("each", compare.CASES.values(), ids=lambda each: each.name)
def test_initial_states_and_scenes_agree_with_the_inputs_of_the_codes(each):
    """Particles do not overlap and lie in the box; time step, gravity and duration are those of the inputs."""
    state = each.initial_state(0)
    low, high = np.array(each.box)
    assert np.all((state.position > low) & (state.position < high))
    pairs = cKDTree(state.position).query_pairs(state.diameter.max(), output_type="ndarray").T
    distance = np.linalg.norm(state.position[pairs[0]] - state.position[pairs[1]], axis=1)
    assert np.all(distance > 0.5 * state.diameter[pairs].sum(axis=0))
    assert each.scene(state).run.time_step == each.time_step
    for code in programs.PROGRAMS:
        if programs.simulates(code, each):
            text = programs.input_path(code, each).read_text(encoding="utf-8")
            assert float(re.search(r"^timestep (\S+)$", text, re.MULTILINE)[1]) == each.time_step
            assert re.search(rf"gravity {GRAVITY} vector 0 (0|-1) (-1|0)$", text, re.MULTILINE)
            steps = sum(int(count) for count in re.findall(r"^run (\d+)$", text, re.MULTILINE))
            assert steps * each.time_step == pytest.approx(each.times[-1])


def test_entered_restitutions_give_the_viscous_force_of_granflow():
    """The values are those of the table in the guide for other codes."""
    entered = case.entered_restitutions(0.8)
    assert entered["LAMMPS"] == pytest.approx(0.7176, abs=5e-5)
    log = math.log(entered["LIGGGHTS"])
    assert -log / math.hypot(log, math.pi) == pytest.approx(damping_ratio_for(0.8))


@pytest.mark.parametrize(("particles", "flow"), [(360, "pass"), (432, "fail")])
def test_the_quick_discharge_fails_if_a_fifth_more_particles_flow_out(monkeypatch, particles, flow):
    """The stored flow of LIGGGHTS, 0.0753 kg/s, is that of 360 particles of 4 mm in 0.4 s."""
    position = np.tile([0.0, 0.0, 0.07], (silo.COUNT, 1))
    still = Particles(position, 0.0 * position, np.full(silo.COUNT, 4e-3))
    below = (np.arange(silo.COUNT) < particles)[:, None]
    first, last = silo.FLOW_TIMES
    fallen = replace(still, position=position - [0, 0, 1.0] * below)
    monkeypatch.setattr(compare, "our_frames", lambda *_: {silo.OPENING: still, first: still, last: fallen})
    statuses = {each.name: each.status for each in validation.QUICK["discharge of a silo"]()}
    assert statuses["LIGGGHTS: mass flow rate"] == flow


def test_evaluation_compares_with_each_code():
    """Three runs of each code with a standard deviation of 0.01: t of Student is 6.62 for four degrees of
    freedom."""
    stored = {}
    for name, value in (("one", 1.0), ("two", 1.2)):
        figures = {"height [m]": [value - 0.01, value, value + 0.01]}
        stored[name] = {"column": {"version": name, "date": "2026-01-01", "figures": figures}}
    cases = compare.compared(bed.COLUMN, {"height [m]": [0.99, 1.0, 1.01]}, stored)
    found = [(each.name, each.unit, each.status) for each in cases]
    assert found == [("one: height", "m", "pass"), ("two: height", "m", "fail")]
    assert cases[0].allowed == pytest.approx(0.02 + 6.62 * 0.01 * np.sqrt(2.0 / 3.0), rel=1e-3)
