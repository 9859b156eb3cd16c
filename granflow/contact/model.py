"""Record of a contact model: what a scene, the schema, messages and documentation derive from it."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, TypeAlias

from granflow.contact.cohesion_law import CohesionLaw
from granflow.contact.law import Law
from granflow.contact.normal_law import NormalLaw
from granflow.contact.options import Option, PairOption
from granflow.contact.surface_law import RollingLaw, TangentialLaw, TwistingLaw

RestitutionInput: TypeAlias = Literal["number or fit", "positive number", "nothing"]
"""Form of `restitution` that a model requires of a pair; "nothing" if restitution follows from the materials."""

SLOTS: Mapping[str, type[Law]] = {
    "normal": NormalLaw,
    "tangential": TangentialLaw,
    "rolling": RollingLaw,
    "twisting": TwistingLaw,
    "cohesion": CohesionLaw,
}
"""Keys of `contact`, in the order of evaluation, and the base class of the models of each."""


@dataclass(frozen=True)
class ContactModel:
    """A contact model of one slot, declared in one file.

    law:           class with the functions of the model and its `name`, `source` and `limits`
    summary:       description in one sentence
    options:       keys of the model in `contact`, in addition to its name
    pair_options:  keys of `pairs` that the model requires
    restitution:   form of the restitution that a normal model requires of a pair
    example:       options of a common variant, for studies of single collisions; given if options are required
    """

    law: type[Law]
    summary: str
    options: Mapping[str, Option] = field(default_factory=dict)
    pair_options: tuple[PairOption, ...] = ()
    restitution: RestitutionInput = "positive number"
    example: Mapping[str, Any] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """Value of the slot in `contact`."""
        return self.law.name

    @property
    def slot(self) -> str:
        """Key of `contact` that selects the model."""
        return next(slot for slot, base in SLOTS.items() if issubclass(self.law, base))

    @property
    def needs_options(self) -> bool:
        """Whether a scene requires options in addition to the name of the model."""
        return any(option.default is None for option in self.options.values())
