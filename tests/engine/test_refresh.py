"""Forces are evaluated again after insertions, wall changes and at stage boundaries, without effect on the
motion."""

import numpy as np
import pytest
from scene_builders import DASHPOTS, SPRINGS, build_scene, particle_group, plane, run_to_end

MODELS = {
    "zhou": {
        "contact": {"normal": "zhou", "tangential": "mindlin", "rolling": "none"},
        "pair": {"friction": 0.5},
    },
    "dashpots": DASHPOTS,
    "springs": SPRINGS,
}
"""Contact models with dashpots in all slots, and with springs of given stiffness and restitution 0."""


def stacked(model, **parts):
    """Two rotating particles, one on the other, on a floor; they overlap from the start."""
    stack = particle_group(
        [[0.0, 0.0, 0.00495], [0.0005, 0.0, 0.0148]],
        velocity=[0.05, 0.0, -0.02],
        angular_velocity=[1.0, 5.0, 3.0],
    )
    floor = {"floor": plane([0.0] * 3, [0.0, 0.0, 1.0])}
    return build_scene({"stack": stack}, walls=floor, gravity=[0.0, 0.0, -9.81], **MODELS[model], **parts)


@pytest.mark.parametrize("model", MODELS)
def test_stage_boundaries_do_not_change_the_motion(taichi_f64, model):
    run = {"velocity_max": 1.0, "time_step": 2e-6}
    whole, _ = run_to_end(stacked(model, run=run | {"duration": 2.4e-3}))
    stages = [{"name": name, "duration": 6e-4} for name in ("first", "second", "third", "fourth")]
    parts, _ = run_to_end(stacked(model, run=run, stages=stages))
    assert np.isfinite(whole.particles["position"]).all()
    for name in ("position", "velocity", "angular_velocity"):
        scale = np.abs(whole.particles[name]).max()
        np.testing.assert_allclose(parts.particles[name], whole.particles[name], rtol=0.0, atol=1e-9 * scale)
