"""What targets determine, from responses with known effects and known scatter."""

from collections import Counter

import numpy as np
import pytest
from scipy.stats import binom, ncf
from scipy.stats import f as f_distribution

from granflow.studies.calibration.response import LEVEL, Effects, Response, effects, identification

NAMES = ["friction", "rolling_friction", "restitution"]


def identified(u, residuals, error=0.0):
    best = int(np.argmin((residuals**2).sum(axis=1)))
    return identification(u, residuals, np.full_like(residuals, error), best)


def test_uncertainty_of_exact_linear_residuals():
    """Residuals 20 (u - 0.3) and 5 (v - 0.6): standard deviations 1/sqrt(400 + 12) and 1/sqrt(25 + 12)."""
    u = np.random.default_rng(1).uniform(size=(40, 2))
    known = identified(u, np.column_stack([20.0 * (u[:, 0] - 0.3), 5.0 * (u[:, 1] - 0.6)]))
    assert known.deviation == pytest.approx([1 / np.sqrt(412.0), 1 / np.sqrt(37.0)], rel=1e-6)
    assert known.effects.change == pytest.approx(np.diag([20.0, 5.0]), abs=1e-9)


def test_change_is_the_mean_difference_between_the_bounds():
    """The mean of u v + 3 v^2 over u at v = 1 exceeds that at v = 0 by 1/2 + 3; over v, that of u = 1 by
    1/2."""
    u = np.random.default_rng(1).uniform(size=(20, 2))
    found = effects(u, (u[:, 0] * u[:, 1] + 3.0 * u[:, 1] ** 2)[:, None], np.zeros((20, 1)))
    assert found.change == pytest.approx(np.array([[0.5, 3.5]]))


def test_effect_has_the_f_statistic_of_a_line():
    """Of a line, F is the squared ratio of the slope to its standard error, with 1 and n - 2 degrees of
    freedom."""
    u = np.linspace(0.0, 1.0, 5)
    residual = 6.0 * u + np.array([0.1, -0.2, 0.3, 0.0, -0.1])
    centered = u - 0.5
    slope = centered @ residual / (centered @ centered)
    deviations = residual - residual.mean() - slope * centered
    error = np.sqrt(deviations @ deviations / 3.0 / (centered @ centered))
    found = effects(u[:, None], residual[:, None], np.zeros((5, 1)))
    assert found.change == pytest.approx(slope) and found.error == pytest.approx(error)
    assert found.probability == pytest.approx(f_distribution.sf((slope / error) ** 2, 1, 3))


def test_standard_errors_of_the_runs_limit_what_is_identified():
    """A residual 7 (u - 0.5) that chance makes exact, with errors of 4 tolerances: the slope has the error 4
    / 0.79."""
    u = np.linspace(0.0, 1.0, 5)[:, None]
    known = identified(u, 7.0 * (u - 0.5), 4.0)
    assert known.effects.error == pytest.approx(4.0 / np.sqrt(((u - 0.5) ** 2).sum()))
    assert not known.is_identified(0) and known.deviation == pytest.approx([np.sqrt(1.0 / 12.0)])
    assert identified(u, 7.0 * (u - 0.5)).is_identified(0)


def test_few_trials_need_a_more_significant_slope():
    """Student's t for 99.865 % is 19.21 with 2 degrees of freedom, and 3.00 with many."""
    ratios = [Response(1, np.zeros((2, 1)), np.eye(2), np.ones(1), n).least_ratio for n in (2, 10**6)]
    assert ratios == pytest.approx([19.207, 3.0], abs=1e-3)


def test_parameters_of_a_sum_are_identified_only_together():
    """One residual with scatter responds to u and v through their sum only, and not to w."""
    random = np.random.default_rng(2)
    u = random.uniform(size=(60, 3))
    known = identified(u, 30.0 * (u[:, :1] + u[:, 1:2] - 1.0) + random.normal(0.0, 0.5, (60, 1)))
    assert not any(known.is_identified(k) for k in range(3))
    # The sum is known: its direction has a vanishing variance, and each of u and v keeps half of the uniform
    # variance.
    assert known.deviation == pytest.approx([np.sqrt(1 / 24), np.sqrt(1 / 24), np.sqrt(1 / 12)], rel=0.05)
    assert known.statement(NAMES, 0, "").endswith("they determine it only together with rolling_friction.")
    assert known.statement(NAMES, 2, "angle changes by 0.1 deg").startswith(
        "restitution cannot be identified from the targets: none of them responds to it between its bounds "
        "by more than the scatter between runs; angle changes by 0.1 deg (F test of 60 trials: p = 0."
    )


def test_parameter_with_an_effect_far_from_the_best_values_only():
    """The residual is constant within the scatter from u = 0.4 on, where the best trials are."""
    random = np.random.default_rng(3)
    u = np.concatenate([random.uniform(0.0, 1.0, (20, 1)), random.uniform(0.4, 1.0, (40, 1))])
    known = identified(u, 30.0 * np.minimum(u - 0.4, 0.0) + random.normal(0.0, 1.0, (60, 1)))
    assert known.effects.significant[0, 0] and not known.is_identified(0)
    assert "they respond to it between its bounds (x, p = " in known.statement(["friction"], 0, "x")


def noisy_calibration(seed, trials, size, scatter):
    """Effects of friction and restitution in a synthetic calibration, and its identification.

    The residual is size (1 - exp(-5 u)) / (1 - exp(-5)) of the friction u, 0 at u = 0.1, as that of an angle
    of repose that friction above about 0.5 does not change; the restitution has no effect. The first ten
    trials are random, most of the others are near the best ones so far, as those of the search.
    """
    random = np.random.default_rng(seed)
    u = np.empty((0, 2))
    found = np.empty(0)
    for number in range(trials):
        point = random.uniform(size=2)
        if number >= 10 and random.uniform() < 0.9:
            near = u[random.choice(np.argsort(found**2)[: max(3, number // 8)])] + random.normal(0.0, 0.12, 2)
            point = 1.0 - np.abs(1.0 - np.abs(near))
        response = size * (np.exp(-0.5) - np.exp(-5.0 * point[0])) / (1.0 - np.exp(-5.0))
        u = np.vstack([u, point])
        found = np.append(found, response + random.normal(0.0, scatter))
    return identified(u, found[:, None])


@pytest.mark.parametrize("trials", [20, 40])
def test_a_parameter_without_effect_is_rarely_taken_for_one_with_an_effect(trials):
    """The rate of false statements is LEVEL for a polynomial and trials that do not depend on earlier ones.

    Both raise the rate here; 2 % is accepted. None of the calibrations identifies the parameter.
    """
    known = [noisy_calibration(seed, trials, 9.0, 2.0) for seed in range(300)]
    count = Counter((bool(each.effects.significant[0, 1]), each.is_identified(1)) for each in known)
    assert count[True, False] + count[True, True] <= binom.isf(0.01, 300, 0.02)
    assert count[True, True] == count[False, True] == 0


def test_a_strong_effect_is_found_and_its_parameter_identified():
    """Scatter of a ninth of the effect: the slope 9 5 exp(-0.5) / (1 - exp(-5)) = 27.5 gives the best value a
    standard deviation of 1/sqrt(27.5^2 / 2 + 12) = 0.05."""
    known = [noisy_calibration(seed, 40, 9.0, 1.0) for seed in range(100)]
    assert sum(bool(each.effects.significant[0, 0]) for each in known) >= 99
    assert sum(each.is_identified(0) for each in known) >= 90


def test_rate_of_found_effects_is_the_power_of_the_f_test():
    """Of a linear effect in uniform trials: the noncentral F distribution, parameter n Var(effect) /
    scatter^2."""
    trials = 40
    count = 400
    size = 2.0
    freedom = trials - 6
    limit = f_distribution.isf(LEVEL, 3, freedom)
    powers = []
    found = 0
    for seed in range(count):
        random = np.random.default_rng(seed)
        u = random.uniform(size=(trials, 2))
        others = np.column_stack([np.ones(trials), u[:, 1], u[:, 1] ** 2])
        signal = size * u[:, 0]
        explained = signal - others @ np.linalg.lstsq(others, signal, rcond=None)[0]
        powers.append(ncf.sf(limit, 3, freedom, explained @ explained))
        residual = (signal + random.normal(size=trials))[:, None]
        found += bool(effects(u, residual, np.zeros((trials, 1))).significant[0, 0])
    power = float(np.mean(powers))
    assert found / count == pytest.approx(power, abs=4.0 * np.sqrt(power * (1.0 - power) / count))


def test_trials_that_were_stopped_early_show_effects_on_the_targets_that_they_have():
    """A trial is stopped if its first residual, 10 (u - 0.1), exceeds 4: the completed ones are those up to u
    = 0.5."""
    random = np.random.default_rng(5)
    u = random.uniform(size=(30, 1))
    residuals = np.hstack([10.0 * (u - 0.1) + random.normal(0.0, 1.0, (30, 1)), 5.0 * u])
    whole = effects(u, residuals[:, :1], np.zeros((30, 1)))
    stopped = residuals[:, 0] > 4.0
    residuals[stopped, 1] = np.nan
    best = int(np.argmin(np.where(stopped, np.inf, np.abs(residuals[:, 0]))))
    known = identification(u, residuals, np.where(np.isnan(residuals), np.nan, 0.0), best)
    assert known.effects.trials.tolist() == [30, 30 - stopped.sum()]
    assert known.effects.change[0] == pytest.approx(whole.change[0])
    assert known.effects.change[1] == pytest.approx(5.0)
    completed = identification(u[~stopped], residuals[~stopped], np.zeros((30 - stopped.sum(), 2)), 0)
    assert known.effects.error[0, 0] < completed.effects.error[0, 0]


def test_many_residuals_need_a_smaller_probability():
    """The smallest of 50 probabilities without effect is below LEVEL in 12 % of all cases without the factor
    50."""
    random = np.random.default_rng(4)
    count = 0
    for _ in range(60):
        found: Effects = effects(
            random.uniform(size=(30, 1)), random.normal(size=(30, 50)), np.zeros((30, 50))
        )
        count += bool(found.significant.any())
    assert count <= binom.isf(1e-3, 60, LEVEL)


def test_scatter_above_the_tolerance_hides_no_slope_of_a_curved_response():
    """A discharge rate over friction, 40 (0.2 - u) / (0.5 + u) with scatter 1.3: the slope at 0.2 is -40 /
    0.7.

    Eight trials of 20 are anywhere, the others near the optimum, where the scatter hides the slope from few
    trials. The deviation is sqrt(1 + 1.3^2) / (40 / 0.7) = 0.029; the optimum of the fit is within three of
    these in 99.7 %.
    """
    found = []
    for seed in range(100):
        random = np.random.default_rng(seed)
        near = np.clip(0.2 + 0.05 * random.standard_normal(12), 0.0, 1.0)
        u = np.concatenate([random.uniform(size=8), near])[:, None]
        found.append(identified(u, 40.0 * (0.2 - u) / (0.5 + u) + 1.3 * random.standard_normal(u.shape)))
    assert sum(known.is_identified(0) for known in found) >= 97
    assert np.median([known.deviation[0] for known in found]) == pytest.approx(
        np.sqrt(2.69) / (40.0 / 0.7), rel=0.15
    )
    assert sum(abs(known.optimum[0] - 0.2) < 3.0 * known.deviation[0] for known in found) >= 97
