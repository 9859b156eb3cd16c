"""Liquid films: unit of the volumes, and what a model that transfers liquid does not support."""

from collections.abc import Sequence
from math import ceil, log2

from granflow.errors import SceneError
from granflow.geometry.sphere import sphere_volume
from granflow.load import Scene
from granflow.plan.scene_parts import PlannedGroup

LIQUID_BITS = 50
"""Binary digits of the volume of all liquid in its unit: three fewer than f64 has, for the halves of odd volumes and
for particles that a program adds."""


def liquid_unit(groups: Sequence[PlannedGroup]) -> float:
    """Unit [m3] of liquid volumes, a power of two: bridges take whole units, so that all sums of volumes are exact.

    The liquid of all groups, with the largest diameters, over 2^LIQUID_BITS; 1 without liquid.
    """
    total = sum(group.count * group.liquid_content * sphere_volume(0.5 * group.diameters[1]) for group in groups)
    return 2.0 ** (ceil(log2(total)) - LIQUID_BITS) if total > 0.0 else 1.0


def refuse_coarse_liquid(scene: Scene, transfers_liquid: bool) -> None:
    """Raise SceneError if a model transfers liquid in another precision than f64."""
    if transfers_liquid and scene.run.precision != "f64":
        raise SceneError(
            f"{scene.locate('run', 'precision')}: run.precision is {scene.run.precision}, but contact.cohesion: "
            f"{scene.contact.name('cohesion')} conserves liquid in f64 only; write f64."
        )
