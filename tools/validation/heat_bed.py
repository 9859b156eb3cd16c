"""Validation cases of the effective conductivity of a bed of spheres between two plates (scene heat_bed).

With gas: Zehner & Schluender 1970, Chem.-Ing.-Tech. 42:933, as in the VDI Heat Atlas, D6.3, for equal spheres
without flattened contacts. With the porosity e, the conductivity k_s of the solid and k_g of the gas:

    k / k_g = 1 - sqrt(1 - e) + sqrt(1 - e) c,    K = k_s / k_g,   B = 1.25 ((1 - e) / e)^(10/9),   N = 1 - B / K
    c = 2/N [B (K - 1) / (N^2 K) ln(K / B) - (B + 1) / 2 - (B - 1) / N]

In vacuum: Batchelor & O'Brien 1977 for contacts in all directions, with z contacts of a sphere of the radius R,
the mean contact radius a, and the solid fraction p:

    k = p z a k_s / (pi R)
"""

import math

import numpy as np

from granflow import Simulation, Snapshot
from validation.case import ValidationCase, shipped_scene

RADIUS, AREA = 2e-3, 4e-4
"""Radius of the beads [m] and area of the plates [m2]."""
GAS, STEEL, GLASS = 0.026, 50.0, 1.05
"""Conductivities [W/(m K)] of air and of the beads."""
MIDDLE = (0.2, 0.8)
"""Part of the height in which gradient, solid fraction and contacts are measured: plates change both near
them."""
ZEHNER = "Zehner & Schluender 1970; VDI Heat Atlas, D6.3"
BATCHELOR = "Batchelor & O'Brien 1977, doi 10.1098/rspa.1977.0100"
OF_GAS = (
    "the formula has a shape factor fitted to measured beds, which scatter around it by tens of percent; "
    "films of gas leave out the heat that flows through the pores, 0.2 k_g, and beyond them, which matters for "
    "small k_s / k_g"
)
OF_CONTACTS = (
    "the formula neglects differences of temperature between neighbors of one particle, and the anisotropy of "
    "a bed that is pressed along one axis; both change beds by about 10 %"
)


def heat_bed_cases() -> list[ValidationCase]:
    """Steel and glass beads in air, and softened beads in vacuum."""
    return [
        _in_air("steel beads in air", STEEL, []),
        _in_air("glass beads in air", GLASS, [f"materials.steel.thermal_conductivity={GLASS}"]),
        _in_vacuum(),
    ]


def _in_air(name: str, solid: float, overrides: list[str]) -> ValidationCase:
    bed = _bed_at_the_end(overrides)
    reference = GAS * zehner_schluender(1.0 - _solid_fraction(bed), solid / GAS)
    return ValidationCase(
        kind="Heat conduction in a bed",
        name=f"effective conductivity, {name}",
        reference=reference,
        source=ZEHNER,
        value=_conductivity(bed),
        unit="W/(m K)",
        allowed=0.3,
        derivation=OF_GAS,
    )


def _in_vacuum() -> ValidationCase:
    overrides = ["contact.heat=conduction", f"materials.steel.thermal_conductivity={GLASS}"]
    bed = _bed_at_the_end([*overrides, "materials.steel.true_young_modulus=null"])
    contacts = bed.contacts
    assert contacts is not None
    height = contacts["position_i"][:, 2]
    chosen = _is_in_middle(height, bed) & (contacts["wall"] < 0)
    radius = float(np.sqrt(0.5 * RADIUS * contacts["overlap"][chosen]).mean())
    beads = _is_in_middle(bed.particles["position"][:, 2], bed)
    contact_number = float(bed.particles["coordination_number"][beads].mean())
    return ValidationCase(
        kind="Heat conduction in a bed",
        name="effective conductivity, soft beads in vacuum",
        reference=_solid_fraction(bed) * contact_number * radius * GLASS / (math.pi * RADIUS),
        source=BATCHELOR,
        value=_conductivity(bed),
        unit="W/(m K)",
        allowed=0.2,
        derivation=OF_CONTACTS,
    )


def zehner_schluender(porosity: float, ratio: float) -> float:
    """Conductivity of a bed over that of the gas; ratio: of solid to gas."""
    shape = 1.25 * ((1.0 - porosity) / porosity) ** (10.0 / 9.0)
    n = 1.0 - shape / ratio
    core = shape * (ratio - 1.0) / (n**2 * ratio) * math.log(ratio / shape)
    core = 2.0 / n * (core - 0.5 * (shape + 1.0) - (shape - 1.0) / n)
    share = math.sqrt(1.0 - porosity)
    return 1.0 - share + share * core


def _bed_at_the_end(overrides: list[str]) -> Snapshot:
    """The bed in its steady state."""
    with Simulation(shipped_scene("verification/heat_bed", overrides)) as simulation:
        simulation.run()
        return simulation.snapshot(contacts=True)


def _is_in_middle(height: np.ndarray, bed: Snapshot) -> np.ndarray:
    low, high = _middle(bed)
    return (height > low) & (height < high)


def _middle(bed: Snapshot) -> tuple[float, float]:
    """Heights [m] between which the bed is measured."""
    top = float(bed.particles["position"][:, 2].max()) + RADIUS
    return MIDDLE[0] * top, MIDDLE[1] * top


def _conductivity(bed: Snapshot) -> float:
    """Heat flux of the hot plate over the gradient of the temperature [W/(m K)]."""
    height = bed.particles["position"][:, 2]
    middle = _is_in_middle(height, bed)
    gradient = np.polyfit(height[middle], bed.particles["temperature"][middle], 1)[0]
    return float(bed.totals["wall_heat_flow.hot"] / AREA / gradient)


def _solid_fraction(bed: Snapshot) -> float:
    """Volume of the beads in the middle over that of the space there.

    Below a plane at the height h above the lowest point of a sphere is the volume pi h^2 (3 R - h) / 3.
    """
    height = bed.particles["position"][:, 2]
    low, high = _middle(bed)

    def below(plane: float) -> float:
        depth = np.clip(plane - height + RADIUS, 0.0, 2.0 * RADIUS)
        return float((math.pi * depth**2 * (3.0 * RADIUS - depth) / 3.0).sum())

    return (below(high) - below(low)) / (AREA * (high - low))
