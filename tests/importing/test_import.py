"""Scripts of LIGGGHTS and LAMMPS become scenes: keys and reports of small scripts."""

import json
import re
from math import exp, pi, sqrt
from pathlib import Path

import numpy as np
import pytest
import yaml

import granflow as gf
from granflow.cli.main import main
from granflow.contact.theory import damping_ratio_for
from granflow.importing.collisions import collision, free_restitution, plastic_collision, tsuji
from granflow.importing.convert import all_commands, all_fixes, convert
from granflow.importing.language import DeckError
from granflow.importing.materials import LEAST_RESTITUTION
from granflow.units import to_si

LIGGGHTS = """
atom_style granular
boundary f f f
units {units}
region box block 0 0.1 0 0.1 0 0.2 units box
create_box 2 box
fix m1 all property/global youngsModulus peratomtype 5e6 1e7
fix m2 all property/global poissonsRatio peratomtype 0.45 0.3
fix m3 all property/global coefficientRestitution peratomtypepair 2 0.5 0.6 0.6 0.7
fix m4 all property/global coefficientFriction peratomtypepair 2 0.1 0.2 0.2 0.3
{properties}
pair_style gran {model}
pair_coeff * *
timestep 1e-5
fix g all gravity 9.81 vector 0 0 -1
fix w all wall/gran {wall} primitive type 2 zplane 0.0
fix p1 all particletemplate/sphere 1 atom_type 1 density constant 2500 radius constant 0.002
fix p2 all particletemplate/sphere 1 atom_type 2 density constant 2500 radius constant 0.004
fix d all particledistribution/discrete 1 2 p1 0.25 p2 0.75
{insertion}
fix i all nve/sphere
{end}
"""
HYSTERESIS = """
fix m5 all property/global characteristicVelocity scalar 2
fix m6 all property/global coefficientMaxElasticStiffness peratomtypepair 2 4 4 4 4
fix m7 all property/global coefficientAdhesionStiffness peratomtypepair 2 .2 .2 .2 .2
fix m8 all property/global coefficientPlasticityDepth peratomtypepair 2 .1 .1 .1 .1
"""
PACK = "fix ins all insert/pack seed 1 distributiontemplate d all_in yes region box particles_in_region 50"
HERTZ = "model hertz tangential history"
LAMMPS = """
units si
atom_style sphere
boundary p p f
region box block 0 0.1 0 0.1 0 0.2
create_box 1 box
{model}
timestep 1e-5
fix g all gravity 10 chute 30
fix p all pour 100 1 7 region box diam one 0.004 dens 2500 2500
fix i all nve/sphere
run 100
"""


def liggghts(units="si", properties="", model=HERTZ, wall=None, insertion=PACK, end="run 1000"):
    """A script of LIGGGHTS with some parts replaced."""
    return LIGGGHTS.format(**{**locals(), "wall": wall or model})


def imported(tmp_path, text, **settings):
    """The translation of a script, with its scene as nested dictionaries."""
    path = tmp_path / "in.deck"
    path.write_text(text)
    found = convert(path, **settings)
    return found, yaml.safe_load(found.text) if found.text else {}


def at(scene, path):
    """The value of a key such as run.duration."""
    for key in path.split("."):
        scene = scene[key]
    return scene


def remarks(found, part):
    """Kind and sentence of the lines of the report that contain a text."""
    return [(kind, sentence) for _, line, kind, sentence in found.report.lines() if part in line]


@pytest.mark.parametrize(
    ("parts", "path", "expected"),
    [
        ({}, "contact.normal", "hertz"),
        ({}, "contact.tangential.increments", "displacement"),
        ({"model": f"{HERTZ} tangential_damping off"}, "contact.tangential.damping", None),
        ({}, "pairs.type1-type2", {"restitution": 0.6, "friction": 0.2}),
        ({}, "pairs.type2-type2.friction", 0.3),
        ({}, "materials.type2.young_modulus", "10 MPa"),
        ({"units": "cgs"}, "materials.type2.young_modulus", "1 MPa"),  # 1e7 dyn/cm2
        ({"units": "cgs"}, "materials.type1.density", 2.5e6),
        ({"units": "cgs"}, "domain.max", ["1 mm", "1 mm", "2 mm"]),
        ({"units": "micro"}, "materials.type2.young_modulus", "10 GPa"),  # 1e7 pg/(um us2)
        ({"units": "micro"}, "run.time_step", "0.01 ns"),
        ({}, "domain.on_exit", "delete"),  # LIGGGHTS has no error for lost particles unless it is given
        ({"end": "thermo_modify lost error\nrun 10"}, "domain.on_exit", "error"),
        ({"end": "thermo_modify lost ignore\nrun 10"}, "domain.on_exit", "delete"),
        ({"end": "boundary p f m\nrun 10"}, "domain.periodic", ["x"]),
        ({}, "walls.w.material", "type2"),
        ({}, "walls.w.normal", [0, 0, 1]),
        ({}, "gravity", [0, 0, -9.81]),
        ({"end": "run 100\nrun 500 upto"}, "run.duration", "5 ms"),
        ({"end": "dump d all custom 50 f id\nrun 1000"}, "output.interval", "500 us"),
        ({"end": "thermo 20\nrun 1000"}, "output.timeseries_interval", "200 us"),
        ({"end": "restart 500 f\nrun 1000"}, "output.checkpoint.interval", "5 ms"),
        # Shares by mass: 0.25 and 0.75 of 50 particles, of which type 1 has an eighth of the mass of type 2.
        ({}, "particles.ins_1.count", round(50 * 0.25 / (0.25 + 0.75 / 8))),
        ({}, "particles.ins_2.count", round(50 * (0.75 / 8) / (0.25 + 0.75 / 8))),
        (
            {"insertion": PACK.replace("particles_in_region 50", "volumefraction_region 0.1 vel constant 0 0 -1")},
            "particles.ins_1.velocity",
            [0, 0, -1],
        ),
        (
            {"insertion": PACK.replace("insert/pack", "insert/rate/region").replace(
                "particles_in_region 50", "mass 0.2 massrate 2 start 500")},
            "particles.ins_1.insert.mass_flow",
            "500 g/s",
        ),
        ({"insertion": "fix p1 all particletemplate/sphere 1 atom_type 1 density constant 2500 radius uniform 0.001 0.002\n"
                       "fix d all particledistribution/discrete 1 1 p1 1\n" + PACK},
         "particles.ins.diameter", {"distribution": "uniform", "min": "2 mm", "max": "4 mm"}),
        ({"properties": "fix m5 all property/global characteristicVelocity scalar 2",
          "model": "model hooke tangential history"}, "contact.normal.stiffness.reference_velocity", "2 m/s"),
        ({"properties": "fix m5 all property/global characteristicVelocity scalar 2",
          "model": "model hooke tangential history"}, "materials.type1.poisson_ratio", 0),
        ({"properties": "fix m5 all property/global coefficientRollingFriction peratomtypepair 2 1 2 2 3",
          "model": f"{HERTZ} rolling_friction epsd2", "wall": HERTZ}, "pairs.type1-wall.rolling_friction", 0),
        ({"properties": "fix m5 all property/global coefficientRollingFriction peratomtypepair 2 1 2 2 3",
          "model": f"{HERTZ} rolling_friction cdt"}, "pairs.type1-type2.rolling_friction", 2),
        ({"properties": "fix m5 all property/global cohesionEnergyDensity peratomtypepair 2 1e5 1e5 1e5 2e5",
          "model": f"{HERTZ} cohesion sjkr2"}, "pairs.type2-type2.cohesion_energy_density", "400 kJ/m3"),
        ({"properties": HYSTERESIS, "model": "model hooke/hysteresis tangential history"},
         "contact.normal", {"law": "luding", "stiffness": {"reference_velocity": "2 m/s"},
                            "plasticity_depth": 0.1, "tension": 0.2}),
    ],
)  # fmt: skip
def test_liggghts(tmp_path, parts, path, expected):
    found, scene = imported(tmp_path, liggghts(**parts))
    assert found.code == "liggghts"
    if expected is None:
        assert path.rpartition(".")[2] not in at(scene, path.rpartition(".")[0])
    else:
        assert at(scene, path) == expected


def test_tangential_damping_of_liggghts(tmp_path):
    """gamma_t / gamma_n = sqrt(St / Sn) = sqrt(4 G* / E*), times the damping ratio of LIGGGHTS over granflow's.

    Both codes reach the restitution that is entered, with ratios that differ because granflow cuts the tension.
    """
    _, scene = imported(tmp_path, liggghts())
    stiffness = 2.0 * (1 - 0.45) / (2 - 0.45)  # 4 G* / E* of equal materials
    beta = 0.6931471806 / sqrt(pi**2 + 0.6931471806**2)
    zeta = damping_ratio_for(0.5)
    tangential = scene["contact"]["tangential"]
    assert tangential["damping"] == pytest.approx(sqrt(stiffness) * beta / zeta, rel=1e-3)
    assert tangential["dashpot"] == "sticking"  # LIGGGHTS limits the spring alone


@pytest.mark.parametrize(("e", "result"), [(0.3, 0.397), (0.5, 0.550), (0.9, 0.902)])
def test_restitution_with_limit_force(tmp_path, e, result):
    """The numbers of the guide: integrated collisions, confirmed with LIGGGHTS."""
    text = liggghts(model=f"{HERTZ} limitForce on").replace("0.5 0.6 0.6 0.7", f"{e} 0.6 0.6 0.7")
    _, scene = imported(tmp_path, text)
    assert scene["pairs"]["type1-type1"]["restitution"] == pytest.approx(result, abs=6e-4)


# LAMMPS


def mass(diameter=0.004, density=2500):
    return density * pi / 6 * diameter**3


@pytest.mark.parametrize(
    ("model", "path", "expected"),
    [
        ("pair_style gran/hooke/history 1000 NULL 300 NULL 0.5 1", "contact.normal.stiffness.value", "1 kN/m"),
        ("pair_style gran/hooke/history 1000 800 300 NULL 0.5 1", "contact.tangential.stiffness", "800 N/m"),
        ("pair_style gran/hooke/history 1000 800 300 NULL 0.5 0", "contact.tangential.damping", None),
        ("pair_style gran/hooke/history 1000 800 300 NULL 0.5 1", "pairs.type1-type1.friction", 0.5),
        # Mindlin's ratio kt/kn = 3 (1 - nu) / (2 - nu), kn = 4/3 E*.
        (f"pair_style gran/hertz/history 1e6 {1e6 * 3 * 0.75 / 1.75} 10 NULL 0.5 1", "materials.type1.poisson_ratio", 0.25),
        ("pair_style gran/hertz/history 1e6 1e6 10 NULL 0.5 1", "contact.normal.law", "kuwabara_kono"),
        ("pair_style gran/hooke 1000 NULL 300 NULL 0.5 1", "contact.tangential.law", "sliding_dashpot"),
        ("pair_style gran/hooke 1000 NULL 300 NULL 0.5 0", "contact.tangential", "none"),
        # Of the Poisson ratio 0.5, kt/kn is 1; of 0.25 it is 9/7, and 8 G* = 2 E / ((2 - nu) (1 + nu)).
        ("pair_style gran/hertz/history 1e6 NULL 10 NULL 0.5 1", "contact.tangential.stiffness_factor", 0.285714286),
        ("pair_style granular\npair_coeff * * hertz/material 1e7 0.9 0.25 tangential mindlin 4.375e6 1.0 0.5 damping tsuji",
         "contact.tangential.stiffness_factor", 0.478515625),
        ("pair_style granular\npair_coeff * * hertz/material 1e7 0.9 0.25 tangential mindlin NULL 1.0 0.5 damping tsuji",
         "materials.type1.young_modulus", "10 MPa"),
        ("pair_style granular\npair_coeff * * jkr 1e7 0.9 0.25 0.05 tangential mindlin_rescale NULL 0 0.5 damping tsuji",
         "pairs.type1-type1.work_of_adhesion", "100 mJ/m2"),
        ("pair_style granular\npair_coeff * * hertz/material 1e7 0.9 0.25 tangential mindlin NULL 0 0.5 twisting marshall"
         " damping tsuji", "contact.twisting", "marshall"),
    ],
)  # fmt: skip
def test_lammps(tmp_path, model, path, expected):
    found, scene = imported(tmp_path, LAMMPS.format(model=model))
    assert found.code == "lammps"
    if expected is None:
        assert path.rpartition(".")[2] not in at(scene, path.rpartition(".")[0])
    else:
        assert at(scene, path) == expected


def test_restitution_at_walls_of_models_of_stiffness(tmp_path):
    """A dashpot gamma m* has the damping ratio zeta = gamma sqrt(m*) / (2 sqrt(k)): at a wall m* is twice as large,
    and e = exp(-pi zeta / sqrt(1 - zeta^2))."""
    numbers = {"kn": 1e4, "kt": 5e3, "gamman": 300, "gammat": 0}
    properties = "\n".join(
        f"fix q{name} all property/global {name} peratomtypepair 2 {value} {value} {value} {value}"
        for name, value in numbers.items()
    )
    _, scene = imported(
        tmp_path, liggghts(properties=properties, model="model hooke/stiffness tangential history")
    )
    for pair, effective in (("type1-type1", mass() / 2), ("type1-wall", mass())):
        zeta = 300 * sqrt(effective) / (2 * sqrt(1e4))
        expected = exp(-pi * zeta / sqrt(1 - zeta**2))
        assert scene["pairs"][pair]["restitution"] == pytest.approx(expected, abs=1e-5)


def test_mixed_coefficients_of_granular(tmp_path):
    """Types without a pair_coeff of their own have geometric means; a wall has the same modulus for all."""
    coefficients = "{} hertz/material {} 0.5 0.25 tangential mindlin NULL 1.0 {} {}damping tsuji\n"
    pairs = [("1 1", "1e7", 0.9, "twisting marshall "), ("2 2", "3e7", 0.4, "twisting marshall ")]
    model = "pair_style granular\n" + "".join("pair_coeff " + coefficients.format(*each) for each in pairs)
    wall = f"fix w all wall/gran granular {coefficients.format('', '1e7', 0.5, '')[1:-1]} zplane 0 NULL\n"
    text = LAMMPS.format(model=model).replace("create_box 1", "create_box 2")
    more = "fix q all pour 100 2 7 region box diam one 0.004 dens 2500 2500\n"
    found, scene = imported(tmp_path, text.replace("fix i all", f"{more}{wall}fix i all"))
    assert scene["pairs"]["type1-type2"]["friction"] == pytest.approx(sqrt(0.9 * 0.4))
    assert "pair_coeff" not in remarks(found, "pair_coeff 2 2")[0][1]
    # E* = 10 MPa / 2 (1 - nu^2) in the script, and 1 / (1/30 + 1/10) = 7.5 MPa / (1 - nu^2) of the materials
    (remark,) = (sentence for _, sentence in remarks(found, "fix w"))
    assert "type2 with the wall have 1.5 times" in remark and "twisting marshall acts in all" in remark


def test_gravity_of_a_chute(tmp_path):
    model = "pair_style gran/hooke/history 1000 NULL 300 NULL 0.5 1"
    _, scene = imported(tmp_path, LAMMPS.format(model=model))
    assert scene["gravity"] == pytest.approx([5, 0, -10 * sqrt(0.75)])


def test_restitution_of_a_linear_spring(tmp_path):
    """gran/hooke: m* x'' + m* g x' + k x = 0 ends at zero overlap: e = exp(-g t / 2), t = pi / sqrt(k / m* - g2 / 4)."""
    model = "pair_style gran/hooke/history 1000 NULL 300 NULL 0.5 1"
    _, scene = imported(tmp_path, LAMMPS.format(model=model))
    frequency = sqrt(1000 / (mass() / 2) - 300**2 / 4)
    assert scene["pairs"]["type1-type1"]["restitution"] == pytest.approx(exp(-150 * pi / frequency), abs=1e-5)


def test_restitution_of_tsuji_in_lammps():
    """The guide: an entered 0.9 gives 0.928, and 0.8621 gives 0.9."""
    assert free_restitution(tsuji(0.9) / sqrt(5), False) == pytest.approx(0.928, abs=5e-4)
    assert free_restitution(tsuji(0.8621) / sqrt(5), False) == pytest.approx(0.9, abs=5e-4)
    assert free_restitution(tsuji(0.8593) / sqrt(5), True) == pytest.approx(0.9, abs=5e-4)


@pytest.mark.parametrize(("eta", "restitution"), [("0", 1), ("1e30", LEAST_RESTITUTION)])
def test_extreme_damping_in_lammps(tmp_path, eta, restitution):
    """Without damping a Hertz contact is elastic; with much of it a particle stays on the other."""
    model = f"pair_style granular\npair_coeff * * hertz/material 1e7 {eta} 0.3 tangential mindlin NULL 0 0.5"
    _, scene = imported(tmp_path, LAMMPS.format(model=model))
    assert scene["pairs"]["type1-type1"]["restitution"] == restitution


def test_settings_of_the_printed_table(tmp_path):
    words = "thermo_modify format float %g flush yes lost ignore norm no colname default"
    found, scene = imported(tmp_path, liggghts(end=f"{words}\nthermo_modify norm no\nrun 10"))
    assert scene["domain"]["on_exit"] == "delete"
    assert remarks(found, "thermo_modify norm no") == [("not needed", "settings of the printed table")]


def test_integrated_collision():
    """A linear spring with 2 zeta: the closed form, with and without attraction."""
    for limited in (True, False):
        assert collision(1.0, 0.4, 0.0, limited) == pytest.approx(free_restitution(0.2, limited), abs=1e-3)


@pytest.mark.parametrize("speed", [0.2, 0.5, 0.9])
def test_plastic_collision(speed):
    """Below the limit: loading with k1 = 1 to the overlap u, unloading with k2 = 1 + (r - 1) u: e = 1/sqrt(k2)."""
    assert plastic_collision(speed, 3.0, 0.0) == pytest.approx(1 / sqrt(1 + 2 * speed), abs=2e-3)


def test_dashpot_of_hysteresis_lowers_the_restitution(tmp_path):
    """The plastic spring alone has e = sqrt(k1 / kp) = 0.5 at its limit."""
    parts = {"properties": HYSTERESIS, "model": "model hooke/hysteresis tangential history"}
    _, scene = imported(tmp_path, liggghts(**parts))
    assert scene["pairs"]["type1-type1"]["restitution"] < 0.5


def test_each_size_has_its_restitution_if_the_model_depends_on_it(tmp_path):
    """The dashpot gamma M of a linear spring k has e = exp(-pi z / sqrt(1 - z^2)), z = gamma / 2 sqrt(M / k); M:
    effective mass, of a wall that of the sphere."""
    properties = "fix m5 all property/global kn peratomtypepair 2 2e3 2e3 2e3 2e3\n"
    properties += "fix m6 all property/global kt peratomtypepair 2 1e3 1e3 1e3 1e3\n"
    properties += "fix m7 all property/global gamman peratomtypepair 2 300 300 300 300\n"
    properties += "fix m8 all property/global gammat peratomtypepair 2 100 100 100 100\n"
    script = liggghts(properties=properties, model="model hooke/stiffness tangential history")
    found, scene = imported(tmp_path, script.replace("atom_type 2", "atom_type 1"))
    mass = {f"type1_{d}mm": 2500.0 * pi / 6.0 * (1e-3 * d) ** 3 for d in (4, 8)}
    groups = {each["material"]: each["diameter"] for each in scene["particles"].values()}
    assert groups == {"type1_4mm": "4 mm", "type1_8mm": "8 mm"}
    for key, pair in scene["pairs"].items():
        first, second = (mass.get(each, 1e9) for each in key.split("-"))
        z = 150.0 * sqrt(first * second / (first + second) / 2e3)
        assert pair["restitution"] == pytest.approx(exp(-pi * z / sqrt(1.0 - z**2)), abs=2e-6), key
    assert len(scene["pairs"]) == 5
    assert "depends on the size" not in str(remarks(found, "pair_style"))


@pytest.mark.parametrize(
    ("pair", "wall", "model"),
    [
        ("hertz/history", "primitive type 2 zplane 0.0", "hertz tangential history"),
        ("hertz/history 1 0", "1 0 zplane 0.0 NULL 2", "hertz tangential history"),
        ("hooke/history 3 1", "3 1 zplane 0.0 NULL 2", "hooke tangential history cohesion sjkr rolling_friction cdt"),
        ("hooke 0 0", "0 0 zplane 0.0 NULL 2", "hooke tangential no_history tangential_damping off"),
        ("hertz/history rolling_friction cdt", "primitive type 2 zplane 0.0 rolling_friction cdt",
         "hertz tangential history rolling_friction cdt"),
        ("hertz/history cohesion sjkr", "type 2 zplane 0.0 cohesion sjkr", "hertz tangential history cohesion sjkr"),
    ],
)  # fmt: skip
def test_styles_of_liggghts_1_and_2_are_the_models_of_liggghts_3(tmp_path, pair, wall, model):
    """The equal pairs are those of the tutorials on the syntax of 2.0 and 3.0 in the manual of LIGGGHTS."""
    properties = "fix m5 all property/global characteristicVelocity scalar 2\n"
    properties += "fix m6 all property/global cohesionEnergyDensity peratomtypepair 2 1e4 1e4 1e4 1e4\n"
    properties += "fix m7 all property/global coefficientRollingFriction peratomtypepair 2 .1 .1 .1 .1\n"
    new = liggghts(properties=properties, model=f"model {model}")
    old = re.sub("pair_style.*", f"pair_style gran/{pair}", new)
    old = re.sub("wall/gran .*", f"wall/gran/{pair.split()[0]} {wall}", old)
    assert old != new
    (_, before), (_, after) = (imported(tmp_path, text) for text in (new, old))
    assert after == before


@pytest.mark.parametrize(
    ("what", "steps"),
    [
        *(("fix,g", 1100), ("fix,none", 100), ("region,box", 1100), ("group,all", 1100), ("group,few", 100)),
        *(("variable,q", 1100), ("variable,none", 100), ("compute,c", 100)),
    ],
)
def test_is_defined(tmp_path, what, steps):
    """Whether a fix and so on exists at the line; 1000 steps more if it does."""
    end = f"variable q equal is_defined({what})\nvariable n equal 100+1000*v_q\nrun $n"
    _, scene = imported(tmp_path, liggghts(end=end))
    assert to_si(scene["run"]["duration"], "time") == pytest.approx(1e-5 * steps)


def test_incremental_history_keeps_the_force(tmp_path):
    """The increment of the force is that of the displacement times the present stiffness."""
    _, scene = imported(tmp_path, liggghts(model="model hertz tangential incremental_history"))
    tangential = scene["contact"]["tangential"]
    assert "increments" not in tangential and tangential["unloading"] == "kept"  # the default: force


@pytest.mark.parametrize("wall", ["primitive type 1 zplane 0.0", "mesh n_meshes 1 meshes floor"])
@pytest.mark.parametrize("level", [0.0, -0.05])
def test_refills_stay_above_a_floor(tmp_path, wall, level):
    """particles_in_region of insert/pack counts those that are in the region. LIGGGHTS 3.8.0 has 243, 344, 394 and
    400 particles after the insertions every 60 ms into a region of 20 mm radius and 80 mm height on a floor; in the
    free fall from 1 m/s all leave a region without one."""
    side = 0.03
    corners = [(-side, -side), (side, -side), (side, side), (-side, side)]
    facets = "".join(
        "facet normal 0 0 1\nouter loop\n"
        + "".join(f"vertex {x} {y} {level}\n" for x, y in (corners[0], *corners[k : k + 2]))
        + "endloop\nendfacet\n"
        for k in (1, 2)
    )
    (tmp_path / "floor.stl").write_text(f"solid floor\n{facets}endsolid floor\n")
    floor = "fix floor all mesh/surface file floor.stl type 1\n" if "mesh" in wall else ""
    pack = "region fill cylinder z 0 0 0.02 0 0.08\nfix ins all insert/pack seed 1 distributiontemplate d all_in yes "
    pack += "insert_every 6000 vel constant 0 0 -1 particles_in_region 400 region fill\n"
    pack += f"{floor}fix bottom all wall/gran {HERTZ} {wall.replace('0.0', str(level))}"
    script = liggghts(insertion=pack, end="run 24000\nunfix ins\nrun 100")
    script = re.sub("region box block.*", "region box block -0.03 0.03 -0.03 0.03 -0.06 0.1", script)
    script = re.sub(
        "radius constant .*", "radius constant 0.003", script.replace("2 p1 0.25 p2 0.75", "1 p1 1")
    )
    script = re.sub("fix w all.*", "", script)
    _, scene = imported(tmp_path, re.sub("timestep.*", "timestep 1e-5", script))
    counts = [group["count"] for group in scene["particles"].values()]
    if level:
        assert counts[1:] == [counts[1]] * 3 and counts[1] > 0.95 * counts[0]
    else:
        assert sum(counts) == 400
        assert np.cumsum(counts)[:2] == pytest.approx([243, 344], rel=0.1)


def test_pour_enters_at_the_lower_end_of_its_region(tmp_path):
    """A fall of 50 mm from 2 m/s takes (sqrt(4 + 1) - 2) / 10 s = 23.6 ms and ends with sqrt(5) m/s.

    LAMMPS counts the steps of this time with the step at the line of the fix: 2361 steps of 10 us are 4.72 ms
    later with 2 us. LAMMPS takes at least one unit of length, 1 m, along y, so that a batch has
    0.001 20 mm x 1 m x 50 mm / (pi/6 (4 mm)3) = 29 particles.
    """
    model = "pair_style gran/hooke/history 1000 NULL 300 NULL 0.5 1"
    source = "region s block 0.04 0.06 0.04 0.06 0.1 0.15\nfix p all pour 1000 1 7 region s diam one 0.004 "
    source += "dens 2500 2500 vel 0.1 0.3 0 0 -2 vol 0.001 50"
    for count, change, rate in (
        (200, "", 29 / 0.02361),
        (200, "timestep 2e-6", 29 / 4.722e-3),
        (20, "", 20 / 0.023607),
    ):
        text = LAMMPS.format(model=model).replace("spherical 0 150", "vector 0 0 -1")
        text = text.replace(
            "fix p all pour 100 1 7 region box diam one 0.004 dens 2500 2500", f"{source}\n{change}"
        )
        text = text.replace("pour 1000", f"pour {count}").replace("run 100\n", "run 20000\n")
        found, scene = imported(tmp_path, text)
        group = scene["particles"]["p"]
        assert group["velocity"][0] == "200 mm/s" and group["count"] == min(count, 174)
        if count == 200:  # six batches, and the rest in the time of one
            rest = scene["particles"]["p_2"]
            assert rest["count"] == 26
            assert to_si(rest["insert"]["start"], "time") == pytest.approx(6 * 29 / rate, rel=1e-3)
            assert float(rest["insert"]["rate"].split()[0]) == pytest.approx(26 * rate / 29, rel=1e-3)
        assert float(group["velocity"][2].split()[0]) == pytest.approx(-sqrt(5.0))
        assert group["insert"]["kind"] == "inlet"
        assert float(group["insert"]["rate"].split()[0]) == pytest.approx(rate, rel=1e-3)
        corner = [float(each.split()[0]) for each in group["insert"]["face"]["rectangle"]["corner"]]
        assert corner == pytest.approx([38, 38, 102])  # centers in the region: a radius wider and above
        assert ("with the time step at the line of the fix" in remarks(found, "fix p")[0][1]) is bool(change)


@pytest.mark.parametrize(
    ("region", "options", "sizes", "counts"),
    [
        ("block 0.025 0.075 0.025 0.075 0.1 0.15", "diam one 0.004 vol 0.1 5", "4 mm",
         (479, 577, 490, 527, 496, 503, 516, 548)),
        ("cylinder z 0.05 0.05 0.02 0.06 0.12", "diam poly 2 0.004 0.6 0.003 0.4 vol 0.3 50", None,
         (331, 334, 408, 370, 407, 338, 311, 303)),
        ("block 0.025 0.075 0.03 0.07 0.1 0.15", "diam range 0.003 0.005 vol 0.02 50", None,
         (352, 341, 361, 311, 338, 398, 349, 406)),
    ],
)  # fmt: skip
def test_batches_of_pour_that_do_not_fit_are_those_of_lammps(tmp_path, region, options, sizes, counts):
    """The first batch of LAMMPS 29 Sep 2021 with eight seeds. The means of 8 and of 4 batches, with a standard
    deviation of 11 % each, differ by less than 3 x 0.11 sqrt(1/8 + 1/4) = 0.2."""
    text = LAMMPS.format(model="pair_style gran/hooke/history 1000 NULL 300 NULL 0.5 1")
    text = text.replace("chute 30", "vector 0 0 -1").replace("run 100\n", "run 60000\n")
    source = f"region s {region}\nfix p all pour 10000 1 7 region s dens 2500 2500 {options}"
    found, scene = imported(tmp_path, re.sub("fix p all pour.*", source, text))
    (sentence,) = (each for _, each in remarks(found, "fix p") if "gives up to place" in each)
    batch = int(sentence.split("a batch has about ")[1].split()[0])
    assert batch == pytest.approx(np.mean(counts), rel=0.2)
    assert sizes in (None, scene["particles"]["p"]["diameter"])
    fall = sqrt(2.0 * (0.06 if "cylinder" in region else 0.05) / 10.0)
    first = [each["insert"] for each in scene["particles"].values() if "start" not in each["insert"]]
    rate = sum(float(each["rate"].split()[0]) for each in first)  # of a group for each size
    assert rate == pytest.approx(batch / fall, rel=0.03)


@pytest.mark.parametrize(
    ("between", "count", "end"), [("", 58, None), ("fix g all gravity 10 vector 0 0 -1\nfix h all gravity 1 vector 1 0 0", 174, "30 ms")]
)  # fmt: skip
def test_batches_of_pour_that_have_appeared_fall_after_unfix(tmp_path, between, count, end):
    """Batches of 29 particles appear every 23.61 ms, the second before the end of the first run at 30 ms. If a stage
    begins then, what is still in the region is left out."""
    model = "pair_style gran/hooke/history 1000 NULL 300 NULL 0.5 1"
    text = LAMMPS.format(model=model).replace("chute 30", "vector 0 0 -1")
    source = "region s block 0.04 0.06 0.04 0.06 0.1 0.15\nfix p all pour 200 1 7 region s diam one 0.004 dens 2500 2500"
    text = re.sub("fix p all pour.*", f"{source} vel 0 0 0 0 -2 vol 0.001 50", text)
    text = text.replace("run 100\n", f"run 3000\nunfix p\n{between}\nrun 30000\n")
    _, scene = imported(tmp_path, text)
    group = scene["particles"]["p"]
    assert (group["count"], group["insert"].get("end")) == (count, end)


# Reports and errors


def test_particles_that_no_fix_integrates_are_told(tmp_path):
    script = liggghts()
    without, _ = imported(tmp_path, script.replace("fix i all nve/sphere\n", ""))
    ((kind, sentence),) = remarks(without, "run 1000")
    assert kind == "approximated" and sentence.startswith("no fix such as nve/sphere integrates")
    assert "no fix such as" not in str(remarks(imported(tmp_path, script)[0], "run 1000"))


def test_every_line_has_a_remark(tmp_path):
    found, _ = imported(tmp_path, liggghts())
    assert len(list(found.report.lines())) == liggghts().count("\n") - 2  # the empty first and third lines
    end = 'shell mkdir post\nvariable n equal 5\nif "$n > 4" then "run $n" else "run 1"\nrun 5 upto'
    assert found.report.is_complete
    found, _ = imported(tmp_path, liggghts(end=end))
    assert found.report.is_complete
    assert remarks(found, "mkdir") == [("not needed", "granflow makes the folders of its output")]
    assert remarks(found, "variable n")[0][1] == "executed: the scene has the result"
    assert [sentence for _, sentence in remarks(found, "run")][-1] == "it has no steps"
    kind, sentence = remarks(found, "m4 all")[0]
    assert (kind, sentence) == ("translated", "pairs.NAME.friction")


@pytest.mark.parametrize(
    ("end", "part", "sentence"),
    [
        ("fix h all heat/gran/radiation\nrun 10", "radiation", "radiation between particles; nearest"),
        ("fix h all wonder 1\nrun 10", "wonder", "fix wonder is not known"),
        ("marvel 1\nrun 10", "marvel", "the command marvel is not known"),
        (
            "variable n equal atoms\nfix g all gravity v_n vector 0 0 1\nrun 10",
            "v_n",
            "gravity that follows the simulation",
        ),
        ("compute c all rainbow\nrun 10", "rainbow", "compute rainbow"),
        ("shell python x\nrun 10", "shell", "shell runs another program"),
        ("run 10\nclear\nunits si", "clear", "a second simulation"),
        (
            "fix w2 all wall/grann model hertz\nrun 10",
            "wall/grann",
            "fix wall/grann is not known; nearest: wall/gran",
        ),
        ("fix x all property/global thermalExpansion peratomtype 1 1\nrun 10", "thermalExpansion", "thermal"),
    ],
)
def test_not_possible(tmp_path, end, part, sentence):
    found, _ = imported(tmp_path, liggghts(end=end))
    kind, given = remarks(found, part)[0]
    assert kind == "not possible" and sentence in given


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("timestep 1e-5", "timestep fast", "in.deck:14: the time step is fast, which is not a number"),
        (
            "timestep 1e-5",
            "timestep v_dt",
            "the time step is v_dt, but it cannot change during a run; give ${dt}.",
        ),
        ("gravity 9.81", "gravity v_g", "in.deck:15: there is no variable g; define it before this line."),
        ("timestep 1e-5", "timestep -1", "in.deck:14: the time step is -1; give a time above 0"),
        ("5e6 1e7", "5e6", "youngsModulus has no number for type 2"),
        ("0.45 0.3", "0.45 1.3", "poissonsRatio has the number 1.3; give one from 0 to 0.5"),
        ("fix m3", "#", "needs fix property/global coefficientRestitution"),
        ("0.1 0.2 0.2 0.3", "0.1 0.2 0.3 0.3", "not symmetric: types 1 and 2"),
        ("region box part", "region no part", "there is no region no. Regions: box"),
        ("model hertz", "modle hertz", "contact models have no keyword modle. Did you mean model?"),
        ("all_in yes", "allin yes", "insert/pack has no keyword allin. Did you mean all_in?"),
        (
            "distributiontemplate d",
            "distributiontemplate e",
            "there is no fix particledistribution/discrete e",
        ),
        ("run 1000", "unfix x", "there is no fix x to unfix"),
        ("run 1000", "", "the script has no run"),
        ("radius constant 0.002", "radius constant", "the radius is missing at the end"),
        ("primitive type 2", "primitive type 1.5", "the type is 1.5; give a whole number"),
        (
            "primitive type 2",
            "primitive type 3",
            "in.deck:16: the type is 3, but the box is made for the types 1 to 2",
        ),
        ("run 1000", "run -5", "the number of steps is -5; give one of at least 0"),
        ("fix i all", "fix i moving", "in.deck:21: there is no group moving. Groups: all."),
        ("run 1000", "group a tipe 1", "groups have no style tipe; they have region, type, id,"),
        ("2 p1 0.25 p2", "2 p1 0.25 p3", "there is no particle template p3. Templates: p1, p2."),
        (
            "particles_in_region 50",
            "volumefraction_region 1.5",
            "the volume fraction is 1.5; give one below 1",
        ),
        (
            "primitive type 2 zplane 0.0",
            "mesh n_meshes 2 meshes a",
            "n_meshes is 2, but fewer names follow (meshes a)",
        ),
        (
            "primitive type 2 zplane 0.0",
            "mesh n_meshes 1 meshes a",
            "there is no fix mesh/surface a. Meshes: none.",
        ),
        (
            "primitive type 2 zplane 0.0",
            "mesh nmeshes 1 meshes a",
            "are missing before the unknown keyword nmeshes",
        ),
    ],
)
def test_errors(tmp_path, old, new, message):
    assert old in liggghts()
    with pytest.raises(gf.GranflowError) as caught:
        imported(tmp_path, liggghts().replace(old, new))
    assert message in str(caught.value)


def test_heat(tmp_path):
    """LIGGGHTS conducts 2 k sqrt(2 pi R d) where granflow conducts 2 k a, a = sqrt(R d)."""
    properties = (
        "fix h1 all property/global thermalConductivity peratomtype 100 50\n"
        "fix h2 all property/global thermalCapacity peratomtype 10 20\n"
        "fix h3 all heat/gran initial_temperature 300"
    )
    text = liggghts(properties=properties).replace("zplane 0.0", "zplane 0.0 temperature 400")
    found, scene = imported(tmp_path, text)
    assert found.report.is_complete and scene["contact"]["heat"] == "conduction"
    assert (
        scene["particles"]["ins_1"]["temperature"] == "300 K"
        and scene["walls"]["w"]["temperature"] == "400 K"
    )
    material = scene["materials"]["type2"]
    assert material["heat_capacity"] == "20 J/kg/K"
    assert float(material["thermal_conductivity"].split()[0]) == pytest.approx(50 * sqrt(2 * pi))


def test_material_that_conducts_no_heat(tmp_path):
    """A scene needs a conductivity above 0; that of the importer is 3e7 times smaller than that of still air."""
    properties = (
        "fix h1 all property/global thermalConductivity peratomtype 0 50\n"
        "fix h2 all property/global thermalCapacity peratomtype 10 20\n"
        "fix h3 all heat/gran initial_temperature 300"
    )
    found, scene = imported(tmp_path, liggghts(properties=properties))
    assert scene["materials"]["type1"]["thermal_conductivity"] == "1e-09 W/m/K"
    kind, sentence = remarks(found, "thermalConductivity")[0]
    assert kind == "approximated" and "type1 has the conductivity 1e-09 W/m/K in place of 0" in sentence
    (tmp_path / "scene.yaml").write_text(found.text)
    gf.load_scene(tmp_path / "scene.yaml")


BRIDGES = """fix l1 all property/global surfaceLiquidContentInitial scalar 0.002
fix l2 all property/global surfaceTension scalar 0.072
fix l3 all property/global fluidViscosity scalar 1e-3
fix l4 all property/global contactAngle peratomtype 0.5 0.4
fix l5 all property/global minSeparationDistanceRatio scalar 1.01
fix l6 all property/global maxSeparationDistanceRatio scalar 1.1"""


def test_liquid_bridges(tmp_path):
    """Soulie's force at contact, with V = 4/3 pi c (1 - sqrt(3/4)) R^3 and the contact angle 0, over pi g R:
    exp(0.48 - 0.0082 ln V) + 0.078 + 0.0018 ln V = 1.774; Willett's is 2."""
    model = f"{HERTZ} cohesion easo/capillary/viscous"
    found, scene = imported(tmp_path, liggghts(properties=BRIDGES, model=model))
    assert found.report.is_complete
    viscous = {"viscosity": "0.001 Pa s", "min_separation_ratio": 1}
    # Twice the largest bridge of equal spheres, whose films give (1 - sqrt(3/4)) / 2 each.
    volume = to_si(scene["contact"]["cohesion"].pop("max_bridge_volume"), "volume")
    assert volume == pytest.approx(2 * 0.002 * (1 - sqrt(0.75)) * 4 / 3 * pi * 0.004**3, rel=1e-5)
    assert scene["contact"]["cohesion"] == {"law": "capillary_transfer", "viscous_force": viscous}
    assert all(group["liquid_content"] == 0.002 for group in scene["particles"].values())
    assert scene["pairs"]["type1-type2"]["contact_angle"] == pytest.approx(0.45)
    (remark,) = {sentence for _, sentence in remarks(found, "pair_style")}
    assert (
        "1.13 times as large" in remark and "instead of 1.01 R*" in remark and "in the script R/2" in remark
    )
    assert "rupture" not in remark
    for name, content in found.files.items():
        (tmp_path / name).write_bytes(content)
    (tmp_path / "scene.yaml").write_text(found.text)
    gf.load_scene(tmp_path / "scene.yaml")
    near = BRIDGES.replace("scalar 1.1", "scalar 1.02").replace("scalar 0.002", "scalar 0")
    found, _ = imported(tmp_path, liggghts(properties=near, model=model))
    (remark,) = {sentence for _, sentence in remarks(found, "pair_style")}
    assert "films with a content of 1e-6" in remark and "rupture" not in remark, "without liquid"
    found, _ = imported(
        tmp_path, liggghts(properties=BRIDGES.replace("scalar 1.1", "scalar 1.02"), model=model)
    )
    # (1 + angle / 2) V^(1/3) with the larger angle; (1.02 - 1) 2 R
    distance = 1.25 * (4 / 3 * pi * 0.002 * (1 - sqrt(0.75))) ** (1 / 3)
    sentence = f"rupture at a distance of {distance:.3g} R, in the script at 0.04 R"
    assert any(kind == "approximated" and sentence in each for kind, each in remarks(found, "fix"))


def test_box_of_which_one_side_grows(tmp_path):
    """boundary p p fm: the upper end is enlarged by the size of the box, and the lower one deletes."""
    head = LAMMPS.format(model="pair_style gran/hooke/history 1000 NULL 300 NULL 0.5 1")
    head = head.replace("boundary p p f", "boundary p p fm").replace(
        "run 100", "thermo_modify lost ignore\nrun 100"
    )
    found, scene = imported(tmp_path, head)
    assert scene["domain"]["on_exit"] == "delete" and scene["domain"]["min"] == [0, 0, 0]
    assert scene["domain"]["max"] == ["100 mm", "100 mm", "400 mm"]
    assert "zhi is enlarged" in remarks(found, "boundary")[0][1]


HEAT = (
    "fix h1 all property/global thermalConductivity peratomtype 100 50\n"
    "fix h2 all property/global thermalCapacity peratomtype 10 20\n"
)


def test_heat_without_particles_and_walls(tmp_path):
    """A script of which the importer knows no insertion, and which has no wall, is reported."""
    text = liggghts(
        properties=f"{HEAT}fix h3 all heat/gran initial_temperature 300", insertion="fix i all wonder"
    )
    text = "\n".join(line for line in text.splitlines() if "wall/gran" not in line)
    found, _ = imported(tmp_path, text)
    assert remarks(found, "wonder")[0][0] == "not possible"


def test_temperatures_and_sources_between_runs_are_settings_of_stages(tmp_path):
    """A half space, a box to the end of the domain, a type, a union; a fix heat/gran that begins later."""
    end = """run 100
fix h3 all heat/gran initial_temperature 300
region ball sphere 0.05 0.05 0.05 0.01
region left block INF 0.02 INF INF INF INF
region slab block INF 0.02 EDGE 0.05 INF INF
region both union 2 left ball
set region left property/atom Temp 800
set type 2 property/atom Temp 500
run 50
set region slab property/atom heatSource -1.5
set region both property/atom Temp 400
group hot region ball
set group hot property/atom Temp 450
run 50"""
    found, scene = imported(tmp_path, liggghts(properties=HEAT, end=end))
    half = {"half_space": {"point": ["20 mm", 0, 0], "normal": [-1, 0, 0]}}
    ball = {"sphere": {"center": ["50 mm", "50 mm", "50 mm"], "radius": "10 mm"}}
    slab = {"box": {"min": ["-1 m", 0, "-2 m"], "max": ["20 mm", "50 mm", "2.2 m"]}}
    first, second, third = scene["stages"]
    assert found.report.is_complete and "set" not in first
    assert second["set"] == [
        {"temperature": "300 K"},
        {"temperature": "800 K", "region": half},
        {"temperature": "500 K", "groups": ["ins_2"]},
    ]
    assert third["set"] == [
        {"heat_source": "-1.5 W", "region": slab},
        {"temperature": "400 K", "region": half},
        {"temperature": "400 K", "region": ball},
        {"temperature": "450 K", "region": ball},
    ]


@pytest.mark.parametrize(
    ("end", "fragment", "sentence"),
    [
        ("run 1\nset atom 3 property/atom Temp 9\nrun 1", "atom 3", "values for atom 3; nearest: set region"),
        (
            "run 1\nset type 1 property/atom charge 9\nrun 1",
            "charge",
            "the property charge; nearest: one of Temp",
        ),
        (
            "group g type 1\nrun 1\nset group g property/atom Temp 9\nrun 1",
            "set group g",
            "values for group g; near",
        ),
        (
            "set group all property/atom Temp 9\nrun 1",
            "Temp 9",
            "the box has no particles yet, so that it changes none",
        ),
        ("run 1\nset group all property/atom Temp 9", "Temp 9", "no run follows"),
        (
            "fix s all property/atom heatSource scalar yes no no 0.5\nrun 1",
            "heatSource",
            "particles.NAME.heat_source",
        ),
    ],
)
def test_settings_that_have_no_effect_or_no_counterpart(tmp_path, end, fragment, sentence):
    text = liggghts(properties=f"{HEAT}fix h3 all heat/gran initial_temperature 300", end=end)
    found, scene = imported(tmp_path, text)
    assert any(sentence in each for _, each in remarks(found, fragment)), remarks(found, fragment)
    assert "stages" not in scene or all("set" not in stage for stage in scene["stages"])


def test_names_with_capitals_and_of_two_cases(tmp_path):
    """Names of a scene have small letters; two names that differ by their case remain two."""
    second = PACK.replace("fix ins", "fix INS").replace("seed 1", "seed 2")
    walls = f"{second}\nfix W.2 all wall/gran {HERTZ} primitive type 2 xplane 0.0\nrun 10"
    found, scene = imported(tmp_path, liggghts(end=f"{walls}"))
    assert set(scene["particles"]) == {"ins_1", "ins_2", "ins_1_2", "ins_2_2"}
    assert set(scene["walls"]) == {"w", "w_2"}
    assert "particles.ins_1_2" in remarks(found, "fix INS")[0][1]


def test_modulus_of_the_model_hooke(tmp_path):
    """The line of the modulus says where the number of the scene is from: 5 MPa / (1 - 0.45^2)."""
    properties = "fix m5 all property/global characteristicVelocity scalar 2"
    found, scene = imported(tmp_path, liggghts(properties=properties, model="model hooke tangential history"))
    assert scene["materials"]["type1"] == {
        "young_modulus": "6.26959247649 MPa",
        "poisson_ratio": 0,
        "density": 2500,
    }
    for line in ("youngsModulus", "poissonsRatio"):
        sentence = remarks(found, line)[0][1]
        assert "E / (1 - nu^2) with the Poisson ratio 0" in sentence and "type 1: 6.26959e+06 Pa" in sentence


def test_random_particles_in_a_sheared_box(tmp_path):
    """Two calls have different points, all in their region; a drag is refused together with the shear."""
    head = LAMMPS.format(model="pair_style gran/hooke/history 1000 NULL 300 NULL 0.5 1")
    atoms = """region c cylinder z 0.05 0.05 0.03 0.05 0.15
create_atoms 1 random 20 1 c
create_atoms 1 random 20 2 c
set group all diameter 0.004 density 2500
fix v all viscous 1e-3
fix s all deform 1 xy erate 2 remap v"""
    text = head.replace("fix p all pour 100 1 7 region box diam one 0.004 dens 2500 2500", atoms)
    found, scene = imported(tmp_path, text.replace("boundary p p f", "boundary p p p"))
    rows = [list(map(float, row.split(","))) for row in found.files["type1.csv"].decode().splitlines()[1:]]
    assert len({tuple(row) for row in rows}) == 40 and "start_type1" in scene["particles"]
    assert all((x - 0.05) ** 2 + (y - 0.05) ** 2 < 0.03**2 and 0.05 < z < 0.15 for x, y, z, _ in rows)
    assert remarks(found, "viscous")[0][0] == "not possible" and "damping" not in scene


RANDOM = """create_atoms 1 random {} 20 c
set group all diameter 0.004 density 2500
set group all density 2500
velocity all create 4e14 12 dist {}
minimize 1e-4 1e-4 10 10
fix l all nve/limit 1e-4"""


@pytest.mark.parametrize(("count", "is_packed"), [(2, False), (400, True)])
def test_random_particles_that_overlap_become_a_packing(tmp_path, count, is_packed):
    """400 spheres of 4 mm in 283 cm3 overlap, two do not. The sum of m v^2 is 3 N - 3 times k T."""
    head = LAMMPS.format(model="pair_style gran/hooke/history 1000 NULL 300 NULL 0.5 1")
    region = "region c cylinder z 0.05 0.05 0.03 0.05 0.15\n"
    text = head.replace(
        "fix p all pour 100 1 7 region box diam one 0.004 dens 2500 2500",
        region + RANDOM.format(count, "gaussian"),
    )
    found, scene = imported(tmp_path, text)
    (group,) = scene["particles"].values()
    assert (group["insert"]["kind"] == "pack") is is_packed
    mass, wanted = 2500 * pi / 6 * 0.004**3, (3 * count - 3) * 1.380649e-23 * 4e14
    if is_packed:
        assert group["count"] == 400 and group["diameter"] == "4 mm"
        cylinder = group["insert"]["region"]["cylinder"]
        assert cylinder["radius"] == "32 mm"  # centers in the region
        speed = to_si(group["thermal"]["velocity_rms"], "velocity")
        assert "velocity" not in group
    else:
        rows = np.array([row.split(",") for row in found.files["type1.csv"].decode().splitlines()[1:]], float)
        assert np.abs(rows[:, 4:7].sum(axis=0)).max() < 1e-9 * np.abs(rows[:, 4:7]).max()
        speed = np.sqrt((rows[:, 4:7] ** 2).sum() / count)
    assert count * mass * speed**2 == pytest.approx(wanted, rel=1e-5)
    assert remarks(found, "minimize")[0][1] == "the random particles are placed without overlap"
    assert found.report.is_complete


def test_runs_that_separate_random_particles_are_left_out(tmp_path):
    """What follows them is the start: their drag has ended, and velocities can be set."""
    head = LAMMPS.format(model="pair_style gran/hooke/history 1000 NULL 300 NULL 0.5 1")
    atoms = (
        "create_atoms 1 random 400 20 box\nset type 1 diameter 0.005 density 2500\nfix l all nve/limit 1e-4\n"
        "fix v all viscous 0.1\nrun 500\nunfix l\nunfix v\nvelocity all set 0.1 0 0"
    )
    text = head.replace("fix p all pour 100 1 7 region box diam one 0.004 dens 2500 2500", atoms)
    found, scene = imported(tmp_path, text)
    assert found.report.is_complete and "damping" not in scene and scene["run"]["duration"] == "1 ms"
    (group,) = scene["particles"].values()
    assert group["velocity"] == ["100 mm/s", 0, 0] and group["insert"]["kind"] == "pack"
    assert "separates random particles" in remarks(found, "run 500")[0][1]


def test_gravity_that_changes_is_that_of_a_stage(tmp_path):
    """Three runs: another gravity from the second one on, none in the third."""
    text = "run 10\nfix g all gravity 5 vector 1 0 0\nrun 20\nrun 5\nunfix g\nrun 30"
    found, scene = imported(tmp_path, liggghts(end=text))
    assert remarks(found, "vector 1 0 0")[0] == ("translated", "stages.NAME.gravity")
    assert scene["gravity"] == [0, 0, -9.81]
    assert scene["stages"] == [
        {"name": "stage_1", "duration": "100 us"},
        {"name": "stage_2", "duration": "250 us", "gravity": [5, 0, 0]},
        {"name": "stage_3", "duration": "300 us", "gravity": [0, 0, 0]},
    ]


def test_gravity_of_variables_is_a_table(tmp_path):
    """The box tilts by 30 degrees in 0.01 s; the second run has gravity of a constant variable."""
    before = "variable t equal 30*elapsed*dt/0.01\nvariable m equal 9.81\nfix g all gravity v_m chute v_t\n"
    after = "\nfix g all gravity v_m vector 0 0 -1\nrun 1000"
    _, scene = imported(tmp_path, liggghts(end=f"{before}run 1000{after}"))
    times, vectors = (np.array(scene["gravity"][name]) for name in ("times", "vectors"))
    assert (times[0], times[-1]) == (0.0, 0.01)
    angle = np.radians(3000.0 * times)
    assert vectors == pytest.approx(9.81 * np.stack([np.sin(angle), 0 * angle, -np.cos(angle)], axis=1))
    assert scene["stages"][1]["gravity"] == [0, 0, -9.81]
    gf.Scene.from_dict(scene)


def test_gravity_of_two_fixes_is_their_sum(tmp_path):
    """Both codes add the forces; a keyword behind the direction is refused."""
    text = (
        "fix h all gravity 5 vector 1 0 0\nrun 10\nunfix g\nfix k all gravity 1 vector 0 1 0 disable\nrun 10"
    )
    found, scene = imported(tmp_path, liggghts(end=text))
    assert scene["gravity"] == [5, 0, -9.81]
    assert scene["stages"][1]["gravity"] == [5, 1, 0]
    assert remarks(found, "disable")[0][0] == "not possible"


ABOVE = {"half_space": {"point": [0, 0, "50 mm"], "normal": [0, 0, 1]}}
RADIUS = "compute 1 all property/atom radius\nvariable up atom {}\ngroup g dynamic all var up every {}\n"


@pytest.mark.parametrize(
    ("before", "command", "expected"),
    [
        ("region r sphere 0 0 0.1 0.02\n", "region r", [{"region": {"sphere": {"center": [0, 0, "100 mm"], "radius": "20 mm"}}}]),
        ("region r block INF INF INF INF 0.05 INF\n", "porosity r 0.3 7", [{"region": ABOVE, "fraction": 0.3}]),
        ("", "group all", [{"groups": ["ins_1", "ins_2"]}]),
        (RADIUS.format("z>0.05", 100), "group g", [{"region": ABOVE}]),
        (RADIUS.format('"z + c_1 > 0.5*0.1"', 50), "group g", [{"region": ABOVE, "part": "any"}]),
        (RADIUS.format('"(2*c_1-0.1 <= 2*(z-2*c_1))"', 1), "group g", None),
        (RADIUS.format('"c_1+0.05 <= z"', 1), "group g", [{"region": ABOVE, "part": "all"}]),
        (RADIUS.format("vz>0", 100), "group g", None),
        (RADIUS.format("z*z>0.05", 100), "group g", None),
        (RADIUS.format("z>0.05", 1000), "group g", []),
    ],
)  # fmt: skip
def test_deletion_between_runs(tmp_path, before, command, expected):
    """A dynamic group is evaluated at multiples of `every` and at the start of a run; at the step 0 it is empty."""
    found, scene = imported(tmp_path, liggghts(end=f"{before}run 100\ndelete_atoms {command}\nrun 100"))
    (_, remark) = remarks(found, "delete_atoms")[-1]
    if expected is None:
        assert remark.startswith("deletion of") or "the condition" in remark
        assert not found.report.is_complete
    elif not expected:
        assert "last at the step 0, at which it has no particles" in remark and "stages" not in scene
    else:
        assert scene["stages"][1]["delete"] == expected
        assert len(gf.Scene.from_dict(yaml.safe_load(found.text)).stages[1].delete) == 1


def test_deletion_before_the_first_run(tmp_path):
    """Of three atoms at 0, 3 and 5 mm and one far away, the overlap of 4 mm deletes the first and keeps one of the
    others; a group of a region deletes the one far away."""
    atoms = "".join(f"create_atoms 1 single {x} 0.05 0.1\n" for x in (0.02, 0.023, 0.025, 0.08))
    text = LAMMPS.format(model="pair_style gran/hooke/history 1e4 NULL 10 NULL 0.5 1\npair_coeff * *")
    start = (
        f"{atoms}set group all diameter 0.002\nset group all density 2500\nregion r block 0.07 0.1 INF INF INF INF\n"
        "group far region r\ndelete_atoms group far\ndelete_atoms overlap 0.004 all all\nrun 100"
    )
    found, _ = imported(tmp_path, re.sub("fix p all pour.*\n", "", text).replace("run 100", start))
    rows = next(iter(found.files.values())).decode().splitlines()[1:]
    assert [row.split(",")[0] for row in rows] == ["0.025"]


def test_read_restart_is_refused_with_advice(tmp_path):
    found, _ = imported(
        tmp_path, "units si\nread_restart f\npair_style gran model hertz\ntimestep 1\nrun 1\n"
    )
    assert found.text == "" and "write_data" in remarks(found, "read_restart")[0][1]


STARTS = """variable speed equal 1+2
set atom 2 vx v_speed
region r cylinder z 0.5 0.5 0.1 1 2
region s sphere 0.4 0.4 0.4 0.18
group g region s
group h subtract all g
velocity g set NULL 7 NULL
set group h omega 5 0 0
set region r omegay 0"""


def test_particles_of_a_file(tmp_path):
    (tmp_path / "data").write_text("header\n\n2 atoms\n1 atom types\n0 1 xlo xhi\n0 1 ylo yhi\n0 2 zlo zhi\n\nAtoms\n\n"
                                   "1 1 0.2 2500 0.5 0.5 0.5\n2 1 0.4 2500 0.5 0.5 1.5\n")  # fmt: skip
    head = LAMMPS.format(model="pair_style gran/hooke/history 1000 NULL 300 NULL 0.5 1")
    text = head.replace("region box block 0 0.1 0 0.1 0 0.2\ncreate_box 1 box", "read_data data")
    text = text.replace("fix p all pour 100 1 7 region box diam one 0.004 dens 2500 2500", STARTS)
    found, scene = imported(tmp_path, text)
    assert found.files["type1.csv"].decode().splitlines()[0] == "x,y,z,r,vx,vy,vz,wx,wy,wz"
    # The cylinder contains the second particle only, whose box would contain none of both.
    rows = [row.split(",") for row in found.files["type1.csv"].decode().splitlines()[1:]]
    assert [row[:5] for row in rows] == [["0.5", "0.5", "0.5", "0.1", "0"], ["0.5", "0.5", "1.5", "0.2", "3"]]
    assert [row[5] for row in rows] == ["7", "0"] and [row[7] for row in rows] == ["0", "5"]
    assert scene["domain"]["max"] == ["1 m", "1 m", "2 m"]


# The command


def test_command(tmp_path, capsys):
    deck = tmp_path / "in.deck"
    deck.write_text(liggghts())
    out = tmp_path / "deck.yaml"
    assert main(["import", str(deck), "--out", str(out)]) == 0
    assert "0 not possible" in capsys.readouterr().out
    scene = gf.load_scene(out)
    assert scene.particles["ins_1"].count + scene.particles["ins_2"].count == 50
    deck.write_text(liggghts(end="fix h all heat/gran/radiation\nrun 100"))
    assert main(["import", str(deck), "--out", str(out)]) == 3  # nothing is written
    assert main(["import", str(deck), "--out", str(out), "--partial"]) == 2  # the file exists
    capsys.readouterr()
    assert main(["import", str(deck), "--out", str(out), "--partial", "--overwrite", "--json"]) == 3
    printed = capsys.readouterr().out
    assert json.loads(printed[printed.index("{") :])["counts"]["not possible"] == 1
    deck.write_text("run")
    assert main(["import", str(deck)]) == 2
    assert "in.deck:1: the number of steps is missing" in capsys.readouterr().err


def test_tables_are_complete():
    """Each entry of the tables has a counterpart, or a reason."""
    for name, each in {**all_commands(), **all_fixes()}.items():
        assert each.counterpart in ("not needed", "not possible") or each.handler.__doc__, name
        assert each.note or each.counterpart != "not possible", name


def test_error_is_not_a_traceback(tmp_path):
    with pytest.raises(DeckError):
        imported(tmp_path, liggghts(insertion="fix ins all insert/pack region nowhere"))


def test_guide(tmp_path):
    """The scene of the guide is that of its script."""
    text = (Path(__file__).resolve().parents[2] / "docs/pages/guides/import.md").read_text(encoding="utf-8")
    blocks = dict(re.findall(r"^```\w+\n# (\S+)\n(.*?)^```", text, re.DOTALL | re.MULTILINE))
    (tmp_path / "in.bed").write_text(f"# in.bed\n{blocks['in.bed']}")
    assert convert(tmp_path / "in.bed").text == blocks["bed.yaml"]


@pytest.mark.parametrize("text", ["clear\n{}", "{}\nclear\n", "{}\nclear\nvariable k equal 2\nprint 'end'\n"])
def test_clear_before_or_after_the_simulation_is_not_needed(tmp_path, text):
    found, _ = imported(tmp_path, text.format(liggghts()))
    assert found.report.is_complete and remarks(found, "clear")[0][0] == "not needed"


def test_code_of_a_script_whose_first_line_has_a_variable_of_the_command_line(tmp_path):
    found, _ = imported(tmp_path, "processors ${X} 1 1\n" + liggghts())
    assert found.code == "liggghts" and found.report.is_complete
