"""Scripts of which the scene has a part only: what the report says, for the line that the part belongs to."""

import re
from math import exp, log, pi, sqrt

import numpy as np
import pytest
import yaml

import granflow as gf
from granflow.contact.theory import damping_ratio_for
from granflow.importing.collisions import free_restitution, tsuji
from granflow.importing.convert import convert
from granflow.importing.language import DeckError
from granflow.plan.build import plan_for

LAMMPS = """
units si
atom_style sphere
boundary f f f
newton off
comm_modify vel yes
region box block 0 0.1 0 0.1 0 0.1
create_box 2 box
pair_style gran/hooke/history 1e4 NULL 100 NULL 0 1
pair_coeff * *
timestep 1e-5
fix g all gravity 9.81 vector 0 0 -1
create_atoms 1 single 0.05 0.05 0.01
create_atoms 2 single 0.05 0.05 0.02
set group all diameter 0.004
set group all density 2500
group one type 1
group two type 2
fix i all nve/sphere
run 100
"""
LIGGGHTS = """
atom_style granular
boundary f f f
newton off
units si
region box block 0 0.1 0 0.1 0 0.1 units box
create_box 2 box
fix m1 all property/global youngsModulus peratomtype 1e7 1e7
fix m2 all property/global poissonsRatio peratomtype 0.3 0.3
fix m3 all property/global coefficientRestitution peratomtypepair 2 0.6 0.6 0.6 0.6
fix m4 all property/global coefficientFriction peratomtypepair 2 0.4 0.4 0.4 0.4
fix m5 all property/global coefficientRollingFriction peratomtypepair 2 0.1 0.1 0.1 0.1
fix m6 all property/global coefficientRollingViscousDamping peratomtypepair 2 0.1 0.1 0.1 0.1
pair_style gran model hertz tangential history
pair_coeff * *
timestep 1e-5
fix g all gravity 9.81 vector 0 0 -1
fix p1 all particletemplate/sphere 15485863 atom_type 1 density constant 2500 radius constant 0.002
fix d all particledistribution/discrete 15485867 1 p1 1
fix ins all insert/pack seed 32452843 distributiontemplate d all_in yes region box particles_in_region 5
fix w all wall/gran model hertz tangential history primitive type 2 zplane 0.0
fix i all nve/sphere
run 100
"""
DECKS = {"lammps": LAMMPS, "liggghts": LIGGGHTS}


def report(tmp_path, deck, *changes):
    """The translation of a script in which texts are replaced."""
    text = DECKS[deck]
    for old, new in changes:
        assert old in text
        text = text.replace(old, new, 1)
    (tmp_path / "in.deck").write_text(text)
    return convert(tmp_path / "in.deck")


def remark(found, part):
    """Kind and sentence of the only line of the report that contains a text."""
    ((kind, sentence),) = {(kind, said) for _, line, kind, said in found.report.lines() if part in line}
    return kind, sentence


GRANULAR = "pair_style granular\npair_coeff * * hertz/material 1e7 0.9 0.3 tangential mindlin NULL 1 0"
HOOKE = "pair_style gran/hooke/history 1e4 NULL 100 NULL 0 1\npair_coeff * *"


@pytest.mark.parametrize(
    ("deck", "changes", "part", "kind", "text"),
    [
        ("lammps", [("units si\n", "")], "create_box", "approximated", "numbers of the default lj"),
        ("lammps", [("timestep 1e-5\n", "")], "run", "translated", "the default of units si"),
        ("lammps", [("pair_coeff * *\n", "")], "pair_style", "approximated", "requires pair_coeff * *"),
        ("lammps", [(HOOKE, f"{GRANULAR} rolling ball 1")], "pair_coeff", "not possible", "the rolling model ball"),
        ("lammps", [(HOOKE, f"{GRANULAR} damping none")], "pair_coeff", "not possible", "damping none"),
        ("lammps", [(HOOKE, GRANULAR.replace("granular", "granular lj/cut"))], "pair_style", "not possible", "lj/cut"),
        (
            "lammps",
            [(HOOKE, GRANULAR.replace("hertz/material 1e7 0.9 0.3", "hertz 1e7 0.9") + " damping velocity")],
            "pair_coeff",
            "approximated",
            "depends on the velocity; here it is that at 0.7 m/s",  # half of sqrt(2 9.81 0.1)
        ),
        (
            "lammps",
            [(HOOKE, "pair_style none"), ("fix i", "fix w all wall/gran hooke 1e4 NULL 100 NULL 0 1 zplane 0 NULL\nfix i")],
            "pair_style none",
            "not possible",
            "particles without contacts with each other",
        ),
        ("lammps", [("fix i", "neigh_modify exclude type 1 2\nfix i")], "neigh_modify", "not possible", "exclude type 1 2"),
        ("lammps", [("fix i", "neigh_modify delay 0\nfix i")], "neigh_modify", "not needed", "neighbor list"),
        (
            "lammps",
            [("fix i all", "neigh_modify exclude group one one\nfix f one freeze\nfix i all")],
            "neigh_modify",
            "not needed",
            "neighbor list",
        ),
        ("lammps", [("nve/sphere", "nve")], "fix i", "approximated", "does not integrate the rotation"),
        ("lammps", [("nve/sphere", "nve/sphere disc")], "fix i", "not possible", "moments of inertia of discs"),
        ("lammps", [("nve/sphere", "rigid single")], "fix i", "not possible", "rigid bodies of particles at given"),
        ("lammps", [("run 100", "run 100\ncreate_atoms 1 single 0.05 0.05 0.05\nrun 100")], "0.05 0.05 0.05", "not possible", "after the first run"),
        ("lammps", [("run 100", "dump d one custom 10 f id\nrun 100")], "dump", "approximated", "not only those of one"),
        ("lammps", [("group one", "change_box all units box x final 0 0.2\ngroup one")], "change_box", "translated", "domain"),
        ("liggghts", [("tangential history\npair", "tangential history ktToKnUser on\npair")], "pair_style", "not possible", "ktToKnUser"),
        (
            "liggghts",
            [("tangential history\npair", "tangential history rolling_friction cdt\npair"), ("history primitive", "history rolling_friction epsd2 primitive")],
            "fix w",
            "approximated",
            "the rolling law is cdt for all contacts, here epsd2",
        ),
        (
            "liggghts",
            [("fix g all gravity", "group late type 1\nfix g late gravity")],
            "fix g",
            "not possible",
            "inserted particles are members of all;",
        ),
        ("liggghts", [("fix i all", "group late type 1\nfix i late")], "fix i late", "approximated", "does not move the inserted"),
        ("liggghts", [("all_in yes", "random_distribute uncorrelated")], "fix ins", "approximated", "are exact, not random"),
        ("liggghts", [("zplane 0.0", "zplane 0.0 contact_area constant 1e-6")], "fix w", "not possible", "contact_area constant"),
        ("liggghts", [("radius constant", "relative yes radius constant")], "fix p1", "not possible", "in percent of another"),
        ("liggghts", [("nve/sphere", "multisphere CAddRhoFluid 0.5 1000")], "fix i all", "not possible", "the added mass"),
        (
            "liggghts",
            [("run 100", "run 100\nfix m4 all property/global coefficientFriction peratomtypepair 2 0 0 0 0\nrun 100")],
            "fix m4 all property/global coefficientFriction peratomtypepair 2 0 ",
            "not possible",
            "coefficientFriction that changes at 0.001 s; nearest: a scene for each",
        ),
        ("liggghts", [("run 100", "run 100\npair_style gran model hooke tangential off\nrun 100"), ("fix m6", "fix m7 all property/global characteristicVelocity scalar 1\nfix m6")], "hooke", "not possible", "contact models that change at 0.001 s"),
        ("lammps", [(HOOKE, GRANULAR), ("run 100", f"run 100\n{GRANULAR.splitlines()[1]}.5\nrun 100")], "NULL 1 0.5", "not possible", "coefficients that change at 0.001 s"),
        (
            "liggghts",
            [("region box particles", "region both particles"), ("fix ins", "region a block 0 0.05 0 0.1 0 0.1 units box\nregion both union 2 a box\nfix ins")],
            "fix ins",
            "not possible",
            "a region of the style union",
        ),
        ("liggghts", [("run 100", "run 50\nunfix i\nrun 50")], "fix i all", "approximated", "integrated in some runs only"),
        ("liggghts", [("insert/pack", "insert/pack/dense")], "fix ins", "not possible", "kind: pack"),
        (
            "liggghts",
            [("primitive type 2 zplane 0.0", "primitive type 2 zplane 0.0 contact_area overlap shear x 0.5")],
            "fix w",
            "approximated",
            "walls.w",
        ),
    ],
)  # fmt: skip
def test_remark(tmp_path, deck, changes, part, kind, text):
    found = report(tmp_path, deck, *changes)
    said = remark(found, part)
    assert said[0] == kind and text in said[1]


def test_keywords_at_the_end_of_a_line_are_read(tmp_path):
    change = ("zplane 0.0", "zplane 0.0 contact_area overlap shear x 0.5")
    walls = yaml.safe_load(report(tmp_path, "liggghts", change).text)["walls"]
    assert walls["w"]["motion"]["kind"] == "surface_velocity"
    change = ("zplane 0.0", "zplane 0.0 limitForce on")
    pairs = yaml.safe_load(report(tmp_path, "liggghts", change).text)["pairs"]
    zeta = -log(0.6) / sqrt(pi**2 + log(0.6) ** 2)
    assert pairs["type1-wall"]["restitution"] == pytest.approx(free_restitution(zeta, True), abs=1e-6)
    change = ("group one", "change_box all units box x final 0 0.2\ngroup one")
    domain = yaml.safe_load(report(tmp_path, "lammps", change).text)["domain"]
    assert domain["max"][0] == "200 mm"


READ = {
    "lammps": [
        *(
            "timestep 1e-5",
            "boundary f f f",
            "create_box 2 box",
            "pair_coeff * *",
            "fix i all nve/sphere",
            "fix f one freeze",
        ),
        *(
            "velocity all zero linear",
            "delete_atoms region box",
            "reset_timestep 0",
            "unfix i",
            "set group all density 2500",
        ),
        "fix g all gravity 9.81 vector 0 0 -1",
    ],
    "liggghts": [
        *("units si", "fix m all multisphere", "thermo 10", "fix m all heat/gran initial_temperature 300"),
        "fix p1 all particletemplate/sphere 15485863 atom_type 1 density constant 2500 radius constant 0.002",
    ],
}


@pytest.mark.parametrize(("deck", "line"), [(deck, line) for deck, lines in READ.items() for line in lines])
def test_words_at_the_end_that_nothing_reads_are_not_possible(tmp_path, deck, line):
    """A command of the deck, or one before its last run, with a word too many."""
    change = (
        (line, f"{line} surplus") if f"\n{line}\n" in DECKS[deck] else ("run 100", f"{line} surplus\nrun 100")
    )
    kind, sentence = remark(report(tmp_path, deck, change), "surplus")
    assert kind == "not possible" and "surplus" in sentence


@pytest.mark.parametrize(
    "lines",
    [
        [
            "compute c all reduce sum x",
            "dump d all image 10 f.jpg type type",
            "fix p all property/atom mine scalar yes no no 0",
        ],
        ["delete_atoms region box compress no", "restart 10 a b", "pair_style soft 1.0"],
    ],
)
def test_words_of_what_is_not_needed_are_permitted(tmp_path, lines):
    found = report(tmp_path, "lammps", ("group one", "\n".join([*lines, "group one"])))
    assert all("at the end of the line" not in sentence for _, _, _, sentence in found.report.lines())


@pytest.mark.parametrize(
    ("deck", "changes", "message"),
    [
        ("lammps", [(HOOKE, "pair_style granular")], "no pair_coeff gives the models of pair_style granular"),
        ("lammps", [("timestep", "units cgs\ntimestep")], "units follows the box"),
        (
            "lammps",
            [("fix i", "velocity all set 1 0 0 summ yes\nfix i")],
            "has no keyword summ. Did you mean sum?",
        ),
        (
            "lammps",
            [
                (
                    "fix i",
                    "region s sphere 0.05 0.05 0.05 0.01\nfix p all pour 10 1 7 region s diam one 0.004\nfix i",
                )
            ],
            "is a sphere; pour requires",
        ),
        (
            "lammps",
            [("fix g all gravity 9.81 vector 0 0 -1\n", "fix p all pour 10 1 7 region box diam one 0.004\n")],
            "fix pour needs a fix gravity along -z",
        ),
        ("lammps", [("diameter 0.004", "diameter 0")], "the diameter is 0; give a number above 0"),
        (
            "lammps",
            [("fix i", "fix p all pour 10 1 7 region box diam one 0.004 dens -1 -1\nfix i")],
            "the density is -1; give a number above 0",
        ),
        ("lammps", [("run 100", "run INF")], "the number of steps is INF"),
        *(
            ("lammps", [(before, after)], message)
            for before, after, message in (
                (
                    "diameter 0.004",
                    "diameter 1e300",
                    "the diameter is 1e300; give 0 or a magnitude from 1e-30",
                ),
                ("gravity 9.81", "gravity 1e-300", "is 1e-300; give 0 or a magnitude from 1e-30 to 1e"),
                ("create_box 2", "create_box 1e15", "types is 1e15; give a whole number from 1 to 1000"),
                (
                    "1 single 0.05 0.05 0.01",
                    "1 random -1 7 NULL",
                    "the number is -1; give a whole number from 0",
                ),
                (
                    "1 single 0.05 0.05 0.01",
                    "1 random 5 -1 NULL",
                    "the seed is -1; give a whole number from 1",
                ),
                (
                    "fix i",
                    "fix p all pour 0 1 7 region box\nfix i",
                    "particles is 0; give a whole number from 1",
                ),
                (
                    HOOKE,
                    GRANULAR.replace("0.9 0.3", "-0.5 0.3"),
                    "eta_n0 is -0.5; give 0 or a number above 0",
                ),
                ("NULL 100 NULL", "NULL -100 NULL", "gamma_n is -100; give 0 or a number above 0"),
                (
                    "run 100",
                    "thermo_modify lost ignore foo\nrun 100",
                    "thermo_modify has no keyword foo. The keyw",
                ),
                ("run 100", "thermo_modify lost\nrun 100", "the value of lost is missing"),
            )
        ),
        ("lammps", [(HOOKE, GRANULAR.replace("1e7", "0"))], "E is 0; give a number above 0"),
        *(
            (
                "lammps",
                [(HOOKE, GRANULAR.replace("0.9 0.3", f"0.9 {nu}"))],
                f"nu is {nu}; give a Poisson ratio",
            )
            for nu in ("1.3", "1", "-1")
        ),
        (
            "liggghts",
            [("fix i", "fix l all property/global surfaceLiquidContentInitial scalar -1\nfix i")],
            "surfaceLiquidContentInitial has the number -1; give one from 0 to inf",
        ),
        ("lammps", [("history 1e4", "history -1")], "Kn is -1; give a number above 0"),
        (
            "liggghts",
            [("particles_in_region 5", "particles_in_region 5 orientation up")],
            "orientation is up",
        ),
    ],
)
def test_errors(tmp_path, deck, changes, message):
    with pytest.raises(DeckError, match=message):
        report(tmp_path, deck, *changes)


def test_velocities_are_added(tmp_path):
    change = ("fix i", "velocity all set 1 NULL 2\nvelocity all set 1 3 NULL sum yes\nfix i")
    found = report(tmp_path, "lammps", change)
    rows = found.files["type1.csv"].decode().splitlines()
    values = dict(zip(rows[0].split(","), map(float, rows[1].split(",")), strict=True))
    assert [values[name] for name in ("vx", "vy", "vz")] == [2.0, 3.0, 2.0]


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("random", "random"),
        ("constant 0.5 0 0 0.8660254037844386", ([0, 0, 0.866025403784], "120 deg")),
        ("template", None),
    ],
)
def test_orientation_of_multispheres(tmp_path, words, expected):
    """A quaternion (cos(a/2), n sin(a/2)) turns by a about n."""
    template = (
        "particletemplate/multisphere 15485863 atom_type 1 density constant 2500 nspheres 2 ntry 1000 "
        "spheres -0.001 0 0 0.002 0.001 0 0 0.002 type 1"
    )
    sphere = "particletemplate/sphere 15485863 atom_type 1 density constant 2500 radius constant 0.002"
    inserted = (
        (sphere, template),
        ("all_in yes", f"orientation {words} all_in yes"),
        ("nve/sphere", "multisphere"),
    )
    (group,) = yaml.safe_load(report(tmp_path, "liggghts", *inserted).text)["particles"].values()
    orientation = group["clump"].get("orientation")
    if isinstance(expected, tuple):
        assert (orientation["axis"], orientation["angle"]) == expected
    else:
        assert orientation == expected


def test_restitution_that_is_not_the_number_of_the_script(tmp_path):
    """Tsuji's polynomial is a dashpot over sqrt(k M): the damping ratio of a Hertz spring is it over sqrt(5)."""
    found = report(tmp_path, "lammps", (HOOKE, f"{GRANULAR} damping tsuji"))
    zeta = tsuji(0.9) / sqrt(5.0)
    e = exp(-pi * zeta / sqrt(1.0 - zeta**2))
    kind, sentence = remark(found, "pair_coeff")
    assert kind == "translated"
    pairs = "type1-type1, type1-type2, type2-type2"
    assert (
        f"restitution of pairs.{pairs}: {e:.4g}, that of a collision in the code with damping tsuji of 0.9"
        in sentence
    )
    given = yaml.safe_load(found.text)["pairs"]["type1-type2"]["restitution"]
    assert given == pytest.approx(e, abs=1e-6)

    change = ("tangential history\npair", "tangential history limitForce on\npair")
    zeta = -log(0.6) / sqrt(pi**2 + log(0.6) ** 2)
    _, sentence = remark(report(tmp_path, "liggghts", change), "pair_style")
    assert (
        f"{free_restitution(zeta, True):.4g}, that of a collision in the code with 0.6 and limitForce"
        in sentence
    )
    _, sentence = remark(report(tmp_path, "liggghts"), "pair_style")
    assert "restitution of pairs" not in sentence  # it is the number of the script


SLIP = np.array([0.1, 0.5, 1.0, 1.3, 1.6, 1.8, 2.0, 2.5, 3.0, 4.0, 6.0])
"""Slip velocities of oblique impacts over the normal velocity."""


def friction_impulse(zeta, tangential, mu, has_tension, step=5e-4):
    """Friction impulses of oblique impacts of a sphere on a wall, by the law of LIGGGHTS (hertz, history).

    Units: mass, normal velocity and Hertz stiffness 1; Poisson ratio 0.3. `zeta`: damping ratio of Tsuji's dashpot;
    `tangential`: tangential over normal dashpot; without `has_tension` the normal force is at least 0.
    """
    ratio = 2 * 0.7 / 1.7  # 4 G* / E* = 2 (1 - nu) / (2 - nu)
    overlap, rate = 0.0, 1.0
    slip, impulse, displacement = SLIP.copy(), 0.0 * SLIP, 0.0 * SLIP
    while (overlap := overlap + step * rate) > 0.0:
        dashpot = sqrt(5.0) * zeta * overlap**0.25
        normal = overlap**1.5 + dashpot * rate
        if normal <= 0.0 and not has_tension:
            break
        rate -= step * normal
        displacement += step * slip
        spring = -1.5 * ratio * sqrt(overlap) * displacement
        limit = mu * abs(normal)
        is_sliding = np.abs(spring) > limit
        spring = np.clip(spring, -limit, limit)
        displacement = -spring / (1.5 * ratio * sqrt(overlap))
        force = spring - np.where(is_sliding, 0.0, tangential * dashpot * slip)
        impulse += step * force
        slip = slip + 3.5 * step * force  # 1 + m R^2 / I
    return impulse


@pytest.mark.parametrize(("e", "mu"), [(0.6, 0.4), (0.5, 0.5)])
def test_friction_while_the_dashpot_pulls(tmp_path, e, mu):
    """The remark has the largest difference of oblique impacts, which both laws have with the same restitution."""
    numbers = (
        "coefficientRestitution peratomtypepair 2 0.6 0.6 0.6 0.6",
        "coefficientRestitution peratomtypepair 2" + 4 * f" {e}",
    )
    friction = (
        "coefficientFriction peratomtypepair 2 0.4 0.4 0.4 0.4",
        "coefficientFriction peratomtypepair 2" + 4 * f" {mu}",
    )
    _, sentence = remark(report(tmp_path, "liggghts", numbers, friction), "pair_style")
    said = [
        float(each)
        for each in re.search(r"by up to about (\S+) of .* by (\S+) in the surface", sentence).groups()
    ]

    beta, zeta = -log(e) / sqrt(pi**2 + log(e) ** 2), damping_ratio_for(e)
    share = sqrt(2 * 0.7 / 1.7)
    code = friction_impulse(beta, share, mu, has_tension=True)
    scene = friction_impulse(zeta, share * beta / zeta, mu, has_tension=False)
    largest = np.abs(code - scene).max()
    assert said == pytest.approx([largest, 2.5 * largest], rel=0.12)


def test_no_friction_of_a_dashpot_that_does_not_pull(tmp_path):
    limited = ("tangential history\npair", "tangential history limitForce on\npair")
    assert (
        "the dashpot of the code pulls" not in remark(report(tmp_path, "liggghts", limited), "pair_style")[1]
    )
    slippery = (
        "coefficientFriction peratomtypepair 2 0.4 0.4 0.4 0.4",
        "coefficientFriction peratomtypepair 2 0 0 0 0",
    )
    assert (
        "the dashpot of the code pulls" not in remark(report(tmp_path, "liggghts", slippery), "pair_style")[1]
    )


@pytest.mark.parametrize(
    "model",
    [
        *("hooke 1e4 0.5 damping coeff_restitution", "hertz/material 1e7 0.5 0.3 damping coeff_restitution"),
        *("hooke 1e4 0.5 damping tsuji", "hertz 1e7 0.5 damping tsuji", "hertz 1e7 0.01 damping velocity"),
        *("hertz 1e7 100 rolling sds 1e3 0.01 0.1", "jkr 1e7 0.5 0.3 0.01 damping tsuji twisting marshall"),
        *(
            "dmt 1e7 0.5 0.3 0.01 damping tsuji",
            "hertz/material 1e7 100 0.3 limit_damping",
            "hooke 1e4 10 damping mass_velocity",
        ),
    ],
)
@pytest.mark.parametrize(
    "tangential", ["", "tangential linear_history 3e3 0.5 0.4", "tangential mindlin NULL 0.5 0.4"]
)
def test_models_of_granular_pass_the_check(tmp_path, model, tangential):
    pair = f"pair_style granular\npair_coeff * * {model} {tangential}"
    wall = f"fix w all wall/gran granular {model} {tangential} zplane 0 NULL\nfix i"
    found = report(tmp_path, "lammps", (HOOKE, pair), ("timestep 1e-5", "timestep 1e-7"), ("fix i", wall))
    for name, content in found.files.items():
        (tmp_path / name).write_bytes(content)
    (tmp_path / "scene.yaml").write_text(found.text)
    plan_for(gf.load_scene(tmp_path / "scene.yaml"))
    if "coeff_restitution" in model:
        assert {each["restitution"] for each in yaml.safe_load(found.text)["pairs"].values()} == {0.5}
    if "tsuji" in model:
        zeta = tsuji(0.5) / (2.0 if model.startswith("hooke") else sqrt(5.0))
        pairs = yaml.safe_load(found.text)["pairs"].values()
        assert all(
            each["restitution"] == pytest.approx(exp(-pi * zeta / sqrt(1 - zeta**2)), abs=1e-6)
            for each in pairs
        )


def test_restitution_of_a_range_of_sizes_is_that_of_the_mean_by_mass(tmp_path):
    """Numbers are equal for all diameters from a to b: the mean by mass is int d^4 / int d^3 = 4/5 (b^5 - a^5) / (b^4 - a^4)."""
    low, high = 0.004, 0.008
    mean = 0.8 * (high**5 - low**5) / (high**4 - low**4)
    found = []
    for diameters in (f"range {low} {high}", f"one {mean:.15g}"):
        atoms = LAMMPS[LAMMPS.index("create_atoms 1") : LAMMPS.index("group one")]
        pour = f"region r block 0.02 0.08 0.02 0.08 0.05 0.09\nfix p all pour 10 1 7 region r diam {diameters} dens 2500 2500\n"
        scene = yaml.safe_load(report(tmp_path, "lammps", (atoms, pour)).text)
        found.append(scene["pairs"]["type1-type1"]["restitution"])
    assert found[0] == pytest.approx(found[1], abs=1e-6) and found[0] < 0.99
