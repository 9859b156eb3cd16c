"""Features: parts of the simulator that a scene needs. All other parts are not compiled."""

from collections.abc import Mapping
from dataclasses import dataclass, fields

from granflow.contact import registry
from granflow.contact.law import FRICTION, ContactModel
from granflow.load import Scene
from granflow.plan.groups import CLASSES_FROM_RATIO, diameter_range, size_classes
from granflow.plan.walls import has_belt, is_force_controlled
from granflow.scene.blocks.run import Damping


@dataclass(frozen=True)
class Features:
    """Compile-time switches of the kernels. A feature that is off costs no time and no memory.

    All are derived from the scene by `features_of`; `granflow explain` shows each one with its reason. Taichi
    compiles only the branches of features that are on.
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

    `models`: active contact models by slot; `law_is_damped`: whether the normal contact model has a viscous
    term, so that forces depend on synchronized velocities; `has_joined_walls`: whether surfaces of walls may
    touch. Rotation is on only with friction, rolling or twisting friction, or with clumps: otherwise no
    torque exists.
    """
    classes = size_classes(scene.particles)
    clumps = any(group.clump for group in scene.particles.values())
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


# Reasons for the features of a scene, with the lines that determine them.


@dataclass(frozen=True)
class Reason:
    """One line of `granflow explain`: a feature, its setting, and the reason."""

    feature: str
    setting: str
    why: str


def reasons_for(scene: Scene, features: Features) -> tuple[Reason, ...]:
    """Reason for the setting of each feature, with the line of the scene that determines it.

    In the order of the fields of Features.
    """
    reasons = {
        "friction": _model_reason(scene, "tangential", features.friction),
        "rolling": _model_reason(scene, "rolling", features.rolling != "none"),
        "twisting": _model_reason(scene, "twisting", features.twisting != "none"),
        "rotation": (
            "required by "
            f"{'clumps' if features.clumps else 'friction, rolling friction or twisting friction'}"
            if features.rotation
            else "no torques: every pair has friction and rolling friction 0"
        ),
        "rate_dependent": _rate_reason(scene, features),
        "cohesion": _model_reason(scene, "cohesion", features.cohesion != "none"),
        "walls": _walls_reason(scene),
        "moving_walls": _moving_reason(scene, features),
        "surface_velocity": _belt_reason(scene, features),
        "force_controlled_walls": _force_controlled_reason(scene, features),
        "mesh_walls": _mesh_reason(scene, features),
        "joined_walls": (
            "the surfaces of walls, or parts of a mesh, may touch: a contact found on several of them counts "
            "once"
            if features.joined_walls
            else "the surfaces of the walls do not touch each other"
        ),
        "one_material": _material_reason(scene),
        "energy_budget": (
            f"output.energy_budget is {'on' if features.energy_budget else 'off'} "
            f"({scene.where('output', 'energy_budget')})"
        ),
        "wall_forces": _wall_forces_reason(scene, features),
        "collision_energies": (
            f"output.collision_energies is {'given' if features.collision_energies else 'absent'} "
            f"({scene.where('output', 'collision_energies')})"
        ),
        "adaptive_step": _time_step_reason(scene),
        "periodic": f"domain.periodic ({scene.where('domain', 'periodic')})"
        if scene.domain.periodic
        else "the domain has no periodic axes",
        "lees_edwards": _lees_edwards_reason(scene),
        "fixed_particles": _fixed_reason(scene, features),
        "outlets": _outlets_reason(scene),
        "size_classes": _sizes_reason(scene),
        "damping": _damping_reason(scene),
        "clumps": _clumps_reason(scene, features),
        "liquid_transfer": _liquid_reason(scene, features),
        "velocity_remainders": f"run.precision is {scene.run.precision} ({scene.where('run', 'precision')})",
        "external_forces": "forces are added from Python only",
    }
    return tuple(
        Reason(item.name, _setting(getattr(features, item.name)), reasons[item.name])
        for item in fields(features)
    )


def _setting(value: bool | str) -> str:
    """Text of a setting: on, off, or the name or number that it contains."""
    if isinstance(value, bool):
        return "on" if value else "off"
    return "off" if value == "none" else value


def _model_reason(scene: Scene, slot: str, on: bool) -> str:
    """The first pair with a value other than 0 of a pair option of the model, or why the model is not
    active."""
    model = registry.models(slot).get(scene.contact.name(slot))
    keys = [option.key for option in model.pair_options] if model else []
    if slot == "tangential":
        keys = keys or [FRICTION.key]
    elif model is None:
        return f"contact.{slot} is none ({scene.where('contact', slot)})"
    if not keys:
        return f"contact.{slot} is {scene.contact.name(slot)} ({scene.where('contact', slot)})"
    if not on:
        return f"every pair has {' and '.join(keys)} 0"
    name, key = next((name, key) for name, pair in scene.pairs.items() for key in keys if getattr(pair, key))
    return f"pairs.{name}.{key} is {getattr(scene.pairs[name], key):g} ({scene.where('pairs', name, key)})"


def _rate_reason(scene: Scene, features: Features) -> str:
    """The damping ratio, or the property of the contact model, that makes forces depend on velocities."""
    normal = scene.contact.normal
    options = scene.contact.options("normal")
    damping_ratio = options.get("damping_ratio")
    if damping_ratio is not None:
        rests = not features.rate_dependent and options.get("rest_damping")
        addition = ", and rest_damping acts only on contacts that reload" if rests else ""
        return (
            f"contact.normal.damping_ratio is {damping_ratio:g}{addition} "
            f"({scene.where('contact', 'normal')})"
        )
    if not features.rate_dependent:
        return f"the {normal.law} contact model with these settings has no viscous force"
    return (
        f"the {normal.law} contact model obtains a restitution below 1 by damping "
        f"({scene.where('contact', 'normal')})"
    )


def _walls_reason(scene: Scene) -> str:
    if not scene.walls:
        return "the scene has no walls"
    return f"{', '.join(scene.walls)} ({scene.where('walls')})"


def _moving_reason(scene: Scene, features: Features) -> str:
    if not features.moving_walls:
        return "no wall has a motion"
    names = [name for name, wall in scene.walls.items() if wall.motion]
    return f"motion of {', '.join(names)} ({scene.where('walls', names[0], 'motion')})"


def _belt_reason(scene: Scene, features: Features) -> str:
    if not features.surface_velocity:
        return "no wall has a surface velocity"
    name = next(name for name, wall in scene.walls.items() if has_belt(wall))
    return f"surface velocity of {name} ({scene.where('walls', name, 'motion')})"


def _force_controlled_reason(scene: Scene, features: Features) -> str:
    if not features.force_controlled_walls:
        return "no wall is force-controlled"
    name = next(name for name, wall in scene.walls.items() if is_force_controlled(wall))
    kinds = " and ".join(dict.fromkeys(each.kind for each in scene.walls[name].motion))
    return f"walls.{name} is {kinds} ({scene.where('walls', name, 'motion')})"


def _mesh_reason(scene: Scene, features: Features) -> str:
    if not features.mesh_walls:
        return "no wall is a mesh"
    name = next(name for name, wall in scene.walls.items() if wall.shape == "mesh")
    return f"walls.{name} is a mesh ({scene.where('walls', name, 'shape')})"


def _wall_forces_reason(scene: Scene, features: Features) -> str:
    if not features.wall_forces:
        return f"output.wall_forces selects no wall ({scene.where('output', 'wall_forces')})"
    return (
        f"output.wall_forces selects {', '.join(scene.measured_walls)} "
        f"({scene.where('output', 'wall_forces')})"
    )


def _outlets_reason(scene: Scene) -> str:
    return (
        f"{', '.join(scene.outlets)} ({scene.where('outlets')})"
        if scene.outlets
        else "the scene has no outlets"
    )


def _fixed_reason(scene: Scene, features: Features) -> str:
    if not features.fixed_particles:
        return "no group of particles is fixed"
    name = next(name for name, group in scene.particles.items() if group.fixed)
    return f"particles.{name} is fixed ({scene.where('particles', name, 'fixed')})"


def _clumps_reason(scene: Scene, features: Features) -> str:
    if not features.clumps:
        return "no group of particles has clumps"
    names = [name for name, group in scene.particles.items() if group.clump]
    return f"{', '.join(names)} ({scene.where('particles', names[0], 'clump')})"


def _liquid_reason(scene: Scene, features: Features) -> str:
    if not features.liquid_transfer:
        return "no cohesion model takes liquid from films on the particles"
    return f"contact.cohesion is {features.cohesion} ({scene.where('contact', 'cohesion')})"


def _time_step_reason(scene: Scene) -> str:
    setting = scene.run.time_step if isinstance(scene.run.time_step, str) else "a number"
    return f"run.time_step is {setting} ({scene.where('run', 'time_step')})"


def _lees_edwards_reason(scene: Scene) -> str:
    lees_edwards = scene.domain.lees_edwards
    if lees_edwards is None:
        return "the domain is not sheared"
    description = f"flow along {lees_edwards.flow}, gradient along {lees_edwards.gradient}"
    return f"shear rate {lees_edwards.rate:g} 1/s, {description} ({scene.where('domain', 'lees_edwards')})"


def _sizes_reason(scene: Scene) -> str:
    """The ratio of the largest to the smallest diameter."""
    spans = [diameter_range(group) for group in scene.particles.values()]
    ratio = max(high for _, high in spans) / min(low for low, _ in spans)
    if ratio < CLASSES_FROM_RATIO:
        return f"the largest diameter is less than {CLASSES_FROM_RATIO:g} times the smallest"
    return f"the largest diameter is {ratio:.3g} times the smallest ({scene.where('particles')})"


def _damping_reason(scene: Scene) -> str:
    """Numbers of the damping and its stages."""
    if scene.damping is None:
        return "the scene has no damping"
    numbers = [f"damping.{kind} is {getattr(scene.damping, kind):g}" for kind in damping_kinds(scene.damping)]
    stages = "in all stages" if scene.damping.stages is None else f"in {', '.join(scene.damping.stages)}"
    return f"{' and '.join(numbers)} {stages} ({scene.where('damping')})"


def _material_reason(scene: Scene) -> str:
    materials = sorted({group.material for group in scene.particles.values()})
    names = ", ".join(materials)
    return (
        f"all particles are of the material {names}"
        if len(materials) == 1
        else f"the particles are of the materials {names}"
    )
