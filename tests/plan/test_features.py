"""Features follow from the scene alone, and their reasons name the deciding setting."""

import pytest
from plan.scenes import TEXT, scene_of

from granflow.plan.build import plan_for

FLOOR = "point: [0, 0, 0], normal: [0, 0, 1], material: glass}"
MOVING_FLOOR = FLOOR.replace("}", ", motion: {kind: translation, velocity: [0, 0, 1 mm/s]}}")
SJKR = "rolling: none\n  cohesion: sjkr"


@pytest.mark.parametrize(("changes", "expected", "line"), [
    ((), {"friction": ("off", "every pair has friction 0"), "walls": ("on", "floor"),
          "moving_walls": ("off", "no wall has a motion"),
          "one_material": ("on", "all particles are of the material glass"),
          "one_size": ("on", "all particles have the diameter 0.004 m and one material")}, None),
    ((), {"rate_dependent": ("off", "contact.normal.damping_ratio is 0, and rest_damping acts only on")}, "normal"),
    ((("friction: 0,", "friction: 0.4,"),), {"friction": ("on", "pairs.glass-glass.friction is 0.4")}, "glass-glass"),
    ((("friction: 0,", "friction: 0.4,"),), {"rotation": ("on", "required by friction, rolling friction")}, None),
    ((("rolling: none", "rolling: cdt"), ("friction: 0}", "friction: 0.01}")), {"rolling": ("cdt", "")}, "glass-glass"),
    ((("interval: 10 ms", "interval: 10 ms\n  energy_budget: true"),),
     {"energy_budget": ("on", "output.energy_budget is on")}, "energy"),
    ((("interval: 10 ms", "interval: 10 ms\n  wall_forces: true"),),
     {"wall_forces": ("on", "output.wall_forces selects floor")}, "wall_forces"),
    (((FLOOR, MOVING_FLOOR),), {"moving_walls": ("on", "motion of floor")}, "floor"),
    ((("normal: zhou", "normal: hertz"),), {"rate_dependent": ("on", "the hertz contact model obtains")}, "normal"),
    ((("rolling: none", SJKR), ("friction: 0}", "friction: 0, cohesion_energy_density: 0}")),
     {"cohesion": ("off", "")}, None),
    ((("rolling: none", SJKR), ("friction: 0}", "friction: 0, cohesion_energy_density: 5 kJ/m3}")),
     {"cohesion": ("sjkr", "")}, None),
])  # fmt: skip
def test_reason_states_setting_cause_and_line(tmp_path, changes, expected, line):
    text = TEXT
    for old, new in changes:
        text = text.replace(old, new)
    plan = plan_for(scene_of(tmp_path, text=text))
    found = {reason.feature: reason for reason in plan.reasons}
    for feature, (setting, why) in expected.items():
        assert found[feature].setting == setting and found[feature].why.startswith(why)
        if line:
            number = next(n for n, each in enumerate(text.splitlines(), 1) if line in each)
            assert found[feature].why.endswith(f"beads.yaml:{number})")
