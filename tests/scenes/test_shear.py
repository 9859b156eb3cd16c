"""Steady shear in the shear cell and the shear tester.

Friction and solid fraction of the full scenes are cases of tools/validation/rheology.py.
"""

import numpy as np
import pytest
from scene_runner import run_shipped_scene

from granflow.studies.yield_locus import ShearTest, YieldLocusEvaluation, shear_point


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
