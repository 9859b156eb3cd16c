"""Wear of walls by impacts: worn volumes against integrals over the momentum that a wall has received."""

import csv

import meshio
import numpy as np
import pytest
from geometry.meshes import sheet, write
from scene_builders import SOFT, build_scene, particle_group, plane, run_to_end

import granflow as gf
from granflow.plan.arrays import structure_of
from granflow.plan.build import plan_for

RADIUS = 0.005
MASS = 4.0 / 3.0 * np.pi * RADIUS**3 * SOFT["density"]
FRICTION = 0.1
ARCHARD = {"law": "archard", "coefficient": 1e-3, "hardness": "2 GPa"}
FINNIE = {"law": "finnie", "coefficient": {"glass": 7.0, "steel": 0.1}, "hardness": "1 GPa"}
SIDE = 0.2 / 32
"""Leg of a triangle of the fine mesh [m]."""
SLIDING = np.array([[0.001 + 0.4 * SIDE * k, 0.0127 * k - 0.03] for k in range(5)])
"""Where spheres meet the plate and the fine mesh, some near edges of triangles [m]."""
ANGLES = np.radians([45.0, 10.0])
"""Angles of impact on the two triangles of the coarse mesh, above and below that of tan a = 1/3."""


@pytest.fixture(scope="module")
def worn(tmp_path_factory):
    """The last snapshot of a run and its folder.

    Glass spheres slide over a plate and over a fine mesh with friction; steel ones meet a mesh of two triangles
    without.
    """
    folder = tmp_path_factory.mktemp("wear")
    with pytest.MonkeyPatch.context() as changed:
        changed.chdir(folder)
        write(folder / "two.stl", *sheet(1, 0.4))
        write(folder / "many.obj", *sheet(32, 0.2))
        mesh = {"shape": "mesh", "material": "liner"}
        walls = {
            "plate": {
                "shape": "rectangle", "corner": [-0.1, 0.4, 0], "sides": [[0.2, 0, 0], [0, 0.2, 0]],
                "material": "liner", "wear": ARCHARD,
            },
            "fine": mesh | {"file": "many.obj", "translate": [0, -0.5, 0], "wear": ARCHARD},
            "coarse": mesh | {"file": "two.stl", "wear": FINNIE},
            "floor": {"shape": "plane", "point": [0, 0, -0.5], "normal": [0, 0, 1], "material": "liner", "wear": {"law": "relative"}},
        }  # fmt: skip
        height = RADIUS + 1e-5
        slow = [[y_x[0], y + y_x[1], height] for y in (0.5, -0.5) for y_x in SLIDING]
        impacts = [[np.cos(a), 0.0, -np.sin(a)] for a in ANGLES]
        groups = {
            "glass": particle_group(slow, velocity=[[1.5, 0.0, -0.5]] * len(slow)),
            "steel": particle_group(
                [[0.1, -0.1, height], [-0.1, 0.1, height]], material="steel", velocity=impacts
            ),
        }
        scene = build_scene(
            groups, walls, {"friction": FRICTION}, pairs={"steel-liner": {"restitution": 0.8, "friction": 0.0}},
            run={"duration": 1e-3, "velocity_max": 2.0, "time_step": 2e-7}, output={"interval": 5e-4},
        )  # fmt: skip
        simulation = gf.Simulation(scene, out=folder / "out", threads=2)
        simulation.run()
        last = simulation.snapshot()
        simulation.free()
    assert last.totals["contact_count"] == 0 and last.particles["velocity"][:, 2].min() > 0.0
    return last, folder / "out"


def test_archard_is_force_times_sliding_distance(worn):
    """A sphere that slides during the whole impact: friction slows the surface by 7/2 mu dJ / m.

    V = k / H * integral of F v dt = k / H * (v J - 7/4 mu J^2 / m),    J: normal momentum

    Rows have totals; frames have no depth of an infinite wall, and the mean depth of a plate.
    """
    last, folder = worn
    normal_momentum = MASS * (last.particles["velocity"][: len(SLIDING), 2] + 0.5)
    sliding = 1.5 * normal_momentum - 1.75 * FRICTION * normal_momentum**2 / MASS
    volume = last.totals["wear_volume.plate"]
    assert volume == pytest.approx(1e-3 / 2e9 * sliding.sum(), rel=2e-3)
    assert last.totals["wear_tangential_work.plate"] == pytest.approx(FRICTION * sliding.sum(), rel=2e-3)
    assert last.totals["wear_tangential_work.coarse"] == last.totals["wear_normal_work.floor"] == 0.0
    rows = list(csv.DictReader((folder / "timeseries.csv").open()))
    assert [float(rows[k]["wear_volume.plate [m3]"]) for k in (0, -1)] == [0.0, volume]
    frame = meshio.read(folder / "walls_0002.vtu")
    wall, depth = (frame.cell_data[name][0] for name in ("wall", "wear_depth"))
    np.testing.assert_allclose(depth[wall == 0], volume / 0.04, rtol=1e-6)
    assert np.isnan(depth[wall == 3]).all()


def test_a_vibrating_sphere_that_sticks_wears_nothing():
    """At rest on a plate, a sphere vibrates with u = 1 mm/s: its spring has at most u sqrt(K m), far below mu m g."""
    plate = {"shape": "plane", "point": [0, 0, 0], "normal": [0, 0, 1], "material": "liner", "wear": ARCHARD}
    scene = build_scene(
        {"glass": particle_group([[0, 0, RADIUS - 1e-6]], velocity=[1e-3, 0, 0])}, {"plate": plate}, {"friction": 0.9},
        gravity=[0, 0, -9.81], run={"duration": 0.01, "time_step": 2e-6},
    )  # fmt: skip
    last, _ = run_to_end(scene)
    assert abs(last.particles["velocity"][0, 0]) > 1e-4
    assert last.wear["plate"][0, [0, 2]].tolist() == [0.0, 0.0]


def test_triangles_of_a_mesh_have_the_wear_of_the_plane(worn):
    """Each contact wears the triangle that it is on; together they are worn as a plate by the same impacts."""
    last, _ = worn
    np.testing.assert_allclose(last.wear["fine"].sum(axis=0), last.wear["plate"][0], rtol=1e-12)
    volume = last.wear["fine"][:, 0]
    assert np.count_nonzero(volume) > len(SLIDING), "spheres slide from one triangle to the next"
    assert np.count_nonzero(volume) < 4 * len(SLIDING)
    assert last.totals["wear_depth_largest.fine"] == pytest.approx(volume.max() / (0.5 * SIDE**2), rel=1e-12)


def finnie_volume(approach, passing):
    """2 k / H m * integral of v f(a) du over the approach u of a sphere without friction, in closed form."""
    ends = np.clip([0.0, passing / 3.0, approach], 0.0, approach)
    speed, angle = np.hypot(ends, passing), np.arcsinh(ends / passing)
    flat = 2.0 * passing * speed - 1.5 * (ends * speed - passing**2 * angle)
    steep = passing**2 * angle / 3.0
    return 2.0 * 0.1 / 1e9 * MASS * (flat[1] - flat[0] + steep[2] - steep[1])


@pytest.mark.parametrize("triangle_angle", ANGLES)
def test_finnie_integrates_over_the_angles_of_an_impact(worn, triangle_angle):
    """The force is the rate of the momentum m u, so that the volume does not depend on the contact model."""
    last, folder = worn
    approach, passing = np.sin(triangle_angle), np.cos(triangle_angle)
    expected = finnie_volume(approach, passing)
    frame = meshio.read(folder / "walls_0002.vtu")
    of_coarse = frame.cell_data["wall"][0] == 2
    centers = frame.points[frame.cells_dict["triangle"][of_coarse]].mean(axis=1)
    below = centers[:, 1] < centers[:, 0]
    depth = frame.cell_data["wear_depth"][0][of_coarse][below == (triangle_angle == ANGLES[0])]
    assert depth * (0.5 * 0.4**2) == pytest.approx(expected, rel=3e-3)


def test_laws_of_wear_belong_to_the_structure():
    """A later run of the same process takes the kernels of a run of equal structure."""
    groups = {"glass": particle_group([[0, 0, RADIUS]], 2 * RADIUS)}
    found = [
        structure_of(plan_for(build_scene(groups, {"floor": plane([0, 0, 0], [0, 0, 1], wear=wear)})))
        for wear in (ARCHARD, ARCHARD | {"coefficient": 2e-3}, {"law": "relative"})
    ]
    assert found[0] == found[1] != found[2]
