"""`granflow check` and `explain` on the scene of the README."""

import re
from pathlib import Path

import pytest

from granflow.cli.main import main

README = Path(__file__).resolve().parents[2] / "README.md"


@pytest.fixture(autouse=True)
def scene_file(tmp_path, monkeypatch):
    """The first scene of README.md as the file two.yaml of the working directory."""
    monkeypatch.chdir(tmp_path)
    text = re.search(r"```yaml\n(.*?)```", README.read_text(encoding="utf-8"), re.DOTALL)[1]
    Path("two.yaml").write_text(text)
    return Path("two.yaml")


def test_check_counts_warnings_of_the_scene_with_its_overrides(capsys):
    assert main(["check", "two.yaml"]) == 0
    assert capsys.readouterr().out == "two.yaml: no problems found.\n"
    changes = ["--set", "output.interval=1 s", "--set", "materials.steel.density=2.5"]
    assert main(["check", "two.yaml", *changes]) == 0
    output = capsys.readouterr()
    count = int(re.fullmatch(r"two\.yaml: no errors, (\d+) warnings\.\n", output.out)[1])
    assert output.err.count("granflow: warning: ") == count >= 2
    assert "output.interval" in output.err and "is 1 s, but the run lasts at most 0.02 s" in output.err


def test_check_lists_and_counts_the_problems(scene_file, capsys):
    text = scene_file.read_text().replace("friction: 0", "frcition: 0")
    scene_file.write_text(text.replace("duration: 20 ms", "duration: 20 mm"))
    assert main(["check", "two.yaml", "--set", "seed=-1"]) == 2
    output = capsys.readouterr()
    *problems, override, count = output.err.splitlines()
    assert output.out == "" and "seed" in override
    assert len(problems) >= 2 and count == f"{len(problems) + 1} problems found."
    assert all(re.match(r"two\.yaml:\d+:\d+: .*[.?]$", problem) for problem in problems)
    assert "Did you mean friction?" in output.err


def test_explain_prints_the_plan(capsys):
    assert main(["explain", "two.yaml", "--precision", "f32"]) == 0
    output = " ".join(capsys.readouterr().out.split())
    assert output.startswith("Two steel spheres (two.yaml)")
    for fragment in ("friction off", "stability limit", "that this time step can reproduce", "precision f32"):
        assert fragment in output
