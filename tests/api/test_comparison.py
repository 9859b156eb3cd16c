"""`granflow compare` of the directories of runs that exist."""

import csv

import pytest
from scene_builders import build_scene, particle_group

from granflow.cli.main import main
from granflow.errors import GranflowError
from granflow.runs.comparison import compare_runs
from granflow.runs.result import Result, write_result


def run_in(folder, friction, energy, force, **more):
    """A directory with the scene and the result of a run."""
    folder.mkdir(parents=True)
    scene = build_scene({"ball": particle_group([0, 0, 0.1])}, pair={"friction": friction}, **more)
    (folder / "scene_as_run.yaml").write_text(scene.to_yaml())
    result = Result(
        run={"simulated_time": 1.0, "wall_clock": energy}, timings={"forces": energy},
        totals={"kinetic_energy": energy, "particle_count": 1.0},
        stages={"run": {"kinetic_energy_mean": 2.0 * energy}}, wall_forces=force,
    )  # fmt: skip
    write_result(folder, result)
    return folder


@pytest.fixture
def runs(tmp_path):
    """Two runs; only the first one measures the force on a wall."""
    return [
        run_in(tmp_path / "a", 0.2, 2.0, {"floor": {"wall_force_z": -3.0}}),
        run_in(tmp_path / "b", 0.3, 3.0, {}, seed=5),
    ]


def test_runs_are_compared_by_the_keys_and_numbers_that_differ(runs, tmp_path, capsys):
    found = compare_runs(runs)
    assert found.names == ("a", "b") and found.remarks == ()
    assert dict(found.keys) == {"pairs.glass-glass.friction": ("0.2", "0.3"), "seed": ("1", "5")}
    differing = {row.name: row for row in found.numbers if row.differs}
    energies = ["kinetic_energy", "kinetic_energy_mean", "kinetic_energy_mean.run"]
    assert list(differing) == [*energies, "wall_force_z.floor"]
    assert differing["kinetic_energy"].values == (2.0, 3.0) and differing["kinetic_energy"].relative(1) == 0.5
    assert found.of_stages == {"kinetic_energy_mean.run"}
    out = tmp_path / "out"
    assert main(["compare", *map(str, runs), "--out", str(out)]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "kinetic_energy J 2 3 (+50 %)" in said and "wall_force_z.floor N -3 –" in said
    assert "2 numbers of 6 are equal in all runs; 1 number of single stages differ" in said
    rows = list(csv.reader((out / "numbers.csv").open()))
    assert rows[0] == ["quantity", "unit", "a", "b"] and ["wall_force_z.floor", "N", "-3.0", ""] in rows
    rows = list(csv.reader((out / "scene.csv").open()))
    assert rows[1:] == [["seed", "1", "5"], ["pairs.glass-glass.friction", "0.2", "0.3"]]


def test_runs_that_cannot_be_compared_are_refused(runs, tmp_path, capsys):
    with pytest.raises(GranflowError, match="is one run: give at least two, or a scene file"):
        compare_runs(runs[:1])
    with pytest.raises(GranflowError, match="A run is given twice"):
        compare_runs([runs[0], tmp_path / "b" / ".." / "a"])
    (runs[1] / "result.json").unlink()
    with pytest.raises(GranflowError, match="b has no result.json: the run is unfinished. Continue it with"):
        compare_runs(runs)
    assert main(["compare", str(runs[0]), "scene.yaml"]) == 2
    assert "scene.yaml is no directory of a run: give one scene file, or" in capsys.readouterr().err
