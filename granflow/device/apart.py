"""Where the partner of a particle stands: in a periodic box, its image that is nearest.

Positions are brought into the box at a search only; in between they may stand out of it by less than the skin.
"""

from typing import Any

import taichi as ti

from granflow.device.state import State


def build_apart(state: State) -> Any:
    """Device function (one, other): vector [m] from the other point to the first, in its nearest image.

    Points that change places give exactly the opposite. Without periodic axes it is the difference and nothing else.
    """
    real, border = state.backend.position_real, state.plan.border
    widths = [float(width) for width in border.width]

    @ti.func
    def apart(one, other):
        between = one - other
        for axis in ti.static(border.axes):
            width, half = real(widths[axis]), real(0.5 * widths[axis])
            above = ti.select(between[axis] > half, width, 0.0 * width)
            below = ti.select(between[axis] < -half, width, 0.0 * width)
            between[axis] = between[axis] - above + below
        return between

    return apart


def build_inside(state: State) -> Any:
    """Device function (point): the image of the point [m] that stands in the box."""
    real, border = state.backend.position_real, state.plan.border
    lows, widths = [float(low) for low in border.low], [float(width) for width in border.width]

    @ti.func
    def inside(point):
        found = point
        for axis in ti.static(border.axes):
            width = real(widths[axis])
            found[axis] = point[axis] - width * ti.floor((point[axis] - real(lows[axis])) / width)
        return found

    return inside


def build_wrap(state: State) -> Any:
    """Kernel (count): bring every particle into the box, and add up what gravity gains or loses by that.

    Reads:   position, mass
    Writes:  position, border_work
    """
    plan, particles = state.plan, state.particles
    border_work: Any = state.control.border_work
    inside, stride, chunk_size = build_inside(state), state.stride, plan.chunk_size
    gravity = [float(g) for g in plan.gravity]

    @ti.kernel
    def wrap(count: ti.i32):
        for task in range((count + chunk_size - 1) // chunk_size * stride):
            if task % stride == 0:
                chunk = task // stride
                for i in range(chunk * chunk_size, ti.min((chunk + 1) * chunk_size, count)):
                    position = particles.position[i]
                    found = inside(position)
                    particles.position[i] = found
                    if ti.static(plan.features.ledger):
                        shift = ti.cast(found - position, ti.f64)
                        weight = ti.cast(particles.mass[i], ti.f64) * ti.Vector(gravity, dt=ti.f64)
                        border_work[chunk] = border_work[chunk] - weight.dot(shift)

    return wrap
