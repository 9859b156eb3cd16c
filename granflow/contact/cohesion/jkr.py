"""Johnson, Kendall & Roberts (1971): adhesive elastic spheres, with the pull beyond contact.

The attraction is the Hertz force minus the JKR force, so that a Hertz normal model and this model together
are the theory; with another normal model the attraction is the same. Lengths are in units of the contact
radius a_s at zero overlap and of d_s, energies follow from both:

    a_s^3 = 2 pi w R^2 / E        d_s = a_s^2 / R        y = sqrt(a / a_s)

    d / d_s = y^4 - y        F = 2 pi w R (4/3 y^6 - 2 y^3)        U = 2 pi w a_s^2 (8/15 y^10 - 4/3 y^7 +
    y^4/2)

The force is smallest at y^3 = 3/4: the pull-off force 3/2 pi w R. At a given distance the contact is stable
down to y^3 = 1/4, where it snaps off.
"""

import math
from dataclasses import dataclass

import numpy as np

from granflow.contact import theory
from granflow.contact.cohesion.bond import BondLaw
from granflow.contact.law import ContactModel, ContactState, ModelRequest, WorkOfAdhesion
from granflow.contact.material import PairMaterial
from granflow.device_functions import power, ti

SNAP_OFF = 0.75 * 0.25 ** (1.0 / 3.0)
"""Distance over d_s at which the contact snaps off: y - y^4 at y^3 = 1/4."""
AT_REST = 1.5 ** (2.0 / 3.0)
"""Contact radius over a_s without a load: y^2 at y^3 = 3/2."""
SMALLEST_SCALE = 1e-6
"""Smallest a_s over R on the device: pairs without adhesion have no length scale, and their attraction is
0."""


def contact_radius_scale(work_of_adhesion: float, modulus_eff: float, radius_eff: float) -> float:
    """Contact radius a_s [m] at zero overlap."""
    return float(np.cbrt(2.0 * math.pi * work_of_adhesion * radius_eff**2 / modulus_eff))


@ti.func
def length_scale(constants, contact):
    """Contact radius a_s [m] at zero overlap."""
    radius = contact.radius_eff
    cube = 2.0 * math.pi * constants.work_of_adhesion * radius * radius / constants.modulus_eff
    return ti.max(power(cube, 1.0 / 3.0), SMALLEST_SCALE * radius)


@ti.func
def root_of_contact_radius(d):
    """y of the stable contact: the largest root of y^4 - y = d, by Ferrari's method.

    Beyond snap-off, for d < -SNAP_OFF, it is the root at snap-off.

        m^3 + d m - 1/8 = 0        y = (sqrt(2 m) + sqrt(sqrt(2 / m) - 2 m)) / 2

    m = A - B with A^3 - B^3 = 1/8 and A B = d/3, as a quotient without cancellation.
    """
    third = ti.max(d, -SNAP_OFF) / 3.0
    a = power(0.0625 + ti.sqrt(ti.max(1.0 / 256.0 + third * third * third, 0.0)), 1.0 / 3.0)
    b = third / a
    m = 0.125 / (a * a + third + b * b)
    return 0.5 * (ti.sqrt(2.0 * m) + ti.sqrt(ti.max(ti.sqrt(2.0 / m) - 2.0 * m, 0.0)))


@dataclass(frozen=True)
class Jkr(BondLaw):
    """JKR adhesion with the work of adhesion w [J/m2] of the pair."""

    name = "jkr"
    source = (
        "Johnson, Kendall & Roberts 1971, doi 10.1098/rspa.1971.0141; Thornton & Ning 1998, Powder Technol. "
        "99:154"
    )
    limits = (
        "for large, soft particles (Tabor parameter above 5); exact with the hertz normal model, an "
        "approximation with any other; the friction limit uses the Hertz force without the attraction"
    )
    constant_names = ("work_of_adhesion", "modulus_eff")

    @property
    def relative_cost(self) -> float:
        """Measured: the contact radius is the root of a quartic equation."""
        return 4.5

    @classmethod
    def from_scene(cls, request: ModelRequest) -> "Jkr":
        """The law that a scene requests."""
        scales = [_scale(pair, request.radius_eff_max) for pair in request.pairs]
        bond_range = SNAP_OFF * max(scales) ** 2 / request.radius_eff_max if request.radius_eff_max else 0.0
        return cls(bond_range, request.energy_budget)

    def pair_constants(self, pair: PairMaterial) -> tuple[float, ...]:
        """Work of adhesion [J/m2] and effective modulus [Pa]."""
        return pair.properties["work_of_adhesion"], pair.modulus_eff

    @ti.func
    def rupture_distance(self, constants, contact):
        """Distance of snap-off [m], 0.4725 d_s."""
        scale = length_scale(constants, contact)
        return SNAP_OFF * scale * scale / contact.radius_eff

    @ti.func
    def bond_attraction(self, constants, contact):
        """Hertz force minus JKR force [N]."""
        scale = length_scale(constants, contact)
        relative = contact.overlap * contact.radius_eff / (scale * scale)
        y = root_of_contact_radius(relative)
        above = ti.max(relative, 0.0)
        cube = y * y * y
        unit = 2.0 * math.pi * constants.work_of_adhesion * contact.radius_eff
        return unit * (4.0 / 3.0 * (above * ti.sqrt(above) - cube * cube) + 2.0 * cube)

    @ti.func
    def contact_radius(self, constants, contact):
        """Contact radius a = a_s y^2 [m], with adhesion larger than that of Hertz."""
        scale = length_scale(constants, contact)
        y = root_of_contact_radius(contact.overlap * contact.radius_eff / (scale * scale))
        return scale * y * y

    @ti.func
    def bond_energy(self, constants, contact):
        """Elastic and surface energy [J] minus the energy of the Hertz contact."""
        scale = length_scale(constants, contact)
        relative = contact.overlap * contact.radius_eff / (scale * scale)
        y = root_of_contact_radius(relative)
        above = ti.max(relative, 0.0)
        fourth = y * y * y * y
        cube = y * y * y
        elastic = 8.0 / 15.0 * (fourth * cube * cube - above * above * ti.sqrt(above))
        unit = 2.0 * math.pi * constants.work_of_adhesion * scale * scale
        return unit * (elastic - 4.0 / 3.0 * fourth * cube + 0.5 * fourth)

    def reference_bond(self, contact: ContactState) -> tuple[float, float]:
        """Attraction and snap-off distance from the contact radius a as in the paper.

        d = a^2 / R - sqrt(2 pi w a / E)        F = 4 E a^3 / (3 R) - sqrt(8 pi w E a^3)
        """
        w = contact.constants.work_of_adhesion
        modulus = contact.constants.modulus_eff
        radius = contact.radius_eff
        if w == 0.0:
            return 0.0, 0.0
        pull = math.sqrt(2.0 * math.pi * w / modulus)
        snap = (0.25 * pull * radius) ** (2.0 / 3.0)  # contact radius at which the distance is largest
        a = _largest_root(pull * radius, contact.overlap * radius) ** 2
        force = 4.0 * modulus * a**3 / (3.0 * radius) - math.sqrt(8.0 * math.pi * w * modulus * a**3)
        hertz = 4.0 / 3.0 * modulus * math.sqrt(radius) * max(contact.overlap, 0.0) ** 1.5
        return hertz - force, pull * math.sqrt(snap) - snap**2 / radius

    def pull_off_force(self, pair: PairMaterial, radius_eff: float) -> float:
        """Pull-off force [N], 3/2 pi w R."""
        return 1.5 * math.pi * pair.properties["work_of_adhesion"] * radius_eff

    def equivalent_velocity(self, pair: PairMaterial, radius_eff: float, mass_eff: float) -> float:
        """Velocity [m/s] of a Hertz impact up to the contact radius of the pair at rest."""
        contact_radius = AT_REST * _scale(pair, radius_eff)
        return theory.velocity_for_radius(pair.modulus_eff, radius_eff, mass_eff, contact_radius)


def _largest_root(pull: float, load: float) -> float:
    """Largest real root y of y^4 - pull y - load, for pull > 0; 0 without a real root.

    The function is convex for y > 0, so that Newton's iteration decreases from an upper bound to the root.
    """
    lowest = (0.25 * pull) ** (1.0 / 3.0)
    least = lowest**4 - pull * lowest - load
    if least >= 0.0:  # of a double root, rounding decides on the sign
        return lowest if least <= 1e-12 * pull * lowest else 0.0
    y = max((2.0 * pull) ** (1.0 / 3.0), (2.0 * max(load, 0.0)) ** 0.25)
    while True:
        smaller = y - (y**4 - pull * y - load) / (4.0 * y**3 - pull)
        if not lowest < smaller < y:
            return y
        y = smaller


def _scale(pair: PairMaterial, radius_eff: float) -> float:
    """Contact radius a_s [m] of a pair at zero overlap."""
    return contact_radius_scale(pair.properties["work_of_adhesion"], pair.modulus_eff, radius_eff)


MODEL = ContactModel(
    Jkr,
    "adhesive elastic spheres, whose attraction continues without overlap (Johnson, Kendall & Roberts 1971)",
    pair_properties=WorkOfAdhesion,
)
