"""Walls, meshes, motions, boxes and lattices of scripts: keys and geometry of small scripts."""

from math import cos, pi, sin

import numpy as np
import pytest
from importing.decks import ATOMS, HOOKE, WALL, imported, lammps, liggghts, loaded, remarks, write_square

from granflow.importing.language import DeckError
from granflow.plan.build import plan_for
from granflow.scene.blocks.motions import poses_at
from granflow.units import to_si

SPRING = "hooke/history 1e4 NULL 100 NULL 0.5 1"
MOVED = f"fix w all {WALL} mesh n_meshes 1 meshes cad\n"
FILE = "mesh/surface file square.stl type 1"
SERVO = "com 0 0 0 ctrlPV force axis 0 0 1 target_val -10 vel_max 0.2 kp 5"


@pytest.fixture
def square(tmp_path):
    """A square of 20 mm in the plane z = 0, with a corner at the origin."""
    write_square(tmp_path / "square.stl")
    return FILE


def turning(axis, point, rate):
    """A motion of a wall."""
    return {"motion": {"kind": "rotation", "point": point, "axis": axis, "angular_velocity": f"{rate} rad/s"}}


def plain(wall):
    """A script of LIGGGHTS with a primitive wall."""
    return liggghts(end=f"fix w all {WALL} primitive type 1 {wall}\nrun 9")


def bounded(wall):
    """A script of LAMMPS with a wall."""
    return lammps(end=f"fix w all wall/gran {SPRING} {wall}\nrun 9")


def around(region, second=""):
    """A script of LAMMPS with a wall around a region, or around the union of two."""
    union = f"region b {second}\nregion r union 2 a b\n" if second else ""
    first = f"region {'a' if second else 'r'} {region}\n"
    return lammps(end=f"{first}{union}fix w all wall/gran/region {SPRING} region r\nrun 100")


TUBE, CONE = "cylinder z 0.05 0.05 0.04 0.1 0.2", "cone z 0.05 0.05 0.01 0.04 0 0.1 open 1 open 2"


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (plain("zplane 0.2"), {"w": {"shape": "plane", "point": [0, 0, "200 mm"], "normal": [0, 0, -1]}}),
        # inside the box: particles on both sides
        (plain("zplane 0.05"), {"w": {"shape": "rectangle", "corner": ["-100 mm", "-100 mm", "50 mm"],
                                      "sides": [["300 mm", 0, 0], [0, "300 mm", 0]]}}),
        (plain("zcylinder 0.04 0.05 0.06"), {"w": {
            "shape": "cylinder", "from": ["50 mm", "60 mm", "-200 mm"], "to": ["50 mm", "60 mm", "400 mm"], "radius": "40 mm"}}),
        (plain("zplane 0.0 contact_area overlap shear x 0.5"),
         {"w": {"motion": {"kind": "surface_velocity", "velocity": ["500 mm/s", 0, 0]}}}),
        # as measured: no velocity of the surface
        (plain("zcylinder 0.05 0.05 0.05 shear x 0.5"), {"w": turning([0, 0, 1], ["50 mm", "50 mm", 0], 0.5)}),
        (liggghts(end=f"fix cad all {FILE} surface_vel 0.4 0 0.3\n{MOVED}run 9"),
         {"cad": {"motion": {"kind": "surface_velocity", "velocity": ["400 mm/s", 0, "300 mm/s"]}}}),
        (bounded("zplane 0 0.2"), {"w_low": {"normal": [0, 0, 1]}, "w_high": {"normal": [0, 0, -1]}}),
        (bounded("xplane NULL 0.1"), {"w": {"point": ["100 mm", 0, 0], "normal": [-1, 0, 0]}}),
        # at 1 mm - 1 mm cos(w t), as sin(w t - 90 deg) + 1
        (bounded("zplane 0 NULL wiggle z 0.001 0.02"), {"w": {"motion": {
            "kind": "vibration", "direction": [0, 0, 1], "amplitude": "1 mm", "frequency": "50 Hz", "phase": "-90 deg"}}}),
        (bounded("zcylinder 0.05 shear y 0.5"), {"w": turning([0, 0, 1], [0, 0, 0], -10)}),
        (around("block 0 0.1 0 0.1 0 0.2"), {"w": {"shape": "box", "min": [0, 0, 0], "max": ["100 mm", "100 mm", "200 mm"]}}),
        (around("block 0 0.1 0 0.1 0 0.2 open 6"), {"w": {"open": ["top"], "finite": True}}),
        (around("block 0.04 0.06 0.04 0.06 0 0.02 side out"), {"w": {"shape": "box", "finite": True}}),
        (around("sphere 0.05 0.05 0.1 0.04"), {"w": {"shape": "sphere", "radius": "40 mm"}}),
        (around("plane 0 0 0.01 0 0 2"), {"w": {"shape": "plane", "normal": [0, 0, 2]}}),
        (around("plane 0 0 0.01 0 0 -1 side out"), {"w": {"shape": "plane", "normal": [0, 0, 1]}}),
        (around("cylinder z 0.05 0.05 0.04 0 0.2"), {"w_bottom": {"radius": "40 mm"}, "w_top": {}, "w_side": {"shape": "cylinder"}}),
        (around("cone z 0.05 0.05 0.01 0.04 0 0.2 open 1 open 2"), {"w": {"shape": "cone", "radius_from": "10 mm"}}),
        (around("cylinder z 0.05 0.05 0.01 0 0.1", "cone z 0.05 0.05 0.01 0.04 0.1 0.2 open 2"),
         {"w_a_bottom": {}, "w_a_side": {}, "w_b": {}}),
        # LAMMPS hides no face behind a region with open faces: measured, a tube without `open` keeps its bottom.
        (around(TUBE, CONE), {"w_a_bottom": {}, "w_a_top": {}, "w_a_side": {}, "w_b": {}}),
        (around(f"{TUBE} open 1", CONE), {"w_a_top": {}, "w_a_side": {}, "w_b": {}}),
        (around("cylinder z 0.05 0.05 0.02 0 0.1", "block 0 0.1 0 0.1 0.1 0.2 open 6"), "the face bottom of region b has an opening"),
        # The part of a sphere inside of the block of a union is no wall; half of it is an opening of the block.
        (around("sphere 0.05 0.05 0.1 0.02", "block 0 0.1 0 0.1 0 0.1"), "the face sphere of region a has an opening"),
    ],
)  # fmt: skip
def test_wall(tmp_path, square, text, expected):
    found, scene = imported(tmp_path, text)
    if isinstance(expected, str):
        assert expected in str(remarks(found, "fix w"))
        return
    assert {name for name in scene["walls"] if name != "floor"} == set(expected)
    for name, keys in expected.items():
        assert keys.items() <= scene["walls"][name].items()
    loaded(tmp_path, found)


# Meshes


@pytest.mark.parametrize(
    ("units", "scale", "expected"),
    [("si", 2.0, [[-0.04, 0.02, 0.03], [0.0, 0.06, 0.03]]), ("cgs", 2.0, [[-4e-4, 2e-4, 3e-4], [0, 6e-4, 3e-4]])],
)  # fmt: skip
def test_mesh_is_transformed_in_the_order_of_the_script(tmp_path, square, units, scale, expected):
    """x of 10 to 30 mm is doubled to 20 to 60 mm and turned to y; y of 0 to 40 mm to -x. The file and the
    displacement are in the unit of the script."""
    steps = "move 0.01 0 0 scale 2.0 rotate axis 0 0 1 angle 90 move 0 0 0.03"
    found, _ = imported(tmp_path, liggghts(units=units, end=f"fix cad all {square} {steps}\n{MOVED}run 9"))
    mesh = loaded(tmp_path, found).walls["cad"].surface(tmp_path)
    np.testing.assert_allclose([mesh.points.min(axis=0), mesh.points.max(axis=0)], expected, atol=1e-7)


@pytest.mark.parametrize(
    ("style", "time", "place"),
    [
        ("linear 0.1 0 0.2", 0.02, [0.002, 0, 0.004]),
        ("wiggle amplitude 0 0 0.001 period 0.02", 0.005, [0, 0, 0.001]),
        ("viblin axis 0 0 2 order 2 amplitude 0.001 0.002 phase 0 0.5 period 0.02 0.05", 0.013,
         [0, 0, 0.001 * (cos(1.3 * pi) - 1) + 0.002 * (cos(0.52 * pi + 0.5) - cos(0.5))]),
        ("rotate origin 0 0 0 axis 0 0 1 period 0.08", 0.02, [0, 0, 0]),
        ("riggle origin 0.02 0 0 axis 0 0 1 period 0.04 amplitude 30", 0.01,
         [0.02 - 0.02 * cos(pi / 6), -0.02 * sin(pi / 6), 0]),
        ("vibrot origin 0.02 0 0 axis 0 0 -1 order 1 amplitude 0.5 phase 0 period 0.02", 0.01,
         [0.02 - 0.02 * cos(1.0), -0.02 * sin(1.0), 0]),
        ("linear/variable v_a v_b v_b", 0.02, [0.0002, 0, 0]),
        ("rotate/variable origin 0.02 0 0 axis 0 0 1 omega v_w", 0.02,
         [0.02 - 0.02 * cos(0.2), -0.02 * sin(0.2), 0]),
    ],
)  # fmt: skip
def test_place_of_a_moving_mesh(tmp_path, square, style, time, place):
    """The corner at the origin, after a time."""
    variables = "variable a equal step*1e-5\nvariable b equal 0\nvariable w equal 1e-2*step\n"
    walls = f"{variables}fix cad all {square}\n{MOVED}fix move all move/mesh mesh cad {style}\nrun 2000"
    found, _ = imported(tmp_path, liggghts(end=walls))
    assert found.report.is_complete
    wall = next(wall for wall in plan_for(loaded(tmp_path, found)).walls if wall.motions)
    poses = poses_at(wall.motions, np.array([time]))
    corner = poses.rotation[0] @ (0 - poses.pivot) + poses.pivot + poses.offset[0]
    # Velocities that are linear between 100 rows per period: angles up to 1 rad within (2 pi/100)^2 / 12.
    np.testing.assert_allclose(corner, place, atol=0.02 * (2 * pi / 100) ** 2 / 12)


def test_motions_of_a_mesh_in_sequence(tmp_path, square):
    """A translation that ends shifts the axis of the rotation that follows, in the frame of the mesh at rest: it is
    30 mm - 0.5 m/s 20 ms. A wall that is given again with one of two meshes ends the other one."""
    walls = (
        f"fix cad all {square}\nfix plug all {square} move 0 0 0.1\n"
        f"fix w all {WALL} mesh n_meshes 2 meshes cad plug\n"
        "fix m1 all move/mesh mesh cad linear 0.5 0 0\nrun 2000\nunfix m1\nunfix w\n"
        f"{MOVED}fix m2 all move/mesh mesh cad rotate origin 0.03 0 0 axis 0 0 1 period -0.5\nrun 1000"
    )
    found, scene = imported(tmp_path, liggghts(end=walls))
    translation, rotation = scene["walls"]["cad"]["motion"]
    assert translation == {"kind": "translation", "velocity": ["500 mm/s", 0, 0], "stages": ["stage_1"]}
    assert rotation["point"] == ["20 mm", 0, 0]
    assert rotation["angular_velocity"] == f"{-4 * pi:.12g} rad/s" and rotation["stages"] == ["stage_2"]
    assert "stages" not in scene["walls"]["cad"] and scene["walls"]["plug"]["stages"] == ["stage_1"]
    assert found.report.is_complete


TURN = "fix m1 all move/mesh mesh cad rotate origin 0 0 0 axis 0 0 1 period 0.04\n"


def rotated(axis, angle, point, x):
    """A point after a rotation by an angle [rad] about an axis x or z through a point."""
    c, s = cos(angle), sin(angle)
    turn = [[c, -s, 0], [s, c, 0], [0, 0, 1]] if axis == "z" else [[1, 0, 0], [0, c, -s], [0, s, c]]
    return np.array(turn) @ (np.array(x) - point) + point


@pytest.mark.parametrize(
    ("moves", "corner"),
    [
        # planetary: the second axis is carried along by the first rotation, and is at (0.02, 0, 0) when it begins
        (
            f"{TURN}fix m2 all move/mesh mesh cad rotate origin 0.02 0 0 axis 0 0 1 period -0.03\nrun 1000",
            lambda x: rotated("z", pi / 2, [0, 0, 0], rotated("z", -2 * pi / 3, [0.02, 0, 0], x)),
        ),
        # one after the other: the second axis is at rest in space
        (
            f"{TURN}run 1000\nunfix m1\n"
            "fix m2 all move/mesh mesh cad rotate origin 0 0.01 0 axis 1 0 0 period 0.08\nrun 1000",
            lambda x: rotated("x", pi / 4, [0, 0.01, 0], rotated("z", pi / 2, [0, 0, 0], x)),
        ),
    ],
)
def test_rotations_of_a_mesh_are_a_chain(tmp_path, square, moves, corner):
    """The first place is that of LIGGGHTS 3.8, to 1e-7 m, with ten times these lengths."""
    walls = f"fix cad all {square} move 0.01 0.002 0.003\n{MOVED}{moves}"
    found, _ = imported(tmp_path, liggghts(end=walls))
    assert found.report.is_complete
    wall = next(wall for wall in plan_for(loaded(tmp_path, found)).walls if wall.motions)
    place = np.array([0.01, 0.002, 0.003])
    for motion in reversed(wall.motions):  # each acts for 10 ms; the last is in the frame of those before
        pose = poses_at([motion], np.array([0.01]))
        place = pose.rotation[0] @ (place - pose.pivot) + pose.pivot + pose.offset[0]
    np.testing.assert_allclose(place, corner([0.01, 0.002, 0.003]), atol=1e-9)


def test_servo(tmp_path, square):
    """The plate is at rest while particles fall, presses with 10 N, rests, presses with 10 N and with 5 N."""
    style = square.replace("mesh/surface", "mesh/surface/stress/servo")
    runs = (
        "fix_modify cad integrate stop\nrun 100\nfix_modify cad integrate start\nrun 200\n"
        "fix_modify cad integrate stop\nrun 300\nfix_modify cad integrate start\nrun 400\n"
        "fix_modify cad target_val -5\nrun 500"
    )
    found, scene = imported(tmp_path, liggghts(end=f"fix cad all {style} {SERVO}\n{MOVED}{runs}"))
    motions = scene["walls"]["cad"]["motion"]
    assert [(each.pop("force"), each.pop("stages")) for each in motions] == [
        ("10 N", ["stage_2"]),
        ("10 N", ["stage_4"]),
        ("5 N", ["stage_5"]),
    ]
    assert motions[0] == {"kind": "servo", "direction": [0, 0, -1], "velocity_max": "200 mm/s"}
    assert scene["output"]["wall_forces"] == ["cad"]
    assert [each["duration"] for each in scene["stages"]] == ["1 ms", "2 ms", "3 ms", "4 ms", "5 ms"]
    loaded(tmp_path, found)


def test_wear_by_the_model_of_finnie(tmp_path, square):
    """k_finnie of a mesh of type 2 and particles of both types, in 1/(dyn/cm2) = 10/Pa."""
    style = square.replace("mesh/surface", "mesh/surface/stress").replace("type 1", "type 2")
    given = "fix m5 all property/global k_finnie peratomtypepair 2 1e-9 3e-9 3e-9 4e-9"
    text = liggghts("cgs", given, end=f"fix cad all {style} wear finnie\n{MOVED}run 9")
    found, scene = imported(tmp_path, text)
    assert found.report.is_complete
    coefficient = {"type1": "3e-08", "type2": "4e-08"}
    assert scene["walls"]["cad"]["wear"] == {"law": "finnie", "coefficient": coefficient, "hardness": "1 Pa"}
    with pytest.raises(DeckError, match="wear finnie needs fix property/global k_finnie"):
        imported(tmp_path, text.replace(given, ""))


def test_mass_flow_through_a_mesh(tmp_path, square):
    flow = f"fix cad all {square} move 0 0 0.05\nfix flow all massflow/mesh mesh cad vec_side 0.2 0 -1 "
    found, scene = imported(tmp_path, liggghts(end=f"{flow} count once delete_atoms yes\nrun 9"))
    assert scene["output"]["flow_meters"]["flow"]["normal"] == [0, 0, -1]
    box = scene["outlets"]["flow"]["box"]
    assert box["min"][:2] == [0, 0] and box["max"][2] == "50 mm"
    assert [float(each.split()[0]) for each in box["max"][:2]] == pytest.approx([20, 20], rel=1e-7)
    loaded(tmp_path, found)


@pytest.mark.parametrize(("all_in", "margin"), [("no", 0.0035), ("yes", 0.0)])
def test_stream_through_a_face(tmp_path, square, all_in, margin):
    """Centers pass the mesh with the given velocity, on all of it, after a way of at least a radius.

    granflow places spheres downstream of the face, within its sides, so that it lies a radius before the mesh. The
    mean radius by mass is 0.25 x 2 mm + 0.75 x 4 mm = 3.5 mm; 2 m/s along x are not across the face.
    """
    stream = (
        f"fix face all {square} move 0.01 0.01 0.1\nfix s all insert/stream seed 1 distributiontemplate d "
        f"nparticles 50 particlerate 100 all_in {all_in} vel constant 2 0 -0.7 insertion_face face extrude_length 0.02"
    )
    found, _ = imported(tmp_path, liggghts(insertion=stream).replace("atom_type 2", "atom_type 1"))
    insert = loaded(tmp_path, found).particles["s"].insert
    outline = insert.face.rectangle
    corners = np.array([outline.corner, np.add(outline.corner, np.sum(outline.sides, axis=0))])
    np.testing.assert_allclose(corners.min(axis=0), [0.01 - margin, 0.01 - margin, 0.1035], atol=1e-9)
    np.testing.assert_allclose(corners.max(axis=0), [0.03 + margin, 0.03 + margin, 0.1035], atol=1e-9)
    assert insert.face.normal.tolist() == [0, 0, -1]
    assert insert.start == pytest.approx(0.0035 / 0.7)


# Regions


def test_region_that_turns_between_runs(tmp_path):
    """Each definition is a wall of its own; the second begins at 0.2 rad and turns by 2 rad/s."""
    block = "region r block 0.01 0.09 0.01 0.09 0 0.2"
    walls = (
        f"{block}\nfix w all wall/gran/region {SPRING} region r\nrun 1000\nregion r delete\n"
        f"variable theta equal 0.2+2*(step-1000)*dt\n{block} rotate v_theta 0.05 0.05 0 0 0 1\nrun 2000"
    )
    _, scene = imported(tmp_path, lammps(end=walls))
    assert scene["walls"]["w"]["stages"] == ["stage_1"]
    left = scene["walls"]["w_2_left"]
    assert left["stages"] == ["stage_2"] and left["motion"]["angular_velocity"] == "2 rad/s"
    corner = np.array([float(each.split()[0]) for each in left["corner"][:2]])
    offset = 40 * np.array([-cos(0.2) + sin(0.2), -sin(0.2) - cos(0.2)])  # (-40, -40) mm turned by 0.2 rad
    np.testing.assert_allclose(corner, 50 + offset, atol=1e-6)


@pytest.mark.parametrize(
    ("shape", "stages"),
    [
        ("cylinder y 0.05 0.1 0.04 INF INF", [None]),
        ("block 0.01 0.09 INF INF 0.05 0.15", ["stage_1", "stage_2"]),
        ("cylinder y 0.06 0.1 0.03 INF INF", ["stage_1", "stage_2"]),
    ],
)
def test_angle_that_begins_again_with_each_run(tmp_path, shape, stages):
    """The step `elapsed` is 0 at the beginning of a run. A cylinder about its own axis turns on at 2 rad/s, as one
    wall; another region jumps by 0.04 rad, and is a wall of its own in each run."""
    walls = (
        f"variable theta equal 2*elapsed*dt\nregion r {shape} rotate v_theta 0.05 0 0.1 0 1 0\n"
        f"fix w all wall/gran/region {SPRING} region r\nrun 2000\nrun 2000"
    )
    _, scene = imported(tmp_path, lammps(end=walls))
    found = list(scene["walls"].values())
    assert [each.get("stages", [None])[0] for each in found] == stages
    assert {each["motion"]["angular_velocity"] for each in found} == {"2 rad/s"}


def test_region_that_swings_is_a_table(tmp_path):
    walls = (
        "variable dz equal 0.001*sin(2*PI*100*step*dt)\nregion r block 0 0.1 0 0.1 0 0.2 move NULL NULL v_dz\n"
        f"fix w all wall/gran/region {SPRING} region r\nrun 2000"
    )
    found, scene = imported(tmp_path, lammps(end=walls))
    motion = scene["walls"]["w"]["motion"]
    rows = np.loadtxt(found.files[motion["file"]].decode().splitlines(), skiprows=1, delimiter=",")
    assert motion["direction"] == [0, 0, 1]
    np.testing.assert_allclose(rows[:, 1], 1e-3 * np.sin(200 * pi * rows[:, 0]), atol=1e-9)


# Boxes that deform


def periodic(deformation):
    """A script of LAMMPS with particles in a periodic box, without gravity and walls."""
    text = lammps(boundary="p p p", atoms=ATOMS, end=deformation)
    return text.replace("fix g all gravity 10 vector 0 0 -1", "")


def test_shear_of_the_box(tmp_path):
    _, scene = imported(tmp_path, periodic("fix s all deform 1 xz erate 20 remap v\nrun 100"))
    assert scene["domain"]["lees_edwards"] == {"flow": "x", "gradient": "z", "rate": "20 1/s"}


def test_widths_that_change(tmp_path):
    """erate -0.5 1/s for 0.4 s leaves 0.8 of the width: the logarithmic rate is ln 0.8 / 0.4 s; trate is this rate.

    The ratio of the linear and the exponential course, (1 + (F - 1) s) F^-s, is largest at 1 + (F - 1) s = (F - 1) / ln F.
    """
    found, scene = imported(tmp_path, periodic("fix s all deform 1 x erate -0.5 z trate 0.1\nrun 40000"))
    deformation = scene["domain"]["deformation"]
    rates = {axis: to_si(each["strain_rate"], "rate") for axis, each in deformation.items()}
    assert rates == pytest.approx({"x": np.log(0.8) / 0.4, "z": 0.1})
    width = (0.8 - 1) / np.log(0.8)
    deviation = width / 0.8 ** ((width - 1) / (0.8 - 1)) - 1
    assert f"up to {100 * deviation:.2g} % from that of the script" in str(remarks(found, "deform"))
    loaded(tmp_path, found)


def test_widths_that_change_in_one_of_three_runs(tmp_path):
    text = periodic("run 1000\nfix s all deform 1 y vel -1.0\nrun 5000\nunfix s\nrun 1000")
    found, scene = imported(tmp_path, text)
    assert "deformation" not in scene["domain"]
    first, second, third = scene["stages"]
    assert "deformation" not in first and third["deformation"] == {"y": {"strain_rate": 0}}
    assert to_si(second["deformation"]["y"]["strain_rate"], "rate") == pytest.approx(np.log(0.5) / 0.05)
    loaded(tmp_path, found)


# Lattices, groups and clumps


CHUTE = lammps(
    boundary="p p f",
    atoms="""region base block INF INF INF INF INF 0.6
region bulk block INF INF INF INF 1.0 3.0
create_atoms 2 region base
create_atoms 1 region bulk
set group all diameter 0.8 density 2.5
group bottom region base
group mobile subtract all bottom
velocity mobile set 2 0 0""",
    end="fix g mobile gravity 981 chute 20\nrun 10",
)


@pytest.mark.parametrize(
    "integrators", ["fix i mobile nve/sphere", "fix f bottom freeze\nfix i all nve/sphere"]
)
def test_particles_on_a_lattice_over_a_rough_bottom(tmp_path, integrators):
    """Two points for each of the 6 cells of a layer: bottom layers at 0 and 0.5, bulk at 1, 1.5, ... 3 cm.
    2 lattices per second are 2 cm/s."""
    text = CHUTE.replace("units si", "units cgs\nlattice bcc 1.0").replace(
        "0 0.1 0 0.1 0 0.2", "0 2 0 3 0 10"
    )
    found, scene = imported(tmp_path, text.replace("fix i all nve/sphere", integrators))
    assert found.report.is_complete and set(scene["particles"]) == {"start_type1", "start_type2_fixed"}
    assert scene["particles"]["start_type2_fixed"]["fixed"] is True
    fixed, moving = (
        np.loadtxt(found.files[name].decode().splitlines(), delimiter=",", skiprows=1)
        for name in ("type2_fixed.csv", "type1.csv")
    )
    assert len(fixed) == 2 * 6 and len(moving) == 5 * 6
    assert sorted({*fixed[:, 2]}) == [0.0, 0.005] and moving[:, 2].max() == 0.03
    np.testing.assert_allclose(moving[:, 3:5], [[0.004, 0.02]] * 30)
    loaded(tmp_path, found)
    found, _ = imported(tmp_path, text)
    assert "on the group mobile only" in str(remarks(found, "fix g"))


CUSTOM = lammps(
    HOOKE.replace("history", "history/omp"),
    atoms="""lattice custom 0.01 a1 2 0 0 a2 0 1 0 a3 0 0 1 basis 0 0 0 basis 0.5 0.5 0.5 origin 0.1 0.1 0.1
region some block 0 0.06 0 0.03 0 0.02 units box
create_atoms 1 region some
set group all diameter 0.004 density 2500
region low block INF INF INF INF -1 0.004 units box
group low region low""",
    end="{}\nrun 10",
).replace("nve/sphere", "nve/sphere/kk")


@pytest.mark.parametrize("width", [0.1, 50.0])  # the wide box has more cells than are tried
def test_particles_on_a_lattice_of_its_own(tmp_path, width):
    """Cells of 20, 10 and 10 mm with a particle at the corner and in the middle, moved by a tenth of a cell."""
    found, _ = imported(tmp_path, CUSTOM.format("").replace("block 0 0.1", f"block 0 {width}"))
    assert found.report.is_complete
    points = np.loadtxt(found.files["type1.csv"].decode().splitlines(), delimiter=",", skiprows=1)[:, :3]
    expected = {
        (0.002 + 0.02 * i + 0.01 * k, 0.001 + 0.01 * j + 0.005 * k, 0.001 + 0.01 * n + 0.005 * k)
        for i in range(3) for j in range(3) for n in range(2) for k in range(2)
    }  # fmt: skip
    assert {tuple(row) for row in points.round(9).tolist()} == {
        tuple(round(each, 9) for each in row) for row in expected
    }


@pytest.mark.parametrize(
    ("fixes", "kind"),
    [
        ("fix s low setforce 0 0 0", "approximated"),
        ("fix s low setforce 0.0 0.0 0.0\nvelocity low set 0.1 0 0 units box", "not possible"),
        ("fix s low setforce 0 0 NULL", "not possible"),
        ("fix s low setforce 0 0 0\nrun 10\nunfix s", "not possible"),
        ("fix f low freeze\nfix s low setforce 0 0 0", "not needed"),
    ],
)
def test_particles_without_force_are_fixed(tmp_path, fixes, kind):
    found, scene = imported(tmp_path, CUSTOM.format(fixes))
    assert kind in [each for each, _ in remarks(found, "fix s")]
    if kind != "not possible":
        fixed = {name: each.get("fixed", False) for name, each in scene["particles"].items()}
        assert sorted(fixed.values()) == [False, True]


@pytest.mark.parametrize(
    ("words", "count"), [("type/subset 2 10 777", 10), ("type/ratio 2 0.25 777", 9), ("type/fraction 2 1 777", 36)]
)  # fmt: skip
def test_random_types(tmp_path, words, count):
    """Of 36 particles; a ratio is exact, each particle has the type with the probability of a fraction."""
    found, _ = imported(tmp_path, CUSTOM.format(f"set group all {words}"))
    rows = {name: len(data.decode().splitlines()) - 1 for name, data in found.files.items()}
    assert rows.get("type1.csv", 0) == 36 - count and rows["type2.csv"] == count


@pytest.mark.parametrize(
    ("spheres", "words", "expected"),
    [
        ("file rod.txt scale 0.002", "random", "random"),
        # A quaternion (cos(a/2), n sin(a/2)) turns by a about n.
        ("-0.002 0 0 0.002 0.002 0 0 0.002", "constant 0.5 0 0 0.8660254037844386",
         {"axis": [0, 0, 0.866025403784], "angle": "120 deg"}),
        ("-0.002 0 0 0.002 0.002 0 0 0.002", "template", None),
    ],
)  # fmt: skip
def test_clump_of_a_template(tmp_path, spheres, words, expected):
    (tmp_path / "rod.txt").write_text("# x y z r\n-1 0 0 1\n1 0 0 1\n")
    insertion = (
        "fix p1 all particletemplate/multisphere 1 atom_type 1 density constant 2500 nspheres 2 ntry 1000 "
        f"spheres {spheres} type 1\nfix d all particledistribution/discrete 1 1 p1 1.0\nfix ins all insert/pack "
        f"seed 1 distributiontemplate d orientation {words} all_in yes region box particles_in_region 5"
    )
    text = liggghts(insertion=insertion).replace("nve/sphere", "multisphere")
    found, scene = imported(tmp_path, text)
    clump = scene["particles"]["ins"]["clump"]
    assert clump["spheres"] == [{"position": [f"{x} mm", 0, 0], "radius": "2 mm"} for x in (-2, 2)]
    assert clump.get("orientation") == expected
    loaded(tmp_path, found)
