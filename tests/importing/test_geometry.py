"""Walls, meshes and motions of scripts: keys, report and geometry of small scripts."""

import struct
from math import cos, pi, sin

import numpy as np
import pytest
import yaml

import granflow as gf
from granflow.importing.convert import convert
from granflow.importing.language import DeckError
from granflow.importing.meshes import FlatFace, Mesh, flat_face
from granflow.plan.build import plan_for
from granflow.scene.blocks.motions import poses_at
from granflow.units import to_si

LIGGGHTS = """
atom_style granular
boundary {boundary}
units si
region box block 0 0.1 0 0.1 0 0.2 units box
create_box 1 box
fix m1 all property/global youngsModulus peratomtype 5e6
fix m2 all property/global poissonsRatio peratomtype 0.45
fix m3 all property/global coefficientRestitution peratomtypepair 1 0.5
fix m4 all property/global coefficientFriction peratomtypepair 1 0.1
pair_style gran model hertz tangential history
pair_coeff * *
timestep 1e-5
fix g all gravity 9.81 vector 0 0 -1
fix p1 all {template}
fix d all particledistribution/discrete 1 1 p1 1.0
fix ins all insert/pack seed 1 distributiontemplate d all_in yes region box particles_in_region 5
fix i all nve/sphere
{walls}
"""
SPHERE = "particletemplate/sphere 1 atom_type 1 density constant 2500 radius constant 0.002"
GRANULAR = "wall/gran model hertz tangential history"
LAMMPS = """
units si
atom_style sphere
boundary {boundary}
region box block 0 0.1 0 0.1 0 0.2
create_box 1 box
pair_style gran/hooke/history 1e4 NULL 100 NULL 0.5 1
pair_coeff * *
timestep 1e-5
fix g all gravity 10 vector 0 0 -1
region source block 0.04 0.06 0.04 0.06 0.1 0.15
fix p all pour 10 1 7 region source diam one 0.004 dens 2500 2500
fix i all nve/sphere
{walls}
"""
HOOKE = "hooke/history 1e4 NULL 100 NULL 0.5 1"


def liggghts(walls, boundary="f f f", template=SPHERE):
    """A script of LIGGGHTS with walls and runs."""
    return LIGGGHTS.format(**locals())


def lammps(walls, boundary="f f f"):
    """A script of LAMMPS with walls and runs."""
    return LAMMPS.format(**locals())


def imported(tmp_path, text):
    """The translation of a script, and its scene as nested dictionaries."""
    path = tmp_path / "in.deck"
    path.write_text(text)
    found = convert(path)
    return found, yaml.safe_load(found.text) if found.text else {}


def checked(tmp_path, found):
    """The scene, written with its files and loaded."""
    for name, content in found.files.items():
        (tmp_path / name).write_bytes(content)
    (tmp_path / "scene.yaml").write_text(found.text)
    return gf.load_scene(tmp_path / "scene.yaml")


def sentences(found, part):
    """What the report says on the lines with a text."""
    return " ".join(f"{kind}: {text}" for _, line, kind, text in found.report.lines() if part in line)


def write_stl(path, triangles):
    """A binary STL file."""
    rows = b"".join(struct.pack("<12fH", 0, 0, 0, *np.ravel(each), 0) for each in triangles)
    path.write_bytes(b" " * 80 + struct.pack("<I", len(triangles)) + rows)


SQUARE = 0.02 * np.array([[[0, 0, 0], [1, 0, 0], [1, 1, 0]], [[0, 0, 0], [1, 1, 0], [0, 1, 0]]])


@pytest.fixture
def square(tmp_path):
    """A square of 20 mm in the plane z = 0, with a corner at the origin."""
    write_stl(tmp_path / "square.stl", SQUARE)
    return "mesh/surface file square.stl type 1"


@pytest.mark.parametrize(
    ("wall", "expected"),
    [
        ("zplane 0.0", {"shape": "plane", "point": [0, 0, 0], "normal": [0, 0, 1]}),
        ("zplane 0.2", {"shape": "plane", "point": [0, 0, "200 mm"], "normal": [0, 0, -1]}),
        (
            "zplane 0.05",  # inside the box: particles on both sides
            {
                "shape": "rectangle",
                "corner": ["-100 mm", "-100 mm", "50 mm"],
                "sides": [["300 mm", 0, 0], [0, "300 mm", 0]],
            },
        ),
        (
            "zcylinder 0.04 0.05 0.06",
            {
                "shape": "cylinder",
                "from": ["50 mm", "60 mm", "-200 mm"],
                "to": ["50 mm", "60 mm", "400 mm"],
                "radius": "40 mm",
            },
        ),
        (
            "zplane 0.0 shear x 0.5",
            {"motion": {"kind": "surface_velocity", "velocity": ["500 mm/s", 0, 0]}},
        ),
        (
            "zcylinder 0.05 0.05 0.05 shear x 0.5",
            {
                "motion": {
                    "kind": "rotation",
                    "point": ["50 mm", "50 mm", 0],
                    "axis": [0, 0, 1],
                    "angular_velocity": "0.5 rad/s",  # as measured: no velocity of the surface
                }
            },
        ),
    ],
)
def test_primitive_wall(tmp_path, wall, expected):
    walls = f"fix w all {GRANULAR} primitive type 1 {wall}\nrun 100"
    found, scene = imported(tmp_path, liggghts(walls))
    assert expected.items() <= scene["walls"]["w"].items()
    assert found.report.is_complete


@pytest.mark.parametrize(
    ("wall", "names", "expected"),
    [
        ("zplane 0 0.2", ["w_low", "w_high"], {"normal": [0, 0, 1]}),
        ("xplane NULL 0.1", ["w"], {"point": ["100 mm", 0, 0], "normal": [-1, 0, 0]}),
        (
            "zplane 0 NULL wiggle z 0.001 0.02",  # at 1 mm - 1 mm cos(w t), as sin(w t - 90 deg) + 1
            ["w"],
            {
                "motion": {
                    "kind": "vibration",
                    "direction": [0, 0, 1],
                    "amplitude": "1 mm",
                    "frequency": "50 Hz",
                    "phase": "-90 deg",
                }
            },
        ),
        (
            "zcylinder 0.05 shear y 0.5",
            ["w"],
            {
                "motion": {
                    "kind": "rotation",
                    "point": [0, 0, 0],
                    "axis": [0, 0, 1],
                    "angular_velocity": "-10 rad/s",
                }
            },
        ),
    ],
)
def test_wall_of_lammps(tmp_path, wall, names, expected):
    _, scene = imported(tmp_path, lammps(f"fix w all wall/gran {HOOKE} {wall}\nrun 100"))
    assert list(scene["walls"]) == names
    assert expected.items() <= scene["walls"][names[0]].items()


def test_mesh_is_transformed_in_the_order_of_the_script(tmp_path, square):
    steps = "move 0.01 0 0 scale 2.0 rotate axis 0 0 1 angle 90 move 0 0 0.03"
    found, _ = imported(
        tmp_path,
        liggghts(f"fix cad all {square} {steps}\nfix w all {GRANULAR} mesh n_meshes 1 meshes cad\nrun 9"),
    )
    mesh = checked(tmp_path, found).walls["cad"].surface(tmp_path)
    # x of 10 to 30 mm is doubled to 20 to 60 mm and turned to y; y of 0 to 40 mm to -x.
    np.testing.assert_allclose(mesh.points.min(axis=0), [-0.04, 0.02, 0.03], atol=1e-7)
    np.testing.assert_allclose(mesh.points.max(axis=0), [0.0, 0.06, 0.03], atol=1e-7)


def test_mesh_in_centimeters(tmp_path, square):
    """The file and the displacement are in the unit of the script: 0.02 cm are 0.2 mm."""
    walls = f"fix cad all {square} move 0 0 3\nfix w all {GRANULAR} mesh n_meshes 1 meshes cad\nrun 9"
    _, scene = imported(tmp_path, liggghts(walls).replace("units si", "units cgs"))
    assert scene["walls"]["cad"]["scale"] == 0.01
    assert scene["walls"]["cad"]["translate"] == [0, 0, "30 mm"]


MOVED = f"fix w all {GRANULAR} mesh n_meshes 1 meshes cad\n"


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
    found, _ = imported(tmp_path, liggghts(walls))
    assert found.report.is_complete
    (wall,) = plan_for(checked(tmp_path, found)).walls
    poses = poses_at(wall.motions, np.array([time]))
    corner = poses.rotation[0] @ (0 - poses.pivot) + poses.pivot + poses.offset[0]
    # Velocities that are linear between 100 rows per period: angles up to 1 rad within (2 pi/100)^2 / 12.
    np.testing.assert_allclose(corner, place, atol=0.02 * (2 * pi / 100) ** 2 / 12)


def test_motions_of_a_mesh_in_sequence(tmp_path, square):
    """A translation that ends shifts the axis of the rotation that follows, in the frame of the mesh at rest."""
    walls = (
        f"fix cad all {square}\n{MOVED}fix m1 all move/mesh mesh cad linear 0.5 0 0\nrun 2000\nunfix m1\n"
        "fix m2 all move/mesh mesh cad rotate origin 0.03 0 0 axis 0 0 1 period -0.5\nrun 1000"
    )
    found, scene = imported(tmp_path, liggghts(walls))
    translation, rotation = scene["walls"]["cad"]["motion"]
    assert translation == {"kind": "translation", "velocity": ["500 mm/s", 0, 0], "stages": ["stage_1"]}
    assert rotation["point"] == ["20 mm", 0, 0]  # 30 mm - 0.5 m/s 20 ms
    assert rotation["angular_velocity"] == f"{-4 * pi:.12g} rad/s" and rotation["stages"] == ["stage_2"]
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
        # about one axis with another rate
        (
            f"{TURN}run 1000\nunfix m1\n"
            "fix m2 all move/mesh mesh cad rotate origin 0 0 0 axis 0 0 -1 period 0.08\nrun 1000",
            lambda x: rotated("z", pi / 2 - pi / 4, [0, 0, 0], x),
        ),
    ],
)
def test_rotations_of_a_mesh_are_a_chain(tmp_path, square, moves, corner):
    """The first place is that of LIGGGHTS 3.8, to 1e-7 m, with ten times these lengths."""
    found, _ = imported(tmp_path, liggghts(f"fix cad all {square} move 0.01 0.002 0.003\n{MOVED}{moves}"))
    assert found.report.is_complete
    (wall,) = plan_for(checked(tmp_path, found)).walls
    place = np.array([0.01, 0.002, 0.003])
    for motion in reversed(wall.motions):  # each acts for 10 ms; the last is in the frame of those before
        pose = poses_at([motion], np.array([0.01]))
        place = pose.rotation[0] @ (place - pose.pivot) + pose.pivot + pose.offset[0]
    np.testing.assert_allclose(place, corner([0.01, 0.002, 0.003]), atol=1e-9)


def test_rotations_about_crossed_axes_at_the_same_time_are_not_possible(tmp_path, square):
    walls = f"fix cad all {square}\n{MOVED}{TURN}{TURN.replace('m1', 'm2').replace('0 0 1', '1 0 0')}run 1000"
    found, _ = imported(tmp_path, liggghts(walls))
    assert "a rotation during that of fix m1, about an axis that is not parallel" in sentences(
        found, "fix m2"
    )


def test_only_translations_across_an_axis_move_it(tmp_path, square):
    """A rotation is given before a translation: in the script its axis is at rest."""
    for velocity, is_told in (("0 0 1", False), ("1 0 0", True)):
        walls = f"fix cad all {square}\n{MOVED}{TURN}fix m2 all move/mesh mesh cad linear {velocity}\nrun 9"
        found, _ = imported(tmp_path, liggghts(walls))
        assert ("the axis moves with the translation" in sentences(found, "fix m1")) is is_told


def test_mesh_whose_wall_is_given_again_remains(tmp_path, square):
    """A script takes the plug away: the fix of both meshes ends, and another one has the hopper alone."""
    walls = (
        f"fix hopper all {square}\nfix plug all {square} move 0 0 0.1\n"
        f"fix w all {GRANULAR} mesh n_meshes 2 meshes hopper plug\nrun 100\nunfix w\n"
        f"fix w all {GRANULAR} mesh n_meshes 1 meshes hopper\nrun 100"
    )
    found, scene = imported(tmp_path, liggghts(walls))
    assert set(scene["walls"]) == {"hopper", "plug"} and found.report.is_complete
    assert "stages" not in scene["walls"]["hopper"] and scene["walls"]["plug"]["stages"] == ["stage_1"]


def test_wall_that_vanishes(tmp_path):
    walls = f"fix lid all {GRANULAR} primitive type 1 zplane 0.2\nfix w all {GRANULAR} primitive type 1 zplane 0\n"
    _, scene = imported(tmp_path, liggghts(f"{walls}run 100\nunfix lid\nrun 200"))
    assert scene["walls"]["lid"]["stages"] == ["stage_1"] and "stages" not in scene["walls"]["w"]
    assert [each["duration"] for each in scene["stages"]] == ["1 ms", "2 ms"]


def test_belt_and_its_inclined_faces(tmp_path, square):
    walls = f"fix cad all {square} surface_vel 0.4 0 0.3\n{MOVED}run 9"
    found, scene = imported(tmp_path, liggghts(walls))
    motion = scene["walls"]["cad"]["motion"]
    assert motion == {"kind": "surface_velocity", "velocity": ["400 mm/s", 0, "300 mm/s"]}
    assert "down to 0.8 of 0.5 m/s" in sentences(found, "surface_vel")  # 0.4 over hypot(0.4, 0.3)


def test_servo_and_forces(tmp_path, square):
    style = square.replace("mesh/surface", "mesh/surface/stress/servo")
    servo = "com 0 0 0 ctrlPV force axis 0 0 1 target_val -10 vel_max 0.2 kp 5"
    _, scene = imported(tmp_path, liggghts(f"fix cad all {style} {servo}\n{MOVED}run 9"))
    assert scene["walls"]["cad"]["motion"] == {
        "kind": "servo",
        "direction": [0, 0, -1],
        "force": "10 N",
        "velocity_max": "200 mm/s",
    }
    assert scene["output"]["wall_forces"] == ["cad"]


def test_servo_that_stops_and_changes_its_target(tmp_path, square):
    """The plate is at rest while particles fall, presses with 10 N, rests, presses with 10 N and with 5 N."""
    style = square.replace("mesh/surface", "mesh/surface/stress/servo")
    servo = "com 0 0 0 ctrlPV force axis 0 0 1 target_val -10 vel_max 0.2 kp 5"
    runs = (
        "fix_modify cad integrate stop\nrun 100\nfix_modify cad integrate start\nrun 200\n"
        "fix_modify cad integrate stop\nrun 300\nfix_modify cad integrate start\nrun 400\n"
        "fix_modify cad target_val -5\nrun 500"
    )
    found, scene = imported(tmp_path, liggghts(f"fix cad all {style} {servo}\n{MOVED}{runs}"))
    assert [(each["force"], each["stages"]) for each in scene["walls"]["cad"]["motion"]] == [
        ("10 N", ["stage_2"]),
        ("10 N", ["stage_4"]),
        ("5 N", ["stage_5"]),
    ]
    assert [each["duration"] for each in scene["stages"]] == ["1 ms", "2 ms", "3 ms", "4 ms", "5 ms"]
    checked(tmp_path, found)


def test_servo_without_a_target_that_stops(tmp_path, square):
    style = square.replace("mesh/surface", "mesh/surface/stress/servo")
    servo = "com 0 0 0 ctrlPV force axis 0 0 1 vel_max 0.2 kp 5"
    runs = "fix_modify cad integrate stop\nrun 9\nfix_modify cad integrate start\nrun 9"
    with pytest.raises(DeckError, match="a servo needs target_val"):
        imported(tmp_path, liggghts(f"fix cad all {style} {servo}\n{MOVED}{runs}"))


def test_servo_with_a_target_that_follows_a_variable(tmp_path, square):
    style = square.replace("mesh/surface", "mesh/surface/stress/servo")
    servo = "com 0 0 0 ctrlPV force axis 0 0 1 target_val -10 vel_max 0.2 kp 5"
    change = "variable f equal step\nfix_modify cad servo/target_val v_f\nrun 9"
    found, _ = imported(tmp_path, liggghts(f"fix cad all {style} {servo}\n{MOVED}run 9\n{change}"))
    assert "servo/target_val v_f of a servo" in sentences(found, "fix_modify")


def test_wear_by_the_model_of_finnie(tmp_path, square):
    """k_finnie of a mesh of type 2 and particles of type 1, in 1/(dyn/cm2) = 10/Pa."""
    style = square.replace("mesh/surface", "mesh/surface/stress").replace("type 1", "type 2")
    text = liggghts(f"fix cad all {style} wear finnie\n{MOVED}run 9").replace("units si", "units cgs")
    text = text.replace("create_box 1 ", "create_box 2 ").replace(
        "peratomtypepair 1 0.5", "peratomtypepair 2 0.5 .5 .5 .5"
    )
    text = (
        text.replace("peratomtypepair 1 0.1", "peratomtypepair 2 .1 .1 .1 .1")
        .replace("5e6", "5e6 5e6")
        .replace("0.45", "0.45 0.45")
    )
    with pytest.raises(DeckError, match="in.deck:19: wear finnie needs fix property/global k_finnie"):
        imported(tmp_path, text)
    given = "fix m5 all property/global k_finnie peratomtypepair 2 1e-9 3e-9 3e-9 4e-9\npair_style"
    found, scene = imported(tmp_path, text.replace("pair_style", given))
    assert found.report.is_complete
    assert scene["walls"]["cad"]["wear"] == {"law": "finnie", "coefficient": "3e-08", "hardness": "1 Pa"}
    assert checked(tmp_path, found).walls["cad"].wear.coefficient == 3e-8


def test_mass_flow_through_a_mesh(tmp_path, square):
    walls = f"fix cad all {square} move 0 0 0.05\nfix flow all massflow/mesh mesh cad vec_side 0.2 0 -1 "
    floor = f"fix w all {GRANULAR} primitive type 1 zplane 0\n"
    found, scene = imported(tmp_path, liggghts(f"{floor}{walls} count once delete_atoms yes\nrun 9"))
    assert scene["output"]["flow_meters"]["flow"]["normal"] == [0, 0, -1]
    box = scene["outlets"]["flow"]["box"]
    assert box["min"][:2] == [0, 0] and box["max"][2] == "50 mm"
    assert [float(each.split()[0]) for each in box["max"][:2]] == pytest.approx([20, 20], rel=1e-7)
    checked(tmp_path, found)


@pytest.mark.parametrize(("all_in", "margin"), [("no", 0.0035), ("yes", 0.0)])
def test_stream_through_a_face(tmp_path, square, all_in, margin):
    """Centers pass the mesh with the given velocity, on all of it, after a way of at least a radius.

    granflow places spheres downstream of the face, within its sides, so that it lies a radius before the mesh. The
    mean radius by mass is 0.25 x 2 mm + 0.75 x 4 mm = 3.5 mm; 2 m/s along x are not across the face.
    """
    large = "fix p2 all particletemplate/sphere 1 atom_type 1 density constant 2500 radius constant 0.004\n"
    stream = (
        f"{large}fix d2 all particledistribution/discrete 1 2 p1 0.25 p2 0.75\nfix face all {square} move 0.01 0.01 0.1\n"
        f"fix s all insert/stream seed 1 distributiontemplate d2 nparticles 50 particlerate 100 all_in {all_in} "
        "vel constant 2 0 -0.7 insertion_face face extrude_length 0.02\n"
    )
    floor = f"fix w all {GRANULAR} primitive type 1 zplane 0\n"
    found, _ = imported(tmp_path, liggghts(f"{floor}{stream}run 9"))
    insert = checked(tmp_path, found).particles["s"].insert
    outline = insert.face.rectangle
    corners = np.array([outline.corner, np.add(outline.corner, np.sum(outline.sides, axis=0))])
    np.testing.assert_allclose(corners.min(axis=0), [0.01 - margin, 0.01 - margin, 0.1035], atol=1e-9)
    np.testing.assert_allclose(corners.max(axis=0), [0.03 + margin, 0.03 + margin, 0.1035], atol=1e-9)
    assert insert.face.normal.tolist() == [0, 0, -1]
    assert insert.start == pytest.approx(0.0035 / 0.7)
    assert "up to 0.02 m before it" in sentences(found, "fix s")


@pytest.mark.parametrize("turn", [0.0, 0.3])
def test_flat_mesh_of_a_rectangle_in_parts(tmp_path, turn):
    """Two squares of 20 mm in a row, in a text file of six digits: a rectangle of 40 mm x 20 mm, however turned."""
    axes = np.array([[cos(turn), sin(turn), 0.0], [-sin(turn), cos(turn), 0.0]])
    parts = [
        [[0, 0], [1, 0], [1, 1]],
        [[0, 0], [1, 1], [0, 1]],
        [[1, 0], [2, 0], [2, 1]],
        [[1, 0], [2, 1], [1, 1]],
    ]
    triangles = 0.02 * np.array(parts) @ axes + [0.0, 0.0, 0.1]
    rows = "".join(
        "facet normal 0 0 1\nouter loop\n" + "".join("vertex {:.6g} {:.6g} {:.6g}\n".format(*p) for p in each)
        + "endloop\nendfacet\n" for each in triangles
    )  # fmt: skip
    (tmp_path / "face.stl").write_text(f"solid a\n{rows}endsolid a\n")
    face = flat_face(Mesh(tmp_path / "face.stl", 1), np.array([0.0, 0.0, -1.0]))
    assert face.sides is not None and not face.difference
    assert np.cross(*face.sides) == pytest.approx([0.0, 0.0, -0.0008], rel=1e-4)
    corners = [face.point + a * face.sides[0] + b * face.sides[1] for a in (0, 1) for b in (0, 1)]
    expected = 0.02 * np.array([[0, 0], [2, 0], [0, 1], [2, 1]]) @ axes + [0.0, 0.0, 0.1]
    distance = np.linalg.norm(np.array(corners)[:, None] - expected[None], axis=2)
    assert distance.min(axis=0).max() < 1e-6 and distance.min(axis=1).max() < 1e-6


@pytest.mark.parametrize(
    ("face", "expected"),
    [
        (FlatFace(np.array([0.02, -0.01, 0.1]), np.array([0.0, 0.0, -1.0]), np.array([[0, 0.05, 0], [0.02, 0, 0]]), 0.0, 1.0),
         [[0.02, 0.04], [0.0, 0.03], [0.1, 0.1]]),
        (FlatFace(np.array([0.02, 0.01, 0.1]), np.array([0.0, 0.0, -1.0]), None, 0.02, 1.0),
         [[0.01, 0.03], [0.0, 0.02], [0.1, 0.1]]),
        (FlatFace(np.array([0.02, 0.02, 0.1]), np.array([0.0, 0.0, -1.0]), None, 0.01, 1.0),
         [[0.01, 0.03], [0.01, 0.03], [0.1, 0.1]]),
    ],
)  # fmt: skip
def test_face_is_cut_at_the_box(face, expected):
    box = np.array([[0.0, 0.04], [0.0, 0.03], [0.0, 0.2]])
    np.testing.assert_allclose(face.within(box).extent(), expected, atol=1e-12)


def test_more_meshes_than_given(tmp_path, square):
    meshes = f"fix a all {square}\nfix b all {square}\nfix w all {GRANULAR} mesh n_meshes 1 meshes a b\n"
    with pytest.raises(DeckError, match="n_meshes is 1, but the mesh b follows; give 2"):
        imported(tmp_path, liggghts(f"{meshes}run 9"))


def test_mesh_of_a_wall_does_not_end_before_it(tmp_path, square):
    with pytest.raises(DeckError, match="fix w uses the mesh cad; unfix w before it"):
        imported(tmp_path, liggghts(f"fix cad all {square}\n{MOVED}run 9\nunfix cad\nrun 9"))


# Regions


@pytest.mark.parametrize(
    ("region", "expected"),
    [
        ("block 0 0.1 0 0.1 0 0.2", {"w": {"shape": "box", "min": [0, 0, 0], "max": ["100 mm", "100 mm", "200 mm"]}}),
        ("block 0 0.1 0 0.1 0 0.2 open 6", {"w": {"open": ["top"], "finite": True}}),
        ("block 0.04 0.06 0.04 0.06 0 0.02 side out", {"w": {"shape": "box", "finite": True}}),
        ("sphere 0.05 0.05 0.1 0.04", {"w": {"shape": "sphere", "radius": "40 mm"}}),
        ("plane 0 0 0.01 0 0 2", {"w": {"shape": "plane", "normal": [0, 0, 2]}}),
        ("plane 0 0 0.01 0 0 -1 side out", {"w": {"shape": "plane", "normal": [0, 0, 1]}}),
        ("cylinder z 0.05 0.05 0.04 0 0.2", {"w_bottom": {"radius": "40 mm"}, "w_top": {}, "w_side": {"shape": "cylinder"}}),
        ("cone z 0.05 0.05 0.01 0.04 0 0.2 open 1 open 2", {"w": {"shape": "cone", "radius_from": "10 mm"}}),
    ],
)  # fmt: skip
def test_wall_on_a_region(tmp_path, region, expected):
    walls = f"region r {region}\nfix w all wall/gran/region {HOOKE} region r\nrun 100"
    found, scene = imported(tmp_path, lammps(walls))
    assert set(scene["walls"]) == set(expected)
    for name, keys in expected.items():
        assert keys.items() <= scene["walls"][name].items()
    checked(tmp_path, found)


def test_faces_inside_a_union_are_left_out(tmp_path):
    walls = (
        "region tube cylinder z 0.05 0.05 0.01 0 0.1\nregion hopper cone z 0.05 0.05 0.01 0.04 0.1 0.2 open 2\n"
        f"region both union 2 tube hopper\nfix w all wall/gran/region {HOOKE} region both\nrun 100"
    )
    found, scene = imported(tmp_path, lammps(walls))
    assert set(scene["walls"]) == {"w_tube_bottom", "w_tube_side", "w_hopper"}
    assert found.report.is_complete


def test_faces_at_an_open_part_of_a_union_remain(tmp_path):
    """LAMMPS hides no face behind a region with open faces: measured, a tube without `open` keeps its bottom."""
    walls = (
        "region tube cylinder z 0.05 0.05 0.04 0.1 0.2{}\nregion cone cone z 0.05 0.05 0.01 0.04 0 0.1 open 1 open 2\n"
        f"region both union 2 tube cone\nfix w all wall/gran/region {HOOKE} region both\nrun 100"
    )
    for opened, is_wall in (("", True), (" open 1", False)):
        _, scene = imported(tmp_path, lammps(walls.replace("{}", opened)))
        assert ("w_tube_bottom" in scene["walls"]) is is_wall


def test_union_with_an_opening_is_not_possible(tmp_path):
    walls = (
        "region tube cylinder z 0.05 0.05 0.02 0 0.1\nregion bin block 0 0.1 0 0.1 0.1 0.2 open 6\n"
        f"region both union 2 tube bin\nfix w all wall/gran/region {HOOKE} region both\nrun 100"
    )
    found, _ = imported(tmp_path, lammps(walls))
    assert "the face bottom of region bin has an opening" in sentences(found, "fix w")


def test_region_that_turns_between_runs(tmp_path):
    """Each definition is a wall of its own; the second begins at 0.2 rad and turns by 2 rad/s."""
    block = "region r block 0.01 0.09 0.01 0.09 0 0.2"
    walls = (
        f"{block}\nfix w all wall/gran/region {HOOKE} region r\nrun 1000\nregion r delete\n"
        f"variable theta equal 0.2+2*(step-1000)*dt\n{block} rotate v_theta 0.05 0.05 0 0 0 1\nrun 2000"
    )
    found, scene = imported(tmp_path, lammps(walls))
    assert scene["walls"]["w"]["stages"] == ["stage_1"]
    left = scene["walls"]["w_2_left"]
    assert left["stages"] == ["stage_2"] and left["motion"]["angular_velocity"] == "2 rad/s"
    corner = np.array([float(each.split()[0]) for each in left["corner"][:2]])
    offset = 40 * np.array([-cos(0.2) + sin(0.2), -sin(0.2) - cos(0.2)])  # (-40, -40) mm turned by 0.2 rad
    np.testing.assert_allclose(corner, 50 + offset, atol=1e-6)
    assert found.report.is_complete


@pytest.mark.parametrize(
    ("shape", "point", "stages"),
    [
        ("cylinder y 0.05 0.1 0.04 INF INF", "0.05 0 0.1", [None]),
        ("block 0.01 0.09 INF INF 0.05 0.15", "0.05 0 0.1", ["stage_1", "stage_2"]),
        ("cylinder y 0.06 0.1 0.03 INF INF", "0.05 0 0.1", ["stage_1", "stage_2"]),
    ],
)
def test_angle_that_begins_again_with_each_run(tmp_path, shape, point, stages):
    """The step `elapsed` is 0 at the beginning of a run. A cylinder about its own axis turns on at 2 rad/s, as one
    wall; another region jumps by 0.04 rad, and is a wall of its own in each run."""
    walls = (
        f"variable theta equal 2*elapsed*dt\nregion r {shape} rotate v_theta {point} 0 1 0\n"
        f"fix w all wall/gran/region {HOOKE} region r\nrun 2000\nrun 2000"
    )
    _, scene = imported(tmp_path, lammps(walls))
    found = list(scene["walls"].values())
    assert [each.get("stages", [None])[0] for each in found] == stages
    assert {each["motion"]["angular_velocity"] for each in found} == {"2 rad/s"}


def test_length_of_the_axis_of_a_region(tmp_path):
    walls = (
        "variable t equal step*dt\nregion r block 0 0.1 0 0.1 0 0.2 rotate v_t 0.05 0.05 0.1 0 3 4\n"
        f"fix w all wall/gran/region {HOOKE} region r\nrun 100"
    )
    found, scene = imported(tmp_path, lammps(walls))
    assert scene["walls"]["w"]["motion"]["angular_velocity"] == "1 rad/s"
    assert "5 times as fast as they turn" in sentences(found, "region r block")


def test_region_that_swings_is_a_table(tmp_path):
    walls = (
        "variable dz equal 0.001*sin(2*PI*100*step*dt)\nregion r block 0 0.1 0 0.1 0 0.2 move NULL NULL v_dz\n"
        f"fix w all wall/gran/region {HOOKE} region r\nrun 2000"
    )
    found, scene = imported(tmp_path, lammps(walls))
    motion = scene["walls"]["w"]["motion"]
    rows = np.loadtxt(found.files[motion["file"]].decode().splitlines(), skiprows=1, delimiter=",")
    assert motion["direction"] == [0, 0, 1]
    np.testing.assert_allclose(rows[:, 1], 1e-3 * np.sin(200 * pi * rows[:, 0]), atol=1e-9)


def test_axes_behind_a_container_are_not_periodic(tmp_path):
    walls = f"region r cylinder z 0.05 0.05 0.05 0 INF\nfix w all wall/gran/region {HOOKE} region r\nrun 100"
    found, scene = imported(tmp_path, lammps(walls, boundary="p p f"))
    assert "periodic" not in scene["domain"]
    assert "not periodic along x: region r is around it" in sentences(found, "boundary")


def test_motion_that_follows_the_simulation_is_not_possible(tmp_path):
    walls = (
        "compute c all ke\nvariable dz equal c_c\nregion r block 0 0.1 0 0.1 0 0.2 move NULL NULL v_dz\n"
        f"fix w all wall/gran/region {HOOKE} region r\nrun 100"
    )
    found, _ = imported(tmp_path, lammps(walls))
    assert "c_c is a result of the simulation" in sentences(found, "region r")


def test_sphere_on_a_block_has_its_outer_half(tmp_path):
    """The part of a sphere inside of the block of a union is no wall; half of it is an opening of the block."""
    walls = (
        "region ball sphere 0.05 0.05 0.1 0.02\nregion bin block 0 0.1 0 0.1 0 0.1\n"
        f"region both union 2 ball bin\nfix w all wall/gran/region {HOOKE} region both\nrun 100"
    )
    found, _ = imported(tmp_path, lammps(walls))
    assert "the face sphere of region ball has an opening" in sentences(found, "fix w")


# Box, shear, clumps, errors


def periodic(deformation):
    """A script of LAMMPS with three particles in a periodic box, without gravity and walls."""
    atoms = "".join(f"create_atoms 1 single 0.05 0.05 {z}\n" for z in (0.02, 0.05, 0.08))
    text = lammps(f"{atoms}set type 1 diameter 0.004\nset type 1 density 2500\n{deformation}", "p p p")
    for line in (
        "fix g all gravity 10 vector 0 0 -1",
        "fix p all pour 10 1 7 region source diam one 0.004 dens 2500 2500",
    ):
        text = text.replace(line, "")
    return text


def test_shear_of_the_box(tmp_path):
    found, scene = imported(tmp_path, periodic("fix s all deform 1 xz erate 20 remap v\nrun 100"))
    assert scene["domain"]["lees_edwards"] == {"flow": "x", "gradient": "z", "rate": "20 1/s"}
    assert "domain.lees_edwards" in sentences(found, "deform")


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
    remark = sentences(found, "deform")
    assert f"up to {100 * deviation:.2g} % from that of the script" in remark and "along z" not in remark
    checked(tmp_path, found)


def test_box_that_deforms_with_damping_is_told(tmp_path):
    found, _ = imported(
        tmp_path, periodic("fix v all viscous 1e-4\nfix s all deform 1 x erate -0.5\nrun 100")
    )
    assert "not possible: a box that deforms, together with damping" in sentences(found, "deform")
    assert "deformation" not in found.text


def test_widths_that_change_in_one_of_three_runs(tmp_path):
    text = periodic("run 1000\nfix s all deform 1 y vel -1.0\nrun 5000\nunfix s\nrun 1000")
    found, scene = imported(tmp_path, text)
    assert "deformation" not in scene["domain"]
    first, second, third = scene["stages"]
    assert "deformation" not in first and third["deformation"] == {"y": {"strain_rate": 0}}
    assert to_si(second["deformation"]["y"]["strain_rate"], "rate") == pytest.approx(np.log(0.5) / 0.05)
    checked(tmp_path, found)


@pytest.mark.parametrize(
    ("deformation", "reason"),
    [
        ("fix s all deform 1 x volume\nrun 10", "the deformation x volume of the box"),
        ("fix s all press/berendsen iso 1 1 1\nrun 10", "nearest: domain.deformation: {x: {pressure: P}}"),
        (
            "change_box all boundary f f f\nfix s all deform 1 x erate 1\nrun 10",
            "without periodic boundaries",
        ),
    ],
)
def test_deformations_that_are_not_possible(tmp_path, deformation, reason):
    found, _ = imported(tmp_path, periodic(deformation))
    assert reason in sentences(found, "fix s")


def test_frozen_particles(tmp_path):
    walls = (
        "create_atoms 1 single 0.05 0.05 0.01\nset type 1 diameter 0.004\nset type 1 density 2500\n"
        "group base type 1\nfix f base freeze\n"
        f"fix w all wall/gran {HOOKE} zplane 0 NULL\nrun 100"
    )
    text = lammps(walls).replace("fix p all pour 10 1 7 region source diam one 0.004 dens 2500 2500", "")
    found, scene = imported(tmp_path, text)
    (group,) = scene["particles"].values()
    assert group["fixed"] is True
    checked(tmp_path, found)


CHUTE = """units cgs
atom_style sphere
boundary p p f
lattice bcc 1.0
region box block 0 2 0 3 0 10
create_box 2 box
region base block INF INF INF INF INF 0.6
region bulk block INF INF INF INF 1.0 3.0
create_atoms 2 region base
create_atoms 1 region bulk
set group all diameter 0.8 density 2.5
group bottom region base
group mobile subtract all bottom
velocity mobile set 2 0 0
pair_style gran/hooke/history 1e4 NULL 100 NULL 0.5 1
pair_coeff * *
timestep 1e-5
fix g {gravity} gravity 981 chute 20
{integrators}
run 10
"""


@pytest.mark.parametrize(
    "integrators", ["fix i mobile nve/sphere", "fix f bottom freeze\nfix i all nve/sphere"]
)
def test_particles_on_a_lattice_over_a_rough_bottom(tmp_path, integrators):
    """Two points for each of the 6 cells of a layer: bottom layers at 0 and 0.5, bulk at 1, 1.5, ... 3 cm."""
    found, scene = imported(tmp_path, CHUTE.format(integrators=integrators, gravity="mobile"))
    assert found.report.is_complete and set(scene["particles"]) == {"start_type1", "start_type2_fixed"}
    assert scene["particles"]["start_type2_fixed"]["fixed"] is True
    fixed, moving = (
        np.loadtxt(found.files[name].decode().splitlines(), delimiter=",", skiprows=1)
        for name in ("type2_fixed.csv", "type1.csv")
    )
    assert len(fixed) == 2 * 6 and len(moving) == 5 * 6
    assert sorted({*fixed[:, 2]}) == [0.0, 0.005] and moving[:, 2].max() == 0.03
    np.testing.assert_allclose(moving[:, 3:5], [[0.004, 0.02]] * 30)  # 2 lattices per second are 2 cm/s
    checked(tmp_path, found)


CUSTOM = """units si
atom_style sphere
boundary f f f
region box block 0 {width} 0 0.06 0 0.06
create_box 1 box
lattice custom 0.01 a1 2 0 0 a2 0 1 0 a3 0 0 1 basis 0 0 0 basis 0.5 0.5 0.5 {more}
region some block 0 0.06 0 0.03 0 0.02 {units}
create_atoms 1 region some
set group all diameter 0.004 density 2500
pair_style gran/hooke/history/omp 1e4 NULL 100 NULL 0.5 1
pair_coeff * *
timestep 1e-5
fix g all gravity/kk 9.81 vector 0 0 -1
fix i all nve/sphere/kk
run 10
"""


@pytest.mark.parametrize("width", [0.1, 50.0])  # the wide box has more cells than are tried
def test_particles_on_a_lattice_of_its_own(tmp_path, width):
    """Cells of 20, 10 and 10 mm with a particle at the corner and in the middle, moved by a tenth of a cell."""
    found, _ = imported(tmp_path, CUSTOM.format(width=width, more="origin 0.1 0.1 0.1", units="units box"))
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
    ("fixes", "kind", "sentence"),
    [
        ("fix s low setforce 0 0 0", "approximated", "particles.NAME.fixed"),
        (
            "fix s low setforce 0.0 0.0 0.0\nvelocity low set 0.1 0 0 units box",
            "not possible",
            "particles that move with a constant velocity",
        ),
        ("fix s low setforce 0 0 NULL", "not possible", "forces that are set"),
        (
            "fix s low setforce 0 0 0\nrun 10\nunfix s",
            "not possible",
            "particles that are held in some runs only",
        ),
        ("fix f low freeze\nfix s low setforce 0 0 0", "not needed", "no fix moves these particles"),
    ],
)
def test_particles_without_force_are_fixed(tmp_path, fixes, kind, sentence):
    text = CUSTOM.format(width=0.1, more="origin 0.1 0.1 0.1", units="units box")
    group = "region low block INF INF INF INF -1 0.004 units box\ngroup low region low\n"
    found, scene = imported(tmp_path, text.replace("run 10", f"{group}{fixes}\nrun 10"))
    assert f"{kind}: {sentence}" in sentences(found, "fix s")
    if kind != "not possible":
        fixed = {name: each.get("fixed", False) for name, each in scene["particles"].items()}
        assert sorted(fixed.values()) == [False, True]


@pytest.mark.parametrize(
    ("words", "count"), [("type/subset 2 10 777", 10), ("type/ratio 2 0.25 777", 9), ("type/fraction 2 1 777", 36)]
)  # fmt: skip
def test_random_types(tmp_path, words, count):
    """Of 36 particles; a ratio is exact, each particle has the type with the probability of a fraction."""
    text = CUSTOM.format(width=0.1, more="origin 0.1 0.1 0.1", units="units box")
    text = text.replace("create_box 1", "create_box 2").replace(
        "pair_style", f"set group all {words}\npair_style"
    )
    found, scene = imported(tmp_path, text)
    rows = {name: len(data.decode().splitlines()) - 1 for name, data in found.files.items()}
    assert rows.get("type1.csv", 0) == 36 - count and rows["type2.csv"] == count
    assert {each["material"] for each in scene["particles"].values()} >= {"type2"}


def test_lengths_in_units_of_a_lattice_with_three_lengths(tmp_path):
    with pytest.raises(DeckError, match=r"in.deck:7: the lattice has other lengths along x, y and z"):
        imported(tmp_path, CUSTOM.format(width=0.1, more="", units=""))


def test_lattice_without_counterpart_is_reported_and_so_is_what_follows(tmp_path):
    text = CUSTOM.format(width=0.1, more="", units="units box").replace(
        "lattice custom 0.01", "lattice sq 0.01"
    )
    found, _ = imported(tmp_path, text)
    assert "the lattice sq" in sentences(found, "lattice sq")
    assert "what is not possible before may be the cause" in sentences(found, "create_atoms")


def test_gravity_on_some_of_the_moving_particles_is_not_possible(tmp_path):
    found, _ = imported(tmp_path, CHUTE.format(integrators="fix i all nve/sphere", gravity="mobile"))
    assert "on the group mobile only" in sentences(found, "fix g")


def test_mesh_that_appears_later_has_a_remark(tmp_path, square):
    wall = f"fix cad all mesh/surface file square.stl type 1\nrun 100\nfix w all {GRANULAR} mesh n_meshes 1 meshes cad"
    found, _ = imported(tmp_path, liggghts(f"{wall}\nrun 9"))
    assert "cad appears at 0.001 s: where it appears within particles" in sentences(found, "fix w")


def test_clump_of_a_template(tmp_path):
    (tmp_path / "rod.txt").write_text("# x y z r\n-1 0 0 1\n1 0 0 1\n")
    template = (
        "particletemplate/multisphere 1 atom_type 1 density constant 2500 nspheres 2 ntry 1000 "
        "spheres file rod.txt scale 0.002 type 1"
    )
    walls = f"fix w all {GRANULAR} primitive type 1 zplane 0\nrun 9"
    text = liggghts(walls, template=template).replace("nve/sphere", "multisphere")
    found, scene = imported(tmp_path, text)
    spheres = scene["particles"]["ins"]["clump"]["spheres"]
    assert spheres == [{"position": [f"{x} mm", 0, 0], "radius": "2 mm"} for x in (-2, 2)]
    checked(tmp_path, found)


@pytest.mark.parametrize(
    ("walls", "message"),
    [
        (f"fix w all {GRANULAR} mesh n_meshes 1 meshes no", "there is no fix mesh/surface no"),
        (f"fix w all {GRANULAR} primitive type 1 wplane 0", "there is no wall wplane"),
        ("fix cad all mesh/surface file no.stl type 1", "is missing: there is no such file"),
        ("fix m all move/mesh mesh cad linear 1 0 0", "there is no fix mesh/surface cad"),
        ("region r block 1 0 0 1 0 1 units box", "begins at 1"),
        ("region r ball 1 0 0 1", "there is no region style ball"),
        ("region r sphere 0 0 0 -1 units box", "the radius is -1"),
        ("boundary f f q", "the boundary of z is q"),
        ("create_box 1 none", "there is no region none"),
    ],
)
def test_errors_name_the_line(tmp_path, walls, message):
    with pytest.raises(DeckError, match=message) as error:
        imported(tmp_path, liggghts(f"{walls}\nrun 9"))
    assert "in.deck:19" in str(error.value)
