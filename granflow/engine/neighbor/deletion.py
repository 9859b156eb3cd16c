"""Particle deletion: which particles remain in a scene, checked at neighbor-list rebuilds only.

A particle is deleted if it is outside the domain or in an outlet, or if a program has marked it. The sort
puts the deleted particles behind the others, and the host lowers the particle count.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from granflow.engine.codes import REMOVED_BELOW
from granflow.engine.state import State
from granflow.kernel_language import ti


def build_remains(state: State) -> Any:
    """Device function (i): true if particle i is in the domain, not in an outlet, and not removed from
    Python.

    The spheres of a clump remain if its center of mass does.

    Reads:  position, radius, fixed, clump, clump_position
    """
    particles = state.particles
    fixed_particles = state.plan.features.fixed_particles
    remains_at = _build_remains_at(state)
    clumps = state.plan.features.clumps

    @ti.func
    def remains(i):
        fixed = 0
        if ti.static(fixed_particles):
            fixed = particles.fixed[i]
        return remains_at(particles.position[i], particles.radius[i], fixed)

    @ti.func
    def clump_remains(i):
        found = remains(i)
        if particles.clump[i] >= 0:
            found = remains_at(particles.clump_position[i], particles.radius[i], 0)
        return found

    return clump_remains if clumps else remains


def remaining(state: State, arrays: Mapping[str, np.ndarray]) -> np.ndarray:
    """Which of n particles on the host remain (n,), as `build_remains` decides.

    arrays:  position (n, 3), radius (n,) and, with fixed particles, fixed (n,), in the types of the fields
    """
    count = len(arrays["radius"])
    found = np.zeros(count, np.int32)
    if count:
        position = np.ascontiguousarray(arrays["position"])
        radius = np.ascontiguousarray(arrays["radius"])
        fixed = np.ascontiguousarray(arrays.get("fixed", np.zeros(count, np.int32)))
        state.built(_build_remaining)(position, radius, fixed, found)
    return found.astype(bool)


def _build_remaining(state: State) -> Any:
    """Kernel (position, radius, fixed, found): the result of `remaining`."""
    remains_at = _build_remains_at(state)
    real = state.backend.position_real
    external: Any = ti.types.ndarray()

    @ti.kernel
    def remaining_particles(position: external, radius: external, fixed: external, found: external):
        for i in range(found.shape[0]):
            p = ti.Vector([position[i, 0], position[i, 1], position[i, 2]], dt=real)
            found[i] = ti.cast(remains_at(p, radius[i], fixed[i]), ti.i32)

    return remaining_particles


def _build_remains_at(state: State) -> Any:
    """Device function (position, radius, fixed): true if such a particle remains.

    Along periodic axes, and in an expanding domain, only the outlets delete. A position that is NaN is
    outside; an outlet does not delete fixed particles. `changes.remove_particles` marks particles by a
    negative radius.
    """
    in_one_outlet = [_build_in_one_outlet(state, index) for index in range(len(state.plan.outlets))]
    low = state.parameter("domain_low")
    high = state.parameter("domain_high")
    unchecked_axes = range(3) if state.plan.domain.on_exit == "expand" else state.plan.periodic_box.axes

    @ti.func
    def in_outlet(p):
        out = False
        for d in ti.static(range(len(in_one_outlet))):
            out = out or in_one_outlet[d](p)
        return out

    @ti.func
    def remains_at(p, radius, fixed):
        inside = radius > REMOVED_BELOW
        lows = low()
        highs = high()
        for axis in ti.static(range(3)):
            if ti.static(axis in unchecked_axes):
                inside = inside & (p[axis] == p[axis])  # false for NaN
            else:
                inside = inside & (p[axis] >= lows[axis]) & (p[axis] <= highs[axis])
        if ti.static(state.plan.features.outlets):
            inside = inside and not (in_outlet(p) and fixed == 0)
        return inside

    return remains_at


def _build_in_one_outlet(state: State, index: int) -> Any:
    """Device function (point): true if the point [m] is in one outlet.

    An outlet is a box, a half space, or the part of a half space within a radius of its axis (disc).
    """
    outlet = state.plan.outlets[index]
    if outlet.kind == "box":
        return _build_in_box(state, index)
    return _build_in_half_space(state, index, outlet.kind)


def _build_in_box(state: State, index: int) -> Any:
    low = state.parameter(f"outlet.{index}.low")
    high = state.parameter(f"outlet.{index}.high")

    @ti.func
    def in_box(p):
        is_inside = True
        lows = low()
        highs = high()
        for axis in ti.static(range(3)):
            is_inside = is_inside & (p[axis] >= lows[axis]) & (p[axis] <= highs[axis])
        return is_inside

    return in_box


def _build_in_half_space(state: State, index: int, kind: str) -> Any:
    point = state.parameter(f"outlet.{index}.point")
    normal = state.parameter(f"outlet.{index}.normal")
    is_disc = kind == "disc"
    radius = state.parameter(f"outlet.{index}.radius") if is_disc else None

    @ti.func
    def in_half_space(p):
        from_point = p - point()
        direction = normal()
        along = from_point.dot(direction)
        is_inside = along >= 0.0
        if ti.static(is_disc):
            radial = from_point - along * direction
            is_inside = is_inside and radial.dot(radial) <= radius() * radius()
        return is_inside

    return in_half_space


def find_farthest(state: State) -> None:
    """Set the particle of an abort because of a coordinate above `plan.coordinate_limit` [m].

    Reads:   position, id
    Writes:  abort_particle
    """
    position = np.nan_to_num(np.abs(state.particles.position.to_numpy()[: state.count]), nan=0.0)
    state.control.abort_particle[0] = int(state.particles.id[int(position.max(axis=1).argmax())])
