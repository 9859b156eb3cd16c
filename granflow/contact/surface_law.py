"""Interfaces of tangential, rolling and twisting models.

In addition to the members of `contact` for all models, see `law`, the struct has for the first particle of the pair:

    normal, normal_half  unit normal n toward the first particle now, and normal p at the half step, the time of the
                         velocities, divided by its component along n: p . n = 1
    normal_load          force [N] that presses the surfaces together: normal force without attraction
    stiffness            no-slip tangential stiffness [N/m]
    stiffness_ratio      ratio of the previous to the present stiffness
    slip, slip_rate      relative tangential displacement in this step [m], and velocity [m/s], in the present contact
                         plane; tangential laws
    normal_damping       dashpot coefficient of the normal model [N s/m]; damped tangential and twisting laws
    rolling_rate         relative angular velocity [rad/s] at the half step; rolling and twisting laws
    inertia_eff          effective moment of inertia [kg m2]; rolling laws
    longest_time_step    longest time step of the run [s]; rolling laws

A law that integrates a rate over the step takes its components with p: along the normal `rate.dot(normal_half)`, in the
contact plane `in_contact_plane(rate, normal, normal_half)`. The normal n is half a step later than the rate, so that a
part of the rotation of the pair would be integrated as slip, rolling or twist.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any, ClassVar, TypeAlias

import numpy as np

from granflow.contact.law import Law
from granflow.device_functions import ti

SurfaceState: TypeAlias = SimpleNamespace
"""Arguments of a reference implementation: the members of `contact`, and `constants` and `history` by name."""


@ti.func
def in_contact_plane(vector, normal, normal_half):
    """Component of a vector in the contact plane at the half step, rotated with the plane to the present one.

        u - (u . n) p

    The rotation from the plane at the half step, whose normal is p, to that of n is a projection along p, with a
    relative error of the square of the angle between them; the component along p vanishes in it as well.
    """
    return vector - vector.dot(normal) * normal_half


def reference_in_contact_plane(vector: np.ndarray, contact: SurfaceState) -> np.ndarray:
    """Reference implementation of `in_contact_plane` in numpy."""
    return vector - np.vdot(vector, contact.normal) * contact.normal_half


@dataclass(frozen=True)
class TangentialLaw(Law):
    """A tangential contact model. An option `stiffness` [N/m] replaces that of the normal model in the time step."""

    required = ("force", "present_force", "limit")
    returns: ClassVar[Mapping[str, tuple[str, ...]]] = {
        **Law.returns,
        "force": ("vector", "history", "number"),
        "present_force": ("vector", "number"),
        "limit": ("number",),
    }

    @property
    def damped(self) -> bool:
        """Whether `force` reads `normal_damping`."""
        return False

    @ti.func
    def force(self, constants, contact, history):
        """Tangential force [N] on the first particle, the history, and the energy dissipated in this step [J]."""

    @ti.func
    def stored_energy(self, constants, contact, history):
        """Recoverable energy [J]."""
        return 0.0 * contact.stiffness

    def reference(self, contact: SurfaceState) -> tuple[np.ndarray, Mapping[str, Any]]:
        """Reference implementation of `force`: tangential force [N] (3,) and the changed history fields."""
        raise NotImplementedError

    @ti.func
    def present_force(self, constants, contact, history):
        """Tangential force [N] that the history alone gives, and its size [N]; for contact output."""

    @ti.func
    def limit(self, constants, contact):
        """Largest tangential force [N]."""


@dataclass(frozen=True)
class TorqueLaw(Law):
    """A model of torques on the first particle of a pair; the opposite torques act on the second."""

    required = ("torque",)
    returns: ClassVar[Mapping[str, tuple[str, ...]]] = {**Law.returns, "torque": ("vector", "history", "number")}

    @ti.func
    def torque(self, constants, contact, history):
        """Torque [N m] on the first particle, the history, and the energy dissipated in this step [J]."""

    def reference(self, contact: SurfaceState) -> tuple[np.ndarray, Mapping[str, Any]]:
        """Reference implementation of `torque`: torque [N m] (3,) and the changed history fields."""
        raise NotImplementedError

    @ti.func
    def stored_energy(self, constants, contact, history):
        """Recoverable energy [J]."""
        return 0.0 * contact.stiffness


@dataclass(frozen=True)
class RollingLaw(TorqueLaw):
    """A rolling model."""


@dataclass(frozen=True)
class TwistingLaw(TorqueLaw):
    """A twisting model, with torques about the normal.

    It reads `history` and `contact` for its stored energy, of which only `overlap`, `radius_eff`, `mass_eff` and
    `stiffness` are known.
    """

    @property
    def damped(self) -> bool:
        """Whether `torque` reads `normal_damping`."""
        return False
