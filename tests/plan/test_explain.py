"""`granflow explain` lists each derived value with its source."""

from dataclasses import fields
from pathlib import Path

import pytest
from geometry.meshes import sheet, write
from plan.scenes import scene_of
from subprocess_runner import each_in_subprocess

from granflow.load import load_scene
from granflow.plan.build import plan_for
from granflow.plan.cost import estimate_memory, typical_rate
from granflow.plan.explain import WIDTH, duration, explain, feature_label, size
from granflow.plan.features import Features


@pytest.fixture(scope="module")
def plan(tmp_path_factory):
    return plan_for(
        scene_of(tmp_path_factory.mktemp("explain"), "numerics.skin=0.5 mm", "run.time_step=4.5e-5")
    )


@pytest.fixture(scope="module")
def rows(plan):
    """Lines of the explanation by their first column."""
    lines = explain(plan).splitlines()
    return {line.strip().split("  ")[0]: line for line in lines}


def test_lines_fit_a_terminal(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    text = explain(plan_for(scene_of(Path(), "run.time_step=4.5e-5", "pairs.glass-glass.friction=0.5")))
    assert max(map(len, text.splitlines())) <= WIDTH


ONLY_IF_ON = (
    "changing_gravity",
    "deforming_box",
    "flows",
    "loss_heat",
    "sources",
    "viscous_cohesion",
    "wall_groups",
    "wear",
)

LISTED = [
    *("friction", "rolling", "twisting", "cohesion"),
    *(item.name for item in fields(Features) if item.name not in ONLY_IF_ON),
]


def test_each_feature_is_listed(rows):
    for feature in map(feature_label, LISTED):
        assert rows[feature].split()[len(feature.split())] in ("on", "off"), feature


def test_each_derived_number_is_listed(plan, rows):
    step = plan.step
    assert f"{step.value:.4g} s" in rows["time step"] and "given in the scene" in rows["time step"]
    assert (
        f"{step.stable_below:.4g} s" in rows["stability limit"] and "beads-beads" in rows["stability limit"]
    )
    assert "0.0001705 s" in rows["Rayleigh time"]
    assert "1 m/s" in rows["impact velocity"] and "run.velocity_max" in rows["impact velocity"]
    assert f"{step.least_restitution:.3g}" in rows["smallest restitution"]
    assert "0.0005 m" in rows["skin"]
    assert "0.002 m" in rows["radius"]
    assert "glass; not used: steel" in rows["materials"]
    assert "1 112" in rows["steps"]  # 50 ms / 45 us
    assert "0.05 s" in rows["simulated time"]
    assert "about 1 s" in rows["run time"] and "5 million particle-steps per second" in rows["run time"]
    memory = estimate_memory(plan, "f64")
    assert (
        size(memory.per_neighbor) in rows["one contact"]
        and "maximum overlap, restitution coefficient, recovered fraction" in rows["one contact"]
    )
    assert size(memory.total) in rows["total"]


def test_settings_show_default_and_given_values_with_their_source(rows):
    assert rows["numerics.chunk_size"].split()[1:] == ["auto", "default"]
    assert (
        "preset stainless_316" in rows["materials.steel.density"]
        and "8030 kg/m3" in rows["materials.steel.density"]
    )
    assert "the restitution of every pair is a number" in rows["contact.normal.restitution_at"]
    assert "default: output.interval" in rows["output.timeseries_interval"]
    assert "given (--set numerics.skin" in rows["numerics.skin"]
    assert "materials.glass.density" not in rows, "required settings are not listed"


def test_simulated_time_of_stages_is_an_upper_bound(tmp_path):
    stages = "[{name: fill, duration: 1 s}, {name: rest, kinetic_energy_below: 1 nJ, max_duration: 2 s}]"
    text = explain(plan_for(scene_of(tmp_path, f"stages={stages}", "run.duration=null")))
    assert "at most 3 s" in text and "fill 1 s, rest at most 2 s" in text


def allocated(directory, overrides, precision):
    """Bytes of all fields of a State that scale with the scene, and the estimate of the plan."""
    import numpy as np

    from granflow.engine.state import State
    from granflow.engine.state_cache import start
    from granflow.plan.arrays import sum_arrays

    plan = plan_for(scene_of(Path(directory), *overrides))
    state = State(plan, start("cpu", precision, 1))
    fields = [
        field
        for group in (state.particles, state.neighbors, state.cell_sort)
        for field in vars(group).values()
    ]
    fields += [*state.neighbors.history.values(), *state.neighbors.saved.values()]
    fields += [getattr(state.control, array.name) for array in sum_arrays(plan)]
    arrays = [np.asarray(field.to_numpy()) for field in fields if hasattr(field, "to_numpy")]
    return sum(array.nbytes for array in arrays), estimate_memory(plan, precision).total


MANY = ("particles.beads.count=3000", "particles.beads.diameter=0.5 mm")
FRICTION = ("pairs.glass-glass.friction=0.4",)


def test_memory_estimate_equals_the_allocated_memory(tmp_path):
    """One process for all precisions, each of which restarts Taichi."""
    cases = ((MANY, "f64"), (MANY + FRICTION, "mixed"), ((*MANY, "contact.normal=hertz"), "f32"))
    for allocated_bytes, estimate in each_in_subprocess(
        allocated, [(str(tmp_path), *each) for each in cases]
    ):
        assert estimate == allocated_bytes


@pytest.mark.parametrize(
    ("seconds", "text"),
    [(0.2, "1 s"), (59, "59 s"), (600, "10 minutes"), (7.3e3, "2 hours"), (1e6, "12 days")],
)
def test_duration_is_rounded_to_a_readable_unit(seconds, text):
    assert duration(seconds) == text


def test_conducting_materials_without_their_real_modulus_are_listed():
    """heat_bed gives true_young_modulus, heat_conduction does not."""
    folder = Path(__file__).parents[2] / "scenes/verification"
    found = [plan_for(load_scene(folder / f"{name}.yaml")) for name in ("heat_conduction", "heat_bed")]
    first, second = ([each for each in plan.forecasts if "areas" in each.name] for plan in found)
    assert [each.value for each in first] == ["of 10 MPa"] and first[0].warning is None and not second


RODS = (
    "particles.beads={material: glass, count: 10, clump: {spheres: [{position: [0, 0, 0], radius: 1 mm}, "
    "{position: [1 mm, 0, 0], radius: 1 mm}]}, insert: {kind: lattice, region: {box: {min: [0, 0, 0], max: "
    "[2 cm, 2 cm, 2 cm]}}}}"
)


@pytest.mark.parametrize(("change", "factor", "cause"), [
    ("title=Beads", 1.0, None),
    (RODS, 3.5, "clumps"),
    ("contact.cohesion=jkr, pairs.glass-glass.work_of_adhesion=0.1, pairs.glass-steel.work_of_adhesion=0", 4.5, "cohesion jkr"),
    ("walls.floor={shape: mesh, file: floor.stl, material: glass}", 1.0 + 0.3 * 4.0 / 2.0, "triangles of meshes"),
])  # fmt: skip
def test_typical_rate_depends_on_the_features_that_cost_most(tmp_path, change, factor, cause):
    """The floor has legs of 2 mm, half of the diameter of the particles."""
    points, corners = sheet(20, size=0.04)
    write(tmp_path / "floor.stl", points, corners)
    changes = change.split(", ") if change.startswith("contact") else [change]
    plan = plan_for(scene_of(tmp_path, *changes))
    rate, causes = typical_rate(plan)
    assert rate == pytest.approx(5e6 / factor, rel=1e-3) and causes == ((cause,) if cause else ())
    assert (cause or "on a CPU") in explain(plan)
