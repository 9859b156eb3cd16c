"""Contact laws with the example options of the registry, and the materials of the pictures."""

from typing import Any

from granflow.contact import registry
from granflow.contact.law import Law, ModelRequest, NormalLaw
from granflow.contact.material import (
    PairMaterial,
    VelocityRestitution,
    limit_velocity,
    modulus_eff,
    shear_modulus_eff,
)
from granflow.scene.blocks.materials import PRESETS, Material

STEEL = PRESETS["stainless_316"]
SOLID = Material(
    young_modulus=STEEL.young_modulus,
    poisson_ratio=STEEL.poisson_ratio,
    density=STEEL.density,
    yield_strength=STEEL.yield_strength,
)
CONDUCTOR = SOLID.model_copy(update={"thermal_conductivity": 15.0})
DIAMETER = 25.4e-3
"""Diameter [m] of the two spheres of the pictures, as in Figs. 3 and 4 of Zhou (2011)."""
RESTITUTION = 0.8
"""Restitution coefficient of models that take one number."""
LARGEST_VELOCITY = 10.0
UNLOADING_ANGLE = 0.5


ADHESION = {
    "cohesion_energy_density": 1e5, "work_of_adhesion": 0.05, "surface_tension": 0.072,
    "contact_angle": 0.3, "liquid_volume": 1e-16, "hamaker_constant": 1e-19, "separation": 1e-8,
    "plasticity": 0.5, "pull_off_force": 0.0,
}  # fmt: skip
"""Options of a pair for the cohesion models, in SI units."""


def pair(restitution: float | VelocityRestitution | None = RESTITUTION) -> PairMaterial:
    """Steel on steel with friction 0.5 and rolling friction 0.1."""
    return PairMaterial(
        modulus_eff(SOLID, SOLID),
        shear_modulus_eff(SOLID, SOLID),
        restitution,
        STEEL.yield_strength,
        {
            "friction": 0.5,
            "rolling_friction": 0.1,
            "rolling_damping": 0.3,
            "rolling_dissipation": 1e-3,
            "twisting_friction": 1e-5,
        }
        | ADHESION,
        (CONDUCTOR, CONDUCTOR),
    )


def fitted_pair() -> PairMaterial:
    """Steel on steel with the restitution of the preset (Zhou 2011, Eq. 12)."""
    assert STEEL.restitution_fit is not None
    return pair(VelocityRestitution(*STEEL.restitution_fit, limit_velocity(SOLID, SOLID)))


def example_pair(name: str) -> PairMaterial:
    """Pair of a normal model: fitted restitution if the model accepts it, else a number, or none."""
    accepted = registry.models("normal")[name].restitution
    return {"number or fit": fitted_pair, "positive number": pair, "nothing": lambda: pair(None)}[accepted]()


def example_law(slot: str, name: str, **options: Any) -> Law:
    """Law of a registered model with its example options, defaults, and `options`."""
    model = registry.models(slot)[name]
    request = ModelRequest(
        model.options(**model.example | options),
        (example_pair(name) if slot == "normal" else pair(),),
        LARGEST_VELOCITY,
        UNLOADING_ANGLE,
    )
    return model.law.from_scene(request)


def normal_law(name: str, **options: Any) -> NormalLaw:
    """Normal law with its example options."""
    law = example_law("normal", name, **options)
    assert isinstance(law, NormalLaw)
    return law


def two_spheres() -> tuple[float, float]:
    """Effective radius [m] and effective mass [kg] of the two spheres."""
    mass = SOLID.density * 3.141592653589793 * DIAMETER**3 / 6.0
    return DIAMETER / 4.0, mass / 2.0
