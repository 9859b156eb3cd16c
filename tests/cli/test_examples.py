"""`granflow examples` and `granflow example`, in a clone and from a built wheel."""

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

from granflow.cli.main import main
from granflow.scene.reference import json_schema

ROOT = Path(__file__).resolve().parents[2]
SCENES = ROOT / "scenes"


def test_every_shipped_scene_is_listed_with_its_title(capsys):
    assert main(["examples"]) == 0
    lines = capsys.readouterr().out.splitlines()
    names = [path.relative_to(SCENES).with_suffix("").as_posix() for path in SCENES.rglob("*.yaml")]
    assert [line.split()[0] for line in lines] == sorted(names)
    assert any(line.split() == ["hopper", "Conical", "hopper"] for line in lines)


def test_shipped_scenes_and_the_reference_name_no_file_of_a_clone():
    """`granflow example` and `granflow schema` work without a clone: pages of the documentation are named by
    title."""
    texts = {path.name: path.read_text(encoding="utf-8") for path in SCENES.rglob("*.yaml")}
    texts["schema"] = json.dumps(json_schema())
    assert [name for name, text in texts.items() if re.search(r"\b(tools|docs)/", text)] == []


def test_scene_is_copied_with_its_mesh(tmp_path, capsys):
    assert main(["example", "mixer", "--out", str(tmp_path)]) == 0
    for name in ("mixer.yaml", "meshes/stirrer.stl"):
        assert (tmp_path / name).read_bytes() == (SCENES / name).read_bytes()
    assert f"granflow run {tmp_path / 'mixer.yaml'}" in capsys.readouterr().out
    assert main(["example", "mixer.yaml", "--out", str(tmp_path)]) == 0  # equal files may exist


@pytest.mark.parametrize(
    ("name", "files", "command"),
    [
        ("verification/through_flow", {"through_flow.yaml", "through_flow_grid.csv"}, "run"),
        ("sweeps/repose_friction", {"angle_of_repose.yaml"}, "sweep"),
        ("calibration/glass_beads", {"angle_of_repose.yaml", "flat_silo.yaml"}, "calibrate"),
    ],
)
def test_files_that_an_example_needs_are_copied(tmp_path, capsys, name, files, command):
    assert main(["example", name, "--out", str(tmp_path)]) == 0
    assert {path.name for path in tmp_path.iterdir() if path.is_file()} == files
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
    subprocess.run(
        [sys.executable, "-m", "zipfile", "-e", str(wheel), str(tmp_path / "installed")], check=True
    )

    def granflow(*arguments):
        program = (
            f"import sys; sys.path.insert(0, {str(tmp_path / 'installed')!r}); import granflow.cli as cli; "
        )
        program += (
            f"assert cli.__file__.startswith({str(tmp_path)!r}); sys.exit(cli.main({list(arguments)!r}))"
        )
        command = [sys.executable, "-c", program]
        return subprocess.run(command, cwd=tmp_path, check=True, capture_output=True, text=True).stdout

    assert len(granflow("examples").splitlines()) == len(list(SCENES.rglob("*.yaml")))
    granflow("example", "mixer")
    assert "no problems found" in granflow("check", "mixer.yaml")
    files = [path.relative_to(tmp_path / "installed") for path in (tmp_path / "installed").rglob("*.py")]
    assert {path.parts[0] for path in files} == {"granflow"}
