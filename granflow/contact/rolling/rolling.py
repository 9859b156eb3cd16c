"""Rolling models: elastic-plastic spring torque (EPSD) and constant directional torque (CDT).

Source: Ai et al. 2011, Powder Technol. 206:269 (models A and C). EPSD is the elastic-plastic spring of `mindlin` with
torque instead of force and angle instead of displacement, rolling stiffness k_t R^2 (Wensrich & Katterfeld 2012, Powder
Technol. 217:409) and limit mu_r R F. Torques act on the first particle of a pair, the opposite torques on the second.

CDT is discontinuous at zero rate, so at small rates it is replaced by a viscous torque: a contact removes at most
`STOPPED_SHARE` of the relative rate per step. A particle with moment of inertia I_i receives I_j / (I_i + I_j) of that
from each neighbor j, 1 from each wall. For non-overlapping spheres of any size around one sphere the sum is below 8
(the largest sum is 7.5, for twelve neighbors 1.11 times as large). The rate after the step is then a mean of the rates
of the particle and its neighbors: no rotation reverses, and rotation relative to the neighbors decays, for any number
of simultaneous contacts.
"""

import taichi as ti

STOPPED_SHARE = 0.125
"""Largest fraction of the relative rolling rate that one contact removes in one step."""


@ti.func
def directional_torque(radius_eff, rolling_friction, normal_force, rolling_rate, inertia_eff, time_step):
    """CDT [N m]: mu_r R F against the rolling rate w [rad/s], viscous below the rate at which both are equal.

        T = -min(mu_r R F / |w|, I / (8 dt)) w        (Ai et al. 2011, model A, with the bound above)

    radius_eff:        effective radius R [m]
    rolling_friction:  mu_r [-]
    normal_force:      F [N]
    rolling_rate:      w, 3-vector
    inertia_eff:       effective moment of inertia I [kg m2]
    time_step:         dt [s], the longest of the run, so that a force evaluation between two steps has the same limit
    """
    rate = ti.sqrt(rolling_rate.dot(rolling_rate))
    size = ti.min(rolling_friction * radius_eff * normal_force, STOPPED_SHARE * inertia_eff * rate / time_step)
    return ti.select(rate > 0.0, -size / rate, 0.0) * rolling_rate


@ti.func
def torque_loss(torque_before, torque, rolling_rate, time_step):
    """Energy dissipated by a torque during one step [J]; exact for the leapfrog scheme, for any other torques.

        W = -(T(t - dt) + T(t)) / 2 . w(t - dt/2) dt

    torque_before, torque:  T of the previous and of this step [N m]
    rolling_rate:           relative angular velocity w at the half step [rad/s]

    Each kick changes the kinetic energy by the torque times the mean of the rates before and after. In the sum over all
    steps each half-step rate is multiplied by half of the torque before and half of the torque after it.
    """
    return -0.5 * time_step * (torque_before + torque).dot(rolling_rate)
