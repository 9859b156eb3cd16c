"""Forecasts of overlaps by impacts and pressures, of impact velocities, and of walls moved by forces."""

import re
from math import exp, log, pi, sqrt

import numpy as np
import pytest
from scene_builders import SOFT, build_scene, particle_group, plane

from granflow import load_scene
from granflow.cli.run import scene_paths
from granflow.errors import SceneError
from granflow.plan.build import plan_for
from granflow.plan.overlaps import impact_overlap, impact_velocity, touching_pairs
from granflow.plan.walls import surface_speed

GRAVITY = 9.81


def warnings_of(scene):
    return [each.warning for each in plan_for(scene).forecasts if each.warning]


def test_conducting_materials_without_their_real_modulus_are_listed():
    """heat_bed gives true_young_modulus, heat_conduction does not."""
    plans = [
        plan_for(load_scene(scene_paths()[f"verification/{name}"]))
        for name in ("heat_conduction", "heat_bed")
    ]
    areas = [[each.value for each in plan.forecasts if "areas" in each.name] for plan in plans]
    assert areas == [["of 10 MPa"], []]


def dropped_ball(modulus, restitution=1.0, **parts):
    """A particle of 10 mm that hits a floor with 2.5 m/s."""
    return build_scene(
        {"ball": particle_group([[0.0, 0.0, 0.1]])}, {"floor": plane([0, 0, 0], [0, 0, 1])},
        {"restitution": restitution}, run={"duration": 0.1, "velocity_max": 2.5}, normal="hertz",
        materials={"glass": SOFT | {"young_modulus": modulus}}, **parts
    )  # fmt: skip


def bed(modulus=1e9, walls=None, run=None, **more):
    """300 particles of 4 mm above a floor of 24 mm x 24 mm in a domain of 26 mm x 26 mm."""
    region = {"box": {"min": [0.0, 0.0, 0.0], "max": [0.024, 0.024, 0.095]}}
    insert = {"kind": "pack", "region": region}
    beads = {"material": "glass", "count": 300, "diameter": 0.004, "insert": insert}
    parts = {
        "gravity": [0.0, 0.0, -GRAVITY], "normal": "hertz",
        "run": {"duration": 0.1, "velocity_max": 0.15} | (run or {}),
        "domain": {"min": [-0.001] * 3, "max": [0.025, 0.025, 0.11], "on_exit": "delete"},
        "materials": {"glass": SOFT | {"young_modulus": modulus}},
    }  # fmt: skip
    return build_scene(
        {"beads": beads}, {"floor": plane([0, 0, 0], [0, 0, 1])} | (walls or {}), **parts | more
    )


def cohesive_bed():
    contact = {"normal": "hertz", "tangential": "none", "rolling": "none", "cohesion": "sjkr"}
    return bed(1e6, pair={"restitution": 0.5, "cohesion_energy_density": 5e4}, contact=contact)


def large_on_small(modulus, ratio=20.0, count=1500):
    """A particle of `ratio` mm that falls by 7 mm onto a layer of particles of 1 mm on a floor of 24 mm x 24
    mm."""
    region = {"box": {"min": [-0.012, -0.012, 0.0], "max": [0.012, 0.012, 0.006]}}
    insert = {"kind": "pack", "region": region}
    small = {"material": "glass", "count": count, "diameter": 0.001, "insert": insert}
    large = particle_group([[0.0, 0.0, 0.0005 * ratio + 0.007]], 0.001 * ratio)
    return build_scene(
        {"small": small, "large": large}, {"floor": plane([0, 0, 0], [0, 0, 1])},
        materials={"glass": SOFT | {"young_modulus": modulus}},
        gravity=[0.0, 0.0, -GRAVITY], run={"duration": 0.1, "velocity_max": 0.37},
        domain={"min": [-0.013, -0.013, -0.001], "max": [0.013, 0.013, 0.06], "on_exit": "error"},
    )  # fmt: skip


def effective(modulus):
    """E* of two bodies with Poisson's ratio 1/4."""
    return modulus / (2.0 * (1.0 - 0.25**2))


IMPACT = (1.25 * pi * 2500.0 * 2.5**2 / effective(1e7)) ** 0.4
PRESSURE = 300 * pi / 6 * 0.004**3 * 2500.0 * GRAVITY / 0.024**2
FORCE = log(2 * 3 * 0.024**2 / 0.004**2) / 1.5 * pi * 0.004**2 * PRESSURE / 3.6
SUPPORTS = 0.8 * 2.0 * 0.01 * 0.1 / 0.0005
SHARED = 2500.0 * 4.0 / 3.0 * pi * 0.01**3 / (2.0 * SUPPORTS)


@pytest.mark.parametrize(("name", "scene", "overlap", "tolerance"), [
    ("overlap of impacts", dropped_ball(1e7), IMPACT, 1e-3),
    ("overlap under the weight", bed(1e5), (FORCE / (4 / 3 * effective(1e5) * sqrt(0.001))) ** (2 / 3) / 0.002, 1e-6),
    ("overlap by cohesion", cohesive_bed(), (1.5 * pi * 5e4 / effective(1e6)) ** 2, 1e-6),
    ("overlap of impacts", large_on_small(1e7), (
        1.25 * SHARED * 0.37**2 / (4 / 3 * effective(1e7) * sqrt(0.01 * 0.0005 / 0.0105))
    )**0.4 / 0.0005, 0.01),
], ids=["impact", "weight", "cohesion", "large on small"])  # fmt: skip
def test_overlap_equals_theory(name, scene, overlap, tolerance):
    """Impact on a wall: (5 m v^2 / (4 k))^0.4 / R with k = 4/3 E* sqrt(R) is (5 pi rho v^2 / (4 E*))^0.4.

    Weight: p = M g / A; the largest of N = 3 A / d^2 forces is ln(2 N) / 1.5 times the mean pi d^2 p / (0.6 6), and
    F = 4/3 E* sqrt(R/2) delta^1.5 between two particles.

    SJKR balances Hertz where 2 pi w R* d = 4/3 E* sqrt(R*) d^1.5: d = R* (3 pi w / (2 E*))^2; at a wall R* = R.

    Large on small: M v^2 / 2 is stored in 2 N contacts, (2/5) k d^2.5 each, N = 0.8 2 R d / r^2 at the limit d = 0.1
    r.
    """
    found = next(each for each in plan_for(scene).forecasts if each.name == name)
    assert found.overlap == pytest.approx(overlap, rel=tolerance)


def test_advised_modulus_is_just_enough_for_the_permitted_overlap():
    """The overlap is proportional to E^-0.4. Viscous forces lower it, a higher limit permits more of it.

    In runs with the large particle the largest overlap is 0.46 of the radius at 10 MPa, 0.24 at 60 MPa: 0.6 GPa is
    enough. A smaller particle, a deep bed, and few small particles lead to binary collisions, with 0.06.
    """
    advised = re.compile(r"young_modulus to ([\d.]+) ([GM])Pa")
    (warning,) = warnings_of(dropped_ball(1e7))
    value, unit = advised.search(warning).groups()
    enough = 1e7 * (IMPACT / 0.1) ** 2.5
    assert enough < float(value) * {"G": 1e9, "M": 1e6}[unit] < 1.2 * enough
    assert warnings_of(dropped_ball(1.2 * enough)) == []
    assert warnings_of(dropped_ball(0.9 * enough, restitution=0.3)) == []
    assert warnings_of(dropped_ball(1e7, numerics={"max_overlap": 0.21})) == []
    (warning,) = warnings_of(large_on_small(1e7))
    value, unit = advised.search(warning).groups()
    assert unit == "G" and 0.6 < float(value) < 1.5 and warnings_of(large_on_small(1e9 * float(value))) == []
    for change in ({"ratio": 5.0}, {"count": 5000}, {"count": 3}):
        assert warnings_of(large_on_small(1e7, **change)) == []


@pytest.mark.parametrize(("normal", "stored"), [
    ("hertz", 0.5**2.5), ("zhou", 0.5**2.5), ({"law": "linear", "stiffness": {"value": 2e3}}, 0.25)
])  # fmt: skip
def test_impact_velocity_follows_from_the_elastic_energy_of_the_model(normal, stored):
    """At half of the largest overlap of an elastic impact at 0.1 m/s, with the approach velocity that remains
    there. A linear spring stores k d^2 / 2, a Hertz contact 8/15 E* sqrt(R) d^2.5."""
    balls = particle_group([[0.0, 0.0, 0.1], [0.0, 0.0, 0.2]])
    plan = plan_for(build_scene({"balls": balls}, normal=normal, pair={"restitution": 1.0}))
    (pair,) = touching_pairs(plan)
    half = 0.5 * pair.overlap_radius * impact_overlap(plan.laws, pair, 0.1)
    assert impact_velocity(plan.laws, pair, half, 0.1 * sqrt(1.0 - stored)) == pytest.approx(0.1, rel=1e-3)


def lid(pressure=1e4, before=(), **more):
    """A plate of 24 mm x 24 mm at z = 100 mm that a force presses down."""
    motion = {"kind": "servo", "direction": [0, 0, -1], "pressure": pressure, "velocity_max": 0.5} | more
    plate = {"shape": "rectangle", "corner": [0, 0, 0.1], "sides": [[0.024, 0, 0], [0, 0.024, 0]]}
    return {"lid": plate | {"material": "glass", "motion": [*before, motion]}}


def free_lid(**more):
    walls = lid()
    walls["lid"]["motion"] = {"kind": "free", "direction": [0, 0, 1], "mass": 0.05} | more
    return walls


DISTANCE = 0.1 - 300 * pi / 6 * 0.004**3 / (0.55 * 0.024**2) - 0.004
"""Distance [m] of a lid from 300 spheres of 4 mm: 31.7 mm high at the solid fraction 0.55, and a layer."""
FALL = sqrt(2.0 * GRAVITY * DISTANCE)
SLOW = {"gain": 1e-3, "velocity_max": 2.0}
LOWERING = {"kind": "translation", "velocity": [0, 0, -0.5], "end": 0.05}
LIFT = free_lid(force=5.0 * 0.05 * GRAVITY)
STEEP = {"lid": lid()["lid"] | {"sides": [[0.024, 0, 0.024], [0, 0.024, 0]]}}
WIDE = {"lid": lid()["lid"] | {"sides": [[0.048, 0, 0], [0, 0.024, 0]]}}


@pytest.mark.parametrize(("sentence", "wrong", "right"), [
    (r"under walls.lid, which presses with 115 N \(200 kPa\).*Set materials.glass.young_modulus",
     bed(1e6, lid(2e5), {"duration": 0.2}),
     bed(1e9, lid(2e5), {"duration": 0.2})),
    ("10 kPa is the pressure on the whole wall.*, on which it is 20 kPa. Give between", bed(walls=WIDE), bed(walls=lid())),
    # A lid that rises by 45 degrees covers 0.707 of its area across the direction.
    ("10 kPa times the area of all faces of the wall, 0.000815 m2, is 8.15 N, but the wall covers only 0.000576 m2",
     bed(walls=STEEP), bed(walls=lid())),
    ("motion.0.velocity_max .* is 100 m/s, faster than presses", bed(walls=lid(velocity_max=100.0)), bed(walls=lid())),
    # The lid moves 10 mm in 0.1 s.
    (f"the bed is about {DISTANCE:.3g} m away.*Set velocity_max to 0.7[0-9]* m/s",
     bed(walls=lid(1e5, velocity_max=0.1)), bed(walls=lid(1e5, velocity_max=0.77))),
    ("the bed is about", bed(walls=lid(1e5, velocity_max=0.1)), bed(walls=lid(1e5, [LOWERING], velocity_max=0.1))),
    ("the bed is about", bed(walls=lid(1e5, velocity_max=0.1)),
     bed(walls=lid(1e5, direction=[1, 0, 0], velocity_max=0.1))),
    # Without contacts a servo moves at gain F = 1e-3 m/(s N) 5.76 N: in 11.2 s, or in 0.1 s at a target of 643 N.
    (r"0.00576 m/s, gain times force.*target \(to 7.7e\+02 N.* give it 13 s", bed(walls=lid(**SLOW)),
     bed(walls=lid(770.0 / 0.024**2, **SLOW))),
    ("gain times force", bed(walls=lid(**SLOW)), bed(walls=lid(**SLOW), run={"duration": 13.0})),
    ("only friction can balance", bed(walls=lid(direction=[1, 0, 0])), bed(walls=lid())),
    (f"the free wall hits the bed with about {FALL:.3g} m/s", bed(walls=free_lid(), run={"duration": 0.12}),
     bed(walls=free_lid(), run={"duration": 0.12, "velocity_max": 1.01 * FALL})),
    ("the free wall hits the bed", bed(walls=free_lid(), run={"duration": 0.12}),
     bed(walls=free_lid(), run={"duration": 0.01})),
    # 10 mm to the end of the domain with (F - M g) / M = 4 g in sqrt(2 s / 4 g) = 22.6 ms.
    ("nothing stops the free wall.*leaves the domain after 0.0226 s", bed(walls=LIFT),
     bed(walls=LIFT | {"roof": plane([0, 0, 0.108], [0, 0, -1])})),
    # The weights of 25 g of particles and of 50 g balance the force.
    ("nothing stops the free wall", bed(walls=LIFT), bed(walls=free_lid(force=0.075 * GRAVITY - 0.01))),
])  # fmt: skip
def test_wall_that_a_force_moves_wrongly_is_reported(sentence, wrong, right):
    wrong, right = (any(re.search(sentence, each) for each in warnings_of(scene)) for scene in (wrong, right))
    assert wrong and not right


def test_damped_free_wall_approaches_its_terminal_velocity():
    """M dv/dt = M g - c v: v = V (1 - exp(-t / T)), s = V (t - T + T exp(-t / T)), V = M g / c = 0.98 m/s, T = M /
    c."""
    decay = 0.05 / 0.5
    terminal = GRAVITY * decay
    times = np.linspace(0.0, 0.3, 100_001)
    reached = terminal * (times - decay + decay * np.exp(-times / decay))
    speed = terminal * (1.0 - exp(-float(times[np.searchsorted(reached, DISTANCE)]) / decay))
    (warning,) = warnings_of(bed(walls=free_lid(damping=0.5), run={"duration": 0.3}))
    assert f"hits the bed with about {speed:.3g} m/s" in warning


def speed_of_walls(scene):
    return surface_speed(scene, plan_for(scene).walls)


def test_particles_attached_to_a_rotating_wall_count_in_its_speed():
    """w (L + R): L = 30 mm from the axis to the center of the farthest particle, up to the corner of the cube
    around it; in a region, to the farthest corner."""
    turn = {"kind": "rotation", "point": [0, 0, 0], "axis": [0, 0, 1], "angular_velocity": 20.0}
    ends = {"from": [0, 0, -0.01], "to": [0, 0, 0.01]}
    shaft = {"shape": "cylinder", "radius": 0.005, "material": "glass", "motion": turn} | ends
    pins = particle_group([[0.01, 0, 0], [0.0, 0.03, 0]], 0.01) | {"fixed": {"to": "shaft"}}
    region = {"box": {"min": [0.0, 0.0, -0.01], "max": [0.03, 0.04, 0.01]}}
    lattice = pins | {"insert": {"kind": "lattice", "region": region}, "count": 2}
    for groups, low, high in (
        ({"pins": pins}, 20.0 * 0.035, 20.0 * (0.03 + 0.005 * sqrt(2.0))),
        ({"pins": lattice}, 20.0 * 0.05, 20.0 * 0.05),
        ({}, 20.0 * 0.005, 20.0 * 0.005),
    ):
        groups = {"ball": particle_group([[0.05, 0.05, 0.0]], 0.01)} | groups
        speed = speed_of_walls(build_scene(groups, walls={"shaft": shaft}))
        assert low * (1 - 1e-9) <= speed <= high * (1 + 1e-9)


def test_servos_of_one_wall_need_different_stages_or_perpendicular_directions():
    stages = [{"name": name, "duration": 0.1} for name in ("seat", "press")]

    def scene_with(**more):
        walls = lid(before=[{"kind": "servo", "force": 1.0, "velocity_max": 0.1} | more], velocity_max=0.3)
        walls["lid"]["motion"][1]["stages"] = ["press"]
        return bed(walls=walls, stages=stages, run={"duration": None})

    assert speed_of_walls(scene_with(direction=[0, 0, -1], stages=["seat"])) == pytest.approx(0.3)
    assert speed_of_walls(scene_with(direction=[1, 0, 0])) == pytest.approx(0.4)
    # The stage press lasts from 0.1 to 0.2 s.
    plan_for(scene_with(direction=[0, 0, -1], end=0.1))
    for more in ({"direction": [0, 0, 1]}, {"direction": [0, 1, 1], "end": 0.11}):
        with pytest.raises(SceneError, match="motion.1 and motion.0 move the wall at the same time"):
            plan_for(scene_with(**more))


FLOOR = plane([0, 0, 0.1], [0, 0, 1])
PLATE = {
    "shape": "rectangle",
    "corner": [0, 0, -0.2],
    "sides": [[0.1, 0, 0], [0, 0.1, 0]],
    "material": "glass",
}
BOX = {"box": {"min": [0.0, 0.0, 0.2], "max": [0.1, 0.1, 0.4]}}
TURN = {"kind": "rotation", "axis": [0, 1, 0], "point": [0, 0, 0.6], "angular_velocity": 0.5}
DRUM = {"shape": "cylinder", "from": [0, -0.1, 0.6], "to": [0, 0.1, 0.6], "radius": 0.5, "material": "glass"}
PUSH = {"kind": "servo", "direction": [0, 0, 1], "force": 1.0, "velocity_max": 0.1}
SHAKE = {"kind": "vibration", "direction": [0, 0, 1], "gamma": 3, "frequency": 20.0}
RISE = {"kind": "translation", "velocity": [0, 0, 0.1], "end": 2.0}
DOMAIN = {"min": [-1.0] * 3, "max": [1.0] * 3, "on_exit": "error"}
OMEGA = 2.0 * pi * 20.0
REACH = np.hypot(0.4, 0.1)


@pytest.mark.parametrize(("walls", "parts", "speed", "height"), [
    ({"floor": FLOOR}, {"velocity": (3.0, 0.0, 0.0)}, 0.0, 0.2),
    ({"plate": PLATE}, {}, 0.0, 0.5),
    ({"floor": FLOOR}, {"region": BOX}, 0.0, 0.3),
    ({"floor": FLOOR | {"vanishes_at": 0.1}}, {}, 0.0, 1.3),
    ({"floor": FLOOR | {"motion": SHAKE}}, {}, 3.0 * GRAVITY / OMEGA, 0.2 + 2.0 * 3.0 * GRAVITY / OMEGA**2),
    ({"drum": DRUM | {"motion": TURN}}, {}, 0.25, 0.5 + 0.25**2 / GRAVITY),
    ({"plate": PLATE | {"motion": TURN | {"point": [0, 0, 0.2]}}}, {}, 0.5 * REACH, 0.4 + REACH),
    ({"plate": PLATE | {"motion": PUSH}}, {}, 0.1, 1.2),
    ({"floor": FLOOR | {"motion": RISE}}, {}, 0.1, 0.2 + 0.1),
    ({"floor": FLOOR}, {"run": {"duration": 1.0, "velocity_max": 0.5}}, None, None),
    ({"floor": FLOOR}, {"domain": DOMAIN | {"periodic": ["z"]}}, None, None),
    ({"floor": FLOOR}, {"gravity": [0.0, 0.0, 0.0]}, None, None),
])  # fmt: skip
def test_impact_forecast_falls_from_insertion_or_lifting_walls_to_the_lowest_wall(
    walls, parts, speed, height
):
    """v = sqrt(v0^2 + u^2 + 2 g h) + u with the speed u of a wall; a drum holds particles up to u^2/g above its
    axis. The upper particle is at 0.3 m, the domain from -1 m to 1 m, the run lasts 1 s. Where the height is not
    known, the velocity is that of the time step."""
    parts = {"gravity": [0, 0, -GRAVITY], "materials": {"glass": SOFT | {"young_modulus": 1e10}}} | parts
    initial = parts.pop("velocity", (0.0, 0.0, 0.0))
    group = particle_group([[0.0, 0.0, 0.3], [0.0, 0.0, 0.2]], 0.01, velocity=initial)
    if region := parts.pop("region", None):
        insert = {"kind": "pack", "region": region}
        group = {"material": "glass", "count": 10, "diameter": 0.01, "insert": insert}
    plan = plan_for(build_scene({"balls": group}, walls, **parts))
    remark = next(each.remark for each in plan.forecasts if each.cause == "impact")
    if height is None:
        assert f"at {plan.impact_velocity.value:.3g} m/s ({plan.impact_velocity.source})" in remark
    else:
        expected = sqrt(initial[0] ** 2 + speed**2 + 2.0 * GRAVITY * height) + speed
        assert f"at {expected:.3g} m/s (estimated from a fall " in remark
