"""Schema of materials, pairs of materials, and the contact law."""

from collections.abc import Iterable
from typing import Annotated, Any, Literal

from pydantic import ConfigDict, Field, Tag, model_validator

from granflow.scene.fields import (
    AlsoWritten,
    Density,
    Model,
    Number,
    Positive,
    Speed,
    Stiffness,
    Text,
    but,
    choice,
    chosen,
    couple,
    required_unless,
    shorthand,
)
from granflow.scene.presets import PRESETS
from granflow.scene.suggest import known_or_meant

YoungModulus = Annotated[float, Number("pressure", noun="Young's modulus", above=0)]
YieldStrength = Annotated[float, Number("pressure", noun="a yield strength", above=0)]
PoissonRatio = Annotated[float, Number(noun="a Poisson ratio", above=-1, at_most=0.5)]
RestitutionNumber = Annotated[float, Number(noun="a restitution coefficient", at_least=0, at_most=1)]
FrictionNumber = Annotated[float, Number(noun="a friction coefficient", at_least=0)]
DampingRatio = Annotated[float, Number(noun="a damping ratio", at_least=0, at_most=1)]


def _preset_in(given: Any, known: Iterable[str], kind: str) -> str | None:
    """Name of the preset that is asked for, None if none is; refuses one that is not known."""
    name = given.get("preset") if isinstance(given, dict) else None
    if name is None or name in list(known):
        return name
    raise but(f"this is not one of the {kind}. {known_or_meant(str(name), known, kind)}", "preset")


_OPTIONAL = ("yield_strength", "restitution_fit")  # of a material: nothing written after the key leaves it out


class Material(Model):
    """What a particle or a wall is made of. A preset fills in what is not given here."""

    model_config = ConfigDict(json_schema_extra=required_unless("preset", "young_modulus", "poisson_ratio", "density"))

    preset: Text | None = Field(None, description="name of a known material that fills in what is not given")
    young_modulus: YoungModulus = Field(description="Young's modulus [Pa], such as 70 GPa")
    poisson_ratio: PoissonRatio = Field(description="Poisson ratio, such as 0.3")
    density: Density = Field(description="density of the solid [kg/m3], such as 2500")
    yield_strength: YieldStrength | None = Field(
        None, description="yield strength [Pa]; only needed for the limit velocity of Eq. 11"
    )
    restitution_fit: Annotated[tuple[Positive, Positive], couple("[sigma, psi]")] | None = Field(
        None, description="sigma and psi of Eq. 12 for this material against itself; known for some presets"
    )

    @model_validator(mode="before")
    @classmethod
    def _fill_in_preset(cls, given: Any) -> Any:
        name = _preset_in(given, PRESETS, "presets")
        if name is None:
            return given
        preset = {key: getattr(PRESETS[name], key) for key in cls.model_fields if key != "preset"}
        left_out = {key for key, value in given.items() if value is None and key in _OPTIONAL}
        return preset | {key: value for key, value in given.items() if key not in left_out}

    @property
    def shear_modulus(self) -> float:
        """Shear modulus [Pa], G = E / (2 (1 + nu))."""
        return self.young_modulus / (2 * (1 + self.poisson_ratio))


class RestitutionFit(Model):
    """Restitution that falls with the approach velocity: e(v) = exp(-sigma (v / (vlim - v))^psi) (Eq. 12)."""

    model_config = ConfigDict(json_schema_extra=required_unless("preset", "sigma", "psi"))

    sigma: Positive = Field(description="sigma of Eq. 12")
    psi: Positive = Field(description="psi of Eq. 12")
    limit_velocity: Speed | None = Field(
        None, description="velocity from which e is 0 [m/s]; left out: Eq. 11 from the yield strengths"
    )
    preset: Text | None = Field(None, description="name of a known material that fills in sigma and psi")

    @model_validator(mode="before")
    @classmethod
    def _fill_in_preset(cls, given: Any) -> Any:
        fits = {name: preset.restitution_fit for name, preset in PRESETS.items() if preset.restitution_fit}
        name = _preset_in(given, fits, "presets with a restitution fit")
        return given if name is None else dict(zip(("sigma", "psi"), fits[name], strict=True)) | given


def _restitution_tag(value: Any) -> str:
    return "<fit>" if isinstance(value, dict | RestitutionFit) else "<number>"


Restitution = Annotated[
    Annotated[RestitutionNumber, Tag("<number>")] | Annotated[RestitutionFit, Tag("<fit>")],
    chosen(_restitution_tag, "a number or {sigma: 3.0, psi: 0.5} is asked here"),
]


class Pair(Model):
    """What happens where two materials touch."""

    restitution: Restitution = Field(
        description="restitution coefficient, a number in [0, 1], or sigma and psi of Eq. 12"
    )
    friction: FrictionNumber = Field(description="Coulomb friction coefficient; 0 states that there is none")
    rolling_friction: FrictionNumber | None = Field(
        None, description="rolling friction coefficient; needed unless contact.rolling is none"
    )


class ZhouNormal(Model):
    """Hertz loading, nonlinear plastic unloading (Zhou 2011)."""

    law: Literal["zhou"] = Field(description="name of the normal law")
    restitution: Literal["onset", "peak", "constant"] = Field(
        "onset",
        description="which velocity gives e: that at first touch, that which Eq. 5 gives for the largest overlap, "
        "or none; a number in every pair makes it constant",
    )
    damping_ratio: DampingRatio = Field(
        0.0, description="viscous damping on the elastic branch, over the critical damping"
    )


class HertzNormal(Model):
    """Hertz spring; viscous damping that gives each pair's restitution number, 1 being elastic."""

    law: Literal["hertz"] = Field(description="name of the normal law")


class ReferenceVelocity(Model):
    """One linear spring per pair, from Eq. 19 at this approach velocity."""

    reference_velocity: Speed = Field(description="approach velocity at which the spring stores what Hertz does [m/s]")


class GivenStiffness(Model):
    """One linear spring for all contacts."""

    value: Stiffness = Field(description="stiffness of the spring [N/m]")


def _stiffness_tag(value: Any) -> str | None:
    if value == "onset":
        return "<onset>"
    for tag, model in (("value", GivenStiffness), ("reference_velocity", ReferenceVelocity)):
        if isinstance(value, model) or (isinstance(value, dict) and tag in value):
            return f"<{tag}>"
    return None


LinearStiffness = Annotated[
    Annotated[Literal["onset"], Tag("<onset>")]
    | Annotated[ReferenceVelocity, Tag("<reference_velocity>")]
    | Annotated[GivenStiffness, Tag("<value>")],
    chosen(_stiffness_tag, "it must be onset, {reference_velocity: 1 m/s} or {value: 1e4 N/m}"),
]


class LinearNormal(Model):
    """Linear spring and dashpot."""

    law: Literal["linear"] = Field(description="name of the normal law")
    stiffness: LinearStiffness = Field(
        description="onset (Eq. 19 per contact, from its own first velocity), {reference_velocity: 1 m/s} "
        "or {value: 1e4 N/m}"
    )


Normal = Annotated[
    Annotated[ZhouNormal, Tag("<zhou>")]
    | Annotated[HertzNormal, Tag("<hertz>")]
    | Annotated[LinearNormal, Tag("<linear>")],
    choice("law"),
    shorthand("law"),
    AlsoWritten(("zhou", "hertz")),
]


class Contact(Model):
    """The laws of contact, the same for every pair."""

    normal: Normal = Field(description="zhou, hertz or linear, or a mapping with `law` and its settings")
    tangential: Literal["mindlin", "none"] = Field(description="mindlin (spring with history, Coulomb cap) or none")
    rolling: Literal["none", "epsd", "cdt"] = Field(
        description="none, epsd (elastic-plastic spring torque) or cdt (constant directional torque)"
    )
