"""Rolling torques against the rolling rate that never reverse a rotation: base class of CDT and the viscous
torque.

A contact removes at most `STOPPED_SHARE` of the relative rate per step. A particle with moment of inertia I_i
receives I_j / (I_i + I_j) of that from each neighbor j, 1 from each wall. For non-overlapping spheres of any
size around one sphere the sum is below 8 (the largest sum is 7.5, for twelve neighbors 1.11 times as large).
The rate after the step is then a mean of the rates of the particle and its neighbors: no rotation reverses,
and rotation relative to the neighbors decays, for any number of simultaneous contacts.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from granflow.contact.law import (
    HistoryField,
    ModelRequest,
    RollingLaw,
    SurfaceState,
    in_contact_plane,
    reference_in_contact_plane,
)
from granflow.device_functions import ti

STOPPED_SHARE = 0.125
"""Largest fraction of the relative rolling rate that one contact removes in one step."""


@ti.func
def bounded_torque(largest, rolling_rate, speed, inertia_eff, time_step):
    """Torque [N m] against the rolling rate w [rad/s], at most `largest` [N m].

        T = -min(largest / |w|, I / (8 dt)) w

    rolling_rate:  w, 3-vector
    speed:         |w|
    inertia_eff:   effective moment of inertia I [kg m2]
    time_step:     dt [s], the longest of the run, so that a force evaluation between two steps has the same
                   limit
    """
    size = ti.min(largest, STOPPED_SHARE * inertia_eff * speed / time_step)
    return ti.select(speed > 0.0, -size / speed, 0.0) * rolling_rate


@ti.func
def torque_loss(torque_before, torque, rolling_rate, time_step):
    """Energy dissipated by a torque during one step [J]; exact for the leapfrog scheme, for any other
    torques.

        W = -(T(t - dt) + T(t)) / 2 . w(t - dt/2) dt

    torque_before, torque:  T of the previous and of this step [N m]
    rolling_rate:           relative angular velocity w at the half step [rad/s]

    Each kick changes the kinetic energy by the torque times the mean of the rates before and after. In the
    sum over all steps each half-step rate is multiplied by half of the torque before and half of the torque
    after it.
    """
    return -0.5 * time_step * (torque_before + torque).dot(rolling_rate)


@dataclass(frozen=True)
class BoundedTorque(RollingLaw):
    """A torque against the rolling rate, bounded as described above.

    energy_budget:  whether the torque is saved for the dissipated energy
    """

    energy_budget: bool

    @classmethod
    def from_scene(cls, request: ModelRequest) -> "BoundedTorque":
        """The law that a scene requests."""
        return cls(request.energy_budget)

    @property
    def history(self) -> tuple[HistoryField, ...]:
        """Torque of the previous step, with the energy budget."""
        return (HistoryField("torque", "rolling torque", "N m", size=3),) if self.energy_budget else ()

    @ti.func
    def torque_size(self, constants, contact, speed):
        """Size of the torque [N m] at a rolling rate [rad/s], without the bound."""

    def reference_size(self, contact: SurfaceState, speed: float) -> float:
        """Reference implementation of `torque_size`."""
        raise NotImplementedError

    @ti.func
    def torque(self, constants, contact, history):
        """Torque [N m] against the tangential rolling rate."""
        rate = contact.rolling_rate
        history_new = history
        energy_lost = 0.0 * contact.stiffness
        tangential_rate = in_contact_plane(rate, contact.normal, contact.normal_half)
        speed = ti.sqrt(tangential_rate.dot(tangential_rate))
        largest = self.torque_size(constants, contact, speed)
        torque = bounded_torque(
            largest, tangential_rate, speed, contact.inertia_eff, contact.longest_time_step
        )
        if ti.static(self.energy_budget):
            energy_lost = torque_loss(history.torque, torque, rate, contact.time_step)
            history_new.torque = torque
        return torque, history_new, energy_lost

    def reference(self, contact: SurfaceState) -> tuple[np.ndarray, Mapping[str, Any]]:
        """Reference implementation of `torque` in numpy."""
        rate = reference_in_contact_plane(contact.rolling_rate, contact)
        speed = float(np.linalg.norm(rate))
        stopping = STOPPED_SHARE * contact.inertia_eff * speed / contact.longest_time_step
        size = min(self.reference_size(contact, speed), stopping)
        torque = -size * rate / speed if speed > 0.0 else np.zeros(3)
        return torque, {"torque": torque} if self.energy_budget else {}
