"""If the precision does not resolve the farthest positions of a domain, the scene is rejected."""

import pytest
from scene_builders import build_scene, particle_group

from granflow.errors import SceneError
from granflow.plan.build import plan_for

RADIUS = 0.005
EDGE = 2.0**13
"""In f32 the spacing is 2^(12 - 23) = 0.49 mm up to 2^13 m and 2^(13 - 23) = 0.98 mm beyond; the limit is 0.5
mm."""


def scene_with_height(edge, precision, on_exit="error"):
    domain = {"min": [0.0] * 3, "max": [0.1, 0.1, edge], "on_exit": on_exit}
    return build_scene(
        {"ball": particle_group([[0.05] * 3])}, domain=domain, run={"duration": 0.1, "precision": precision}
    )


@pytest.mark.parametrize("on_exit", ["error", "delete", "expand"])
def test_f32_spacing_above_a_tenth_of_the_smallest_radius_is_rejected(on_exit):
    plan_for(scene_with_height(EDGE, "f32", on_exit))
    with pytest.raises(SceneError) as refused:
        plan_for(scene_with_height(1.001 * EDGE, "f32", on_exit))
    message = str(refused.value)
    assert (
        "run.precision is f32, but it resolves positions only to 0.000977 m at 8.2e+03 m from the origin"
        in message
    )
    assert "0.1 of the smallest radius 0.005 m. Use --precision mixed" in message


@pytest.mark.parametrize("precision", ["mixed", "f64"])
def test_f64_positions_have_a_larger_limit(precision):
    """Up to 2^42 m the spacing is 2^(41 - 52) = 0.49 mm."""
    plan_for(scene_with_height(2.0**42, precision))
    with pytest.raises(SceneError, match=r"resolves positions only to 0.000977 m .*\. Move the scene closer"):
        plan_for(scene_with_height(1.001 * 2.0**42, precision))
