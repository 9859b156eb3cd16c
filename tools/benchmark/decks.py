"""Input decks of LIGGGHTS and LAMMPS for a case, from one template."""

from benchmark import cases
from benchmark.cases import Case, Steps

FIRST_STEP = "first_step.txt"
"""File to which a deck writes the time after the first step [s since 1970]."""

DECK = """{style}
boundary f f f
newton off
{communicate} vel yes
units si
processors {grid}
read_data case.data
neighbor {skin} bin
neigh_modify delay 0 every 1 check yes
{model}
pair_coeff * *
timestep {time_step}
fix weight all gravity {gravity} vector 0 0 -1
{walls}
fix motion all nve/sphere
compute touching all contact/atom
compute coordination all reduce ave c_touching
{mass}
thermo_style custom step atoms {shown}
thermo_modify lost {lost} norm no
thermo 1000000000
run 1
shell date +%s.%N > {first_step}
run {warm}
run {window}
thermo_style custom step atoms c_coordination {shown}
thermo_modify lost {lost} norm no
run 1
"""
MASS = "region above block INF INF INF INF 0.0 INF units box\nvariable above equal mass(all,above)"


def liggghts_deck(case: Case, steps: Steps, skin: float) -> str:
    """Hertz with tangential history; walls as primitives in a bed, as triangles in the hopper."""
    law = "model hertz tangential history"
    properties = "\n".join(
        (
            f"fix m1 all property/global youngsModulus peratomtype {cases.YOUNG_MODULUS}",
            f"fix m2 all property/global poissonsRatio peratomtype {cases.POISSON_RATIO}",
            f"fix m3 all property/global coefficientRestitution peratomtypepair 1 {cases.RESTITUTION}",
            f"fix m4 all property/global coefficientFriction peratomtypepair 1 {cases.FRICTION}",
            f"pair_style gran {law}",
        )
    )
    planes = (
        ("xplane", 0.0),
        ("xplane", case.sides[0]),
        ("yplane", 0.0),
        ("yplane", case.sides[1]),
        ("zplane", 0.0),
    )
    walls = "\n".join(
        f"fix wall{number} all wall/gran {law} primitive type 1 {plane} {place}"
        for number, (plane, place) in enumerate(planes)
    )
    if case.kind == "hopper":
        walls = (
            "fix mesh all mesh/surface file hopper.stl type 1\n"
            f"fix wall all wall/gran {law} mesh n_meshes 1 meshes mesh"
        )
    return _deck(case, steps, skin, "atom_style granular\natom_modify map array", "communicate single",
                 properties, walls)  # fmt: skip


def lammps_deck(case: Case, steps: Steps, skin: float) -> str:
    """gran/hertz/history; walls as planes in a bed, as regions in the hopper."""
    normal, tangential = cases.hertz_stiffnesses()
    damping = cases.lammps_damping()
    numbers = f"{normal:.6g} {tangential:.6g} {damping:.6g} {0.5 * damping:.6g} {cases.FRICTION} 1"
    law = f"hertz/history {numbers}"
    model = f"pair_style gran/hertz/history {numbers}"
    walls = "\n".join(
        f"fix wall_{axis} all wall/gran {law} {axis}plane 0.0 {high}"
        for axis, high in (("x", case.sides[0]), ("y", case.sides[1]), ("z", "NULL"))
    )
    if case.kind == "hopper":
        height = cases.CONE_HEIGHT
        orifice = cases.ORIFICE_RADIUS
        tube = cases.TUBE_RADIUS
        walls = (
            f"region tube cylinder z 0 0 {tube} {height} 1.0 side in units box open 1 open 2\n"
            f"region cone cone z 0 0 {orifice} {tube} 0.0 {height} side in units box open 1 open 2\n"
            f"region hopper union 2 tube cone\nfix wall all wall/gran/region {law} region hopper"
        )
    return _deck(case, steps, skin, "atom_style sphere", "comm_modify", model, walls)


def _deck(
    case: Case, steps: Steps, skin: float, style: str, communicate: str, model: str, walls: str
) -> str:  # fmt: skip
    hopper = case.kind == "hopper"
    return DECK.format(
        style=style, communicate=communicate, grid="* 1 1" if hopper else "* * 1", skin=skin, model=model,
        time_step=cases.TIME_STEP, gravity=cases.GRAVITY, walls=walls, mass=MASS if hopper else "",
        shown="v_above" if hopper else "", lost="ignore" if hopper else "error", first_step=FIRST_STEP,
        warm=steps.warm, window=steps.window
    )  # fmt: skip
