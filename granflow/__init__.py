"""granflow: discrete element simulation of granular flow, from a YAML scene to ParaView.

Names are imported at first use: reading a scene does not start Taichi.
"""

import os
from importlib import import_module
from inspect import modulesbyfile
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from granflow.engine.state_cache import start
    from granflow.errors import FunctionError, GranflowError, OutputError, RunError, SceneError, StopRun
    from granflow.live.forces import ParticleForce
    from granflow.load import Scene
    from granflow.load import load as load_scene
    from granflow.observers.analysis import analyze_snapshots
    from granflow.observers.flow_meters import steady_flow
    from granflow.observers.interval import on_interval
    from granflow.particles.particle_data import ParticleData
    from granflow.plan.build import plan_for
    from granflow.plan.explain import explain
    from granflow.plan.memory_estimate import estimate_memory
    from granflow.plan.plan import Plan
    from granflow.runs.read_run import Run, read_run
    from granflow.runs.result import Result
    from granflow.scene.registration import register_contact_model
    from granflow.scene.schema.analysis import (
        CenterOfMassMetric,
        ContentMetric,
        CoordinationMetric,
        FabricMetric,
        FieldGrid,
        LaceyMetric,
        ReposeMetric,
        SegregationMetric,
        SlidingMetric,
    )
    from granflow.scene.schema.clumps import Clump, ClumpSphere
    from granflow.scene.schema.contact import Contact
    from granflow.scene.schema.damping import Damping
    from granflow.scene.schema.domain import Domain, LeesEdwards
    from granflow.scene.schema.expect import Expectation
    from granflow.scene.schema.insertion import (
        BoxRegion,
        CylinderRegion,
        DiscFace,
        FileInsertion,
        InletInsertion,
        LatticeInsertion,
        PackInsertion,
        PositionsInsertion,
        PythonInsertion,
        RainInsertion,
        RectangleFace,
    )
    from granflow.scene.schema.materials import Material, MaterialPair, RestitutionFit
    from granflow.scene.schema.motions import (
        FreeWall,
        Rotation,
        Servo,
        SurfaceVelocity,
        TableMotion,
        Translation,
        Vibration,
    )
    from granflow.scene.schema.outlets import BoxOutlet, DiscOutlet, HalfSpaceOutlet
    from granflow.scene.schema.output import Checkpoints, FlowMeter, Output
    from granflow.scene.schema.particles import Group
    from granflow.scene.schema.run import Numerics, RunSettings
    from granflow.scene.schema.shapes import Box
    from granflow.scene.schema.sizes import ClassSizes, LogNormalSizes, NormalSizes, SizeClass, UniformSizes
    from granflow.scene.schema.stages import Stage, StageCondition
    from granflow.scene.schema.walls import BoxWall, Cone, Cylinder, Disc, MeshWall, Plane, Rectangle, RotationStep
    from granflow.simulation import Simulation
    from granflow.snapshot import Snapshot
    from granflow.studies.calibration.calibrate import calibrate
    from granflow.studies.sweep.sweep import sweep

# Without these, Taichi prints a banner to stdout and sends its version to its developers once a day.
os.environ.setdefault("ENABLE_TAICHI_HEADER_PRINT", "0")
os.environ.setdefault("ENABLE_QUADRANTS_HEADER_PRINT", "0")
os.environ.setdefault("TI_SKIP_VERSION_CHECK", "ON")
# Without HOME, as under some job schedulers, Taichi ends the process.
os.environ.setdefault("HOME", os.path.expanduser("~"))
# For each decorated function of a module, Taichi asks `inspect` for the module that executes the import, which is not
# found: without this entry, `inspect` searches all modules every time, 0.3 s per start.
modulesbyfile.setdefault("<frozen importlib._bootstrap>", "_frozen_importlib")

__all__ = [
    "Box",
    "BoxOutlet",
    "BoxRegion",
    "BoxWall",
    "CenterOfMassMetric",
    "Checkpoints",
    "ClassSizes",
    "Clump",
    "ClumpSphere",
    "Cone",
    "Contact",
    "ContentMetric",
    "CoordinationMetric",
    "Cylinder",
    "CylinderRegion",
    "Damping",
    "Disc",
    "DiscFace",
    "DiscOutlet",
    "Domain",
    "Expectation",
    "FabricMetric",
    "FieldGrid",
    "FileInsertion",
    "FlowMeter",
    "FreeWall",
    "FunctionError",
    "GranflowError",
    "Group",
    "HalfSpaceOutlet",
    "InletInsertion",
    "LaceyMetric",
    "LatticeInsertion",
    "LeesEdwards",
    "LogNormalSizes",
    "Material",
    "MaterialPair",
    "MeshWall",
    "NormalSizes",
    "Numerics",
    "Output",
    "OutputError",
    "PackInsertion",
    "ParticleData",
    "ParticleForce",
    "Plan",
    "Plane",
    "PositionsInsertion",
    "PythonInsertion",
    "RainInsertion",
    "Rectangle",
    "RectangleFace",
    "ReposeMetric",
    "RestitutionFit",
    "Result",
    "Rotation",
    "RotationStep",
    "Run",
    "RunError",
    "RunSettings",
    "Scene",
    "SceneError",
    "SegregationMetric",
    "Servo",
    "Simulation",
    "SizeClass",
    "SlidingMetric",
    "Snapshot",
    "Stage",
    "StageCondition",
    "StopRun",
    "SurfaceVelocity",
    "TableMotion",
    "Translation",
    "UniformSizes",
    "Vibration",
    "analyze_snapshots",
    "calibrate",
    "estimate_memory",
    "explain",
    "load_scene",
    "on_interval",
    "plan_for",
    "read_run",
    "register_contact_model",
    "start",
    "steady_flow",
    "sweep",
]

_LOCATIONS = {
    "Box": "granflow.scene.schema.shapes:Box",
    "BoxOutlet": "granflow.scene.schema.outlets:BoxOutlet",
    "BoxRegion": "granflow.scene.schema.insertion:BoxRegion",
    "BoxWall": "granflow.scene.schema.walls:BoxWall",
    "CenterOfMassMetric": "granflow.scene.schema.analysis:CenterOfMassMetric",
    "Checkpoints": "granflow.scene.schema.output:Checkpoints",
    "ClassSizes": "granflow.scene.schema.sizes:ClassSizes",
    "Clump": "granflow.scene.schema.clumps:Clump",
    "ClumpSphere": "granflow.scene.schema.clumps:ClumpSphere",
    "Cone": "granflow.scene.schema.walls:Cone",
    "Contact": "granflow.scene.schema.contact:Contact",
    "ContentMetric": "granflow.scene.schema.analysis:ContentMetric",
    "CoordinationMetric": "granflow.scene.schema.analysis:CoordinationMetric",
    "Cylinder": "granflow.scene.schema.walls:Cylinder",
    "CylinderRegion": "granflow.scene.schema.insertion:CylinderRegion",
    "Damping": "granflow.scene.schema.damping:Damping",
    "Disc": "granflow.scene.schema.walls:Disc",
    "DiscFace": "granflow.scene.schema.insertion:DiscFace",
    "DiscOutlet": "granflow.scene.schema.outlets:DiscOutlet",
    "Domain": "granflow.scene.schema.domain:Domain",
    "Expectation": "granflow.scene.schema.expect:Expectation",
    "FabricMetric": "granflow.scene.schema.analysis:FabricMetric",
    "FieldGrid": "granflow.scene.schema.analysis:FieldGrid",
    "FileInsertion": "granflow.scene.schema.insertion:FileInsertion",
    "FlowMeter": "granflow.scene.schema.output:FlowMeter",
    "FreeWall": "granflow.scene.schema.motions:FreeWall",
    "FunctionError": "granflow.errors:FunctionError",
    "GranflowError": "granflow.errors:GranflowError",
    "Group": "granflow.scene.schema.particles:Group",
    "HalfSpaceOutlet": "granflow.scene.schema.outlets:HalfSpaceOutlet",
    "InletInsertion": "granflow.scene.schema.insertion:InletInsertion",
    "LaceyMetric": "granflow.scene.schema.analysis:LaceyMetric",
    "LatticeInsertion": "granflow.scene.schema.insertion:LatticeInsertion",
    "LeesEdwards": "granflow.scene.schema.domain:LeesEdwards",
    "LogNormalSizes": "granflow.scene.schema.sizes:LogNormalSizes",
    "Material": "granflow.scene.schema.materials:Material",
    "MaterialPair": "granflow.scene.schema.materials:MaterialPair",
    "MeshWall": "granflow.scene.schema.walls:MeshWall",
    "NormalSizes": "granflow.scene.schema.sizes:NormalSizes",
    "Numerics": "granflow.scene.schema.run:Numerics",
    "Output": "granflow.scene.schema.output:Output",
    "OutputError": "granflow.errors:OutputError",
    "PackInsertion": "granflow.scene.schema.insertion:PackInsertion",
    "ParticleData": "granflow.particles.particle_data:ParticleData",
    "ParticleForce": "granflow.live.forces:ParticleForce",
    "Plan": "granflow.plan.plan:Plan",
    "Plane": "granflow.scene.schema.walls:Plane",
    "PositionsInsertion": "granflow.scene.schema.insertion:PositionsInsertion",
    "PythonInsertion": "granflow.scene.schema.insertion:PythonInsertion",
    "RainInsertion": "granflow.scene.schema.insertion:RainInsertion",
    "Rectangle": "granflow.scene.schema.walls:Rectangle",
    "RectangleFace": "granflow.scene.schema.insertion:RectangleFace",
    "ReposeMetric": "granflow.scene.schema.analysis:ReposeMetric",
    "RestitutionFit": "granflow.scene.schema.materials:RestitutionFit",
    "Result": "granflow.runs.result:Result",
    "Rotation": "granflow.scene.schema.motions:Rotation",
    "RotationStep": "granflow.scene.schema.walls:RotationStep",
    "Run": "granflow.runs.read_run:Run",
    "RunError": "granflow.errors:RunError",
    "RunSettings": "granflow.scene.schema.run:RunSettings",
    "Scene": "granflow.load:Scene",
    "SceneError": "granflow.errors:SceneError",
    "SegregationMetric": "granflow.scene.schema.analysis:SegregationMetric",
    "Servo": "granflow.scene.schema.motions:Servo",
    "Simulation": "granflow.simulation:Simulation",
    "SizeClass": "granflow.scene.schema.sizes:SizeClass",
    "SlidingMetric": "granflow.scene.schema.analysis:SlidingMetric",
    "Snapshot": "granflow.snapshot:Snapshot",
    "Stage": "granflow.scene.schema.stages:Stage",
    "StageCondition": "granflow.scene.schema.stages:StageCondition",
    "StopRun": "granflow.errors:StopRun",
    "SurfaceVelocity": "granflow.scene.schema.motions:SurfaceVelocity",
    "TableMotion": "granflow.scene.schema.motions:TableMotion",
    "Translation": "granflow.scene.schema.motions:Translation",
    "UniformSizes": "granflow.scene.schema.sizes:UniformSizes",
    "Vibration": "granflow.scene.schema.motions:Vibration",
    "__version__": "importlib.metadata:version",
    "analyze_snapshots": "granflow.observers.analysis:analyze_snapshots",
    "calibrate": "granflow.studies.calibration.calibrate:calibrate",
    "estimate_memory": "granflow.plan.memory_estimate:estimate_memory",
    "explain": "granflow.plan.explain:explain",
    "load_scene": "granflow.load:load",
    "on_interval": "granflow.observers.interval:on_interval",
    "plan_for": "granflow.plan.build:plan_for",
    "read_run": "granflow.runs.read_run:read_run",
    "register_contact_model": "granflow.scene.registration:register_contact_model",
    "start": "granflow.engine.state_cache:start",
    "steady_flow": "granflow.observers.flow_meters:steady_flow",
    "sweep": "granflow.studies.sweep.sweep:sweep",
}
"""Module and attribute of each public name."""


def __getattr__(name: str) -> Any:
    """Import a public name at its first use. Raises AttributeError for other names."""
    if name not in _LOCATIONS:
        raise AttributeError(f"module 'granflow' has no attribute '{name}'")
    module, _, attribute = _LOCATIONS[name].partition(":")
    value = getattr(import_module(module), attribute)
    return value("granflow") if name == "__version__" else value


def __dir__() -> list[str]:
    """The public names."""
    return sorted(_LOCATIONS)
