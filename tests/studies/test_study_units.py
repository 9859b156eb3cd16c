"""Units of the values in sweep and calibration files."""

import pytest
from studies.sweep_files import write_sweep
from studies.test_sweep import problems_of, settings, sweep_of

from granflow.errors import FileError
from granflow.studies.sweep import checked_points, read_sweep
from granflow.studies.sweep_design import design_points


@pytest.mark.parametrize(
    ("vary", "words"),
    [
        ("{a: {from: 30 deg, to: 10 deg, count: 2}}", "it must be larger than from, 30 deg."),
        (
            "{a: {from: 10 deg, to: 30, count: 2}}",
            "30 has no unit; give all values in deg, or all in SI units.",
        ),
        ("{a: {from: 10 mm, to: 1 s, count: 2}}", "mm and s are units of different dimensions."),
        ("{a: [10 deg, 20]}", "vary.a is [10 deg, 20], but 20 has no unit"),
        ("{a: {values: [10 deg, 1 s]}}", "deg and s are units of different dimensions."),
    ],
)
def test_values_of_different_dimensions_are_refused(tmp_path, vary, words):
    (problem,) = problems_of(tmp_path, f"scene: spheres.yaml\nvary: {vary}\nread: kinetic_energy\n")
    assert words in problem and problem.startswith("sweep.yaml:2:")


def test_range_with_a_unit_has_the_values_of_a_list_with_this_unit():
    listed = design_points(sweep_of(vary={"wall.angle": ["0 deg", "10 deg", "20 deg", "30 deg"]}))
    ranged = design_points(sweep_of(vary={"wall.angle": {"from": 0, "to": "30 deg", "count": 4}}))
    assert [point.values for point in ranged] == [point.values for point in listed]
    assert [point.settings["wall.angle"] for point in ranged[2:]] == [
        "0.3490658503988659 rad",
        "0.5235987755982988 rad",
    ]


@pytest.mark.parametrize("values", ["[10 mm, 20 mm]", "{from: 10 mm, to: 20 mm, count: 2}"])
def test_unit_of_another_dimension_is_refused_by_the_scene(tmp_path, values):
    """The number 0.01 would be a valid friction."""
    text = f"scene: spheres.yaml\nvary:\n  pairs.steel-steel.friction: {values}\nread: kinetic_energy\n"
    with pytest.raises(
        FileError, match=r"sweep.yaml:3:3: pairs.steel-steel.friction is .*a number without a unit is"
    ):
        checked_points(read_sweep(write_sweep(tmp_path, text)), settings(tmp_path))
