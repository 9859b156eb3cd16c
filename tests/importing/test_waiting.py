"""Loops of scripts that end on results of the simulation become stages that end on them."""

from math import pi

import pytest
from importing.decks import PACK, imported, liggghts, loaded, write_square

from granflow.importing.language import DeckError
from granflow.units import to_si

LOOP = """fix lid all mesh/surface/stress file square.stl type 1
fix w all wall/gran model hertz tangential history mesh n_meshes 1 meshes lid
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
print "now ${ke}"
if "%s" then "jump %s done"
run 2000
run 500
jump SELF loop
label done
unfix floor
region top block 0.03 0.07 0.03 0.07 0.15 0.18 units box
fix more all insert/rate/region seed 3 distributiontemplate d nparticles 5 particlerate 500 insert_every 1000 %s region top
run 3000"""


def waiting(tmp_path, condition, units="si", file="SELF", start="", insertion=PACK):
    """The translation of a script with a loop, and its scene."""
    write_square(tmp_path / "square.stl", 0.08, (0.01, 0.01), 0.19)
    end = LOOP % (condition, file, start)
    end = end if insertion else end.replace("fix more", "#")
    return imported(tmp_path, liggghts(units, insertion=insertion, end=end))


SMALL = 4.0 / 3.0 * pi * 0.002**3 * 2500.0
"""Mass of the smaller particles [kg]."""


@pytest.mark.parametrize(
    ("condition", "units", "key", "expected"),
    [
        ("${ke} < 1e-6", "si", "until", {"quantity": "kinetic_energy", "below": "1e-06 J"}),
        # 1 erg is 1e-7 J
        ("${ke}<=1e-6", "cgs", "until", {"quantity": "kinetic_energy", "below": "1e-13 J"}),
        ("1e-6 > ${kin}", "si", "until", {"quantity": "kinetic_energy", "below": "1e-06 J"}),
        ("${f} > 2*${low}", "si", "until", {"quantity": "wall_force_z.lid", "above": "0.04 N"}),
        ("${f} < -${low}", "si", "until", {"quantity": "wall_force_z.lid", "below": "-0.02 N"}),
        ("${v} < ${low}", "si", "kinetic_energy_below", f"{0.5 * SMALL * 0.02**2:.6g} J"),
    ],
)
def test_a_loop_becomes_a_stage_that_ends_on_its_condition(tmp_path, condition, units, key, expected):
    """The end of the loop is not known, so that nothing after it has a time."""
    found, scene = waiting(tmp_path, condition, units, "in.deck" if key == "until" else "SELF")
    first, loop, last = scene["stages"]
    assert loop[key] == expected and to_si(loop["max_duration"], "time") == pytest.approx(100 * 2500e-5)
    assert [to_si(each["duration"], "time") for each in (first, last)] == pytest.approx([0.01, 0.03])
    assert scene["particles"]["more_1"]["insert"]["stages"] == ["stage_3"]
    assert scene["walls"]["floor"]["stages"] == ["stage_1", "stage_2"]
    assert found.report.is_complete
    if units == "si":
        loaded(tmp_path, found)


def test_what_a_loop_excludes(tmp_path):
    found, _ = waiting(tmp_path, "${ke} < 1e-6", start="start 9000")
    assert any("a time after a loop of unknown length" in e.sentence for e in found.report.entries)
    with pytest.raises(DeckError, match="the loop waits for particles, but the script inserts none"):
        waiting(tmp_path, "${v} < 1", insertion="")


@pytest.mark.parametrize(
    "condition",
    ["${ke} > 1e-6", "${ke} < ${kin}", "${ke} < 1 && ${f} > 2", "temp < 3", "${vx} < 0.1", "${ke}+1 < 2"],
)
def test_conditions_without_counterpart(tmp_path, condition):
    with pytest.raises(DeckError, match=r"in\.deck:\d+: .*(is a result of the simulation|cannot be decided)"):
        waiting(tmp_path, condition)
