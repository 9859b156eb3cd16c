"""Features follow from the scene alone, and their reasons name the deciding setting."""

from dataclasses import fields

import pytest
from plan.scenes import TEXT, line_of, scene_of

from granflow.plan.build import plan_for
from granflow.plan.features import Features

FLOOR = "  floor: {shape: plane, point: [0, 0, 0], normal: [0, 0, 1], material: glass}\n"
MOVING_FLOOR = FLOOR.replace("}\n", ", motion: {kind: translation, velocity: [0, 0, 1 mm/s]}}\n")


def reasons(scene):
    return {reason.feature: (reason.setting, reason.why) for reason in plan_for(scene).reasons}


def test_only_required_features_are_enabled(tmp_path):
    text = TEXT.replace("walls:\n" + FLOOR, "")
    features = plan_for(scene_of(tmp_path, text=text)).features
    assert [
        item.name for item in fields(Features) if getattr(features, item.name) not in (False, "none", ())
    ] == ["one_material", "one_size"]


@pytest.mark.parametrize(("change", "feature", "setting", "why", "line"), [
    ((), "friction", "off", "every pair has friction 0", None),
    ((), "walls", "on", "floor", "walls:"),
    ((), "moving_walls", "off", "no wall has a motion", None),
    ((), "one_material", "on", "all particles are of the material glass", None),
    ((), "one_size", "on", "all particles have the diameter 0.004 m and one material", None),
    ((), "rate_dependent", "off",
     "contact.normal.damping_ratio is 0, and rest_damping acts only on contacts that reload (", "normal"),
    (("friction: 0,", "friction: 0.4,"), "friction", "on", "pairs.glass-glass.friction is 0.4",
     "glass-glass"),
    (("friction: 0,", "friction: 0.4,"), "rotation", "on",
     "required by friction, rolling friction or twisting friction", None),
    (("interval: 10 ms", "interval: 10 ms\n  energy_budget: true"), "energy_budget", "on",
     "output.energy_budget is on", "energy"),
    (("interval: 10 ms", "interval: 10 ms\n  wall_forces: true"), "wall_forces", "on",
     "output.wall_forces selects floor", "wall_forces"),
    ((FLOOR, MOVING_FLOOR), "moving_walls", "on", "motion of floor", "floor"),
    (("normal: zhou", "normal: hertz"), "rate_dependent", "on", "the hertz contact model obtains", "normal")
])  # fmt: skip
def test_reason_states_setting_cause_and_line(tmp_path, change, feature, setting, why, line):
    text = TEXT.replace(*change, 1) if change else TEXT
    found, message = reasons(scene_of(tmp_path, text=text))[feature]
    assert found == setting
    assert message.startswith(why)
    if line:
        number = next(n for n, each in enumerate(text.splitlines(), 1) if line in each)
        assert message.endswith(f"beads.yaml:{number})")


def test_rolling_friction_of_any_pair_enables_the_rolling_model(tmp_path):
    text = TEXT.replace("rolling: none", "rolling: cdt").replace(
        "rolling_friction: 0}", "rolling_friction: 0.01}", 1
    )
    found = reasons(scene_of(tmp_path, text=text))
    assert found["rolling"][0] == "cdt"
    assert found["rolling"][1].endswith(f"beads.yaml:{line_of('glass-glass')})")
    assert found["rotation"][0] == "on"


@pytest.mark.parametrize(("density", "setting"), [("0", "off"), ("5 kJ/m3", "sjkr")])
def test_cohesion_is_disabled_if_no_pair_is_cohesive(tmp_path, density, setting):
    text = TEXT.replace("rolling: none", "rolling: none\n  cohesion: sjkr")
    text = text.replace("rolling_friction: 0}", f"rolling_friction: 0, cohesion_energy_density: {density}}}")
    plan = plan_for(scene_of(tmp_path, text=text))
    assert {reason.feature: reason.setting for reason in plan.reasons}["cohesion"] == setting
    assert plan.laws.attracts == (setting == "sjkr")
