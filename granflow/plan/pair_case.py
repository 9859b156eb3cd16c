"""One possible contact of a scene, and the time step that resolves it and keeps it stable.

Durations of contacts and stiffnesses come from the normal contact model.
"""

import math
from dataclasses import dataclass, replace

from granflow.contact.law import NormalLaw
from granflow.contact.material import PairMaterial, Solid

MAX_CONTACTS = 12
"""Maximum number of contacts of a sphere with equal spheres."""
NORMAL_MODES, SLIDING_MODES = 4.0, 20.0
"""Squared highest frequencies of densely packed equal spheres with 12 contacts, over K/M and Kt/M of a
contact."""
STABLE_SHARE = 0.99
"""Time step over the stability limit of the stiffest mode."""


@dataclass(frozen=True)
class PairCase:
    """A contact of two bodies: of a given one, or the stiffest of two groups, or of a group and a wall.

    materials:       names of both materials, that of the first particle first
    pair:            mixed constants of the materials
    radius_eff:      [m]
    mass_eff:        [kg]
    radius:          [m] of the first particle, whose Rayleigh time limits the time step
    overlap_radius:  [m] of the smaller particle, its largest in two groups; the overlap limit refers to it
    solid:           material of the first particle
    """

    name: str
    materials: tuple[str, str]
    pair: PairMaterial
    radius_eff: float
    mass_eff: float
    radius: float
    overlap_radius: float
    solid: Solid
    contact_count: int = MAX_CONTACTS
    """Maximum number of simultaneous contacts of a particle: at most the number of other particles and
    walls."""
    pair_key: str | None = None
    """Key of the material pair under `pairs`; None for a contact that limits the time step but cannot
    occur."""
    mass_ratio: float = 1.0
    """Largest mass of a clump over that of its sphere: dashpots have the former, motion at least the
    latter."""
    resistance: tuple[float, float] = (0.0, 0.0)
    """Largest ratios of the viscous force of the cohesion model to the velocity, normal and tangential [N
    s/m]."""

    @property
    def dashpot_arguments(self) -> tuple[PairMaterial, float, float]:
        """Constants of the materials, effective radius [m], and effective mass [kg] in the contact models."""
        return self.pair, self.radius_eff, self.mass_eff * self.mass_ratio

    def stiffer(self, factor: float) -> "PairCase":
        """The same contact with both effective moduli multiplied by `factor`."""
        pair = replace(
            self.pair,
            modulus_eff=factor * self.pair.modulus_eff,
            shear_modulus_eff=factor * self.pair.shear_modulus_eff,
        )
        return replace(self, pair=pair)

    def shortest_phase(self, law: NormalLaw, velocity: float) -> float:
        """Shorter of loading and unloading time [s] at an impact velocity [m/s]; the unloading time is
        bounded below.

        The bound is `law.unresolved_unloading` times the loading time: a contact model that limits its own
        unloading stiffness needs no shorter time step (durations: Zhou 2011, Eqs. 13 to 16, for the model of
        that paper).
        """
        loading, unloading = law.phase_durations(self.pair, self.radius_eff, self.mass_eff, velocity)
        return min(loading, max(unloading, law.unresolved_unloading(self.pair) * loading))

    def stable_step(self, law: NormalLaw, velocity: float) -> float:
        """Time step [s] above which the energy of a particle in contact can grow, for its stiffest
        arrangement.

        The leapfrog scheme is stable for a mode x'' = -w^2 x - 2 b x' up to w^2 dt^2 + 8 b dt = 4, since the
        velocity in the viscous force is v(t - dt/2) + dt/2 x''(t - dt); at the limit v changes its sign in
        every step. Masses M with z contacts of stiffness K and viscosity c, and tangential stiffness
        Kt = 4 G/E K with effective moduli, or that of the tangential model, if there is friction, have at
        most

            w^2 = S (K + 2 Kt)/M,   2 b = S c/M,   S = min(z, 4)   if neighbors move in opposite directions
            w^2 = S Kt/M,   S = min(2.5 z + 1, 20)                 if all rotate in the same sense and
                                                                   contacts slip

        With friction the second frequency is the higher one and halves the step. A contact model that limits
        its unloading stiffness has K dt^2 = theta^2 M there, or another number with damping, see
        `NormalLaw.unloading_number`.
        """
        pair_arguments = (self.pair, self.radius_eff, self.mass_eff, velocity)
        count = min(self.contact_count, MAX_CONTACTS)
        mass = self.mass_eff
        normal_modes = min(count, NORMAL_MODES)
        tangential_modes = min(2.5 * count + 1.0, SLIDING_MODES)
        tangential = self._tangential_stiffness(law, velocity)
        normal_resistance, tangential_resistance = self.resistance
        viscosity = law.viscosity(*self.dashpot_arguments, velocity)
        viscosity += normal_resistance + 2.0 * tangential_resistance
        margin = 4.0 - normal_modes * law.unloading_number(self.pair)
        steps = (
            _largest_step(
                law.stable_stiffness(*pair_arguments) + 2.0 * tangential, viscosity, mass / normal_modes, 4.0
            ),
            _largest_step(2.0 * tangential, viscosity, mass / normal_modes, margin),
            _largest_step(tangential, tangential_resistance, mass / tangential_modes, 4.0),
        )
        return STABLE_SHARE * min(steps)

    @property
    def viscous_step(self) -> float:
        """Time step [s] below which the viscous force of the cohesion model alone is stable, as in
        `stable_step`; infinite without one."""
        count = min(self.contact_count, MAX_CONTACTS)
        normal, tangential = self.resistance
        return STABLE_SHARE * min(
            _largest_step(0.0, normal + 2.0 * tangential, self.mass_eff / min(count, NORMAL_MODES), 4.0),
            _largest_step(0.0, tangential, self.mass_eff / min(2.5 * count + 1.0, SLIDING_MODES), 4.0),
        )

    def _tangential_stiffness(self, law: NormalLaw, velocity: float) -> float:
        """Tangential stiffness Kt [N/m] of a contact at an impact velocity [m/s]; 0 without friction."""
        pair = self.pair
        if not pair.has_tangential_force:
            return 0.0
        if pair.tangential_stiffness is not None:
            return pair.tangential_stiffness
        normal = law.loading_stiffness(pair, self.radius_eff, self.mass_eff, velocity)
        return 4.0 * pair.shear_modulus_eff / pair.modulus_eff * normal


def _largest_step(stiffness: float, viscosity: float, mass: float, limit: float) -> float:
    """Step [s] at which K/M dt^2 + 4 c/M dt equals `limit`; infinite for K = c = 0.

    `stiffness` K [N/m], `viscosity` c [N s/m], `mass` M [kg].
    """
    if stiffness == viscosity == 0.0:
        return math.inf
    scaled_mass = 0.25 * mass * limit
    return 2.0 * scaled_mass / (viscosity + math.sqrt(viscosity**2 + stiffness * scaled_mass))
