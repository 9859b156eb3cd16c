"""Pages of a sweep and of a calibration, from files of runs with known numbers."""

import json
import re
from math import pi, sin

import numpy as np
import pytest
from studies.test_calibration import runner
from studies.test_sweep import run

from granflow.studies.calibration.results import result_of, write_calibration_page, write_result
from granflow.studies.interactive_plots import short_names
from granflow.studies.run_process import ABORTED, DONE, Outcome, final_outcome, write_outcome
from granflow.studies.sweep_design import DesignPoint, SweepInput, design_points
from granflow.studies.sweep_page import figure_of, mean_over, sobol_indices, with_error, write_sweep_page
from granflow.studies.sweep_table import PointRow, RunRow, SweepTable, shown, table_of, warning_sentence


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


def swept(folder, aborts=(), function=ishigami, **parts):
    """A sweep, by default of three parameters, whose runs have a function of them as their mass flow rate."""
    bounds = {"from": -pi, "to": pi} | ({} if "sampling" in parts else {"count": 3})
    content = {
        "scene": "a.yaml", "vary": dict.fromkeys(("a.x", "a.y", "b.z"), bounds), "read": ["mass_flow.out"]
    }  # fmt: skip
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
TEXTS = {MARKUP: {"keys": "a.x", "values": [MARKUP, "20 deg"]}, "b.y": ["20 deg", "25 deg"]}
GRID = ["scatter"] + 3 * ["histogram2d"] + ["parcoords", "splom", "scatter", "scatter"]
SOBOL = ["scatter", "parcoords", "splom", "bar", "scatter", "scatter"]


@pytest.mark.parametrize(("parts", "kinds", "words"), [
    ({"aborts": (4,)}, GRID, ("overlap above the limit", ">Two parameters</h2>", ">warnings</th>")),
    ({"sampling": {"kind": "sobol", "count": 16}}, SOBOL, (">Sobol indices</h2>", ">run79<")),
    ({"vary": {}, "repeat": {"seeds": 2}, "function": lambda: 1.0}, ["scatter", "scatter"], (">All points</h2>",)),
    ({"vary": TEXTS, "function": lambda name, y: y},
     ["scatter", "histogram2d", "parcoords", "splom", "scatter", "scatter"], ("y [deg]", "&lt;b&gt;x")),
])  # fmt: skip
def test_page_of_a_sweep_has_its_plots(tmp_path, parts, kinds, words):
    """Names and values are no markup in plots: they have no tags but line breaks."""
    pytest.importorskip("plotly")
    pytest.importorskip("SALib")
    sweep, table = swept(tmp_path, **parts)
    write_sweep_page(tmp_path, sweep, table)
    found = figures(tmp_path / "sweep.html")
    assert [each.data[0].type for each in found] == kinds
    text = (tmp_path / "sweep.html").read_text()
    assert all(each in text for each in words)
    tags = {tag for each in found for tag in re.findall(r"<[^>]*>", str(each.to_dict()))}
    assert tags <= {"<br>", "<extra>", "</extra>"}


def test_mean_over_a_parameter():
    """Means at each of few values; in intervals of equal ratios if there are many."""
    pandas = pytest.importorskip("pandas")
    few = pandas.DataFrame({"x": ["b", "a", "b"], "q": [1.0, 2.0, 4.0]})
    assert mean_over(few, "x", "q", False).values.tolist() == [["b", 2.5], ["a", 2.0]]
    many = pandas.DataFrame({"x": np.geomspace(0.01, 1.0, 16), "q": np.arange(16.0)})
    np.testing.assert_allclose(mean_over(many, "x", "q", True)["q"], np.arange(0.5, 16.0, 2.0))


@pytest.mark.parametrize(
    ("value", "error", "text"),
    [(19.1214, 4.13, "19.1 ± 4.1"), (3.0255e-11, 2.36e-11, "3.0e-11 ± 2.4e-11"), (120.4, 12.0, "120 ± 12"),
     (0.5, np.nan, "0.5"), (np.nan, np.nan, "–"), (0.25, 0.0, "0.25 ± 0"), (0.012, 3.1, "0.0 ± 3.1"),
     (1204.0, 130.0, "1200 ± 130")],
)  # fmt: skip
def test_a_number_has_the_digits_of_its_standard_error(value, error, text):
    assert with_error(value, error) == text


def test_short_names_of_parameters_are_different():
    assert short_names(["walls.left.motion.phase", "friction"]) == {
        "walls.left.motion.phase": "motion.phase", "friction": "friction",
    }  # fmt: skip
    assert list(short_names(["walls.left.motion.phase", "walls.right.motion.phase"]).values()) == [
        "left.motion.phase", "right.motion.phase",
    ]  # fmt: skip


def test_few_base_samples_have_a_sentence_and_their_indices_as_numbers(tmp_path):
    """The page draws indices whose intervals are smaller than 1; sobol.csv has all of them."""
    pytest.importorskip("SALib")
    sampling = {"kind": "sobol", "count": 2}
    sweep, table = swept(tmp_path, sampling=sampling)
    (indices,), sentence = sobol_indices(sweep, table)
    assert indices.largest_interval > 0.3 and "2 base samples are too few. Raise sampling.count" in sentence
    write_sweep_page(tmp_path, sweep, table)
    page = (tmp_path / "sweep.html").read_text()
    assert "base samples are too few" in page and ">first order</th>" in page
    rows = (tmp_path / "sobol.csv").read_text().splitlines()
    assert rows[0] == "quantity,parameter,first,first_interval,total,total_interval" and len(rows) == 4
    assert rows[1].startswith("mass_flow.out,a.x,") and float(rows[1].split(",")[2]) == indices.first[0]


def test_missing_numbers_prevent_sobol_indices_with_a_reason(tmp_path):
    pytest.importorskip("SALib")
    sweep, table = swept(tmp_path, aborts=(4,), sampling={"kind": "sobol", "count": 4})
    assert sobol_indices(sweep, table) == ([], "mass_flow.out is missing at 1 of 20 points.")


def test_page_of_a_calibration_has_best_values_and_remarks(tmp_path):
    """The energy responds to the restitution only, so that the friction cannot be identified."""
    pytest.importorskip("plotly")
    found = runner(tmp_path)
    search = found.search
    random = np.random.default_rng(1)
    while (trial := search.next_trial()) is not None:
        residual = 50.0 * (trial.params["restitution"] - 0.62) + random.normal(0.0, 0.1)
        trial.set_user_attr("residuals", {"energy": [residual]})
        trial.set_user_attr("errors", {"energy": [0.0]})
        trial.set_user_attr("simulated", {"energy": 1e-3 + 1e-5 * residual})
        search.study.tell(trial, residual**2)
    result = result_of(search, found.targets)
    friction, restitution = result.parameters
    assert restitution.value == pytest.approx(0.62, abs=0.02) and not restitution.not_identified
    assert restitution.optimum == pytest.approx(0.62, abs=3.0 * restitution.deviation)
    assert np.isnan(friction.optimum) and (friction.importance, restitution.importance) == (0.0, 1.0)
    assert friction.not_identified.startswith("friction cannot be identified from 12 completed trials: with")
    assert "Raise search.trials until 16 or more are completed." in friction.not_identified
    write_result(tmp_path, result)
    write_calibration_page(tmp_path, search.calibration, result)
    drawn = figures(tmp_path / "calibration.html")
    assert [each.data[0].type for each in drawn] == ["scatter", "scatter", "bar"]
    assert friction.not_identified in (tmp_path / "calibration.html").read_text()
    assert len((tmp_path / "trials.csv").read_text().splitlines()) == 13


def test_the_first_of_the_warnings_of_a_sweep_is_shown():
    def row(*warnings):
        return PointRow(
            DesignPoint({}, {}), [RunRow(None, Outcome(DONE), warnings=(each,)) for each in warnings]
        )

    assert not warning_sentence([row()])
    assert (
        warning_sentence([row("a", "b", "a", "c")])
        == "1 of 1 point has warnings, see sweep.csv; the first: a (2 more)"
    )
    assert warning_sentence([row(), row("a"), row("b")]).endswith(
        "2 of 3 points have warnings, see sweep.csv; the first: a (1 more)"
    )


def test_a_sweep_over_contact_models_with_options_has_a_page(tmp_path):
    """Values that are mappings are labels in YAML, in plots, tables and the CSV file."""
    laws = [{"law": "zhou", "rest_damping": 0.1}, {"law": "zhou", "rest_damping": 0.2}, "hertz"]
    vary = {"contact.normal": {"values": laws}, "run.duration": {"values": [1.0, 2.0]}}
    sweep, table = swept(
        tmp_path, function=lambda law, time: time * len(law), vary=vary, sampling={"kind": "grid"}
    )
    write_sweep_page(tmp_path, sweep, table)
    page = (tmp_path / "sweep.html").read_text()
    assert "{law: zhou, rest_damping: 0.1}" in page and "{&#39;law&#39;" not in page
    assert table.columns()["contact.normal"][0] == "{law: zhou, rest_damping: 0.1}"
    assert table.run_columns()["contact.normal"][-1] == "hertz"


def test_figure_of_a_sweep_has_points_with_standard_errors():
    """Three seeds at each of two points: error bars of s / sqrt(3) about the means; a line for each value of the
    other parameter."""
    pytest.importorskip("matplotlib")
    from granflow.studies.figures import styled_figure

    sweep = SweepInput.model_validate({
        "scene": "a.yaml", "read": ["mass_flow.out"], "repeat": {"seeds": 3},
        "vary": {"a.x": [1.0, 2.0], "a.law": ["zhou", "hertz"]},
    })  # fmt: skip
    numbers = {(1.0, "zhou"): [1, 2, 3], (1.0, "hertz"): [4, 4, 7], (2.0, "zhou"): [2, 2, 2],
               (2.0, "hertz"): [0, 5, 10]}  # fmt: skip
    rows = tuple(
        PointRow(
            point,
            [RunRow(None, Outcome(DONE, "", 1.0), {"mass_flow.out": float(value)}) for value in
             numbers[tuple(point.values.values())]],
        )
        for point in design_points(sweep)
    )  # fmt: skip
    table = shown(sweep, SweepTable(("a.x", "a.law"), ("mass_flow.out",), 3, rows))
    drawing = figure_of(table)
    with styled_figure((4, 3)) as figure:
        drawing.draw(figure)
        over_x, over_law = figure.axes
        bars = {each.get_label(): each for each in over_x.containers}
        for law in ("zhou", "hertz"):
            line, _, (sticks,) = bars[law]
            expected = np.array([numbers[x, law] for x in (1.0, 2.0)], float)
            assert line.get_xydata().tolist() == [[1.0, expected[0].mean()], [2.0, expected[1].mean()]]
            length = [segment[1, 1] - segment[0, 1] for segment in sticks.get_segments()]
            assert length == pytest.approx(2.0 * expected.std(axis=1, ddof=1) / np.sqrt(3.0))
        assert [each.get_text() for each in over_law.get_xticklabels()] == ["zhou", "hertz"]


def test_a_sweep_without_numbers_has_no_figure(tmp_path):
    sweep, table = swept(tmp_path, aborts=range(27))
    write_sweep_page(tmp_path, sweep, table)
    assert not (tmp_path / "sweep.png").exists()
