"""tools/bench.py: logs of other codes, ratios, and the page of measurements."""

import json
from pathlib import Path
from types import SimpleNamespace

import pytest
from benchmark import cases, codes, phases, ranks_page, tables

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


def test_log_of_lammps_is_parsed():
    case = SimpleNamespace(kind="hopper", count=3)
    job = codes.Job("lammps", "hertz", case, 2, "f64", 5e-4, cases.Steps(100, 200))
    found = codes.read_log(LOG, job)
    assert found["version"] == "29 Sep 2021 - Update 2"
    assert found["rate"] == pytest.approx(3 * 200 / 0.5)
    assert found["contacts"] == pytest.approx(4.2 / 2)
    assert found["rebuilds"] == pytest.approx(3 / 200 * 1000)
    assert found["mass_flow"] == pytest.approx(0.25 / (200 * 1e-5))
    with pytest.raises(codes.Failed, match="Lost atoms"):
        codes.read_log(LOG[:300] + "\nERROR: Lost atoms\n", job)


def test_ratios_are_computed_within_a_round():
    """The machine is half as fast in round 2, and LAMMPS has no round 3: only rounds of both codes are
    compared."""
    points = [
        {"round": n, "code": code, "law": "hertz", "rate": rate, "case": "bed 10", "count": 10, "threads": 1}
        for code, rates in {"granflow": (40e6, 20e6, 30e6), "lammps": (20e6, 10e6)}.items()
        for n, rate in enumerate(rates, 1)
    ]
    result = {"points": points, "notes": []}
    lammps = next(group for group in tables.groups(result) if group.code == "lammps")
    ratio = tables.ratio(result, lammps)
    assert (ratio.middle, ratio.low, ratio.high) == (2.0, 2.0, 2.0)


def test_the_guide_contains_the_newest_measurements_on_ranks(tmp_path):
    """If this fails, run `python tools/bench.py --page`."""
    guide = tmp_path / "parallel.md"
    text = ranks_page.GUIDE.read_text(encoding="utf-8")
    guide.write_text(text, encoding="utf-8")
    results = Path(ranks_page.__file__).parent / "results"
    assert ranks_page.write(results, guide).read_text(encoding="utf-8") == text


def test_phase_that_launches_hide_has_no_rates():
    """On a loaded machine, a launch can take as long as a sampled step: the time of the phase is then 0."""
    result = json.loads(sorted(Path(phases.__file__).parent.glob("results/*-phases.json"))[-1].read_text())
    result["points"][0]["seconds"]["motion"] = 0.0
    hidden, forces, *_ = phases.rows(result)
    assert hidden[6:8] == ["-", "-"] and hidden[10].startswith("- (")
    assert "-" not in forces[6:8]
