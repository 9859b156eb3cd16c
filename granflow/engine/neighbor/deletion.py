"""Particle deletion. Checked at neighbor-list rebuilds only."""

from math import inf
from typing import Any

import numpy as np
import taichi as ti

from granflow.engine.state import State
from granflow.plan.outlets import PlannedOutlet


def find_farthest(state: State) -> None:
    """Set the particle of an abort because of a coordinate above `plan.coordinate_limit` [m].

    Reads:   position, id
    Writes:  abort_particle
    """
    position = np.nan_to_num(np.abs(state.particles.position.to_numpy()[: state.count]), nan=0.0)
    state.control.abort_particle[0] = int(state.particles.id[int(position.max(axis=1).argmax())])


def build_remains(state: State) -> Any:
    """Device function (i): true if particle i is in the domain and not in an outlet.

    Along periodic axes, and in an expanding domain, only the outlets delete. A position that is NaN is outside; an
    outlet does not delete fixed particles.

    Reads:  position, fixed
    """
    in_outlet = _build_in_outlet(state)
    position, real, periodic_box = state.particles.position, state.backend.position_real, state.plan.periodic_box
    unchecked_axes = range(3) if state.plan.domain.on_exit == "expand" else periodic_box.axes
    lows, highs = ([float(value) for value in corner] for corner in (state.plan.domain_low, state.plan.domain_high))

    @ti.func
    def remains(i):
        p, inside = position[i], True
        for axis in ti.static(range(3)):
            if ti.static(axis in unchecked_axes):
                inside = inside and p[axis] == p[axis]  # false for NaN
            else:
                inside = inside and p[axis] >= real(lows[axis]) and p[axis] <= real(highs[axis])
        if ti.static(state.plan.features.outlets):
            inside = inside and not in_outlet(i)
        return inside

    return remains


def _build_in_outlet(state: State) -> Any:
    """Device function (i): true if particle i is in an outlet and not fixed.

    Reads:  position, fixed
    """
    particles, fixed_particles = state.particles, state.plan.features.fixed_particles
    in_one_outlet = [_build_in_one_outlet(outlet, state.backend.position_real) for outlet in state.plan.outlets]

    @ti.func
    def in_outlet(i):
        out = False
        for d in ti.static(range(len(in_one_outlet))):
            out = out or in_one_outlet[d](particles.position[i])
        if ti.static(fixed_particles):
            out = out and particles.fixed[i] == 0
        return out

    return in_outlet


def _build_in_one_outlet(outlet: PlannedOutlet, real: Any) -> Any:
    """Device function (point): true if the point [m] is in one outlet.

    An outlet is a box, a half space, or the part of a half space within a radius of its axis (disc).
    """
    is_box, has_radius = outlet.low is not None, outlet.radius < inf
    lows, highs = ([] if corner is None else corner.tolist() for corner in (outlet.low, outlet.high))
    point, normal, radius = outlet.point.tolist(), outlet.normal.tolist(), outlet.radius

    @ti.func
    def in_box(p):
        is_inside = True
        for axis in ti.static(range(3)):
            is_inside = is_inside and p[axis] >= real(lows[axis]) and p[axis] <= real(highs[axis])
        return is_inside

    @ti.func
    def in_half_space(p):
        from_point = p - ti.Vector(point, dt=real)
        along = from_point.dot(ti.Vector(normal, dt=real))
        is_inside = along >= 0.0
        if ti.static(has_radius):
            radial = from_point - along * ti.Vector(normal, dt=real)
            is_inside = is_inside and radial.dot(radial) <= real(radius) * real(radius)
        return is_inside

    return in_box if is_box else in_half_space
