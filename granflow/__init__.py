"""granflow: discrete element simulation of granular flow, from a YAML scene to ParaView.

Names are imported at first use: reading a scene does not start Taichi.
"""

import os
from importlib import import_module
from inspect import modulesbyfile
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from granflow.engine.backend import start
    from granflow.errors import FunctionError, GranflowError, RunError, SceneError, StopRun
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
    from granflow.scene.registration import register_contact_model
    from granflow.scene.schema.motions import Rotation, Translation, Vibration
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
    "FunctionError",
    "GranflowError",
    "ParticleData",
    "ParticleForce",
    "Plan",
    "Rotation",
    "RunError",
    "Scene",
    "SceneError",
    "Simulation",
    "Snapshot",
    "StopRun",
    "Translation",
    "Vibration",
    "analyze_snapshots",
    "calibrate",
    "estimate_memory",
    "explain",
    "load_scene",
    "on_interval",
    "plan_for",
    "register_contact_model",
    "start",
    "steady_flow",
    "sweep",
]

_LOCATIONS = {
    "FunctionError": "granflow.errors:FunctionError",
    "GranflowError": "granflow.errors:GranflowError",
    "ParticleData": "granflow.particles.particle_data:ParticleData",
    "ParticleForce": "granflow.live.forces:ParticleForce",
    "Plan": "granflow.plan.plan:Plan",
    "Rotation": "granflow.scene.schema.motions:Rotation",
    "RunError": "granflow.errors:RunError",
    "Scene": "granflow.load:Scene",
    "SceneError": "granflow.errors:SceneError",
    "Simulation": "granflow.simulation:Simulation",
    "Snapshot": "granflow.snapshot:Snapshot",
    "StopRun": "granflow.errors:StopRun",
    "Translation": "granflow.scene.schema.motions:Translation",
    "Vibration": "granflow.scene.schema.motions:Vibration",
    "analyze_snapshots": "granflow.observers.analysis:analyze_snapshots",
    "calibrate": "granflow.studies.calibration.calibrate:calibrate",
    "estimate_memory": "granflow.plan.memory_estimate:estimate_memory",
    "explain": "granflow.plan.explain:explain",
    "load_scene": "granflow.load:load",
    "on_interval": "granflow.observers.interval:on_interval",
    "plan_for": "granflow.plan.build:plan_for",
    "start": "granflow.engine.backend:start",
    "steady_flow": "granflow.observers.flow_meters:steady_flow",
    "sweep": "granflow.studies.sweep.sweep:sweep",
    "register_contact_model": "granflow.scene.registration:register_contact_model",
    "__version__": "importlib.metadata:version",
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
