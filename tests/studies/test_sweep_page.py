"""Pages of a sweep and of a calibration, from files of runs with known numbers."""

import json
import re
import shutil
import subprocess
from dataclasses import replace
from math import pi, sin

import numpy as np
import pytest
from studies.test_calibration import runner
from studies.test_sweep import run

from granflow.studies.calibration.results import result_of, write_calibration_page, write_result
from granflow.studies.interactive_plots import short_names
from granflow.studies.run_process import ABORTED, Outcome, final_outcome, write_outcome
from granflow.studies.sweep_design import SweepInput, design_points
from granflow.studies.sweep_page import (
    NamedRun,
    heat_maps,
    in_lines,
    main_effects,
    parallel_coordinates,
    scatter_matrix,
    series_overlay,
    sobol_indices,
    with_error,
    write_sweep_page,
)
from granflow.studies.sweep_table import shown, table_of


def ishigami(x, y, z):
    return sin(x) + 7.0 * sin(y) ** 2 + 0.1 * z**4 * sin(x)


CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")


def finished(folder, name, value, aborts=False):
    """A run with a result and a time series, or an aborted one."""
    made = run(folder, name)
    if aborts:
        write_outcome(made.directory, Outcome(ABORTED, "overlap above the limit", 2.0))
        return made
    content = {"expect": [], "run": {"wall_clock": 1.0}, "flow_meters": {"out": {"mass_flow": value}}}
    (made.directory / "result.json").write_text(json.dumps(content))
    rows = [f"{0.1 * k},run,{value * 0.1 * k},{value}" for k in range(20)]
    heads = "time [s],stage,flow_mass.out [kg],mass_flow.out [kg/s]"
    (made.directory / "timeseries.csv").write_text("\n".join([heads, *rows]) + "\n")
    return made


def swept(folder, aborts=(), function=ishigami, **parts):
    """A sweep, by default of three parameters, whose runs have a function of them as their mass flow rate."""
    bounds = {"from": -pi, "to": pi} | ({} if "sampling" in parts else {"count": 3})
    content = {
        "scene": "a.yaml",
        "vary": dict.fromkeys(("a.x", "a.y", "b.z"), bounds),
        "read": ["mass_flow.out"],
    }
    sweep = SweepInput.model_validate(content | parts)
    points = [
        (point, [finished(folder, f"run{k}", function(*point.values.values()), k in aborts)])
        for k, point in enumerate(design_points(sweep))
    ]
    outcomes = {each.request.directory: final_outcome(each.directory) for _, (each,) in points}
    return sweep, table_of(tuple(sweep.vary), sweep.read, points, outcomes)


def test_page_of_a_sobol_sweep_has_indices_and_all_points(tmp_path):
    pytest.importorskip("plotly")
    pytest.importorskip("SALib")
    sweep, table = swept(tmp_path, sampling={"kind": "sobol", "count": 64})
    write_sweep_page(tmp_path, sweep, table)
    page = (tmp_path / "sweep.html").read_text()
    assert len(table.rows) == 64 * 5 and all(f"runs/run{k}" in page for k in range(320))
    (indices,), why = sobol_indices(sweep, table)
    assert not why and indices.total[0] > indices.first[0] + 0.1  # x interacts with z
    titles = ("Main effects", "All parameters and quantities", "Sobol indices", "Time series", "All points")
    assert all(f">{title}</h2>" in page for title in titles) and "Two parameters" not in page


def test_page_of_a_grid_has_heat_maps_and_the_reason_of_an_abort(tmp_path):
    pytest.importorskip("plotly")
    sweep, table = swept(tmp_path, aborts=(4,))
    write_sweep_page(tmp_path, sweep, table)
    page = (tmp_path / "sweep.html").read_text()
    assert "Two parameters" in page and "overlap above the limit" in page and ">reason</th>" in page
    assert "standard error" not in page and "equal intervals" not in page  # one seed, few values
    assert "Sobol" not in page.partition("<body>")[2].partition("<script>")[0]


MARKUP = "<b>x</b><a href='http://example.org'>%{x}</a>"


def plotted_texts(page):
    """All texts in the figures of a page, which plotly reads as markup."""
    found = []

    def collect(value):
        if isinstance(value, str):
            found.append(value)
        for each in value.values() if isinstance(value, dict) else value if isinstance(value, list) else ():
            collect(each)

    for figure in re.findall(r"<script[^>]*application/json[^>]*>(.*?)</script>", page, re.S):
        collect(json.loads(figure))
    return found


def test_names_and_values_of_a_sweep_are_no_markup_in_its_plots(tmp_path):
    pytest.importorskip("plotly")
    vary = {MARKUP: {"keys": "a.x", "values": [MARKUP, "plain"]}, "b.y": [1, 2]}
    sweep, table = swept(tmp_path, vary=vary, function=lambda _name, y: y)
    write_sweep_page(tmp_path, sweep, table)
    texts = plotted_texts((tmp_path / "sweep.html").read_text())
    assert any("&lt;b&gt;x&lt;/b&gt;" in text for text in texts)
    tags = {tag for text in texts for tag in re.findall(r"<[^>]*>", text)}
    assert tags <= {"<br>", "<extra>", "</extra>"}
    assert not any("%{x}" in text and "hovertemplate" in text for text in texts)


def test_tables_of_a_sweep_have_the_warnings_of_its_runs(tmp_path):
    sweep, table = swept(tmp_path)
    warned = table.rows[3].runs[0].run.directory / "result.json"
    warned.write_text(
        json.dumps(json.loads(warned.read_text()) | {"warnings": ["walls.lid has never touched."]})
    )
    outcomes = {each.run.request.directory: each.outcome for row in table.rows for each in row.runs}
    points = [(row.point, [each.run for each in row.runs]) for row in table.rows]
    table = table_of(table.parameters, table.quantities, points, outcomes)
    for columns in (table.columns(), table.run_columns()):
        assert [
            k for k, text in enumerate(columns["warnings"]) if text == "walls.lid has never touched."
        ] == [3]
    write_sweep_page(tmp_path, sweep, table)
    page = (tmp_path / "sweep.html").read_text()
    assert ">warnings</th>" in page and "walls.lid has never touched." in page


def test_page_of_a_sweep_has_degrees_and_the_units_of_the_sweep_file(tmp_path):
    pytest.importorskip("plotly")
    angles = {"expect": [], "run": {"wall_clock": 1.0}, "metrics": {"left": {"angle_of_repose": 0.4}}}
    content = {"scene": "a.yaml", "vary": {"a.x": ["20 deg"]}, "read": ["angle_of_repose.left"]}
    sweep = SweepInput.model_validate(content)
    (point,) = design_points(sweep)
    made = finished(tmp_path, "run0", 1.0)
    (made.directory / "result.json").write_text(json.dumps(angles))
    outcomes = {made.request.directory: final_outcome(made.directory)}
    table = table_of(tuple(sweep.vary), sweep.read, [(point, [made])], outcomes)
    write_sweep_page(tmp_path, sweep, table)
    page = (tmp_path / "sweep.html").read_text()
    assert (
        ">22.918</td>" in page and "a.x [deg] = 20" in page and "angle_of_repose.left [deg] = 22.92" in page
    )
    assert "1 of 1 runs, named by a.x [deg]." in page and '"name":"20"' in page
    assert all(f">{head} [deg]</th>" in page for head in ("a.x", "angle_of_repose.left"))
    assert table.columns()["angle_of_repose.left [rad]"] == [0.4]
    assert table.columns()["a.x"] == [pytest.approx(0.3490658503988659)]


def test_parameters_on_a_logarithmic_scale_have_logarithmic_axes_and_intervals(tmp_path):
    sweep, table = swept(tmp_path, vary={"a.x": {"from": 0.01, "to": 1.0, "scale": "log", "count": 17},
                                         "a.y": [0.0], "b.z": [1.0]})  # fmt: skip
    found = shown(sweep, table)
    figure = main_effects(found, "mass_flow.out").figure
    assert figure["layout"]["xaxis"]["type"] == "log"
    assert "type" not in figure["layout"]["xaxis2"]
    means = figure["data"][1]["x"]  # of two of the 17 values each, the last of three
    np.testing.assert_allclose(means[:7], 10.0 ** (-2.0 + 0.125 * (2.0 * np.arange(7) + 0.5)), rtol=1e-4)
    assert means[7] == pytest.approx(10.0 ** (-2.0 + 0.125 * 15.0), rel=1e-4)
    layout = scatter_matrix(found).figure["layout"]
    assert layout["xaxis"]["type"] == layout["yaxis"]["type"] == "log"
    assert "type" not in layout["xaxis2"]
    assert [line["y"][0] for line in parallel_coordinates(found).figure["data"]] == [
        pytest.approx(k / 16, abs=1e-6) for k in range(17)
    ]


@pytest.mark.parametrize(
    ("value", "error", "text"),
    [(19.1214, 4.13, "19.1 ± 4.1"), (3.0255e-11, 2.36e-11, "3.0e-11 ± 2.4e-11"), (120.4, 12.0, "120 ± 12"),
     (0.5, np.nan, "0.5"), (np.nan, np.nan, "–"), (0.25, 0.0, "0.25 ± 0"), (0.012, 3.1, "0.0 ± 3.1"),
     (1204.0, 130.0, "1200 ± 130")],
)  # fmt: skip
def test_a_number_has_the_digits_of_its_standard_error(value, error, text):
    assert with_error(value, error) == text


def test_labels_of_narrow_plots_have_few_lines():
    assert in_lines("angle_of_repose.left [deg]") == "angle_of_<br>repose.left<br>[deg]"
    assert in_lines("mass [kg]") == "mass [kg]"


def test_short_names_of_parameters_are_different():
    assert short_names(["walls.left.motion.phase", "friction"]) == {
        "walls.left.motion.phase": "motion.phase", "friction": "friction",
    }  # fmt: skip
    assert list(short_names(["walls.left.motion.phase", "walls.right.motion.phase"]).values()) == [
        "left.motion.phase", "right.motion.phase",
    ]  # fmt: skip


def test_missing_numbers_prevent_sobol_indices_with_a_reason(tmp_path):
    pytest.importorskip("SALib")
    sweep, table = swept(tmp_path, aborts=(4,), sampling={"kind": "sobol", "count": 4})
    assert sobol_indices(sweep, table) == ([], "mass_flow.out is missing at 1 of 20 points.")


def test_overlay_shows_the_series_of_all_runs(tmp_path):
    runs = [
        NamedRun(name, f"x = {name}", finished(tmp_path, name, k + 1.0).directory)
        for k, name in enumerate("ab")
    ]
    plot = series_overlay(runs, ["mass_flow.out"], "x")
    assert [curve["name"] for curve in plot.figure["data"]] == ["a", "b"]
    assert set(plot.figure["data"][1]["y"]) == {2.0}
    labels = [button["label"] for button in plot.figure["layout"]["updatemenus"][0]["buttons"]]
    assert labels == ["mass flow, out", "flow mass, out"]
    plot = series_overlay(runs, ["flow_mass.out", "mass_flow.out"], "x")
    labels = [button["label"] for button in plot.figure["layout"]["updatemenus"][0]["buttons"]]
    assert labels == ["flow mass, out", "mass flow, out"]


def test_overlay_shows_angles_in_degrees(tmp_path):
    made = finished(tmp_path, "a", 1.0)
    (made.directory / "timeseries.csv").write_text("time [s],stage,repose [rad]\n0,run,0\n1,run,0.4\n")
    figure = series_overlay([NamedRun("a", "", made.directory)], [], "x").figure
    assert figure["data"][0]["y"] == [0.0, pytest.approx(0.4 * 180.0 / pi)]
    assert figure["layout"]["yaxis"]["title"]["text"] == "repose (deg)"


@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium")
@pytest.mark.parametrize("parameters, plots", [(("a.x",), 3), (("a.x", "a.y"), 5)])
def test_browser_draws_each_plot(tmp_path, parameters, plots):
    """Plotly draws an SVG of class main-svg in each plot; a scatter matrix of two columns made it fail."""
    pytest.importorskip("plotly")
    content = {
        "scene": "a.yaml",
        "vary": dict.fromkeys(parameters, [0.1, 0.2, 0.3]),
        "read": ["mass_flow.out"],
    }
    sweep = SweepInput.model_validate(content)
    points = [
        (point, [finished(tmp_path, f"run{k}", sum(point.values.values()))])
        for k, point in enumerate(design_points(sweep))
    ]
    outcomes = {each.request.directory: final_outcome(each.directory) for _, (each,) in points}
    write_sweep_page(tmp_path, sweep, table_of(tuple(sweep.vary), sweep.read, points, outcomes))
    command = [
        CHROMIUM,
        "--headless",
        "--no-sandbox",
        "--use-angle=swiftshader",
        "--enable-unsafe-swiftshader",
    ]
    command += ["--virtual-time-budget=9000", "--dump-dom", (tmp_path / "sweep.html").as_uri()]
    page = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True).stdout
    page = page.partition("<body")[2]
    assert page.count('class="plot-container') == plots and ">The plot cannot be shown" not in page


@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium")
def test_plots_follow_the_width_of_the_page(tmp_path):
    """The page becomes 300 pixels wide after the plots are drawn, without an event of the window."""
    pytest.importorskip("plotly")
    sweep, table = swept(tmp_path)
    write_sweep_page(tmp_path, sweep, table)
    page = tmp_path / "sweep.html"
    script = "<script>setTimeout(() => { document.body.style.width = '300px'; }, 6000);</script></body>"
    page.write_text(page.read_text().replace("</body>", script))
    command = [
        CHROMIUM,
        "--headless",
        "--no-sandbox",
        "--window-size=1000,800",
        "--virtual-time-budget=12000",
    ]
    dump = subprocess.run(
        [*command, "--dump-dom", page.as_uri()], capture_output=True, text=True, timeout=120
    ).stdout
    widths = {
        int(width)
        for width in re.findall(r'class="main-svg"[^>]*? width="(\d+)"', dump.partition("<body")[2])
    }
    assert widths == {300}


def test_titles_of_a_scatter_matrix_are_outside_the_labels_of_the_ticks(tmp_path):
    """A title of several lines is placed beside the labels only if it has a standoff."""
    sweep, table = swept(tmp_path)
    layout = scatter_matrix(shown(sweep, table)).figure["layout"]
    for axis in ("xaxis", "yaxis", "xaxis4", "yaxis4"):
        assert layout[axis]["title"]["standoff"] > 0
    assert layout["yaxis4"]["title"]["text"] == in_lines("mass_flow.out [kg/s]")


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
    assert restitution.optimum == pytest.approx(0.62, abs=3.0 * restitution.deviation) and np.isnan(
        friction.optimum
    )
    assert friction.not_identified.startswith(
        "friction cannot be identified from the targets: none of them responds to it between its bounds by "
        "more than the scatter between runs; energy changes by "
    )
    write_result(tmp_path, result)
    write_calibration_page(tmp_path, search.calibration, result)
    page = (tmp_path / "calibration.html").read_text()
    assert (friction.importance, restitution.importance) == (0.0, 1.0)
    assert friction.not_identified in page and ">Importance</h2>" in page
    assert len((tmp_path / "trials.csv").read_text().splitlines()) == 13


def test_heat_map_of_equal_values_is_labeled_with_their_value(tmp_path):
    sweep, table = swept(tmp_path)
    rows = tuple(
        replace(row, runs=[replace(each, numbers={"mass_flow.out": 2.5}) for each in row.runs])
        for row in table.rows
    )
    bars = [plot.figure["data"][0]["colorbar"] for plot in heat_maps(shown(sweep, replace(table, rows=rows)))]
    assert [bar["ticktext"] for bar in bars] == [["2.5"]] * 3
    assert all(
        "ticktext" not in plot.figure["data"][0]["colorbar"] for plot in heat_maps(shown(sweep, table))
    )
