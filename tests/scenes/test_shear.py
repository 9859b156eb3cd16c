"""Steady shear of a layer under gravity and of a Lees-Edwards box.

Friction and solid fraction of the full scenes are cases of tools/validation/rheology.py.
"""

from scene_runner import run_shipped_scene


def test_reduced_sheared_layer_satisfies_its_expectations(tmp_path, taichi_f64):
    small = (
        "particles.base.count=21",
        "particles.base.insert.region.box={min: [-12 mm, -6 mm, 0], max: [12 mm, 6 mm, 8 mm]}",
        "particles.layer.count=150",
        "particles.layer.insert.region.box={min: [-12 mm, -6 mm, 8 mm], max: [12 mm, 6 mm, 60 mm]}",
        "domain.min=[-12 mm, -6 mm, -4 mm]",
        "domain.max=[12 mm, 6 mm, 120 mm]",
        "stages.0.duration=0.2 s",
        "stages.1.duration=0.04 s",
        "expect=[{quantity: particle_count, equals: 171, tolerance: 0}, "
        "{quantity: boundary_work, above: 0}, {quantity: energy_error, between: [-2e-3, 2e-3]}]",
    )
    assert run_shipped_scene("sheared_layer", tmp_path, overrides=small)[1] == []


def test_reduced_shear_cell_satisfies_its_expectations(tmp_path, taichi_f64):
    small = ("stages.0.duration=0.05 s", "stages.1.duration=0.02 s")
    assert run_shipped_scene("shear_cell", tmp_path, overrides=small)[1] == []
