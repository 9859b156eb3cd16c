"""A ridge remains after the particles on both sides flow out; its slopes are straight and have the expected
angle."""

import pytest
from scene_runner import REDUCED_HEAP, run_shipped_scene


@pytest.mark.slow
def test_reduced_angle_of_repose_satisfies_its_expectations(tmp_path, taichi_f64):
    """20 particles wide and 4 deep, until the first particles have flowed out."""
    small = (
        *REDUCED_HEAP,
        "stages.0.duration=0.15 s",
        "stages.1.duration=0.35 s",
        "expect=[{quantity: deleted_count, between: [20, 300]}, {quantity: energy_error, between: [-2e-3, "
        "2e-3]}]",
    )
    assert run_shipped_scene("angle_of_repose", tmp_path, overrides=small)[1] == []


@pytest.mark.slow
@pytest.mark.timeout(1500)
def test_angle_of_repose_satisfies_its_expectations(tmp_path, taichi_f64):
    assert run_shipped_scene("angle_of_repose", tmp_path)[1] == []
