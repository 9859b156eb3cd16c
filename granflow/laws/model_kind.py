"""What the catalog says of a law before anything is compiled: its settings in a scene, and who builds it.

Nothing here imports Taichi: a scene is read and checked with it.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import import_module
from typing import Any, Literal, TypeAlias

from granflow.laws.law import ModelRequest, NormalLaw

RestitutionInput: TypeAlias = Literal["number or fit", "positive number", "nothing"]
"""What a law takes from `restitution` of a pair; "nothing" where the material itself decides."""


@dataclass(frozen=True)
class Amount:
    """A setting that is one number, SI or with a unit; without a default it must be given."""

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
    """A setting that is one of some words, or a mapping with one of some keys: onset, {value: 1e4 N/m}.

    `with_numbers` is the word that it becomes where every pair gives a number as restitution.
    """

    description: str
    words: tuple[str, ...]
    keyed: Mapping[str, Amount] = field(default_factory=dict)
    default: str | None = None
    with_numbers: str | None = None


Setting: TypeAlias = Amount | Choice


@dataclass(frozen=True)
class LawKind:
    """One entry of the catalog. The law's file, `granflow/laws/<name>.py`, holds `law_for(request)`."""

    name: str
    summary: str
    settings: Mapping[str, Setting] = field(default_factory=dict)
    restitution: RestitutionInput = "positive number"
    example: Mapping[str, Any] = field(default_factory=dict)
    """Settings that give a usual variant of a law which cannot do without any, for single collisions."""

    @property
    def needs_settings(self) -> bool:
        """Whether a scene must say more than the law's name."""
        return any(setting.default is None for setting in self.settings.values())

    def build(self, request: ModelRequest) -> NormalLaw:
        """Make the law that a scene asks for; loads Taichi."""
        law: NormalLaw = import_module(f"granflow.laws.{self.name}").law_for(request)
        return law
