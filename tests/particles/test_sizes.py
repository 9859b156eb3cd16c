"""Size distributions: exact counts, truncation, and moments within five standard errors of theory."""

import numpy as np
import pytest
from particles.scenes import BOX, scene_with
from scipy import integrate, stats

from granflow.errors import FileError
from granflow.scene.blocks.sizes import SieveSizes

COUNT = 20_000


def sizes(spec):
    """A size distribution after validation by the schema."""
    group = {"count": 10, "diameter": spec, "insert": {"kind": "pack", "region": BOX}}
    return scene_with({"beads": group}).particles["beads"].diameter


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
    {"distribution": "normal", "mean": 0.0035, "deviation": 0.002, "min": 0.003, "max": 0.005},
    {"distribution": "log_normal", "by": "number", "median": 0.004, "sigma": 2.0, "min": 0.003, "max": 0.008},
    {"distribution": "log_normal", "by": "mass", "median": 0.004, "sigma": 0.5, "min": 0.002, "max": 0.009},
    {"distribution": "rosin_rammler", "size": 0.004, "spread": 2.5, "min": 0.001, "max": 0.008},
]


@pytest.mark.parametrize("spec", DISTRIBUTIONS)
def test_moments_equal_those_of_the_truncated_distribution(spec):
    """The standard error of the sample mean of d^p is sqrt((E[d^2p] - E[d^p]^2) / n)."""
    density = density_of(spec)

    def moment(p):
        value, _ = integrate.quad(lambda d: d**p * density(d), spec["min"], spec["max"])
        total, _ = integrate.quad(density, spec["min"], spec["max"])
        return value / total

    values = sizes(spec).draw(COUNT, np.random.default_rng(5))
    assert values.min() >= spec["min"] and values.max() <= spec["max"] and len(values) == COUNT
    assert len(np.unique(values)) > 0.999 * COUNT, "values outside are drawn again, not clipped"
    for power in (1, 3):
        standard_error = np.sqrt((moment(2 * power) - moment(power) ** 2) / COUNT)
        assert abs((values**power).mean() - moment(power)) < 5 * standard_error


CURVE = [(0.001, 0.0), (0.002, 0.3), (0.003, 0.3), (0.004, 1.0)]
"""Openings [m] of sieves and the share that passes."""


def test_masses_follow_the_sieve_curve():
    """30 % of the mass between 1 and 2 mm, none to 3 mm, the rest to 4 mm, linear in the diameter: within the
    mass of the particles of one of the 1024 equal shares of the numbers."""
    spec = sizes({"distribution": "sieve", "sieves": [{"opening": d, "passing": w} for d, w in CURVE]})
    assert spec.spans() == [(0.001, 0.002), (0.003, 0.004)]
    values = spec.draw(20 * 1024, np.random.default_rng(2))
    share = values**3 / (values**3).sum()
    for diameter in (0.00125, 0.002, 0.003, 0.00325, 0.0039):
        finer = np.interp(diameter, *zip(*CURVE, strict=True))
        assert share[values <= diameter].sum() == pytest.approx(finer, abs=20 * share.max())
    np.testing.assert_array_equal(spec.draw(1500, np.random.default_rng(2)), values[:1500])
    cubes = 1e4 * 0.003**3
    count = spec.count_for_volume(cubes, lambda: np.random.default_rng(2))
    assert (spec.draw(count, np.random.default_rng(2)) ** 3).sum() == pytest.approx(cubes, abs=0.004**3)


SIEVE_FILES = {
    "passing in %, from the largest sieve": "Aperture (mm);Cumulative passing (%)\n4;100\n3;30\n2;30\n1;0\n",
    "share, spaces, other columns": "name size[um] mass[g] passing\na 1e3 9 0\nb 2e3 9 0.3\nc 3e3 9 0.3\nd 4e3 9 1\n",
    "retained masses": "# 2 kg\nopening [m],mass [g]\n0.001,45\n0.002,0\n0.003,105\n0.004,0\n",
}  # fmt: skip


@pytest.mark.parametrize("text", SIEVE_FILES.values(), ids=SIEVE_FILES)
def test_sieve_curve_of_a_file(text, tmp_path):
    (tmp_path / "sieves.csv").write_text(text)
    group = {"mass": 0.01, "diameter": {"distribution": "sieve", "file": "sieves.csv"}}
    scene = scene_with({"beads": group | {"insert": {"kind": "pack", "region": BOX}}}, folder=tmp_path)
    found = [(each.opening, each.passing) for each in scene.particles["beads"].diameter.curve]
    np.testing.assert_allclose(found, CURVE, rtol=1e-15)
    assert scene.particles["beads"].count > 100, "the count follows from the mass and the curve"


FAULTY_SIEVES = {
    "": ": the table has no rows;",
    "size [mm],passing [%]\n1,0\ninf,100\n": ":3: size [mm] is inf, but",
    "opening,passing\n1,1\n": ": a sieve curve has 2 to 1000 rows, and this table has 1.",
    "x,y\n1,0\n2,1\n": ":1: the columns are x, y, but opening and one of passing",
    "opening,passing [kg]\n1,0\n2,1\n": ":1: the unit of passing [kg] is invalid: ",
    "opening,mass\n0,1\n2,x\n": ":2: opening is 0, but it must be a number above 0;|:3: mass is x, but",
    "size,passing\n1,0\n2,100\n": ":3: passing is 100, but it must be at most 1;",
    "size [mm],passing [%]\n2,50\n3,40\n1,10\n": ":4: passing [%] is 10, but the smallest sieve must pass 0;|"
    ":3: passing [%] is 40, but the next smaller sieve passes 50 %;|:3: passing [%] is 40, but the largest sieve",
    "size [mm],passing\n1,0\n1,0.5\n2,1\n": ":3: size [mm] is 1, but openings must increase",
    "size,mass\n1,1\n2,1\n": ":3: mass is 1, but the largest sieve must retain 0;",
    "size,mass\n1,0\n2,0\n": ":2: mass is 0, but at least one sieve must retain something.",
}


@pytest.mark.parametrize("text", FAULTY_SIEVES)
def test_faulty_file_of_a_sieve_curve_is_rejected_with_its_line(text, tmp_path):
    path = tmp_path / "sieves.csv"
    path.write_text(text)
    with pytest.raises(FileError) as caught:
        SieveSizes(file="sieves.csv").read(path)
    expected = [f"{path}{each}" for each in FAULTY_SIEVES[text].split("|")]
    assert all(a.startswith(b) for a, b in zip(caught.value.problems, expected, strict=True))


def test_counts_of_classes_are_exact_within_one_particle():
    """Half of the mass in each of 1 mm and 2 mm: eight small particles per large one."""

    def classes(by, *shares):
        given = [{"diameter": diameter, "fraction": fraction} for diameter, fraction in shares]
        return sizes({"distribution": "classes", "by": by, "classes": given})

    thirds = classes("number", (0.001, 1), (0.002, 1), (0.003, 1))
    assert sorted(thirds.counts(100)) == [33, 33, 34]
    assert not np.all(np.diff(thirds.draw(100, np.random.default_rng(1))) >= 0)
    assert list(classes("mass", (0.001, 0.5), (0.002, 0.5)).counts(900)) == [800, 100]
    for count in (1, 101):
        counts = classes("mass", (0.001, 0.2), (0.002, 0.5), (0.005, 0.3)).counts(count)
        exact = np.array([0.2, 0.5 / 8, 0.3 / 125])
        assert counts.sum() == count and np.all(np.abs(counts - count * exact / exact.sum()) < 1)
