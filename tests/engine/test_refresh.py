"""Forces are evaluated again after insertions, wall changes and at stage boundaries, without effect on the
motion."""

import numpy as np
import pytest
from scene_builders import build_scene, particle_group, plane, run_to_end

DAMPED = {"damping": 1.0}
MODELS = {
    "zhou": ({"normal": "zhou"}, {}),
    "restitution 0": ({"normal": "zhou"}, {"restitution": 0.0}),
    "mindlin": ({"normal": "hertz", "tangential": {"law": "mindlin", **DAMPED}}, {}),
    "linear_history": (
        {"normal": "hertz", "tangential": {"law": "linear_history", "stiffness": 1e4, **DAMPED}},
        {},
    ),
    "sds": ({"normal": "zhou", "rolling": "sds"}, {"rolling_friction": 0.1, "rolling_damping": 0.3}),
    "marshall": ({"normal": "hertz", "twisting": {"law": "marshall", **DAMPED}}, {}),
}


def stacked(model, **parts):
    """Two rotating particles, one on the other, on a floor; they overlap from the start."""
    contact, pair = MODELS[model]
    stack = particle_group(
        [[0.0, 0.0, 0.00495], [0.0005, 0.0, 0.0148]],
        velocity=[0.05, 0.0, -0.02],
        angular_velocity=[1.0, 5.0, 3.0],
    )
    return build_scene(
        {"stack": stack},
        walls={"floor": plane([0.0] * 3, [0.0, 0.0, 1.0])},
        contact={"tangential": "mindlin", "rolling": "none"} | contact,
        pair={"restitution": 0.5, "friction": 0.5} | pair,
        gravity=[0.0, 0.0, -9.81],
        **parts,
    )


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
