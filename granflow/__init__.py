"""granflow: discrete element simulation of granular flow, from a YAML scene to ParaView.

Names are imported at first use: reading a scene does not start Taichi.
"""

import ast
import inspect
import os
import sys
from functools import cache
from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from granflow.engine.engine import start
    from granflow.errors import FunctionError, GranflowError, OutputError, RunError, SceneError, StopRun
    from granflow.live.forces import ParticleForce
    from granflow.load import Scene
    from granflow.load import load as load_scene
    from granflow.observers.analysis import analyze_snapshots
    from granflow.observers.meters import steady_flow
    from granflow.observers.observer import on_interval
    from granflow.particles.group import ParticleData
    from granflow.plan.build import plan_for
    from granflow.plan.explain import explain
    from granflow.plan.memory import estimate_memory
    from granflow.plan.plan import Plan
    from granflow.runs.read_run import Run, read_run
    from granflow.runs.result import Result
    from granflow.scene.blocks.contact import Contact
    from granflow.scene.blocks.domain import BoxOutlet, DiscOutlet, Domain, HalfSpaceOutlet, LeesEdwards
    from granflow.scene.blocks.materials import Material, MaterialPair, RestitutionFit
    from granflow.scene.blocks.output import (
        CenterOfMassMetric,
        Checkpoints,
        CollisionEnergies,
        ContentMetric,
        CoordinationMetric,
        Expectation,
        FabricMetric,
        FieldGrid,
        FlowMeter,
        LaceyMetric,
        Output,
        ReposeMetric,
        SegregationMetric,
        SlidingMetric,
    )
    from granflow.scene.blocks.particles import (
        BoxRegion,
        ClassSizes,
        Clump,
        ClumpSphere,
        CylinderRegion,
        DiscFace,
        FileInsertion,
        Group,
        InletInsertion,
        LatticeInsertion,
        LogNormalSizes,
        NormalSizes,
        PackInsertion,
        PositionsInsertion,
        PythonInsertion,
        RainInsertion,
        RectangleFace,
        SizeClass,
        UniformSizes,
    )
    from granflow.scene.blocks.run import Damping, Numerics, RunSettings, Stage, StageCondition
    from granflow.scene.blocks.shapes import Box, RotationStep
    from granflow.scene.blocks.walls import (
        BoxWall,
        Cone,
        Cylinder,
        Disc,
        FreeWall,
        MeshWall,
        Plane,
        Rectangle,
        Rotation,
        Servo,
        SurfaceVelocity,
        TableMotion,
        Translation,
        Vibration,
    )
    from granflow.scene.registration import register_contact_model
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
# For each decorated function of a module, Taichi asks `inspect` for the module that executes the import,
# which is not found: without this entry, `inspect` searches all modules every time, 0.3 s per start.
inspect.modulesbyfile.setdefault("<frozen importlib._bootstrap>", "_frozen_importlib")

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
    "CollisionEnergies",
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


@cache
def _locations() -> dict[str, tuple[str, str]]:
    """Module and attribute of each public name: the imports of this module that only type checkers
    execute."""
    source = inspect.getsource(sys.modules[__name__])
    (block,) = (node for node in ast.parse(source).body if isinstance(node, ast.If))
    imports = (node for node in block.body if isinstance(node, ast.ImportFrom))
    return {
        each.asname or each.name: (str(node.module), each.name) for node in imports for each in node.names
    }


def __getattr__(name: str) -> Any:
    """Import a public name at its first use. Raises AttributeError for other names."""
    if name == "__version__":
        return import_module("importlib.metadata").version("granflow")
    if name not in __all__:
        raise AttributeError(f"module 'granflow' has no attribute '{name}'")
    module, attribute = _locations()[name]
    return getattr(import_module(module), attribute)


def __dir__() -> list[str]:
    """The public names."""
    return sorted(["__version__", *__all__])
