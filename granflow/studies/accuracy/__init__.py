"""Error against run time: collisions of two particles, and complete scenes.

`measure_*` returns the results, `write_*` writes CSV, figures and a page.
"""

from granflow.studies.accuracy.report import measure_two_bodies, write_two_bodies
from granflow.studies.accuracy.scene_points import measure_scene
from granflow.studies.accuracy.scene_report import write_scene

__all__ = ["measure_scene", "measure_two_bodies", "write_scene", "write_two_bodies"]
