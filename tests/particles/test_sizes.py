"""Size distributions: exact counts, truncation, and moments within five standard errors of theory."""

import numpy as np
import pytest
from particles.scenes import BOX, scene_with
from scipy import integrate, stats

from granflow.scene.blocks.sizes import GivenSizes

COUNT = 20_000


def sizes(spec):
    """A size distribution after validation by the schema."""
    group = {"count": 10, "diameter": spec, "insert": {"kind": "pack", "region": BOX}}
    return scene_with({"beads": group}).particles["beads"].diameter


def sample(spec, seed=5):
    """A sample of `COUNT` diameters [m]."""
    return sizes(spec).draw(COUNT, np.random.default_rng(seed))


def density_of(spec):
    """The probability density of the untruncated distribution, from scipy."""
    if spec["distribution"] == "uniform":
        return stats.uniform(spec["min"], spec["max"] - spec["min"]).pdf
    if spec["distribution"] == "normal":
        return stats.norm(spec["mean"], spec["deviation"]).pdf
    if spec["distribution"] == "rosin_rammler":
        mass = stats.weibull_min(spec["spread"], scale=spec["size"]).pdf
    else:
        mass = stats.lognorm(spec["sigma"], scale=spec["median"]).pdf
    return mass if spec.get("by") == "number" else lambda d: mass(d) * (0.004 / d) ** 3


DISTRIBUTIONS = [
    {"distribution": "uniform", "min": 0.003, "max": 0.005},
    {"distribution": "normal", "mean": 0.004, "deviation": 0.0004, "min": 0.002, "max": 0.006},
    {"distribution": "normal", "mean": 0.0035, "deviation": 0.002, "min": 0.003, "max": 0.005},
    {"distribution": "log_normal", "by": "number", "median": 0.004, "sigma": 0.3, "min": 0.002, "max": 0.008},
    {"distribution": "log_normal", "by": "number", "median": 0.004, "sigma": 2.0, "min": 0.003, "max": 0.008},
    {"distribution": "log_normal", "by": "mass", "median": 0.004, "sigma": 0.5, "min": 0.002, "max": 0.009},
    {"distribution": "rosin_rammler", "size": 0.004, "spread": 2.5, "min": 0.001, "max": 0.008},
    {"distribution": "rosin_rammler", "size": 0.004, "spread": 8, "min": 0.002, "max": 0.005},
]


@pytest.mark.parametrize("power", [1, 2, 3])
@pytest.mark.parametrize("spec", DISTRIBUTIONS)
def test_moments_equal_those_of_the_truncated_distribution(spec, power):
    """The standard error of the sample mean of d^p is sqrt((E[d^2p] - E[d^p]^2) / n)."""
    density = density_of(spec)

    def moment(p):
        value, _ = integrate.quad(lambda d: d**p * density(d), spec["min"], spec["max"])
        total, _ = integrate.quad(density, spec["min"], spec["max"])
        return value / total

    values = sample(spec)
    assert values.min() >= spec["min"] and values.max() <= spec["max"] and len(values) == COUNT
    assert len(np.unique(values)) > 0.999 * COUNT, "values outside are drawn again, not clipped"
    values = values**power
    standard_error = np.sqrt((moment(2 * power) - moment(power) ** 2) / COUNT)
    assert abs(values.mean() - moment(power)) < 5 * standard_error


def classes(by, *shares):
    """A distribution of classes (diameter [m], fraction)."""
    return sizes(
        {
            "distribution": "classes",
            "by": by,
            "classes": [{"diameter": diameter, "fraction": fraction} for diameter, fraction in shares],
        }
    )


def test_masses_follow_the_sieve_curve():
    """30 % of the mass between 1 and 2 mm, none to 3 mm, the rest to 4 mm, linear in the diameter: within the
    mass of the particles of one of the 1024 equal shares of the numbers."""
    curve = [(0.001, 0.0), (0.002, 0.3), (0.003, 0.3), (0.004, 1.0)]
    spec = sizes({"distribution": "sieve", "sieves": [{"opening": d, "passing": w} for d, w in curve]})
    assert spec.spans() == [(0.001, 0.002), (0.003, 0.004)]
    values = spec.draw(20 * 1024, np.random.default_rng(2))
    share = values**3 / (values**3).sum()
    for diameter in (0.00125, 0.0015, 0.002, 0.0025, 0.003, 0.00325, 0.0039):
        finer = np.interp(diameter, *zip(*curve, strict=True))
        assert share[values <= diameter].sum() == pytest.approx(finer, abs=20 * share.max())
    np.testing.assert_array_equal(spec.draw(1500, np.random.default_rng(2)), values[:1500])
    cubes = 1e4 * 0.003**3
    count = spec.count_for_volume(cubes, lambda: np.random.default_rng(2))
    assert (spec.draw(count, np.random.default_rng(2)) ** 3).sum() == pytest.approx(cubes, abs=0.004**3)


def test_class_counts_by_number_are_exact_within_one_particle():
    spec = classes("number", (0.001, 1), (0.002, 1), (0.003, 1))
    assert sorted(spec.counts(100)) == [33, 33, 34]
    assert list(classes("number", (0.001, 0.7), (0.002, 0.3)).counts(10)) == [7, 3]
    values = spec.draw(100, np.random.default_rng(1))
    assert len(values) == 100 and not np.all(np.diff(values) >= 0)


def test_class_counts_by_mass_are_exact_within_one_particle():
    """Half of the mass in each of 1 mm and 2 mm: eight small particles per large one."""
    counts = classes("mass", (0.001, 0.5), (0.002, 0.5)).counts(900)
    assert list(counts) == [800, 100]
    for count in (1, 7, 101, 1000):
        counts = classes("mass", (0.001, 0.2), (0.002, 0.5), (0.005, 0.3)).counts(count)
        assert counts.sum() == count
        exact = np.array([0.2, 0.5 / 8, 0.3 / 125])
        assert np.all(np.abs(counts - count * exact / exact.sum()) < 1)


def test_constant_and_listed_diameters_are_used_unchanged():
    np.testing.assert_array_equal(GivenSizes(0.004).draw(3, np.random.default_rng(1)), [0.004] * 3)
    np.testing.assert_array_equal(GivenSizes((0.1, 0.2)).draw(2, np.random.default_rng(1)), [0.1, 0.2])
