"""Variants of a scene, each with one feature off that is on, or on that is off."""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Any, Literal

from granflow.plan import Plan, plan_for
from granflow.scene import Scene
from granflow.scene.schema import Contact, Pair

FRICTION, ROLLING_FRICTION = 0.3, 0.02
"""Of every pair where a feature is switched on that the scene has not."""


@dataclass(frozen=True)
class Variant:
    """A scene, and what its plan is made to hold though the scene does not need it."""

    name: str
    scene: Scene
    forced: dict[str, Any] = field(default_factory=dict)

    def plan(self, base: Plan, on_gpu: bool) -> Plan:
        """The plan of this variant with the steps and the skin of the scene as it stands."""
        free = self.scene.run.model_copy(update={"time_step": "auto"})
        domain = self.scene.domain.model_copy(update={"leaving": "delete"})
        plan = plan_for(self.scene.model_copy(update={"run": free, "domain": domain}), on_gpu)
        features = replace(plan.features, **self.forced)
        return replace(plan, features=features, step=base.step, skin=base.skin)


def variants_of(plan: Plan) -> list[Variant]:
    """The scene of a plan as it stands, and with every feature the other way that can be without moving a particle."""
    scene, features = plan.scene, plan.features
    return [
        Variant("as it stands", scene),
        *_without_turning(plan),
        *([] if features.friction else [Variant("with friction", _with_friction(scene, FRICTION))]),
        *([Variant("with rolling friction", _with_rolling(scene, "epsd"))] if features.rolling == "none" else []),
        *_without_history(plan),
        *([Variant("without adhesion", _dry(scene))] if features.adhesion != "none" else []),
        *_other_walls(plan),
        *_other_materials(plan),
        Variant(f"{'without' if features.ledger else 'with'} ledger", _with_ledger(scene, not features.ledger)),
        Variant("without all of these", _bare(scene)),
    ]


def _without_turning(plan: Plan) -> Iterator[Variant]:
    """Friction and rolling by themselves, and rotation, which is left out where both are."""
    scene, features = plan.scene, plan.features
    if features.friction:
        yield Variant("without friction", _with_friction(scene, 0.0), {"rotation": True})
    if features.rolling != "none":
        yield Variant("without rolling friction", _with_rolling(scene, "none"), {"rotation": True})
    if features.rotation:
        yield Variant("without rotation", _smooth(scene))


def _without_history(plan: Plan) -> Iterator[Variant]:
    """Elastic Hertz contacts, which have no past; then nothing at all remembered."""
    elastic = _elastic(plan.scene)
    if plan.law.history_names:
        yield Variant("without normal history", elastic)
    elif plan.features.rate_dependent:
        yield Variant("without damping", elastic)
    if plan.history:
        yield Variant("without any history", _smooth(elastic), {"rotation": plan.features.rotation})


def _other_walls(plan: Plan) -> Iterator[Variant]:
    """No walls; walls that could move. A moving wall is not stilled: it would stand elsewhere."""
    if plan.features.walls:
        yield Variant("without walls", plan.scene.model_copy(update={"walls": {}}))
    if plan.features.walls and not plan.features.moving_walls:
        yield Variant("with moving walls", plan.scene, {"moving_walls": True})


def _other_materials(plan: Plan) -> Iterator[Variant]:
    if plan.features.one_material:
        yield Variant("with several materials", plan.scene, {"one_material": False})
        return
    alike = _of_one_material(plan.scene)
    if alike is not None:
        yield Variant("with one material", alike)


def _bare(scene: Scene) -> Scene:
    """No more than spheres that repel each other."""
    least = _with_ledger(_dry(_smooth(_elastic(scene))), False)
    return (_of_one_material(least) or least).model_copy(update={"walls": {}})


def _smooth(scene: Scene) -> Scene:
    return _with_rolling(_with_friction(scene, 0.0), "none")


def _with_friction(scene: Scene, friction: float) -> Scene:
    rough = _with_pairs(scene, friction=friction)
    return _with_contact(rough, tangential="mindlin") if friction else rough


def _with_rolling(scene: Scene, rolling: Literal["none", "epsd"]) -> Scene:
    pairs = {name: _rolling_pair(pair) for name, pair in scene.pairs.items()}
    return _with_contact(scene.model_copy(update={"pairs": pairs}), rolling=rolling)


def _rolling_pair(pair: Pair) -> Pair:
    return pair.model_copy(update={"rolling_friction": pair.rolling_friction or ROLLING_FRICTION})


def _elastic(scene: Scene) -> Scene:
    """Hertz's law without loss."""
    given = scene.contact.model_dump(by_alias=True, exclude_none=True) | {"normal": "hertz"}
    lossless = _with_pairs(scene, restitution=1.0)
    return lossless.model_copy(update={"contact": Contact.model_validate(given)})


def _dry(scene: Scene) -> Scene:
    return _with_contact(scene, adhesion="none")


def _with_ledger(scene: Scene, on: bool) -> Scene:
    return scene.model_copy(update={"output": scene.output.model_copy(update={"energy": on})})


def _of_one_material(scene: Scene) -> Scene | None:
    """All particles of the material that most are of; None where the scene does not say how that meets every wall."""
    material = max(scene.particles.values(), key=lambda group: group.count).material
    walls = {wall.material for wall in scene.walls.values()}
    if not all(scene.pair_key(material, other) in scene.pairs for other in {material, *walls}):
        return None
    groups = {name: group.model_copy(update={"material": material}) for name, group in scene.particles.items()}
    return scene.model_copy(update={"particles": groups})


def _with_pairs(scene: Scene, **values: float) -> Scene:
    pairs = {name: pair.model_copy(update=values) for name, pair in scene.pairs.items()}
    return scene.model_copy(update={"pairs": pairs})


def _with_contact(scene: Scene, **values: str) -> Scene:
    return scene.model_copy(update={"contact": scene.contact.model_copy(update=values)})
