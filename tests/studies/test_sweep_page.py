"""Page of a sweep, from files of runs with known numbers."""

import json
import re
from math import pi, sin

import pytest
from studies.test_sweep import run

from granflow.studies.run_process import ABORTED, Outcome, final_outcome, write_outcome
from granflow.studies.sweep_design import SweepInput, design_points
from granflow.studies.sweep_page import sobol_indices, write_sweep_page
from granflow.studies.sweep_table import table_of


def ishigami(x, y, z):
    return sin(x) + 7.0 * sin(y) ** 2 + 0.1 * z**4 * sin(x)


def finished(folder, name, value, aborts=False):
    """A run with a result and a time series, or an aborted one."""
    made = run(folder, name)
    if aborts:
        write_outcome(made.directory, Outcome(ABORTED, "overlap above the limit", 2.0))
        return made
    content = {"expect": [], "run": {"wall_clock": 1.0}, "warnings": ["x has never touched."],
               "flow_meters": {"out": {"mass_flow": value}}}  # fmt: skip
    (made.directory / "result.json").write_text(json.dumps(content))
    rows = [f"{0.1 * k},run,{value * 0.1 * k},{value}" for k in range(20)]
    heads = "time [s],stage,flow_mass.out [kg],mass_flow.out [kg/s]"
    (made.directory / "timeseries.csv").write_text("\n".join([heads, *rows]) + "\n")
    return made


def swept(folder, vary, function=ishigami, aborts=(), **parts):
    """A sweep whose runs have a function of its parameters as their mass flow rate."""
    content = {"scene": "a.yaml", "vary": vary, "read": ["mass_flow.out"]}
    sweep = SweepInput.model_validate(content | parts)
    points = [
        (point, [finished(folder, f"run{k}", function(*point.values.values()), k in aborts)])
        for k, point in enumerate(design_points(sweep))
    ]
    outcomes = {each.request.directory: final_outcome(each.directory) for _, (each,) in points}
    return sweep, table_of(tuple(sweep.vary), sweep.read, points, outcomes)


def figures(page):
    """Figures of a page as objects of plotly, which checks them."""
    from plotly.graph_objects import Figure

    scripts = re.findall(r"<script[^>]*application/json[^>]*>(.*?)</script>", page.read_text(), re.S)
    return [Figure(json.loads(each)) for each in scripts]


MARKUP = "<b>x</b><a href='http://example.org'>x</a>"


def test_page_of_a_grid_shows_names_and_values_without_markup(tmp_path):
    """Values may be texts with a unit and mappings, which are YAML in the table."""
    pytest.importorskip("plotly")
    laws = [MARKUP, {"law": "zhou", "rest_damping": 0.1}]
    vary = {MARKUP: {"keys": "contact.normal", "values": laws}, "b.y": ["20 deg", "25 deg"], "c": [1, 2]}
    sweep, table = swept(tmp_path, vary, lambda _, y, c: y * c, aborts=(1,))
    assert table.columns()[MARKUP][-1] == "{law: zhou, rest_damping: 0.1}"
    write_sweep_page(tmp_path, sweep, table)
    found = figures(tmp_path / "sweep.html")
    kinds = ["scatter"] + 3 * ["histogram2d"] + ["parcoords", "splom", "scatter", "scatter"]
    assert [each.data[0].type for each in found] == kinds
    text = (tmp_path / "sweep.html").read_text()
    assert all(
        each in text for each in ("overlap above the limit", ">warnings</th>", "y [deg]", "&lt;b&gt;x")
    )
    tags = {tag for each in found for tag in re.findall(r"<[^>]*>", str(each.to_dict()))}
    assert tags <= {"<br>", "<extra>", "</extra>"}


def test_page_of_a_sobol_design_has_its_indices(tmp_path):
    """A missing number prevents them; few samples have intervals that are too large."""
    pytest.importorskip("plotly")
    pytest.importorskip("SALib")
    vary = dict.fromkeys(("a.x", "a.y", "b.z"), {"from": -pi, "to": pi})
    sampling = {"kind": "sobol", "count": 2}
    sweep, table = swept(tmp_path, vary, sampling=sampling)
    (indices,), sentence = sobol_indices(sweep, table)
    assert indices.largest_interval > 0.3 and "2 base samples are too few." in sentence
    write_sweep_page(tmp_path, sweep, table)
    rows = (tmp_path / "sobol.csv").read_text().splitlines()
    assert rows[0] == "quantity,parameter,first,first_interval,total,total_interval" and len(rows) == 4
    assert rows[1].startswith("mass_flow.out,a.x,") and float(rows[1].split(",")[2]) == indices.first[0]
    assert "base samples are too few" in (tmp_path / "sweep.html").read_text()
    incomplete = swept(tmp_path / "incomplete", vary, aborts=(4,), sampling=sampling)
    assert sobol_indices(*incomplete) == ([], "mass_flow.out is missing at 1 of 10 points.")
