"""Features: parts of the simulator that a scene needs. All other parts are not compiled.

The features follow from the scene alone. `features_of` is a table with one row per feature: its value, and
the reason with the line of the scene that determines it. The kernels read the values at compile time;
`granflow explain` prints the rows.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

from granflow.contact import registry
from granflow.contact.law import SLOTS, ContactModel
from granflow.contact.registry import ContactLaws
from granflow.load import Scene
from granflow.plan.size_classes import CLASSES_FROM_RATIO, size_classes
from granflow.scene.blocks.gravity import motions_of, vectors_of
from granflow.scene.blocks.run import Damping


@dataclass(frozen=True)
class Features:
    """Compile-time switches of the kernels. A feature that is off costs no time and no memory.

    All are derived from the scene by `features_of`; `granflow explain` shows each one with its reason. Taichi
    compiles only the branches of features that are on.
    """

    rotation: bool
    rate_dependent: bool
    walls: bool
    moving_walls: bool
    surface_velocity: bool
    force_controlled_walls: bool
    mesh_walls: bool
    joined_walls: bool
    one_material: bool
    one_size: bool
    """Whether all particles are equal spheres of one material, so that radius and mass are two numbers."""
    energy_budget: bool
    wall_forces: bool
    collision_energies: bool
    adaptive_step: bool
    periodic: str
    """Periodic axes, such as "x, y", or "none"."""
    lees_edwards: bool
    fixed_particles: bool
    attached_particles: bool
    outlets: bool
    size_classes: str
    """Number of size classes with separate cell grids, or "none"."""
    damping: str
    """Kinds of damping of all motion, "cundall", "drag" or both, or "none"."""
    clumps: bool = False
    liquid_transfer: bool = False
    """Whether the cohesion model takes liquid from films on the particles."""
    viscous_cohesion: bool = False
    """Whether the cohesion model has a viscous force."""
    velocity_remainders: bool = False
    """Whether velocities in float32 keep what rounding takes from their changes."""
    flows: tuple[str, ...] = ()
    """What flows through contacts and is summed for each particle; particle equations read the sums."""
    sources: tuple[str, ...] = ()
    """Sources of flows in each particle that a group or a stage of the scene has."""
    loss_heat: bool = False
    """Whether the losses of contacts become heat of the particles."""
    wear: bool = False
    """Whether walls wear."""
    wall_groups: bool = False
    """Whether particles of some groups pass through a wall."""
    deforming_box: bool = False
    """Whether the widths of the periodic box change."""
    changing_gravity: bool = False
    """Whether gravity changes with time, or in a stage."""
    external_forces: bool = False
    """Forces from Python, see `Plan.external_forces`; never from the scene."""

    @property
    def synchronized(self) -> bool:
        """Whether forces depend on velocities at the time of the positions."""
        return self.rate_dependent or self.viscous_cohesion

    @property
    def moving_images(self) -> bool:
        """Whether images across periodic boundaries have another velocity than their originals."""
        return self.lees_edwards or self.deforming_box

    @property
    def loss_heat_ahead(self) -> bool:
        """Whether heat of losses belongs to the next half step in part, as that of viscous forces."""
        return self.loss_heat and self.viscous_cohesion


@dataclass(frozen=True)
class Reason:
    """One line of `granflow explain`: a feature, its setting, and the reason."""

    feature: str
    setting: str
    why: str


def features_of(
    scene: Scene,
    models: Mapping[str, ContactModel],
    laws: ContactLaws,
    has_joined_walls: bool,
    mesh_walls: Sequence[str],
) -> tuple[Features, tuple[Reason, ...]]:
    """All features of the scene, and the reasons of all of them and of the contact models but the normal one.

    `models`, `laws`: active contact models by slot, and their laws; `has_joined_walls`: whether surfaces of
    walls may touch; `mesh_walls`: names of the walls with a mesh.
    """
    rows = list(_rows(scene, models, laws, has_joined_walls, mesh_walls))
    names = {each.name for each in fields(Features)}
    values: dict[str, Any] = {name: value for name, value, _ in rows if name in names}
    reasons = tuple(Reason(name, _setting(value), why) for name, value, why in rows)
    return Features(**values), reasons


def _setting(value: bool | str | tuple[str, ...]) -> str:
    """Text of a setting: on, off, or the names or the number that it contains."""
    if isinstance(value, tuple):
        return ", ".join(value)
    if isinstance(value, bool):
        return "on" if value else "off"
    return "off" if value == "none" else value


def _rows(
    scene: Scene,
    models: Mapping[str, ContactModel],
    laws: ContactLaws,
    has_joined_walls: bool,
    mesh_walls: Sequence[str],
) -> Iterator[tuple[str, bool | str | tuple[str, ...], str]]:
    """Name, value and reason of each feature. Arguments as of `features_of`."""
    walls = scene.walls
    groups = scene.particles
    where = scene.where

    # Contacts.
    yield from (_model_row(scene, models, slot) for slot in SLOTS if SLOTS[slot].on_surface)
    clumps = [name for name, group in groups.items() if group.shape.body is not None]
    rotating = any(group.shape.rotates for group in groups.values())
    has_torques = any(SLOTS[slot].on_surface for slot in models)
    spinning = [name for name, group in groups.items() if group.initial_rotation_rate > 0.0]
    if rotating:
        why = "required by clumps"
    elif has_torques:
        why = "required by friction, rolling friction or twisting friction"
    elif laws.has_viscous_cohesion:
        why = "required by the viscous force of the cohesion model"
    elif spinning:
        why = f"particles.{spinning[0]} has an initial angular velocity ({where('particles', spinning[0])})"
    else:
        why = "no torques: every pair has friction and rolling friction 0"
    yield "rotation", rotating or has_torques or laws.has_viscous_cohesion or bool(spinning), why
    yield "rate_dependent", laws.normal.rate_dependent, _rate_reason(scene, laws.normal.rate_dependent)
    cohesion = models["cohesion"].name if "cohesion" in models else "none"
    yield _model_row(scene, models, "cohesion")
    if laws.has_viscous_cohesion:
        place = where("contact", "cohesion")
        yield "viscous_cohesion", True, f"{cohesion} with these settings has a viscous force ({place})"

    # Walls.
    yield (
        "walls",
        bool(walls),
        f"{', '.join(walls)} ({where('walls')})" if walls else "the scene has no walls",
    )
    moving = [name for name, wall in walls.items() if wall.motion]
    yield (
        "moving_walls",
        bool(moving),
        f"motion of {', '.join(moving)} ({where('walls', moving[0], 'motion')})"
        if moving
        else "no wall has a motion",
    )
    belts = [name for name, wall in walls.items() if wall.has_belt]
    yield (
        "surface_velocity",
        bool(belts),
        f"surface velocity of {belts[0]} ({where('walls', belts[0], 'motion')})"
        if belts
        else "no wall has a surface velocity",
    )
    controlled = [name for name, wall in walls.items() if wall.is_force_controlled]
    yield (
        "force_controlled_walls",
        bool(controlled),
        f"walls.{controlled[0]} is {_kinds_of_motion(scene, controlled[0])} "
        f"({where('walls', controlled[0], 'motion')})"
        if controlled
        else "no wall is force-controlled",
    )
    yield (
        "mesh_walls",
        bool(mesh_walls),
        f"walls.{mesh_walls[0]} is a mesh ({where('walls', mesh_walls[0], 'shape')})"
        if mesh_walls
        else "no wall is a mesh",
    )
    yield (
        "joined_walls",
        has_joined_walls,
        "the surfaces of walls, or parts of a mesh, may touch: a contact found on several of them counts once"
        if has_joined_walls
        else "the surfaces of the walls do not touch each other",
    )
    materials = sorted({group.material for group in groups.values()})
    yield (
        "one_material",
        len(materials) == 1,
        f"all particles are of the material {materials[0]}"
        if len(materials) == 1
        else f"the particles are of the materials {', '.join(materials)}",
    )
    yield "one_size", *_one_size(scene, len(materials) == 1)

    # Output.
    output = scene.output
    yield (
        "energy_budget",
        output.energy_budget,
        f"output.energy_budget is {'on' if output.energy_budget else 'off'} "
        f"({where('output', 'energy_budget')})",
    )
    yield (
        "wall_forces",
        bool(scene.measured_walls),
        f"output.wall_forces selects {', '.join(scene.measured_walls) or 'no wall'} "
        f"({where('output', 'wall_forces')})",
    )
    has_energies = output.collision_energies is not None
    yield (
        "collision_energies",
        has_energies,
        f"output.collision_energies is {'given' if has_energies else 'absent'} "
        f"({where('output', 'collision_energies')})",
    )

    # Run and domain.
    time_step = scene.run.time_step if isinstance(scene.run.time_step, str) else "a number"
    yield (
        "adaptive_step",
        time_step == "adaptive",
        f"run.time_step is {time_step} ({where('run', 'time_step')})",
    )
    yield (
        "periodic",
        ", ".join(scene.domain.periodic) or "none",
        f"domain.periodic ({where('domain', 'periodic')})"
        if scene.domain.periodic
        else "the domain has no periodic axes",
    )
    shear = scene.domain.lees_edwards
    yield (
        "lees_edwards",
        shear is not None,
        "the domain is not sheared"
        if shear is None
        else f"shear rate {shear.rate:g} 1/s, flow along {shear.flow}, gradient along {shear.gradient} "
        f"({where('domain', 'lees_edwards')})",
    )
    deforming = [".".join(map(str, path)) + f" ({where(*path)})" for path, _ in scene.deformations()]
    if deforming:
        yield "deforming_box", True, f"the widths follow {', '.join(deforming)}"

    # Particles.
    fixed = [name for name, group in groups.items() if group.fixed]
    yield (
        "fixed_particles",
        bool(fixed),
        f"particles.{fixed[0]} is fixed ({where('particles', fixed[0], 'fixed')})"
        if fixed
        else "no group of particles is fixed",
    )
    attached = [(name, group.attached_to) for name, group in groups.items() if group.attached_to]
    yield (
        "attached_particles",
        bool(attached),
        f"particles.{attached[0][0]} moves with the wall {attached[0][1]} "
        f"({where('particles', attached[0][0], 'fixed')})"
        if attached
        else "no particles move with a wall",
    )
    yield (
        "outlets",
        bool(scene.outlets),
        f"{', '.join(scene.outlets)} ({where('outlets')})" if scene.outlets else "the scene has no outlets",
    )
    classes = len(size_classes(groups))
    yield "size_classes", str(classes) if classes > 1 else "none", _sizes_reason(scene)
    yield "damping", " and ".join(_damping_kinds(scene.damping)) or "none", _damping_reason(scene)
    yield (
        "clumps",
        bool(clumps),
        f"{', '.join(clumps)} ({where('particles', clumps[0], 'clump')})"
        if clumps
        else "no group of particles has clumps",
    )
    takes_liquid = cohesion in registry.liquid_models()
    yield (
        "liquid_transfer",
        takes_liquid,
        f"contact.cohesion is {cohesion} ({where('contact', 'cohesion')})"
        if takes_liquid
        else "no cohesion model takes liquid from films on the particles",
    )
    yield (
        "velocity_remainders",
        scene.run.precision != "f64",
        f"run.precision is {scene.run.precision} ({where('run', 'precision')})",
    )
    flows = {name: f"contact.{slot}" for slot, model in models.items() for name in model.law.flows}
    if flows:
        why = f"through the contacts of {', '.join(dict.fromkeys(flows.values()))}"
        changed = [each.name for each in registry.equations_with(tuple(flows))]
        yield "flows", tuple(flows), why + (f"; they change the {' and '.join(changed)}" if changed else "")
    sources = {
        source.name: scene.where(*scene.places_of(source.name)[0])
        for model in models.values()
        for flow in model.law.flows.values()
        if (source := flow.source) is not None and scene.places_of(source.name)
    }
    if sources:
        yield "sources", tuple(sources), f"given in {', '.join(sources.values())}"
    if getattr(scene.contact.options("heat"), "from_dissipation", False):
        place = where("contact", "heat", "from_dissipation")
        yield "loss_heat", True, f"contact.heat.from_dissipation is true ({place})"
    worn = [name for name, wall in walls.items() if wall.wear is not None]
    if worn:
        yield "wear", True, f"wear of {', '.join(worn)} ({where('walls', worn[0], 'wear')})"
    selective = [name for name, wall in walls.items() if wall.groups is not None]
    if selective:
        place = where("walls", selective[0], "groups")
        yield "wall_groups", True, f"some groups pass through {', '.join(selective)} ({place})"
    if scene.gravity_changes:
        yield "changing_gravity", True, _gravity_reason(scene)
    yield "external_forces", False, "forces are added from Python only"


def _gravity_reason(scene: Scene) -> str:
    """What changes gravity: its motions, its table, or stages."""
    motions = motions_of(scene.gravity)
    if motions:
        kinds = " and ".join(dict.fromkeys(each.kind for each in motions))
        return f"{kinds} of gravity ({scene.where('gravity', 'motion')})"
    if len(vectors_of(scene.gravity)) > 1:
        return f"table of gravity ({scene.where('gravity', 'vectors')})"
    index = next(number for number, each in enumerate(scene.stages) if each.gravity is not None)
    return f"gravity of stage {scene.stages[index].name} ({scene.where('stages', index, 'gravity')})"


def _one_size(scene: Scene, one_material: bool) -> tuple[bool, str]:
    """Whether all particles have one radius and one mass in contacts, and the reason.

    Clumps have the mass of the clump, fixed particles an infinite one.
    """
    groups = scene.particles
    smallest = min(group.diameters[0] for group in groups.values())
    largest = max(group.diameters[1] for group in groups.values())
    other = [name for name, group in groups.items() if group.fixed or group.shape.body is not None]
    if smallest < largest:
        return False, f"the diameters are {smallest:.4g} to {largest:.4g} m"
    if not one_material:
        return False, "the particles are of several materials"
    if other:
        return False, f"particles.{other[0]} is fixed, or has clumps ({scene.where('particles', other[0])})"
    return True, f"all particles have the diameter {largest:.4g} m and one material"


def _model_row(scene: Scene, models: Mapping[str, ContactModel], slot: str) -> tuple[str, bool | str, str]:
    """Row of the contact model of a slot: its name, or for friction whether there is any."""
    reason = _model_reason(scene, models, slot)
    if slot == "tangential":
        return "friction", slot in models, reason
    return slot, models[slot].name if slot in models else "none", reason


def _model_reason(scene: Scene, models: Mapping[str, ContactModel], slot: str) -> str:
    """The first pair with a value other than 0 of a pair property of the model, or why the model is not
    active."""
    model = registry.models(slot).get(scene.contact.name(slot))
    keys = list(model.pair_properties.model_fields) if model else []
    if slot == "tangential":
        keys = keys or ["friction"]
    elif model is None:
        return f"contact.{slot} is none ({scene.where('contact', slot)})"
    if not keys:
        return f"contact.{slot} is {scene.contact.name(slot)} ({scene.where('contact', slot)})"
    if slot not in models:
        return f"every pair has {' and '.join(keys)} 0"
    name, key = next((name, key) for name, pair in scene.pairs.items() for key in keys if getattr(pair, key))
    return f"pairs.{name}.{key} is {getattr(scene.pairs[name], key):g} ({scene.where('pairs', name, key)})"


def _rate_reason(scene: Scene, law_is_damped: bool) -> str:
    """The key, or the property of the contact model, that makes forces depend on velocities."""
    normal = scene.contact.normal
    place = scene.where("contact", "normal")
    reason = scene.contact.options("normal").rate_reason
    if reason:
        return f"{reason} ({place})"
    if law_is_damped:
        return f"the {normal.law} contact model obtains a restitution below 1 by damping ({place})"
    return f"the {normal.law} contact model with these settings has no viscous force"


def _kinds_of_motion(scene: Scene, wall: str) -> str:
    return " and ".join(dict.fromkeys(each.kind for each in scene.walls[wall].motion))


def _sizes_reason(scene: Scene) -> str:
    """The ratio of the largest to the smallest diameter."""
    spans = [group.diameters for group in scene.particles.values()]
    ratio = max(high for _, high in spans) / min(low for low, _ in spans)
    if ratio < CLASSES_FROM_RATIO:
        return f"the largest diameter is less than {CLASSES_FROM_RATIO:g} times the smallest"
    return f"the largest diameter is {ratio:.3g} times the smallest ({scene.where('particles')})"


def _damping_kinds(damping: Damping | None) -> list[str]:
    """Kinds of damping of all motion that a scene requests."""
    return [kind for kind in ("cundall", "drag") if getattr(damping, kind, None) is not None]


def _damping_reason(scene: Scene) -> str:
    """Numbers of the damping and its stages."""
    if scene.damping is None:
        return "the scene has no damping"
    numbers = [
        f"damping.{kind} is {getattr(scene.damping, kind):g}" for kind in _damping_kinds(scene.damping)
    ]
    stages = "in all stages" if scene.damping.stages is None else f"in {', '.join(scene.damping.stages)}"
    return f"{' and '.join(numbers)} {stages} ({scene.where('damping')})"
