"""Loops of scripts that end on results of the simulation become stages that end on them."""

from math import pi

import pytest
import yaml

import granflow as gf
from granflow.importing.convert import convert
from granflow.importing.language import DeckError
from granflow.units import to_si

TEXT = """
atom_style granular
boundary f f f
units {units}
region box block -0.05 0.05 -0.05 0.05 0 0.2 units box
create_box 1 box
fix m1 all property/global youngsModulus peratomtype 5e6
fix m2 all property/global poissonsRatio peratomtype 0.45
fix m3 all property/global coefficientRestitution peratomtypepair 1 0.6
fix m4 all property/global coefficientFriction peratomtypepair 1 0.5
pair_style gran model hertz tangential history
pair_coeff * *
timestep 1e-5
fix g all gravity 9.81 vector 0 0 -1
fix lid all mesh/surface/stress file square.stl type 1
fix w all wall/gran model hertz tangential history mesh n_meshes 1 meshes lid
fix floor all wall/gran model hertz tangential history primitive type 1 zplane 0.0
fix p1 all particletemplate/sphere 15485863 atom_type 1 density constant 2500 radius constant 0.004
fix p2 all particletemplate/sphere 15485863 atom_type 1 density constant 2500 radius constant 0.002
fix d all particledistribution/discrete 15485867 2 p1 0.5 p2 0.5
fix ins all insert/pack seed 32452843 distributiontemplate d insert_every once region box particles_in_region 20
fix i all nve/sphere
compute kin all ke
variable kin equal c_kin
variable ke equal ke
variable vx equal vcm(all,x)
variable vy equal vcm(all,y)
variable vz equal vcm(all,z)
variable v equal sqrt(v_vx*v_vx+v_vy^2+v_vz*v_vz)
variable f equal f_lid[3]
variable low equal 0.02
run 1000
label loop
print "now ${{ke}}"
if "{condition}" then "jump {file} done"
run 2000
run 500
jump SELF loop
label done
unfix floor
region top block -0.02 0.02 -0.02 0.02 0.15 0.18 units box
fix more all insert/rate/region seed 32452867 distributiontemplate d nparticles 5 particlerate 500 insert_every 1000 region top
run 3000
"""
SQUARE = "".join(
    "facet normal 0 0 1\nouter loop\n"
    + "".join(f"vertex {x} {y} 0.19\n" for x, y in corners)
    + "endloop\nendfacet\n"
    for corners in (
        ((-0.04, -0.04), (0.04, -0.04), (0.04, 0.04)),
        ((-0.04, -0.04), (0.04, 0.04), (-0.04, 0.04)),
    )
)


def imported(tmp_path, condition, units="si", file="SELF", text=TEXT):
    """The translation of the script, and its scene."""
    (tmp_path / "square.stl").write_text(f"solid a\n{SQUARE}endsolid a\n")
    (tmp_path / "in.wait").write_text(text.format(condition=condition, units=units, file=file))
    found = convert(tmp_path / "in.wait")
    return found, yaml.safe_load(found.text) if found.text else {}


SMALL = 4.0 / 3.0 * pi * 0.002**3 * 2500.0
"""Mass of the smaller particles [kg]."""


@pytest.mark.parametrize(
    ("condition", "units", "key", "expected"),
    [
        ("${ke} < 1e-6", "si", "until", {"quantity": "kinetic_energy", "below": "1e-06 J"}),
        (
            "${ke}<=1e-6",
            "cgs",
            "until",
            {"quantity": "kinetic_energy", "below": "1e-13 J"},
        ),  # 1 erg is 1e-7 J
        ("1e-6 > ${kin}", "si", "until", {"quantity": "kinetic_energy", "below": "1e-06 J"}),
        ("${f} > 2*${low}", "si", "until", {"quantity": "wall_force_z.lid", "above": "0.04 N"}),
        ("${f} < -${low}", "si", "until", {"quantity": "wall_force_z.lid", "below": "-0.02 N"}),
        ("${v} < ${low}", "si", "kinetic_energy_below", f"{0.5 * SMALL * 0.02**2:.6g} J"),
    ],
)
def test_a_loop_becomes_a_stage_that_ends_on_its_condition(tmp_path, condition, units, key, expected):
    found, scene = imported(tmp_path, condition, units)
    first, loop, last = scene["stages"]
    assert loop[key] == expected and to_si(loop["max_duration"], "time") == pytest.approx(100 * 2500e-5)
    assert [to_si(each["duration"], "time") for each in (first, last)] == pytest.approx([0.01, 0.03])
    assert any(
        "ends" in e.sentence and e.kind == "approximated"
        for e in found.report.entries
        if e.command.name == "if"
    )


def test_what_follows_begins_with_its_stage(tmp_path):
    """The end of the loop is not known, so that nothing after it has a time."""
    found, scene = imported(tmp_path, "${ke} < 1e-6", file="in.wait")
    assert scene["particles"]["more"]["insert"]["stages"] == ["stage_3"]
    assert scene["walls"]["floor"]["stages"] == ["stage_1", "stage_2"]
    assert found.report.is_complete
    (tmp_path / "in.yaml").write_text(found.text)
    for name, content in found.files.items():
        (tmp_path / name).write_bytes(content)
    gf.load_scene(tmp_path / "in.yaml")


def test_a_time_within_the_run_after_a_loop_is_not_possible(tmp_path):
    text = TEXT.replace("insert_every 1000 region top", "insert_every 1000 start 9000 region top")
    found, _ = imported(tmp_path, "${ke} < 1e-6", text=text)
    assert any("a time after a loop of unknown length" in e.sentence for e in found.report.entries)


def test_a_loop_without_particles(tmp_path):
    text = "\n".join(line for line in TEXT.splitlines() if "insert" not in line)
    with pytest.raises(
        DeckError, match=r"in\.wait:34: the loop waits for particles, but the script inserts none"
    ):
        imported(tmp_path, "${v} < 1", text=text)


@pytest.mark.parametrize(
    "condition",
    ["${ke} > 1e-6", "${ke} < ${kin}", "${ke} < 1 && ${f} > 2", "temp < 3", "${vx} < 0.1", "${ke}+1 < 2"],
)
def test_conditions_without_counterpart(tmp_path, condition):
    with pytest.raises(DeckError, match=r"in\.wait:35: .*(is a result of the simulation|cannot be decided)"):
        imported(tmp_path, condition)
