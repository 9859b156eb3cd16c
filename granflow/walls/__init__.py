"""Wall shapes (device function and numpy twin), the rims they share, and how walls move."""

from granflow.walls.catalogue import SHAPE_KINDS, kind_code, reach_about, triangles
from granflow.walls.motion import Motion, Poses, Rotation, Translation, Vibration, pose, speed_bound
from granflow.walls.plane import half_space, rectangle
from granflow.walls.revolved import cone, cylinder, disc
from granflow.walls.rims import join_rims
from granflow.walls.shape import FAR_AWAY, PARAMETER_COUNT, Shape, ShapeKind

__all__ = [
    "FAR_AWAY",
    "PARAMETER_COUNT",
    "SHAPE_KINDS",
    "Motion",
    "Poses",
    "Rotation",
    "Shape",
    "ShapeKind",
    "Translation",
    "Vibration",
    "cone",
    "cylinder",
    "disc",
    "half_space",
    "join_rims",
    "kind_code",
    "pose",
    "reach_about",
    "rectangle",
    "speed_bound",
    "triangles",
]
