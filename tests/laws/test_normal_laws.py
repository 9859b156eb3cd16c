"""What every normal law of the catalog owes, whichever law it is."""

import numpy as np
import pytest
from laws.cases import CASES, CONTINUOUS, MASS, NUDGE, RADIUS, TIME_STEP, Units, random_walks, reference_walk, walk

from granflow.laws.catalog import NORMAL_LAWS

every_law = pytest.mark.parametrize("case", CASES, ids=str)
every_continuous_law = pytest.mark.parametrize("case", CONTINUOUS, ids=str)

ULPS = 4
"""Device against twin: ulps of the pressing force, or of what an ulp of the largest overlap changes in it."""

HISTORY_ULPS = 12
"""The same of each remembered number: e(v) grows the rounding of a velocity near the limit velocity."""


def grid_paths(contacts, steps, seed=3):
    """Closed walks over a grid of overlaps, one grid step at a time: (contacts, steps) of grid numbers, above 0."""
    rng = np.random.default_rng(seed)
    there = np.cumsum(rng.choice([-1, 1], (contacts, steps)), axis=1)
    there -= there.min(axis=1, keepdims=True) - 1
    rebound = np.array([np.resize(np.arange(row[-1], row[0] - np.sign(row[-1] - row[0]),
                                         -1 if row[-1] > row[0] else 1), steps) for row in there])  # fmt: skip
    return there, rebound


def test_every_law_of_the_catalog_has_a_case():
    assert {case.law().name for case in CASES} == set(NORMAL_LAWS)


@every_law
def test_device_equals_its_numpy_reference(taichi_f64, case):
    overlap, rate = random_walks(contacts=150, steps=60)
    found = walk(case, overlap, rate)
    force, nudged, history = reference_walk(case, overlap, rate)
    names = case.law().history_names
    remembered = history[..., names.index("overlap_max")] if "overlap_max" in names else overlap
    pull = found.pressing - found.force
    tangent = (np.abs(nudged - force) / NUDGE + pull) / overlap
    eps, tiny = np.finfo(float).eps, np.finfo(float).tiny
    unit = np.maximum(eps * np.maximum(found.pressing, tangent * remembered), tiny)
    worst = np.max(np.abs(found.force - force) / unit)
    assert worst <= ULPS, worst
    np.testing.assert_allclose(found.history, history, rtol=HISTORY_ULPS * eps)


@every_law
def test_force_pulls_only_where_the_law_says_so(taichi_f64, case):
    """What presses the surfaces together is never below 0, and it is the force itself where nothing attracts."""
    overlap, rate = random_walks(contacts=2000, steps=80, seed=2)
    found = walk(case, overlap, rate)
    pulls = case.law().attracts
    assert found.pressing.min() >= (-1e-15 * found.force.max() if pulls else 0.0)
    assert bool(found.force.min() < 0.0) == pulls
    assert found.force.max() > 0.0
    assert not found.force[overlap <= 0.0].any()


@every_law
def test_force_vanishes_with_the_overlap(taichi_f64, case):
    tiny = 1e-9
    overlap = np.array([[3e-4, 3e-4], [3e-4 * tiny, 3e-4 * tiny]])
    rate = np.array([[0.5, 0.0]] * 2)
    large, small = np.abs(walk(case, overlap, rate).elastic[:, 1])
    assert 0.0 < small <= 1.001 * tiny * large, "no law here rises more slowly than in proportion"


@every_continuous_law
def test_force_is_continuous_at_every_change_of_branch(taichi_f64, case):
    """Along a path of 16 times finer steps the largest change from step to step is 16 times smaller."""
    corners = np.array([1e-9, 2e-4, 1.6e-4, 3e-4, 2.9e-4, 2.95e-4, 2e-4, 3.5e-4, 1e-9, 3e-4, 1e-9])
    lengths = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(corners)))])

    def largest_jump(steps):
        overlap = np.interp(np.linspace(0.0, lengths[-1], steps + 1), lengths, corners)[None, :]
        rate = np.zeros_like(overlap)
        rate[0, 0] = 0.5
        return np.abs(np.diff(walk(case, overlap, rate, time_step=0.0).elastic)).max()

    coarse, fine = largest_jump(4000), largest_jump(64000)
    assert coarse / fine == pytest.approx(16.0, rel=0.1)


@every_continuous_law
def test_no_closed_path_gives_work(taichi_f64, case):
    """Work by the trapezoid rule: what is retraced elastically cancels, and unloading lies below loading."""
    there, rebound = grid_paths(contacts=300, steps=60)
    overlap = 6e-6 * np.concatenate([there, rebound], axis=1)
    closed = [np.flatnonzero(rebound[i] == there[i, 0])[0] + there.shape[1] for i in range(len(there))]
    step = np.diff(overlap, axis=1, prepend=overlap[:, :1])
    rate = step / TIME_STEP
    rate[:, 0] = 0.5
    found = walk(case, overlap, rate, time_step=0.0)
    elastic = 0.5 * (found.elastic[:, 1:] + found.elastic[:, :-1]) * step[:, 1:]
    work = elastic + found.viscous[:, 1:] * step[:, 1:]
    total = np.array([work[i, : closed[i]].sum() for i in range(len(work))])
    scale = np.abs(elastic).sum(axis=1)
    assert np.all(total >= -1e-14 * scale)
    assert case.name.endswith("elastic") == bool(np.all(total <= 1e-12 * scale))


@every_continuous_law
def test_work_put_in_is_stored_or_lost(taichi_f64, case):
    """The quadrature of the elastic force is what the law says it stores and has lost; second order in the step."""
    rising, falling = np.linspace(0.0, 3e-4, 4001)[1:], np.linspace(3e-4, 2.4e-4, 8001)[1:]
    overlap = np.concatenate([rising, falling, falling[-2::-1], [3e-4], 3e-4 + rising[:500] / 10])[None, :]
    rate = np.zeros_like(overlap)
    rate[0, 0] = 0.5
    found = walk(case, overlap, rate, time_step=0.0)
    middle = 0.5 * (found.elastic[0, 1:] + found.elastic[0, :-1])
    work = np.concatenate([[0.0], np.cumsum(middle * np.diff(overlap[0]))]) + found.stored[0, 0] + found.lost[0, 0]
    accounting = found.stored[0] + found.lost[0]
    np.testing.assert_allclose(work, accounting, atol=2e-6 * accounting.max())
    if not case.adhesive:
        assert np.all(found.stored >= 0.0)
    assert np.diff(found.lost[0]).min() >= -1e-12 * accounting.max()
    assert case.plastic == bool(found.lost.max() > 1e-9 * accounting.max())


@every_law
@pytest.mark.parametrize("units", [Units(1e3, 1.0, 1.0), Units(1.0, 1e-3, 1.0), Units(1.0, 1.0, 1e6)], ids=str)
def test_units_do_not_matter(taichi_f64, case, units):
    overlap, rate = random_walks(contacts=100, steps=40, seed=4)
    plain, scaled = walk(case, overlap, rate), walk(case, overlap, rate, units)
    # the residual overlap is a difference: its rounding weighs by the unloading tangent, at most 300 Hertz forces
    size = plain.force.max()
    np.testing.assert_allclose(scaled.force / units.newton, plain.force, rtol=1e-12, atol=1e-13 * size)
    energy = units.newton * units.meter
    np.testing.assert_allclose(scaled.stored / energy, plain.stored, rtol=1e-12, atol=1e-13 * plain.stored.max())


@every_law
def test_a_wall_is_the_limit_of_a_growing_partner(taichi_f64, case):
    """The difference falls as 1 / partner radius; its mass grows with the cube and soon says nothing."""
    overlap, rate = random_walks(contacts=20, steps=40, seed=5)
    wall = walk(case, overlap, rate).force

    def difference(times):
        radius, mass = RADIUS * times / (1.0 + times), MASS * times**3 / (1.0 + times**3)
        return np.abs(walk(case, overlap, rate, radius=radius, mass=mass).force - wall).max() / wall.max()

    ten_thousand, million = difference(1e4), difference(1e6)
    if case.name.startswith(("linear", "walton_braun", "luding")) and case.name.endswith(("number", "elastic")):
        assert ten_thousand <= 1e-12, "a spring given as a number knows no radius"
    else:
        assert ten_thousand <= 1e-4
        assert ten_thousand / million == pytest.approx(100.0, rel=0.01)
