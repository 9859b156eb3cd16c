"""Feature costs: features, start state and memory of every variant."""

from dataclasses import asdict
from pathlib import Path

import pytest
from benchmark import features
from benchmark.features import variants_of

from granflow.errors import SceneError
from granflow.load import load_scene
from granflow.plan.build import plan_for

TEXT = """\
title: Beads on a floor
gravity: [0, 0, -9.81]
materials:
  glass: {young_modulus: 10 MPa, poisson_ratio: 0.23, density: 2500}
  steel: {young_modulus: 10 MPa, poisson_ratio: 0.3, density: 7850}
pairs:
  glass-glass: {restitution: 0.7, friction: 0.4, rolling_friction: 0.02}
  glass-steel: {restitution: 0.7, friction: 0.4, rolling_friction: 0.02}
  steel-steel: {restitution: 0.7, friction: 0.4, rolling_friction: 0.02}
contact: {normal: zhou, tangential: mindlin, rolling: epsd}
walls:
  floor: {shape: plane, point: [0, 0, 0], normal: [0, 0, 1], material: steel}
particles:
  beads: {material: glass, count: 60, diameter: 4 mm,
    insert: {kind: lattice, region: {box: {min: [0, 0, 0], max: [2 cm, 2 cm, 2 cm]}}}}
domain: {min: [-1 cm, -1 cm, -1 cm], max: [3 cm, 3 cm, 3 cm], on_exit: error}
run: {duration: 30 ms, velocity_max: 1 m/s}
output: {interval: 10 ms, energy_budget: true}
"""


def plans(directory, *overrides):
    """Plans of all variants by name."""
    path = directory / "beads.yaml"
    path.write_text(TEXT)
    scene = load_scene(path, overrides)
    base = plan_for(scene)
    return {variant.name: variant.plan(base, on_gpu=False) for variant in variants_of(scene, base)}


@pytest.mark.parametrize(("name", "saved", "changed"), [
    ("without friction", {"rotation": True, "rolling": "epsd"}, {"friction": False}),
    ("without rolling friction", {"rotation": True, "friction": True}, {"rolling": "none"}),
    ("without rotation", {"walls": True}, {"rotation": False, "friction": False, "rolling": "none"}),
    ("without walls", {"friction": True}, {"walls": False}),
    ("without energy budget", {"friction": True}, {"energy_budget": False}),
    ("with several materials", {"friction": True}, {"one_material": False}),
    ("with several sizes", {"one_material": True}, {"one_size": False}),
    ("with moving walls", {"walls": True}, {"moving_walls": True}),
    ("without any history", {"rotation": True}, {"friction": False, "rolling": "none"}),
    ("without all of these", {"one_material": True},
     {
         "friction": False, "rotation": False, "walls": False, "energy_budget": False,
         "rate_dependent": False
     })
])  # fmt: skip
def test_a_variant_changes_its_feature_only(tmp_path, name, saved, changed):
    found = plans(tmp_path)
    baseline = switches(found["baseline"])
    other = switches(found[name])
    for feature, value in saved.items():
        assert other[feature] == baseline[feature] == value, feature
    for feature, value in changed.items():
        assert other[feature] == value, feature
        if name != "without all of these" or feature != "rate_dependent":
            assert baseline[feature] != value, feature


def switches(plan):
    """Features and contact models of a plan by name."""
    return asdict(plan.features) | plan.laws.names | {"friction": plan.laws.has_tangential}


def test_clumps_are_refused_before_the_run():
    scene = load_scene(Path(__file__).parents[2] / "scenes" / "clumps.yaml")
    with pytest.raises(SceneError, match=r"clumps\.yaml:\d+:\d+: .* cannot be measured with clumps"):
        features.feature_costs(scene)
