"""Rolling slot: elastic-plastic spring torque (EPSD) and constant directional torque (CDT).

Sources: Ai et al. 2011, Powder Technol. 206:269 (models A and C). EPSD is the elastic-plastic spring of `mindlin`
with torque for force and angle for displacement, rolling stiffness k_t R^2 (Wensrich & Katterfeld 2012, Powder
Technol. 217:409) and the cap mu_r R F. Torques act on the first partner; the second gets the opposite.
"""

import taichi as ti


@ti.func
def directional_torque(radius_eff, rolling_friction, normal_force, rolling_rate, inertia_eff, time_step):
    """CDT: torque mu_r R F against the relative rolling, at most half of what would stop it within the step."""
    rate = ti.sqrt(rolling_rate.dot(rolling_rate))
    size = ti.min(rolling_friction * radius_eff * normal_force, 0.5 * inertia_eff * rate / time_step)
    return ti.select(rate > 0.0, -size / rate, 0.0) * rolling_rate
