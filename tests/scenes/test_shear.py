"""Steady shear of a layer under gravity and of a Lees-Edwards box.

Friction and solid fraction of the full scenes are cases of tools/validation/rheology.py.
"""

import numpy as np
import pytest
from scene_runner import run_shipped_scene

from granflow.studies.yield_locus import ShearTest, YieldLocusEvaluation, shear_point


@pytest.mark.slow
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


@pytest.mark.slow
def test_cohesionless_preshear_of_the_shear_tester_has_the_friction_of_spheres(tmp_path, taichi_f64):
    """Spheres with a friction of 0.5, without rolling friction and cohesion: shear over normal stress of steady
    flow within 2 degrees of mu(I) of glass beads (Jop, Forterre & Pouliquen 2006), tan 20.9 deg for slow flow.
    """
    settings = (
        "pairs={powder-powder: {restitution: 0.5, friction: 0.5}}",
        "contact={normal: hertz, tangential: mindlin, rolling: none}",
    )
    assert run_shipped_scene("shear_tester", tmp_path, overrides=settings)[1] == []
    evaluation = YieldLocusEvaluation.model_validate({"wall": "lid", "parameters": {"shear": "none"}})
    normal, shear = shear_point(evaluation, ShearTest({}, 1, tmp_path, {})).preshear
    assert normal == pytest.approx(5000.0, rel=0.01)
    low, high = np.tan(np.radians([18.9, 22.9]))
    assert low < shear / normal < high


@pytest.mark.slow
def test_reduced_triaxial_test_satisfies_its_expectations(tmp_path, taichi_f64):
    """216 spheres: the lateral pressures remain near their target at a strain rate of 10 1/s."""
    box = "{min: [0, 0, 0], max: [6.1 mm, 6.1 mm, 6.1 mm]}"
    small = (
        "particles.glass.count=216",
        f"particles.glass.insert.region.box={box}",
        "domain.max=[6.1 mm, 6.1 mm, 6.1 mm]",
        "stages.0.until.hold=0.1 ms",
        "stages.1.until.below=-0.08",
        "stages.2.duration=1 ms",
        "expect=[{quantity: energy_error, between: [-3e-3, 3e-3]}, {quantity: box_pressure_mean.compress, above: 1}, "
        "{quantity: box_pressure_x_mean.critical, between: [99 kPa, 105 kPa]}, "
        "{quantity: box_pressure_y_mean.critical, between: [99 kPa, 105 kPa]}, "
        "{quantity: stress_ratio_mean.critical, between: [0.2, 1]}]",
    )
    assert run_shipped_scene("triaxial", tmp_path, overrides=small)[1] == []
