"""The normal laws by name: a new law is one new file, `<name>.py`, and one entry here. No Taichi."""

from collections.abc import Mapping
from types import MappingProxyType

from granflow.laws.model_kind import Amount, Choice, LawKind

SPRING = Choice(
    "onset (Eq. 19 per contact, from its own first velocity), {reference_velocity: 1 m/s} or {value: 1e4 N/m}",
    words=("onset",),
    keyed={
        "reference_velocity": Amount(
            "approach velocity at which the spring stores what Hertz does [m/s]",
            *("1 m/s", "velocity", "a speed"),
            above=0,
        ),
        "value": Amount("stiffness of the spring [N/m]", "1e4 N/m", "stiffness", above=0),
    },
)

ZHOU = LawKind(
    "zhou",
    "Hertz loading, nonlinear plastic unloading (Zhou 2011).",
    {
        "restitution_at": Choice(
            "which velocity gives e: that at first touch, that which Eq. 5 gives for the largest overlap, "
            "or none; a number in every pair makes it constant",
            words=("impact", "max_overlap", "constant"),
            default="impact",
            with_numbers="constant",
        ),
        "damping_ratio": Amount(
            "viscous damping on the elastic branch, over the critical damping",
            *("0.1", "number", "a damping ratio"),
            at_least=0,
            at_most=1,
            default=0.0,
        ),
    },
    "number or fit",
)
HERTZ = LawKind("hertz", "Hertz spring; viscous damping that gives each pair's restitution number, 1 being elastic.")
LINEAR = LawKind("linear", "Linear spring and dashpot.", {"stiffness": SPRING}, example={"stiffness": "onset"})
THORNTON = LawKind(
    "thornton",
    "Elastic, perfectly plastic spheres: the yield strength decides the restitution (Thornton 1997).",
    {
        "yield_ratio": Amount(
            "largest contact pressure over the yield strength: 1.6 where yield begins below the surface "
            "(Thornton 1997), 2.8 where the contact is fully plastic (Johnson 1985)",
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
            "constant (k2 = k1 / e^2: one restitution) or {reference_velocity: 1 m/s} (k2 grows with the largest "
            "force, so that each pair's restitution is that at this velocity, and e falls)",
            words=("constant",),
            keyed={
                "reference_velocity": Amount(
                    "approach velocity with each pair's restitution [m/s]", *("1 m/s", "velocity", "a speed"), above=0
                )
            },
        ),
    },
    example={"stiffness": "onset", "unloading": "constant"},
)
LUDING = LawKind(
    "luding",
    "Bilinear with a plasticity that grows up to a limit overlap, elastic beyond it (Luding 2008); each pair's "
    "restitution is that at the limit.",
    {
        "stiffness": SPRING,
        "plasticity_depth": Amount(
            "largest residual overlap over 2 R, R being the effective radius, such as 0.05",
            *("0.05", "number", "a ratio"),
            above=0,
            at_most=1,
        ),
        "tension": Amount(
            "stiffness kc of the tension line -kc d over the loading stiffness; 0 for none",
            *("0.2", "number", "a ratio"),
            at_least=0,
            default=0.0,
        ),
    },
    example={"stiffness": "onset", "plasticity_depth": 0.05, "tension": 0.0},
)
KUWABARA_KONO = LawKind(
    "kuwabara_kono",
    "Viscoelastic spheres, Hertz with damping by the square root of the overlap (Kuwabara & Kono 1987): e falls.",
    {
        "reference_velocity": Amount(
            "approach velocity at which each pair has its restitution [m/s]", *("1 m/s", "velocity", "a speed"), above=0
        )
    },
    example={"reference_velocity": 1.0},
)

NORMAL_LAWS: Mapping[str, LawKind] = MappingProxyType(
    {kind.name: kind for kind in (ZHOU, HERTZ, LINEAR, THORNTON, WALTON_BRAUN, LUDING, KUWABARA_KONO)}
)
