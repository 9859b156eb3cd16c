"""Impact velocity of the forecasts from the drop height, below that of the time step."""

import numpy as np
import pytest
from scene_builders import SOFT, build_scene, particle_group, plane

from granflow.plan.build import plan_for

GRAVITY = 9.81
HARD = {"glass": SOFT | {"young_modulus": 1e10}}
FLOOR = {"floor": plane([0, 0, 0.1], [0, 0, 1])}
RECTANGLE = {
    "shape": "rectangle", "corner": [0, 0, -0.2], "sides": [[0.1, 0, 0], [0, 0.1, 0]], "material": "glass"
}  # fmt: skip
BOX = {"box": {"min": [0.0, 0.0, 0.2], "max": [0.1, 0.1, 0.4]}}
TUBE = {"cylinder": {"from": [0, 0, 0.3], "to": [0.1, 0, 0.3], "radius": 0.05}}
SHAKING = {"motion": {"kind": "vibration", "direction": [0, 0, 1], "gamma": 3, "frequency": 20.0}}
DRUM = {
    "shape": "cylinder", "from": [0, -0.1, 0.6], "to": [0, 0.1, 0.6], "radius": 0.5, "material": "glass",
    "motion": {"kind": "rotation", "axis": [0, 1, 0], "point": [0, 0, 0.6], "angular_velocity": 0.5}
}  # fmt: skip
PUSHED = {"motion": {"kind": "servo", "direction": [0, 0, 1], "force": 1.0, "velocity_max": 0.1}}
LID = plane([0, 0, 0.5], [0, 0, -1]) | {"motion": PUSHED["motion"] | {"direction": [0, 0, -1]}}


def scene(walls, insert=None, velocity=(0.0, 0.0, 0.0), gravity=(0.0, 0.0, -GRAVITY), **parts):
    """Two particles, the upper one at 0.3 m, or a group inserted in a region; the domain is from -1 m to 1
    m."""
    group = particle_group([[0.0, 0.0, 0.3], [0.0, 0.0, 0.2]], 0.01, velocity=list(velocity))
    if insert is not None:
        group = {
            "material": "glass", "count": 10, "diameter": 0.01, "insert": {"kind": "pack", "region": insert}
        }  # fmt: skip
    return build_scene({"balls": group}, walls=walls, gravity=list(gravity), materials=HARD, **parts)


def fall(height, initial=0.0):
    return np.sqrt(initial**2 + 2.0 * GRAVITY * height)


CASES = {
    "floor": (scene(FLOOR), fall(0.2)),
    "initial speed": (scene(FLOOR, velocity=(3.0, 0.0, 0.0)), fall(0.2, 3.0)),
    "lowest wall": (scene({"plate": RECTANGLE}), fall(0.5)), "end of the domain": (scene({}), fall(1.3)),
    "box": (scene(FLOOR, BOX), fall(0.3)), "cylinder": (scene(FLOOR, TUBE), fall(0.25)),
    "floor that vanishes": (
        scene({"floor": FLOOR["floor"] | {"vanishes_at": 0.1}, "plate": RECTANGLE}), fall(1.3)
    )
}  # fmt: skip


@pytest.mark.parametrize("name", CASES)
def test_impact_forecast_falls_from_the_insertion_to_the_lowest_wall(name):
    given, expected = CASES[name]
    plan = plan_for(given)
    forecast = next(each for each in plan.forecasts if each.cause == "impact")
    assert f"at {expected:.3g} m/s (estimated from a fall of particles.balls by" in forecast.remark
    assert plan.impact_velocity.value == pytest.approx(np.sqrt(2.0 * GRAVITY * 2.0)), (
        "the time step keeps the domain"
    )


@pytest.mark.parametrize(
    "given",
    [
        scene(FLOOR, run={"duration": 1.0, "velocity_max": 0.5}),
        scene(FLOOR, domain={"min": [-1.0] * 3, "max": [1.0] * 3, "periodic": ["z"], "on_exit": "error"}),
        scene({}, domain={"min": [-1.0] * 3, "max": [1.0] * 3, "on_exit": "expand"}),
        scene(FLOOR, gravity=(0.0, 0.0, 0.0)),
    ],
    ids=["velocity_max", "periodic", "expanding domain", "no gravity"],
)
def test_impact_forecast_has_the_planned_velocity_where_the_drop_height_is_not_known(given):
    plan = plan_for(given)
    forecast = next(each for each in plan.forecasts if each.cause == "impact")
    assert f"at {plan.impact_velocity.value:.3g} m/s ({plan.impact_velocity.source})" in forecast.remark


OMEGA = 2.0 * np.pi * 20.0
LIFTED = {
    "vibration": (
        {"floor": FLOOR["floor"] | SHAKING}, 3.0 * GRAVITY / OMEGA, 0.2 + 2.0 * 3.0 * GRAVITY / OMEGA**2
    ),
    "drum, which holds particles up to u^2/g above its axis": (
        {"drum": DRUM}, 0.5 * 0.5, 0.5 + (0.5 * 0.5)**2 / GRAVITY
    ),
    "stirrer": ({"plate": RECTANGLE | {"motion": DRUM["motion"] | {"point": [0, 0, 0.2]}}}, 0.5 * np.hypot(0.4, 0.1), 0.4 + np.hypot(0.4, 0.1)),
    "pushed up": ({"plate": RECTANGLE | PUSHED}, 0.1, 1.2),
    "lid that presses down": ({**FLOOR, "lid": LID}, 0.1, 0.2),
    "elevator": (
        {"floor": FLOOR["floor"] | {"motion": {"kind": "translation", "velocity": [0, 0, 0.1], "end": 2.0}}},
        0.1, 0.2 + 0.1
    )
}  # fmt: skip


@pytest.mark.parametrize("name", LIFTED)
def test_impact_forecast_falls_from_where_walls_lift_particles(name):
    """v = sqrt(u^2 + 2 g h) + u with the speed u of the wall; the run lasts 1 s."""
    walls, speed, height = LIFTED[name]
    plan = plan_for(scene(walls))
    forecast = next(each for each in plan.forecasts if each.cause == "impact")
    assert f"at {fall(height, speed) + speed:.3g} m/s (estimated from a fall " in forecast.remark
