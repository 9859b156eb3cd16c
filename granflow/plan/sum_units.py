"""Sums over contacts: the quantities that each chunk of particles sums, and the units that make them exact.

A contact rounds its force, torque, energy, ... to a multiple of a unit before it adds it. Sums of integers
are exact and do not depend on the order of their terms. The bits of a run then depend neither on the order
of the neighbor lists nor on skin, rebuilds, chunk size or number of threads.

The largest force of a contact within the overlap limit L, with R the largest radius that the smaller of two
particles in contact can have, and the overlap d = L R, is

    F = max[(4/3) E* sqrt(R) d^1.5,  k d + c v]        over all contacts that can occur, at least W

with k and c the tangent stiffness during loading and the viscosity of the normal and the cohesion model at
the planned velocity v, and W the weight of the heaviest sphere, which the sums contain: a large sphere among
small ones is heavier than the largest force of a contact. With F rounded up to a power of two, the unit of a
force is F / 2^45 = 3e-14 F: sums up to 2^7 F are exact in f64, and also exact if their terms are in f32, of
which those above 2^-23 F are multiples of half a unit.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import ceil, log2

import numpy as np

from granflow.contact.law import SLOTS, FlowCase, NormalLaw
from granflow.contact.registry import ContactLaws
from granflow.geometry.sphere import sphere_volume
from granflow.particles.group import SceneGroup
from granflow.plan.features import Features
from granflow.plan.pair_case import PairCase

# The quantities.

LOSSES = (
    "plastic_dissipation",
    "friction_dissipation",
    "rolling_dissipation",
    "damping_dissipation",
    "wall_work",
)
"""Terms of the energy budget that each chunk sums [J], with the names of the totals."""
LOSS_PLASTIC = LOSSES.index("plastic_dissipation")
LOSS_DAMPING = LOSSES.index("damping_dissipation")
LOSS_WALL_WORK = LOSSES.index("wall_work")
LOSS_VISCOUS = LOSSES.index(SLOTS["cohesion"].loss)
"""Term of the viscous force of a cohesion model."""


def terms_ahead(features: Features) -> tuple[int, ...]:
    """Terms of which a force evaluation counts a half for the next step, see `engine.contact.Accounting`."""
    walls = (LOSS_WALL_WORK,) if features.moving_walls else ()
    return (*walls, LOSS_VISCOUS) if features.viscous_cohesion else walls


IMPULSE_SIZE = 8
"""Components that each chunk sums for a wall: time integrals of force (3), torque (3), normal force (1) and
power (1)."""
WEAR_SIZE = 3
"""Sums of each worn face: volume, normal and tangential work."""


# The units.

FORCE_BITS, ENERGY_BITS, IMPULSE_BITS, WALL_BITS = 45, 70, 53, 43
"""Binary digits of the largest force in units of a force, and so on: fewer, if more terms are added.

An energy is added in two words, so that the contacts of small particles count in the presence of very large
ones.
"""
LOSS_HEAT_UNITS = 2.0**10
"""Unit of the heat of one particle in one step over that of energies: 64-bit integers hold 8 times the
largest energy of a contact."""
SUM_BITS = 50
"""Binary digits of the largest sum of forces on a particle in its unit, a quarter of what f64 represents
exactly in half units: partial sums can be larger than the sum."""
CARRY_BITS = 40
"""Binary digits of the low word of a sum over a run; a high word counts the rest."""
UNIT_FORCE, UNIT_TORQUE, UNIT_ENERGY, UNIT_IMPULSE, UNIT_ANGULAR_IMPULSE, UNIT_WALL_FORCE = range(6)
"""Order of the units in device arrays."""


@dataclass(frozen=True)
class SumUnits:
    """Units of the sums, powers of two.

    force:            force on a particle [N]
    torque:           torque on a particle [N m]
    energy:           dissipated energy and work [J]
    impulse:          time integral of a wall force [N s]
    angular_impulse:  time integral of a wall torque [N m s]
    wall_force:       force on a force-controlled wall [N]
    wear_volume:      worn volume of a wall [m3]
    """

    force: float
    torque: float
    energy: float
    impulse: float
    angular_impulse: float
    wall_force: float
    wear_volume: float = 1.0

    @property
    def largest_force(self) -> float:
        """Largest contact force [N] on a particle: above it, the sums are not exact."""
        return self.force * 2.0**SUM_BITS


def sum_units(
    pair_cases: Sequence[PairCase],
    law: NormalLaw,
    velocity: float,
    max_overlap: float,
    radius: float,
    time_step: float,
    size: float,
    weight: float = 0.0,
    volume_per_work: float = 0.0,
) -> SumUnits:
    """Units of a scene.

    pair_cases:   contacts that can occur, and those that only limit the time step
    velocity:     maximum expected impact velocity [m/s]
    max_overlap:  overlap limit over the radius
    radius:       largest radius [m]
    time_step:    longest time step [s]
    size:         largest distance [m] of a particle from the pivot of a wall
    weight:       [N], of the heaviest sphere
    volume_per_work:  largest worn volume over work of all walls [1/Pa]; 0 without wear
    """
    force = weight
    energy = 0.0
    possible = [case for case in pair_cases if case.pair_key is not None] or pair_cases
    for case in possible:
        overlap = max_overlap * case.overlap_radius
        hertz = 4.0 / 3.0 * case.pair.modulus_eff * np.sqrt(case.overlap_radius) * overlap**1.5
        stiffness = law.loading_stiffness(case.pair, case.radius_eff, case.mass_eff, velocity)
        viscosity = law.viscosity(*case.dashpot_arguments, velocity)
        spring = stiffness * overlap + (viscosity + sum(case.resistance)) * velocity
        force = max(force, hertz, spring)
        energy = max(energy, max(hertz, spring) * overlap)
    force_scale = _power_of_two(force)
    radius_scale = _power_of_two(radius)
    impulse = force_scale * _power_of_two(time_step) / 2.0**IMPULSE_BITS
    energy_unit = _power_of_two(energy) / 2.0**ENERGY_BITS
    return SumUnits(
        force=force_scale / 2.0**FORCE_BITS,
        torque=force_scale * radius_scale / 2.0**FORCE_BITS,
        energy=energy_unit,
        impulse=impulse,
        angular_impulse=impulse * _power_of_two(size),
        wall_force=force_scale / 2.0**WALL_BITS,
        wear_volume=energy_unit * _power_of_two(volume_per_work) if volume_per_work > 0.0 else 1.0,
    )


def _power_of_two(value: float) -> float:
    """Smallest power of two not below a positive value."""
    return 2.0 ** ceil(log2(value))


# The units of the sums that contact models declare.


def flow_units(
    laws: ContactLaws, cases: Sequence[FlowCase], sources: Mapping[str, float]
) -> dict[str, float]:
    """Unit of each sum of `laws.flows`, a power of two: the largest flow of a contact, or of a source, over
    2^FORCE_BITS.

    cases:    largest contacts of each two materials
    sources:  largest magnitude of a source of each flow that has one
    """
    found = {}
    for name in laws.flows:
        bounds = [law.flow_bounds(name, case)[0] for law in laws.laws if name in law.flows for case in cases]
        found[name] = _power_of_two(max(*bounds, sources.get(name, 0.0), TINY)) / 2.0**FORCE_BITS
    return found


def integral_unit(flow_unit: float, time_step: float) -> float:
    """Unit of the integral over time of a flow of a wall, as finer than that of a flow as that of an impulse
    than that of a force."""
    return flow_unit * _power_of_two(time_step) / 2.0 ** (IMPULSE_BITS - FORCE_BITS)


TINY = 1e-200
"""Largest flow of a model whose bound is 0: nothing flows."""


# The unit of liquid volumes: films and bridges exchange whole units.

LIQUID_BITS = 50
"""Binary digits of the volume of all liquid in its unit: three fewer than f64 has, for the halves of odd
volumes and for particles that a program adds."""


def liquid_unit(groups: Sequence[SceneGroup]) -> float:
    """Unit [m3] of liquid volumes, a power of two: bridges take whole units, so that all sums of volumes are
    exact.

    The liquid of all groups, with the largest diameters, over 2^LIQUID_BITS; 1 without liquid.
    """
    specs = [group.spec for group in groups]
    total = sum(
        each.sphere_count * (each.liquid_content or 0.0) * sphere_volume(0.5 * each.diameters[1])
        for each in specs
    )
    return 2.0 ** (ceil(log2(total)) - LIQUID_BITS) if total > 0.0 else 1.0
