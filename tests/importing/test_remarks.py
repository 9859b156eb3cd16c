"""What a scene does not have: the kind and the reason in the report of the line, and errors of scripts."""

import pytest
from importing.decks import (
    ATOMS,
    HEATED,
    HERTZ,
    HOOKE,
    POUR,
    WALL,
    imported,
    lammps,
    liggghts,
    pairwise,
    remarks,
    write_square,
)

from granflow.errors import GranflowError

GRANULAR = "pair_style granular\npair_coeff * * hertz/material 1e7 0.9 0.3 tangential mindlin NULL 1 0"
ROLLING = pairwise(coefficientRollingFriction=0.1, coefficientRollingViscousDamping=0.1)
REGION = (
    "variable t equal step*dt\ncompute c all ke\nvariable c equal c_c\nregion r {}\n"
    "fix w all wall/gran/region hooke/history 1000 NULL 300 NULL 0.5 1 region r\nrun 100"
)
OUTPUT = (
    "compute c all reduce sum x\ndump d all image 10 f.jpg type type\npair_style soft 1.0\nrestart 10 a b\n"
    "fix p all property/atom mine scalar yes no no 0\ndelete_atoms region box compress no\n"
)
PLATE = "fix cad all mesh/surface file square.stl type 1"
MESH = "fix cad all mesh/surface/stress/servo file square.stl type 1 com 0 0 0 ctrlPV force axis 0 0 1 vel_max 0.2"
MESHES = f"fix w all {WALL} mesh n_meshes 1 meshes cad"
TURN = "fix m1 all move/mesh mesh cad rotate origin 0 0 0 axis 0 0 1 period 0.04"


def with_atoms(**parts):
    return lammps(**{"atoms": ATOMS, **parts})


@pytest.mark.parametrize(
    ("text", "part", "kind", "reason"),
    [
        (lammps().replace("units si\n", ""), "create_box", "approximated", "numbers of the default lj"),
        (lammps().replace("timestep 1e-5\n", ""), "run", "translated", "the default of units si"),
        (lammps(HOOKE.splitlines()[0]), "pair_style", "approximated", "requires pair_coeff * *"),
        (lammps(f"{GRANULAR} rolling ball 1"), "pair_coeff", "not possible", "the rolling model ball"),
        (lammps(GRANULAR.replace("mindlin", "mindlin_classic")), "pair_coeff", "not possible", "mindlin_classic"),
        (lammps(GRANULAR.replace("hertz/material 1e7 0.9 0.3", "dmt 1e7 0.9 0.3 0.1").replace("1 0", "1 0.5")),
         "pair_coeff", "approximated", "pull-off force Fp = 4 pi gamma R*"),
        # measured: without damping 0.0004 m/s in place of 0.19 m/s of friction in one impact
        (lammps(end="fix w all wall/gran hooke/history 1e4 NULL 9 NULL 0.5 0 zplane 0 NULL\nrun 9"), "fix w", "approximated", "less of it"),
        (lammps(f"{GRANULAR} damping none"), "pair_coeff", "not possible", "damping none"),
        (lammps(GRANULAR.replace("granular", "granular lj/cut")), "pair_style", "not possible", "lj/cut"),
        # half of sqrt(2 10 m/s2 0.2 m)
        (with_atoms(model=GRANULAR.replace("hertz/material 1e7 0.9 0.3", "hertz 1e7 0.9") + " damping velocity"),
         "pair_coeff", "approximated", "depends on the velocity; here it is that at 1 m/s"),
        (lammps("pair_style none", end="fix w all wall/gran hooke 1e4 NULL 100 NULL 0 1 zplane 0 NULL\nrun 9"),
         "pair_style none", "not possible", "without contacts with each other"),
        (with_atoms(atoms=ATOMS.replace("group one", f"{OUTPUT}group one")), "compute c", "not needed", ""),
        (with_atoms(end="neigh_modify exclude type 1 2\nrun 9"), "neigh_modify", "not possible", "exclude type 1 2"),
        (with_atoms(end="neigh_modify delay 0\nrun 9"), "neigh_modify", "not needed", "neighbor list"),
        (with_atoms(end="neigh_modify exclude group one one\nfix f one freeze\nrun 9"), "neigh_modify", "not needed", ""),
        (lammps().replace("nve/sphere", "nve"), "fix i", "approximated", "does not integrate the rotation"),
        (lammps().replace("nve/sphere", "nve/sphere disc"), "fix i", "not possible", "moments of inertia of discs"),
        (with_atoms().replace("nve/sphere", "rigid single"), "fix i", "not possible", "rigid bodies of particles"),
        (lammps(end="run 9\ncreate_atoms 1 single 0.05 0.05 0.05\nrun 9"), "0.05 0.05 0.05", "not possible", "after the"),
        (with_atoms(end="dump d one custom 10 f id\nrun 9"), "dump", "approximated", "not only those of one"),
        (with_atoms(model=GRANULAR, end=f"run 9\n{GRANULAR.splitlines()[1]}.5\nrun 9"), "NULL 1 0.5", "not possible", "change"),
        (with_atoms(boundary="p p p", end="fix v all viscous 1e-3\nfix s all deform 1 xy erate 2 remap v\nrun 9"),
         "viscous", "not possible", ""),
        (with_atoms(boundary="p p p", end="fix v all viscous 1e-3\nfix s all deform 1 x erate -0.5\nrun 9"),
         "deform", "not possible", "a box that deforms, together with damping"),
        (with_atoms(boundary="p p p", end="fix s all deform 1 x volume\nrun 9"), "fix s", "not possible", "x volume"),
        (with_atoms(boundary="p p p", end="fix s all press/berendsen iso 1 1 1\nrun 9"), "fix s", "not possible", "pressure"),
        (with_atoms(end="fix s all deform 1 x erate 1\nrun 9"), "fix s", "not possible", "without periodic boundaries"),
        (lammps(atoms="lattice sq 0.01\ncreate_atoms 1 region source\nset group all diameter 1"), "lattice sq", "not possible", ""),
        (with_atoms(end="fix v all viscous 1e-3\nrun 9\nfix v all viscous 2e-3\nrun 9"), "viscous 2e-3", "not possible", "damping that changes"),
        (with_atoms(end="fix v all damping/cundall 0.2 0.2\nfix w all damping/cundall 0.5 0.5\nrun 9"), "0.5", "not possible", "two Cundall"),
        (with_atoms(end="velocity two set 1 0 0\nfix f two freeze\nrun 9"), "freeze", "approximated", "their velocity acts on"),
        (with_atoms(end="run 9\nregion r block INF INF INF INF INF 1\ngroup late region r\nfix f late freeze\nrun 9"),
         "freeze", "not possible", "made at 9e-05 s"),
        (with_atoms(end="fix p one planeforce 0 0 1\nrun 9"), "planeforce", "not possible", "a layer one diameter thick"),
        (with_atoms(end="fix i all nve/spere\nrun 9"), "spere", "not possible", "nearest: nve/sphere"),
        (with_atoms(end="timestep 5e-6\nrun 9\ntimestep 1e-5\nrun 9"), "timestep 1e-5", "approximated", "from 5e-06 to 1e-05 s"),
        (liggghts(properties=pairwise(cohesionEnergyDensity=1e5), model=f"{HERTZ} cohesion sjkr tangential_reduce on"),
         "pair_style", "approximated", "does not lower the limit of friction"),
        (liggghts(properties=ROLLING + "fix r all property/global rollingStiffness scalar 3\n", model=f"{HERTZ} rolling_friction epsd3"),
         "pair_style", "approximated", "35.5 times"),  # 6 G*/E* = 3 (1 - nu) / (2 - nu), nu = 0.45, over 3 (0.1)^2
        (liggghts(properties=ROLLING, model=f"{HERTZ} rolling_friction cdt"), "pair_style", "approximated", "follows the normal force"),
        (liggghts(model=f"{HERTZ} ktToKnUser on"), "pair_style", "not possible", "ktToKnUser"),
        (liggghts(properties=ROLLING, model=f"{HERTZ} rolling_friction cdt", wall=f"{HERTZ} rolling_friction epsd2"),
         "fix floor", "approximated", "the rolling law is cdt for all contacts, here epsd2"),
        (liggghts().replace("fix g all", "group late type 1\nfix g late"), "fix g", "not possible", "members of all"),
        (liggghts().replace("fix i all", "group late type 1\nfix i late"), "fix i", "approximated", "does not move the"),
        (liggghts().replace("fix i all nve/sphere\n", ""), "run", "approximated", "no fix such as nve/sphere integrates"),
        (liggghts(end="run 50\nunfix i\nrun 50"), "fix i all", "approximated", "integrated in some runs only"),
        (liggghts().replace("all_in yes", "random_distribute uncorrelated"), "fix ins", "approximated", "are exact"),
        (liggghts().replace("0.0", "0.0 contact_area constant 1e-6", 1), "fix floor", "not possible", "contact_area constant"),
        (liggghts().replace("radius constant", "relative yes radius constant"), "fix p1", "not possible", "in percent"),
        (liggghts().replace("nve/sphere", "multisphere CAddRhoFluid 0.5 1000"), "fix i", "not possible", "added mass"),
        (liggghts(end="run 9\nfix m4 all property/global coefficientFriction peratomtypepair 2 0 0 0 0\nrun 9"),
         "2 0 0 0 0", "not possible", "coefficientFriction that changes"),
        (liggghts(properties="fix m5 all property/global characteristicVelocity scalar 1", end="run 9\npair_style gran model hooke\nrun 9"),
         "hooke", "not possible", "contact models that change"),
        (liggghts().replace("region box particles", "region both particles").replace(
            "fix ins", "region a block 0 0.05 0 0.1 0 0.1 units box\nregion both union 2 a box\nfix ins"),
         "fix ins", "not possible", "a region of the style union"),
        (liggghts().replace("insert/pack", "insert/pack/dense"), "fix ins", "not possible", "kind: pack"),
        (liggghts(end="fix h all heat/gran/radiation\nrun 10"), "radiation", "not possible", "radiation between particles"),
        (liggghts(end="fix h all wonder 1\nrun 10"), "wonder", "not possible", "fix wonder is not known"),
        (liggghts(end="marvel 1\nrun 10"), "marvel", "not possible", "the command marvel is not known"),
        (with_atoms(end="fix m two move linear 0 0 1\nrun 9"), "move linear", "not possible", "integrates and fix move"),
        (with_atoms(end="fix m two move transrot 0 0 1\nrun 9"), "move", "not possible", "the motion transrot"),
        (lammps(end="fix m all move linear 0 0 1\nrun 9"), "move linear", "not possible", "inserted particles"),
        (liggghts(end="fix f all addforce 0 0 1\nrun 10"), "addforce", "not possible", "different masses"),
        (liggghts(end="fix f all addforce v_x 0 1\nrun 10"), "addforce", "not possible", "a force that changes"),
        (liggghts(end="variable n equal atoms\nfix g all gravity v_n vector 0 0 1\nrun 10"), "v_n", "not possible", "follows"),
        (liggghts(properties="fix x all property/global thermalExpansion peratomtype 1 1"), "thermalE", "not possible", "thermal"),
        (liggghts(end="compute c all rainbow\nrun 10"), "rainbow", "not possible", "compute rainbow"),
        (liggghts(end="shell python x\nrun 10"), "shell", "not possible", "shell runs another program"),
        (liggghts(end="run 10\nclear\nunits si"), "clear", "not possible", "a second simulation"),
        (liggghts(end="fix w all wall/grann x\nrun 10"), "grann", "not possible", "nearest: wall/gran"),
        (liggghts(properties=HEATED, insertion="fix x all wonder").replace("fix floor", "#"), "wonder", "not possible", ""),
        (liggghts(properties=HEATED, end="run 1\nset atom 3 property/atom Temp 9\nrun 1"), "atom 3", "not possible", "values for"),
        (liggghts(properties=HEATED, end="group g type 1\nrun 1\nset group g property/atom Temp 9\nrun 1"), "set group", "not possible", ""),
        (liggghts(properties=HEATED, end="run 1\nset type 1 property/atom charge 9\nrun 1"), "charge", "not possible", "nearest"),
        (liggghts(properties=HEATED, end="set group all property/atom Temp 9\nrun 1"), "Temp 9", "not needed", "no particles yet"),
        (liggghts(properties=HEATED, end="run 1\nset group all property/atom Temp 9"), "Temp 9", "not needed", "no run follows"),
        (liggghts(properties=HEATED, end="fix s all property/atom heatSource scalar yes no no 0.5\nrun 1"),
         "heatSource", "translated", "particles.NAME.heat_source"),
        (lammps(boundary="p p f", end=REGION.format("cylinder z 0.05 0.05 0.05 0 INF")), "boundary", "translated", "not periodic along x: region r is around"),
        # by the length of the axis
        (lammps(end=REGION.format("block 0 0.1 0 0.1 0 0.2 rotate v_t 0.05 0.05 0.1 0 3 4")), "region r", "approximated", "5 times as fast"),
        (lammps(end=REGION.format("block 0 0.1 0 0.1 0 0.2 move NULL NULL v_c")), "region r", "not possible", "c_c is a result"),
        # A rotation is given before a translation: in the script its axis is at rest.
        (liggghts(end=f"{PLATE}\n{MESHES}\n{TURN}\nfix m2 all move/mesh mesh cad linear 1 0 0\nrun 9"), "fix m1", "approximated", "moves with the translation"),
        (liggghts(end=f"{PLATE}\n{MESHES}\n{TURN}\nfix m2 all move/mesh mesh cad linear 0 0 1\nrun 9"), "fix m1", "translated", ""),
        (liggghts(end=f"{PLATE} surface_vel 0.4 0 0.3\n{MESHES}\nrun 9"), "surface_vel", "approximated", "down to 0.8 of 0.5 m/s"),
        (liggghts(end=f"{MESH} target_val 1\n{MESHES}\nrun 9\nvariable f equal step\nfix_modify cad servo/target_val v_f\nrun 9"),
         "fix_modify", "not possible", "servo/target_val v_f of a servo"),
        (liggghts(end=f"{MESH} target_val 1\nrun 9\n{MESHES}\nrun 9"), "fix w", "approximated", "cad appears at 9e-05 s"),
        (liggghts(end=f"{PLATE}\n{MESHES}\n{TURN}\n{TURN.replace('m1', 'm2').replace('0 0 1', '1 0 0')}\nrun 9"),
         "fix m2", "not possible", "about an axis that is not parallel"),
    ],
)  # fmt: skip
def test_remark(tmp_path, text, part, kind, reason):
    write_square(tmp_path / "square.stl")
    found, _ = imported(tmp_path, text)
    assert [said for said in remarks(found, part) if said[0] == kind and reason in said[1]], remarks(
        found, part
    )


READ = {
    with_atoms: [
        *("timestep 1e-5", "boundary f f f", "create_box 2 box", "pair_coeff * *", "fix i all nve/sphere"),
        *(
            "velocity all zero linear",
            "delete_atoms region box",
            "reset_timestep 0",
            "unfix i",
            "fix f one freeze",
        ),
        *("set group all density 2500", "fix g all gravity 10 vector 0 0 -1"),
    ],
    liggghts: [
        *("units si", "fix m all multisphere", "thermo 10", "fix m all heat/gran initial_temperature 300"),
        "fix p1 all particletemplate/sphere 1 atom_type 1 density constant 2500 radius constant 0.002",
    ],
}


@pytest.mark.parametrize(("deck", "line"), [(deck, line) for deck, lines in READ.items() for line in lines])
def test_words_at_the_end_that_nothing_reads_are_not_possible(tmp_path, deck, line):
    """A command of the deck, or one before its last run, with a word too many."""
    text = deck() if f"\n{line}\n" in deck() else deck(end=f"{line}\nrun 100")
    found, _ = imported(tmp_path, text.replace(line, f"{line} surplus", 1))
    assert [kind for kind, _ in remarks(found, "surplus")] == ["not possible"]


@pytest.mark.parametrize(
    ("deck", "old", "new", "message"),
    [
        (liggghts, "timestep 1e-5", "timestep fast", "in.deck:14: the time step is fast, which is not a number"),
        (liggghts, "gravity 9.81", "gravity v_g", "in.deck:15: there is no variable g; define it"),
        (liggghts, "timestep 1e-5", "timestep -1", "the time step is -1; give a time above 0"),
        (liggghts, "5e6 1e7", "5e6", "youngsModulus has no number for type 2"),
        (liggghts, "0.45 0.3", "0.45 1.3", "poissonsRatio has the number 1.3; give one from 0 to 0.5"),
        (liggghts, "fix m3", "#", "needs fix property/global coefficientRestitution"),
        (liggghts, "0.1 0.2 0.2 0.3", "0.1 0.2 0.3 0.3", "not symmetric: types 1 and 2"),
        (liggghts, "model hertz", "modle hertz", "contact models have no keyword modle. Did you mean model"),
        (liggghts, "all_in yes", "allin yes", "insert/pack has no keyword allin. Did you mean all_in"),
        (liggghts, "distributiontemplate d", "distributiontemplate e", "no fix particledistribution/discrete e"),
        (liggghts, "run 1000", "unfix x", "there is no fix x to unfix"),
        (liggghts, "run 1000", "", "the script has no run"),
        (lambda: "title: A bed\n", "A bed", "A", "no line begins with a command of LIGGGHTS or LAMMPS"),
        (liggghts, "radius constant 0.002", "radius constant", "the radius is missing at the end"),
        (liggghts, "primitive type 2", "primitive type 3", "the type is 3, but the box is made for the types 1 to 2"),
        (liggghts, "run 1000", "run -5", "the number of steps is -5; give one of at least 0"),
        (liggghts, "fix i all", "fix i moving", "there is no group moving. Groups: all"),
        (liggghts, "2 p1 0.25 p2", "2 p1 0.25 p3", "there is no particle template p3. Templates: p1, p2"),
        (liggghts, "particles_in_region 50", "volumefraction_region 1.5", "fraction is 1.5; give one below 1"),
        (liggghts, "fix i", "fix l all property/global surfaceLiquidContentInitial scalar -1\nfix i", "give one from 0 to inf"),
        (liggghts, "primitive type 2 zplane 0.0", "mesh n_meshes 2 meshes a", "n_meshes is 2, but fewer names follow"),
        (liggghts, "run", f"{MESH}\nfix w all {WALL} mesh n_meshes 0 meshes cad\nrun", "n_meshes is 0, but the mesh cad follows"),
        (liggghts, "run", f"{MESH} target_val 1\n{MESHES}\nrun 9\nunfix cad\nrun", "fix w uses the mesh cad; unfix w"),
        (liggghts, "run", f"{MESH}\n{MESHES}\nfix_modify cad integrate stop\nrun", "a servo needs target_val"),
        (liggghts, "run", "fix cad all mesh/surface file no.stl type 1\nrun", "there is no such file"),
        (liggghts, "run", "fix m all move/mesh mesh cad linear 1 0 0\nrun", "there is no fix mesh/surface cad"),
        (liggghts, "region box block", "region box ball", "there is no region style ball"),
        (liggghts, "run", "region r sphere 0 0 0 -1 units box\nrun", "the radius is -1"),
        (liggghts, "boundary f f f", "boundary f f q", "the boundary of z is q"),
        (lammps, "region source", "lattice custom 0.01 a1 2 0 0 a2 0 1 0 a3 0 0 1 basis 0 0 0\nregion source", "other lengths along x, y and z"),
        (lammps, HOOKE, "pair_style granular", "no pair_coeff gives the models of pair_style granular"),
        (lammps, "timestep", "units cgs\ntimestep", "units follows the box"),
        (lammps, POUR, f"{ATOMS}\nvelocity all set 1 0 0 summ yes", "has no keyword summ. Did you mean sum"),
        (lammps, "source block 0.04 0.06 0.04 0.06 0.1 0.15", "source sphere 0.05 0.05 0.05 0.01", "is a sphere; pour requires"),
        (lammps, "fix g all gravity 10 vector 0 0 -1\n", "", "fix pour needs a fix gravity along -z"),
        (lammps, "pour 100", "pour 0", "particles is 0; give a whole number from 1"),
        (lammps, "gravity 10", "gravity 1e-300", "is 1e-300; give 0 or a magnitude from 1e-30 to 1e"),
        (lammps, HOOKE, GRANULAR.replace("0.9 0.3", "0.9 1"), "nu is 1; give a Poisson ratio"),
        (lammps, "history 1000", "history -1", "Kn is -1; give a number above 0"),
        (lammps, "run 100", "thermo_modify lost ignore foo\nrun 100", "thermo_modify has no keyword foo"),
    ],
)  # fmt: skip
def test_errors(tmp_path, deck, old, new, message):
    write_square(tmp_path / "square.stl")
    assert old in deck()
    with pytest.raises(GranflowError, match=message):
        imported(tmp_path, deck().replace(old, new, 1))
