"""Contact statistics: maximum and mean overlap, numbers of contacts."""

import numpy as np
import pytest
from scene_builders import build_scene, particle_group, plane, run_to_end


@pytest.mark.parametrize("chunk_size", [pytest.param(1, marks=pytest.mark.slow), 512])
def test_statistics_of_pairs_and_of_a_chain_between_walls(taichi_f64, chunk_size):
    """Overlaps are relative to the smaller radius, also if it is that of the second particle; walls are no
    part of the coordination number. Contacts are computed twice (chunks of one particle) or once."""
    at = [[0.0148, 0.0, 0.1], [0.0148, 0.0119, 0.1], [0.0148, 0.0, 0.2], [0.0148, 0.0119, 0.2]]
    groups = {
        "pairs": particle_group(at, [0.004, 0.02, 0.02, 0.004]),
        "chain": particle_group([[0.00495, 0, 0], [0.0148, 0, 0], [0.02465, 0, 0]], 0.01),
    }
    walls = {"left": plane([0, 0, 0], [1, 0, 0]), "right": plane([0.0296, 0, 0], [-1, 0, 0])}
    run = {"duration": 1e-6, "time_step": 1e-6}
    last, _ = run_to_end(build_scene(groups, walls=walls, numerics={"chunk_size": chunk_size}, run=run))
    found, totals = last.particles, last.totals
    position = found["position"]
    pairs = [(0.012 - np.linalg.norm(position[k] - position[k + 1])) / 0.002 for k in (0, 2)]
    chain = [(0.01 - np.linalg.norm(position[k] - position[k + 1])) / 0.005 for k in (4, 5)]
    at_walls = (0.005 - np.array([position[4, 0], 0.0296 - position[6, 0]])) / 0.005
    assert min(pairs) > 0.04 > max(chain)
    assert totals["overlap_largest"] == pytest.approx(max(pairs), rel=1e-12)
    assert totals["overlap_mean"] == pytest.approx(np.mean([*pairs, *chain, *at_walls]), rel=1e-12)
    assert (totals["contact_count"], totals["wall_contact_count"]) == (6.0, 2.0)
    assert totals["coordination_number"] == pytest.approx(8 / 7)
    assert found["coordination_number"].tolist() == [1, 1, 1, 1, 1, 2, 1]
    assert found["wall_contact_count"].tolist() == [0, 0, 0, 0, 1, 0, 1]
