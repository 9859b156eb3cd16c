"""Forecasts of probable mistakes: wrong units, output intervals that hide a vibration, inlets and regions of
rain."""

import numpy as np
import pytest
from plan.scenes import TEXT, scene_of

from granflow.errors import SceneError
from granflow.particles.group import groups_of
from granflow.particles.insertion import Inserter
from granflow.plan.build import plan_for


def warnings_of(scene):
    return [each.warning for each in plan_for(scene).forecasts if each.warning]


@pytest.mark.parametrize(
    ("shape", "key", "length"),
    [
        ("cylinder, from: [1 cm, 1 cm, 0], to: [1 cm, 1 cm, 2 cm], radius: 22", "radius", 22.0),
        ("cylinder, from: [1 cm, 1 cm, 0], to: [1 cm, 1 cm, 22], radius: 22 mm", "to", 22.0),
        ("cone, from: [1 cm, 1 cm, 0], to: [1 cm, 1 cm, 2 cm], radius_from: 2 mm, radius_to: 9",
         "radius_to", 9.0),
        ("disc, center: [1 cm, 1 cm, 0], normal: [0, 0, 1], radius: 25", "radius", 25.0),
        ("rectangle, corner: [0, 0, 0], sides: [[20, 0, 0], [0, 2 cm, 0]]", "sides", 20.0),
        ("disc, center: [1 cm, 1 cm, 0], normal: [0, 0, 1], radius: 25 cm", None, 0.25)
    ],
    ids=["radius", "axis", "cone", "disc", "rectangle", "large floor"]
)  # fmt: skip
def test_wall_that_is_much_larger_than_the_domain_is_reported(tmp_path, shape, key, length):
    """The longest side of the domain is 40 mm; a floor of 25 cm is no mistake."""
    text = TEXT.replace("particles:\n", f"  part: {{shape: {shape}, material: glass}}\nparticles:\n")
    found = [
        each
        for each in warnings_of(scene_of(tmp_path, text=text))
        if "walls.part" in each and "Check" in each
    ]
    line = next(number for number, each in enumerate(text.splitlines(), 1) if "  part:" in each)
    if key is None:
        assert found == []
    else:
        (warning,) = found
        beginning = f"beads.yaml:{line}) is {length:.3g} m, {length / 0.04:.0f} times the longest side"
        assert (
            warning.startswith(f"walls.part.{key} (")
            and beginning in warning
            and f"{length:g} mm is {length / 1000:g} m" in warning
        )


def test_wrong_unit_of_a_diameter_is_reported_before_the_errors_that_follow_from_it(tmp_path):
    """Particles of 4 m allow a step of 15 ms, in which the initial velocity moves the others too far."""
    face = "{disc: {center: [1 cm, 1 cm, 2 cm], normal: [0, 0, -1], radius: 5 mm}}"
    inlet = f"{{kind: inlet, rate: 100 1/s, face: {face}}}"
    jet = f"{{material: glass, count: 5, diameter: %s, velocity: [0, 0, -0.5 m/s], insert: {inlet}}}"
    with pytest.raises(SceneError) as error:
        plan_for(scene_of(tmp_path, "particles.beads.fixed=true", "particles.jet=" + jet % 4))
    first = error.value.problems[0]
    assert "particles.jet.diameter is 4 m, larger than the face of the inlet, which is 0.01 m wide" in first
    assert "4 mm is 0.004 m" in first and len(error.value.problems) > 1
    assert not [
        each for each in warnings_of(scene_of(tmp_path, "particles.jet=" + jet % "4 mm")) if "unit" in each
    ]


@pytest.mark.parametrize(("rates", "is_reported"), [([400], True), ([250, -250], False)])
def test_angular_velocity_in_a_wrong_unit_is_reported(tmp_path, rates, is_reported):
    """The farthest point is 30 mm from an axis: 12 and 7.5 m/s. The speeds of a chain do not add up."""
    turns = [
        f"{{kind: rotation, point: [0, 0, 0], axis: [0, 0, 1], angular_velocity: {rate}}}" for rate in rates
    ]
    found = warnings_of(scene_of(tmp_path, f"walls.floor.motion=[{', '.join(turns)}]"))
    assert [each for each in found if "Angular velocities are in rad/s" in each] == found * is_reported
    assert bool(found) == is_reported


VIBRATION = "{kind: vibration, direction: [0, 0, 1], amplitude: 0.1 mm, frequency: 25 Hz}"


@pytest.mark.parametrize(("interval", "halves"), [(20, 1), (60.2, 3), (40, None), (20.5, None)])
@pytest.mark.parametrize("key", ["interval", "timeseries_interval"])
def test_interval_of_half_a_period_is_reported(tmp_path, key, interval, halves):
    """25 Hz: 40 ms. At odd multiples of 20 ms, sin(w t) is 0 in all frames, within 1 % of the period."""
    intervals = {"interval": "5 ms"} | {key: f"{interval} ms"}
    overrides = [f"output.{name}={value}" for name, value in intervals.items()]
    found = warnings_of(scene_of(tmp_path, f"walls.floor.motion={VIBRATION}", "run.duration=1 s", *overrides))
    if halves is None:
        assert found == []
    else:
        (warning,) = found
        assert f"output.{key} (" in warning and "of walls.floor.motion (" in warning
        assert (
            f"{0.5 * halves:g} times the period 0.04 s" in warning and "0.005 s or less, 8 times" in warning
        )


@pytest.mark.parametrize(("velocity", "count"), [("2 mm/s", 1), ("0.05 m/s", 1), ("0.09 m/s", 0)])
def test_planned_velocity_far_below_that_of_a_fall_is_reported(tmp_path, velocity, count):
    """Particles of a lattice fall up to 30 mm onto the floor: sqrt(2 g h) = 0.77 m/s, a tenth of it is the
    limit."""
    region = "{box: {min: [0, 0, 10 mm], max: [2 cm, 2 cm, 30 mm]}}"
    overrides = [f"particles.beads.insert.region={region}", f"run.velocity_max={velocity}"]
    found = [each for each in warnings_of(scene_of(tmp_path, *overrides)) if "run.velocity_max (" in each]
    assert len(found) == count
    fall = (2.0 * 9.81 * 0.03) ** 0.5
    assert all(f"particles.beads can fall 0.03 m and reach {fall:.3g} m/s" in each for each in found)
    damped = warnings_of(scene_of(tmp_path, *overrides, "damping={drag: 20 1/s}"))
    assert not [each for each in damped if "run.velocity_max (" in each]


def inlet_scene(tmp_path, radius):
    """Particles of 4 mm enter through a disc with 0.3 m/s downward, 1200 per second."""
    face = f"{{disc: {{center: [1 cm, 1 cm, 2.5 cm], normal: [0, 0, -1], radius: {radius} mm}}}}"
    return flow_scene(tmp_path, f"{{kind: inlet, rate: 1200 1/s, face: {face}}}")


def flow_scene(tmp_path, insertion, *overrides, count=300, velocity="-0.3 m/s"):
    """A scene with an insertion of particles of 4 mm."""
    jet = (
        f"{{material: glass, count: {count}, diameter: 4 mm, velocity: [0, 0, {velocity}], insert: "
        f"{insertion}}}"
    )
    return scene_of(tmp_path, f"particles.jet={jet}", "run.duration=0.3", *overrides)


BOX = "{box: {min: [0, 0, 1 cm], max: [%s mm, %s mm, 2 cm]}}"
DISC = "{cylinder: {from: [1 cm, 1 cm, 2 cm], to: [1 cm, 1 cm, 1 cm], radius: %s mm}}"


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


def assert_limits_the_rate(scene, is_too_small, largest_ratio, tolerance):
    """Assert that a limit below the required 1200 particles per second is reported if, and only if, it is
    one.

    largest_ratio:  of the reported limit to the rate of the inserter
    tolerance:      relative, of the rate of the inserter without a limit
    Returns:        the warnings
    """
    found = queue_warnings(scene)
    assert len(found) == is_too_small
    reached = rate_through(scene)
    if is_too_small:
        limit = float(found[0].split("at most about ")[1].split(" leave")[0])
        assert reached < limit < min(1200.0, largest_ratio * reached)
    else:
        assert reached == pytest.approx(1200.0, rel=tolerance)
    return found


def queue_warnings(scene):
    """Warnings on particles that are queued."""
    return [each for each in warnings_of(scene) if "are queued" in each]


@pytest.mark.parametrize(("radius", "is_too_small"), [(3.0, True), (15.0, False)])
def test_inlet_that_is_too_small_for_its_rate_is_reported(tmp_path, radius, is_too_small):
    """The forecast is an upper bound of the rate of the inserter, at most three times as large."""
    assert_limits_the_rate(inlet_scene(tmp_path, radius), is_too_small, largest_ratio=3.0, tolerance=0.01)


@pytest.mark.parametrize(("region", "is_too_small"), [(BOX % (6, 6), True), (DISC % 10, False)])
def test_region_of_rain_that_is_too_small_for_its_rate_is_reported(tmp_path, region, is_too_small):
    """The forecast is an upper bound of the rate of the inserter, at most four times as large."""
    scene = flow_scene(tmp_path, f"{{kind: rain, rate: 1200 1/s, region: {region}}}")
    for warning in assert_limits_the_rate(scene, is_too_small, largest_ratio=4.0, tolerance=0.05):
        assert "leave the region in a second" in warning
        assert "Enlarge the region, raise particles.jet.velocity, or lower the rate." in warning


@pytest.mark.parametrize(
    ("count", "gravity", "is_reported"), [(60, 0, True), (20, 0, False), (60, "-9.81", False)]
)
def test_rain_without_motion_is_limited_by_its_region(tmp_path, count, gravity, is_reported):
    """4 cm3 hold at most 0.45 * 4 cm3 / 33.5 mm3 = 54 particles; 60 per second is a low rate with gravity."""
    rain = f"{{kind: rain, rate: 60 1/s, region: {BOX % (20, 20)}}}"
    scene = flow_scene(tmp_path, rain, f"gravity=[0, 0, {gravity}]", count=count, velocity=0)
    found = queue_warnings(scene)
    assert len(found) == is_reported
    assert all("60 particles are required, but the region holds at most about 54" in each for each in found)


DISC_DOWN = "{disc: {center: [1 cm, 1 cm, 2.5 cm], normal: [0, 0, -2], radius: 15 mm}}"
RECTANGLE_DOWN = "{rectangle: {corner: [-5 mm, -5 mm, 2.5 cm], sides: [[0, 3 cm, 0], [3 cm, 0, 0]]}}"
DISC_UP = "{disc: {center: [1 cm, 1 cm, 0], normal: [0, 0, 1], radius: 15 mm}}"
DISC_ACROSS = "{disc: {center: [0, 1 cm, 1 cm], normal: [1, 0, 0], radius: 8 mm}}"


@pytest.mark.parametrize(("face", "velocity", "gravity", "fault", "proposed"), [
    (DISC_DOWN, "[0, 0, 0.3]", -9.81, "is [0, 0, 0.3] m/s, but particles enter through", "[0, 0, -0.3]"),
    (RECTANGLE_DOWN, "[0.1, 0, 0.3]", -9.81, "points against it", "[0.1, 0, -0.3]"),
    (DISC_UP, "[0, 0, 0]", -9.81, "gravity moves them backward", "[0, 0, "),
    (DISC_UP, "[0.3, 0, 0]", -9.81, "gravity moves them backward", "[0.3, 0, "),
    (DISC_ACROSS, "[0, 0, -0.3]", -9.81, "do not leave the face", ", 0, -0.3]"),
    (DISC_DOWN, "[0, 0, 0]", 0.0, "do not leave the face", "[0, 0, -"),
    (DISC_DOWN, "[0, 0, 0]", -9.81, None, None),
    (DISC_DOWN, "[0.3, 0, 0]", -9.81, None, None),
    (DISC_DOWN, "[0.3, 0, -0.01]", 0.0, None, None),
    (DISC_UP, "[0, 0, 0.3]", -9.81, None, None),
    (DISC_ACROSS, "[0, 0, 0]", -9.81, None, None)
])  # fmt: skip
def test_inlet_that_particles_leave_backward_or_not_at_all_is_reported(
    tmp_path, face, velocity, gravity, fault, proposed
):
    """The velocity decides, and gravity for a velocity parallel to the face; the proposed velocity has no
    warning."""

    def direction_warnings(velocity):
        insertion = f"{{kind: inlet, rate: 100 1/s, face: {face}}}"
        jet = f"{{material: glass, count: 20, diameter: 4 mm, velocity: {velocity}, insert: {insertion}}}"
        scene = scene_of(tmp_path, f"particles.jet={jet}", f"gravity=[0, 0, {gravity}]", "run.duration=1")
        return [each for each in warnings_of(scene) if "particles.jet" in each]

    found = direction_warnings(velocity)
    if fault is None:
        assert not [each for each in found if "face of the inlet" in each]
        return
    (warning,) = found
    assert warning.startswith("particles.jet.velocity (--set particles.jet=")
    assert fault in warning and proposed in warning
    valid = warning.split("such as ")[1].split(" m/s")[0]
    assert direction_warnings(valid) == []


@pytest.mark.parametrize(
    ("last", "fault"),
    [
        ("{position: [2 mm, 1e-13, 0], radius: 2 mm}",
         "the same sphere as spheres.1: its contacts count twice"),
        ("{position: [6.5 mm, 0, 0], radius: 2 mm}", "0.0005 m away from the surface of spheres.1"),
        ("{position: [2 mm, 0, 0], radius: 1.9 mm}", None),
        ("{position: [6 mm, 0, 0], radius: 2 mm}", None)
    ],
    ids=["coincident", "disjoint", "concentric", "touching"]
)  # fmt: skip
def test_clumps_with_a_sphere_twice_or_a_gap_are_reported(tmp_path, last, fault):
    def clump_warnings(last):
        lines = ["{position: [0, 0, 0], radius: 2 mm}", "{position: [2 mm, 0, 0], radius: 2 mm}", last]
        spheres = "".join(f"        - {line}\n" for line in lines)
        text = TEXT.replace("    diameter: 4 mm\n", f"    clump:\n      spheres:\n{spheres}").replace(
            "count: 10", "count: 1"
        )

        return [each for each in warnings_of(scene_of(tmp_path, text=text)) if ".clump." in each]

    found = clump_warnings(last)
    if fault is None:
        assert found == []
        return
    (warning,) = found
    line = TEXT[: TEXT.index("    diameter: 4 mm\n")].count("\n") + 5
    assert (
        warning.startswith("particles.beads.clump.spheres.2.position (")
        and f"beads.yaml:{line}) is [0.00" in warning
    )
    assert fault in warning
    valid = warning.split("such as ")[1].split(" m")[0]
    assert clump_warnings(f"{{position: {valid}, radius: 2 mm}}") == []


MASS = 2500.0 * np.pi / 6.0 * 0.004**3
"""Mass [kg] of a particle of 4 mm."""
JET = "{kind: rain, rate: 100 1/s, start: 0.1 s, region: {box: {min: [0, 0, 1 cm], max: [2 cm, 2 cm, 2 cm]}}}"


@pytest.mark.parametrize(("condition", "bound"), [
    ("quantity: particle_count, above: 310", "at most 310, the number of all particles until then"),
    ("quantity: particle_count, above: 309", None),
    ("quantity: inserted_count.jet, above: 300", "at most 300, the count of particles.jet"),
    ("quantity: inserted_count.jet, above: 299", None),
    (f"quantity: deleted_mass, above: {310.5 * MASS}", f"at most {310.0 * MASS:.6g} kg"),
    (f"quantity: deleted_mass, above: {309.5 * MASS}", None),
    ("quantity: kinetic_energy, below: 0", "kinetic_energy is never below 0"),
    ("quantity: kinetic_energy, below: 1e-9", None),
])  # fmt: skip
def test_condition_that_can_never_be_satisfied_is_reported(tmp_path, condition, bound):
    """Ten particles at the start, and 300 that enter within 10 s."""
    stages = f"stages=[{{name: fill, until: {{{condition}}}, max_duration: 10 s}}]"
    text = TEXT.replace("  duration: 50 ms\n", "")
    jet = f"particles.jet={{material: glass, count: 300, diameter: 4 mm, insert: {JET}}}"
    found = [
        each for each in warnings_of(scene_of(tmp_path, jet, stages, text=text)) if "stages.0.until" in each
    ]
    assert len(found) == (bound is not None)
    assert bound is None or (bound in found[0] and "the stage lasts its max_duration, 10 s" in found[0])


@pytest.mark.parametrize(("duration", "above", "is_reported"), [(1.0, 91, True), (1.0, 90, False)])
def test_count_that_a_flow_does_not_reach_within_the_stage_is_reported(
    tmp_path, duration, above, is_reported
):
    """100 per second from 0.1 to 1 s are due at 0.1, 0.11, ..., 1 s: 91 particles."""
    stages = f"stages=[{{name: fill, until: {{quantity: inserted_count.jet, above: {above}}}, max_duration: {duration}}}]"
    text = TEXT.replace("  duration: 50 ms\n", "")
    jet = f"particles.jet={{material: glass, count: 300, diameter: 4 mm, insert: {JET}}}"
    found = [
        each for each in warnings_of(scene_of(tmp_path, jet, stages, text=text)) if "stages.0.until" in each
    ]
    assert len(found) == is_reported
    assert not found or "at most 91 until the end of the stage at the rate of particles.jet" in found[0]


@pytest.mark.parametrize(("interval", "is_reported"), [("0.3 s", True), ("10 ms", False)])
def test_stage_without_a_row_for_its_condition_is_reported(tmp_path, interval, is_reported):
    until = "{quantity: kinetic_energy, below: 1 nJ}"
    stages = f"stages=[{{name: settle, until: {until}, max_duration: 0.2 s}}]"
    text = TEXT.replace("  duration: 50 ms\n", "")
    scene = scene_of(tmp_path, stages, f"output.timeseries_interval={interval}", text=text)
    found = [each for each in warnings_of(scene) if "is evaluated at the rows of the time series" in each]
    assert len(found) == is_reported


@pytest.mark.parametrize("key", ["gravity=[0, 0, -1e-300]", "pairs.glass-glass.restitution=1e-300"])
def test_numbers_whose_square_underflows_are_zero(tmp_path, key):
    """A gravity of 1e-300 has no direction in double precision, and a restitution of 1e-300 no damping."""
    scene = scene_of(tmp_path, key)
    assert scene == scene_of(tmp_path, key.replace("-1e-300", "0").replace("1e-300", "0"))
    assert plan_for(scene).time_step > 0.0
