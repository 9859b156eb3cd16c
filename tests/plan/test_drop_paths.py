"""Impact velocity of the forecasts along the paths of particles over chutes, belts, tables and hoppers.

The expected velocities follow from the heights of the walls in the scenes. `plan.impact_velocity` stays that
of a fall through the domain.
"""

import json

import numpy as np
import pytest
from scene_builders import build_scene, particle_group, plane

from granflow import load_scene
from granflow.plan.build import plan_for
from granflow.plan.falls import forecast_velocity, path_velocity

G = 9.81
TOP, FLOOR = 0.6, -0.9
SOFT = {"glass": {"young_modulus": 1e6, "poisson_ratio": 0.25, "density": 2500.0}}


def rectangle(corner, *sides, **more):
    return {"shape": "rectangle", "corner": corner, "sides": [*sides], "material": "glass"} | more


CHUTE = rectangle([-0.2, -0.1, 0.5], [0.3, 0, -0.3], [0, 0.2, 0])
"""Inclined by 45 degrees, at 0.3 m below the particle, and down to 0.2 m."""
TABLE = rectangle([-0.2, -0.2, 0.2], [0.4, 0, 0], [0, 0.4, 0])
SIDES = {
    f"side{number}": rectangle([-0.2 * x - 0.2 * abs(y), -0.2 * y - 0.2 * abs(x), 0.1], side, [0, 0, 0.3])
    for number, (x, y, side) in enumerate(
        [(1, 0, [0, 0.4, 0]), (-1, 0, [0, 0.4, 0]), (0, 1, [0.4, 0, 0]), (0, -1, [0.4, 0, 0])]
    )
}
"""Four walls around the table, from below to above it."""
HOPPER = {"shape": "cone", "from": [0, 0, 0.5], "to": [0, 0, 0.2], "radius_from": 0.35, "radius_to": 0.05}
FLOORS = {"floor": plane([0, 0, FLOOR], [0, 0, 1])}


def scene(walls, insert=None, velocity=(0.0, 0.0, 0.0), **parts):
    """One particle at 0.6 m above the origin, or a group in a region, above a floor at -0.9 m."""
    group = particle_group([[0.0, 0.0, TOP]], 0.01, velocity=list(velocity))
    if insert is not None:
        group = {
            "material": "glass",
            "count": 10,
            "diameter": 0.01,
            "insert": insert,
            "velocity": list(velocity),
        }
    usual = {"gravity": [0.0, 0.0, -G], "materials": SOFT, "normal": "hertz"}
    return build_scene({"balls": group}, walls=FLOORS | walls, **usual | parts)


def fall(height, initial=0.0):
    return np.sqrt(initial**2 + 2.0 * G * height)


def belt(speed):
    return TABLE | {"motion": {"kind": "surface_velocity", "velocity": [speed, 0, 0]}}


AFTER_CHUTE = 0.5 * 0.3 + 0.1 + (0.2 - FLOOR)
"""Height [m] of the fall with the velocity after the chute: half of the energy of the impact is along it."""
CASES = {
    "chute": (scene({"chute": CHUTE}), fall(AFTER_CHUTE)),
    "table without sides": (scene({"table": TABLE}), fall(0.2 - FLOOR)),
    "table with sides": (scene({"table": TABLE} | SIDES), fall(TOP - 0.2)),
    "hopper": (
        scene({"hopper": HOPPER | {"material": "glass"}}, {"kind": "pack", "region": {"box": {
            "min": [0.1, -0.05, 0.5], "max": [0.2, 0.05, TOP]}}}),
        None,
    ),
    "beside the table": (scene({"table": TABLE | {"corner": [0.01, 0.01, 0.2]}}), fall(TOP - FLOOR)),
    "thrown over the table": (scene({"table": TABLE}, velocity=(1.5, 0.0, 0.0)), fall(TOP - FLOOR, 1.5)),
    "table that vanishes": (scene({"table": TABLE | {"vanishes_at": 0.5}} | SIDES), fall(TOP - FLOOR)),
}  # fmt: skip


@pytest.mark.parametrize("name", [name for name, (_, expected) in CASES.items() if expected is not None])
def test_impact_velocity_follows_from_the_heights_of_the_walls_on_the_path(name):
    given, expected = CASES[name]
    assert path_velocity(plan_for(given)).value == pytest.approx(expected, rel=1e-6)


def test_path_over_a_cone_keeps_the_velocity_along_it_and_ends_below_its_orifice():
    """The cone has a slope of 45 degrees (facets: up to 0.2 % more) and an orifice at 0.2 m.

    A particle at the distance r from the axis falls onto it at the height 0.15 m + r; all start at the height
    TOP.
    """
    given, _ = CASES["hopper"]
    found = path_velocity(plan_for(given))
    low, high = (
        0.5 * (TOP - 0.15 - r) + (0.15 + r - 0.2) + (0.2 - FLOOR) for r in (0.1, np.hypot(0.2, 0.05))
    )
    assert fall(low) < found.value < 1.005 * fall(high) < forecast_velocity(plan_for(given)).value
    assert "particles.balls over walls.hopper to walls.floor" in found.source


@pytest.mark.parametrize("speed", [0.5, 3.0])
def test_belt_adds_its_speed_and_throws_particles(speed):
    """A particle falls from the belt with its speed u, and the fastest impact is against another point of a
    belt."""
    given = scene({"belt": belt(speed)})
    expected = fall(max(0.2 - FLOOR, 0.0), speed) + speed
    assert path_velocity(plan_for(given)).value == pytest.approx(expected, rel=1e-6)
    enclosed = scene({"belt": belt(speed)} | SIDES)
    expected = max(fall(TOP - 0.2), speed) + speed
    assert path_velocity(plan_for(enclosed)).value == pytest.approx(expected, rel=1e-6)


def test_mesh_stops_a_fall_as_the_rectangle_of_its_triangles(tmp_path):
    (tmp_path / "chute.obj").write_text(
        "v -200 -100 500\nv 100 -100 200\nv 100 100 200\nv -200 100 500\nf 1 2 3 4\n"
    )
    wall = {"shape": "mesh", "file": "chute.obj", "scale": 1e-3, "material": "glass"}
    given = scene({"chute": CHUTE}).to_dict() | {"walls": FLOORS | {"chute": wall}}
    (tmp_path / "scene.yaml").write_text(json.dumps(given))
    loaded = load_scene(tmp_path / "scene.yaml")
    assert path_velocity(plan_for(loaded)).value == pytest.approx(fall(AFTER_CHUTE), rel=1e-6)


def test_inlet_starts_with_its_velocity():
    inlet = {
        "kind": "inlet",
        "rate": 100,
        "face": {"rectangle": {"corner": [-0.05, -0.05, TOP], "sides": [[0, 0.1, 0], [0.1, 0, 0]]}},
    }
    given = scene({"table": TABLE} | SIDES, inlet, velocity=(0.0, 0.0, -2.0))
    assert path_velocity(plan_for(given)).value == pytest.approx(fall(TOP - 0.2, 2.0), rel=1e-6)


def warned(given):
    return [each for each in plan_for(given).warnings if "an impact at" in each]


def stiff_for(height):
    """Materials for which an elastic impact after a fall by `height` [m] overlaps by 0.095 of the radius.

    d/R = (5 pi rho v^2 / (4 E*))^0.4,     E* = E / (2 (1 - nu^2))
    """
    modulus_eff = 1.25 * np.pi * 2500.0 * fall(height) ** 2 / 0.095**2.5
    return {"glass": SOFT["glass"] | {"young_modulus": 2.0 * (1.0 - 0.25**2) * float(modulus_eff)}}


def test_walls_between_insertion_and_floor_remove_false_warnings_only():
    enough = stiff_for(TOP - 0.2)
    elastic = {"pair": {"restitution": 1.0}}
    assert not warned(scene({"table": TABLE} | SIDES, materials=enough, **elastic))
    assert warned(scene({}, materials=enough, **elastic))
    assert warned(scene({"table": TABLE}, materials=enough, **elastic)), (
        "particles fall over the edges of the table"
    )
    assert warned(scene({"table": TABLE} | SIDES, materials=stiff_for(0.8 * (TOP - 0.2)), **elastic))
