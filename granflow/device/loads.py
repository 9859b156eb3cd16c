"""What the grains do to the walls, added up over time: every chunk on its own, all of them in order on the host."""

from typing import Any

import numpy as np
import taichi as ti

from granflow.device.state import State


def build_enter_load(state: State) -> Any:
    """Device function (chunk, wall, i, normal, force on i, torque on i, time_step): book one contact of one step.

        J += -F dt        L += -[(x - p) x F + M] dt        N += F . n dt

    with p the point of the wall's rotation as the scene gives it, the origin where it has none. Sums are in f64 at
    any precision: a load is the difference of two of them.
    """
    particles, walls, impulses = state.particles, state.walls, state.control.impulses

    @ti.func
    def enter_load(chunk, w, i, normal, force, torque, dt):
        row = walls.load_row[w]
        if row >= 0:
            time = ti.cast(dt, ti.f64)
            push, turn = -time * ti.cast(force, ti.f64), -time * ti.cast(torque, ti.f64)
            arm = ti.cast(particles.position[i], ti.f64) - ti.cast(walls.pivot[w], ti.f64)
            turn += arm.cross(push)
            booked = impulses[chunk, row]
            for axis in ti.static(range(3)):
                booked[axis] += push[axis]
                booked[3 + axis] += turn[axis]
            booked[6] -= push.dot(ti.cast(normal, ti.f64))
            impulses[chunk, row] = booked

    return enter_load


def wall_impulses(state: State) -> dict[str, np.ndarray]:
    """Impulse [N s], angular impulse [N m s] and normal impulse [N s] of every measured wall since the start (7,)."""
    if state.control.impulses is None:
        return {}
    sums = state.control.impulses.to_numpy().sum(axis=0)
    return dict(zip(state.plan.scene.loaded_walls, sums, strict=True))
