"""Wall shapes (device function and reference implementation), their shared edges, and wall motion."""

from granflow.walls.catalog import SHAPE_KINDS, kind_code, reach_about, triangles
from granflow.walls.motion import Motion, Poses, Rotation, Translation, Vibration, pose, speed_bound
from granflow.walls.plane import half_space, rectangle
from granflow.walls.revolved import cone, cylinder, disc
from granflow.walls.shape import FAR_AWAY, PARAMETER_COUNT, Shape, ShapeKind
from granflow.walls.shared_edges import join_shared_edges

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
    "join_shared_edges",
    "kind_code",
    "pose",
    "reach_about",
    "rectangle",
    "speed_bound",
    "triangles",
]
