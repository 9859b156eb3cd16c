"""Linear spring of contact models: a given stiffness, or Zhou's Eq. 19 at one velocity or per contact."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import taichi as ti

from granflow.contact import theory
from granflow.contact.material import PairMaterial
from granflow.contact.model import ContactState, ModelRequest
from granflow.contact.theory import MIN_VELOCITY_SHARE


@dataclass(frozen=True)
class Spring:
    """Spring whose stiffness [N/m] is constant from first touch to separation."""

    history_names: tuple[str, ...]
    """History fields of the spring; empty if the stiffness is a number."""
    prepare: Any
    """Device function for NormalLaw.prepare that sets the stiffness at first touch; constants[0] is the effective
    modulus. None if the stiffness is a number."""
    stiffness_of: Any
    """Device function (history) -> stiffness."""
    host_stiffness: Callable[[float, float, float, float], float]
    """Stiffness of (modulus_eff, radius_eff, mass_eff, velocity)."""
    history_index: int
    """Index of the stiffness in the history of the contact model."""

    def stiffness(self, pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float) -> float:
        """Stiffness [N/m] in a collision of a pair; arguments as for `law.PhaseDurations`."""
        return self.host_stiffness(pair.modulus_eff, radius_eff, mass_eff, velocity)

    def reference_stiffness(self, contact: ContactState) -> tuple[float, list[float]]:
        """Reference implementation of `prepare` and `stiffness_of`: stiffness [N/m] and its history fields."""
        stiffness_saved = contact.history[self.history_index] if self.history_names else 0.0
        stiffness_new = self.host_stiffness(
            contact.constants[0], contact.radius_eff, contact.mass_eff, contact.overlap_rate
        )
        stiffness = float(stiffness_saved) if stiffness_saved > 0.0 else stiffness_new
        return stiffness, [stiffness] if self.history_names else []


@ti.func
def equivalent_spring(constants, radius_eff, mass_eff, velocity):
    """Stiffness [N/m] with the Hertz energy at the same maximum overlap (Zhou 2011, Eq. 19).

    K = (4/5) k sqrt(dmax) = (4/5) k (5 M v^2 / (4 k))^(1/5)        k = (4/3) E sqrt(R), constants[0] is E
    """
    k = 4.0 / 3.0 * constants[0] * ti.sqrt(radius_eff)
    return 0.8 * k * ti.pow(1.25 * mass_eff * velocity * velocity / k, 0.2)


@ti.func
def tangential_spring(constants, stiffness):
    """Tangential stiffness [N/m] of a linear spring: Mindlin's ratio 4 G / E times the normal stiffness.

    constants[0] is E, constants[1] is G.
    """
    return 4.0 * constants[1] / constants[0] * stiffness


def build_spring(
    stiffness: float | None, reference_velocity: float | None, velocity_floor: float, history_index: int
) -> Spring:
    """Spring with a given stiffness [N/m], or Eq. 19 at a reference velocity [m/s], or per contact (both None).

    stiffness:           constant stiffness [N/m]
    reference_velocity:  velocity [m/s] in Eq. 19
    velocity_floor:      smallest velocity [m/s] in Eq. 19 per contact, because the stiffness would be zero for a
                         contact that forms at rest
    history_index:       index of the stiffness in the history of the contact model
    """
    is_given, fixed = stiffness is not None, reference_velocity is not None

    @ti.func
    def prepare(constants, radius_eff, mass_eff, time_step, overlap, overlap_rate, history):
        """Set the stiffness in the history at first touch."""
        history_new = history
        if history_new[history_index] == 0.0:
            velocity = ti.max(overlap_rate, velocity_floor)
            if ti.static(fixed):
                velocity = 0.0 * overlap_rate + reference_velocity
            history_new[history_index] = equivalent_spring(constants, radius_eff, mass_eff, velocity)
        return history_new

    @ti.func
    def stiffness_of(history):
        """Stiffness [N/m] of a contact."""
        value = 0.0 * history[0]
        if ti.static(is_given):
            value += stiffness
        else:
            value += history[history_index]
        return value

    def host_stiffness(modulus: float, radius_eff: float, mass_eff: float, velocity: float) -> float:
        if stiffness is not None:
            return stiffness
        speed = max(velocity, velocity_floor) if reference_velocity is None else reference_velocity
        return float(theory.equivalent_spring(theory.hertz_stiffness(modulus, radius_eff), mass_eff, speed))

    names = () if is_given else ("spring_stiffness",)
    return Spring(names, None if is_given else prepare, stiffness_of, host_stiffness, history_index)


def spring_for(request: ModelRequest, history_index: int) -> Spring:
    """Spring from the setting `stiffness` of a scene.

    request:        settings as in `catalog.SPRING`; the velocity floor is MIN_VELOCITY_SHARE of its `velocity_max`
    history_index:  index of the stiffness in the history of the contact model
    """
    given: str | Mapping[str, float] = request.settings["stiffness"]
    keyed: Mapping[str, float] = {} if isinstance(given, str) else given
    velocity_floor = MIN_VELOCITY_SHARE * request.velocity_max
    return build_spring(keyed.get("value"), keyed.get("reference_velocity"), velocity_floor, history_index)


def quarter_period(stiffness: float, mass_eff: float) -> float:
    """Time [s] from first touch to the maximum overlap of a linear spring, (pi/2) sqrt(M / K)."""
    return 0.5 * np.pi * float(np.sqrt(mass_eff / stiffness))
