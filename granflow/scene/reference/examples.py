"""Example of each key of a scene: the one of its description, a value in a shipped scene, or one of its type."""

import re
from collections import Counter
from collections.abc import Iterator
from functools import cache
from typing import Any

from ruamel.yaml import YAML

from granflow.io.shipped_files import example_paths
from granflow.scene.reference.schema_keys import ROOT, Key, alternatives, as_yaml, dimension_of, parts, referenced

NO_SCENES = ("sweeps/", "calibration/")
"""Folders of shipped files that are not scenes."""
LONGEST = 72
"""Characters of the longest example from a scene."""
TEXTS = {
    "description": "8000 glass beads discharge through the outlet.",
    "file": "parts/drum.stl",
    "start_from": "../out/hopper",
    "quantity": "mass_flow.outlet",
    "name": "settle",
    "materials": "glass",
    "groups": "red",
    "stages": "settle",
}
"""Examples of text by key."""
VECTORS = {
    "min": "[0, 0, 0]",
    "max": "[40 mm, 40 mm, 80 mm]",
    "sides": "[[40 mm, 0, 0], [0, 20 mm, 0]]",
    **dict.fromkeys(("point", "center", "corner", "translate"), "[0, 0, 10 mm]"),
    **dict.fromkeys(("normal", "axis", "direction"), "[0, 0, 1]"),
}
"""Examples of lists of numbers by key."""
EXAMPLES = {
    "expect": "[{quantity: particle_count, equals: 8000, tolerance: 0}]",
    "phase": "90 deg",
    "motion": "{kind: vibration, direction: [0, 0, 1], amplitude: 1 mm, frequency: 25 Hz}",
    "until": "{quantity: wall_pressure.lid, above: 100 kPa}",
    "domain": "{min: [0, 0, 0], max: [40 mm, 40 mm, 80 mm], on_exit: error}",
}
"""Examples by key where the shipped scenes have special values or none."""
PART_EXAMPLES = {
    "scene.start_from": "out/hopper",
    "scene.title": "Conical hopper",
    "scene.damping": "{drag: 5 1/s, stages: [settle]}",
    "Material.restitution_fit": "[3.0, 0.5]",
    "MaterialPair.twisting_friction": "20 um",
    "MaterialPair.rolling_dissipation": "0.1 ms",
    "MaterialPair.rolling_damping": "0.3",
    "MaterialPair.hamaker_constant": "6.5e-20",
    "MaterialPair.separation": "1.65e-10",
    "RestitutionFit.sigma": "3.0",
    "RestitutionFit.limit_velocity": "100 m/s",
    "Damping.drag": "5 1/s",
    "Group.mass": "20 g",
    "Group.clump": "{spheres: [{position: [0, 0, 0], radius: 2 mm}, {position: [3 mm, 0, 0], radius: 2 mm}]}",
    "Clump.spheres": "[{position: [0, 0, 0], radius: 2 mm}, {position: [3 mm, 0, 0], radius: 2 mm}]",
    "Group.radius": "2 mm",
    "Group.velocity": "[0, 0, -0.5 m/s]",
    "Group.angular_velocity": "[0, 6, 0]",
    "Group.liquid_content": "1 %",
    "Group.thermal": "{velocity_rms: 0.1 m/s}",
    "Stage.min_duration": "50 ms",
    "RunSettings.time_step": "2 us",
    "Output.fields": "{bed: {cell: 5 mm, quantities: [solid_fraction, velocity]}}",
    "ThorntonNormal.yield_ratio": "0.02",
    "KuwabaraKonoNormal.reference_velocity": "1 m/s",
    "Vibration.amplitude": "1 mm",
    "Vibration.frequency": "25 Hz",
    "Vibration.angular_frequency": "157 rad/s",
    "Translation.velocity": "[0, 0, -20 mm/s]",
    "Translation.initial_velocity": "[0, 0, 0]",
    "Translation.ramp_duration": "50 ms",
    "Rotation.ramp_duration": "0.5 s",
    "Rotation.initial_angular_velocity": "0",
    "SurfaceVelocity.velocity": "[0.5 m/s, 0, 0]",
    "SurfaceVelocity.initial_velocity": "[0, 0, 0]",
    "SurfaceVelocity.ramp_duration": "0.2 s",
    "TableMotion.file": "motion.csv",
    "TableMotion.times": "[0, 0.5 s, 1 s]",
    "TableMotion.displacements": "[0, 4 mm, 0]",
    "TableMotion.velocities": "[0, 20 mm/s, 0]",
    "TableMotion.angles": "[0, 30 deg, 0]",
    "TableMotion.angular_velocities": "[0, 30 rpm, 0]",
    "Servo.direction": "[0, 0, -1]",
    "Servo.pressure": "50 kPa",
    "Servo.velocity_max": "0.1 m/s",
    "FreeWall.direction": "[0, 0, -1]",
    "LogNormalSizes.min": "1 mm",
    "LogNormalSizes.max": "4 mm",
    "LogNormalSizes.median": "2 mm",
    "LogNormalSizes.sigma": "0.3",
    "ThermalMotion.velocity_rms": "0.1 m/s",
    "RainInsertion.rate": "2000 1/s",
    "RainInsertion.end": "1 s",
    "InletInsertion.start": "0",
    "FileInsertion.file": "particles.csv",
    "StageCondition.quantity": "wall_pressure.lid",
    "StageCondition.above": "100 kPa",
    "StageCondition.below": "5 kPa",
    "FieldGrid.cells": "[20, 1, 40]",
    "LaceyMetric.cells": "[4, 4, 8]",
    "SegregationMetric.cells": "[4, 4, 8]",
    "SegregationMetric.cell": "20 mm",
    "SlidingMetric.walls": "[floor]",
    "Box.min": "[0, 0, 0]",
    "Box.max": "[40 mm, 40 mm, 80 mm]",
    "Checkpoints.interval": "0.5 s",
    "CollisionEnergies.min": "1 nJ",
    "CollisionEnergies.max": "1 mJ",
    "FileSummary.speed_max": "0.5 m/s",
    "FileSummary.diameter_min": "3 mm",
    "FileSummary.overlap_max": "0.01",
    "FileSummary.overlap_rows": "lines 12 and 40",
    "LeesEdwards.start": "0.2 s",
    "BoxOutlet.box": "{min: [-0.5, -0.5, 0.2], max: [0.5, 0.5, 0.4]}",
    **{f"{law}Stiffness{way}": value for law in ("Linear", "WaltonBraun", "Luding") for way, value in (
        ("ReferenceVelocity.reference_velocity", "1 m/s"), ("Value.value", "1e4 N/m"))},
    "WaltonBraunUnloadingReferenceVelocity.reference_velocity": "1 m/s",
    **{f"{motion}.end": "1.5 s" for motion in (
        "Vibration", "Translation", "Rotation", "TableMotion", "SurfaceVelocity", "Servo", "FreeWall")},
    **{f"{wall}.vanishes_at": "1 s" for wall in (
        "Plane", "Rectangle", "Cylinder", "Cone", "Disc", "BoxWall", "MeshWall")},
}  # fmt: skip
"""Examples by part and key where neither the shipped scenes nor the type give a realistic value."""


def example_of(key: Key) -> str:
    """Key and example value as YAML on one line."""
    value = PART_EXAMPLES.get(f"{key.part}.{key.name}") or EXAMPLES.get(key.name)
    value = value or _described(key.description) or _from_scenes(key)
    return f"{key.name}: {value or _typical(key.schema, key.name)}"


def _described(description: str) -> str:
    """Example at the end of a description, after "such as"; empty without one."""
    found = re.search(r"such as ([^;]+?)( for [a-z]+)?$", description)
    return found[1] if found and ", or" not in found[1] and " of " not in found[1] else ""


def _from_scenes(key: Key) -> str:
    """The most frequent value in the shipped scenes, of equally frequent ones the shortest; empty if all are long."""
    found = _harvest().get((key.part, key.name), Counter())
    short = [text for text in found if len(text) <= LONGEST]
    return min(short, key=lambda text: (-found[text], len(text), text), default="")


@cache
def _harvest() -> dict[tuple[str, str], Counter[str]]:
    """Values of all keys in the shipped scenes as YAML, by part and key; subfolders count if no other scene has it."""
    found: dict[tuple[str, str], Counter[str]] = {}
    scenes = {name: path for name, path in example_paths().items() if not name.startswith(NO_SCENES)}
    for depth in (0, 1):
        known = set(found)
        for path in (path for name, path in scenes.items() if name.count("/") == depth):
            for part, name, value in _values(ROOT, YAML(typ="safe").load(path)):
                if (part, name) not in known:
                    found.setdefault((part, name), Counter())[as_yaml(value)] += 1
    return found


def _values(part: str, mapping: dict[str, Any]) -> Iterator[tuple[str, str, Any]]:
    """Part, key and value of every key in a mapping, nested ones included."""
    for name, schema in parts()[part].get("properties", {}).items():
        if name in mapping:
            yield part, name, mapping[name]
            yield from _inside(schema, mapping[name])


def _inside(schema: dict[str, Any], value: Any) -> Iterator[tuple[str, str, Any]]:
    """Values of the parts that a value contains."""
    for each in alternatives(schema):
        part = referenced(each)
        if part and isinstance(value, dict) and _fits(part, value):
            yield from _values(part, value)
            return
        if isinstance(value, dict):
            for inner in each.get("patternProperties", {}).values():
                for item in value.values():
                    yield from _inside(inner, item)
        elif isinstance(value, list) and isinstance(each.get("items"), dict):
            for item in value:
                yield from _inside(each["items"], item)


def _fits(part: str, value: dict[str, Any]) -> bool:
    """Whether a mapping is a value of a part: its keys are known, and a key such as `kind` fits."""
    known = parts()[part].get("properties", {})
    return set(value) <= set(known) and all(known[key].get("const", each) == each for key, each in value.items())


def _typical(schema: dict[str, Any], key: str = "") -> str:
    """A value of the type of a schema; `key` selects the example of text."""
    if default := schema.get("default"):
        return as_yaml(default)
    options = list(alternatives(schema))
    first = options[0]
    for each in options:
        if dimension := dimension_of(each):
            return dimension.example
    if part := referenced(first):
        return _mapping(part)
    if "const" in first or "enum" in first:
        return str(first.get("const") or first["enum"][0])
    if "prefixItems" in first:
        return VECTORS.get(key) or f"[{', '.join(_typical(each) for each in first['prefixItems'])}]"
    if "items" in first:
        return f"[{_typical(first['items'], key)}]"
    if "patternProperties" in first:
        return f"{{first: {_typical(next(iter(first['patternProperties'].values())))}}}"
    return {"boolean": "true", "integer": "100", "number": "0.5", "string": TEXTS.get(key, "glass")}[first["type"]]


def _mapping(part: str) -> str:
    """A mapping with the required keys of a part."""
    schema = parts()[part]
    required = [name for name in schema["properties"] if name in schema.get("required", ())]
    return "{" + ", ".join(f"{name}: {_typical(schema['properties'][name], name)}" for name in required) + "}"
