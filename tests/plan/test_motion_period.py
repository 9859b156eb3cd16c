"""If the time step does not resolve the period of a wall motion, the scene is rejected."""

import math

import pytest
from plan.scenes import TEXT, scene_of

from granflow.errors import SceneError
from granflow.plan.build import plan_for

STEP = 1e-5
"""Time step of the scenes [s]; ten steps are a period of 1e-4 s, a frequency of 10 kHz or 62 832 rad/s."""

VIBRATION = "{{kind: vibration, direction: [0, 0, 1], amplitude: 1 nm, frequency: {} Hz}}"
ROTATION = "{{kind: rotation, point: [0, 0, 0], axis: [0, 0, 1], angular_velocity: {}}}"


def plan_of(directory, motion):
    text = TEXT.replace("material: glass}\nparticles", f"material: glass, motion: {motion}}}\nparticles")
    return plan_for(scene_of(directory, f"run.time_step={STEP}", "run.velocity_max=1 m/s", text=text))


@pytest.mark.parametrize("motion", [VIBRATION.format(9_999), ROTATION.format(2 * math.pi * 9_999)])
def test_ten_steps_per_period_are_accepted(tmp_path, motion):
    assert plan_of(tmp_path, motion).step.value == STEP


@pytest.mark.parametrize("motion", [VIBRATION.format(10_001), ROTATION.format(-2 * math.pi * 10_001)])
def test_fewer_steps_per_period_are_rejected_with_the_required_step(tmp_path, motion):
    with pytest.raises(
        SceneError, match=r"walls.floor.motion.0 has a period of 0.0001 s, .* to 1e-05 s or less"
    ):
        plan_of(tmp_path, motion)
