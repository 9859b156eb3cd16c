"""Final report: expectations, table, JSON, log and the resolved scene."""

import io
import json
import logging
import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from rich.console import Console

from granflow.io.log import read_record, run_log
from granflow.runs.result import (
    ExpectationResult,
    Result,
    closing_table,
    evaluate,
    write_result,
    write_stage_ends,
)

RESULT = Result(
    run={"simulated_time": 1.5, "step_count": np.int64(1_234_567)},
    timings={"neighbor_list": 1.0, "forces": 3.0},
    totals={"particle_count": 8000, "kinetic_energy": 1e-3, "energy_error": float("nan")},
    flow_meters={"outlet": {"flow_mass": 0.25, "flow_count": 100, "mass_flow": 0.153}},
)


def test_numbers_have_the_names_of_the_expect_block():
    names = ("mass_flow.outlet", "timings.forces", "kinetic_energy", "step_count")
    assert [RESULT.numbers[name] for name in names] == [0.153, 3.0, 1e-3, 1_234_567]
    no_bounds = dict.fromkeys(("between", "below", "above", "equals", "tolerance"))
    expectation = SimpleNamespace(**{**no_bounds, "quantity": "mass_flow.outlet", "above": 0.1})
    ((sentence, met),) = RESULT.with_expectations([expectation]).expectations
    assert met and sentence == "mass_flow.outlet is 0.153 kg/s, as expected above 0.1 kg/s."


def test_json_is_strict_and_contains_the_same_numbers(tmp_path):
    path = write_result(tmp_path, replace(RESULT, expectations=(ExpectationResult("All is well.", True),)))

    def reject(constant):
        raise AssertionError(f"{constant} is not JSON")

    content = json.loads(path.read_text(), parse_constant=reject)
    assert content["run"] == {"simulated_time": 1.5, "step_count": 1_234_567}
    assert content["totals"]["energy_error"] is None
    assert content["flow_meters"]["outlet"]["mass_flow"] == 0.153
    assert content["expect"] == [{"sentence": "All is well.", "met": True}]


def test_stage_ends_are_the_last_rows_of_the_stages(tmp_path):
    rows = ["time [s],stage,height", "0.0,fill,1", "0.1,fill,2", "0.2,press,3", "0.3,press,4"]
    (tmp_path / "timeseries.csv").write_text("\n".join(rows[:3]) + "\n")
    write_stage_ends(tmp_path)
    assert not (tmp_path / "stages.csv").exists(), "a single stage"
    (tmp_path / "timeseries.csv").write_text("\n".join(rows) + "\n")
    write_stage_ends(tmp_path)
    assert (tmp_path / "stages.csv").read_text().splitlines() == [rows[0], rows[2], rows[4]]


def shown(result, **options):
    """The closing table as text, without its lines."""
    console = Console(width=100, record=True, file=io.StringIO())
    console.print(closing_table(result, **options))
    rows = [re.sub("[ │]+", " ", line).strip() for line in console.export_text().splitlines()]
    return [row for row in rows if row and "─" not in row]


def test_table_has_the_speed_the_state_and_what_the_scene_measures():
    angles = {"heap": {"angle_of_repose": 0.4, "angle_of_repose_error": float("nan")}}
    rows = shown(replace(RESULT, metrics=angles))
    assert rows == [
        "Result", "simulated time 1.5 s", "step count 1 234 567", "wall clock 4.00 s (75% of it forces)",
        "particle count 8 000", "kinetic energy 0.001 J", "energy error -",
        "flow mass, outlet 0.25 kg", "flow count, outlet 100", "mass flow, outlet 0.153 kg/s",
        "angle of repose, heap 0.4 rad (22.92 deg)", "angle of repose error, heap -",
    ]  # fmt: skip


def test_table_shows_insertion_and_deletion_only_if_they_occur():
    counts = {"particle_count": 10, "inserted_count": 10, "queued_count": 0, "deleted_count": 0}
    assert not any("ed count" in row for row in shown(replace(RESULT, totals=counts)))
    changed = counts | {"inserted_count": 12, "deleted_count": 2}
    rows = shown(replace(RESULT, totals=changed))
    assert "inserted count 12" in rows and "deleted count 2" in rows and "queued count 0" not in rows


def test_table_shows_the_totals_of_features_and_hides_terms_of_the_energy_budget():
    totals = {"temperature_mean": 300.0, "box_pressure_x": 1.0, "box_pressure": 2.0, "elastic_energy": 3.0,
              "friction_dissipation": 4.0, "wall_work": 5.0, "energy_error": 0.0, "overlap_mean": 0.1}  # fmt: skip
    rows = shown(replace(RESULT, totals=totals))
    assert [row.split(" ")[:2] for row in rows[4:7]] == [
        ["temperature", "mean"],
        ["box", "pressure"],
        ["wall", "work"],
    ]
    assert not any(
        word in row for row in rows for word in ("elastic", "dissipation", "overlap", "pressure x")
    )
    assert "wall work" not in " ".join(shown(replace(RESULT, totals=totals | {"wall_work": 0.0})))


def test_table_shows_what_is_missing_of_an_inserted_group():
    group = {"inserted_count": 4, "inserted_mass": 0.5, "not_inserted_count": 0}
    assert shown(replace(RESULT, insertion={"feed": group}))[-1] == "inserted mass, feed 0.5 kg"
    missing = replace(RESULT, insertion={"feed": group | {"not_inserted_count": 2}})
    assert shown(missing)[-1] == "not inserted count, feed 2"


def test_table_has_one_row_for_a_wall_at_rest_and_names_the_stage_of_means():
    wall = {f"wall_{name}_{axis}": 0.5 for name in ("force", "torque") for axis in "xyz"}
    wall |= {"wall_pressure": 3.0, "wall_force": 0.9, "wall_force_largest": 2.0}
    powers = {"floor": 0.0, "belt": 2.0, "screw": -1.0}
    walls = {name: wall | {"wall_power": power} for name, power in powers.items()}
    forces = replace(RESULT, wall_forces=walls, stages={"run": {}})

    def rows(result):
        return [row for row in shown(result, moving=["screw"]) if "wall " in row and "clock" not in row]

    assert rows(forces) == [
        "wall force (x, y, z), floor 0.5, 0.5, 0.5 N, mean of the run",
        "wall force (x, y, z), belt 0.5, 0.5, 0.5 N, mean of the run",
        "wall power, belt 2 W, mean of the run",
        "wall force (x, y, z), screw 0.5, 0.5, 0.5 N, mean of the run",
        "wall torque (x, y, z), screw 0.5, 0.5, 0.5 N m, mean of the run",
        "wall pressure, screw 3 Pa, mean of the run",
        "wall power, screw -1 W, mean of the run",
    ]
    staged = rows(replace(forces, stages={"fill": {}, "stir": {}}))
    assert all(row.endswith(", mean of stir") for row in staged)


def test_log_records_the_run_until_an_exception_ends_it(tmp_path):
    with pytest.raises(RuntimeError), run_log(tmp_path) as log:
        log.info("stage fill begins")
        logging.getLogger("granflow.engine").warning("list grown")
        raise RuntimeError("it broke")
    logging.getLogger("granflow").error("too late")
    lines = (tmp_path / "run.log").read_text().splitlines()
    assert [line.split(" ", 2)[2] for line in lines] == [
        "INFO granflow: stage fill begins",
        "WARNING granflow.engine: list grown",
        "ERROR granflow: ended by RuntimeError: it broke",
    ]
    assert [(entry.level, entry.text, entry.ended_by) for entry in read_record(tmp_path / "run.jsonl")] == [
        ("WARNING", "list grown", ""),
        ("ERROR", "ended by RuntimeError: it broke", "RuntimeError"),
    ]


def test_record_of_a_resumed_run_continues_after_a_line_that_was_cut_off(tmp_path):
    with run_log(tmp_path) as log:
        log.info("for people only")
        log.warning("first")
    with (tmp_path / "run.jsonl").open("a") as file:
        file.write('{"time": "2026')
    with run_log(tmp_path, append=True) as log:
        log.warning("second\x1b[2J")
    found = [entry.text for entry in read_record(tmp_path / "run.jsonl")]
    assert found == ["first", "second\\x1b[2J"]


NUMBERS = {
    "mass_flow.outlet": 0.153, "angle_of_repose.heap": 0.4, "particle_count": 8000,
    "energy_error": float("nan"), "kinetic_energy": 1e-9
}  # fmt: skip


def expected(quantity, **bound):
    no_bounds = dict.fromkeys(("between", "below", "above", "equals", "tolerance"))
    return SimpleNamespace(quantity=quantity, **{**no_bounds, **bound})


@pytest.mark.parametrize(("quantity", "bound", "sentence", "met"), [
    ("mass_flow.outlet", {"between": (0.1, 0.2)}, "0.153 kg/s, as expected between 0.1 and 0.2 kg/s.", True),
    ("mass_flow.outlet", {"above": 0.2}, "0.153 kg/s, but should be above 0.2 kg/s.", False),
    ("angle_of_repose.heap", {"above": 0.3}, "0.4 rad (22.92 deg), as expected above 0.3 rad.", True),
    ("kinetic_energy", {"below": 1e-8}, "1e-09 J, as expected below 1e-08 J.", True),
    ("particle_count", {"equals": 8000}, "8000, as expected equal to 8000.", True),
    ("particle_count", {"equals": 8001}, "8000, but should be equal to 8001.", False),
    ("particle_count", {"equals": 8001, "tolerance": 0.001}, "8000, as expected equal to 8001 within 0.1 %.", True),
    ("kinetic_energy", {"equals": 1.001e-9, "tolerance": 0.01},
     "1e-09 J, as expected equal to 1.001e-09 J within 1 %.", True),
    ("energy_error", {"below": 1.0}, "nan, but should be below 1.", False),
])  # fmt: skip
def test_sentence_states_value_bound_and_result(quantity, bound, sentence, met):
    assert evaluate([expected(quantity, **bound)], NUMBERS) == [(f"{quantity} is {sentence}", met)]


def test_unknown_quantity_suggests_the_nearest_name_or_lists_all():
    similar, other = evaluate([expected("mass_flow.outlt", above=0), expected("xyzzy", above=0)], NUMBERS)
    assert similar == ("mass_flow.outlt is not a number of this run. Did you mean mass_flow.outlet?", False)
    assert not other[1] and all(name in other[0] for name in NUMBERS)
