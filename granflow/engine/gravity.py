"""Gravity on the device: a constant vector, or a row for each step if it changes, and the work of its change.

The potential energy refers to gravity at the start g0, of which it is a function of the position; what the
changing gravity g(t) does in addition is work on the particles. In one step, from t to t + dt,

    W = dt v(t + dt/2) . m {[g(t) + g(t + dt)] / 2 - g0}

which with the potential energy is the change of the kinetic energy in free flight, exactly, as for external
forces (`particle_forces.py`).
"""

import numpy as np

from granflow.engine.state import State
from granflow.engine.sums import SHARES, add_energy
from granflow.kernel_language import ti
from granflow.plan.capacities import POSE_COUNT
from granflow.plan.sum_units import UNIT_ENERGY


class Gravity:
    """Gravity in device functions; `pose` is the index of the poses at the end of a step.

    Reads:   gravity, mass, fixed
    Writes:  gravity_work
    """

    def __init__(self, state: State) -> None:
        self.changes = state.plan.features.changing_gravity
        self.particles = state.particles
        self.at_start = state.parameter("gravity")
        self.rows = state.control.gravity
        self.work = state.control.gravity_work
        self.counts_work = self.work is not None
        self.high_words_per_joule = state.parameter("per_unit", UNIT_ENERGY)

    @ti.func
    def before(self, pose):
        """Gravity [m/s2] at the begin of a step, to which its kick belongs."""
        found = self.at_start()
        if ti.static(self.changes):
            found = self.rows[pose]
        return found

    @ti.func
    def after(self, pose):
        """Gravity [m/s2] at the end of a step, to which its forces belong."""
        found = self.at_start()
        if ti.static(self.changes):
            found = self.rows[pose + 1]
        return found

    @ti.func
    def add_work(self, chunk, i, velocity, pose, dt):
        """Add the work of one step on particle i; `velocity` [m/s]: at the half step, of a clump that of its
        center of mass."""
        if ti.static(self.counts_work):
            mass = ti.cast(self.particles.mobility(i) * self.particles.mass[i], ti.f64)
            change = 0.5 * (self.rows[pose] + self.rows[pose + 1]) - self.at_start()
            done = ti.cast(dt, ti.f64) * mass * change.dot(ti.cast(velocity, ti.f64))
            scale = ti.cast(self.high_words_per_joule(), ti.f64)
            add_energy(self.work, chunk, 0, 1, SHARES, scale * done)


def upload_gravity(state: State, step: int) -> None:
    """Upload gravity before and after POSE_COUNT steps, of which the first ends after step number `step`.

    Row k is that after step number `step` - 1 + k: the first row of an upload that begins with the present
    time may precede a change of the time step, and is not used.

    Writes:  gravity
    """
    times = np.asarray(state.clock.time_after(step - 1 + np.arange(POSE_COUNT + 1)))
    state.control.gravity.from_numpy(state.gravity_course.at(times))


def present_gravity(state: State) -> np.ndarray:
    """Gravity (3,) [m/s2] at the present time."""
    if not state.plan.features.changing_gravity:
        return np.array(state.plan.scene.gravity_at_start)
    return np.asarray(state.gravity_course.at(np.array([state.clock.time]))[0])
