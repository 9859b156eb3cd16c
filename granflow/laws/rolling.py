"""Rolling slot: elastic-plastic spring torque (EPSD) and constant directional torque (CDT).

Sources: Ai et al. 2011, Powder Technol. 206:269 (models A and C); rolling stiffness k_t R^2 as in Wensrich &
Katterfeld 2012, Powder Technol. 217:409. Torques act on the first partner; the second gets the opposite.
"""

from typing import Literal

import taichi as ti

Rolling = Literal["none", "epsd", "cdt"]


@ti.func
def spring_torque(lateral_stiffness, radius_eff, rolling_friction, normal_force, rotation):
    """EPSD: torque -k_t R^2 theta, held at rolling friction times R times the normal force.

    Returns (torque, rotation kept, slipped); `rotation` is the rolling displacement theta [rad].
    """
    torque = -lateral_stiffness * radius_eff * radius_eff * rotation
    kept = rotation
    slipped = 0
    cap = rolling_friction * radius_eff * normal_force
    square = torque.dot(torque)
    if square > cap * cap:
        share = cap / ti.sqrt(square)
        torque = share * torque
        kept = share * rotation
        slipped = 1
    return torque, kept, slipped


@ti.func
def directional_torque(radius_eff, rolling_friction, normal_force, rolling_rate, inertia_eff, time_step):
    """CDT: torque mu_r R F against the relative rolling, at most what stops it within the step."""
    torque = 0.0 * rolling_rate
    rate = ti.sqrt(rolling_rate.dot(rolling_rate))
    if rate > 0.0:
        size = ti.min(rolling_friction * radius_eff * normal_force, 0.5 * inertia_eff * rate / time_step)
        torque = -size / rate * rolling_rate
    return torque
