"""Rolling slot: elastic-plastic spring torque (EPSD) and constant directional torque (CDT).

Sources: Ai et al. 2011, Powder Technol. 206:269 (models A and C). EPSD is the elastic-plastic spring of `mindlin`
with torque for force and angle for displacement, rolling stiffness k_t R^2 (Wensrich & Katterfeld 2012, Powder
Technol. 217:409) and the cap mu_r R F. Torques act on the first partner; the second gets the opposite.

CDT has no torque at rest, so an explicit step turns it into a viscous torque at small rates: a contact removes at most
`STOPPED_SHARE` of the relative rate per step. A particle with moment of inertia I_i receives I_j / (I_i + I_j) of that
from each neighbor j, 1 from each wall. Spheres that touch one sphere without overlapping each other add up to less
than 8, whatever their sizes (the largest sum is 7.5, for twelve neighbors 1.11 times as large). The rate after the
step is then a mean of the particle's own rate and those of its neighbors: no particle's rotation reverses, and
rotation relative to the neighbors decays, however many contacts act at once.
"""

import taichi as ti

STOPPED_SHARE = 0.125
"""Largest share of the relative rolling rate that one contact removes in one step."""


@ti.func
def directional_torque(radius_eff, rolling_friction, normal_force, rolling_rate, inertia_eff, time_step):
    """CDT [N m]: mu_r R F against the rolling rate w [rad/s], viscous below the rate at which both are equal.

        T = -min(mu_r R F / |w|, I / (8 dt)) w

    `time_step` is the longest step of the run, so that a force evaluation between two steps has the same limit.
    """
    rate = ti.sqrt(rolling_rate.dot(rolling_rate))
    size = ti.min(rolling_friction * radius_eff * normal_force, STOPPED_SHARE * inertia_eff * rate / time_step)
    return ti.select(rate > 0.0, -size / rate, 0.0) * rolling_rate


@ti.func
def torque_loss(torque_before, torque, rolling_rate, time_step):
    """Energy taken by a torque during one step [J]: exact for the leapfrog, whatever else acts on the particles.

        W = -(T(t - dt) + T(t)) / 2 . w(t - dt/2) dt

    Both kicks change the kinetic energy by the torque times the mean of the rates before and after; summed over the
    steps, each half-step rate meets half of the torque on either side of it.
    """
    return -0.5 * time_step * (torque_before + torque).dot(rolling_rate)
