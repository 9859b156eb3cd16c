"""Who leaves: asked of every particle at a search, and of nobody in between."""

from math import inf
from typing import Any

import numpy as np
import taichi as ti

from granflow.device.guards import GUARD_FAR
from granflow.device.state import State
from granflow.plan.outlets import Drain
from granflow.plan.slots import BOUNDS


def check_coordinates(state: State) -> None:
    """Set the guard where a particle of a domain that grows is too far from the origin for the precision.

    Reads:   low, high (see `build_bounds`), and position, id if one is
    Writes:  guard, guard_particle
    """
    count = min(state.count, BOUNDS)
    corners = (field.to_numpy()[:count] for field in (state.sorting.low, state.sorting.high))
    if max(float(np.abs(corner).max()) for corner in corners) <= state.plan.coordinate_limit:
        return
    position = np.nan_to_num(np.abs(state.particles.position.to_numpy()[: state.count]), nan=0.0)
    state.control.guard[0] = GUARD_FAR
    state.control.guard_particle[0] = int(state.particles.id[int(position.max(axis=1).argmax())])


def build_stays(state: State) -> Any:
    """Device function (i): whether particle i is still in the domain, and in no outlet.

    A position that is no number is nowhere; fixed grains stay in outlets. Reads: position, fixed
    """
    flows_out = _build_flows_out(state)
    position, real, border = state.particles.position, state.backend.position_real, state.plan.border
    free = range(3) if state.plan.scene.domain.leaving == "grow" else border.axes
    lows, highs = ([float(value) for value in corner] for corner in (state.plan.domain_low, state.plan.domain_high))

    @ti.func
    def stays(i):
        p, inside = position[i], True
        for axis in ti.static(range(3)):
            if ti.static(axis in free):
                inside = inside and p[axis] == p[axis]
            else:
                inside = inside and p[axis] >= real(lows[axis]) and p[axis] <= real(highs[axis])
        if ti.static(state.plan.features.outlets):
            inside = inside and not flows_out(i)
        return inside

    return stays


def _build_flows_out(state: State) -> Any:
    """Device function (i): whether particle i is in an outlet, and free to leave through it."""
    particles, fixed_grains = state.particles, state.plan.features.fixed_grains
    inside = [_build_inside(drain, state.backend.position_real) for drain in state.plan.drains]

    @ti.func
    def flows_out(i):
        out = False
        for d in ti.static(range(len(inside))):
            out = out or inside[d](particles.position[i])
        if ti.static(fixed_grains):
            out = out and particles.fixed[i] == 0
        return out

    return flows_out


def _build_inside(drain: Drain, real: Any) -> Any:
    """Device function (point): whether it is in one outlet."""
    boxed, narrow = drain.low is not None, drain.radius < inf
    lows, highs = ([] if corner is None else corner.tolist() for corner in (drain.low, drain.high))
    point, normal, radius = drain.point.tolist(), drain.normal.tolist(), drain.radius

    @ti.func
    def in_box(p):
        there = True
        for axis in ti.static(range(3)):
            there = there and p[axis] >= real(lows[axis]) and p[axis] <= real(highs[axis])
        return there

    @ti.func
    def beyond(p):
        apart = p - ti.Vector(point, dt=real)
        along = apart.dot(ti.Vector(normal, dt=real))
        there = along >= 0.0
        if ti.static(narrow):
            across = apart - along * ti.Vector(normal, dt=real)
            there = there and across.dot(across) <= real(radius) * real(radius)
        return there

    return in_box if boxed else beyond
