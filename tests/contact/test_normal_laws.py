"""Requirements on every normal model of the catalog."""

import numpy as np
import pytest
from contact.cases import (
    CASES,
    CONTINUOUS,
    MASS,
    PERTURBATION,
    PLAIN,
    RADIUS,
    Units,
    evaluate_path,
    evaluate_reference,
    law_parameters,
    random_paths,
    single_contact,
)

from granflow.contact.registry import models
from granflow.kernel_language import ti

every_law = pytest.mark.parametrize("case", CASES, ids=str)

ULPS = 4
"""Device against reference: tolerance in ulps of the repulsion, or of its change per ulp of the maximum
overlap."""

HISTORY_ULPS = 12
"""The same for each history number: e(v) amplifies the rounding of a velocity near the limit velocity. Energies
are sums of differences of energies: their tolerance is relative to the largest one."""


def test_every_law_of_the_catalog_has_a_case():
    assert {case.law().name for case in CASES} == set(models("normal"))


@every_law
def test_device_equals_its_numpy_reference(taichi_f64, case):
    """The repulsion is never below 0, and it equals the total force of models without attraction."""
    overlap, rate = random_paths(contacts=60, steps=60)
    found = evaluate_path(case, overlap, rate)
    force, perturbed, history = evaluate_reference(case, overlap, rate)
    names = case.law().history_names
    overlap_max = history[..., names.index("overlap_max")] if "overlap_max" in names else overlap
    attraction = found.repulsion - found.force
    tangent = (np.abs(perturbed - force) / PERTURBATION + attraction) / overlap
    eps = np.finfo(float).eps
    tiny = np.finfo(float).tiny
    unit = np.maximum(eps * np.maximum(found.repulsion, tangent * overlap_max), tiny)
    worst = np.max(np.abs(found.force - force) / unit)
    assert worst <= ULPS, worst
    for k, each in enumerate(case.law().history):
        largest = np.abs(history[..., k]).max() if each.unit == "J" else 0.0
        np.testing.assert_allclose(
            found.history[..., k], history[..., k], rtol=HISTORY_ULPS * eps, atol=HISTORY_ULPS * eps * largest
        )
    attracts = case.laws().attracts
    assert found.repulsion.min() >= (-1e-15 * found.force.max() if attracts else 0.0)
    assert bool(found.force.min() < 0.0) == attracts
    if not attracts:
        np.testing.assert_array_equal(found.repulsion, found.force)


@pytest.mark.parametrize("case", CONTINUOUS, ids=str)
def test_work_equals_stored_plus_lost_energy(taichi_f64, case):
    """The quadrature of the elastic force equals the stored and lost energy of the model; second order in the
    step."""
    rising = np.linspace(0.0, 3e-4, 4001)[1:]
    falling = np.linspace(3e-4, 2.4e-4, 8001)[1:]
    overlap = np.concatenate([rising, falling, falling[-2::-1], [3e-4], 3e-4 + rising[:500] / 10])[None, :]
    rate = np.zeros_like(overlap)
    rate[0, 0] = 0.5
    found = evaluate_path(case, overlap, rate, time_step=0.0)
    mean_force = 0.5 * (found.elastic[0, 1:] + found.elastic[0, :-1])
    accounting = found.stored[0] + found.lost[0]
    work = accounting[0] + np.concatenate([[0.0], np.cumsum(mean_force * np.diff(overlap[0]))])
    np.testing.assert_allclose(work, accounting, atol=2e-6 * accounting.max())
    if not (case.adhesive or case.pulls_off):
        assert np.all(found.stored >= 0.0)
    assert np.diff(found.lost[0]).min() >= -1e-12 * accounting.max()
    assert case.plastic == bool(found.lost.max() > 1e-9 * accounting.max())


@every_law
def test_force_and_energy_scale_with_the_units(taichi_f64, case):
    """The residual overlap is a difference: the unloading tangent, at most 300 Hertz forces, amplifies its
    rounding."""
    units = Units(1e3, 1e-3, 1e6)
    overlap, rate = random_paths(contacts=20, steps=40, seed=4)
    plain = evaluate_path(case, overlap, rate)
    scaled = evaluate_path(case, overlap, rate, units)
    for name, unit in (("force", units.newton), ("stored", units.newton * units.meter)):
        expected = getattr(plain, name)
        atol = 1e-13 * expected.max()
        np.testing.assert_allclose(getattr(scaled, name) / unit, expected, rtol=1e-12, atol=atol)


DAMPED = [each for each in PLAIN if "damping" in vars(type(each.law())) and each.pair().restitution != 1.0]
"""Cases of laws with a dashpot that loses energy."""


@pytest.mark.parametrize("case", DAMPED, ids=str)
def test_damping_is_the_ratio_of_the_viscous_force_to_the_rate(taichi_f64, case):
    """Dashpots of tangential models follow `damping`; at a small rate and step, no law averages over the step."""
    laws = case.laws()
    read_constants, new_history, contact_of, force_of, *_ = single_contact(laws)
    row = ti.types.ndarray(ti.f64, 1)

    @ti.kernel
    def evaluate(pair: row, parameters: row, overlap: row, ratio: row, damping: row):
        for i in range(overlap.shape[0]):
            constants = read_constants(pair, parameters)
            contact = contact_of(RADIUS, MASS, 1e-12, overlap[i], 1e-6)
            _force, _load, viscous, history = force_of(constants, contact, new_history())
            ratio[i] = viscous / 1e-6
            damping[i] = laws.normal.damping(constants.normal, contact, history.normal)

    assert {each.law().name for each in DAMPED} == {"hertz", "linear", "eepa", "kuwabara_kono"}
    overlap = RADIUS * np.array([1e-4, 1e-3, 0.01, 0.1])
    ratio, damping = np.zeros((2, len(overlap)))
    evaluate(np.array(laws.pair_constants(case.pair())), law_parameters(laws), overlap, ratio, damping)
    assert damping.min() > 0.0
    np.testing.assert_allclose(damping, ratio, rtol=1e-6)
