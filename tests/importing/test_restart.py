"""Scripts that continue with the restart file of another one become one scene."""

import pytest
import yaml
from importing.decks import WALL, liggghts, write_square

from granflow.cli.main import main
from granflow.importing.convert import convert
from granflow.units import to_si

SIDE = f"fix side all {WALL} primitive type 1 zcylinder 0.05 0.05 0.05"
LID = f"fix lid all mesh/surface file lid.stl type 1\nfix w all {WALL} mesh n_meshes 1 meshes lid\n"
MOVE = "fix mv all move/mesh mesh lid rotate origin 0 0 0 axis 0 0 1 period 2\n"
RUNS = "restart 1000 post/part.*\nrun 3000\nwrite_restart post/settled.rst\nrun 2000"
BOX = "region box block 0 0.1 0 0.1 0 0.2 units box\ncreate_box 2 box"


def scripts(tmp_path, file="post/settled.rst", friction="0.1 0.2 0.2 0.3"):
    """Two scripts, the second of which reads a restart file of the first one."""
    write_square(tmp_path / "lid.stl", level=0.1)
    (tmp_path / "in.fill").write_text(liggghts(end=f"{LID}{SIDE}\n{RUNS}"))
    text = liggghts(insertion="", end=f"{LID}{MOVE}{SIDE} shear z 0.1\nrun 20000").replace(
        BOX, f"read_restart {file}"
    )
    (tmp_path / "in.shear").write_text(text.replace("0.1 0.2 0.2 0.3", friction))
    return tmp_path / "in.shear", tmp_path / "in.fill"


@pytest.mark.parametrize(
    ("file", "first", "kind"),
    [
        ("post/settled.rst", 0.03, "not needed"),
        ("post/part.2000", 0.02, "not needed"),
        ("post/part.1500", 0.05, "approximated"),  # no file of this step
        ("other.rst", 0.05, "approximated"),
    ],
)
def test_the_scene_continues_at_the_step_of_the_file(tmp_path, file, first, kind):
    """Equal walls of both scripts are one wall; the cylinder and the lid move from the begin of the second one on."""
    second, before = scripts(tmp_path, file)
    found = convert(second, after=[before])
    scene = yaml.safe_load(found.text)
    assert [to_si(each["duration"], "time") for each in scene["stages"]] == pytest.approx([first, 0.2])
    assert next(e.kind for e in found.report.entries if e.command.name == "read_restart") == kind
    assert found.report.is_complete and set(scene["particles"]) == {"ins_1", "ins_2"}
    assert set(scene["walls"]) == {"floor", "side", "lid"}
    assert not any("stages" in wall for wall in scene["walls"].values())
    assert "motion" not in scene["walls"]["floor"]
    assert to_si(scene["walls"]["side"]["motion"]["start"], "time") == pytest.approx(first)
    assert scene["walls"]["lid"]["motion"]["stages"] == ["stage_2"]


def test_what_is_not_possible(tmp_path):
    """Contacts that differ, and a script without the one before."""
    second, first = scripts(tmp_path, friction="0.1 0.2 0.2 0.4")
    said = {
        each.sentence for each in convert(second, after=[first]).report.entries if each.kind == "not possible"
    }
    assert any("coefficientFriction that changes at 0.03 s" in each for each in said)
    said = {
        each.command.name: each.sentence
        for each in convert(second).report.entries
        if each.kind == "not possible"
    }
    assert "--after" in said["read_restart"]


def test_command_line(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    second, first = scripts(tmp_path)
    assert main(["import", str(second), "--after", str(first)]) == 0
    assert "from in.fill and in.shear" in (tmp_path / "shear.yaml").read_text()
