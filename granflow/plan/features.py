"""Which parts of the simulator a scene needs, and why: everything else is left out."""

from dataclasses import dataclass, fields
from typing import Literal

from granflow.plan.sizes import WIDE, diameter_range, size_classes
from granflow.plan.walls import is_driven
from granflow.scene import Scene


@dataclass(frozen=True)
class Features:
    """Switches that kernels are compiled with. What is off costs no time and no memory."""

    friction: bool
    rolling: Literal["none", "epsd", "cdt"]
    rotation: bool
    rate_dependent: bool
    adhesion: Literal["none", "sjkr"]
    walls: bool
    moving_walls: bool
    driven_walls: bool
    mesh_walls: bool
    one_material: bool
    ledger: bool
    loads: bool
    adaptive_step: bool
    periodic: str
    """Periodic axes, such as "x, y", or "none"."""
    shear: bool
    fixed_grains: bool
    outlets: bool
    size_classes: str
    """Number of classes of sizes that the search takes one by one, or "none"."""


@dataclass(frozen=True)
class Reason:
    """One line of `granflow explain`: a feature, whether it is on, and why."""

    feature: str
    setting: str
    why: str


def features_of(scene: Scene, law_is_damped: bool) -> Features:
    """Decide every feature from the scene alone."""
    friction = any(pair.friction > 0.0 for pair in scene.pairs.values())
    rolling, classes = scene.contact.rolling, size_classes(scene)
    if not any(pair.rolling_friction for pair in scene.pairs.values()):
        rolling = "none"
    return Features(
        friction=friction,
        rolling=rolling,
        rotation=friction or rolling != "none",
        rate_dependent=law_is_damped,
        adhesion=adhesion_of(scene),
        walls=bool(scene.walls),
        moving_walls=any(wall.motion for wall in scene.walls.values()),
        driven_walls=any(is_driven(wall) for wall in scene.walls.values()),
        mesh_walls=any(wall.shape == "mesh" for wall in scene.walls.values()),
        one_material=len({group.material for group in scene.particles.values()}) == 1,
        ledger=scene.output.energy,
        loads=bool(scene.loaded_walls),
        adaptive_step=scene.run.time_step == "adaptive",
        periodic=", ".join(scene.domain.periodic) or "none",
        shear=scene.domain.shear is not None,
        fixed_grains=any(group.fixed for group in scene.particles.values()),
        outlets=bool(scene.outlets),
        size_classes=str(len(classes)) if len(classes) > 1 else "none",
    )


def adhesion_of(scene: Scene) -> Literal["none", "sjkr"]:
    """The adhesion of the scene; none where no pair has a cohesion energy density above 0."""
    return scene.contact.adhesion if any(pair.cohesion_energy_density for pair in scene.pairs.values()) else "none"


def reasons_for(scene: Scene, features: Features) -> tuple[Reason, ...]:
    """Say of every feature why it is on or off, with the line of the scene that decided it."""
    why = {
        "friction": _first_pair(scene, "friction", features.friction),
        "rolling": _rolling_reason(scene, features),
        "rotation": "friction or rolling turns the particles" if features.rotation else "nothing turns the particles",
        "rate_dependent": _rate_reason(scene, features),
        "adhesion": _adhesion_reason(scene, features),
        "walls": _walls_reason(scene),
        "moving_walls": _moving_reason(scene, features),
        "driven_walls": _driven_reason(scene, features),
        "mesh_walls": _mesh_reason(scene, features),
        "one_material": _material_reason(scene),
        "ledger": f"output.energy is {'on' if features.ledger else 'off'} ({scene.where('output', 'energy')})",
        "loads": _loads_reason(scene, features),
        "adaptive_step": _step_reason(scene),
        "periodic": f"domain.periodic ({scene.where('domain', 'periodic')})"
        if scene.domain.periodic
        else "the domain has no periodic axes",
        "shear": _shear_reason(scene),
        "fixed_grains": _fixed_reason(scene, features),
        "outlets": _outlets_reason(scene),
        "size_classes": _sizes_reason(scene),
    }
    return tuple(Reason(item.name, _setting(getattr(features, item.name)), why[item.name]) for item in fields(features))


def _setting(value: bool | str) -> str:
    if isinstance(value, bool):
        return "on" if value else "off"
    return "off" if value == "none" else value


def _first_pair(scene: Scene, key: str, on: bool) -> str:
    if not on:
        return f"every pair has {key} 0"
    name, pair = next((name, pair) for name, pair in scene.pairs.items() if getattr(pair, key))
    return f"pairs.{name}.{key} is {getattr(pair, key):g} ({scene.where('pairs', name, key)})"


def _rolling_reason(scene: Scene, features: Features) -> str:
    if scene.contact.rolling == "none":
        return f"contact.rolling is none ({scene.where('contact', 'rolling')})"
    return _first_pair(scene, "rolling_friction", features.rolling != "none")


def _adhesion_reason(scene: Scene, features: Features) -> str:
    if scene.contact.adhesion == "none":
        return "contact.adhesion is none"
    return _first_pair(scene, "cohesion_energy_density", features.adhesion != "none")


def _rate_reason(scene: Scene, features: Features) -> str:
    normal = scene.contact.normal
    if not features.rate_dependent:
        return f"the {normal.law} law as set here has no viscous term"
    damping_ratio = normal.settings().get("damping_ratio")
    if damping_ratio is not None:
        return f"contact.normal.damping_ratio is {damping_ratio:g} ({scene.where('contact', 'normal')})"
    return f"the {normal.law} law reaches a restitution below 1 by damping ({scene.where('contact', 'normal')})"


def _walls_reason(scene: Scene) -> str:
    if not scene.walls:
        return "the scene has no walls"
    return f"{', '.join(scene.walls)} ({scene.where('walls')})"


def _moving_reason(scene: Scene, features: Features) -> str:
    if not features.moving_walls:
        return "no wall has a motion"
    name = next(name for name, wall in scene.walls.items() if wall.motion)
    return f"walls.{name} moves ({scene.where('walls', name, 'motion')})"


def _driven_reason(scene: Scene, features: Features) -> str:
    if not features.driven_walls:
        return "no wall is moved by the grains' forces"
    name = next(name for name, wall in scene.walls.items() if is_driven(wall))
    kinds = " and ".join(dict.fromkeys(each.kind for each in scene.walls[name].motion))
    return f"walls.{name} is {kinds} ({scene.where('walls', name, 'motion')})"


def _mesh_reason(scene: Scene, features: Features) -> str:
    if not features.mesh_walls:
        return "no wall is a mesh"
    name = next(name for name, wall in scene.walls.items() if wall.shape == "mesh")
    return f"walls.{name} is one ({scene.where('walls', name, 'shape')})"


def _loads_reason(scene: Scene, features: Features) -> str:
    if not features.loads:
        return f"output.loads asks for no wall ({scene.where('output', 'loads')})"
    return f"output.loads asks for {', '.join(scene.loaded_walls)} ({scene.where('output', 'loads')})"


def _outlets_reason(scene: Scene) -> str:
    return f"{', '.join(scene.outlets)} ({scene.where('outlets')})" if scene.outlets else "the scene has no outlets"


def _fixed_reason(scene: Scene, features: Features) -> str:
    if not features.fixed_grains:
        return "every group of particles can move"
    name = next(name for name, group in scene.particles.items() if group.fixed)
    return f"particles.{name} is fixed ({scene.where('particles', name, 'fixed')})"


def _step_reason(scene: Scene) -> str:
    how = scene.run.time_step if isinstance(scene.run.time_step, str) else "a number"
    return f"run.time_step is {how} ({scene.where('run', 'time_step')})"


def _shear_reason(scene: Scene) -> str:
    shear = scene.domain.shear
    if shear is None:
        return "the domain is not sheared"
    moved = f"{shear.velocity_along} changes with {shear.gradient_along} by {shear.rate:g} 1/s"
    return f"velocity along {moved} ({scene.where('domain', 'shear')})"


def _sizes_reason(scene: Scene) -> str:
    spans = [diameter_range(group) for group in scene.particles.values()]
    ratio = max(high for _, high in spans) / min(low for low, _ in spans)
    if ratio < WIDE:
        return f"the largest particles are less than {WIDE:g} times as wide as the smallest"
    return f"the largest particles are {ratio:.3g} times as wide as the smallest ({scene.where('particles')})"


def _material_reason(scene: Scene) -> str:
    materials = sorted({group.material for group in scene.particles.values()})
    return f"all particles are of {materials[0]}" if len(materials) == 1 else f"particles are of {', '.join(materials)}"
