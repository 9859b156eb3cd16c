"""Material presets, each with its source."""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

_ZHOU = (
    "Zhou, Theor. Appl. Mech. Lett. 1, 041006 (2011), Figs. 3-4, after Stevens & Hrenya, Powder Technol. 154, 99 (2005)"
)
_GLASS = "soda-lime silicate glass, EN 572-1: Young's modulus 70 GPa, Poisson ratio 0.2, density 2500 kg/m3"


@dataclass(frozen=True)
class Preset:
    """A material in SI units.

    Moduli and strength [Pa], density [kg/m3]. `restitution_fit`: (sigma, psi) of Zhou (2011), Eq. 12, for contacts
    within the material, if known. `source`: reference.
    """

    young_modulus: float
    poisson_ratio: float
    density: float
    yield_strength: float | None
    restitution_fit: tuple[float, float] | None
    source: str


PRESETS: Mapping[str, Preset] = MappingProxyType(
    {
        "stainless_316": Preset(193e9, 0.35, 8030.0, 0.310e9, (3.0432, 0.540), _ZHOU),
        "chrome_52100": Preset(203e9, 0.28, 7830.0, 2.03e9, (0.1418, 0.3114), _ZHOU),
        "glass": Preset(70e9, 0.20, 2500.0, None, None, _GLASS),
    }
)
"""Materials by the name that `preset` of a material accepts."""
