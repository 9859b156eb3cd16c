"""Force-controlled walls: their motions with the numbers that follow from contacts and time step.

The forces of the particles move these walls (`scene.blocks.motions.ForceControlledMotion`). A motion is
stable only if it is slow enough for the contacts of a layer of particles on the wall: its numbers and limits
follow from the stiffness and viscosity of such a layer, and from the time step.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import sqrt

import numpy as np

from granflow.contact.law import NormalLaw
from granflow.errors import SceneError
from granflow.load import Scene
from granflow.plan.pair_case import PairCase
from granflow.plan.walls import PlannedWall
from granflow.scene.blocks.domain import Domain
from granflow.scene.blocks.motions import ForceControlledMotion, Numbers, WallContacts
from granflow.schema.quantities import Vector3


@dataclass(frozen=True)
class ControlledMotion:
    """One force-controlled motion: index of the wall, index of the motion of this wall, name of the wall.

    spec:     the motion with unit vectors
    numbers:  see `ForceControlledMotion.numbers`
    source:   its line in the scene file
    """

    wall: int
    motion: int
    name: str
    spec: ForceControlledMotion
    numbers: Numbers
    source: str

    @property
    def direction(self) -> Vector3:
        """Unit vector along which the wall moves."""
        return self.spec.direction

    @property
    def force(self) -> float:
        """Force [N] of the wall on particles at rest along its direction."""
        return self.numbers["force"]

    @property
    def key(self) -> str:
        """Key in messages and checkpoints."""
        return f"walls.{self.name}.motion.{self.motion}"


def controlled_motions_of(
    scene: Scene,
    walls: Sequence[PlannedWall],
    law: NormalLaw,
    pair_cases: Sequence[PairCase],
    velocity: float,
    step: float,
) -> tuple[ControlledMotion, ...]:
    """All force-controlled motions in order of the walls.

    `velocity` [m/s]: maximum expected impact velocity, at which `law` gives the stiffness of `pair_cases`;
    `step` [s].

    Raises SceneError for a motion that is unstable with the step.
    """
    controlled_motions = []
    for index, wall in enumerate(walls):
        for number, motion in enumerate(wall.motions):
            if isinstance(motion, ForceControlledMotion):
                layer = _layer(scene, wall, motion.direction, law, pair_cases, velocity, step)
                unstable = motion.instability(layer, step)
                if unstable is not None:
                    key, sentence = unstable
                    location = scene.locate("walls", wall.name, "motion", number, key)
                    raise SceneError(f"{location}: walls.{wall.name}.motion.{key} {sentence}")
                numbers = motion.numbers(wall.area or 0.0, scene.gravity_at_start, layer, step)
                source = scene.where("walls", wall.name, "motion", number)
                controlled_motions.append(ControlledMotion(index, number, wall.name, motion, numbers, source))
    return tuple(controlled_motions)


def _layer(
    scene: Scene,
    wall: PlannedWall,
    direction: Vector3,
    law: NormalLaw,
    pair_cases: Sequence[PairCase],
    velocity: float,
    step: float,
) -> WallContacts:
    """The contacts of a layer of particles on the wall.

    A layer of spheres of radius r in closest packing has one sphere per area 2 sqrt(3) r^2 of the wall.
    """
    radius = min(pair_case.radius for pair_case in pair_cases)
    area = wall.area or section(scene.domain, direction)
    sphere_count = sum(group.sphere_count for group in scene.particles.values())
    in_layer = area / (2.0 * sqrt(3.0) * radius**2)
    responses = [
        (*law.present_response(*case.dashpot_arguments, velocity, step), case.resistance[0])
        for case in pair_cases
    ]
    return WallContacts(
        contact_count=max(min(sphere_count, in_layer), 1.0),
        stiffness=max(
            law.loading_stiffness(case.pair, case.radius_eff, case.mass_eff, velocity) for case in pair_cases
        ),
        resistance=max(
            viscosity + liquid + 0.5 * step * stiffness for stiffness, viscosity, liquid in responses
        ),
    )


def section(domain: Domain, direction: Sequence[float] | np.ndarray) -> float:
    """Projected area [m2] of the domain along a direction (3,), unit vector."""
    size = np.subtract(domain.max, domain.min)
    return float(np.abs(direction) @ [size[1] * size[2], size[2] * size[0], size[0] * size[1]])
