"""Shipped scenes satisfy their `expect:` blocks, large ones in a reduced form; sweeps and calibrations are valid."""

import pickle

import numpy as np
import pytest
from scene_runner import SCENES, run_shipped_scene

from granflow import Scene, load_scene
from granflow.cli.run import scene_paths
from granflow.plan.build import plan_for
from granflow.plan.restitution import restitution_warnings
from granflow.studies.calibration.calibrate import estimate_trials, read_calibration
from granflow.studies.checked_run import CheckedRun, RunSettings
from granflow.studies.sweep import checked_points, read_sweep
from granflow.studies.yield_locus import ShearTest, YieldLocusEvaluation, shear_point

QUICK = ("through_flow",)
"""Verification scene whose subject no faster test has; the others are slow tests."""
OTHERS = sorted({path.stem for path in (SCENES / "verification").glob("*.yaml")} - set(QUICK))
LARGE = (
    *("hopper", "vibrated_bed", "drum", "flat_silo", "column_collapse", "impact", "clumps", "mixer"),
    *(f"dosta2024/{name}" for name in ("silo_large_orifice", "silo_small_orifice", "drum", "penetration")),
    *("angle_of_repose", "sheared_layer", "triaxial"),
)
HOPPER = (
    *("particles.beads.count=300", "numerics.max_overlap=0.2", "numerics.time_step_fraction=0.1"),
    *("materials.glass.young_modulus=10 MPa", "materials.acrylic.young_modulus=10 MPa"),
    *("stages.0.duration=0.2 s", "stages.1.max_duration=0.1 s", "stages.2.duration=0.3 s"),
    "expect=[{quantity: flow_count.outlet, between: [297, 300]}, {quantity: energy_error, between: [-2e-3, 2e-3]}]",
)
"""The outlet is as wide as the bed is high, so the flow is not steady and Beverloo's law does not apply: nearly all
particles flow out. A sphere without rolling friction that rolls around the funnel does not descend: its path oscillates
in height, as in a vertical cylinder. With other seeds, one or two of 300 particles are
still in the funnel after 0.3 s, also without rest damping (6 of 12 seeds)."""


SHEAR_CELL = ("stages.0.duration=0.05 s", "stages.1.duration=0.02 s")


@pytest.mark.parametrize(
    ("name", "overrides"),
    [*((f"verification/{name}", ()) for name in QUICK), ("hopper", HOPPER), ("shear_cell", SHEAR_CELL)],
)
def test_quick_and_reduced_scenes_satisfy_their_expectations(name, overrides, tmp_path, taichi_f64):
    assert run_shipped_scene(name, tmp_path, overrides=overrides)[1] == []


@pytest.mark.slow
@pytest.mark.timeout(1500)
@pytest.mark.parametrize("name", ["two_spheres", *(f"verification/{name}" for name in OTHERS), *LARGE])
def test_large_and_other_scenes_satisfy_their_expectations(name, tmp_path, taichi_f64):
    assert run_shipped_scene(name, tmp_path)[1] == []


@pytest.mark.parametrize("path", scene_paths().values(), ids=lambda path: path.stem)
def test_shipped_scene_is_complete_without_warnings_and_equal_after_saving(path, tmp_path):
    """Verification scenes may have coarse steps, whose restitution differs."""
    scene = load_scene(path)
    plan = plan_for(scene)
    assert scene.description and scene.expect
    assert not [each.warning for each in plan.forecasts if each.warning]
    assert path.parent.name == "verification" or not restitution_warnings(plan)
    parts = {name: value for name in type(scene).model_fields if (value := getattr(scene, name)) is not None}
    assert Scene(folder=path.parent, **parts) == scene == Scene.from_dict(scene.to_dict(), scene.folder)
    again = pickle.loads(pickle.dumps(scene))
    assert again == scene and (again.folder, again.path) == (scene.folder, scene.path)
    for _, name in scene.input_names():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_bytes((path.parent / name).read_bytes())
    assert load_scene(scene.save(tmp_path / "again.yaml")) == scene


@pytest.mark.slow
def test_cohesionless_preshear_of_the_shear_tester_has_the_friction_of_spheres(tmp_path, taichi_f64):
    """Spheres with a friction of 0.5, without rolling friction and cohesion: shear over normal stress of steady
    flow within 2 degrees of mu(I) of glass beads (Jop, Forterre & Pouliquen 2006), tan 20.9 deg for slow flow.
    """
    settings = (
        "pairs={powder-powder: {restitution: 0.5, friction: 0.5}}",
        "contact={normal: hertz, tangential: mindlin, rolling: none}",
    )
    assert run_shipped_scene("shear_tester", tmp_path, overrides=settings)[1] == []
    evaluation = YieldLocusEvaluation.model_validate({"wall": "lid", "parameters": {"shear": "none"}})
    normal, shear = shear_point(evaluation, ShearTest({}, 1, tmp_path, {})).preshear
    assert normal == pytest.approx(5000.0, rel=0.01)
    low, high = np.tan(np.radians([18.9, 22.9]))
    assert low < shear / normal < high


SWEEPS, CALIBRATIONS = (sorted((SCENES / folder).glob("*.yaml")) for folder in ("sweeps", "calibration"))


@pytest.mark.parametrize("path", SWEEPS, ids=lambda path: path.stem)
def test_all_points_of_a_shipped_sweep_are_valid(path, tmp_path):
    points = checked_points(read_sweep(path), RunSettings(tmp_path, 1, "cpu", tmp_path / "stop"))
    assert all(isinstance(run, CheckedRun) for _, runs in points for run in runs)


@pytest.mark.parametrize("path", CALIBRATIONS, ids=lambda path: path.stem)
def test_bounds_of_a_shipped_calibration_are_valid(path, tmp_path):
    study = read_calibration(path)
    assert estimate_trials(study, tmp_path / "out").scenes.keys() == study.scenes.keys()
