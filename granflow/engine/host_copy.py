"""Copies particles to and from the device: insertion, deleted ranges, and snapshots."""

from collections.abc import Callable
from typing import Any

import numpy as np
import taichi as ti
from taichi.lang.util import to_numpy_type

from granflow.engine.frozen_masks import build_mobility
from granflow.engine.state import State


class HostCopy:
    """Copies between host arrays and the particle fields."""

    def __init__(self, state: State) -> None:
        self.state = state
        self._append = _build_append(state)
        self._kick = _build_kick(state)
        self._copies: dict[tuple[str, ...], FieldCopy] = {}

    def append(self, arrays: dict[str, np.ndarray]) -> None:
        """Append n particles behind the present ones.

        arrays:  id (n,), material (n,) numbers of the plan, fixed (n,) 1 or 0, radius (n,) [m], mass (n,) [kg],
                 position (n, 3) [m], velocity (n, 3) [m/s] half a step back, angular_velocity (n, 3) [rad/s]

        The arrays are converted to the types of the fields. Forces and torques of the new particles are zero.
        """
        state, particles = self.state, self.state.particles
        count = len(arrays["radius"])
        if not count:
            return
        real = particles.radius.dtype
        real_type = np.float64 if real == ti.f64 else np.float32
        position = np.float64 if particles.position.dtype == ti.f64 else np.float32
        self._append(
            state.count,
            np.ascontiguousarray(arrays["id"], dtype=np.int32),
            np.ascontiguousarray(arrays["material"], dtype=np.int32),
            np.ascontiguousarray(arrays["fixed"], dtype=np.int32),
            np.ascontiguousarray(arrays["radius"], dtype=real_type),
            np.ascontiguousarray(arrays["mass"], dtype=real_type),
            np.ascontiguousarray(arrays["position"], dtype=position),
            np.ascontiguousarray(arrays["velocity"], dtype=real_type),
            np.ascontiguousarray(arrays["angular_velocity"], dtype=real_type),
        )
        state.count += count

    def kick(self, time: float) -> None:
        """Advance velocities and angular velocities by `time` [s] under the present forces; backwards if negative.

        Fixed particles keep their velocity.
        """
        self._kick(self.state.count, time)

    def copy_to_host(self, names: tuple[str, ...], first: int = 0, last: int | None = None) -> dict[str, np.ndarray]:
        """Host copies of particle fields.

        names:        fields; those that the scene does not have are absent in the result
        first, last:  index range, `last` exclusive (default: the particle count)
        Returns:      arrays (k,) or (k, 3) in the types of the fields
        """
        count = (self.state.count if last is None else last) - first
        if names not in self._copies:
            self._copies[names] = FieldCopy(self.state, names)
        return self._copies[names].take(first, count)


class FieldCopy:
    """Copies some particle fields to the host with one kernel, as columns of one table of reals and one of integers.

    The `to_numpy` of Taichi compiles a kernel for each field and copies the whole capacity.
    """

    def __init__(self, state: State, names: tuple[str, ...]) -> None:
        fields = {name: getattr(state.particles, name) for name in names}
        self._fields = {name: field for name, field in fields.items() if field is not None}
        self._real = to_numpy_type(state.backend.position_real)
        self._columns: dict[str, slice] = {}
        self._widths = {True: 0, False: 0}
        for name, field in self._fields.items():
            first = self._widths[_is_integer(field)]
            self._columns[name] = slice(first, first + _component_count(field))
            self._widths[_is_integer(field)] = first + _component_count(field)
        self._copy = _build_copy(list(self._fields.values()), [part.start for part in self._columns.values()])

    def take(self, first: int, count: int) -> dict[str, np.ndarray]:
        """Arrays (count,) or (count, 3) by name, from index `first`."""
        reals = np.zeros((count, max(self._widths[False], 1)), self._real)
        integers = np.zeros((count, max(self._widths[True], 1)), np.int32)
        if count:
            self._copy(first, reals, integers)
        found = {}
        for name, field in self._fields.items():
            part = (integers if _is_integer(field) else reals)[:, self._columns[name]]
            shaped = part if _component_count(field) > 1 else part[:, 0]
            found[name] = np.ascontiguousarray(shaped, to_numpy_type(field.dtype))
        return found


def _is_integer(field: Any) -> bool:
    return bool(field.dtype == ti.i32)


def _component_count(field: Any) -> int:
    """Number of components of a field entry."""
    return int(getattr(field, "n", 1))


def _build_copy(fields: list[Any], columns: list[int]) -> Callable[..., None]:
    """Kernel (first, reals, integers): copy the entries from `first` on into columns of the two tables."""
    sizes, is_integer_field = [_component_count(field) for field in fields], [_is_integer(field) for field in fields]
    external: Any = ti.types.ndarray()

    @ti.kernel
    def copy(first: ti.i32, reals: external, integers: external):
        for k in range(reals.shape[0]):
            for f in ti.static(range(len(fields))):
                if ti.static(is_integer_field[f]):
                    integers[k, columns[f]] = fields[f][first + k]
                elif ti.static(sizes[f] == 1):
                    reals[k, columns[f]] = fields[f][first + k]
                else:
                    for axis in ti.static(range(sizes[f])):
                        reals[k, columns[f] + axis] = fields[f][first + k][axis]

    return copy


def _build_append(state: State) -> Callable[..., None]:
    """Kernel (first, arrays): write new particles from index `first` on.

    Writes:  all particle fields except coordination and position_at_rebuild
    """
    particles, features = state.particles, state.plan.features
    external: Any = ti.types.ndarray()

    @ti.kernel
    def append(
        first: ti.i32, ids: external, material: external, fixed: external, radius: external, mass: external,
        position: external, velocity: external, angular_velocity: external
    ):  # fmt: skip
        for k in range(ids.shape[0]):
            i = first + k
            particles.id[i] = ids[k]
            particles.radius[i] = radius[k]
            particles.mass[i] = mass[k]
            for axis in ti.static(range(3)):
                particles.position[i][axis] = position[k, axis]
                particles.velocity[i][axis] = velocity[k, axis]
                particles.force[i][axis] = 0.0
                if ti.static(features.rotation):
                    particles.angular_velocity[i][axis] = angular_velocity[k, axis]
                    particles.torque[i][axis] = 0.0
                if ti.static(features.rate_dependent):
                    particles.velocity_synchronized[i][axis] = velocity[k, axis]
            if ti.static(not features.one_material):
                particles.material[i] = material[k]
            if ti.static(features.fixed_particles):
                particles.fixed[i] = fixed[k]

    return append


def _build_kick(state: State) -> Callable[..., None]:
    """Kernel (count, time): velocity change of `HostCopy.kick`.

        v += time F / m,   w += time M / I,   I = (2/5) m R^2

    Reads:   force, torque, mass, radius, fixed
    Writes:  velocity, angular_velocity
    """
    particles, rotation, real = state.particles, state.plan.features.rotation, state.backend.real
    mobility = build_mobility(state)

    @ti.kernel
    def kick(count: ti.i32, time: real):
        for i in range(count):
            particles.velocity[i] = particles.velocity[i] + mobility(i) * time / particles.mass[i] * particles.force[i]
            if ti.static(rotation):
                inertia = 0.4 * particles.mass[i] * particles.radius[i] * particles.radius[i]
                particles.angular_velocity[i] = (
                    particles.angular_velocity[i] + mobility(i) * time / inertia * particles.torque[i]
                )

    return kick
