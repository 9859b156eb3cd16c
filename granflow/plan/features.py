"""Features: parts of the simulator that a scene needs. All other parts are not compiled."""

from collections.abc import Mapping
from dataclasses import dataclass

from granflow.contact import registry
from granflow.contact.model import ContactModel
from granflow.load import Scene
from granflow.plan.size_classes import size_classes
from granflow.plan.walls import has_belt, is_force_controlled
from granflow.scene.schema.damping import Damping


@dataclass(frozen=True)
class Features:
    """Compile-time switches of the kernels. A feature that is off costs no time and no memory.

    All are derived from the scene by `features_of`; `granflow explain` shows each one with its reason. Taichi compiles
    only the branches of features that are on.
    """

    friction: bool
    rolling: str
    """Name of the rolling model, or "none"."""
    twisting: str
    """Name of the twisting model, or "none"."""
    rotation: bool
    rate_dependent: bool
    cohesion: str
    """Name of the cohesion model, or "none"."""
    walls: bool
    moving_walls: bool
    surface_velocity: bool
    force_controlled_walls: bool
    mesh_walls: bool
    joined_walls: bool
    one_material: bool
    energy_budget: bool
    wall_forces: bool
    collision_energies: bool
    adaptive_step: bool
    periodic: str
    """Periodic axes, such as "x, y", or "none"."""
    lees_edwards: bool
    fixed_particles: bool
    outlets: bool
    size_classes: str
    """Number of size classes with separate cell grids, or "none"."""
    damping: str
    """Kinds of damping of all motion, "cundall", "drag" or both, or "none"."""
    clumps: bool = False
    liquid_transfer: bool = False
    """Whether the cohesion model takes liquid from films on the particles."""
    velocity_remainders: bool = False
    """Whether velocities in float32 keep what rounding takes from their changes."""
    external_forces: bool = False
    """Forces from Python, see `Plan.external_forces`; never from the scene."""


def features_of(
    scene: Scene, models: Mapping[str, ContactModel], law_is_damped: bool, has_joined_walls: bool
) -> Features:
    """Derive all features from the scene.

    `models`: active contact models by slot; `law_is_damped`: whether the normal contact model has a viscous term, so
    that forces depend on synchronized velocities; `has_joined_walls`: whether surfaces of walls may touch. Rotation is
    on only with friction, rolling or twisting friction, or with clumps: otherwise no torque exists.
    """
    classes, clumps = size_classes(scene.particles), any(group.clump for group in scene.particles.values())
    return Features(
        friction="tangential" in models,
        rolling=_name(models, "rolling"),
        twisting=_name(models, "twisting"),
        rotation=clumps or any(slot in models for slot in ("tangential", "rolling", "twisting")),
        rate_dependent=law_is_damped,
        cohesion=_name(models, "cohesion"),
        walls=bool(scene.walls),
        moving_walls=any(wall.motion for wall in scene.walls.values()),
        surface_velocity=any(has_belt(wall) for wall in scene.walls.values()),
        force_controlled_walls=any(is_force_controlled(wall) for wall in scene.walls.values()),
        mesh_walls=any(wall.shape == "mesh" for wall in scene.walls.values()),
        joined_walls=has_joined_walls,
        one_material=len({group.material for group in scene.particles.values()}) == 1,
        energy_budget=scene.output.energy_budget,
        wall_forces=bool(scene.measured_walls),
        collision_energies=scene.output.collision_energies is not None,
        adaptive_step=scene.run.time_step == "adaptive",
        periodic=", ".join(scene.domain.periodic) or "none",
        lees_edwards=scene.domain.lees_edwards is not None,
        fixed_particles=any(group.fixed for group in scene.particles.values()),
        outlets=bool(scene.outlets),
        size_classes=str(len(classes)) if len(classes) > 1 else "none",
        damping=" and ".join(damping_kinds(scene.damping)) or "none",
        clumps=clumps,
        liquid_transfer=_name(models, "cohesion") in registry.liquid_models(),
        velocity_remainders=scene.run.precision != "f64",
    )


def _name(models: Mapping[str, ContactModel], slot: str) -> str:
    return models[slot].name if slot in models else "none"


def damping_kinds(damping: Damping | None) -> list[str]:
    """Kinds of damping of all motion that a scene requests."""
    return [kind for kind in ("cundall", "drag") if getattr(damping, kind, None) is not None]
