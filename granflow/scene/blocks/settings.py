"""Settings of stages: properties that particles take when a stage begins, such as another temperature.

The keys of the properties are those of particle equations and of sources of flows, which `use_registry` adds,
so that a registered equation has its key here, too.
"""

from collections.abc import Iterator, Mapping
from typing import Annotated

from pydantic.fields import FieldInfo

from granflow.contact import registry
from granflow.scene.blocks.particle_regions import ParticleRegion
from granflow.schema.faults import Fault, whole
from granflow.schema.model import GroupNames, Model, add_keys, optional, optional_key
from granflow.visible_text import alternatives


class StageSetting(Model):
    """Properties that particles take when a stage begins; later they change as in any stage.

    It applies to the particles that are present then, of some groups or of all, in a region or everywhere;
    not to those that are inserted later.

    >>> gf.StageSetting(temperature="800 K", groups=["beads"]).groups
    ('beads',)
    """

    groups: GroupNames | None = optional("groups whose particles are set", "all", examples=[["beads"]])
    region: ParticleRegion | None = optional(
        "region in which the centers of the particles are",
        "everywhere",
        examples=[{"half_space": {"point": [0, 0, 0], "normal": [1, 0, 0]}}],
    )

    @property
    def values(self) -> Mapping[str, float]:
        """The values that are given, by property."""
        names = (each for each in type(self).model_fields if each not in ("groups", "region"))
        return {name: value for name in names if (value := getattr(self, name)) is not None}

    def faults(self) -> Iterator[Fault]:
        """Yield a fault unless a property is given."""
        if not self.values:
            yield whole((), f"sets no property; give {alternatives(list(_keys()))}")


def _keys() -> dict[str, FieldInfo]:
    """Keys of the properties."""
    values = {each.name: (each.initial, each.meaning) for each in registry.equations()}
    sources = {name: (each.type, each.meaning) for name, (_, each) in registry.sources().items()}
    return {
        name: optional_key(Annotated[float, number], f"value that the particles take: {meaning}")
        for name, (number, meaning) in (values | sources).items()
    }


def use_registry() -> None:
    """Add the properties of particle equations, and sources of flows.

    A schema that is built must be rebuilt afterwards.
    """
    add_keys(StageSetting, _keys())


use_registry()
