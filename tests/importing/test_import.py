"""Scripts of LIGGGHTS and LAMMPS become scenes: keys of small scripts."""

import json
import re
from math import exp, hypot, log, pi, sqrt
from pathlib import Path

import numpy as np
import pytest
from importing.decks import (
    ATOMS,
    HEAT,
    HEATED,
    HERTZ,
    PACK,
    POUR,
    at,
    imported,
    lammps,
    liggghts,
    loaded,
    pairwise,
    remarks,
    write_square,
)

import granflow as gf
from granflow.cli.main import main
from granflow.contact.theory import damping_ratio_for
from granflow.importing.collisions import collision, free_restitution, plastic_collision, tsuji
from granflow.importing.convert import convert
from granflow.importing.materials import LEAST_RESTITUTION
from granflow.units import to_si

GUIDES = Path(__file__).resolve().parents[2] / "docs/pages/guides"
SPEED = "fix m5 all property/global characteristicVelocity scalar 2"
STIFFER = pairwise(
    coefficientMaxElasticStiffness=4, coefficientAdhesionStiffness=0.2, coefficientPlasticityDepth=0.1
)
ROLLING = "fix m5 all property/global coefficientRollingFriction peratomtypepair 2 1 2 2 3"
HYSTERESIS = {"properties": f"{SPEED}\n{STIFFER}", "model": "model hooke/hysteresis tangential history"}
MASS = 2500 * pi / 6 * 0.004**3
"""Mass [kg] of a particle of LAMMPS."""


@pytest.mark.parametrize(
    ("parts", "path", "expected"),
    [
        ({}, "contact.normal", "hertz"),
        ({}, "contact.tangential.increments", "displacement"),
        ({"model": f"{HERTZ} tangential_damping off"}, "contact.tangential.damping", None),
        # The increment of the force is that of the displacement times the present stiffness: the default.
        ({"model": "model hertz tangential incremental_history"}, "contact.tangential.increments", None),
        ({"model": "model hertz tangential incremental_history"}, "contact.tangential.unloading", "kept"),
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
        ({"end": "thermo_modify format float %g flush yes lost ignore norm no\nrun 10"}, "domain.on_exit", "delete"),
        ({"boundary": "p f m"}, "domain.periodic", ["x"]),
        ({}, "walls.floor.material", "type2"),
        ({}, "walls.floor.normal", [0, 0, 1]),
        ({}, "gravity", [0, 0, -9.81]),
        ({"end": "run 100\nrun 500 upto"}, "run.duration", "5 ms"),
        ({"end": "run 1000\nclear"}, "run.duration", "10 ms"),
        ({"end": "dump d all custom 50 f id\nrun 1000"}, "output.interval", "500 us"),
        ({"end": "thermo 20\nrun 1000"}, "output.timeseries_interval", "200 us"),
        ({"end": "restart 500 f\nrun 1000"}, "output.checkpoint.interval", "5 ms"),
        # Shares by mass: 0.25 and 0.75 of 50 particles, of which type 1 has an eighth of the mass of type 2.
        ({}, "particles.ins_1.count", round(50 * 0.25 / (0.25 + 0.75 / 8))),
        ({}, "particles.ins_2.count", round(50 * (0.75 / 8) / (0.25 + 0.75 / 8))),
        ({"insertion": PACK.replace("particles_in_region 50", "volumefraction_region 0.1 vel constant 0 0 -1")},
         "particles.ins_1.velocity", [0, 0, -1]),
        ({"insertion": PACK.replace("pack", "rate/region").replace("particles_in_region 50", "mass 0.2 massrate 2 start 500")},
         "particles.ins_1.insert.mass_flow", "500 g/s"),
        ({"insertion": "fix p1 all particletemplate/sphere 1 atom_type 1 density constant 2500 radius uniform 0.001 0.002\n"
                       "fix d all particledistribution/discrete 1 1 p1 1\n" + PACK},
         "particles.ins.diameter", {"distribution": "uniform", "min": "2 mm", "max": "4 mm"}),
        ({"properties": SPEED, "model": "model hooke tangential history"},
         "contact.normal.stiffness.reference_velocity", "2 m/s"),
        # 5 MPa / (1 - 0.45^2)
        ({"properties": SPEED, "model": "model hooke tangential history"}, "materials.type1",
         {"young_modulus": "6.26959247649 MPa", "poisson_ratio": 0, "density": 2500}),
        ({"properties": ROLLING, "model": f"{HERTZ} rolling_friction epsd2", "wall": HERTZ}, "pairs.type1-wall.rolling_friction", 0),
        ({"properties": ROLLING, "model": f"{HERTZ} rolling_friction cdt"}, "pairs.type1-type2.rolling_friction", 2),
        ({"properties": "fix m5 all property/global cohesionEnergyDensity peratomtypepair 2 1e5 1e5 1e5 2e5",
          "model": f"{HERTZ} cohesion sjkr2"}, "pairs.type2-type2.cohesion_energy_density", "400 kJ/m3"),
        # The area of sjkr2 is 4 pi R* d for spheres, but 2 pi R d at walls, as that of sjkr.
        ({"properties": pairwise(cohesionEnergyDensity=1e5), "model": f"{HERTZ} cohesion sjkr2"},
         "pairs.type1-wall.cohesion_energy_density", "100 kJ/m3"),
        # below sqrt(k1 / kp) = 0.5 of the plastic spring alone
        (HYSTERESIS, "pairs.type1-type1.restitution", 0.335308),
        (HYSTERESIS, "contact.normal", {"law": "luding", "stiffness": {"reference_velocity": "2 m/s"},
                            "plasticity_depth": 0.1, "tension": 0.2}),
    ],
)  # fmt: skip
def test_liggghts(tmp_path, parts, path, expected):
    found, scene = imported(tmp_path, liggghts(**parts))
    assert found.code == "liggghts"
    assert at(scene, path) == expected


GRANULAR = "pair_style granular\npair_coeff * * {} {}"


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
        (GRANULAR.format("hertz/material 1e7 0.9 0.25", "tangential mindlin 4.375e6 1.0 0.5 damping tsuji"),
         "contact.tangential.stiffness_factor", 0.478515625),
        (GRANULAR.format("hertz/material 1e7 0.9 0.25", "tangential mindlin NULL 1.0 0.5 damping tsuji"),
         "materials.type1.young_modulus", "10 MPa"),
        (GRANULAR.format("jkr 1e7 0.9 0.25 0.05", "tangential mindlin_rescale NULL 0 0.5 damping tsuji"),
         "pairs.type1-type1.work_of_adhesion", "100 mJ/m2"),
        (GRANULAR.format("hertz/material 1e7 0.9 0.25", "tangential mindlin NULL 0 0.5 twisting marshall damping tsuji"),
         "contact.twisting", "marshall"),
        # Without damping a Hertz contact is elastic; with much of it a particle stays on the other.
        (GRANULAR.format("hertz/material 1e7 0 0.3", "tangential mindlin NULL 0 0.5"), "pairs.type1-type1.restitution", 1),
        (GRANULAR.format("hertz/material 1e7 1e30 0.3", "tangential mindlin NULL 0 0.5"), "pairs.type1-type1.restitution", LEAST_RESTITUTION),
    ],
)  # fmt: skip
def test_lammps(tmp_path, model, path, expected):
    found, scene = imported(tmp_path, lammps(model))
    assert found.code == "lammps"
    assert at(scene, path) == expected


def test_box_of_lammps(tmp_path):
    """boundary fm: the upper end is enlarged by the size of the box, and the lower one deletes."""
    end = "thermo_modify lost ignore\nchange_box all units box x final 0 0.2\nrun 100"
    _, scene = imported(tmp_path, lammps(boundary="f f fm", end=end))
    assert scene["domain"] == {"min": [0, 0, 0], "max": ["200 mm", "100 mm", "400 mm"], "on_exit": "delete"}


def test_tangential_damping_of_liggghts(tmp_path):
    """gamma_t / gamma_n = sqrt(St / Sn) = sqrt(4 G* / E*), times the damping ratio of LIGGGHTS over granflow's.

    Both codes reach the restitution that is entered, with ratios that differ because granflow cuts the tension.
    """
    _, scene = imported(tmp_path, liggghts())
    stiffness = 2.0 * (1 - 0.45) / (2 - 0.45)  # 4 G* / E* of equal materials
    beta = 0.6931471806 / sqrt(pi**2 + 0.6931471806**2)
    tangential = scene["contact"]["tangential"]
    assert tangential["damping"] == pytest.approx(sqrt(stiffness) * beta / damping_ratio_for(0.5), rel=1e-3)
    assert tangential["dashpot"] == "sticking"  # LIGGGHTS limits the spring alone


@pytest.mark.parametrize(("e", "result"), [(0.3, 0.397), (0.5, 0.550), (0.9, 0.902)])
def test_restitution_with_limit_force(tmp_path, e, result):
    """The numbers of the guide: integrated collisions, confirmed with LIGGGHTS."""
    text = liggghts(model=f"{HERTZ} limitForce on", wall=HERTZ).replace("0.5 0.6 0.6 0.7", f"{e} 0.6 0.6 0.7")
    _, scene = imported(tmp_path, text)
    assert scene["pairs"]["type1-type1"]["restitution"] == pytest.approx(result, abs=6e-4)
    _, scene = imported(
        tmp_path, text.replace(" limitForce on", "").replace("zplane 0.0", "zplane 0.0 limitForce on")
    )
    assert scene["pairs"]["type1-type1"]["restitution"] == e


def test_mixed_coefficients_of_granular(tmp_path):
    """Types without a pair_coeff of their own have geometric means. A wall has the same modulus for all: in the
    script E* = 10 MPa / 2 (1 - nu^2), of the materials 1 / (1/30 + 1/10) = 7.5 MPa / (1 - nu^2)."""
    coefficients = "{} hertz/material {} 0.5 0.25 tangential mindlin NULL 1.0 {} damping tsuji\n"
    model = "".join(
        "pair_coeff " + coefficients.format(*row) for row in (("1 1", 1e7, 0.9), ("2 2", 3e7, 0.4))
    )
    wall = f"fix w all wall/gran granular {coefficients.format('', '1e7', 0.5)[1:-1]} zplane 0 NULL\nrun 100"
    atoms = f"{POUR}\nfix q all pour 100 2 7 region source diam one 0.004 dens 2500 2500"
    found, scene = imported(tmp_path, lammps(f"pair_style granular\n{model}", atoms=atoms, end=wall))
    assert scene["pairs"]["type1-type2"]["friction"] == pytest.approx(sqrt(0.9 * 0.4))
    assert "type2 with the wall have 1.5 times" in remarks(found, "fix w")[0][1]


def test_linear_spring_on_a_chute(tmp_path):
    """gran/hooke: m* x'' + m* g x' + k x = 0 ends at zero overlap: e = exp(-g t / 2), t = pi / sqrt(k / m* - g2 / 4)."""
    _, scene = imported(
        tmp_path, lammps(boundary="p p f", gravity="10 chute 30", atoms=POUR.replace("source", "box"))
    )
    assert scene["gravity"] == pytest.approx([5, 0, -10 * sqrt(0.75)])
    frequency = sqrt(1000 / (MASS / 2) - 300**2 / 4)
    assert scene["pairs"]["type1-type1"]["restitution"] == pytest.approx(exp(-150 * pi / frequency), abs=1e-5)


def test_integrated_collisions():
    """A linear spring with 2 zeta has a closed form. A plastic spring below its limit loads with k1 = 1 to the
    overlap u and unloads with k2 = 1 + (r - 1) u: e = 1/sqrt(k2)."""
    for limited in (True, False):
        assert collision(1.0, 0.4, 0.0, limited) == pytest.approx(free_restitution(0.2, limited), abs=1e-3)
    for speed in (0.2, 0.9):
        assert plastic_collision(speed, 3.0, 0.0) == pytest.approx(1 / sqrt(1 + 2 * speed), abs=2e-3)


def test_numbers_to_enter_in_other_codes_give_the_restitution_of_the_guide():
    """In LIGGGHTS, with the result of entering e with limitForce, and in LAMMPS by the polynomial of Tsuji."""
    guide = (GUIDES / "other_codes.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| ((?:0\.\d+ ?\|? ?){6})\|$", guide, re.MULTILINE)
    table = [[float(cell) for cell in row.split("|")] for row in rows]
    assert [row[0] for row in table] == [0.3, 0.5, 0.7, 0.8, 0.9, 0.95]
    for e, _, in_liggghts, limited, *in_lammps in table:
        zeta = -log(in_liggghts) / hypot(log(in_liggghts), pi)
        assert free_restitution(zeta, False) == pytest.approx(e, abs=1e-5)
        assert free_restitution(zeta, True) == pytest.approx(limited, abs=6e-4)
        for entered, has_limit in zip(in_lammps, (False, True), strict=True):
            assert free_restitution(tsuji(entered) / sqrt(5), has_limit) == pytest.approx(e, abs=1e-4)


def test_each_size_has_its_restitution_if_the_model_depends_on_it(tmp_path):
    """The dashpot gamma M of a linear spring k has e = exp(-pi z / sqrt(1 - z^2)), z = gamma / 2 sqrt(M / k); M:
    effective mass, of a wall that of the sphere."""
    properties = pairwise(kn=2e3, kt=1e3, gamman=300, gammat=100)
    script = liggghts(properties=properties, model="model hooke/stiffness tangential history")
    _, scene = imported(tmp_path, script.replace("atom_type 2", "atom_type 1"))
    mass = {f"type1_{d}mm": 2500.0 * pi / 6.0 * (1e-3 * d) ** 3 for d in (4, 8)}
    groups = {each["material"]: each["diameter"] for each in scene["particles"].values()}
    assert groups == {"type1_4mm": "4 mm", "type1_8mm": "8 mm"}
    for key, pair in scene["pairs"].items():
        first, second = (mass.get(each, 1e9) for each in key.split("-"))
        z = 150.0 * sqrt(first * second / (first + second) / 2e3)
        assert pair["restitution"] == pytest.approx(exp(-pi * z / sqrt(1.0 - z**2)), abs=2e-6), key
    assert len(scene["pairs"]) == 5


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
    properties = f"{SPEED}\n{pairwise(cohesionEnergyDensity=1e4, coefficientRollingFriction=0.1)}"
    new = liggghts(properties=properties, model=f"model {model}")
    old = re.sub("pair_style.*", f"pair_style gran/{pair}", new)
    old = re.sub("wall/gran .*", f"wall/gran/{pair.split()[0]} {wall}", old)
    assert old != new
    (_, before), (_, after) = (imported(tmp_path, text) for text in (new, old))
    assert after == before


def test_is_defined(tmp_path):
    """Whether a fix and so on exists at the line: more steps, by a power of two, for each that does."""
    names = [
        "fix,g",
        "fix,none",
        "region,box",
        "group,all",
        "group,few",
        "variable,q0",
        "variable,none",
        "compute,c",
    ]
    lines = [f"variable q{k} equal is_defined({name})" for k, name in enumerate(names)]
    total = "+".join(f"{2**k}*v_q{k}" for k in range(len(names)))
    _, scene = imported(tmp_path, liggghts(end="\n".join([*lines, f"variable n equal {total}", "run $n"])))
    assert to_si(scene["run"]["duration"], "time") == pytest.approx(1e-5 * (1 + 4 + 8 + 32))


# Insertion


@pytest.mark.parametrize("wall", ["primitive type 2 zplane {}", "mesh n_meshes 1 meshes mesh"])
@pytest.mark.parametrize("level", [0.0, -0.05])
def test_refills_stay_above_a_floor(tmp_path, wall, level):
    """particles_in_region of insert/pack counts those that are in the region. LIGGGHTS 3.8.0 has 243, 344, 394 and
    400 particles after the insertions every 60 ms into a region of 20 mm radius and 80 mm height on a floor; in the
    free fall from 1 m/s all leave a region without one."""
    write_square(tmp_path / "floor.stl", 0.06, (-0.03, -0.03), level)
    pack = "region fill cylinder z 0 0 0.02 0 0.08\nfix ins all insert/pack seed 1 distributiontemplate d all_in yes "
    pack += "insert_every 6000 vel constant 0 0 -1 particles_in_region 400 region fill"
    mesh = "fix mesh all mesh/surface file floor.stl type 1" if "mesh" in wall else ""
    script = liggghts(properties=mesh, insertion=pack, end="run 24000\nunfix ins\nrun 100")
    for old, new in (
        ("block 0 0.1 0 0.1 0 0.2", "block -0.03 0.03 -0.03 0.03 -0.06 0.1"),
        ("2 p1 0.25 p2 0.75", "1 p1 1"),
        ("radius constant 0.002", "radius constant 0.003"),
        ("primitive type 2 zplane 0.0", wall.format(level)),
    ):
        script = script.replace(old, new)
    _, scene = imported(tmp_path, script)
    counts = [group["count"] for group in scene["particles"].values()]
    if level:
        assert counts[1:] == pytest.approx([0.97 * counts[0]] * 3, rel=0.005)  # (v t + g t^2 / 2) / height
    else:
        assert sum(counts) == 400
        assert np.cumsum(counts)[:2] == pytest.approx([243, 344], rel=0.1)


def test_refills_replace_all_that_have_fallen_out(tmp_path):
    """LIGGGHTS 3.8.0: 100 particles, and 128.4, 185.4 and 236.4 after the refills every 50 ms, the mean of five seeds."""
    pack = "region fill block 0.005 0.095 0.005 0.095 0.05 0.15\nfix ins all insert/pack seed 1 distributiontemplate d "
    pack += "all_in yes insert_every 5000 vel constant 0 0 -0.3 particles_in_region 100 region fill"
    _, scene = imported(tmp_path, liggghts(insertion=pack, end="run 19000"))
    counts = {name: group["count"] for name, group in scene["particles"].items()}
    batches = [sum(counts[f"ins_{k}{end}"] for k in (1, 2)) for end in ("", "_2", "_3", "_4")]
    assert np.cumsum(batches) == pytest.approx([100, 128.4, 185.4, 236.4], rel=0.02)


@pytest.mark.parametrize(("height", "shares", "requested", "reached"), [
    (0.0075, "1 p1 1", 0.9, 0.241), (0.01, "1 p1 1", 0.9, 0.246), (0.025, "1 p1 1", 0.9, 0.287),
    (0.01, "2 p1 0.5 p2 0.5", 0.4, 0.344), (0.025, "2 p1 0.5 p2 0.5", 0.4, 0.363),
    (0.025, "2 p1 0.5 p2 0.5", 0.9, 0.301), (0.01, "1 p1 1", 0.2, 0.2),
])  # fmt: skip
def test_random_insertion_ends_at_the_solid_fraction_of_liggghts(
    tmp_path, height, shares, requested, reached
):
    """In 50 mm x 50 mm with diameters of 5 and 2.5 mm; `reached` by LIGGGHTS 3.8.0. The large particles come first:
    if they do not fit, the small ones are left out."""
    pack = (
        f"region fill block 0 0.05 0 0.05 0 {height}\nfix ins all insert/pack seed 1 distributiontemplate d "
    )
    pack += f"all_in yes insert_every once volumefraction_region {requested} region fill"
    script = liggghts(insertion=pack).replace("2 p1 0.25 p2 0.75", shares)
    script = script.replace("constant 0.004", "constant 0.00125").replace(
        "constant 0.002\n", "constant 0.0025\n"
    )
    _, scene = imported(tmp_path, script)
    groups = [(each["count"], to_si(each["diameter"], "length")) for each in scene["particles"].values()]
    volume = sum(np.pi / 6.0 * count * diameter**3 for count, diameter in groups)
    assert volume / (0.05**2 * height) == pytest.approx(reached, rel=0.08)


def poured(tmp_path, options, end, count=10000, region="block 0.04 0.06 0.04 0.06 0.1 0.15"):
    """The translation of a script with a fix pour from a region."""
    source = f"region s {region}\nfix p all pour {count} 1 7 region s dens 2500 2500 {options}"
    return imported(tmp_path, lammps(boundary="p p f", atoms=source, end=end))


@pytest.mark.parametrize(
    ("count", "change", "rate"),
    [(200, "", 29 / 0.02361), (200, "timestep 2e-6\n", 29 / 4.722e-3), (20, "", 20 / 0.023607)],
)
def test_pour_enters_at_the_lower_end_of_its_region(tmp_path, count, change, rate):
    """A fall of 50 mm from 2 m/s takes (sqrt(4 + 1) - 2) / 10 s = 23.6 ms and ends with sqrt(5) m/s.

    LAMMPS counts the steps of this time with the step at the line of the fix: 2361 steps of 10 us are 4.72 ms
    later with 2 us. LAMMPS takes at least one unit of length, 1 m, along y, so that a batch has
    0.001 20 mm x 1 m x 50 mm / (pi/6 (4 mm)3) = 29 particles.
    """
    options = "diam one 0.004 vel 0.1 0.3 0 0 -2 vol 0.001 50"
    _, scene = poured(tmp_path, options, f"{change}run 20000", count)
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


@pytest.mark.parametrize(
    ("region", "options", "counts"),
    [
        ("block 0.025 0.075 0.025 0.075 0.1 0.15", "diam one 0.004 vol 0.1 5", (479, 577, 490, 527, 496, 503, 516, 548)),
        ("cylinder z 0.05 0.05 0.02 0.06 0.12", "diam poly 2 0.004 0.6 0.003 0.4 vol 0.3 50",
         (331, 334, 408, 370, 407, 338, 311, 303)),
        ("block 0.025 0.075 0.03 0.07 0.1 0.15", "diam range 0.003 0.005 vol 0.02 50",
         (352, 341, 361, 311, 338, 398, 349, 406)),
    ],
)  # fmt: skip
def test_batches_of_pour_that_do_not_fit_are_those_of_lammps(tmp_path, region, options, counts):
    """The first batch of LAMMPS 29 Sep 2021 with eight seeds. The means of 8 and of 4 batches, with a standard
    deviation of 11 % each, differ by less than 3 x 0.11 sqrt(1/8 + 1/4) = 0.2."""
    found, scene = poured(tmp_path, options, "run 60000", region=region)
    (sentence,) = (each for _, each in remarks(found, "fix p") if "gives up to place" in each)
    batch = int(sentence.split("a batch has about ")[1].split()[0])
    assert batch == pytest.approx(np.mean(counts), rel=0.2)
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
    runs = f"run 3000\nunfix p\n{between}\nrun 30000"
    _, scene = poured(tmp_path, "diam one 0.004 vel 0 0 0 0 -2 vol 0.001 50", runs, 200)
    group = scene["particles"]["p"]
    assert (group["count"], group["insert"].get("end")) == (count, end)


RANDOM = """region c cylinder z 0.05 0.05 0.03 0.05 0.15
{}
set group all diameter 0.004 density 2500
velocity all create 4e14 12 dist gaussian
minimize 1e-4 1e-4 10 10
fix l all nve/limit 1e-4"""


@pytest.mark.parametrize(("calls", "count"), [(["3 20", "3 21"], 6), (["400 20"], 400)])
def test_random_particles_that_overlap_become_a_packing(tmp_path, calls, count):
    """400 spheres of 4 mm in 283 cm3 overlap, six do not. The sum of m v^2 is 3 N - 3 times k T."""
    lines = "\n".join(f"create_atoms 1 random {each} c" for each in calls)
    found, scene = imported(tmp_path, lammps(atoms=RANDOM.format(lines)))
    (group,) = scene["particles"].values()
    if count == 400:
        assert group["insert"]["kind"] == "pack"
        assert group["count"] == count and group["diameter"] == "4 mm" and "velocity" not in group
        assert group["insert"]["region"]["cylinder"]["radius"] == "32 mm"  # centers in the region
        speed = to_si(group["thermal"]["velocity_rms"], "velocity")
    else:
        rows = np.array([row.split(",") for row in found.files["type1.csv"].decode().splitlines()[1:]], float)
        assert len(np.unique(rows[:, 0])) == count and (np.abs(rows[:, 2] - 0.1) < 0.05).all()
        assert (np.hypot(rows[:, 0] - 0.05, rows[:, 1] - 0.05) < 0.03).all()
        assert np.abs(rows[:, 4:7].sum(axis=0)).max() < 1e-9 * np.abs(rows[:, 4:7]).max()
        speed = np.sqrt((rows[:, 4:7] ** 2).sum() / count)
    assert count * MASS * speed**2 == pytest.approx((3 * count - 3) * 1.380649e-23 * 4e14, rel=1e-5)
    assert found.report.is_complete


def test_runs_that_separate_random_particles_are_left_out(tmp_path):
    """What follows them is the start: their drag has ended, and velocities can be set."""
    atoms = (
        "create_atoms 1 random 400 20 box\nset type 1 diameter 0.005 density 2500\nfix l all nve/limit 1e-4\n"
        "fix v all viscous 0.1\nrun 500\nunfix l\nunfix v\nvelocity all set 0.1 0 0"
    )
    found, scene = imported(tmp_path, lammps(atoms=atoms))
    assert found.report.is_complete and "damping" not in scene and scene["run"]["duration"] == "1 ms"
    (group,) = scene["particles"].values()
    assert group["velocity"] == ["100 mm/s", 0, 0] and group["insert"]["kind"] == "pack"


STARTS = """variable half equal 0.5
variable speed atom 2+v_half*id
set atom 2 vx v_speed
region r cylinder z 0.5 0.5 0.1 1 2
region s sphere 0.4 0.4 0.4 0.18
group g region s
group h subtract all g
velocity g set NULL 7 NULL
velocity g set NULL NULL 2 sum yes
set group h omega 5 0 0
set region r omegay 0"""


def test_particles_of_a_file(tmp_path):
    """The cylinder contains the second particle only, whose box would contain none of both."""
    (tmp_path / "data").write_text("header\n\n2 atoms\n1 atom types\n0 1 xlo xhi\n0 1 ylo yhi\n0 2 zlo zhi\n\nAtoms\n\n"
                                   "1 1 0.2 2500 0.5 0.5 0.5\n2 1 0.4 2500 0.5 0.5 1.5\n")  # fmt: skip
    text = lammps(atoms=STARTS).replace(
        "region box block 0 0.1 0 0.1 0 0.2\ncreate_box 2 box", "read_data data"
    )
    found, scene = imported(tmp_path, text)
    header, *rows = (row.split(",") for row in found.files["type1.csv"].decode().splitlines())
    assert header == ["x", "y", "z", "r", "vx", "vy", "vz", "wx", "wy", "wz"]
    expected = [[0.5, 0.5, 0.5, 0.1, 0, 7, 2, 0, 0, 0], [0.5, 0.5, 1.5, 0.2, 3, 0, 0, 5, 0, 0]]
    assert [[float(each) for each in row] for row in rows] == expected
    assert scene["domain"]["max"] == ["1 m", "1 m", "2 m"]


THIRD = "create_atoms 1 single 0.05 0.05 0.08\nset atom 3 diameter 0.004 density 2500"


@pytest.mark.parametrize(
    ("commands", "moved"),
    [
        ("group a type 1", [1]),
        ("group a union early", []),
        ("region low block INF INF INF INF INF 0.015\ngroup a region low\nset group all z 0.05", [1]),
        ("group a type 1\ngroup a id 2", [1, 2]),
        ("group a id 1:2:2", [1]),
        ("group a type > 1", [2]),
        ("variable up atom z>0.015\ngroup a variable up", [2]),
        (f"{THIRD}\ngroup a subtract all two", [1, 3]),
        ("group a type 1\ndelete_atoms group two", [1]),
        # The last particle, here the third, fills the gap and has its id, unless ids are kept.
        (f"{THIRD}\ndelete_atoms group one\ngroup a id 1", [1]),
        (f"{THIRD}\ndelete_atoms group one compress no\ngroup a id 2", [2]),
    ],
)  # fmt: skip
def test_groups_have_the_particles_of_their_command(tmp_path, commands, moved):
    """One particle of each type, the second above; the group `early` precedes them. So it is in LAMMPS 22 Jul 2025."""
    atoms = f"group early type 1\n{ATOMS}\n{commands}\nvelocity a set 1 0 0"
    found, _ = imported(tmp_path, lammps(atoms=atoms))
    assert found.report.is_complete
    counts = [data.decode().count(",1,0,0,0,0,0") for data in found.files.values()]
    assert sum(counts) == len(moved) and found.files["type1.csv"].decode().count(",1,0,") == len(
        {*moved} - {2}
    )


@pytest.mark.parametrize(
    ("code", "words", "mass"),
    [
        ("lammps", "density 2500 diameter 0.01", 1309),
        ("lammps", "mass 0.002 diameter 0.01", 0.002),
        ("lammps", "diameter 0.01 density 2500 diameter 0.02", 0.001309),
        ("liggghts", "density 2500 diameter 0.01", 0.001309),
        ("liggghts", "diameter 0.01 mass 0.002", 0.002),
        ("liggghts", "diameter 0.01 density 2500 diameter 0.02", 0.010472),
    ],
)
def test_mass_of_particles_whose_diameter_is_set(tmp_path, code, words, mass):
    """Masses of LAMMPS 22 Jul 2025, which keeps them, and of LIGGGHTS 3.8.0, which keeps the density."""
    atoms = f"create_atoms 1 single 0.05 0.05 0.1\nset type 1 {words}"
    text = lammps(atoms=atoms) if code == "lammps" else liggghts(insertion=atoms)
    found, scene = imported(tmp_path, text)
    radius = float(found.files["type1.csv"].decode().splitlines()[1].split(",")[3])
    density = scene["materials"]["type1"]["density"]
    assert found.report.is_complete and density * 4 / 3 * pi * radius**3 == pytest.approx(mass, rel=1e-3)


@pytest.mark.parametrize(
    ("end", "damping", "stages"),
    [
        ("fix v all viscous 1e-3\nfix w all viscous 2e-3\nrun 9", {"drag": 3e-3 / MASS}, None),
        ("fix v all viscous 1e-3\nrun 9\nunfix v\nrun 9\nfix v all viscous 1e-3\nrun 9", {"drag": 1e-3 / MASS}, [1, 3]),
        ("fix v all damping/cundall 0.2 0.2\nrun 9\nunfix v\nrun 9", {"cundall": 0.2}, [1]),
    ],
)  # fmt: skip
def test_damping(tmp_path, end, damping, stages):
    """The codes add the drag of all fixes."""
    _, scene = imported(tmp_path, lammps(atoms=ATOMS, end=end))
    names = scene["damping"].pop("stages", None)
    assert names == (stages and [f"stage_{number}" for number in stages])
    found = {key: to_si(value, "rate") if key == "drag" else value for key, value in scene["damping"].items()}
    assert found == pytest.approx(damping)


def test_names_with_capitals_and_of_two_cases(tmp_path):
    """Names of a scene have small letters; two names that differ by their case remain two."""
    second = PACK.replace("fix ins", "fix INS").replace("seed 1", "seed 2")
    end = f"{second}\nfix W.2 all wall/gran {HERTZ} primitive type 2 xplane 0.0\nrun 10"
    _, scene = imported(tmp_path, liggghts(end=end))
    assert set(scene["particles"]) == {"ins_1", "ins_2", "ins_1_2", "ins_2_2"}
    assert set(scene["walls"]) == {"floor", "w_2"}


# Heat, liquid, gravity and deletions


def test_heat(tmp_path):
    """LIGGGHTS conducts 2 k sqrt(2 pi R d) where granflow conducts 2 k a, a = sqrt(R d). A scene needs a conductivity
    above 0; that of the importer is 3e7 times smaller than that of still air."""
    text = liggghts(properties=HEATED).replace("zplane 0.0", "zplane 0.0 temperature 400")
    found, scene = imported(tmp_path, text.replace("peratomtype 100 50", "peratomtype 0 50"))
    assert scene["contact"]["heat"] == "conduction" and scene["walls"]["floor"]["temperature"] == "400 K"
    assert scene["particles"]["ins_1"]["temperature"] == "300 K"
    material = scene["materials"]["type2"]
    assert material["heat_capacity"] == "20 J/kg/K"
    assert float(material["thermal_conductivity"].split()[0]) == pytest.approx(50 * sqrt(2 * pi))
    assert scene["materials"]["type1"]["thermal_conductivity"] == "1e-09 W/m/K"
    assert remarks(found, "thermalConductivity")[0][0] == "approximated"
    loaded(tmp_path, found)


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
    assert found.report.is_complete
    assert [stage.get("set") for stage in scene["stages"]] == [
        None,
        [
            {"temperature": "300 K"},
            {"temperature": "800 K", "region": half},
            {"temperature": "500 K", "groups": ["ins_2"]},
        ],
        [
            {"heat_source": "-1.5 W", "region": slab},
            {"temperature": "400 K", "region": half},
            {"temperature": "400 K", "region": ball},
            {"temperature": "450 K", "region": ball},
        ],
    ]


BRIDGES = """fix l1 all property/global surfaceLiquidContentInitial scalar 0.002
fix l2 all property/global surfaceTension scalar 0.072
fix l3 all property/global fluidViscosity scalar 1e-3
fix l4 all property/global contactAngle peratomtype 0.5 0.4
fix l5 all property/global minSeparationDistanceRatio scalar 1.01
fix l6 all property/global maxSeparationDistanceRatio scalar 1.1"""


def test_liquid_bridges(tmp_path):
    """Soulie's force at contact, with V = 4/3 pi c (1 - sqrt(3/4)) R^3 and the contact angle 0, over pi g R:
    exp(0.48 - 0.0082 ln V) + 0.078 + 0.0018 ln V = 1.774; Willett's is 2, 1.13 times as large.

    The largest volume is twice the bridge of equal spheres, whose films give (1 - sqrt(3/4)) / 2 each. A bridge
    breaks at (1 + angle / 2) V^(1/3) with the larger angle, in the script at (1.02 - 1) 2 R.
    """
    model = f"{HERTZ} cohesion easo/capillary/viscous"
    found, scene = imported(tmp_path, liggghts(properties=BRIDGES, model=model))
    share = (1 - sqrt(0.75)) * 4 / 3 * pi * 0.002
    cohesion = scene["contact"]["cohesion"]
    volume = to_si(cohesion.pop("max_bridge_volume"), "volume")
    assert volume == pytest.approx(2 * share * 0.004**3, rel=1e-5) and found.report.is_complete
    viscous = {"viscosity": "0.001 Pa s", "min_separation_ratio": 1}
    assert cohesion == {"law": "capillary_transfer", "viscous_force": viscous}
    assert all(group["liquid_content"] == 0.002 for group in scene["particles"].values())
    assert scene["pairs"]["type1-type2"]["contact_angle"] == pytest.approx(0.45)
    assert "1.13 times as large" in remarks(found, "pair_style")[0][1]
    loaded(tmp_path, found)
    found, _ = imported(
        tmp_path, liggghts(properties=BRIDGES.replace("scalar 1.1", "scalar 1.02"), model=model)
    )
    sentence = f"rupture at a distance of {1.25 * share ** (1 / 3):.3g} R, in the script at 0.04 R"
    assert sentence in str(remarks(found, "fix"))


def test_gravity_that_changes_is_that_of_a_stage(tmp_path):
    """Both codes add the forces of all fixes: a force is an acceleration of particles of one mass."""
    force = 2.0 * 2500.0 * 4.0 / 3.0 * np.pi * 0.002**3
    text = "fix h all gravity 5 vector 0 1 0\nrun 10\nfix g all gravity 5 vector 1 0 0\nrun 20\nrun 5\n"
    text += f"fix p all addforce 0 0 {force}\nrun 7\nunfix g\nunfix h\nrun 30"
    _, scene = imported(tmp_path, liggghts(end=text).replace("constant 0.004", "constant 0.002"))
    assert scene["gravity"] == [0, 5, -9.81]
    assert scene["stages"] == [
        {"name": "stage_1", "duration": "100 us"},
        {"name": "stage_2", "duration": "250 us", "gravity": [5, 5, 0]},
        {"name": "stage_3", "duration": "70 us", "gravity": [5, 5, 2]},
        {"name": "stage_4", "duration": "300 us", "gravity": [0, 0, 2]},
    ]


@pytest.mark.parametrize(("style", "motion"), [
    ("linear 0.1 0 0", {"kind": "translation", "velocity": ["100 mm/s", 0, 0]}),
    ("wiggle 0 0.003 0 0.02", {"kind": "vibration", "direction": [0, 1, 0], "amplitude": "3 mm", "frequency": "50 Hz"}),
    ("rotate 0.05 0.05 0 0 0 1 0.02 units box",
     {"kind": "rotation", "point": ["50 mm", "50 mm", 0], "axis": [0, 0, 1], "angular_velocity": "314.159265359 rad/s"}),
])  # fmt: skip
def test_moved_particles_follow_a_wall(tmp_path, style, motion):
    end = f"fix m two move {style}\nrun 100\nunfix m\nrun 50"
    script = lammps(atoms=ATOMS, end=end).replace("fix i all nve", "fix i one nve")
    found, scene = imported(tmp_path, script)
    assert scene["walls"]["m_carrier"]["motion"] == [{**motion, "stages": ["stage_1"]}]
    groups = {name: group.get("fixed") for name, group in scene["particles"].items()}
    assert groups == {"start_type1": None, "start_type2_m_carrier": {"to": "m_carrier"}}
    gf.plan_for(loaded(tmp_path, found))


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
    assert found.report.is_complete is (expected is not None)
    if expected:
        assert scene["stages"][1]["delete"] == expected
        assert len(loaded(tmp_path, found).stages[1].delete) == 1
    else:
        assert all("delete" not in stage for stage in scene.get("stages", ()))


def test_deletion_before_the_first_run(tmp_path):
    """Of three atoms at 0, 3 and 5 mm and one far away, the overlap of 4 mm deletes the first and keeps one of the
    others; a group of a region deletes the one far away."""
    atoms = "".join(f"create_atoms 1 single {x} 0.05 0.1\n" for x in (0.02, 0.023, 0.025, 0.08))
    atoms += (
        "set group all diameter 0.002\nset group all density 2500\nregion r block 0.07 0.1 INF INF INF INF\n"
        "group far region r\ndelete_atoms group far\ndelete_atoms overlap 0.004 all all"
    )
    found, _ = imported(tmp_path, lammps(atoms=atoms))
    rows = found.files["type1.csv"].decode().splitlines()[1:]
    assert [row.split(",")[0] for row in rows] == ["0.025"]


def test_restitution_of_a_range_of_sizes_is_that_of_the_mean_by_mass(tmp_path):
    """Numbers are equal for all diameters from a to b: the mean by mass is int d^4 / int d^3 = 4/5 (b^5 - a^5) / (b^4 - a^4)."""
    low, high = 0.004, 0.008
    mean = 0.8 * (high**5 - low**5) / (high**4 - low**4)
    found = []
    for diameters in (f"range {low} {high}", f"one {mean:.15g}"):
        _, scene = poured(tmp_path, f"diam {diameters}", "run 100", count=10)
        found.append(scene["pairs"]["type1-type1"]["restitution"])
    assert found[0] == pytest.approx(found[1], abs=1e-6) and found[0] < 0.99


MODELS = [
    *("hooke 1e4 0.5 damping coeff_restitution", "hertz/material 1e7 0.5 0.3 damping coeff_restitution"),
    *("hooke 1e4 0.5 damping tsuji", "hertz 1e7 0.5 damping tsuji", "hertz 1e7 0.01 damping velocity"),
    *("hertz 1e7 100 rolling sds 1e3 0.01 0.1", "jkr 1e7 0.5 0.3 0.01 damping tsuji twisting marshall"),
    *("dmt 1e7 0.5 0.3 0.01 damping tsuji", "hertz/material 1e7 100 0.3 limit_damping"),
    "hooke 1e4 10 damping mass_velocity",
]
TANGENTIAL = ["", "tangential linear_history 3e3 0.5 0.4", "tangential mindlin NULL 0.5 0.4"]


@pytest.mark.parametrize(("model", "tangential"), list(zip(MODELS, 4 * TANGENTIAL, strict=False)))
def test_models_of_granular(tmp_path, model, tangential):
    """The scene loads. Tsuji's polynomial is a dashpot over sqrt(k M): the damping ratio of a Hertz spring is it
    over sqrt(5), of a linear one over 2."""
    pair = f"pair_style granular\npair_coeff * * {model} {tangential}"
    wall = f"timestep 1e-7\nfix w all wall/gran granular {model} {tangential} zplane 0 NULL\nrun 100"
    found, scene = imported(tmp_path, lammps(pair, atoms=ATOMS, end=wall))
    loaded(tmp_path, found)
    expected = 0.5
    if "tsuji" in model:
        zeta = tsuji(0.5) / (2.0 if model.startswith("hooke") else sqrt(5.0))
        expected = exp(-pi * zeta / sqrt(1 - zeta**2))
    if "coeff_restitution" in model or "tsuji" in model:
        found = [each["restitution"] for each in scene["pairs"].values()]
        assert found == pytest.approx([expected] * len(found), abs=1e-6)


# The command


def test_command(tmp_path, capsys):
    deck, out = tmp_path / "in.deck", tmp_path / "deck.yaml"
    deck.write_text(liggghts())
    command = ["import", str(deck), "--out", str(out)]
    assert main(command) == 0
    assert gf.load_scene(out).particles["ins_1"].count == 36
    deck.write_text(liggghts(end="fix h all heat/gran/radiation\nrun 100"))
    assert main(command) == 3  # nothing is written
    assert main([*command, "--partial"]) == 2  # the file exists
    capsys.readouterr()
    assert main([*command, "--partial", "--overwrite", "--json"]) == 3
    printed = capsys.readouterr().out
    assert json.loads(printed[printed.index("{") :])["counts"]["not possible"] == 1
    deck.write_text("run")
    assert main(["import", str(deck)]) == 2


def test_guide(tmp_path):
    """The scene of the guide is that of its script."""
    text = (GUIDES / "import.md").read_text(encoding="utf-8")
    blocks = dict(re.findall(r"^```\w+\n# (\S+)\n(.*?)^```", text, re.DOTALL | re.MULTILINE))
    (tmp_path / "in.bed").write_text(f"# in.bed\n{blocks['in.bed']}")
    assert convert(tmp_path / "in.bed").text == blocks["bed.yaml"]
