"""Catalog of the normal contact models. A new model is one file, `<name>.py`, and one entry here. No Taichi."""

from collections.abc import Mapping
from types import MappingProxyType

from granflow.contact.model_kind import Amount, Choice, LawKind

SPRING = Choice(
    "onset (Zhou 2011, Eq. 19, for each contact at its impact velocity), {reference_velocity: 1 m/s} (Eq. 19 at this "
    "velocity) or {value: 1e4 N/m}",
    words=("onset",),
    keyed={
        "reference_velocity": Amount(
            "approach velocity [m/s] at which the spring stores the same energy as a Hertz contact",
            *("1 m/s", "velocity", "a speed"),
            above=0,
        ),
        "value": Amount(
            "stiffness [N/m] of the spring, for all pairs and particle sizes", "1e4 N/m", "stiffness", above=0
        ),
    },
)

ZHOU = LawKind(
    "zhou",
    "Hertz loading, nonlinear plastic unloading (Zhou 2011).",
    {
        "restitution_at": Choice(
            "velocity at which e is evaluated: impact (at first touch), max_overlap (from the maximum overlap, "
            "Zhou 2011, Eq. 5) or constant (e does not depend on velocity; always used if the restitution of "
            "every pair is a number)",
            words=("impact", "max_overlap", "constant"),
            default="impact",
            with_numbers="constant",
        ),
        "damping_ratio": Amount(
            "damping ratio of the viscous force on the elastic branch; 0: no viscous force, 1: critical damping",
            *("0.1", "number", "a damping ratio"),
            at_least=0,
            at_most=1,
            default=0.0,
        ),
    },
    "number or fit",
)
HERTZ = LawKind("hertz", "Hertz spring; viscous damping from the restitution number of each pair (1: elastic).")
LINEAR = LawKind("linear", "Linear spring and dashpot.", {"stiffness": SPRING}, example={"stiffness": "onset"})
THORNTON = LawKind(
    "thornton",
    "Elastic, perfectly plastic spheres: restitution follows from the yield strength (Thornton 1997).",
    {
        "yield_ratio": Amount(
            "ratio of the maximum contact pressure to the yield strength: 1.6 at the onset of yield below the surface "
            "(Thornton 1997), 2.8 for a fully plastic contact (Johnson 1985)",
            *("1.6", "number", "a ratio"),
            above=0,
        )
    },
    "nothing",
    example={"yield_ratio": 1.6},
)
WALTON_BRAUN = LawKind(
    "walton_braun",
    "Bilinear: stiffness k1 on loading, the steeper k2 on unloading (Walton & Braun 1986).",
    {
        "stiffness": SPRING,
        "unloading": Choice(
            "constant (k2 = k1 / e^2: constant restitution) or {reference_velocity: 1 m/s} (k2 increases with the "
            "maximum force; e decreases with velocity and equals the restitution of the pair at this velocity)",
            words=("constant",),
            keyed={
                "reference_velocity": Amount(
                    "approach velocity [m/s] at which e equals the restitution of the pair",
                    *("1 m/s", "velocity", "a speed"),
                    above=0,
                )
            },
        ),
    },
    example={"stiffness": "onset", "unloading": "constant"},
)
LUDING = LawKind(
    "luding",
    "Bilinear, with plasticity that increases up to a limit overlap, elastic beyond it (Luding 2008); the restitution "
    "of a pair applies at the limit.",
    {
        "stiffness": SPRING,
        "plasticity_depth": Amount(
            "ratio of the largest residual overlap to 2 R (R: effective radius), such as 0.05",
            *("0.05", "number", "a ratio"),
            above=0,
            at_most=1,
        ),
        "tension": Amount(
            "ratio of the stiffness kc of the tension line -kc d to the loading stiffness; 0: no tension",
            *("0.2", "number", "a ratio"),
            at_least=0,
            default=0.0,
        ),
    },
    example={"stiffness": "onset", "plasticity_depth": 0.05, "tension": 0.0},
)
KUWABARA_KONO = LawKind(
    "kuwabara_kono",
    "Viscoelastic spheres: Hertz spring with damping proportional to the square root of the overlap; e decreases with "
    "velocity (Kuwabara & Kono 1987).",
    {
        "reference_velocity": Amount(
            "approach velocity [m/s] at which e equals the restitution of the pair",
            *("1 m/s", "velocity", "a speed"),
            above=0,
        )
    },
    example={"reference_velocity": 1.0},
)

NORMAL_LAWS: Mapping[str, LawKind] = MappingProxyType(
    {kind.name: kind for kind in (ZHOU, HERTZ, LINEAR, THORNTON, WALTON_BRAUN, LUDING, KUWABARA_KONO)}
)
