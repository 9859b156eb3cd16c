"""Scene files: reading, validation, and the immutable `Scene`."""

from granflow.scene.jsonschema import json_schema
from granflow.scene.reader import load
from granflow.scene.schema import Scene

__all__ = ["Scene", "json_schema", "load"]
