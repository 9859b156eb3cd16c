"""Contact statistics: maximum and mean overlap."""

import numpy as np
import pytest
from scene_builders import build_scene, particle_group, run_to_end


@pytest.mark.parametrize("chunk_size", [1, 512])
@pytest.mark.parametrize("diameters", [(0.004, 0.02), (0.02, 0.004)])
def test_overlap_is_relative_to_the_smaller_radius_in_either_order(taichi_f64, chunk_size, diameters):
    """The contact is computed twice (chunks of one particle) or once."""
    pair = particle_group([[0.0, 0.0, 0.0], [0.01198, 0.0, 0.0]], diameters)
    scene = build_scene({"balls": pair}, numerics={"chunk_size": chunk_size}, run={"duration": 1e-6, "time_step": 1e-6})
    last, _ = run_to_end(scene)
    separation = np.linalg.norm(np.subtract(*last.particles["position"]))
    expected = (0.012 - separation) / 0.002
    assert expected == pytest.approx(0.01, rel=1e-2)
    assert last.totals["overlap_largest"] == pytest.approx(expected, rel=1e-12)
    assert last.totals["overlap_mean"] == pytest.approx(expected, rel=1e-12)
