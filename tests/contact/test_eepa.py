"""Edinburgh elasto-plastic adhesion: forces of each branch and losses of cycles against hand calculations."""

import math

import numpy as np
import pytest
from contact.cases import CASES, MASS, MODULUS, RADIUS, SPRING, Case, adhesion, eepa, evaluate_path

from granflow.studies.collide import collide

HERTZ = 4.0 / 3.0 * MODULUS * math.sqrt(RADIUS)
LARGEST, PLASTICITY, WORK, PULL = 3e-4, 0.4, 60.0, 0.3
PROPERTIES = adhesion(PLASTICITY, WORK, PULL)
ADHESIVE = Case("eepa_all", "eepa", 1.0, eepa(1.5), PROPERTIES, plastic=True, pulls_off=True)
BY_NAME = {each.name: each for each in CASES}


def along(model, overlap):
    """Results along overlaps [m] of one contact at rest."""
    overlap = np.array(overlap)[None, :]
    return evaluate_path(model, overlap, np.zeros_like(overlap), time_step=0.0)


def minimum(stiffness, exponent, largest, plasticity, work):
    """Plastic overlap and overlap of the smallest force [m], and this force [N] (Morrissey 2013)."""
    plastic = plasticity ** (1.0 / exponent) * largest
    force = 1.5 * math.pi * work * math.sqrt(2.0 * RADIUS * plastic)
    k2 = stiffness / (1.0 - plasticity)
    return plastic, (plastic**exponent - force / k2) ** (1.0 / exponent), force


def test_forces_of_all_branches_have_the_published_values(taichi_f64):
    """Loading, the unloading line, its smallest force, half of the overlap there on the adhesion branch,
    reloading from there along k2, and loading beyond the line.

    The friction limit is mu (F + kadh d^chi + f0) (Thakur et al. 2014). The smallest force is at most half of that
    of the unloading line at 0: fmin grows with the square root of the overlap, the line with its power 1.5.
    """
    plastic, lowest, smallest = minimum(HERTZ, 1.5, LARGEST, PLASTICITY, WORK)
    k2 = HERTZ / (1.0 - PLASTICITY)
    unloading, branch = 0.9 * LARGEST, 0.5 * lowest
    on_branch = smallest * 0.5**1.5
    decreased = (branch**1.5 + on_branch / k2) ** (1.0 / 1.5)
    reloading, beyond = 1.2 * decreased, 1.01 * decreased / PLASTICITY ** (1.0 / 1.5)
    path = [LARGEST, unloading, plastic, lowest, branch, reloading, beyond]
    found = along(ADHESIVE, path)
    expected = [
        HERTZ * LARGEST**1.5, k2 * (unloading**1.5 - plastic**1.5), 0.0, -smallest, -on_branch,
        k2 * (reloading**1.5 - decreased**1.5), HERTZ * beyond**1.5,
    ]  # fmt: skip
    assert decreased < reloading < beyond < LARGEST
    np.testing.assert_allclose(found.force[0] + PULL, expected, rtol=1e-12, atol=1e-12)
    load = np.array(expected[:4]) + smallest * (np.array(path[:4]) / lowest) ** 1.5
    np.testing.assert_allclose(found.repulsion[0, :4], load, rtol=1e-12, atol=1e-12)
    np.testing.assert_array_equal(found.history[0, -1, :2], beyond)
    small = 1e-6
    plastic = PLASTICITY ** (1.0 / 1.5) * small
    assert minimum(HERTZ, 1.5, small, PLASTICITY, WORK * 0.1)[2] > 0.5 * k2 * plastic**1.5
    found = along(BY_NAME["eepa"], np.concatenate([[small], np.linspace(plastic, 0.0, 4001)[:-1]]))
    assert found.force.min() == pytest.approx(-0.5 * k2 * plastic**1.5, rel=1e-3)


@pytest.mark.parametrize(
    ("stiffness", "law", "settings"), [("hertz", "hertz", {}), (SPRING, "linear", {"stiffness": SPRING})]
)
def test_elastic_model_without_adhesion_is_hertz_or_linear(taichi_f64, stiffness, law, settings):
    """Also with the dashpot of a restitution, which is then that of the collision."""
    plain = Case("eepa_plain", "eepa", 0.6, eepa(1.5, stiffness), adhesion(0.0, 0.0))
    same = Case(law, law, 0.6, settings)
    overlap = np.linspace(1e-6, 3e-4, 40)[None, :]
    for rate in (0.5, -0.5):
        found, expected = (
            evaluate_path(each, overlap, np.full_like(overlap, rate)) for each in (plain, same)
        )
        np.testing.assert_allclose(found.force, expected.force, rtol=1e-14, atol=1e-13)
        np.testing.assert_allclose(found.viscous, expected.viscous, rtol=1e-14, atol=1e-13)
    arguments = (plain.pair(), RADIUS, MASS, 0.5)
    assert plain.law().restitution(*arguments) == pytest.approx(0.6, rel=1e-5)
    assert plain.law().phase_durations(*arguments) == pytest.approx(same.law().phase_durations(*arguments))
    assert plain.law().stable_stiffness(*arguments) == pytest.approx(same.law().stable_stiffness(*arguments))


def test_collision_sticks_if_the_work_of_adhesion_exceeds_the_elastic_energy(taichi_f64):
    """Linear: e^2 = k1/k2 - fmin dp / (k1 dmax^2); the share of adhesion decreases with the velocity."""
    k1, ratio = 2e4, 0.8
    model = Case("eepa_sticky", "eepa", 1.0, eepa(1.0, {"value": k1}), adhesion(ratio, 2.0 * WORK))
    law, pair = model.law(), model.pair()

    def squared(velocity):
        largest = velocity * math.sqrt(MASS / k1)
        plastic, _, smallest = minimum(k1, 1.0, largest, ratio, 2.0 * WORK)
        return 1.0 - ratio - smallest * plastic / (k1 * largest**2)

    assert squared(0.1) < 0.0 < squared(1.0)
    assert law.restitution(pair, RADIUS, MASS, 0.1) == 0.0
    assert law.restitution(pair, RADIUS, MASS, 1.0) == pytest.approx(math.sqrt(squared(1.0)), rel=1e-12)
    assert all(np.isfinite(law.phase_durations(pair, RADIUS, MASS, 0.1)))


def test_simulated_collision_agrees_with_the_theory_of_the_model(taichi_f64):
    """By `granflow collide`, in the engine: with settings of contact model and pair."""
    found = collide(
        "eepa", "glass", 4e-3, 0.5, restitution=0.8, steps_per_contact=400,
        settings=["plasticity=0.4", "work_of_adhesion=20", "pull_off_force=1e-3", "adhesion_exponent=3"],
    )  # fmt: skip
    assert 0.5 < found["restitution"] < 0.78
    assert found["restitution"] == pytest.approx(found["restitution_asked"], rel=1e-3)
    for name in ("duration", "overlap_max", "force_max"):
        assert found[name] == pytest.approx(found[f"{name}_theory"], rel=3e-3), name
