"""Linear spring and dashpot; the spring from Zhou's Eq. 19 (per contact or from one velocity) or a number."""

from collections.abc import Callable

import numpy as np
import taichi as ti

from granflow.laws import theory
from granflow.laws.law import NormalLaw
from granflow.laws.material import PairMaterial

CONSTANTS = ("modulus_eff", "shear_modulus_eff", "damping_ratio")


def pair_constants(pair: PairMaterial) -> tuple[float, ...]:
    """Numbers of CONSTANTS. Raises ValueError where the restitution is 0 or falls with velocity."""
    if not isinstance(pair.restitution, float):
        raise ValueError("the linear law takes one number as restitution coefficient")
    return pair.modulus_eff, pair.shear_modulus_eff, theory.damping_ratio_for(pair.restitution)


@ti.func
def equivalent_spring(constants, radius_eff, mass_eff, velocity):
    """Spring with the Hertz contact's energy at its largest overlap, (4/5) k sqrt(dmax) [N/m] (Zhou 2011, Eq. 19)."""
    k = 4.0 / 3.0 * constants[0] * ti.sqrt(radius_eff)
    return 0.8 * k * ti.pow(1.25 * mass_eff * velocity * velocity / k, 0.2)


def build(stiffness: float | None, reference_velocity: float | None, velocity_floor: float) -> NormalLaw:
    """Linear law with a spring [N/m], or Eq. 19 at a reference velocity [m/s], or per contact (both None).

    Per contact the spring comes from that contact's own approach velocity, at least `velocity_floor`: Eq. 19 gives
    no spring at all to a contact that forms at rest.
    """

    given, fixed = stiffness is not None, reference_velocity is not None

    @ti.func
    def spring_at(constants, radius_eff, mass_eff, velocity):
        value = 0.0 * radius_eff
        if ti.static(given):
            value += stiffness
        elif ti.static(fixed):
            value += equivalent_spring(constants, radius_eff, mass_eff, reference_velocity)
        else:
            value += equivalent_spring(constants, radius_eff, mass_eff, ti.max(velocity, velocity_floor))
        return value

    @ti.func
    def prepare(constants, radius_eff, mass_eff, time_step, overlap, overlap_rate, history):
        """The spring of a contact that opens."""
        memory = history
        if memory[0] == 0.0:
            memory[0] = spring_at(constants, radius_eff, mass_eff, overlap_rate)
        return memory

    @ti.func
    def prepared_force(constants, radius_eff, mass_eff, time_step, overlap, overlap_rate, history):
        """F = K d + 2 zeta sqrt(K M) d', cut where it would pull."""
        elastic = history[0] * overlap
        viscous = ti.max(2.0 * constants[2] * ti.sqrt(history[0] * mass_eff) * overlap_rate, -elastic)
        return elastic + viscous, viscous, history

    @ti.func
    def force(constants, radius_eff, mass_eff, time_step, overlap, overlap_rate, history):
        memory = prepare(constants, radius_eff, mass_eff, time_step, overlap, overlap_rate, history)
        return prepared_force(constants, radius_eff, mass_eff, time_step, overlap, overlap_rate, memory)

    @ti.func
    def stored_energy(constants, radius_eff, mass_eff, time_step, overlap, history):
        return 0.5 * history[0] * overlap * overlap

    @ti.func
    def lost_energy(constants, radius_eff, mass_eff, time_step, overlap, history):
        return 0.0 * overlap

    @ti.func
    def lateral_stiffness(constants, radius_eff, overlap, history):
        """Mindlin's ratio of tangential to normal stiffness, 4 G / E, on the linear spring [N/m]."""
        return 4.0 * constants[1] / constants[0] * history[0]

    def host_spring(pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float) -> float:
        if stiffness is not None:
            return stiffness
        speed = max(velocity, velocity_floor) if reference_velocity is None else reference_velocity
        k = theory.hertz_stiffness(pair.modulus_eff, radius_eff)
        return float(theory.equivalent_spring(k, mass_eff, speed))

    def phase_durations(pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float) -> tuple[float, float]:
        quarter = 0.5 * np.pi * float(np.sqrt(mass_eff / host_spring(pair, radius_eff, mass_eff, velocity)))
        return quarter, quarter

    return NormalLaw(
        name="linear",
        source="Cundall & Strack 1979; spring: Zhou 2011, Eq. 19; damping: Schwager & Poeschel 2007",
        constant_names=CONSTANTS,
        history_names=("spring_stiffness",),
        rate_dependent=True,
        lateral_grows=False,
        pair_constants=pair_constants,
        force=force,
        prepare=prepare,
        prepared_force=prepared_force,
        stored_energy=stored_energy,
        lost_energy=lost_energy,
        lateral_stiffness=lateral_stiffness,
        reference_force=_twin(host_spring),
        phase_durations=phase_durations,
        unloading_stiffness=host_spring,
    )


def _twin(host_spring: Callable[..., float]) -> Callable[..., tuple[float, np.ndarray]]:
    """Numpy twin of `force`."""

    def reference_force(
        constants: np.ndarray,
        radius_eff: float,
        mass_eff: float,
        time_step: float,
        overlap: float,
        overlap_rate: float,
        history: np.ndarray,
    ) -> tuple[float, np.ndarray]:
        spring = history[0]
        if spring == 0.0:
            pair = PairMaterial(constants[0], constants[1], 1.0, 0.0)
            spring = host_spring(pair, radius_eff, mass_eff, overlap_rate)
        viscous = 2.0 * constants[2] * np.sqrt(spring * mass_eff) * overlap_rate
        return float(max(spring * overlap + viscous, 0.0)), np.array([spring])

    return reference_force
