"""Variants of a scene with each contact model and matched parameters.

Linear springs have the stiffness of Eq. 19 (Zhou 2011), per contact or at the reference velocity.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from granflow import GranflowError, Plan, Scene, SceneError, plan_for
from granflow.contact.registry import models
from granflow.scene.suggest import suggestion_or_list

LINEAR_KEYS = ("linear_onset", "linear_reference")
"""Directories of the two variants of the linear contact model: spring per contact, and from the reference velocity."""

TYPICAL_SHARE = 0.1
"""Default reference velocity over the largest expected impact velocity."""


@dataclass(frozen=True)
class LawVariant:
    """The scene with one contact model; `key` names its directory, `normal` is its `contact.normal`.

    If the contact model cannot run the scene, `scene` is None and `refused` gives the reason.
    """

    key: str
    title: str
    normal: Mapping[str, Any]
    scene: Scene | None
    refused: str = ""


def law_names(given: str) -> tuple[str, ...]:
    """Contact models of a comma-separated list.

    Raises GranflowError for an unknown contact model, a repeated one, or an empty list.
    """
    names = tuple(part.strip() for part in given.split(",") if part.strip())
    if not names:
        raise GranflowError("--laws is empty: give at least one contact model, such as --laws zhou,linear,hertz.")
    for number, name in enumerate(names):
        if name not in models("normal"):
            remedy = suggestion_or_list(name, models("normal"), "contact models")
            raise GranflowError(f"Unknown contact model {name}. {remedy if remedy.endswith('?') else remedy + '.'}")
        if name in names[:number]:
            raise GranflowError(f"The contact model {name} is repeated: give each once.")
    return names


def reference_velocity_of(scene: Scene) -> float:
    """Typical impact velocity [m/s]: TYPICAL_SHARE of the largest that the plan assumes."""
    return TYPICAL_SHARE * automatic_plan(scene).velocity_max


def automatic_plan(scene: Scene) -> Plan:
    """Plan of a scene with the automatic time step. Raises SceneError if its contact model cannot run it."""
    return plan_for(scene.model_copy(update={"run": scene.run.model_copy(update={"time_step": "auto"})}))


def variants_of(
    scene: Scene, laws: Sequence[str], reference_velocity: float, most_particles: int | None = None
) -> list[LawVariant]:
    """The scene with each contact model, `linear` twice: per contact and from the reference velocity [m/s].

    Every variant has its automatic time step and computes the energy budget. `most_particles` reduces the groups
    without explicit positions in proportion.
    """
    found = []
    for key, title, normal in _normals(scene, laws, reference_velocity):
        described = _described(scene, normal, reference_velocity, most_particles)
        try:
            found.append(LawVariant(key, title, normal, Scene.from_dict(described, scene.folder)))
        except SceneError as error:
            found.append(LawVariant(key, title, normal, None, "; ".join(error.problems)))
    return found


def _normals(scene: Scene, laws: Sequence[str], velocity: float) -> Iterator[tuple[str, str, dict[str, Any]]]:
    """Directory, title and `contact.normal` of every variant.

    The contact model of the scene keeps its settings; other models get those of their example in the catalog.
    """
    for name in laws:
        if name == "linear":
            at = {"reference_velocity": velocity}
            yield LINEAR_KEYS[0], "linear per contact", {"law": name, "stiffness": "onset"}
            yield LINEAR_KEYS[1], f"linear of {velocity:.3g} m/s", {"law": name, "stiffness": at}
        elif name == scene.contact.normal.law:
            yield name, name, {"law": name, **scene.contact.normal.settings()}
        else:
            example = dict(models("normal")[name].example)
            if "reference_velocity" in example:
                example["reference_velocity"] = velocity
            yield name, name, {"law": name, **example}


def _described(scene: Scene, normal: Mapping[str, Any], velocity: float, most: int | None) -> dict[str, Any]:
    """Scene description with the contact model, in the structure of a scene file.

    With an automatic time step, the energy budget and without expectations; `most`: largest number of particles or
    None.
    """
    described = scene.model_dump(by_alias=True, exclude_none=True)
    described["contact"]["normal"] = dict(normal)
    described["run"]["time_step"] = "auto"
    described["output"] |= {"energy_budget": True, "particles": True}
    described["expect"] = []
    for key, pair in described["pairs"].items():
        pair["restitution"] = restitution_for(scene, key, str(normal["law"]), velocity)
        if pair["restitution"] is None:
            del pair["restitution"]
    reduced = reduced_counts(scene, most)
    for name, count in reduced.items():
        described["particles"][name]["count"] = count
    return described


def restitution_for(scene: Scene, pair: str, law: str, velocity: float) -> Any:
    """Restitution of a pair for a contact model: that of the scene, or the value of Eq. 12 at the velocity [m/s].

    `pair`: key in `pairs`. The result is a number or a mapping as in a scene; None if the contact model derives it from
    the materials, or if the scene does not define it.
    """
    kind, given = models("normal")[law].restitution, scene.pairs[pair].restitution
    if kind == "nothing" or given is None or isinstance(given, float):
        return None if kind == "nothing" else given
    if kind == "positive number":
        return automatic_plan(scene).pair(*pair.split("-")).restitution_at(velocity)
    return given.model_dump(exclude_none=True)


def reduced_counts(scene: Scene, most: int | None) -> dict[str, int]:
    """Reduced counts of the groups without explicit positions, for at most `most` particles if possible.

    In proportion, at least 1 per group. Empty without a limit, or if the scene is below it.
    """
    explicit_kinds = ("positions", "file")
    scalable = {name: group.count for name, group in scene.particles.items() if group.insert.kind not in explicit_kinds}
    explicit_count = sum(group.count for group in scene.particles.values()) - sum(scalable.values())
    if most is None or explicit_count + sum(scalable.values()) <= most:
        return {}
    share = max(most - explicit_count, 0) / sum(scalable.values()) if scalable else 1.0
    return {name: max(int(share * count), 1) for name, count in scalable.items()}
