"""Particles in and out of the device: grains that arrive, ranges that leave, everything for a snapshot."""

from collections.abc import Callable
from typing import Any

import numpy as np
import taichi as ti

from granflow.device.state import State


class Transfer:
    """Copies between host arrays and the particle fields."""

    def __init__(self, state: State) -> None:
        self.state = state
        self._append = _build_append(state)
        self._kick = _build_kick(state)

    def append(self, arrays: dict[str, np.ndarray]) -> None:
        """Put n more particles behind those that are there.

        `arrays`: id (n,), material (n,) numbers of the plan, radius (n,), mass (n,), position (n, 3), velocity
        (n, 3) half a step back, spin (n, 3).
        """
        state, particles = self.state, self.state.particles
        count = len(arrays["radius"])
        if not count:
            return
        real = particles.radius.dtype
        wide = np.float64 if real == ti.f64 else np.float32
        position = np.float64 if particles.position.dtype == ti.f64 else np.float32
        self._append(
            state.count,
            np.ascontiguousarray(arrays["id"], dtype=np.int32),
            np.ascontiguousarray(arrays["material"], dtype=np.int32),
            np.ascontiguousarray(arrays["radius"], dtype=wide),
            np.ascontiguousarray(arrays["mass"], dtype=wide),
            np.ascontiguousarray(arrays["position"], dtype=position),
            np.ascontiguousarray(arrays["velocity"], dtype=wide),
            np.ascontiguousarray(arrays["spin"], dtype=wide),
        )
        state.count += count

    def kick(self, time: float) -> None:
        """Advance velocities and spins by `time` [s] under the present forces; backwards if it is negative."""
        self._kick(self.state.count, time)

    def taken(self, names: tuple[str, ...], first: int = 0, last: int | None = None) -> dict[str, np.ndarray]:
        """Host copies of particle fields from index `first` to before `last` (the present count)."""
        end = self.state.count if last is None else last
        found = {}
        for name in names:
            values = getattr(self.state.particles, name)
            found[name] = None if values is None else values.to_numpy()[first:end]
        return {name: values for name, values in found.items() if values is not None}


def _build_append(state: State) -> Callable[..., None]:
    particles, features = state.particles, state.plan.features
    external: Any = ti.types.ndarray()

    @ti.kernel
    def append(
        first: ti.i32, ids: external, material: external, radius: external, mass: external,
        position: external, velocity: external, spin: external
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
                    particles.spin[i][axis] = spin[k, axis]
                    particles.torque[i][axis] = 0.0
                if ti.static(features.rate_dependent):
                    particles.velocity_now[i][axis] = velocity[k, axis]
            if ti.static(not features.one_material):
                particles.material[i] = material[k]

    return append


def _build_kick(state: State) -> Callable[..., None]:
    particles, rotation, real = state.particles, state.plan.features.rotation, state.backend.real

    @ti.kernel
    def kick(count: ti.i32, time: real):
        for i in range(count):
            particles.velocity[i] = particles.velocity[i] + time / particles.mass[i] * particles.force[i]
            if ti.static(rotation):
                inertia = 0.4 * particles.mass[i] * particles.radius[i] * particles.radius[i]
                particles.spin[i] = particles.spin[i] + time / inertia * particles.torque[i]

    return kick
