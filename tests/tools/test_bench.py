"""tools/bench.py: generated beds, logs of other codes, ratios, byte and operation counts, messages."""

import importlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

TOOLS = Path(__file__).resolve().parents[2] / "tools"


def module(name):
    return importlib.import_module(f"benchmark.{name}")


def three_particle_bed():
    """Three particles in a box of 10 mm x 20 mm; the first overlaps the wall at x = 10 mm by 0.1 mm."""
    position = np.array([[9.1, 5.0, 1.0], [4.0, 5.0, 1.0], [4.0, 15.0, 1.2]]) * 1e-3
    return module("cases").Case("bed 3", "bed", np.array([2.0, 2.0, 2.4]) * 1e-3, position, (0.010, 0.020))


def test_lammps_damping_gives_the_restitution():
    """A collision with LAMMPS' model, integrated by scipy: e is about 0.9 at the mean overlap of the
    damping."""
    from scipy.integrate import solve_ivp

    cases = module("cases")
    stiffness = cases.hertz_stiffnesses()[0]
    damping = cases.lammps_damping()
    radius = 1e-3
    mass = 0.5 * 2500 * 4 / 3 * np.pi * 2e-3**3
    overlap_max = 2.0 * cases.OVERLAP_MEAN  # the mean over a collision is about half of the maximum
    speed = np.sqrt(0.8 * stiffness * np.sqrt(radius) * overlap_max**2.5 / mass)

    def motion(_, state):
        overlap = max(state[0], 0.0)
        return state[1], -np.sqrt(radius * overlap) * (stiffness * overlap + damping * mass * state[1]) / mass

    def separation(_, state):
        return state[0] if state[1] < 0 else 1.0

    separation.terminal = True
    run = solve_ivp(motion, (0, 0.05), (1e-12, speed), events=separation, rtol=1e-9, atol=1e-14)
    assert -run.y[1, -1] / speed == pytest.approx(0.9, abs=0.02)


LOG = """LAMMPS (29 Sep 2021 - Update 2)
Step Atoms v_above
       0       3   2.00
       1       3   2.00
Loop time of 0.01 on 2 procs for 1 steps with 3 atoms
Neighbor list builds = 0
Step Atoms v_above
       1       3   2.00
     101       3   1.50
Loop time of 9 on 2 procs for 100 steps with 3 atoms
Neighbor list builds = 7
Step Atoms v_above
     101       3   1.50
WARNING: something
     301       3   1.25
Loop time of 0.5 on 2 procs for 200 steps with 3 atoms
Neighbor list builds = 3
Step Atoms c_coordination v_above
     301       3    4.0   1.25
     302       3    4.2   1.25
Loop time of 0.02 on 2 procs for 1 steps with 3 atoms
Neighbor list builds = 0
"""


def hopper_job(threads):
    cases = module("cases")
    codes = module("codes")
    case = replace(three_particle_bed(), kind="hopper")
    return codes.Job("lammps", "hertz", case, threads, "f64", 5e-4, cases.Steps(100, 200))


def test_log_of_lammps_is_parsed():
    codes = module("codes")
    found = codes.read_log(LOG, hopper_job(2))
    assert found["version"] == "29 Sep 2021 - Update 2"
    assert found["rate"] == pytest.approx(3 * 200 / 0.5)
    assert found["contacts"] == pytest.approx(4.2 / 2)
    assert found["rebuilds"] == pytest.approx(3 / 200 * 1000)
    assert found["mass_flow"] == pytest.approx(0.25 / (200 * 1e-5))
    with pytest.raises(codes.Failed, match=r"ran on 2 rank\(s\) for 4"):
        codes.read_log(LOG, hopper_job(4))
    with pytest.raises(codes.Failed, match="Lost atoms"):
        codes.read_log(LOG[:300] + "\nERROR: Lost atoms\n", hopper_job(2))


def points(**rates):
    """Measurements of 10 particles on one thread; names are CODE_LAW, values the rates of the rounds."""
    common = {"case": "bed 10", "count": 10, "threads": 1}
    found = []
    for name, values in rates.items():
        code, law = name.split("_")
        found += [
            {"round": n, "code": code, "law": law, "rate": rate} | common for n, rate in enumerate(values, 1)
        ]
    return found


def test_ratios_are_computed_within_a_round():
    tables = module("tables")
    # The machine is half as fast in round 2, and LAMMPS has no round 3: only rounds of both codes are
    # compared.
    result = {"points": points(granflow_hertz=[40e6, 20e6, 30e6], lammps_hertz=[20e6, 10e6]), "notes": []}
    lammps = next(group for group in tables.groups(result) if group.code == "lammps")
    ratio = tables.ratio(result, lammps)
    assert (ratio.middle, ratio.low, ratio.high) == (2.0, 2.0, 2.0)
    assert "2.00 (2.00-2.00)" in tables.text(result)


def test_the_guide_contains_the_newest_measurements_on_ranks(tmp_path):
    """If this fails, run `python tools/bench.py --page`."""
    ranks_page = module("ranks_page")
    bench = Path(module("ranks_page").__file__).parent
    guide = tmp_path / "parallel.md"
    guide.write_text(ranks_page.GUIDE.read_text(encoding="utf-8"), encoding="utf-8")
    written = ranks_page.write(bench / "results", guide)
    assert written.read_text(encoding="utf-8") == ranks_page.GUIDE.read_text(encoding="utf-8")
