"""The kinds of walls."""

from typing import Annotated, Any, get_args

from granflow.contact import registry
from granflow.scene.blocks.walls.box import BoxWall
from granflow.scene.blocks.walls.half_space import Plane
from granflow.scene.blocks.walls.mesh import MeshWall
from granflow.scene.blocks.walls.rectangle import Rectangle
from granflow.scene.blocks.walls.revolved import Cone, Cylinder, Disc
from granflow.scene.blocks.walls.sphere import Sphere
from granflow.scene.blocks.walls.wall import Wall
from granflow.schema.faults import value_error
from granflow.schema.model import add_keys, choose_by_key, optional_key

AnyWall = Annotated[
    Plane | Rectangle | Cylinder | Cone | Disc | Sphere | BoxWall | MeshWall, choose_by_key("shape")
]
"""A wall of any kind; the key `shape` selects it."""
WALLS: tuple[type[Wall], ...] = get_args(get_args(AnyWall)[0])
"""The kinds of walls."""


def with_faces(walls: dict[str, Wall]) -> dict[str, Wall]:
    """The walls with the faces of each valid box in its place, named BOX.FACE; an invalid box remains.

    Raises PydanticCustomError if the scene gives a wall of that name, too.
    """
    found: dict[str, Wall] = {}
    for given, wall in walls.items():
        for name, each in wall.walls(given):
            if name != given and name in walls:
                raise value_error(f"{name} is also a face of the box {given}; rename one of them")
            found[name] = each
    return found


def use_registry() -> None:
    """Add the keys that contact models read of walls to all kinds.

    A schema that is built must be rebuilt afterwards.
    """
    keys = {}
    for key, each in registry.wall_properties().items():
        annotation: Any = each.annotation
        for note in each.metadata:
            annotation = Annotated[annotation, note]
        keys[key] = optional_key(annotation, each.description or "", each.examples)
    kinds: tuple[type[Wall], ...] = (Wall, *WALLS)
    for kind in kinds:
        add_keys(kind, keys)


use_registry()
