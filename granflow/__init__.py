"""granflow: discrete element simulation of granular flow, from a YAML scene to ParaView.

Names are imported at first use: reading a scene does not start Taichi.
"""

import os
from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from granflow.errors import GranflowError, RunError, SceneError
    from granflow.load import load as load_scene
    from granflow.scene.registration import register_contact_model
    from granflow.simulation import Simulation

# Without these, Taichi prints a banner to stdout and sends its version to its developers once a day.
os.environ.setdefault("ENABLE_TAICHI_HEADER_PRINT", "0")
os.environ.setdefault("TI_SKIP_VERSION_CHECK", "ON")
# Without HOME, as under some job schedulers, Taichi ends the process.
os.environ.setdefault("HOME", os.path.expanduser("~"))

__all__ = ["GranflowError", "RunError", "SceneError", "Simulation", "load_scene", "register_contact_model"]

_LOCATIONS = {
    "GranflowError": "granflow.errors:GranflowError",
    "RunError": "granflow.errors:RunError",
    "SceneError": "granflow.errors:SceneError",
    "Simulation": "granflow.simulation:Simulation",
    "load_scene": "granflow.load:load",
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
