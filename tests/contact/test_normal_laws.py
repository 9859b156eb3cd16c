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
    TIME_STEP,
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
every_continuous_law = pytest.mark.parametrize("case", CONTINUOUS, ids=str)

ULPS = 4
"""Device against reference: tolerance in ulps of the repulsion, or of its change per ulp of the maximum
overlap."""

HISTORY_ULPS = 12
"""The same for each history number: e(v) amplifies the rounding of a velocity near the limit velocity. Energies
are sums of differences of energies: their tolerance is relative to the largest one."""


def grid_paths(contacts, steps, seed=3):
    """Closed random paths on a grid of overlaps: grid numbers above 0 out and back, (contacts, steps)
    each."""
    rng = np.random.default_rng(seed)
    outward = np.cumsum(rng.choice([-1, 1], (contacts, steps)), axis=1)
    outward -= outward.min(axis=1, keepdims=True) - 1
    inward = np.array([np.resize(np.arange(row[-1], row[0] - np.sign(row[-1] - row[0]),
                                         -1 if row[-1] > row[0] else 1), steps) for row in outward])  # fmt: skip
    return outward, inward


def test_every_law_of_the_catalog_has_a_case():
    assert {case.law().name for case in CASES} == set(models("normal"))


@every_law
def test_device_equals_its_numpy_reference(taichi_f64, case):
    overlap, rate = random_paths(contacts=150, steps=60)
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


@every_law
def test_only_attractive_models_have_tension(taichi_f64, case):
    """The repulsion is never below 0, and it equals the total force of models without attraction."""
    overlap, rate = random_paths(contacts=2000, steps=80, seed=2)
    found = evaluate_path(case, overlap, rate)
    attracts = case.laws().attracts
    assert found.repulsion.min() >= (-1e-15 * found.force.max() if attracts else 0.0)
    assert bool(found.force.min() < 0.0) == attracts
    assert found.force.max() > 0.0
    assert not found.force[overlap <= 0.0].any()


@pytest.mark.parametrize("case", [case for case in CASES if not case.pulls_off], ids=str)
def test_force_vanishes_at_zero_overlap(taichi_f64, case):
    tiny = 1e-9
    overlap = np.array([[3e-4, 3e-4], [3e-4 * tiny, 3e-4 * tiny]])
    rate = np.array(
        [[0.5, 0.5]] * 2
    )  # at rest, a contact of restitution 0 has no force at its maximum overlap
    large, small = np.abs(evaluate_path(case, overlap, rate).elastic[:, 1])
    assert 0.0 < small <= 1.001 * tiny * large, (
        "the force of every model is at most proportional to a small overlap"
    )


@every_continuous_law
def test_force_is_continuous_between_branches(taichi_f64, case):
    """If the steps of a path are 16 times smaller, the largest change per step is 16 times smaller."""
    corners = np.array([1e-9, 2e-4, 1.6e-4, 3e-4, 2.9e-4, 2.95e-4, 2e-4, 3.5e-4, 1e-9, 3e-4, 1e-9])
    lengths = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(corners)))])

    def largest_jump(steps):
        overlap = np.interp(np.linspace(0.0, lengths[-1], steps + 1), lengths, corners)[None, :]
        rate = np.zeros_like(overlap)
        rate[0, 0] = 0.5
        return np.abs(np.diff(evaluate_path(case, overlap, rate, time_step=0.0).elastic)).max()

    coarse = largest_jump(4000)
    fine = largest_jump(64000)
    assert coarse / fine == pytest.approx(16.0, rel=0.1)


@every_continuous_law
def test_work_on_closed_paths_is_not_negative(taichi_f64, case):
    """Work by the trapezoid rule: elastic parts of the path cancel, and unloading lies below loading."""
    outward, inward = grid_paths(contacts=300, steps=60)
    overlap = 6e-6 * np.concatenate([outward, inward], axis=1)
    closed = [np.flatnonzero(inward[i] == outward[i, 0])[0] + outward.shape[1] for i in range(len(outward))]
    step = np.diff(overlap, axis=1, prepend=overlap[:, :1])
    rate = step / TIME_STEP
    rate[:, 0] = 0.5
    found = evaluate_path(case, overlap, rate, time_step=0.0)
    elastic = 0.5 * (found.elastic[:, 1:] + found.elastic[:, :-1]) * step[:, 1:]
    work = elastic + found.viscous[:, 1:] * step[:, 1:]
    total = np.array([work[i, : closed[i]].sum() for i in range(len(work))])
    scale = np.abs(elastic).sum(axis=1)
    assert np.all(total >= -1e-14 * scale)
    assert case.name.endswith("elastic") == bool(np.all(total <= 1e-12 * scale))


@every_continuous_law
def test_work_equals_stored_plus_lost_energy(taichi_f64, case):
    """The quadrature of the elastic force equals the stored and lost energy of the model; second order in the
    step."""
    rising = np.linspace(0.0, 3e-4, 4001)[1:]
    falling = np.linspace(3e-4, 2.4e-4, 8001)[1:]
    overlap = np.concatenate([rising, falling, falling[-2::-1], [3e-4], 3e-4 + rising[:500] / 10])[None, :]
    rate = np.zeros_like(overlap)
    rate[0, 0] = 0.5
    found = evaluate_path(case, overlap, rate, time_step=0.0)
    midpoint_force = 0.5 * (found.elastic[0, 1:] + found.elastic[0, :-1])
    work = (
        np.concatenate([[0.0], np.cumsum(midpoint_force * np.diff(overlap[0]))])
        + found.stored[0, 0]
        + found.lost[0, 0]
    )
    accounting = found.stored[0] + found.lost[0]
    np.testing.assert_allclose(work, accounting, atol=2e-6 * accounting.max())
    if not (case.adhesive or case.pulls_off):
        assert np.all(found.stored >= 0.0)
    assert np.diff(found.lost[0]).min() >= -1e-12 * accounting.max()
    assert case.plastic == bool(found.lost.max() > 1e-9 * accounting.max())


@every_law
def test_force_and_energy_scale_with_the_units(taichi_f64, case):
    units = Units(1e3, 1e-3, 1e6)
    overlap, rate = random_paths(contacts=100, steps=40, seed=4)
    plain = evaluate_path(case, overlap, rate)
    scaled = evaluate_path(case, overlap, rate, units)
    # the residual overlap is a difference: the unloading tangent amplifies its rounding, at most 300 Hertz
    # forces
    size = plain.force.max()
    np.testing.assert_allclose(scaled.force / units.newton, plain.force, rtol=1e-12, atol=1e-13 * size)
    energy = units.newton * units.meter
    np.testing.assert_allclose(
        scaled.stored / energy, plain.stored, rtol=1e-12, atol=1e-13 * plain.stored.max()
    )


@every_law
def test_wall_is_the_limit_of_a_growing_partner(taichi_f64, case):
    """The difference decreases as 1 / partner radius; the mass of the partner grows with the cube and is
    negligible."""
    overlap, rate = random_paths(contacts=20, steps=40, seed=5)
    wall = evaluate_path(case, overlap, rate).force

    def difference(times):
        radius = RADIUS * times / (1.0 + times)
        mass = MASS * times**3 / (1.0 + times**3)
        return (
            np.abs(evaluate_path(case, overlap, rate, radius=radius, mass=mass).force - wall).max()
            / wall.max()
        )

    ten_thousand = difference(1e4)
    million = difference(1e6)
    if case.name.startswith(("linear", "walton_braun", "luding")) and case.name.endswith(
        ("number", "elastic")
    ):
        assert ten_thousand <= 1e-12, "a stiffness given as a number does not depend on the radius"
    else:
        assert ten_thousand <= 1e-4
        assert ten_thousand / million == pytest.approx(100.0, rel=0.01)


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
