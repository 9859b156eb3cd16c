"""`granflow compare`: tables of two particles against closed forms, statistics of beds, intervals of seeds."""

import csv
import shutil
import sys
from types import SimpleNamespace

import numpy as np
import pytest
from scene_builders import SOFT, build_scene, particle_group, plane
from scipy import stats

from granflow.snapshot import Snapshot
from granflow.studies.compare import report as reporting
from granflow.studies.compare import runs
from granflow.studies.compare.bed import FORCE_EDGES, BedHeights, ForceHistogram
from granflow.studies.compare.collisions import assess_collisions, subject_of, sweep_columns, sweeps_of
from granflow.studies.compare.differences import Estimate, difference_of
from granflow.studies.compare.report import compare, draw_collisions, drawings, notes_on
from granflow.studies.compare.runs import variants_of
from granflow.studies.figures import Drawing, write_figures

DIAMETER, SPEED = 0.01, 1.0
REFERENCE = 0.1 * SPEED
MODULUS = 0.5 * SOFT["young_modulus"] / (1.0 - SOFT["poisson_ratio"] ** 2)
MASS_EFF = 0.5 * SOFT["density"] * np.pi / 6.0 * DIAMETER**3
HERTZ = 4.0 / 3.0 * MODULUS * np.sqrt(0.25 * DIAMETER)
DURATION_RATIO = 2.9432751838
"""T/Ts of an elastic Hertz contact: twice eta1 of Zhou's Eq. 14."""


def duration(velocity):
    """Hertz: 2 eta1 (25 M^2 / (16 k^2 v))^(1/5) (Eq. 13)."""
    return DURATION_RATIO * (25.0 * MASS_EFF**2 / (16.0 * HERTZ**2 * velocity)) ** 0.2


def overlap_max(velocity):
    """Hertz: (5 M v^2 / (4 k))^(2/5) (Eq. 5)."""
    return (1.25 * MASS_EFF * velocity**2 / HERTZ) ** 0.4


def spring(velocity):
    """(4/5) (5/4 k^4 M v^2)^(1/5) (Eq. 19)."""
    return 0.8 * (1.25 * HERTZ**4 * MASS_EFF * velocity**2) ** 0.2


def half_period(velocity):
    """Contact duration with the spring of a velocity: pi sqrt(M / alpha)."""
    return np.pi * np.sqrt(MASS_EFF / spring(velocity))


def head_on():
    """Two particles that collide elastically; max_overlap lies between that of Eq. 5 and that of the one
    spring."""
    contact_time = duration(REFERENCE)
    reach = 0.5 * (DIAMETER + 4.0 * contact_time * SPEED)
    velocity = [[0.5 * SPEED, 0.0, 0.0], [-0.5 * SPEED, 0.0, 0.0]]
    return build_scene(
        {"spheres": particle_group([[-reach, 0.0, 0.0], [reach, 0.0, 0.0]], DIAMETER, velocity=velocity)},
        pair={"restitution": 1.0},
        numerics={"max_overlap": 1.25 * overlap_max(SPEED) / (0.5 * DIAMETER)},
        run={"duration": 47.0 * contact_time, "time_step": 1e-7},
        output={"interval": 5.0 * contact_time, "timeseries_interval": contact_time / 20.0},
    )


@pytest.fixture(scope="module")
def found(taichi_f64, tmp_path_factory):
    out = tmp_path_factory.mktemp("compare")
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(sys.modules, "matplotlib", None)
        patch.setattr(reporting, "sweeps_of", lambda *_: [])
        return compare(head_on(), ["linear", "hertz"], out), out


@pytest.fixture(scope="module")
def table(found):
    """compare.csv as (quantity, law) -> (value, ratio)."""
    with (found[1] / "compare.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    return {(row["quantity"], row["law"]): (float(row["value"]), float(row["ratio"])) for row in rows}


def test_each_law_has_its_own_automatic_step_overlap_and_duration(table):
    """0.05 of a quarter period, or of half of Hertz's contact time, at the fastest approach. Eq. 19 keeps the
    largest overlap of Eq. 5; the sampling interval is the resolution of contact durations."""
    steps = {
        "linear_onset": half_period(SPEED),
        "linear_reference": half_period(REFERENCE),
        "hertz": duration(SPEED),
    }
    for law, contact_time in steps.items():
        assert table["time step", law][0] == pytest.approx(0.05 * 0.5 * contact_time, rel=1e-8)
    assert table["time step", "linear_reference"][1] == pytest.approx(10.0**0.2, rel=1e-9)
    count = 47.0 * duration(REFERENCE) / table["time step", "hertz"][0]
    assert table["steps needed", "hertz"][0] == pytest.approx(count, abs=1.0)
    resolution = duration(REFERENCE) / 8.0
    for law in ("linear_onset", "hertz"):
        expected = overlap_max(SPEED) / (0.5 * DIAMETER)
        assert table["maximum overlap/radius", law][0] == pytest.approx(expected, rel=0.01)
        assert table["median contact duration", law][0] == pytest.approx(steps[law], abs=resolution)


def test_an_aborted_run_is_a_result(found, table):
    """The one spring overlaps 10^0.2 times as far, beyond the limit, before half of its own contact time is
    over: a spring 10^0.4 times as stiff is required. Two particles form no bed to assess the other spring."""
    comparison, out = found
    (stopped,) = (run for run in comparison.runs if run.stopped)
    assert stopped.variant.key == "linear_reference"
    first_contact = 4.0 * duration(REFERENCE)
    assert first_contact < stopped.time < first_contact + 0.5 * half_period(REFERENCE)
    assert np.isnan(table["end of stage", "linear_reference"][0])
    assert np.isnan(table["steps needed", "linear_reference"][1]), "an aborted run has no ratios"
    one_spring, spring_per_contact = comparison.assessments[-2:]
    assert one_spring.holds and spring_per_contact.holds is None
    (sentence,) = (note for note in notes_on(comparison) if "softer" in note)
    assert "for which Eq. 19 gives a spring 2.5 times as stiff" in sentence
    html = (out / "compare.html").read_text(encoding="utf-8")
    assert "linear of 0.1 m/s was aborted at" in html and "pip install matplotlib" in html
    compile((out / "side_by_side.py").read_text(encoding="utf-8"), "side_by_side.py", "exec")


def test_runs_of_a_stopped_comparison_are_kept(found, tmp_path, monkeypatch):
    """Hertz is interrupted in a second comparison; the third one has the same table, without another run of
    linear."""
    out = shutil.copytree(found[1], tmp_path / "out")
    shutil.rmtree(out / "hertz")
    run_variant = runs.run_variant
    ran = []
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    monkeypatch.setattr(reporting, "sweeps_of", lambda *_: [])

    def interrupted_once(variant, directory, *more):
        ran.append(variant.key)
        if len(ran) > 1:
            return run_variant(variant, directory, *more)
        (directory / "scene_as_run.yaml").write_text(variant.scene.to_yaml())
        raise KeyboardInterrupt

    monkeypatch.setattr(runs, "run_variant", interrupted_once)
    with pytest.raises(KeyboardInterrupt):
        compare(head_on(), ["linear", "hertz"], out)
    compare(head_on(), ["linear", "hertz"], out)
    assert ran == ["hertz", "hertz"]
    for name in ("durations.csv", "heights.csv", "forces.csv"):
        assert (out / name).read_bytes() == (found[1] / name).read_bytes()


def test_variants_use_the_restitution_form_of_their_contact_model():
    """A restitution that falls with velocity by Eq. 12: e(0.1 m/s) = exp(-2 (0.1/9.9)^0.5) = 0.8179. A reduction
    keeps explicit positions."""
    fit = {"sigma": 2.0, "psi": 0.5, "limit_velocity": 10.0}
    region = {"box": {"min": [-0.5] * 3, "max": [0.5] * 3}}
    poured = {
        "material": "glass",
        "count": 90,
        "diameter": 0.01,
        "insert": {"kind": "pack", "region": region},
    }
    scene = build_scene(
        {"listed": particle_group([[0, 0, 0.5]]), "poured": poured}, pair={"restitution": fit}
    )
    given = variants_of(scene, ["zhou", "linear", "thornton"], 0.1, most_particles=31)
    variants = {each.key: each.scene for each in given}
    assert variants["zhou"].pairs["glass-glass"].restitution.sigma == 2.0
    assert {name: each.count for name, each in variants["zhou"].particles.items()} == {
        "listed": 1,
        "poured": 30,
    }
    for key in ("linear_onset", "linear_reference"):
        assert variants[key].pairs["glass-glass"].restitution == pytest.approx(0.8179, rel=1e-4)
    assert variants["thornton"] is None, "there is no yield strength"


@pytest.fixture(scope="module")
def columns(taichi_f64):
    """Collisions of the spring per contact over three decades of velocity."""
    scene = head_on()
    subject = subject_of(scene, REFERENCE)
    variants = [each for each in variants_of(scene, ["linear"], REFERENCE) if each.key == "linear_onset"]
    return sweep_columns(subject, sweeps_of(scene, subject, variants, steps=["fine"]))


def test_springs_collide_as_harmonic_oscillators(columns):
    """Half a period pi sqrt(M/alpha) and a maximum overlap v sqrt(M/alpha), at least 100 steps each. Eq. 19 per
    contact uses at least the spring of a hundredth of the largest impact velocity.

    The one spring deviates by 10^0.2 at ten times its velocity; Eq. 19 per contact by pi / 2.943 at any.
    """
    velocity = columns["velocity"]
    contact_time = half_period(np.maximum(velocity, 0.01 * SPEED))
    np.testing.assert_allclose(columns["duration"], contact_time, rtol=1e-3)
    np.testing.assert_allclose(columns["overlap_max"], velocity * contact_time / np.pi, rtol=1e-3)
    np.testing.assert_allclose(columns["restitution"], 1.0, atol=1e-3)
    np.testing.assert_allclose(columns["duration_exact"], duration(velocity), rtol=1e-9)
    np.testing.assert_allclose(columns["overlap_max_exact"], overlap_max(velocity), rtol=1e-9)
    one_spring = columns | {
        "law": np.full(len(velocity), "linear_reference"),
        "duration": half_period(REFERENCE) + 0.0 * velocity,
        "overlap_max": velocity * half_period(REFERENCE) / np.pi,
    }
    both = {name: np.concatenate([columns[name], one_spring[name]]) for name in columns}
    wrong, corrected, unstable = assess_collisions(both)
    assert wrong.holds and f"+{100.0 * (10.0**0.2 - 1.0):.1f} %" in wrong.why
    assert corrected.holds and f"+{100.0 * (np.pi / DURATION_RATIO - 1.0):.1f} %" in corrected.why
    assert unstable.holds is None


def test_figures_are_written(found, columns, tmp_path):
    pytest.importorskip("matplotlib")
    subject = subject_of(head_on(), REFERENCE)
    collisions = Drawing(lambda figure: draw_collisions(figure, subject, columns, []), 5.0)
    drawn = drawings(found[0].runs, None, {}) | {"collisions.png": collisions}
    assert not write_figures(tmp_path, drawn)
    assert {path.name for path in tmp_path.iterdir()} == set(drawn) and len(drawn) == 4


def snapshot(particles, contacts):
    return Snapshot(0.5, 0, "run", particles, contacts, {}, {})


def test_forces_of_an_exponential_distribution():
    """P = exp(-f/<f>): in a class from a to b the density is (exp(-a) - exp(-b)) / (b - a)."""
    force = np.random.default_rng(2).exponential(5.0, 200_000)
    forces = ForceHistogram()
    forces.update(snapshot({}, {"id_j": np.ones(len(force)), "normal_force": force}))
    low, high = FORCE_EDGES[:-2], FORCE_EDGES[1:-1]
    expected = (np.exp(-low) - np.exp(-high)) / (high - low)
    sigma = np.sqrt(expected / (len(force) * (high - low)))
    assert np.all(np.abs(forces.density("run") - expected) < 5.0 * sigma)
    assert forces.share_above("run", 2.0) == pytest.approx(np.exp(-2.0), rel=0.02)


def test_heights_are_opposite_to_gravity():
    particles = {
        "position": np.array([[1.0, 9.0, 9.0], [3.0, 0.0, 0.0]]), "mass": np.array([3.0, 1.0]),
        "radius": np.array([0.5, 0.5]), "velocity": np.array([[3.0, 4.0, 0.0]] * 2),
    }  # fmt: skip
    heights = BedHeights.of(SimpleNamespace(usual_gravity=(-2.0, 0.0, 0.0)))
    heights.update(snapshot(particles, {}))
    assert heights.rows == [(0.5, 1.5, pytest.approx(1.5 + 0.95 * 2.0))]
    assert heights.typical_speed == 5.0


@pytest.mark.parametrize(("first", "other", "conclusion"), [
    ([1.0, 1.01, 0.99], [2.0, 2.02, 1.98], "larger"), ([2.0, 2.02, 1.98], [1.0, 1.01, 0.99], "smaller"),
    ([1.0, 1.2, 0.8], [1.02, 1.2, 0.85], "not distinguishable"), ([1.0, 1.0], [1.0, 1.0], "equal"),
    ([1.0, 1.0], [1.1, 1.1], "larger"), ([-2.0, -2.1], [-1.0, -1.1], "larger"),
])  # fmt: skip
def test_conclusions(first, other, conclusion):
    found = difference_of("x", "", ("a", "b"), Estimate.of(first), Estimate.of(other))
    assert found.conclusion == conclusion
    assert difference_of("x", "", ("a", "b"), Estimate.of(first[:1]), Estimate.of(other[:1])) is None


def falling():
    """Twelve particles at random places fall onto a plate, through a flow meter."""
    region = {"box": {"min": [-0.05, -0.05, 0.02], "max": [0.05, 0.05, 0.06]}}
    group = {"material": "glass", "count": 12, "diameter": 0.01, "insert": {"kind": "pack", "region": region}}
    return build_scene(
        {"beads": group}, walls={"floor": plane([0, 0, 0], [0, 0, 1])}, gravity=[0, 0, -9.81],
        pair={"restitution": 0.5}, run={"duration": 0.12},
        output={"timeseries_interval": 0.002, "interval": 0.02,
                "flow_meters": {"below": {"point": [0, 0, 0.03], "normal": [0, 0, -1]}}},
    )  # fmt: skip


def rows(path):
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def test_comparison_with_seeds_has_intervals_of_its_runs(taichi_f64, monkeypatch, tmp_path):
    """Each interval is Welch's of the values in seeds.csv; the values of the summary are their means."""
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    monkeypatch.setattr(reporting, "sweeps_of", lambda *_: [])
    compare(falling(), ["hertz", "zhou"], tmp_path, seeds=2)
    seeds = rows(tmp_path / "seeds.csv")
    summary = {(row["quantity"], row["law"]): float(row["value"]) for row in rows(tmp_path / "compare.csv")}
    differences = rows(tmp_path / "differences.csv")
    assert {"center of mass", "surface"} <= {row["quantity"] for row in differences}
    samples = {}
    for each in seeds:
        if each["value"] != "nan":
            samples.setdefault((each["quantity"], each["law"]), []).append(float(each["value"]))
    for row in differences:
        hertz, zhou = (samples[row["quantity"], law] for law in ("hertz", "zhou"))
        assert summary[row["quantity"], "zhou"] == pytest.approx(np.mean(zhou), rel=1e-12)
        if np.ptp(hertz) > 0.0 or np.ptp(zhou) > 0.0:
            interval = stats.ttest_ind(zhou, hertz, equal_var=False).confidence_interval()
            assert (float(row["low"]), float(row["high"])) == pytest.approx(tuple(interval), rel=1e-9)
    heights = samples["center of mass", "hertz"] + samples["center of mass", "zhou"]
    assert len(set(heights)) == 4, "each seed is another packing"
