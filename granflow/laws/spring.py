"""The linear spring of the laws that have one: a number, or Zhou's Eq. 19 at one velocity or per contact."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import taichi as ti

from granflow.laws import theory
from granflow.laws.law import ContactState, ModelRequest
from granflow.laws.material import PairMaterial

MIN_VELOCITY_SHARE = 0.01
"""Eq. 19 per contact takes an approach velocity of at least this share of the largest."""


@dataclass(frozen=True)
class Spring:
    """A spring stiffness [N/m] that a contact keeps from first touch on."""

    history_names: tuple[str, ...]
    """What a contact must remember of it: nothing where the stiffness is a number."""
    prepare: Any
    """Device function for NormalLaw.prepare: the spring of a contact that opens, where constants[0] is the effective
    modulus. None where the stiffness is a number."""
    stiffness_of: Any
    """Device function (history) -> stiffness."""
    host_stiffness: Callable[[float, float, float, float], float]
    """Stiffness of (modulus_eff, radius_eff, mass_eff, velocity)."""
    history_index: int
    """Where the stiffness stands in the law's history."""

    def stiffness(self, pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float) -> float:
        """Stiffness [N/m] in a collision of this pair."""
        return self.host_stiffness(pair.modulus_eff, radius_eff, mass_eff, velocity)

    def reference_stiffness(self, contact: ContactState) -> tuple[float, list[float]]:
        """Numpy twin of `prepare` and `stiffness_kept`: stiffness, and what the history holds of it."""
        stiffness_kept = contact.history[self.history_index] if self.history_names else 0.0
        stiffness_new = self.host_stiffness(
            contact.constants[0], contact.radius_eff, contact.mass_eff, contact.overlap_rate
        )
        stiffness = float(stiffness_kept) if stiffness_kept > 0.0 else stiffness_new
        return stiffness, [stiffness] if self.history_names else []


@ti.func
def equivalent_spring(constants, radius_eff, mass_eff, velocity):
    """Spring with the Hertz contact's energy at its largest overlap, (4/5) k sqrt(dmax) [N/m] (Zhou 2011, Eq. 19)."""
    k = 4.0 / 3.0 * constants[0] * ti.sqrt(radius_eff)
    return 0.8 * k * ti.pow(1.25 * mass_eff * velocity * velocity / k, 0.2)


@ti.func
def tangential_spring(constants, stiffness):
    """Mindlin's ratio of tangential to normal stiffness, 4 G / E, on a linear spring [N/m]; constants E, G first."""
    return 4.0 * constants[1] / constants[0] * stiffness


def build_spring(
    stiffness: float | None, reference_velocity: float | None, velocity_floor: float, history_index: int
) -> Spring:
    """A spring [N/m], or Eq. 19 at a reference velocity [m/s], or per contact (both None).

    Per contact the spring comes from that contact's own approach velocity, at least `velocity_floor`: Eq. 19 gives
    no spring at all to a contact that forms at rest. `history_index` is its place in the law's history.
    """
    is_given, fixed = stiffness is not None, reference_velocity is not None

    @ti.func
    def prepare(constants, radius_eff, mass_eff, time_step, overlap, overlap_rate, history):
        history_new = history
        if history_new[history_index] == 0.0:
            velocity = ti.max(overlap_rate, velocity_floor)
            if ti.static(fixed):
                velocity = 0.0 * overlap_rate + reference_velocity
            history_new[history_index] = equivalent_spring(constants, radius_eff, mass_eff, velocity)
        return history_new

    @ti.func
    def stiffness_of(history):
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
    """The spring that a scene asks for under `stiffness`; `history_index` is its place in the law's history."""
    given: str | Mapping[str, float] = request.settings["stiffness"]
    keyed: Mapping[str, float] = {} if isinstance(given, str) else given
    velocity_floor = MIN_VELOCITY_SHARE * request.velocity_max
    return build_spring(keyed.get("value"), keyed.get("reference_velocity"), velocity_floor, history_index)


def quarter_period(stiffness: float, mass_eff: float) -> float:
    """Time [s] from first touch to the largest overlap on a linear spring."""
    return 0.5 * np.pi * float(np.sqrt(mass_eff / stiffness))
