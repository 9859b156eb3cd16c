"""Small scripts of LIGGGHTS and LAMMPS, and their translations."""

import meshio
import yaml

import granflow as gf
from granflow.importing.convert import convert

_LIGGGHTS = """
atom_style granular
boundary {boundary}
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
fix floor all wall/gran {wall} primitive type 2 zplane 0.0
fix p1 all particletemplate/sphere 1 atom_type 1 density constant 2500 radius constant 0.002
fix p2 all particletemplate/sphere 1 atom_type 2 density constant 2500 radius constant 0.004
fix d all particledistribution/discrete 1 2 p1 0.25 p2 0.75
{insertion}
fix i all nve/sphere
{end}
"""
HERTZ = "model hertz tangential history"
WALL = f"wall/gran {HERTZ}"
PACK = "fix ins all insert/pack seed 1 distributiontemplate d all_in yes region box particles_in_region 50"
HEAT = (
    "fix h1 all property/global thermalConductivity peratomtype 100 50\n"
    "fix h2 all property/global thermalCapacity peratomtype 10 20\n"
)
HEATED = f"{HEAT}fix h3 all heat/gran initial_temperature 300"

_LAMMPS = """
units si
atom_style sphere
boundary {boundary}
region box block 0 0.1 0 0.1 0 0.2
create_box 2 box
{model}
timestep 1e-5
fix g all gravity {gravity}
region source block 0.04 0.06 0.04 0.06 0.1 0.15
{atoms}
fix i all nve/sphere
{end}
"""
HOOKE = "pair_style gran/hooke/history 1000 NULL 300 NULL 0.5 1\npair_coeff * *"
POUR = "fix p all pour 100 1 7 region source diam one 0.004 dens 2500 2500"
ATOMS = """create_atoms 1 single 0.05 0.05 0.01
create_atoms 2 single 0.05 0.05 0.02
set group all diameter 0.004
set group all density 2500
group one type 1
group two type 2"""


def pairwise(**values):
    """Properties of pairs of types, with one value for all pairs."""
    lines = (
        f"fix q{key} all property/global {key} peratomtypepair 2" + 4 * f" {x}" for key, x in values.items()
    )
    return "\n".join(lines) + "\n"


def liggghts(
    units="si", properties="", model=HERTZ, wall=None, insertion=PACK, end="run 1000", boundary="f f f"
):
    """A script with two types of particles, of 4 mm and 8 mm, that are inserted into the box above a floor."""
    return _LIGGGHTS.format(**{**locals(), "wall": wall or model})


def lammps(model=HOOKE, boundary="f f f", gravity="10 vector 0 0 -1", atoms=POUR, end="run 100"):
    """A script that pours particles of 4 mm, or has given `atoms`."""
    return _LAMMPS.format(**locals())


def imported(folder, text, **settings):
    """The translation of a script, and its scene as nested dictionaries."""
    (folder / "in.deck").write_text(text)
    found = convert(folder / "in.deck", **settings)
    return found, yaml.safe_load(found.text) if found.text else {}


def loaded(folder, found):
    """The scene, written with its files and loaded."""
    for name, content in found.files.items():
        (folder / name).write_bytes(content)
    (folder / "scene.yaml").write_text(found.text)
    return gf.load_scene(folder / "scene.yaml")


def at(scene, path):
    """The value of a key such as run.duration, or None."""
    for key in path.split("."):
        scene = scene.get(key)
    return scene


def remarks(found, part):
    """Kind and sentence of the lines of the report that contain a text."""
    return [(kind, sentence) for _, line, kind, sentence in found.report.lines() if part in line]


def write_square(path, side=0.02, low=(0.0, 0.0), level=0.0):
    """A mesh of a square in a plane z = level."""
    x, y = low
    points = [[x, y, level], [x + side, y, level], [x + side, y + side, level], [x, y + side, level]]
    meshio.Mesh(points, [("triangle", [[0, 1, 2], [0, 2, 3]])]).write(path)
