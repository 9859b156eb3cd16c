"""`granflow check` and `schema` on real scene files, and the scene of the README."""

import json
import re
from pathlib import Path

import pytest
from plan.scenes import TEXT

from granflow.cli.main import main

README = Path(__file__).resolve().parents[2] / "README.md"


@pytest.fixture(scope="module")
def readme_scene():
    """The first scene of README.md."""
    return re.search(r"```yaml\n(.*?)```", README.read_text(encoding="utf-8"), re.DOTALL)[1]


@pytest.fixture
def scene_file(tmp_path, monkeypatch, readme_scene):
    monkeypatch.chdir(tmp_path)
    path = Path("two.yaml")
    path.write_text(readme_scene)
    return path


def test_scene_of_the_readme_has_no_problems(scene_file, capsys):
    assert main(["check", "two.yaml"]) == 0
    assert capsys.readouterr().out == "two.yaml: no problems found.\n"


def test_warnings_are_counted_and_follow_the_result(scene_file, capsys):
    changes = ["--set", "output.interval=1 s", "--set", "materials.steel.density=2.5"]
    assert main(["check", "two.yaml", *changes]) == 0
    output = capsys.readouterr()
    count = int(re.fullmatch(r"two\.yaml: no errors, (\d+) warnings\.\n", output.out)[1])
    assert output.err.count("granflow: warning: ") == count >= 2
    assert "output.interval" in output.err and "is 1 s, but the run lasts at most 0.02 s" in output.err


@pytest.mark.parametrize("change", ["numerics.time_step_fraction=0.5", "run.time_step=5e-5"])
def test_check_reports_a_restitution_that_the_step_does_not_reach(tmp_path, capsys, change):
    """The message names the key that the scene gives, and a value with which the warning disappears."""
    path = tmp_path / "beads.yaml"
    path.write_text(
        TEXT.replace("restitution: 0.7", "restitution: 0.8").replace("normal: zhou", "normal: hertz")
    )
    assert main(["check", str(path), "--set", "numerics.rayleigh_fraction=1", "--set", change]) == 0
    error = capsys.readouterr().err
    assert "the given restitution is 0.8" in error
    key, value = re.search(r"Use ([a-z_.]+): ([0-9.e-]*[0-9])", error).groups()
    assert key == change.split("=")[0]
    assert main(["check", str(path), "--set", "numerics.rayleigh_fraction=1", "--set", f"{key}={value}"]) == 0
    assert "the given restitution" not in capsys.readouterr().err


def test_problems_are_listed_with_lines_and_counted(scene_file, capsys):
    text = (
        scene_file.read_text()
        .replace("friction: 0", "frcition: 0")
        .replace("duration: 20 ms", "duration: 20 mm")
    )
    scene_file.write_text(text)
    assert main(["check", "two.yaml"]) == 2
    output = capsys.readouterr()
    *problems, count = output.err.splitlines()
    assert output.out == ""
    assert len(problems) >= 2 and count == f"{len(problems)} problems found."
    assert all(re.match(r"two\.yaml:\d+:\d+: .*[.?]$", problem) for problem in problems)
    assert "Did you mean friction?" in output.err


def test_values_set_on_the_command_line_are_checked(scene_file, capsys):
    assert main(["check", "two.yaml", "--set", "run.duration=1 s", "--set", "seed=7"]) == 0
    assert main(["check", "two.yaml", "--set", "run.duration=-1 s"]) == 2
    assert "run.duration" in capsys.readouterr().err


def test_missing_file_is_reported_in_one_sentence(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["check", "nosuch.yaml"]) == 2
    assert capsys.readouterr().err.startswith("nosuch.yaml: ")


def test_schema_is_json_with_the_blocks_of_a_scene(capsys):
    assert main(["schema"]) == 0
    assert {"materials", "particles", "walls", "run"} <= json.loads(capsys.readouterr().out)[
        "properties"
    ].keys()


def test_explain_prints_the_plan(scene_file, capsys):
    assert main(["explain", "two.yaml", "--precision", "f32"]) == 0
    output = capsys.readouterr().out
    assert output.startswith("Two steel spheres (two.yaml)\n")
    for fragment in (
        "friction off",
        "stability limit",
        "smallest value that this time step can reproduce",
        "precision f32",
    ):
        assert fragment in " ".join(output.split())
