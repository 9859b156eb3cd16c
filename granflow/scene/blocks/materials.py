"""Schema of the blocks `materials` and `pairs`: properties of one material, and of two in contact.

A preset supplies the values of a material, or of a restitution that depends on velocity. Contact models
declare further keys of pairs (`PairProperties`), which `use_registry` adds to `MaterialPair`.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import ConfigDict, Field, Tag, model_validator
from pydantic.fields import FieldInfo

from granflow.contact import registry
from granflow.contact.law import FrictionCoefficient
from granflow.contact.material import VelocityRestitution, limit_velocity
from granflow.schema import quantities as q
from granflow.schema.faults import value_error
from granflow.schema.messages import suggestion_or_list
from granflow.schema.model import (
    Model,
    Text,
    add_keys,
    choose_by,
    optional,
    optional_key,
    pair_list,
    required_unless,
)
from granflow.schema.quantities import Number

# Block `materials`

YoungModulus = Annotated[float, Number("pressure", noun="Young's modulus", above=0)]
YieldStrength = Annotated[float, Number("pressure", noun="a yield strength", above=0)]
PoissonRatio = Annotated[float, Number(noun="a Poisson ratio", above=-1, at_most=0.5)]
_OPTIONAL = ("yield_strength", "restitution_fit")
"""Keys of a material whose empty value removes the value of the preset."""


@dataclass(frozen=True)
class Preset:
    """A material in SI units.

    Moduli and strength [Pa], density [kg/m3]. `restitution_fit`: (sigma, psi) of Zhou (2011), Eq. 12, for
    contacts within the material, if known. `source`: reference.
    """

    young_modulus: float
    poisson_ratio: float
    density: float
    yield_strength: float | None
    restitution_fit: tuple[float, float] | None
    source: str


_ZHOU = (
    "Zhou, Theor. Appl. Mech. Lett. 1, 041006 (2011), Figs. 3-4, after Stevens & Hrenya, Powder Technol. "
    "154, 99 (2005)"
)
_GLASS = "soda-lime silicate glass, EN 572-1: Young's modulus 70 GPa, Poisson ratio 0.2, density 2500 kg/m3"
PRESETS: Mapping[str, Preset] = MappingProxyType(
    {
        "stainless_316": Preset(193e9, 0.35, 8030.0, 0.310e9, (3.0432, 0.540), _ZHOU),
        "chrome_52100": Preset(203e9, 0.28, 7830.0, 2.03e9, (0.1418, 0.3114), _ZHOU),
        "glass": Preset(70e9, 0.20, 2500.0, None, None, _GLASS),
    }
)
"""Materials by the name that `preset` of a material accepts."""


def _preset_name(given: Any, known: Iterable[str], kind: str) -> str | None:
    """Name of the requested preset, None without one.

    `known`: names of the presets; `kind`: noun for the message. Raises PydanticCustomError for an unknown
    preset.
    """
    name = given.get("preset") if isinstance(given, dict) else None
    if name is None or name in list(known):
        return name
    raise value_error(
        f"this is not one of the {kind}. {suggestion_or_list(str(name), known, kind)}", "preset"
    )


class Material(Model):
    """Material of particles and walls. A preset supplies the values that are not given here.

    Isotropic and linear elastic; a material without a yield strength never yields.

    >>> gf.Material(young_modulus="70 GPa", poisson_ratio=0.25, density="2.5 g/cm3").young_modulus
    70000000000.0
    """

    model_config = ConfigDict(
        json_schema_extra=required_unless("preset", "young_modulus", "poisson_ratio", "density")
    )

    preset: Text | None = Field(
        None,
        description="name of a preset that supplies the values that are not given: "
        + ", ".join(
            f"{name} ({each.young_modulus / 1e9:g} GPa, {each.poisson_ratio:g}, {each.density:g} kg/m3)"
            for name, each in PRESETS.items()
        ),
    )
    young_modulus: YoungModulus = Field(
        description="Young's modulus [Pa], such as 70 GPa", examples=["70 GPa"]
    )
    poisson_ratio: PoissonRatio = Field(description="Poisson ratio, such as 0.3", examples=[0.3])
    density: q.Density = Field(description="density of the solid [kg/m3], such as 2500", examples=[2500])
    yield_strength: YieldStrength | None = Field(
        None,
        description="yield strength [Pa]; required by some contact models and by Eq. 11 of Zhou (2011)",
    )
    restitution_fit: Annotated[tuple[q.Positive, q.Positive], pair_list("[sigma, psi]")] | None = Field(
        None,
        description=(
            "sigma and psi (Zhou 2011, Eq. 12) for contacts within this material; available in some presets"
        ),
        examples=[[3.0, 0.5]],
    )

    if TYPE_CHECKING:  # a preset supplies required keys, contact models add keys

        def __init__(self, **keys: Any) -> None: ...

    @model_validator(mode="before")
    @classmethod
    def _fill_in_preset(cls, given: Any) -> Any:
        """Add the values of the preset; given values have priority.

        An empty optional value removes that of the preset. Raises PydanticCustomError for an unknown preset.
        """
        name = _preset_name(given, PRESETS, "presets")
        if name is None:
            return given
        preset = {key: value for key, value in vars(PRESETS[name]).items() if key in cls.model_fields}
        left_out = {key for key, value in given.items() if value is None and key in _OPTIONAL}
        return preset | {key: value for key, value in given.items() if key not in left_out}

    @property
    def shear_modulus(self) -> float:
        """Shear modulus [Pa], G = E / (2 (1 + nu))."""
        return self.young_modulus / (2 * (1 + self.poisson_ratio))


# Block `pairs`

RestitutionNumber = Annotated[float, Number(noun="a restitution coefficient", at_least=0, at_most=1)]


class RestitutionFit(Model):
    """Restitution that decreases with the impact velocity v [m/s] (Zhou 2011, Eq. 12).

    e(v) = exp(-sigma (v / (vlim - v))^psi)   for v < vlim, else 0

    >>> gf.RestitutionFit(preset="stainless_316", limit_velocity="20 m/s").limit_velocity
    20.0
    """

    model_config = ConfigDict(json_schema_extra=required_unless("preset", "sigma", "psi"))

    sigma: q.Positive = Field(description="sigma of Zhou (2011), Eq. 12", examples=[3.0])
    psi: q.Positive = Field(description="psi of Zhou (2011), Eq. 12")
    limit_velocity: q.Speed | None = optional(
        "impact velocity above which e is 0 [m/s]",
        "Zhou (2011), Eq. 11, with the yield strengths",
        examples=["100 m/s"],
    )
    preset: Text | None = Field(
        None,
        description="name of a preset that supplies sigma and psi: "
        + " or ".join(name for name, each in PRESETS.items() if each.restitution_fit),
    )

    @model_validator(mode="before")
    @classmethod
    def _fill_in_preset(cls, given: Any) -> Any:
        """Add sigma and psi of the preset; given values have priority."""
        fits = {name: preset.restitution_fit for name, preset in PRESETS.items() if preset.restitution_fit}
        name = _preset_name(given, fits, "presets with a restitution fit")
        return given if name is None else dict(zip(("sigma", "psi"), fits[name], strict=True)) | given


def _restitution_tag(given: Any) -> str:
    if given is None:
        return "<none>"
    return "<fit>" if isinstance(given, dict | RestitutionFit) else "<number>"


Restitution = Annotated[
    Annotated[RestitutionNumber, Tag("<number>")]
    | Annotated[RestitutionFit, Tag("<fit>")]
    | Annotated[None, Tag("<none>")],
    choose_by(_restitution_tag, "a number or {sigma: 3.0, psi: 0.5} is expected"),
]
"""A number, a fit (Zhou 2011, Eq. 12), or None if the contact model derives it from the materials."""


class MaterialPair(Model):
    """Contact properties of two materials, independent of their order.

    Required for each two materials that can come into contact, including contacts of a material with itself.

    >>> gf.MaterialPair(restitution=0.9, friction=0.5)
    MaterialPair(restitution=0.9, friction=0.5)
    """

    restitution: Restitution = Field(
        None,
        description=(
            "restitution coefficient, a number in [0, 1], or sigma and psi of Zhou (2011), Eq. 12; required "
            "unless the normal contact model derives it from the materials"
        ),
    )
    friction: FrictionCoefficient = Field(description="Coulomb friction coefficient; 0 for no friction")

    if TYPE_CHECKING:  # keys that contact models add

        def __init__(self, *, friction: Any, restitution: Any = None, **properties: Any) -> None: ...

    @property
    def fit(self) -> RestitutionFit | None:
        """The restitution if it is a fit."""
        return self.restitution if isinstance(self.restitution, RestitutionFit) else None

    def restitution_of(self, first: Material, second: Material) -> float | VelocityRestitution | None:
        """The restitution of the two materials as contact models read it.

        A limit velocity that is not given follows from their yield strengths (Zhou 2011, Eq. 11).
        """
        if isinstance(self.restitution, RestitutionFit):
            fit = self.restitution
            limit = fit.limit_velocity or limit_velocity(first, second)
            return VelocityRestitution(fit.sigma, fit.psi, limit)
        return self.restitution


def _annotation(field: FieldInfo) -> Any:
    """Type of a field with its notes."""
    found: Any = field.annotation
    for note in field.metadata:
        found = Annotated[found, note]
    return found


def use_registry() -> None:
    """Add the keys that contact models require of `pairs`, except those that every pair has, and those that
    particle equations and contact models require of materials.

    A schema that is built must be rebuilt afterwards.
    """
    of_materials = {
        key: optional_key(_annotation(each), f"{each.description}; {purpose}", each.examples)
        for key, (each, purpose) in registry.material_properties().items()
    }
    add_keys(Material, of_materials)
    of_models = {}
    for key, each in registry.pair_properties().items():
        needed = " or ".join(
            f"contact.{slot}: {' or '.join(names)}" for slot, names in registry.models_with(key).items()
        )
        description = f"{each.description}; required with {needed}"
        of_models[key] = optional_key(_annotation(each), description, each.examples)
    declared = MaterialPair.__annotations__
    add_keys(MaterialPair, {key: each for key, each in of_models.items() if key not in declared})


use_registry()
