"""Cases of single models: their theory against published figures, and wrong models that they detect."""

import math

import numpy as np
import pytest
from validation import rheology
from validation import theory_of_collisions as theory
from validation.theory_of_collisions import Pair, Partner

GLASS = {"young_modulus": 48e9, "poisson_ratio": 0.20, "density": 2800.0}
SPHERES = Pair(Partner(GLASS, 0.01), Partner(GLASS, 0.01))


@pytest.mark.parametrize(
    ("e", "residual", "unloading", "tangent"),
    [(0.2, 0.968000, 0.2513, 20.8), (0.5, 0.799550, 0.6293, 3.34), (1.0, 0.0, 1.4716, 1.0)],
)  # fmt: skip
def test_integrated_collision_has_the_figures_of_the_paper(e, residual, unloading, tangent):
    """Zhou 2011: residual overlap over the maximum one, eta2 of Eq. 15, tangents; eta1 = 1.471637592 (Eq.
    14). Chung and Ooi: largest force of 10.697 kN."""
    found = theory.zhou_collision(SPHERES, e, 20.0)
    unit = SPHERES.largest_overlap(20.0) / 20.0
    assert found.force == pytest.approx(10.697e3, rel=6e-4)
    assert found.velocity == pytest.approx(20.0 * e, rel=1e-8)
    assert found.loading / unit == pytest.approx(1.471637592, abs=1e-8)
    assert found.unloading / unit == pytest.approx(unloading, abs=6e-5)
    assert 1.0 - theory.zhou_recovery(e) == pytest.approx(residual, abs=6e-7)
    assert theory.zhou_tangent(e) == pytest.approx(tangent, rel=5e-3)


def test_accelerating_layer_has_less_friction_than_a_steady_one():
    """A uniform layer that accelerates by a: shear over normal stress is tan 25 deg - a / (g cos 25 deg)."""
    height = np.linspace(-0.004, 0.12, 62)
    share = np.where(height < 0.05, 0.6, 0.0)
    balance = math.tan(math.radians(25.0)) - 0.2 / (9.81 * math.cos(math.radians(25.0)))

    def frame(number):
        """Frame of a time."""
        velocity = np.zeros((62, 3))
        velocity[:, 0] = 1.0 + 0.2 * rheology.FRAME_INTERVAL * number
        stress = np.zeros((62, 9))
        stress[:, 2] = 1000.0 * balance
        stress[:, 8] = -1000.0
        position = np.zeros((62, 3))
        position[:, 2] = height
        return {"position": position, "velocity": velocity, "solid_fraction": share, "contact_stress": stress,
                "kinetic_stress": np.zeros((62, 9))}  # fmt: skip

    expected, found, error = rheology.layer_balance([frame(n) for n in range(26)])
    assert expected == pytest.approx(balance, rel=1e-12) and found == pytest.approx(balance, rel=1e-12)
    assert error < 1e-12
