"""If the precision does not resolve the farthest positions of a domain, the scene is rejected."""

import pytest
from scene_builders import build_scene, particle_group

from granflow.errors import SceneError
from granflow.plan.build import plan_for


def planned(edge, precision, on_exit):
    domain = {"min": [0.0] * 3, "max": [0.1, 0.1, edge], "on_exit": on_exit}
    run = {"duration": 0.1, "precision": precision}
    return plan_for(build_scene({"ball": particle_group([[0.05] * 3])}, domain=domain, run=run))


@pytest.mark.parametrize(("precision", "edge", "on_exit", "advice"), [
    ("f32", 2.0**13, "error", "Use --precision mixed"), ("f32", 2.0**13, "expand", "Use --precision mixed"),
    ("mixed", 2.0**42, "error", "Move the scene closer"),
])  # fmt: skip
def test_spacing_above_a_tenth_of_the_smallest_radius_is_rejected(precision, edge, on_exit, advice):
    """The radius is 5 mm. The spacing is 2^(12 - 23) = 2^(41 - 52) = 0.49 mm up to the edge [m], and 0.98 mm
    beyond."""
    planned(edge, precision, on_exit)
    with pytest.raises(SceneError, match=f"resolves positions only to 0.000977 m .*{advice}"):
        planned(1.001 * edge, precision, on_exit)
