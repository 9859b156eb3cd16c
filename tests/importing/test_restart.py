"""Scripts that continue with the restart file of another one become one scene."""

import pytest
import yaml

from granflow.cli.main import main
from granflow.importing.convert import convert
from granflow.units import to_si

COMMON = """
atom_style granular
boundary f f f
units si
{box}
fix m1 all property/global youngsModulus peratomtype 5e6
fix m2 all property/global poissonsRatio peratomtype 0.45
fix m3 all property/global coefficientRestitution peratomtypepair 1 0.6
fix m4 all property/global coefficientFriction peratomtypepair 1 {friction}
pair_style gran model hertz tangential history
pair_coeff * *
timestep 1e-5
fix g all gravity 9.81 vector 0 0 -1
fix floor all wall/gran model hertz tangential history primitive type 1 zplane 0.0
fix i all nve/sphere
"""
FIRST = """
fix side all wall/gran model hertz tangential history primitive type 1 zcylinder 0.05 0 0
fix p all particletemplate/sphere 15485863 atom_type 1 density constant 2500 radius constant 0.004
fix d all particledistribution/discrete 15485867 1 p 1.0
region fill block -0.02 0.02 -0.02 0.02 0 0.1 units box
fix ins all insert/pack seed 32452843 distributiontemplate d insert_every once region fill particles_in_region 9
restart 1000 post/part.*
run 3000
write_restart post/settled.rst
run 2000
"""
SECOND = """
fix side all wall/gran model hertz tangential history primitive type 1 zcylinder 0.05 0 0 shear z 0.1
run 20000
"""


def scripts(tmp_path, file="post/settled.rst", friction="0.5"):
    """Two scripts, the second of which reads a restart file of the first one."""
    box = "region box block -0.05 0.05 -0.05 0.05 0 0.2 units box\ncreate_box 1 box"
    (tmp_path / "in.fill").write_text(COMMON.format(box=box, friction="0.5") + FIRST)
    text = COMMON.format(box=f"read_restart {file}", friction=friction) + SECOND
    (tmp_path / "in.shear").write_text(text)
    return tmp_path / "in.shear", tmp_path / "in.fill"


def imported(tmp_path, **changes):
    """The translation of both scripts and its scene."""
    second, first = scripts(tmp_path, **changes)
    found = convert(second, after=[first])
    return found, yaml.safe_load(found.text)


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
    found, scene = imported(tmp_path, file=file)
    assert [to_si(each["duration"], "time") for each in scene["stages"]] == pytest.approx([first, 0.2])
    assert next(e.kind for e in found.report.entries if e.command.name == "read_restart") == kind
    assert found.report.is_complete and scene["particles"]["ins"]["count"] == 9


def test_equal_walls_of_both_scripts_are_one_wall(tmp_path):
    """The floor has no stages; the cylinder moves from the begin of the second script on."""
    _, scene = imported(tmp_path)
    assert set(scene["walls"]) == {"floor", "side"}
    assert not any("stages" in wall for wall in scene["walls"].values())
    assert "motion" not in scene["walls"]["floor"]
    assert to_si(scene["walls"]["side"]["motion"]["start"], "time") == pytest.approx(0.03)


def test_contacts_that_differ_are_not_possible(tmp_path):
    found, _ = imported(tmp_path, friction="0.6")
    line = next(e for e in found.report.entries if e.command.where == "in.shear:9")
    assert line.kind == "not possible" and "coefficientFriction that changes at 0.03 s" in line.sentence


def test_a_script_alone_names_the_option(tmp_path):
    found = convert(scripts(tmp_path)[0])
    line = next(e for e in found.report.entries if e.command.name == "read_restart")
    assert line.kind == "not possible" and "--after" in line.sentence


def test_command_line(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    second, first = scripts(tmp_path)
    assert main(["import", str(second), "--after", str(first)]) == 0
    assert "in.shear:5: read_restart" in capsys.readouterr().out
    text = (tmp_path / "shear.yaml").read_text()
    assert "from in.fill and in.shear" in text and "# in.shear:14: fix floor" in text


def test_mesh_that_turns_in_the_second_script_only_is_one_wall(tmp_path):
    """The mesh of the first script is at rest and has no move of the second one, whose mesh has the same name."""
    corners = "".join(f"vertex {x} {y} 0.1\n" for x, y in ((0, 0), (0.02, 0), (0, 0.02)))
    stl = f"solid a\nfacet normal 0 0 1\nouter loop\n{corners}endloop\nendfacet\nendsolid a\n"
    (tmp_path / "lid.stl").write_text(stl)
    mesh = (
        "fix lid all mesh/surface file lid.stl type 1\n"
        "fix w all wall/gran model hertz tangential history mesh n_meshes 1 meshes lid\n"
    )
    second, first = scripts(tmp_path)
    first.write_text(first.read_text().replace("fix p all", f"{mesh}fix p all"))
    move = "fix mv all move/mesh mesh lid rotate origin 0 0 0 axis 0 0 1 period 2\nrun 20000"
    second.write_text(second.read_text().replace("run 20000", f"{mesh}{move}"))
    found = convert(second, after=[first])
    scene = yaml.safe_load(found.text)
    assert set(scene["walls"]) == {"floor", "side", "lid"} and "stages" not in scene["walls"]["lid"]
    assert scene["walls"]["lid"]["motion"]["stages"] == ["stage_2"]
