"""`granflow compare` on two particles with one aborted run: tables against closed forms, page, error
messages."""

import csv
import re
import shutil
import sys

import numpy as np
import pytest
from scene_builders import SOFT, build_scene, particle_group, plane

from granflow.errors import GranflowError
from granflow.studies.compare import report as reporting
from granflow.studies.compare import runs
from granflow.studies.compare.report import compare, notes_on
from granflow.studies.compare.runs import law_names, variants_of

DIAMETER, SPEED = 0.01, 1.0
REFERENCE = 0.1 * SPEED
MODULUS = 0.5 * SOFT["young_modulus"] / (1.0 - SOFT["poisson_ratio"] ** 2)
RADIUS_EFF = 0.25 * DIAMETER
MASS_EFF = 0.5 * SOFT["density"] * np.pi / 6.0 * DIAMETER**3
HERTZ = 4.0 / 3.0 * MODULUS * np.sqrt(RADIUS_EFF)
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


def test_each_law_has_its_own_automatic_step(table):
    """0.05 of a quarter period pi/2 sqrt(M/alpha), or of half of Hertz's contact time, at the fastest
    approach."""
    quarter = {
        name: 0.5 * np.pi * np.sqrt(MASS_EFF / spring(v))
        for name, v in (("onset", SPEED), ("ref", REFERENCE))
    }
    assert table["time step", "linear_onset"][0] == pytest.approx(0.05 * quarter["onset"], rel=1e-9)
    assert table["time step", "linear_reference"][0] == pytest.approx(0.05 * quarter["ref"], rel=1e-9)
    assert table["time step", "linear_reference"][1] == pytest.approx(10.0**0.2, rel=1e-9)
    assert table["time step", "hertz"][0] == pytest.approx(0.05 * 0.5 * duration(SPEED), rel=1e-8)
    steps = 47.0 * duration(REFERENCE) / table["time step", "hertz"][0]
    assert table["steps needed", "hertz"][0] == pytest.approx(steps, abs=1.0)


@pytest.mark.parametrize("law", ["linear_onset", "hertz"])
def test_overlap_and_contact_duration_match_theory(table, law):
    """Eq. 19 keeps the largest overlap of Eq. 5; the sampling interval is the resolution of contact
    durations."""
    expected = overlap_max(SPEED) / (0.5 * DIAMETER)
    assert table["maximum overlap/radius", law][0] == pytest.approx(expected, rel=0.01)
    contact_duration = duration(SPEED) if law == "hertz" else np.pi * np.sqrt(MASS_EFF / spring(SPEED))
    assert table["median contact duration", law][0] == pytest.approx(
        contact_duration, abs=duration(REFERENCE) / 8.0
    )


def test_an_aborted_run_is_a_result(found, table):
    """The one spring overlaps 10^0.2 times as far, beyond the limit, before half of its own contact time is
    over."""
    comparison, out = found
    stopped = {run.variant.key: run for run in comparison.runs if run.stopped}
    assert list(stopped) == ["linear_reference"]
    first_contact = 4.0 * duration(REFERENCE)
    assert (
        first_contact
        < stopped["linear_reference"].time
        < first_contact + 0.5 * np.pi * np.sqrt(MASS_EFF / spring(REFERENCE))
    )
    assert "more than numerics.max_overlap" in stopped["linear_reference"].stopped
    assert np.isnan(table["end of stage", "linear_reference"][0])
    assert np.isnan(table["steps needed", "linear_reference"][1]), "an aborted run has no ratios"
    assert table["steps needed", "hertz"][1] > 0.0
    assert "linear of 0.1 m/s was aborted at" in (out / "compare.html").read_text(encoding="utf-8")


def test_the_springs_are_assessed_in_the_scene(found):
    """One spring fails if its run aborts; two particles form no bed for the assessment of the other."""
    one_spring, spring_per_contact = found[0].assessments[-2:]
    assert one_spring.holds and re.match(
        r"The run was aborted at 0.0\d+ s: particle \d .* overlaps with", one_spring.why
    )
    assert spring_per_contact.holds is None and "too few contacts" in spring_per_contact.why


def test_a_spring_below_the_impact_velocity_is_reported(found):
    """The particles collide at ten times the reference velocity: a spring 10^0.4 times as stiff is
    required."""
    (sentence,) = (note for note in notes_on(found[0]) if "softer" in note)
    assert sentence.startswith(
        "linear of 0.1 m/s is softer than the impacts of this scene require: the largest overlap"
    )
    velocity = re.search(
        r"an impact at (\S+) m/s, for which Eq. 19 gives a spring 2.5 times as stiff", sentence
    )[1]
    assert float(velocity) == pytest.approx(SPEED, rel=0.03), (
        "rows of the time series miss the largest overlap"
    )
    assert "--reference-velocity" in sentence and "run.velocity_max" in sentence
    assert sentence.partition(":")[0] in (found[1] / "compare.html").read_text(encoding="utf-8")


def test_page_without_figures_is_self_contained_and_gives_the_reason(found):
    comparison, out = found
    html = (out / "compare.html").read_text(encoding="utf-8")
    ratio = "linear\nof 0.1 m/s\nover linear\nper contact"
    for text in ("Side by side", "linear per contact", "linear of 0.1 m/s", ratio, "pip install matplotlib"):
        assert text in html
    assert not re.findall(r'(?:src|href)="(?:http|//)', html)
    assert {path.name for path in out.glob("*.csv")} == {
        "compare.csv", "heights.csv", "forces.csv", "durations.csv"
    }  # fmt: skip
    script = (out / "side_by_side.py").read_text(encoding="utf-8")
    compile(script, "side_by_side.py", "exec")
    for run in comparison.runs:
        assert (out / run.variant.key / "particles.pvd").exists() and repr(run.variant.key) in script


def test_matplotlib_figures_are_written(found, tmp_path):
    pytest.importorskip("matplotlib")
    from granflow.studies.compare.report import drawings
    from granflow.studies.figures import write_figures

    assert not write_figures(tmp_path, drawings(found[0].runs, None, {}))
    assert {path.name for path in tmp_path.iterdir()} == {"course.png", "energies.png", "contacts.png"}


@pytest.mark.parametrize(("given", "sentence"), [
    ("zhou,hertzz", "Unknown contact model hertzz. Did you mean hertz?"),
    ("zhou,xyz", "Unknown contact model xyz. The contact models are zhou, hertz, linear"),
    ("zhou, zhou", "The contact model zhou is repeated: give each once."), (",", "--laws is empty")
])  # fmt: skip
def test_invalid_lists_of_contact_models_raise_one_sentence(given, sentence):
    with pytest.raises(GranflowError, match=re.escape(sentence)):
        law_names(given)


def test_runs_of_a_stopped_comparison_are_kept(found, tmp_path, monkeypatch):
    """Hertz is interrupted in a second comparison; the third one has the same table, without another run of
    linear."""
    out = shutil.copytree(found[1], tmp_path / "out")
    (out / "hertz" / runs.RECORD).unlink()
    shutil.rmtree(out / "hertz")
    run_variant = runs.run_variant
    lines = []
    ran = []
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    monkeypatch.setattr(reporting, "sweeps_of", lambda *_: [])

    def interrupted(*arguments):
        ran.append(arguments[0].key)
        (arguments[1] / "scene_as_run.yaml").write_text(arguments[0].scene.to_yaml())
        (arguments[1] / "result.json").write_text("{}")
        raise KeyboardInterrupt

    monkeypatch.setattr(runs, "run_variant", interrupted)
    with pytest.raises(KeyboardInterrupt):
        compare(head_on(), ["linear", "hertz"], out, report=lines.append, prepare=refuse)
    assert lines == [
        "run 1 of 3: linear per contact, kept", "run 2 of 3: linear of 0.1 m/s, kept", "run 3 of 3: hertz"
    ]  # fmt: skip
    monkeypatch.setattr(
        runs, "run_variant", lambda *arguments: ran.append(arguments[0].key) or run_variant(*arguments)
    )
    compare(head_on(), ["linear", "hertz"], out, prepare=refuse)
    assert ran == ["hertz", "hertz"]

    def rows(folder):
        with (folder / "compare.csv").open(newline="") as file:
            return [
                row
                for row in csv.DictReader(file)
                if "wall" not in row["quantity"] and row["quantity"] != "compilation"
            ]

    assert rows(out) == rows(found[1])
    for name in ("durations.csv", "heights.csv", "forces.csv"):
        assert (out / name).read_bytes() == (found[1] / name).read_bytes()
    (out / "hertz" / "timeseries.csv").write_text("time [s]\n0\n")
    with pytest.raises(GranflowError, match="other results in hertz"):
        compare(head_on(), ["linear", "hertz"], out, prepare=refuse)


def refuse(directory):
    if directory.exists():
        raise GranflowError(f"other results in {directory.name}")


def fitted(**materials):
    """A scene whose restitution falls with velocity by Eq. 12, e(0.1 m/s) = exp(-2 (0.1/9.9)^0.5) =
    0.8179."""
    fit = {"sigma": 2.0, "psi": 0.5, "limit_velocity": 10.0}
    floor = plane([0, 0, 0], [0, 0, 1], stages=["fill"])
    return build_scene(
        {"listed": particle_group([[0, 0, 0.5]]), "poured": {**particle_group([[0, 0, 0]]), "count": 90,
         "insert": {"kind": "pack", "region": {"box": {"min": [-0.5] * 3, "max": [0.5] * 3}}}}},
        walls={"floor": floor}, pair={"restitution": fit}, materials=materials, run={}, stages=[
            {"name": "fill", "duration": 0.1}, {"name": "open", "duration": 0.1}],
    )  # fmt: skip


def test_variants_use_the_restitution_form_of_their_contact_model():
    variants = {each.key: each for each in variants_of(fitted(), ["zhou", "linear", "thornton"], 0.1)}
    assert variants["zhou"].scene.pairs["glass-glass"].restitution.sigma == 2.0
    expected = np.exp(-2.0 * np.sqrt(0.1 / 9.9))
    for key in ("linear_onset", "linear_reference"):
        assert variants[key].scene.pairs["glass-glass"].restitution == pytest.approx(expected, rel=1e-12)
    assert variants["linear_reference"].normal["stiffness"] == {"reference_velocity": 0.1}
    assert variants["thornton"].scene is None and "yield strength" in variants["thornton"].refused
    hard = fitted(glass=SOFT | {"yield_strength": 1e8})
    (thornton,) = variants_of(hard, ["thornton"], 0.1)
    assert thornton.scene.pairs["glass-glass"].restitution is None


def test_reduction_keeps_explicit_positions():
    (one,) = variants_of(fitted(), ["hertz"], 0.1, most_particles=31)
    assert {name: group.count for name, group in one.scene.particles.items()} == {"listed": 1, "poured": 30}
    (whole,) = variants_of(fitted(), ["hertz"], 0.1)
    assert whole.scene.particles["poured"].count == 90
    assert whole.scene.output.energy_budget and whole.scene.run.time_step == "auto"
