"""Force-controlled walls: servo walls with a target force, and free walls with a mass.

The forces of the particles move these walls. A motion is stable only if it is slow enough for the contacts
of a layer of particles on the wall; gain, lag and smallest mass follow from the stiffness and viscosity of
such a layer and from the time step.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import sqrt
from typing import Any, Literal

import numpy as np

from granflow.contact.law import NormalLaw
from granflow.errors import SceneError
from granflow.load import Scene
from granflow.plan.time_step import PairCase
from granflow.plan.walls import PlannedWall
from granflow.scene.blocks.domain import Domain


@dataclass(frozen=True)
class ControlledMotion:
    """One force-controlled motion: index of the wall, index of the motion of this wall, and its parameters.

    `force` [N] along the unit vector `direction`: target force of a servo on the particles; applied force and
    weight of a free wall.
    """

    wall: int
    motion: int
    name: str
    kind: Literal["servo", "free"]
    direction: tuple[float, float, float]
    force: float
    gain: float
    """Servo: velocity per force error [m/(s N)]."""
    lag: float
    """Servo: time [steps] in which its velocity follows the force error."""
    velocity_max: float
    """Servo: maximum velocity [m/s]."""
    mass: float
    """Free wall: mass [kg]."""
    damping: float
    """Free wall: damping [kg/s]."""
    source: str
    """Line of the motion in the scene file."""

    def approach(self, error: float) -> tuple[float, str]:
        """Velocity [m/s] of a servo at a force error [N] of either sign, and the limit that determines it in
        words."""
        velocity = self.gain * abs(error)
        if velocity < self.velocity_max:
            force = "force" if error == self.force else "force error"
            return velocity, f"gain times {force}, less than velocity_max {self.velocity_max:.3g} m/s"
        return self.velocity_max, "velocity_max"

    @property
    def key(self) -> str:
        """Key in messages and checkpoints."""
        return f"walls.{self.name}.motion.{self.motion}"


@dataclass(frozen=True)
class WallContacts:
    """Contacts of a layer of particles on a wall.

    count:       of contacts
    stiffness:   [N/m] of one contact at the maximum impact velocity
    resistance:  C + K dt / 2 [N s/m] of one contact, with the largest tangent stiffness K and viscosity C
                 that it can have, see `NormalLaw.present_response`
    """

    count: float
    stiffness: float
    resistance: float


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
        for number, given in enumerate(wall.motions):
            if given.force_controlled:
                layer = _layer(scene, wall, given, law, pair_cases, velocity, step)
                controlled = _servo if given.kind == "servo" else _free
                controlled_motions.append(controlled(scene, index, wall, number, given, layer, step))
    return tuple(controlled_motions)


GAIN_SHARE = 0.2
"""Share of the force error that a servo corrects in one step, if all particles within reach are in
contact."""
MAX_GAIN = 2.0
"""This share at which the overshoot of a servo grows from step to step."""


def _servo(
    scene: Scene, index: int, wall: PlannedWall, number: int, given: Any, layer: WallContacts, step: float
) -> ControlledMotion:
    """A servo approaches v = gain (F - f), limited to velocity_max, within `lag` steps.

    Contacts of stiffness K change their force by K dt v = gain K dt (F - f) in a step: for gain K dt < 2 the
    force error decreases in every step. The servo is a dashpot of 1/gain: it dissipates energy of the
    particles.

    With v' = v + (gain (F - f) - v) / (1 + lag), the characteristic equation on contacts of stiffness K and
    viscosity C

        z^2 - (1 + p - gain K dt / (1 + lag)) z + p = 0,     p = (lag - gain C) / (1 + lag)

    has both roots inside the unit circle for lag >= gain (C + K dt / 2), because then 0 <= p < 1 and 2 + 2 p
    exceeds gain K dt / (1 + lag). Without lag the wall would overshoot at every step on contacts with gain C
    > 1: the force that it reacts to contains that of its own velocity.
    """
    max_gain = MAX_GAIN / (layer.stiffness * step)
    default_gain = GAIN_SHARE / (layer.count * layer.stiffness * step)
    gain = default_gain if given.gain is None else given.gain
    if given.gain is not None and gain > max_gain:
        location = scene.locate("walls", wall.name, "motion", number, "gain")
        raise SceneError(
            f"{location}: walls.{wall.name}.motion.gain is {gain:.3g} m/(s N), but from {max_gain:.3g} "
            f"on the wall overshoots at every step of {step:.3g} s. Without the key it is {default_gain:.2g}."
        )
    force = given.force
    if force is None:
        force = given.pressure * (wall.surface.area or 0.0)
    return ControlledMotion(
        wall=index,
        motion=number,
        name=wall.name,
        kind="servo",
        direction=given.direction,
        force=force,
        gain=gain,
        lag=gain * layer.count * layer.resistance,
        velocity_max=given.velocity_max,
        mass=1.0,
        damping=0.0,
        source=scene.where("walls", wall.name, "motion", number),
    )


def _free(
    scene: Scene, index: int, wall: PlannedWall, number: int, given: Any, layer: WallContacts, step: float
) -> ControlledMotion:
    """A free wall of mass M on contacts of stiffness K and viscosity C is stable for M > (C + K dt / 2) dt /
    2.

    The least mass is twice as large, and at least K dt^2 [kg], with the contacts of a layer of particles.
    Raises SceneError for a smaller mass.
    """
    min_mass = layer.count * step * max(layer.resistance, layer.stiffness * step)
    if given.mass < min_mass:
        location = scene.locate("walls", wall.name, "motion", number, "mass")
        raise SceneError(
            f"{location}: walls.{wall.name}.motion.mass is {given.mass:.3g} kg, but with contacts of all "
            f"particles within reach the wall oscillates too fast for a step of {step:.3g} s: set it to "
            f"{min_mass:.2g} kg or more, or lower run.time_step."
        )
    direction = given.direction
    weight = given.mass * float(np.dot(scene.gravity, direction))
    return ControlledMotion(
        wall=index,
        motion=number,
        name=wall.name,
        kind="free",
        direction=direction,
        force=given.force + weight,
        gain=0.0,
        lag=0.0,
        velocity_max=0.0,
        mass=given.mass,
        damping=given.damping,
        source=scene.where("walls", wall.name, "motion", number),
    )


def _layer(
    scene: Scene,
    wall: PlannedWall,
    given: Any,
    law: NormalLaw,
    pair_cases: Sequence[PairCase],
    velocity: float,
    step: float,
) -> WallContacts:
    """The contacts of a layer of particles on the wall.

    A layer of spheres of radius r in closest packing has one sphere per area 2 sqrt(3) r^2 of the wall.
    """
    radius = min(pair_case.radius for pair_case in pair_cases)
    area = wall.surface.area or section(scene.domain, given.direction)
    sphere_count = sum(group.sphere_count for group in scene.particles.values())
    in_layer = area / (2.0 * sqrt(3.0) * radius**2)
    responses = [law.present_response(*case.dashpot_arguments, velocity, step) for case in pair_cases]
    return WallContacts(
        count=max(min(sphere_count, in_layer), 1.0),
        stiffness=max(
            law.loading_stiffness(case.pair, case.radius_eff, case.mass_eff, velocity) for case in pair_cases
        ),
        resistance=max(viscosity + 0.5 * step * stiffness for stiffness, viscosity in responses),
    )


def section(domain: Domain, direction: Sequence[float] | np.ndarray) -> float:
    """Projected area [m2] of the domain along a direction (3,), unit vector."""
    size = np.subtract(domain.max, domain.min)
    return float(np.abs(direction) @ [size[1] * size[2], size[2] * size[0], size[0] * size[1]])


def describe(controlled: ControlledMotion) -> Iterator[tuple[str, str]]:
    """Names and values of the parameters of a force-controlled motion, for `granflow explain`."""
    if controlled.kind == "servo":
        yield "target force", f"{controlled.force:.4g} N"
        yield "gain", f"{controlled.gain:.3g} m/(s N)"
        yield "lag", f"{controlled.lag:.3g} steps"
        yield "maximum velocity", f"{controlled.velocity_max:.3g} m/s"
    else:
        yield "mass", f"{controlled.mass:.4g} kg"
        yield "force and weight", f"{controlled.force:.4g} N"
        yield "damping", f"{controlled.damping:.3g} kg/s"
