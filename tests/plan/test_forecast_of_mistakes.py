"""Forecasts of probable mistakes: wrong units, intervals, conditions, inlets, and particles inside of walls."""

import re

import numpy as np
import pytest
from geometry.meshes import cube, write
from plan.scenes import scene_of
from scene_builders import build_scene, particle_group, plane

from granflow.errors import SceneError
from granflow.particles.group import groups_of
from granflow.particles.insertion import Inserter, initial_particles
from granflow.plan.build import plan_for
from granflow.plan.overlaps import particle_warnings, refuse_initial_overlaps
from granflow.runs.initial_particles import initial_state


def warnings_of(scene):
    return [each.warning for each in plan_for(scene).forecasts if each.warning]


# These functions return overrides of the scene of ten beads.
def wall(shape, motion=""):
    return [f"walls.part={{shape: {shape}, material: glass{motion and f', motion: {motion}'}}}"]


def belt(more=""):
    return wall(
        "rectangle, corner: [0, 0, 12 mm], sides: [[2 cm, 0, 0], [0, 2 cm, 0]]",
        f"{{kind: translation, velocity: [1 m/s, 0, 0]{more}}}",
    )


def turned(*motions):
    """A plate of 1 cm around x = 0 in a domain from -10 to 30 mm."""
    sides = "corner: [-5 mm, 5 mm, 12 mm], sides: [[1 cm, 0, 0], [0, 1 cm, 0]]"
    return [*wall(f"rectangle, {sides}", f"[{', '.join(motions)}]"), "run.duration=0.1"]


HALF_TURN = "{kind: rotation, axis: [0, 0, 1], point: [0, 10 mm, 0], angular_velocity: 1800 deg/s}"
SHIFT = "{kind: translation, velocity: [24 cm/s, 0, 0], end: 0.1 s}"


def turning(*rates):
    turns = [
        f"{{kind: rotation, point: [0, 0, 0], axis: [0, 0, 1], angular_velocity: {rate}}}" for rate in rates
    ]
    return [f"walls.floor.motion=[{', '.join(turns)}]"]


def spun(rate):
    motion = f"{{kind: rotation, point: [1 cm, 1 cm, 0], axis: [0, 0, 1], angular_velocity: {rate}}}"
    return wall("disc, center: [1 cm, 1 cm, 0], normal: [0, 0, 1], radius: 1 cm", motion)


def shaken_part(phase):
    motion = f"{{kind: vibration, direction: [0, 0, 1], amplitude: 1 um, frequency: 25 Hz, phase: {phase}}}"
    return wall("disc, center: [1 cm, 1 cm, 0], normal: [0, 0, 1], radius: 1 cm", motion)


def inclined_belt(velocity):
    sides = "corner: [0, 0, 0], sides: [[16 mm, 0, 12 mm], [0, 2 cm, 0]]"
    return wall(f"rectangle, {sides}", f"{{kind: surface_velocity, velocity: {velocity}}}")


def heated(temperature):
    return [
        "contact.heat=conduction",
        "materials.glass.heat_capacity=800",
        "materials.glass.thermal_conductivity=1",
        f"particles.beads.temperature={temperature}",
    ]


def drained(side):
    return [f"outlets={{sink: {{half_space: {{point: [0, 0, -1 mm], normal: [0, 0, {side}]}}}}}}"]


def shaken(key, interval):
    """Output of a floor that vibrates with a period of 40 ms."""
    motion = "{kind: vibration, direction: [0, 0, 1], amplitude: 0.1 mm, frequency: 25 Hz}"
    intervals = {"interval": "5 ms"} | {key: interval}
    output = [f"output.{name}={value}" for name, value in intervals.items()]
    return [f"walls.floor.motion={motion}", "run.duration=1 s", *output]


def dropped(velocity, *more):
    """A lattice whose upper end is 30 mm above the floor: sqrt(2 g h) = 0.77 m/s."""
    region = "{box: {min: [0, 0, 10 mm], max: [2 cm, 2 cm, 30 mm]}}"
    return [f"particles.beads.insert.region={region}", f"run.velocity_max={velocity}", *more]


def rained(height):
    """Centers are between z = 2 and 8 mm; a floor at a height h [mm] takes those below h + 1.8 mm."""
    rain = "{kind: rain, rate: 100, region: {box: {min: [0, 0, 0], max: [2 cm, 2 cm, 1 cm]}}}"
    return [f"particles.beads.insert={rain}", f"walls.floor.point=[0, 0, {height} mm]"]


BOX = "region: {box: {min: [0, 0, 1 cm], max: [%s mm, %s mm, 2 cm]}}"


def jet(insertion, count=300, velocity="[0, 0, -0.3]"):
    group = f"material: glass, count: {count}, diameter: 4 mm, velocity: {velocity}"
    return f"particles.jet={{{group}, insert: {{{insertion}}}}}"


def queued(count):
    """4 cm3 without gravity hold at most 0.45 * 4 cm3 / 33.5 mm3 = 54 particles."""
    rain = f"kind: rain, rate: 60 1/s, {BOX % (20, 20)}"
    return [jet(rain, count, "[0, 0, 0]"), "gravity=[0, 0, 0]", "run.duration=0.3"]


def staged(until, duration="10 s", *more):
    """Ten particles at the start, and 100 per second from 0.1 s on, at most 300."""
    stage = f"{{name: fill, until: {{{until}}}, max_duration: {duration}}}"
    rain = f"kind: rain, rate: 100 1/s, start: 0.1 s, {BOX % (20, 20)}"
    return ["run.duration=null", f"stages=[{stage}]", jet(rain), *more]


def entered(face, velocity, gravity=-9.81):
    return [
        jet(f"kind: inlet, rate: 100 1/s, face: {face}", 20, velocity),
        f"gravity=[0, 0, {gravity}]",
        "run.duration=1",
    ]


DOWN = "{disc: {center: [1 cm, 1 cm, 2.5 cm], normal: [0, 0, -2], radius: 15 mm}}"
UP = "{disc: {center: [1 cm, 1 cm, 0], normal: [0, 0, 1], radius: 15 mm}}"
ACROSS = "{disc: {center: [0, 1 cm, 1 cm], normal: [1, 0, 0], radius: 8 mm}}"
RECTANGLE = "{rectangle: {corner: [-5 mm, -5 mm, 2.5 cm], sides: [[0, 3 cm, 0], [3 cm, 0, 0]]}}"


def rod(last):
    """A clump of three spheres."""
    spheres = f"{{position: [0, 0, 0], radius: 2 mm}}, {{position: [2 mm, 0, 0], radius: 2 mm}}, {last}"
    insertion = "{kind: lattice, region: {box: {min: [0, 0, 0], max: [2 cm, 2 cm, 1 cm]}}}"
    return [
        f"particles.beads={{material: glass, count: 1, clump: {{spheres: [{spheres}]}}, insert: {insertion}}}"
    ]


MASS = 2500.0 * np.pi / 6.0 * 0.004**3
"""Mass [kg] of a particle of 4 mm."""
LATE_RAIN = f"kind: rain, rate: 1000 1/s, start: 0.1 s, {BOX % (20, 20)}"
REPOSE = "output.metrics={heap: {kind: repose, surface: cone}}"


@pytest.mark.parametrize(("sentence", "wrong", "right"), [
    ("materials.glass.density .* is 2.5 kg/m3, less than light foams", ["materials.glass.density=2.5"],
     ["materials.glass.density=2.5", "particles.beads.diameter=1 m", "domain.max=[9, 9, 99]", "run.velocity_max=1",
      "particles.beads.insert.region={box: {min: [0, 0, 0], max: [9, 9, 99]}}"]),
    ("young_modulus .* is 5e[+]04 GPa, more than that of diamond", ["materials.glass.young_modulus=50e6 N/mm2"],
     ["materials.steel.young_modulus=50e6 N/mm2"]),
    ("work_of_adhesion .* is not used, because contact.cohesion is none",
     ["pairs.glass-glass.work_of_adhesion=0.1"], []),
    ("pairs.glass-glass.friction .* is 30: it is a coefficient", ["pairs.glass-glass.friction=30"], []),
    ("diameter .* is 4 m, 100 times the longest side of the domain",
     ["particles.ball={material: glass, diameter: 4, insert: {kind: positions, positions: [[0, 0, 0]]}}"], []),
    ("angle_of_repose.heap is in rad, and the bound is 30",
     [REPOSE, "expect=[{quantity: angle_of_repose.heap, between: [20, 30]}]"],
     [REPOSE, "expect=[{quantity: angle_of_repose.heap, between: [20 deg, 30 deg]}]"]),
    ("output.interval .* at most 0.05 s", ["output.interval=51 ms"], ["output.interval=50 ms"]),
    ("output.timeseries_interval .* shorter than the time step", ["output.timeseries_interval=1 ns"],
     ["output.timeseries_interval=1 ms"]),
    ("walls.part.to .* is 22 m, 550 times the longest side",
     wall("cylinder, from: [1 cm, 1 cm, 0], to: [1 cm, 1 cm, 22], radius: 22 mm"), []),
    ("walls.part.radius_to .* 9 mm is 0.009 m",
     wall("cone, from: [1 cm, 1 cm, 0], to: [1 cm, 1 cm, 2 cm], radius_from: 2 mm, radius_to: 9"), []),
    ("walls.part.sides .* is 20 m, 500 times",
     wall("rectangle, corner: [0, 0, 0], sides: [[20, 0, 0], [0, 2 cm, 0]]"), []),
    ("walls.part.radius .* is", wall("disc, center: [1 cm, 1 cm, 0], normal: [0, 0, 1], radius: 25"),
     wall("disc, center: [1 cm, 1 cm, 0], normal: [0, 0, 1], radius: 25 cm")),
    # The farthest point is 30 mm from an axis: 12 m/s. The speeds of a chain do not add up.
    ("Angular velocities without a unit are in rad/s", turning(400), turning(250, -250)),
    # A disc that reaches 10 mm from the axis, at 4 m/s.
    ("Angular velocities without a unit are in rad/s", turning(400), spun(400)),
    ("walls.part.motion.0.phase .* is 90 rad, more than a full turn", shaken_part(90), shaken_part("90 deg")),
    ("particles.beads.temperature .* is 20 K, colder than liquid nitrogen", heated(20), heated("20 degC")),
    ("particles.beads.insert .* all positions are inside outlets.sink", drained(1), drained(-1)),
    # Inclined by atan(3/4).
    ("magnitude 1 m/s, but only .* at most 0.8 m/s", inclined_belt("[1, 0, 0]"), inclined_belt("[0.8, 0, 0.6]")),
    # At odd multiples of 20 ms, sin(w t) is 0 in all frames, within 1 % of the period.
    (r"output.interval \(.* 0.5 times the period 0.04 s .* 0.005 s or less", shaken("interval", "20 ms"),
     shaken("interval", "40 ms")),
    (r"output.timeseries_interval \(.* 1.5 times the period 0.04 s", shaken("timeseries_interval", "60.2 ms"),
     shaken("timeseries_interval", "20.5 ms")),
    # In space the plate ends at x = 19 to 29 mm; in its own frame at -(5 + 24) = -29 mm, 19 mm outside.
    ("by up to 0.019 m at 0.0999 s. Motion 1 turns with the rotation before it", turned(HALF_TURN, SHIFT),
     turned(SHIFT, HALF_TURN)),
    ("motion 1, carry it by up to 0.0899 m", turned(SHIFT.replace("24", "90"), HALF_TURN), turned(SHIFT, HALF_TURN)),
    ("run.velocity_max .* particles.beads can fall 0.03 m and reach 0.767 m/s", dropped("0.05 m/s"),
     dropped("0.09 m/s")),
    ("run.velocity_max .* walls.part moves at up to 1 m/s", [*belt(), "run.velocity_max=0.009"],
     [*belt(), "run.velocity_max=0.011"]),
    ("run.velocity_max .* can fall", dropped("2 mm/s"), dropped("2 mm/s", "damping={drag: 20 1/s}")),
    (r"is at least 2[12][.\d]* m outside", wall("rectangle, corner: [0, 0, 22], sides: [[1 cm, 0, 0], [0, 1 cm, 0]]"),
     wall("rectangle, corner: [0, 0, 22 mm], sides: [[1 cm, 0, 0], [0, 1 cm, 0]]")),
    # The belt leaves the domain, up to x = 3 cm, after 30 ms.
    (r"walls.part.* after 0.0(3|4[01])", belt(), belt(", end: 50 ms")),
    ("walls.part.* after", belt(), [*belt(), "run.duration=10 ms"]),
    (r"9[67]\.?\d* % of the positions", rained(6), []),
    ("% of the positions", rained(6), rained(4)),
    ("60 particles are required, but the region holds at most about 54", queued(60), queued(20)),
    ("at most 310, the number of all particles until then.*the stage lasts its max_duration, 10 s",
     staged("quantity: particle_count, above: 310"), staged("quantity: particle_count, above: 309")),
    ("at most 300, the count of particles.jet", staged("quantity: inserted_count.jet, above: 300"),
     staged("quantity: inserted_count.jet, above: 299")),
    (f"at most {310 * MASS:.6g} kg", staged(f"quantity: deleted_mass, above: {310.5 * MASS}"),
     staged(f"quantity: deleted_mass, above: {309.5 * MASS}")),
    ("kinetic_energy is never below 0", staged("quantity: kinetic_energy, below: 0"),
     staged("quantity: kinetic_energy, below: 1e-9")),
    # 100 per second from 0.1 to 1 s are due at 0.1, 0.11, ..., 1 s: 91 particles.
    ("at most 91 until the end of the stage at the rate of particles.jet",
     staged("quantity: inserted_count.jet, above: 91", "1 s"),
     staged("quantity: inserted_count.jet, above: 90", "1 s")),
    ("is evaluated at the rows of the time series",
     staged("quantity: kinetic_energy, below: 1 nJ", "0.2 s", "output.timeseries_interval=0.3 s"),
     staged("quantity: kinetic_energy, below: 1 nJ", "0.2 s", "output.timeseries_interval=10 ms")),
    (r"velocity \(.* is \[0, 0, 0.3\] m/s, but particles enter through.* such as \[0, 0, -0.3\] m/s",
     entered(DOWN, "[0, 0, 0.3]"), entered(DOWN, "[0.3, 0, -0.01]", 0.0)),
    (r"points against it.* such as \[0.1, 0, -0.3\]", entered(RECTANGLE, "[0.1, 0, 0.3]"),
     entered(RECTANGLE, "[0.1, 0, -0.3]")),
    (r"gravity moves them backward.* such as \[0.3, 0, 0", entered(UP, "[0.3, 0, 0]"), entered(UP, "[0, 0, 0.3]")),
    (r"do not leave the face.* such as \[0.*, 0, -0.3\]", entered(ACROSS, "[0, 0, -0.3]"),
     entered(ACROSS, "[0, 0, 0]")),
    (r"do not leave the face.* such as \[0, 0, -0", entered(DOWN, "[0, 0, 0]", 0.0), entered(DOWN, "[0, 0, 0]")),
    (r"clump.spheres.2.position .* the same sphere as spheres.1: its contacts count twice",
     rod("{position: [2 mm, 1e-13, 0], radius: 2 mm}"), rod("{position: [2 mm, 0, 0], radius: 1.9 mm}")),
    (r"clump.spheres.2.position .* 0.0005 m away from the surface of spheres.1",
     rod("{position: [6.5 mm, 0, 0], radius: 2 mm}"), rod("{position: [6 mm, 0, 0], radius: 2 mm}")),
    ("motion.0.* begins at 0.2 s, but the run ends at 0.05 s",
     ["walls.floor.motion={kind: translation, velocity: [0, 0, 1], start: 0.2}"], []),
    ("gravity.times.* begins at 0.2 s", ["gravity={times: [0.2, 0.4], vectors: [[0, 0, -9.81], [0, 0, -1]]}"],
     ["gravity={times: [0.0, 0.4], vectors: [[0, 0, -9.81], [0, 0, -1]]}"]),
    ("the insertion starts at 0.1 s, but the run ends at 0.1 s", [jet(LATE_RAIN), "run.duration=0.1"],
     [jet(LATE_RAIN), "run.duration=0.3"]),
])  # fmt: skip
def test_probable_mistake_is_reported(tmp_path, sentence, wrong, right):
    """The scene of ten beads with overrides that are probably wrong, and that are just right."""
    wrong, right = (
        any(re.search(sentence, each) for each in warnings_of(scene_of(tmp_path, *overrides)))
        for overrides in (wrong, right)
    )
    assert wrong and not right


def test_wrong_unit_of_a_diameter_is_reported_before_the_errors_that_follow_from_it(tmp_path):
    """Particles of 4 m allow a step of 15 ms, in which the initial velocity moves the others too far."""
    face = "face: {disc: {center: [1 cm, 1 cm, 2 cm], normal: [0, 0, -1], radius: 5 mm}}"
    inlet = jet(f"kind: inlet, rate: 100 1/s, {face}", 5, "[0, 0, -0.5]")
    with pytest.raises(SceneError) as error:
        plan_for(scene_of(tmp_path, "particles.beads.fixed=true", inlet.replace("4 mm", "4")))
    first = error.value.problems[0]
    assert "particles.jet.diameter is 4 m, larger than the face of the inlet, which is 0.01 m wide" in first
    assert "4 mm is 0.004 m" in first and len(error.value.problems) > 1


def rate_through(scene):
    """Particles per second that the inserter of a scene inserts if they fall freely."""
    inserter = Inserter(groups_of(scene)["jet"])
    start = np.zeros((0, 3))
    entered = np.zeros(0)
    while (time := inserter.next_time) < 0.25:
        fallen = 0.3 * (time - entered) + 0.5 * 9.81 * (time - entered) ** 2
        present = start - fallen[:, None] * [0.0, 0.0, 1.0]
        new = inserter.insert_due(time, present, np.full(len(present), 0.002)).position
        start = np.concatenate([start, new])
        entered = np.concatenate([entered, np.full(len(new), time)])
    return len(start) / 0.25


INLET = "kind: inlet, face: {disc: {center: [1 cm, 1 cm, 2.5 cm], normal: [0, 0, -1], radius: %s mm}}"
CYLINDER = "region: {cylinder: {from: [1 cm, 1 cm, 2 cm], to: [1 cm, 1 cm, 1 cm], radius: 1 cm}}"


@pytest.mark.parametrize(("insertion", "largest_ratio"), [
    (INLET % 3, 3.0), (INLET % 15, None), (f"kind: rain, {BOX % (6, 6)}", 4.0), (f"kind: rain, {CYLINDER}", None),
])  # fmt: skip
def test_region_or_face_that_is_too_small_for_its_rate_is_reported(tmp_path, insertion, largest_ratio):
    """The forecast is an upper bound of the rate of the inserter, at most a few times as large; the required
    rate is 1200 per second."""
    scene = scene_of(tmp_path, jet(f"rate: 1200 1/s, {insertion}"), "run.duration=0.3")
    found = [each for each in warnings_of(scene) if "are queued" in each]
    reached = rate_through(scene)
    assert len(found) == (largest_ratio is not None)
    if found:
        limit = float(found[0].split("at most about ")[1].split(" leave")[0])
        assert reached < limit < min(1200.0, largest_ratio * reached)
    else:
        assert reached == pytest.approx(1200.0, rel=0.05)


@pytest.mark.parametrize(("distance", "count"), [(0.00399, 0), (0.0035, 1)])
def test_file_of_a_settled_bed_causes_no_warning(tmp_path, distance, count):
    """Particles of radius 2 mm that overlap by 0.5 % of the radius touch; 25 % is more than the weight
    explains."""
    (tmp_path / "start.csv").write_text(f"x,y,z,r\n0,0,0.002,0.002\n0,{distance},0.002,0.002\n")
    beads = "particles.beads={material: glass, insert: {kind: file, file: start.csv}}"
    scene = scene_of(tmp_path, beads, "materials.glass.young_modulus=10 kPa", "run.velocity_max=0.01")
    found = [each for each in warnings_of(scene) if "start.csv" in each]
    assert len(found) == count
    assert all("overlap by up to 0.25 of the smaller radius (lines 2 and 3)" in each for each in found)


def packing(count, diameter):
    """Overrides for particles in a box of 2 cm."""
    box = "particles.beads.insert.region.box={min: [0, 0, 0], max: [2 cm, 2 cm, 2 cm]}"
    changes = (f"count={count}", f"diameter={diameter} mm", "insert.kind=pack")
    return [*(f"particles.beads.{change}" for change in changes), box]


@pytest.mark.parametrize(("height", "is_hit"), [(5, True), (20, False)])
def test_particles_of_a_packing_that_overlap_a_wall_are_left_out(tmp_path, height, is_hit):
    """Centers of spheres of radius 2 mm overlap a plate by more than the limit 0.1 R if they are less than 1.8
    mm from it; the others remain as they are without the plate."""
    beads = ["particles.beads.insert.kind=pack"]
    plate = wall(f"rectangle, corner: [0, 0, {height} mm], sides: [[2 cm, 0, 0], [0, 2 cm, 0]]")
    everywhere = initial_particles(scene_of(tmp_path, *beads)).position
    particles, _, warnings = initial_state(plan_for(scene_of(tmp_path, *beads, *plate)), None, None)
    expected = everywhere[abs(everywhere[:, 2] - 1e-3 * height) >= 1.8e-3]
    assert (particles.position == expected).all() and len(warnings) == is_hit == (len(expected) < 10)
    if is_hit:
        left = f"{10 - len(expected)} of 10 particles are left out because they overlap walls.part"
        assert (
            left in warnings[0] and f"multiply its count or mass by {10 / len(expected):.3g}" in warnings[0]
        )


@pytest.mark.parametrize(("radius", "most_are_inside"), [(9, True), (4, False)])
def test_particles_on_both_sides_of_a_container_are_named(tmp_path, radius, most_are_inside):
    """A packing in a square of 2 cm with an open cylinder about its middle: 9 mm enclose 64 % of the area."""
    vessel = wall(f"cylinder, from: [1 cm, 1 cm, 0], to: [1 cm, 1 cm, 5 cm], radius: {radius} mm")
    plan = plan_for(scene_of(tmp_path, *vessel, *packing(300, 1)))
    everywhere = initial_particles(plan.scene).position
    outside = (np.linalg.norm(everywhere[:, :2] - 0.01, axis=1) > 1e-3 * radius).sum()
    sentence = f": {outside} of 300 particles start outside walls.part and {300 - outside} inside."
    _, _, warnings = initial_state(plan, None, None)
    assert any(sentence in each for each in warnings) == most_are_inside


@pytest.mark.parametrize(("size", "center"), [(0.012, 0.01), (0.05, 0.0)])
def test_packing_leaves_out_the_inside_of_a_solid_body_but_not_of_a_container(tmp_path, size, center):
    """A closed cube of 12 mm with space for whole particles of 2 mm inside, and one of 50 mm around all."""
    points, corners = cube()
    write(tmp_path / "body.stl", size * (points - 0.5) + center, corners)
    parts = [*wall("mesh, file: body.stl"), *packing(600, 2), "walls.floor.point=[0, 0, -1 cm]"]
    particles, _, warnings = initial_state(plan_for(scene_of(tmp_path, *parts)), None, None)
    is_inside = abs(particles.position - center).max(axis=1) < 0.5 * size
    if size < 0.02:
        assert not is_inside.any() and 300 < len(particles) < 600 and "overlap walls.part" in warnings[0]
    else:
        assert is_inside.all() and len(particles) == 600 and warnings == []


def test_packing_behind_a_wall_is_refused(tmp_path):
    plan = plan_for(scene_of(tmp_path, "walls.floor.point=[0, 0, 11 mm]"))
    with pytest.raises(
        SceneError, match="has no particle left, because all are inside or behind walls.floor"
    ):
        initial_state(plan, None, None)


def test_initial_particles_inside_walls_are_reported():
    inside = particle_group([[0.0, 0.0, 0.05], [0.0, 0.0, 0.003], [0.0, 0.0, 0.0049]])
    scene = build_scene({"balls": inside}, walls={"floor": plane([0, 0, 0], [0, 0, 1])})
    (warning,) = particle_warnings(plan_for(scene), initial_particles(scene))
    assert (
        "1 of 3 particles are inside walls.floor at the start, by up to 0.4 of the radius, at [0, 0, 0.003]"
        in warning
    )


@pytest.mark.parametrize(("positions", "distance", "limit", "overlap"), [
    ([[0, 0, 0.1], [0, 0, 0.1]], 0.01, 0.1, 2.0),
    ([[0.05, 0, 0], [0, 0, 0], [0, 0.007, 0]], 0.003, 0.1, 0.6),
    ([[0, 0, -0.998], [0, 0, 0.999]], 0.007, 0.1, 1.4),
    ([[0, 0, 0], [0, 0.0099, 0]], None, 0.1, 0.02),
    ([[0, 0, 0], [0, 0.007, 0]], None, 0.7, 0.6),
], ids=["identical", "overlap", "periodic", "touching", "higher limit"])  # fmt: skip
def test_initial_particles_that_overlap_each_other_are_refused(positions, distance, limit, overlap):
    """Spheres with the radius 5 mm overlap by (2 R - |x_i - x_j|) / R."""
    domain = {"min": [-1.0] * 3, "max": [1.0] * 3, "periodic": ["z"], "on_exit": "error"}
    scene = build_scene({"balls": particle_group(positions)}, domain=domain, numerics={"max_overlap": limit})
    if distance is None:
        return refuse_initial_overlaps(scene, initial_particles(scene))
    sentence = (
        f"overlap by {overlap:g} of the smaller radius .* at most {limit:g} .* Move them {distance:g} m"
    )
    with pytest.raises(SceneError, match=sentence):
        refuse_initial_overlaps(scene, initial_particles(scene))
