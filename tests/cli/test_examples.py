"""`granflow examples` and `granflow example`, in a clone and from a built wheel."""

import subprocess
import sys
from pathlib import Path

import pytest

from granflow.cli.main import main

ROOT = Path(__file__).resolve().parents[2]
SCENES = ROOT / "scenes"


def test_every_shipped_scene_is_listed_with_its_title(capsys):
    assert main(["examples"]) == 0
    lines = capsys.readouterr().out.splitlines()
    names = [path.relative_to(SCENES).with_suffix("").as_posix() for path in SCENES.rglob("*.yaml")]
    assert [line.split()[0] for line in lines] == sorted(names)
    assert any(line.split() == ["hopper", "Conical", "hopper"] for line in lines)


@pytest.mark.parametrize(
    ("name", "files", "command"),
    [
        ("mixer.yaml", {"mixer.yaml", "meshes/stirrer.stl"}, "run"),
        ("verification/through_flow", {"through_flow.yaml", "through_flow_grid.csv"}, "run"),
        ("sweeps/repose_friction", {"angle_of_repose.yaml", "sweeps/repose_friction.yaml"}, "sweep"),
        (
            "calibration/glass_beads",
            {"angle_of_repose.yaml", "flat_silo.yaml", "calibration/glass_beads.yaml"},
            "calibrate",
        ),
    ],
)
def test_an_example_is_copied_with_the_files_that_it_needs(tmp_path, capsys, name, files, command):
    for _ in range(2):  # equal files may exist
        assert main(["example", name, "--out", str(tmp_path)]) == 0
    copies = [path for path in tmp_path.rglob("*") if path.is_file()]
    assert {path.relative_to(tmp_path).as_posix() for path in copies} == files
    assert all(
        any(path.read_bytes() == each.read_bytes() for each in SCENES.rglob(path.name)) for path in copies
    )
    assert f"granflow {command} {tmp_path}" in capsys.readouterr().out


def test_wrong_names_and_changed_files_are_refused(tmp_path, capsys):
    (tmp_path / "hopper.yaml").write_text("title: mine\n")
    assert main(["example", "hopper", "--out", str(tmp_path)]) == 2
    assert "exists with other contents: remove it" in capsys.readouterr().err
    assert (tmp_path / "hopper.yaml").read_text() == "title: mine\n"
    assert main(["example", "hoper", "--out", str(tmp_path)]) == 2
    assert capsys.readouterr().err.endswith("hoper is not one of the shipped scenes. Did you mean hopper?\n")


@pytest.mark.slow
def test_wheel_contains_the_scenes_and_no_tools(tmp_path):
    """The package in a wheel, without the clone, lists all scenes and copies one that passes the check."""
    build = f"from hatchling.build import build_wheel; build_wheel({str(tmp_path)!r})"
    subprocess.run([sys.executable, "-c", build], cwd=ROOT, check=True, capture_output=True)
    (wheel,) = tmp_path.glob("*.whl")
    installed = tmp_path / "installed"
    subprocess.run([sys.executable, "-m", "zipfile", "-e", wheel, installed], check=True)
    assert {path.relative_to(installed).parts[0] for path in installed.rglob("*.py")} == {"granflow"}

    def granflow(*arguments):
        program = f"import sys; sys.path.insert(0, {str(installed)!r}); import granflow.cli as cli; "
        program += f"assert cli.__file__.startswith({str(tmp_path)!r}); sys.exit(cli.main({arguments!r}))"
        command = [sys.executable, "-c", program]
        return subprocess.run(command, cwd=tmp_path, check=True, capture_output=True, text=True).stdout

    assert len(granflow("examples").splitlines()) == len(list(SCENES.rglob("*.yaml")))
    granflow("example", "mixer")
    assert "no problems found" in granflow("check", "mixer.yaml")
