"""The factor of the tangential stiffness of Mindlin's model."""

import numpy as np
import pytest

from tests.scene_builders import SOFT, colliding, few_spheres, run_to_end


@pytest.mark.parametrize("damping", [0.0, 0.6])
def test_a_factor_acts_as_other_moduli_with_the_same_ratio(damping):
    """Kt / (4 a E*) = 2 (1 - nu) / (2 - nu) for equal materials: 1 for nu = 0, and 2/3 for nu = 1/2.

    With the same E* = E / (2 (1 - nu^2)), the factor 3/2 at nu = 1/2 is an oblique collision at nu = 0.
    """
    found = []
    for poisson, factor in ((0.0, 1.0), (0.5, 1.5), (0.5, 1.0)):
        material = SOFT | {"young_modulus": 1e8 * (1.0 - poisson**2), "poisson_ratio": poisson}
        tangential = {"law": "mindlin", "stiffness_factor": factor, "damping": damping}
        pairs = {"glass": colliding(0.0101, 0.01, 0.5, axis=(0.8, 0.6, 0.0))}
        pairs["glass"]["velocity"] = [[0.25, 0.0, 0.0], [-0.25, 0.0, 0.0]]
        scene = few_spheres(
            pairs,
            pair={"friction": 0.9, "restitution": 0.7},
            materials={"glass": material},
            contact={"normal": "hertz", "tangential": tangential, "rolling": "none"},
            run={"duration": 1e-3, "time_step": 1e-6},
        )
        last, _ = run_to_end(scene)
        found.append(
            np.concatenate([last.particles["velocity"][0], 0.005 * last.particles["angular_velocity"][0]])
        )
    assert np.abs(found[0][5]) > 0.02
    np.testing.assert_allclose(found[1], found[0], rtol=0, atol=1e-9)
    assert np.abs(found[2] - found[0]).max() > 1e-3
