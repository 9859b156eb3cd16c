"""granflow: discrete element simulation of granular flow, from a YAML scene to ParaView.

Names are imported at first use: reading a scene does not start Taichi. `_LOCATIONS` says where each public
name is defined; type checkers, which do not run `__getattr__`, read the imports in the first block instead.
A test compares the two.
"""

import os
from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from granflow.engine.state_cache import start as start
    from granflow.errors import FunctionError as FunctionError
    from granflow.errors import GranflowError as GranflowError
    from granflow.errors import OutputError as OutputError
    from granflow.errors import RunError as RunError
    from granflow.errors import SceneError as SceneError
    from granflow.errors import StopRun as StopRun
    from granflow.live.forces import ParticleForce as ParticleForce
    from granflow.load import Scene as Scene
    from granflow.load import load_scene as load_scene
    from granflow.observers.build import analyze_snapshots as analyze_snapshots
    from granflow.observers.meters import steady_flow as steady_flow
    from granflow.observers.meters import steady_flow_error as steady_flow_error
    from granflow.observers.observer import on_interval as on_interval
    from granflow.particles.group import ParticleData as ParticleData
    from granflow.plan.build import plan_for as plan_for
    from granflow.plan.cost import estimate_memory as estimate_memory
    from granflow.plan.explain import explain as explain
    from granflow.plan.plan import Plan as Plan
    from granflow.runs.read_run import Run as Run
    from granflow.runs.read_run import read_run as read_run
    from granflow.runs.result import Result as Result
    from granflow.scene.blocks.contact import Contact as Contact
    from granflow.scene.blocks.deformation import AxisDeformation as AxisDeformation
    from granflow.scene.blocks.deformation import Deformation as Deformation
    from granflow.scene.blocks.deletions import StageDeletion as StageDeletion
    from granflow.scene.blocks.domain import Domain as Domain
    from granflow.scene.blocks.domain import LeesEdwards as LeesEdwards
    from granflow.scene.blocks.gravity import ChangingGravity as ChangingGravity
    from granflow.scene.blocks.gravity import GravityOscillation as GravityOscillation
    from granflow.scene.blocks.gravity import GravityRotation as GravityRotation
    from granflow.scene.blocks.gravity import GravityVibration as GravityVibration
    from granflow.scene.blocks.insertions import BoxRegion as BoxRegion
    from granflow.scene.blocks.insertions import CylinderRegion as CylinderRegion
    from granflow.scene.blocks.insertions import DiscFace as DiscFace
    from granflow.scene.blocks.insertions import FileInsertion as FileInsertion
    from granflow.scene.blocks.insertions import InletInsertion as InletInsertion
    from granflow.scene.blocks.insertions import LatticeInsertion as LatticeInsertion
    from granflow.scene.blocks.insertions import PackInsertion as PackInsertion
    from granflow.scene.blocks.insertions import PositionsInsertion as PositionsInsertion
    from granflow.scene.blocks.insertions import PythonInsertion as PythonInsertion
    from granflow.scene.blocks.insertions import RainInsertion as RainInsertion
    from granflow.scene.blocks.insertions import RectangleFace as RectangleFace
    from granflow.scene.blocks.materials import Material as Material
    from granflow.scene.blocks.materials import MaterialPair as MaterialPair
    from granflow.scene.blocks.materials import RestitutionFit as RestitutionFit
    from granflow.scene.blocks.metrics import CenterOfMassMetric as CenterOfMassMetric
    from granflow.scene.blocks.metrics import ContentMetric as ContentMetric
    from granflow.scene.blocks.metrics import CoordinationMetric as CoordinationMetric
    from granflow.scene.blocks.metrics import FabricMetric as FabricMetric
    from granflow.scene.blocks.metrics import GranularTemperatureMetric as GranularTemperatureMetric
    from granflow.scene.blocks.metrics import HeightMetric as HeightMetric
    from granflow.scene.blocks.metrics import LaceyMetric as LaceyMetric
    from granflow.scene.blocks.metrics import OrientationMetric as OrientationMetric
    from granflow.scene.blocks.metrics import ReposeMetric as ReposeMetric
    from granflow.scene.blocks.metrics import SegregationMetric as SegregationMetric
    from granflow.scene.blocks.metrics import SlidingMetric as SlidingMetric
    from granflow.scene.blocks.metrics import SolidFractionMetric as SolidFractionMetric
    from granflow.scene.blocks.metrics import StressMetric as StressMetric
    from granflow.scene.blocks.motions import FreeWall as FreeWall
    from granflow.scene.blocks.motions import Oscillation as Oscillation
    from granflow.scene.blocks.motions import Rotation as Rotation
    from granflow.scene.blocks.motions import Servo as Servo
    from granflow.scene.blocks.motions import SurfaceVelocity as SurfaceVelocity
    from granflow.scene.blocks.motions import TableMotion as TableMotion
    from granflow.scene.blocks.motions import Translation as Translation
    from granflow.scene.blocks.motions import Vibration as Vibration
    from granflow.scene.blocks.outlets import BoxOutlet as BoxOutlet
    from granflow.scene.blocks.outlets import DiscOutlet as DiscOutlet
    from granflow.scene.blocks.outlets import HalfSpaceOutlet as HalfSpaceOutlet
    from granflow.scene.blocks.output import Checkpoints as Checkpoints
    from granflow.scene.blocks.output import CollisionEnergies as CollisionEnergies
    from granflow.scene.blocks.output import Expectation as Expectation
    from granflow.scene.blocks.output import FieldGrid as FieldGrid
    from granflow.scene.blocks.output import FlowMeter as FlowMeter
    from granflow.scene.blocks.output import Output as Output
    from granflow.scene.blocks.output import ResidenceTime as ResidenceTime
    from granflow.scene.blocks.particle_shapes.clump import Clump as Clump
    from granflow.scene.blocks.particle_shapes.clump import ClumpSphere as ClumpSphere
    from granflow.scene.blocks.particles import Group as Group
    from granflow.scene.blocks.primitives import Box as Box
    from granflow.scene.blocks.primitives import RotationStep as RotationStep
    from granflow.scene.blocks.run import Damping as Damping
    from granflow.scene.blocks.run import Numerics as Numerics
    from granflow.scene.blocks.run import RunSettings as RunSettings
    from granflow.scene.blocks.run import Stage as Stage
    from granflow.scene.blocks.run import StageCondition as StageCondition
    from granflow.scene.blocks.settings import StageSetting as StageSetting
    from granflow.scene.blocks.sizes import ClassSizes as ClassSizes
    from granflow.scene.blocks.sizes import LogNormalSizes as LogNormalSizes
    from granflow.scene.blocks.sizes import NormalSizes as NormalSizes
    from granflow.scene.blocks.sizes import RosinRammlerSizes as RosinRammlerSizes
    from granflow.scene.blocks.sizes import Sieve as Sieve
    from granflow.scene.blocks.sizes import SieveSizes as SieveSizes
    from granflow.scene.blocks.sizes import SizeClass as SizeClass
    from granflow.scene.blocks.sizes import UniformSizes as UniformSizes
    from granflow.scene.blocks.walls.box import BoxWall as BoxWall
    from granflow.scene.blocks.walls.half_space import Plane as Plane
    from granflow.scene.blocks.walls.mesh import MeshWall as MeshWall
    from granflow.scene.blocks.walls.rectangle import Rectangle as Rectangle
    from granflow.scene.blocks.walls.revolved import Cone as Cone
    from granflow.scene.blocks.walls.revolved import Cylinder as Cylinder
    from granflow.scene.blocks.walls.revolved import Disc as Disc
    from granflow.scene.blocks.walls.sphere import Sphere as Sphere
    from granflow.scene.blocks.wear import ArchardWear as ArchardWear
    from granflow.scene.blocks.wear import FinnieWear as FinnieWear
    from granflow.scene.blocks.wear import RelativeWear as RelativeWear
    from granflow.scene.registration import register_contact_model as register_contact_model
    from granflow.scene.registration import register_metric as register_metric
    from granflow.scene.registration import register_particle_equation as register_particle_equation
    from granflow.simulation import Simulation as Simulation
    from granflow.snapshot import Snapshot as Snapshot
    from granflow.studies.calibration.calibrate import calibrate as calibrate
    from granflow.studies.sweep import sweep as sweep

# Without these, Taichi prints a banner to stdout and sends its version to its developers once a day.
os.environ.setdefault("ENABLE_TAICHI_HEADER_PRINT", "0")
os.environ.setdefault("ENABLE_QUADRANTS_HEADER_PRINT", "0")
os.environ.setdefault("TI_SKIP_VERSION_CHECK", "ON")
# In notebooks, the prints of kernels would pass through Python, which a line on stderr announces.
os.environ.setdefault("TI_ENABLE_PYBUF", "0")
os.environ.setdefault("QD_ENABLE_PYBUF", "0")
# Without HOME, as under some job schedulers, Taichi ends the process.
os.environ.setdefault("HOME", os.path.expanduser("~"))

_LOCATIONS = {
    "ArchardWear": "granflow.scene.blocks.wear.ArchardWear",
    "AxisDeformation": "granflow.scene.blocks.deformation.AxisDeformation",
    "Box": "granflow.scene.blocks.primitives.Box",
    "BoxOutlet": "granflow.scene.blocks.outlets.BoxOutlet",
    "BoxRegion": "granflow.scene.blocks.insertions.BoxRegion",
    "BoxWall": "granflow.scene.blocks.walls.box.BoxWall",
    "CenterOfMassMetric": "granflow.scene.blocks.metrics.CenterOfMassMetric",
    "ChangingGravity": "granflow.scene.blocks.gravity.ChangingGravity",
    "Checkpoints": "granflow.scene.blocks.output.Checkpoints",
    "ClassSizes": "granflow.scene.blocks.sizes.ClassSizes",
    "Clump": "granflow.scene.blocks.particle_shapes.clump.Clump",
    "ClumpSphere": "granflow.scene.blocks.particle_shapes.clump.ClumpSphere",
    "CollisionEnergies": "granflow.scene.blocks.output.CollisionEnergies",
    "Cone": "granflow.scene.blocks.walls.revolved.Cone",
    "Contact": "granflow.scene.blocks.contact.Contact",
    "ContentMetric": "granflow.scene.blocks.metrics.ContentMetric",
    "CoordinationMetric": "granflow.scene.blocks.metrics.CoordinationMetric",
    "Cylinder": "granflow.scene.blocks.walls.revolved.Cylinder",
    "CylinderRegion": "granflow.scene.blocks.insertions.CylinderRegion",
    "Damping": "granflow.scene.blocks.run.Damping",
    "Deformation": "granflow.scene.blocks.deformation.Deformation",
    "Disc": "granflow.scene.blocks.walls.revolved.Disc",
    "DiscFace": "granflow.scene.blocks.insertions.DiscFace",
    "DiscOutlet": "granflow.scene.blocks.outlets.DiscOutlet",
    "Domain": "granflow.scene.blocks.domain.Domain",
    "Expectation": "granflow.scene.blocks.output.Expectation",
    "FabricMetric": "granflow.scene.blocks.metrics.FabricMetric",
    "FieldGrid": "granflow.scene.blocks.output.FieldGrid",
    "FileInsertion": "granflow.scene.blocks.insertions.FileInsertion",
    "FinnieWear": "granflow.scene.blocks.wear.FinnieWear",
    "FlowMeter": "granflow.scene.blocks.output.FlowMeter",
    "FreeWall": "granflow.scene.blocks.motions.FreeWall",
    "FunctionError": "granflow.errors.FunctionError",
    "GranflowError": "granflow.errors.GranflowError",
    "GranularTemperatureMetric": "granflow.scene.blocks.metrics.GranularTemperatureMetric",
    "GravityOscillation": "granflow.scene.blocks.gravity.GravityOscillation",
    "GravityRotation": "granflow.scene.blocks.gravity.GravityRotation",
    "GravityVibration": "granflow.scene.blocks.gravity.GravityVibration",
    "Group": "granflow.scene.blocks.particles.Group",
    "HalfSpaceOutlet": "granflow.scene.blocks.outlets.HalfSpaceOutlet",
    "HeightMetric": "granflow.scene.blocks.metrics.HeightMetric",
    "InletInsertion": "granflow.scene.blocks.insertions.InletInsertion",
    "LaceyMetric": "granflow.scene.blocks.metrics.LaceyMetric",
    "LatticeInsertion": "granflow.scene.blocks.insertions.LatticeInsertion",
    "LeesEdwards": "granflow.scene.blocks.domain.LeesEdwards",
    "LogNormalSizes": "granflow.scene.blocks.sizes.LogNormalSizes",
    "Material": "granflow.scene.blocks.materials.Material",
    "MaterialPair": "granflow.scene.blocks.materials.MaterialPair",
    "MeshWall": "granflow.scene.blocks.walls.mesh.MeshWall",
    "NormalSizes": "granflow.scene.blocks.sizes.NormalSizes",
    "Numerics": "granflow.scene.blocks.run.Numerics",
    "OrientationMetric": "granflow.scene.blocks.metrics.OrientationMetric",
    "Oscillation": "granflow.scene.blocks.motions.Oscillation",
    "Output": "granflow.scene.blocks.output.Output",
    "OutputError": "granflow.errors.OutputError",
    "PackInsertion": "granflow.scene.blocks.insertions.PackInsertion",
    "ParticleData": "granflow.particles.group.ParticleData",
    "ParticleForce": "granflow.live.forces.ParticleForce",
    "Plan": "granflow.plan.plan.Plan",
    "Plane": "granflow.scene.blocks.walls.half_space.Plane",
    "PositionsInsertion": "granflow.scene.blocks.insertions.PositionsInsertion",
    "PythonInsertion": "granflow.scene.blocks.insertions.PythonInsertion",
    "RainInsertion": "granflow.scene.blocks.insertions.RainInsertion",
    "Rectangle": "granflow.scene.blocks.walls.rectangle.Rectangle",
    "RectangleFace": "granflow.scene.blocks.insertions.RectangleFace",
    "RelativeWear": "granflow.scene.blocks.wear.RelativeWear",
    "ReposeMetric": "granflow.scene.blocks.metrics.ReposeMetric",
    "ResidenceTime": "granflow.scene.blocks.output.ResidenceTime",
    "RestitutionFit": "granflow.scene.blocks.materials.RestitutionFit",
    "Result": "granflow.runs.result.Result",
    "RosinRammlerSizes": "granflow.scene.blocks.sizes.RosinRammlerSizes",
    "Rotation": "granflow.scene.blocks.motions.Rotation",
    "RotationStep": "granflow.scene.blocks.primitives.RotationStep",
    "Run": "granflow.runs.read_run.Run",
    "RunError": "granflow.errors.RunError",
    "RunSettings": "granflow.scene.blocks.run.RunSettings",
    "Scene": "granflow.load.Scene",
    "SceneError": "granflow.errors.SceneError",
    "SegregationMetric": "granflow.scene.blocks.metrics.SegregationMetric",
    "Servo": "granflow.scene.blocks.motions.Servo",
    "Sieve": "granflow.scene.blocks.sizes.Sieve",
    "SieveSizes": "granflow.scene.blocks.sizes.SieveSizes",
    "Simulation": "granflow.simulation.Simulation",
    "SizeClass": "granflow.scene.blocks.sizes.SizeClass",
    "SlidingMetric": "granflow.scene.blocks.metrics.SlidingMetric",
    "Snapshot": "granflow.snapshot.Snapshot",
    "SolidFractionMetric": "granflow.scene.blocks.metrics.SolidFractionMetric",
    "Sphere": "granflow.scene.blocks.walls.sphere.Sphere",
    "Stage": "granflow.scene.blocks.run.Stage",
    "StageCondition": "granflow.scene.blocks.run.StageCondition",
    "StageDeletion": "granflow.scene.blocks.deletions.StageDeletion",
    "StageSetting": "granflow.scene.blocks.settings.StageSetting",
    "StopRun": "granflow.errors.StopRun",
    "StressMetric": "granflow.scene.blocks.metrics.StressMetric",
    "SurfaceVelocity": "granflow.scene.blocks.motions.SurfaceVelocity",
    "TableMotion": "granflow.scene.blocks.motions.TableMotion",
    "Translation": "granflow.scene.blocks.motions.Translation",
    "UniformSizes": "granflow.scene.blocks.sizes.UniformSizes",
    "Vibration": "granflow.scene.blocks.motions.Vibration",
    "analyze_snapshots": "granflow.observers.build.analyze_snapshots",
    "calibrate": "granflow.studies.calibration.calibrate.calibrate",
    "estimate_memory": "granflow.plan.cost.estimate_memory",
    "explain": "granflow.plan.explain.explain",
    "load_scene": "granflow.load.load_scene",
    "on_interval": "granflow.observers.observer.on_interval",
    "plan_for": "granflow.plan.build.plan_for",
    "read_run": "granflow.runs.read_run.read_run",
    "register_contact_model": "granflow.scene.registration.register_contact_model",
    "register_metric": "granflow.scene.registration.register_metric",
    "register_particle_equation": "granflow.scene.registration.register_particle_equation",
    "start": "granflow.engine.state_cache.start",
    "steady_flow": "granflow.observers.meters.steady_flow",
    "steady_flow_error": "granflow.observers.meters.steady_flow_error",
    "sweep": "granflow.studies.sweep.sweep",
}
"""Module and attribute of each public name."""

__all__ = list(_LOCATIONS)


def __getattr__(name: str) -> Any:
    """Import a public name at its first use. Raises AttributeError for other names."""
    if name == "__version__":
        return import_module("importlib.metadata").version("granflow")
    if name not in _LOCATIONS:
        raise AttributeError(f"module 'granflow' has no attribute '{name}'")
    module, _, attribute = _LOCATIONS[name].rpartition(".")
    return getattr(import_module(module), attribute)


def __dir__() -> list[str]:
    """The public names."""
    return sorted(["__version__", *_LOCATIONS])
