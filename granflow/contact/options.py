"""Declared options of contact models: keys of a model in a scene, from which the schema and its messages derive."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TypeAlias


@dataclass(frozen=True)
class Amount:
    """An option that is one number, in SI units or with a unit; required if it has no default.

    description:  meaning, for the schema and the documentation
    example:      value with unit, for messages
    dimension:    "number" if dimensionless (the default), "length", "velocity", "stiffness", ...: the keys of
                  `granflow.scene.schema.units.DIMENSIONS`, which a wrong one lists
    noun:         noun with article, for messages
    limits:       `above`, `at_least`, `at_most`, in SI units; None: no limit
    default:      value if the option is omitted
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
    """An option that is one of `words`, or a mapping with one key of `keyed`: onset, {value: 1e4 N/m}.

    default:       word if the option is omitted; None: the option is required
    with_numbers:  word used in place of the default if the restitution of every pair is a number
    """

    description: str
    words: tuple[str, ...]
    keyed: Mapping[str, Amount] = field(default_factory=dict)
    default: str | None = None
    with_numbers: str | None = None


Option: TypeAlias = Amount | Choice


@dataclass(frozen=True)
class PairOption:
    """A key of `pairs` that a contact model requires; the model is compiled only if a pair has a value other than 0.

    key:     name of the key
    amount:  meaning and limits of the value, which has no default
    remedy:  what to write, for the message on a missing key
    """

    key: str
    amount: Amount
    remedy: str = "give a value, or 0"


FRICTION = PairOption("friction", Amount("Coulomb friction coefficient; 0 for no friction", "0.5"))
"""Sliding friction, which every pair has, for every tangential model."""

ROLLING_FRICTION = PairOption(
    "rolling_friction",
    Amount("rolling friction coefficient", "0.1", noun="a friction coefficient", at_least=0),
    "give the coefficient, or 0 to disable rolling friction",
)
"""Rolling friction, shared by the rolling models."""

WORK_OF_ADHESION = PairOption(
    "work_of_adhesion",
    Amount(
        "work of adhesion w [J/m2]: energy per area that separates the two surfaces; twice the surface energy of equal "
        "materials",
        *("50 mJ/m2", "surface_energy", "a work of adhesion"),
        at_least=0,
    ),
    "give it in J/m2, or 0 to disable cohesion",
)
"""Work of adhesion, shared by the models of dry adhesion."""
