"""Variants of a scene, each with one feature switched on or off.

A feature that is forced on without effect on the motion shows the cost of its code alone.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Any, Literal

from granflow import Plan, Scene, plan_for
from granflow.scene.schema.contact import Contact
from granflow.scene.schema.materials import MaterialPair

FRICTION, ROLLING_FRICTION = 0.3, 0.02
"""Coefficients of every pair if a variant adds the feature to the scene."""


@dataclass(frozen=True)
class FeatureVariant:
    """A scene, and the features that its plan includes although the scene does not require them.

    `forced_features`: values of fields of `plan.features.Features` by name.
    """

    name: str
    scene: Scene
    forced_features: dict[str, Any] = field(default_factory=dict)

    def plan(self, base: Plan, on_gpu: bool) -> Plan:
        """Plan of this variant with the time step and the skin of the baseline, so that the same work is timed."""
        free = self.scene.run.model_copy(update={"time_step": "auto"})
        domain = self.scene.domain.model_copy(update={"on_exit": "delete"})
        plan = plan_for(self.scene.model_copy(update={"run": free, "domain": domain}), on_gpu)
        features = replace(plan.features, **self.forced_features)
        return replace(plan, features=features, step=base.step, skin=base.skin)


def variants_of(scene: Scene, plan: Plan) -> list[FeatureVariant]:
    """Baseline and all variants with one feature changed that do not require other particle positions."""
    features = plan.features
    return [
        FeatureVariant("baseline", scene),
        *_without_rotational_features(scene, plan),
        *([] if features.friction else [FeatureVariant("with friction", _with_friction(scene, FRICTION))]),
        *(
            [FeatureVariant("with rolling friction", _with_rolling(scene, "epsd"))]
            if features.rolling == "none"
            else []
        ),
        *_without_history(scene, plan),
        *([FeatureVariant("without cohesion", _without_cohesion(scene))] if features.cohesion != "none" else []),
        *_other_walls(scene, plan),
        *_other_materials(scene, plan),
        FeatureVariant(
            f"{'without' if features.energy_budget else 'with'} energy budget",
            _with_energy_budget(scene, not features.energy_budget),
        ),
        FeatureVariant("without all of these", _minimal(scene)),
    ]


def _without_rotational_features(scene: Scene, plan: Plan) -> Iterator[FeatureVariant]:
    """Variants without friction, without rolling friction, and without rotation, which excludes both."""
    features = plan.features
    if features.friction:
        yield FeatureVariant("without friction", _with_friction(scene, 0.0), {"rotation": True})
    if features.rolling != "none":
        yield FeatureVariant("without rolling friction", _with_rolling(scene, "none"), {"rotation": True})
    if features.rotation:
        yield FeatureVariant("without rotation", _without_rotation(scene))


def _without_history(scene: Scene, plan: Plan) -> Iterator[FeatureVariant]:
    """Variants with elastic Hertz contacts, which have no normal history, and without any contact history."""
    elastic = _elastic(scene)
    if plan.law.history_names:
        yield FeatureVariant("without normal history", elastic)
    elif plan.features.rate_dependent:
        yield FeatureVariant("without damping", elastic)
    if plan.history:
        yield FeatureVariant("without any history", _without_rotation(elastic), {"rotation": plan.features.rotation})


def _other_walls(scene: Scene, plan: Plan) -> Iterator[FeatureVariant]:
    """Variants without walls, and with the code for moving walls.

    No variant stops a moving wall: its position would differ.
    """
    if plan.features.walls:
        yield FeatureVariant("without walls", scene.model_copy(update={"walls": {}}))
    if plan.features.walls and not plan.features.moving_walls:
        yield FeatureVariant("with moving walls", scene, {"moving_walls": True})


def _other_materials(scene: Scene, plan: Plan) -> Iterator[FeatureVariant]:
    """Variant with several materials, or with one material if the scene has several."""
    if plan.features.one_material:
        yield FeatureVariant("with several materials", scene, {"one_material": False})
        return
    one_material = _of_one_material(scene)
    if one_material is not None:
        yield FeatureVariant("with one material", one_material)


def _minimal(scene: Scene) -> Scene:
    """Minimal scene: elastic particles of one material, without walls, rotation, cohesion and energy budget."""
    minimal = _with_energy_budget(_without_cohesion(_without_rotation(_elastic(scene))), False)
    return (_of_one_material(minimal) or minimal).model_copy(update={"walls": {}})


def _without_rotation(scene: Scene) -> Scene:
    """The scene without friction and rolling friction, so that its plan has no rotation."""
    return _with_rolling(_with_friction(scene, 0.0), "none")


def _with_friction(scene: Scene, friction: float) -> Scene:
    """The scene with one friction coefficient for all pairs; 0 switches friction off."""
    with_friction = _with_pairs(scene, friction=friction)
    return _with_contact(with_friction, tangential="mindlin") if friction else with_friction


def _with_rolling(scene: Scene, rolling: Literal["none", "epsd"]) -> Scene:
    """The scene with a rolling model; missing coefficients are set to ROLLING_FRICTION."""
    pairs = {name: _rolling_pair(pair) for name, pair in scene.pairs.items()}
    return _with_contact(scene.model_copy(update={"pairs": pairs}), rolling=rolling)


def _rolling_pair(pair: MaterialPair) -> MaterialPair:
    """The pair with its rolling friction, or ROLLING_FRICTION if it has none."""
    return pair.model_copy(update={"rolling_friction": pair.model_dump()["rolling_friction"] or ROLLING_FRICTION})


def _elastic(scene: Scene) -> Scene:
    """Hertz's model without dissipation."""
    given = scene.contact.model_dump(by_alias=True, exclude_none=True) | {"normal": "hertz"}
    lossless = _with_pairs(scene, restitution=1.0)
    return lossless.model_copy(update={"contact": Contact.model_validate(given)})


def _without_cohesion(scene: Scene) -> Scene:
    """The scene without cohesion."""
    return _with_contact(scene, cohesion="none")


def _with_energy_budget(scene: Scene, on: bool) -> Scene:
    """The scene with the energy budget switched on or off."""
    return scene.model_copy(update={"output": scene.output.model_copy(update={"energy_budget": on})})


def _of_one_material(scene: Scene) -> Scene | None:
    """All particles of the most frequent material.

    None if the scene does not define the pairs of this material with itself and all wall materials.
    """
    material = max(scene.particles.values(), key=lambda group: group.count).material
    walls = {wall.material for wall in scene.walls.values()}
    if not all(scene.pair_key(material, other) in scene.pairs for other in {material, *walls}):
        return None
    groups = {name: group.model_copy(update={"material": material}) for name, group in scene.particles.items()}
    return scene.model_copy(update={"particles": groups})


def _with_pairs(scene: Scene, **values: float) -> Scene:
    """The scene with the same values for all pairs."""
    pairs = {name: pair.model_copy(update=values) for name, pair in scene.pairs.items()}
    return scene.model_copy(update={"pairs": pairs})


def _with_contact(scene: Scene, **values: str) -> Scene:
    """The scene with changed contact models."""
    return scene.model_copy(update={"contact": scene.contact.model_copy(update=values)})
