"""Catalog entries of contact models: name, settings in a scene, and the function that builds the model.

Does not import Taichi, so that scenes can be read and checked without it.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import import_module
from typing import Any, Literal, TypeAlias

from granflow.contact.model import ModelRequest, NormalLaw

RestitutionInput: TypeAlias = Literal["number or fit", "positive number", "nothing"]
"""Form of `restitution` that a model requires of a pair; "nothing" if restitution follows from the materials."""


@dataclass(frozen=True)
class Amount:
    """A setting that is one number, in SI units or with a unit; required if it has no default.

    description:  meaning, for the schema and the documentation
    example:      value with unit, for messages
    dimension:    dimension as in `scene.units`, "number" if dimensionless
    noun:         noun with article, for messages
    limits:       `above`, `at_least`, `at_most`, in SI units; None: no limit
    default:      value if the setting is omitted
    """

    description: str
    example: str
    dimension: str = "number"
    noun: str = ""
    above: float | None = None
    at_least: float | None = None
    at_most: float | None = None
    default: float | None = None


@dataclass(frozen=True)
class Choice:
    """A setting that is one of `words`, or a mapping with one key of `keyed`: onset, {value: 1e4 N/m}.

    default:       word if the setting is omitted; None: the setting is required
    with_numbers:  word used in place of the default if the restitution of every pair is a number
    """

    description: str
    words: tuple[str, ...]
    keyed: Mapping[str, Amount] = field(default_factory=dict)
    default: str | None = None
    with_numbers: str | None = None


Setting: TypeAlias = Amount | Choice


@dataclass(frozen=True)
class LawKind:
    """One entry of the catalog. The file of the model, `granflow/contact/normal/<name>.py`, defines `law_for(request)`.

    name:         value of `contact.normal.law`
    summary:      description in one sentence
    settings:     other keys of `contact.normal`
    restitution:  form of the restitution that the model requires of a pair
    """

    name: str
    summary: str
    settings: Mapping[str, Setting] = field(default_factory=dict)
    restitution: RestitutionInput = "positive number"
    example: Mapping[str, Any] = field(default_factory=dict)
    """Settings of a common variant, for studies of single collisions; given if the model has required settings."""

    @property
    def needs_settings(self) -> bool:
        """Whether a scene requires settings in addition to the name of the model."""
        return any(setting.default is None for setting in self.settings.values())

    def build(self, request: ModelRequest) -> NormalLaw:
        """Build the contact model that a scene requests. Imports Taichi.

        The pair constants of the model raise ValueError for a pair that it does not support.
        """
        law: NormalLaw = import_module(f"granflow.contact.normal.{self.name}").law_for(request)
        return law
