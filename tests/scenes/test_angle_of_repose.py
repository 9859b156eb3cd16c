"""A ridge remains after the particles on both sides flow out; its slopes are straight and have the expected angle."""

import pytest
from scene_runner import run_shipped_scene


@pytest.mark.slow
def test_reduced_angle_of_repose_satisfies_its_expectations(tmp_path, taichi_f64):
    """20 particles wide and 4 deep, until the first particles have flowed out."""
    small = (
        "materials.glass.young_modulus=4 MPa",
        "materials.plate.young_modulus=4 MPa",
        "numerics.max_overlap=0.2",
        "particles.base.count=80",
        "particles.base.insert.region.box={min: [-50 mm, -10 mm, 0], max: [50 mm, 10 mm, 5 mm]}",
        "particles.beads.count=500",
        "particles.beads.insert.region.box={min: [-70 mm, -10 mm, 5 mm], max: [70 mm, 10 mm, 55 mm]}",
        "walls.left.corner=[-70 mm, -10 mm, 0]",
        "walls.right.corner=[70 mm, -10 mm, 0]",
        "walls.left_gate.corner=[-70 mm, -10 mm, 0]",
        "walls.right_gate.corner=[50 mm, -10 mm, 0]",
        "domain.min=[-75 mm, -10 mm, -40 mm]",
        "domain.max=[75 mm, 10 mm, 110 mm]",
        "output.metrics.left.region={min: [-40 mm, -10 mm, 0], max: [-5 mm, 10 mm, 100 mm]}",
        "output.metrics.right.region={min: [5 mm, -10 mm, 0], max: [40 mm, 10 mm, 100 mm]}",
        "stages.0.duration=0.15 s",
        "stages.1.duration=0.35 s",
        "expect=[{quantity: deleted_count, between: [20, 300]}, {quantity: energy_error, between: [-2e-3, 2e-3]}]",
    )
    assert run_shipped_scene("angle_of_repose", tmp_path, overrides=small)[1] == []


@pytest.mark.slow
@pytest.mark.timeout(1500)
def test_angle_of_repose_satisfies_its_expectations(tmp_path, taichi_f64):
    assert run_shipped_scene("angle_of_repose", tmp_path)[1] == []
