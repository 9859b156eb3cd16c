"""Edinburgh elasto-plastic adhesion: forces of each branch and losses of cycles against hand calculations."""

import math

import numpy as np
import pytest
from contact.cases import CASES, MASS, MODULUS, RADIUS, adhesion, case, eepa, evaluate_path, number, spring

from granflow.studies.collide import collide

HERTZ = 4.0 / 3.0 * MODULUS * math.sqrt(RADIUS)
LARGEST, PLASTICITY, WORK, PULL = 3e-4, 0.4, 60.0, 0.3
ADHESIVE = case(
    "eepa_all", "eepa", number(1.0), eepa(1.5), adhesion(PLASTICITY, WORK, PULL), plastic=True, pulls_off=True
)
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
    reloading from there along k2, and loading beyond the line."""
    plastic, lowest, smallest = minimum(HERTZ, 1.5, LARGEST, PLASTICITY, WORK)
    k2 = HERTZ / (1.0 - PLASTICITY)
    unloading = 0.9 * LARGEST
    branch = 0.5 * lowest
    on_branch = smallest * 0.5**1.5
    decreased = (branch**1.5 + on_branch / k2) ** (1.0 / 1.5)
    reloading = 1.2 * decreased
    beyond = 1.01 * decreased / PLASTICITY ** (1.0 / 1.5)
    path = [LARGEST, unloading, plastic, lowest, branch, reloading, beyond]
    found = along(ADHESIVE, path)
    expected = [
        HERTZ * LARGEST**1.5,
        k2 * (unloading**1.5 - plastic**1.5),
        0.0,
        -smallest,
        -on_branch,
        k2 * (reloading**1.5 - decreased**1.5),
        HERTZ * beyond**1.5,
    ]
    assert decreased < reloading < beyond < LARGEST
    np.testing.assert_allclose(found.force[0] + PULL, expected, rtol=1e-12, atol=1e-12)
    # the friction limit is mu (F + kadh d^chi + f0) (Thakur et al. 2014)
    k_adh = smallest / lowest**1.5
    np.testing.assert_allclose(
        found.repulsion[0, :4],
        np.array(expected[:4]) + k_adh * np.array(path[:4]) ** 1.5,
        rtol=1e-12,
        atol=1e-12,
    )
    np.testing.assert_array_equal(found.history[0, -1, :2], beyond)


def test_smallest_force_is_at_most_half_of_that_of_the_unloading_line(taichi_f64):
    """fmin grows with the square root of the overlap, the line with its power 1.5: small contacts are limited."""
    largest = 1e-6
    plastic = PLASTICITY ** (1.0 / 1.5) * largest
    at_zero = HERTZ / (1.0 - PLASTICITY) * plastic**1.5
    assert minimum(HERTZ, 1.5, largest, PLASTICITY, WORK * 0.1)[2] > 0.5 * at_zero
    found = along(BY_NAME["eepa"], np.concatenate([[largest], np.linspace(plastic, 0.0, 4001)[:-1]]))
    assert found.force.min() == pytest.approx(-0.5 * at_zero, rel=1e-3)


def test_loss_of_a_cycle_of_the_linear_model_is_the_area_of_its_loop(taichi_f64):
    """k1 dmax^2 (1 - k1/k2) / 2 of loading and unloading, fmin dp / 2 of the triangle under tension."""
    model = BY_NAME["eepa_linear"]
    k1 = 2e4
    ratio = 0.5
    plastic, lowest, smallest = minimum(k1, 1.0, LARGEST, ratio, WORK)
    expected = 0.5 * k1 * LARGEST**2 * ratio + 0.5 * smallest * plastic
    found = along(model, [LARGEST, 0.5 * lowest, 1e-12])
    assert found.lost[0, -1] == pytest.approx(expected, rel=1e-9)
    assert found.stored[0, -1] < 1e-9 * expected
    # the path: without the energy of the model
    path = np.concatenate([np.linspace(0.0, LARGEST, 3001)[1:], np.linspace(LARGEST, 0.0, 30001)[1:-1]])
    force = along(model, path).force[0]
    assert np.sum(0.5 * (force[1:] + force[:-1]) * np.diff(path)) == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize("chi", [1.5, 4.0])
def test_energy_balance_of_repeated_cycles(taichi_f64, chi):
    """Cycles of growing and falling size from the adhesion branch: work is stored, or lost without return."""
    model = case(
        f"eepa_cycles_{chi}", "eepa", number(1.0), eepa(chi), adhesion(PLASTICITY, WORK, PULL), plastic=True
    )
    corners = np.array([1e-9, 2.5e-4, 4e-5, 1.5e-4, 3e-5, 2.2e-4, 2e-5, 4e-4, 9e-5, 3e-4, 1e-9])
    lengths = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(corners)))])
    path = np.interp(np.linspace(0.0, lengths[-1], 100_001), lengths, corners)
    found = along(model, path)
    force = found.force[0]
    work = np.concatenate([[0.0], np.cumsum(0.5 * (force[1:] + force[:-1]) * np.diff(path))])
    accounting = found.stored[0] + found.lost[0]
    np.testing.assert_allclose(work, accounting, atol=2e-6 * accounting.max())
    assert force.min() < -PULL - 0.5 * minimum(HERTZ, 1.5, 4e-4, PLASTICITY, WORK)[2]
    assert np.diff(found.lost[0]).min() >= -1e-12 * accounting.max()
    assert found.history[0, -1, 2] > 0.0, "plastic work of earlier cycles"


@pytest.mark.parametrize("stiffness", [None, 2e4])
def test_elastic_model_without_adhesion_is_hertz_or_linear(taichi_f64, stiffness):
    """Also with the dashpot of a restitution, which is then that of the collision."""
    plain = case("eepa_plain", "eepa", number(0.6), eepa(1.5, stiffness), adhesion(0.0, 0.0))
    law, settings = ("hertz", lambda units: {}) if stiffness is None else ("linear", spring(stiffness))
    same = case(law, law, number(0.6), settings)
    overlap = np.linspace(1e-6, 3e-4, 40)[None, :]
    for rate in (0.5, -0.5):
        found, expected = (
            evaluate_path(each, overlap, np.full_like(overlap, rate)) for each in (plain, same)
        )
        np.testing.assert_allclose(found.force, expected.force, rtol=1e-14, atol=1e-13)
        np.testing.assert_allclose(found.viscous, expected.viscous, rtol=1e-14, atol=1e-13)
    pair = plain.pair()
    assert plain.law().restitution(pair, RADIUS, MASS, 0.5) == pytest.approx(0.6, rel=1e-5)
    arguments = (pair, RADIUS, MASS, 0.5)
    assert plain.law().phase_durations(*arguments) == pytest.approx(same.law().phase_durations(*arguments))
    assert plain.law().stable_stiffness(*arguments) == pytest.approx(same.law().stable_stiffness(*arguments))


def test_collision_sticks_if_the_work_of_adhesion_exceeds_the_elastic_energy(taichi_f64):
    """Linear: e^2 = k1/k2 - fmin dp / (k1 dmax^2); the share of adhesion decreases with the velocity."""
    k1 = 2e4
    ratio = 0.8
    model = case("eepa_sticky", "eepa", number(1.0), eepa(1.0, k1), adhesion(ratio, 2.0 * WORK))
    law = model.law()

    def squared(velocity):
        largest = velocity * math.sqrt(MASS / k1)
        plastic, _, smallest = minimum(k1, 1.0, largest, ratio, 2.0 * WORK)
        return 1.0 - ratio - smallest * plastic / (k1 * largest**2)

    assert squared(0.1) < 0.0 < squared(1.0)
    assert law.restitution(model.pair(), RADIUS, MASS, 0.1) == 0.0
    assert law.restitution(model.pair(), RADIUS, MASS, 1.0) == pytest.approx(
        math.sqrt(squared(1.0)), rel=1e-12
    )
    assert all(np.isfinite(law.phase_durations(model.pair(), RADIUS, MASS, 0.1)))


def test_contact_with_a_weak_tension_lasts_until_the_surfaces_separate(taichi_f64):
    """With the example of the catalog the tension of steel spheres is 1e-7 of the largest force."""
    found = collide("eepa", "stainless_316", 4e-3, 0.5, restitution=0.7, steps_per_contact=400)
    assert found["duration"] == pytest.approx(found["duration_theory"], rel=2.5e-3)


@pytest.mark.parametrize("restitution", [pytest.param(1.0, marks=pytest.mark.slow), 0.8])
def test_simulated_collision_agrees_with_the_theory_of_the_model(taichi_f64, restitution):
    """By `granflow collide`, in the engine: with settings of contact model and pair."""
    found = collide(
        "eepa", "glass", 4e-3, 0.5, restitution=restitution, steps_per_contact=400,
        settings=["plasticity=0.4", "work_of_adhesion=20", "pull_off_force=1e-3", "adhesion_exponent=3"],
    )  # fmt: skip
    assert 0.5 < found["restitution"] < 0.78
    assert found["restitution"] == pytest.approx(found["restitution_asked"], rel=1e-3)
    for name in ("duration", "overlap_max", "force_max"):
        assert found[name] == pytest.approx(found[f"{name}_theory"], rel=3e-3), name
