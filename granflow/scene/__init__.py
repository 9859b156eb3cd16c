"""Scene files: reading, validation, and the immutable `Scene`.

`load(path)` returns a resolved scene in SI units, or raises SceneError with all problems. The generation of particles
(packings, insertion, particle files) and the periodic box on the host are part of this package.
"""

from granflow.scene.jsonschema import json_schema
from granflow.scene.reader import load
from granflow.scene.schema import Scene

__all__ = ["Scene", "json_schema", "load"]
