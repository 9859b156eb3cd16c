"""Yield loci: the geometry of Mohr circles against closed forms, the stresses of synthetic runs with known
ones, messages, and a small shear test from the sweep to the tables."""

import csv
import json
import re
from math import asin, cos, radians, sin, sqrt, tan
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import linregress

from granflow.cli.main import main
from granflow.errors import FileError
from granflow.io.tables import read_series
from granflow.studies.checked_run import RunSettings
from granflow.studies.sweep import checked_points, read_sweep
from granflow.studies.yield_locus import (
    ShearTest,
    YieldLocus,
    YieldLocusEvaluation,
    evaluate,
    locus_columns,
    shear_point,
)

SCENES = Path(__file__).parents[2] / "scenes"
EXACT = np.zeros((2, 2))
"""Covariance of a line without scatter."""
TEST = YieldLocusEvaluation.model_validate(
    {"wall": "lid", "parameters": {"shear": "ratio", "preshear": "preshear"}}
)


@pytest.mark.parametrize(("cohesion", "angle"), [(0.0, 30.0), (700.0, 90.0), (700.0, 119.0)])
def test_circle_of_consolidation_is_the_one_that_touches_the_locus(cohesion, angle):
    """A circle about 9 kPa touches tau = c + sigma tan(phi) at 90 deg + phi from the sigma axis. Any point of it
    to the right of there gives it back. Its principal stresses are m +- r, and the line through the origin that
    touches it has the sine r / m."""
    phi = radians(30.0)
    center, radius = 9000.0, (cohesion + 9000.0 * tan(phi)) * cos(phi)
    point = (center + radius * cos(radians(angle)), radius * sin(radians(angle)))
    locus = YieldLocus(cohesion, tan(phi), EXACT, point)
    assert locus.center == pytest.approx(center, rel=1e-9)
    assert locus.consolidation_stress == pytest.approx(center + radius, rel=1e-9)
    assert locus.effective_angle == pytest.approx(asin(radius / center), rel=1e-9)
    assert tan(locus.steady_angle) == pytest.approx(point[1] / point[0])
    if cohesion == 0.0:
        assert locus.unconfined_strength == 0.0 and locus.effective_angle == pytest.approx(phi)


def test_strength_and_its_circle_follow_from_cohesion_and_angle():
    """sigma_c = 2 c cos(phi) / (1 - sin(phi)); its circle touches the line at the height c + sigma tan(phi), at
    the distance of its radius from its center. The error is that of the linearized formula."""
    cohesion, phi = 900.0, radians(35.0)
    covariance = np.array([[400.0, -0.05], [-0.05, 1e-4]])
    locus = YieldLocus(cohesion, tan(phi), covariance, (5000.0, 3000.0))
    assert locus.unconfined_strength == pytest.approx(2 * cohesion * cos(phi) / (1 - sin(phi)))
    x = locus.least_normal
    distance = np.hypot(x - 0.5 * locus.unconfined_strength, cohesion + x * tan(phi))
    assert distance == pytest.approx(0.5 * locus.unconfined_strength)

    def strength(c, slope):
        return YieldLocus(c, slope, EXACT, (1.0, 1.0)).unconfined_strength

    by_c = (strength(cohesion + 1.0, tan(phi)) - strength(cohesion - 1.0, tan(phi))) / 2.0
    by_slope = (strength(cohesion, tan(phi) + 1e-4) - strength(cohesion, tan(phi) - 1e-4)) / 2e-4
    expected = sqrt(400.0 * by_c**2 + 1e-4 * by_slope**2 - 2 * 0.05 * by_c * by_slope)
    assert locus.unconfined_error == pytest.approx(expected, rel=1e-5)


# Synthetic runs

AREA = 12e-3 * 8e-3
PRESHEAR, STEADY = 5000.0, 2800.0
"""Normal and shear stress [Pa] of the preshear."""
PEAK_MEAN = 1.0 - 2.0 * 0.05 / 4
"""Mean over a window of 5 % around the top of a triangle whose slope is 2 peak per stage, over its peak."""


def peaked(sigma, peak):
    """Normal and shear stress [Pa] of a shear to failure at shares of the stage: the peak at 0.3."""

    def stresses(share):
        return sigma + 0 * share, peak * (1.0 - 2.0 * np.abs(share - 0.3))

    return stresses


def shear_test(folder, name, ratio, failure, steady=STEADY, preshear=None, rows=200, seed=1):
    """A run whose lid has these stresses, in `shear` those of the function `failure` of the share of the
    stage. The force on the lid is opposite to its motion."""
    directory = folder / name
    directory.mkdir()
    (directory / "scene_as_run.yaml").write_text((SCENES / "shear_tester.yaml").read_text())
    share = np.arange(1, rows + 1) / rows
    rising = np.where(share < 0.5, 2.0 * share, 1.0)
    sections = {
        "consolidate": (PRESHEAR + 0 * share, 0 * share),
        "preshear": (PRESHEAR + 0 * share, steady * rising) if preshear is None else preshear(share),
        "shear": failure(share),
    }
    lines = ["time [s],stage,wall_force_x.lid [N],wall_force_y.lid [N],wall_force_z.lid [N]"]
    for k, (stage, (normal, shear)) in enumerate(sections.items()):
        for t, sigma, tau in zip(k + share, normal, shear, strict=True):
            lines.append(f"{t},{stage},{-tau * AREA},0,{sigma * AREA}")
    (directory / "timeseries.csv").write_text("\n".join(lines) + "\n")
    texts = {"preshear": "5 kPa", "ratio": f"{ratio:g}"}
    return ShearTest({"preshear": PRESHEAR, "ratio": ratio}, seed, directory, texts)


def test_prorated_points_give_the_locus_of_the_mean_preshear(tmp_path):
    """Two seeds with preshear stresses of 0.9 and 1.1 of the mean, and stresses at failure in proportion, give
    the points of one line, tau = 500 Pa + 0.5 sigma, without scatter."""
    runs = []
    for seed, factor in ((1, 0.9), (2, 1.1)):
        for ratio in (0.3, 0.5, 0.7):
            failure = peaked(ratio * PRESHEAR, factor * (500.0 + 0.5 * ratio * PRESHEAR) / PEAK_MEAN)
            runs.append(shear_test(tmp_path, f"{seed}_{ratio}", ratio, failure, factor * STEADY, seed=seed))
    point = shear_point(TEST, runs[0])
    assert point.preshear == pytest.approx((PRESHEAR, 0.9 * STEADY)) and not point.remarks
    assert (point.normal, point.shear) == pytest.approx((1500.0, 0.9 * 1250.0), rel=1e-3)
    (locus,) = evaluate(TEST, runs)
    assert locus.line is not None and not locus.remarks
    assert locus.preshear == pytest.approx((PRESHEAR, STEADY))
    assert (locus.line.cohesion, locus.line.slope) == pytest.approx((500.0, 0.5), rel=2e-3)
    assert locus.line.covariance[0, 0] < 1.0


@pytest.mark.parametrize(("name", "parts", "remark"), [
    ("rising", {"failure": lambda x: (2000.0 + 0 * x, 1800.0 * x)}, "there is no peak"),
    ("short", {"failure": peaked(2000.0, 1800.0), "rows": 30}, "the stage preshear has 30 rows"),
    ("lifted", {"failure": peaked(-100.0, 300.0)}, "the normal stress at failure is not positive"),
    ("drifting", {"failure": peaked(2000.0, 1800.0), "preshear": lambda x: (5000.0 + 0 * x, 3000.0 * x)},
     "the preshear is not steady: its shear stress changes by +33 %"),
])  # fmt: skip
def test_remarks_on_a_run(tmp_path, name, parts, remark):
    """A preshear with a stress in proportion to the time has means of 5/8 and 7/8 in the two quarters of its
    second half, and 6/8 in both."""
    point = shear_point(TEST, shear_test(tmp_path, name, 0.4, **parts))
    assert any(remark in each for each in point.remarks), point.remarks
    assert point.is_used == (name == "drifting")


@pytest.mark.parametrize(("peaks", "remark"), [
    ({0.4: 1800.0}, "1 of 1 shear points are valid"), ({0.3: 2000.0, 0.6: 1500.0}, "its slope is -0.325"),
    ({0.3: 1000.0, 0.6: 1300.0, 0.7: 1400.0}, "the preshear point is 69 % above the yield locus"),
    ({0.3: 1400.0, 0.7: 2400.0}, "two points have no error"),
    ({0.3: 700.0, 0.5: 1350.0, 0.8: 2300.0}, "the unconfined yield strength is 0"),
])  # fmt: skip
def test_remarks_on_a_locus(tmp_path, peaks, remark):
    """A line through (1500, 1000), (3000, 1300) and (3500, 1400), less 2.5 %, has 1657 Pa at 5000 Pa, and the
    preshear 2800 Pa. The errors of a line are those of linear regression."""
    runs = [shear_test(tmp_path, f"{r}", r, peaked(r * PRESHEAR, peak)) for r, peak in peaks.items()]
    (locus,) = evaluate(TEST, runs)
    assert any(remark in each for each in locus.remarks), locus.remarks
    assert (locus_columns([locus])["consolidation_stress [Pa]"] == [None]) == (locus.line is None)
    if locus.line is not None and len(peaks) > 2:
        expected = linregress([each.normal for each in locus.points], [each.shear for each in locus.points])
        assert locus.line.cohesion == pytest.approx(expected.intercept)
        assert np.sqrt(locus.line.covariance[1, 1]) == pytest.approx(expected.stderr)


SWEEP = """\
scene: SCENES/shear_tester.yaml
vary:
  preshear: [4 kPa]
  ratio: [0.4, 0.7]
derive:
  walls.lid.motion.0.pressure: preshear
  walls.lid.motion.1.pressure: ratio * preshear
evaluate:
  kind: yield_locus
  wall: lid
  parameters: {preshear: preshear, shear: ratio}
"""


def write(folder, text=SWEEP):
    path = folder / "sweep.yaml"
    path.write_text(text.replace("SCENES", str(SCENES)))
    return path


@pytest.mark.parametrize(("old", "new", "message"), [
    ("shear: ratio}", "shear: rato}", "sweep.yaml:11:43: evaluate.parameters.shear is rato, but"),
    ("wall: lid", "wall: lit", "sweep.yaml:10:9: evaluate.wall is lit, but there is no such wall."),
    ("wall: lid", "wall: bottom", "evaluate.wall is bottom, but it has 0 servos and 0 translations"),
    ("wall: lid", "wall: lid\n  stages: {shear: sheer}", "sweep.yaml:11:19: evaluate.stages.shear is sheer"),
    ("evaluate:", "set: {'walls.lid.motion.4.velocity': [0, 0.01, 0]}\nevaluate:", "other directions in the two stages"),
])  # fmt: skip
def test_sweep_that_is_no_shear_test_is_refused(tmp_path, old, new, message):
    text = SWEEP.replace(old, new)
    with pytest.raises(FileError, match=re.escape(message)):
        checked_points(read_sweep(write(tmp_path, text)), RunSettings(tmp_path, 1, "cpu", tmp_path / "stop"))


SMALL = (
    ("[12 mm, 8 mm", "[4 mm, 4 mm"), ("count: 100", "count: 16"), ("count: 900", "count: 60"), ("16 mm", "8.5 mm"),
    ("17.5 mm", "10 mm"), ("duration: 55 ms", "duration: 50 ms"), ("duration: 0.13 s", "duration: 15 ms"),
    ("duration: 16 ms", "duration: 8 ms"),
)  # fmt: skip
"""Changes of the shipped scene: 92 particles, and short stages."""


@pytest.mark.slow
def test_sweep_of_a_small_shear_tester(tmp_path, capsys):
    """One command runs two tests and writes the yield locus: the normal stress is the pressure of the lid, and
    files, page and printed table agree."""
    scene = (SCENES / "shear_tester.yaml").read_text()
    for old, new in SMALL:
        assert old in scene
        scene = scene.replace(old, new)
    (tmp_path / "small.yaml").write_text(scene[: scene.index("expect:")])
    path = write(tmp_path, SWEEP.replace("SCENES/shear_tester.yaml", "small.yaml"))
    main(["sweep", str(path), "--out", str(tmp_path / "out"), "--jobs", "1"])
    with (tmp_path / "out/shear_points.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [float(row["ratio"]) for row in rows] == [0.4, 0.7]
    for row in rows:
        series = read_series(tmp_path / "out/runs" / row["run"] / "timeseries.csv")
        pressure = next(each.values for each in series.columns if each.name == "wall_pressure.lid")
        steady = np.array_split(pressure[series.stage == "preshear"], 2)[1]
        assert float(row["preshear_normal_stress [Pa]"]) == pytest.approx(steady.mean(), rel=1e-3)
        assert 0.2 < float(row["shear_stress [Pa]"]) / float(row["normal_stress [Pa]"]) < 2.0
    (locus,) = json.loads((tmp_path / "out/yield_loci.json").read_text())
    assert [each["run"] for each in locus["points"]] == [row["run"] for row in rows]
    normal, shear = (float(rows[0][f"preshear_{kind}_stress [Pa]"]) for kind in ("normal", "shear"))
    assert f" {np.degrees(np.arctan2(shear, normal)):.1f} " in capsys.readouterr().out
    assert (tmp_path / "out/yield_loci.png").stat().st_size > 1000
    assert "Yield loci" in (tmp_path / "out/sweep.html").read_text()
