"""Contact statistics: maximum and mean overlap, numbers of contacts."""

import numpy as np
import pytest
from scene_builders import build_scene, particle_group, plane, run_to_end


@pytest.mark.parametrize("chunk_size", [1, 512])
@pytest.mark.parametrize("diameters", [(0.004, 0.02), (0.02, 0.004)])
def test_overlap_is_relative_to_the_smaller_radius_in_either_order(taichi_f64, chunk_size, diameters):
    """The contact is computed twice (chunks of one particle) or once."""
    pair = particle_group([[0.0, 0.0, 0.0], [0.01198, 0.0, 0.0]], diameters)
    scene = build_scene(
        {"balls": pair}, numerics={"chunk_size": chunk_size}, run={"duration": 1e-6, "time_step": 1e-6}
    )
    last, _ = run_to_end(scene)
    separation = np.linalg.norm(np.subtract(*last.particles["position"]))
    expected = (0.012 - separation) / 0.002
    assert expected == pytest.approx(0.01, rel=1e-2)
    assert last.totals["overlap_largest"] == pytest.approx(expected, rel=1e-12)
    assert last.totals["overlap_mean"] == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("chunk_size", [1, 512])
def test_wall_contacts_are_not_part_of_the_coordination_number(taichi_f64, chunk_size):
    """A chain of three particles between two walls: 1, 2 and 1 contacts with particles, 1, 0 and 1 with
    walls."""
    chain = particle_group([[0.00495, 0, 0], [0.0148, 0, 0], [0.02465, 0, 0]], 0.01)
    walls = {"left": plane([0, 0, 0], [1, 0, 0]), "right": plane([0.0296, 0, 0], [-1, 0, 0])}
    numerics = {"chunk_size": chunk_size}
    run = {"duration": 1e-6, "time_step": 1e-6}
    last, _ = run_to_end(build_scene({"balls": chain}, walls=walls, numerics=numerics, run=run))
    assert last.particles["coordination_number"].tolist() == [1, 2, 1]
    assert last.particles["wall_contact_count"].tolist() == [1, 0, 1]
    totals = last.totals
    assert (totals["contact_count"], totals["wall_contact_count"]) == (4.0, 2.0)
    assert totals["coordination_number"] == pytest.approx(4 / 3)
