"""granflow: discrete element simulation of granular flow, from a YAML scene to ParaView."""

from importlib.metadata import version

__version__ = version("granflow")
