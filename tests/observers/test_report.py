"""Final report: expectations, table, JSON, log and the resolved scene."""

import json
import logging
from types import SimpleNamespace

import numpy as np
import pytest

from granflow.io.log import read_record, run_log
from granflow.runs.result import Result, evaluate, write_result, write_stage_ends

RESULT = Result(
    run={"simulated_time": 1.5, "step_count": np.int64(1_234_567)},
    timings={"neighbor_list": 1.0, "forces": 3.0},
    totals={"particle_count": 8000, "kinetic_energy": 1e-3, "energy_error": float("nan")},
    flow_meters={"outlet": {"flow_mass": 0.25, "flow_count": 100, "mass_flow": 0.153}},
)


def expected(quantity, **bound):
    no_bounds = dict.fromkeys(("between", "below", "above", "equals", "tolerance"))
    return SimpleNamespace(quantity=quantity, **{**no_bounds, **bound})


def test_json_is_strict_and_contains_the_numbers_of_the_expect_block(tmp_path):
    names = ("mass_flow.outlet", "timings.forces", "kinetic_energy", "step_count")
    assert [RESULT.numbers[name] for name in names] == [0.153, 3.0, 1e-3, 1_234_567]

    def reject(constant):
        raise AssertionError(f"{constant} is not JSON")

    path = write_result(tmp_path, RESULT.with_expectations([expected("mass_flow.outlet", above=0.1)]))
    content = json.loads(path.read_text(), parse_constant=reject)
    assert content["run"] == {"simulated_time": 1.5, "step_count": 1_234_567}
    assert content["totals"]["energy_error"] is None
    assert content["flow_meters"]["outlet"]["mass_flow"] == 0.153
    assert [each["met"] for each in content["expect"]] == [True]


def test_stage_ends_are_the_last_rows_of_the_stages(tmp_path):
    rows = ["time [s],stage,height", "0.0,fill,1", "0.1,fill,2", "0.2,press,3", "0.3,press,4"]
    (tmp_path / "timeseries.csv").write_text("\n".join(rows[:3]) + "\n")
    write_stage_ends(tmp_path)
    assert not (tmp_path / "stages.csv").exists(), "a single stage"
    (tmp_path / "timeseries.csv").write_text("\n".join(rows) + "\n")
    write_stage_ends(tmp_path)
    assert (tmp_path / "stages.csv").read_text().splitlines() == [rows[0], rows[2], rows[4]]


def test_log_records_the_run_until_an_exception_ends_it(tmp_path):
    """The record of a resumed run continues after a line that was cut off."""
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
    with (tmp_path / "run.jsonl").open("a") as file:
        file.write('{"time": "2026')
    with run_log(tmp_path, append=True) as log:
        log.warning("second\x1b[2J")
    assert [(entry.level, entry.text, entry.ended_by) for entry in read_record(tmp_path / "run.jsonl")] == [
        ("WARNING", "list grown", ""),
        ("ERROR", "ended by RuntimeError: it broke", "RuntimeError"),
        ("WARNING", "second\\x1b[2J", ""),
    ]


NUMBERS = {
    "mass_flow.outlet": 0.153, "angle_of_repose.heap": 0.4, "particle_count": 8000,
    "energy_error": float("nan"), "kinetic_energy": 1e-9
}  # fmt: skip


@pytest.mark.parametrize(("quantity", "bound", "sentence", "met"), [
    ("mass_flow.outlet", {"between": (0.1, 0.2)}, "0.153 kg/s, as expected between 0.1 and 0.2 kg/s.", True),
    ("mass_flow.outlet", {"above": 0.2}, "0.153 kg/s, but should be above 0.2 kg/s.", False),
    ("angle_of_repose.heap", {"above": 0.3}, "0.4 rad (22.92 deg), as expected above 0.3 rad.", True),
    ("kinetic_energy", {"below": 1e-8}, "1e-09 J, as expected below 1e-08 J.", True),
    ("particle_count", {"equals": 8000}, "8000, as expected equal to 8000.", True),
    ("particle_count", {"equals": 8001, "tolerance": 0.001}, "8000, as expected equal to 8001 within 0.1 %.", True),
    ("kinetic_energy", {"equals": 1.001e-9, "tolerance": 0.01},
     "1e-09 J, as expected equal to 1.001e-09 J within 1 %.", True),
    ("energy_error", {"below": 1.0}, "nan, but should be below 1.", False),
    ("mass_flow.outlt", {"above": 0}, "not a number of this run; result.json has all of them.", False),
])  # fmt: skip
def test_sentence_states_value_bound_and_result(quantity, bound, sentence, met):
    assert evaluate([expected(quantity, **bound)], NUMBERS) == [(f"{quantity} is {sentence}", met)]
