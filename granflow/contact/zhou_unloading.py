"""Unloading curve of Zhou (2011) and its parameters as device functions; `theory` contains their host forms."""

from granflow.contact.power import exponential, power
from granflow.contact.substep_corrections import mean_above
from granflow.device_functions import ti

REST_SPEED = 0.1
"""Velocity over the impact velocity of the maximum overlap at which rest damping is halved."""

NEWTON_STEPS = 5
"""Newton iterations from y = (4/5) e^2: five reach float64 precision for every e, four leave 25 ulps at e = 1."""


@ti.func
def restitution_at(constants, velocity):
    """Restitution coefficient at an approach velocity [m/s] (Zhou 2011, Eq. 12).

        e(v) = exp(-sigma (v / (vlim - v))^psi)      v < vlim, else 0

    A pair with a constant restitution has the limit velocity 0.
    """
    limit = constants.limit_velocity
    e = constants.restitution
    if limit > 0.0:
        e = 0.0
        if velocity <= 0.0:
            e = 1.0
        elif velocity < limit:
            e = exponential(-constants.sigma * power(velocity / (limit - velocity), constants.psi))
    return e


@ti.func
def recovery_of(e):
    """Recovered fraction y of the maximum overlap (Zhou 2011, Eq. 8), by NEWTON_STEPS Newton iterations.

    y = (4/5) e^2 + (1/5) e^3 y^2.5
    """
    first = 0.8 * e * e
    share = 0.2 * e * e * e
    y = first
    for _ in range(NEWTON_STEPS):  # not unrolled: several kernels contain it several times, and compile it slowly
        root = y * ti.sqrt(y)
        y -= (y - first - share * y * root) / (1.0 - 2.5 * share * root)
    return y


@ti.func
def least_restitution(k, mass, overlap_max, time_step, angle):
    """Smallest restitution at this time step: unloading tangent <= angle^2 M / dt^2; not from the paper.

    Device form of `theory.least_restitution`.
    """
    return ti.sqrt(1.25 * k * ti.sqrt(overlap_max) / mass) * time_step / angle


@ti.func
def unloading_force(stiffness, radius, overlap_max, e, y, overlap, rate, time_step):
    """Force on the unloading branch [N], zero below the residual overlap, and its tangent [N/m].

        F = lam (d - ds) + e^3 k (d - ds)^1.5        d > ds        (Zhou 2011, Eq. 4)

    with k = stiffness sqrt(radius), stiffness = (4/3) E, and d - ds averaged over the step, in which the particles may
    separate. Up to 1/e^2 steeper than loading; limited by the time step as e -> 0.
    """
    above = mean_above(overlap - overlap_max * (1.0 - y), rate, time_step)
    cube = e * e * e
    slope = ti.sqrt(radius * overlap_max) * (1.0 - cube * y * ti.sqrt(y)) / y
    hertz = cube * ti.sqrt(radius * above)
    return stiffness * above * (slope + hertz), stiffness * (slope + 1.5 * hertz)


@ti.func
def reloading_damping(contact, tangent, loading_energy):
    """Damping c [N s/m] of a contact that reloads, for the damping ratio 1, and its stiffness number; not in the paper.

        c = 2 sqrt(K M) (1 - n) / (1 + (d' / (s v))^2),      n = K dt^2/M < 1, else 0

    with s = REST_SPEED. The first factor preserves the stability limit of dense packings, 4 n + 4 c dt/M <= 4,
    for damping ratios up to 1/2: the damping acts on approach only, in half of the steps of the fastest mode. The
    second one restricts the damping to vibrations that are slow compared with the impact velocity v that causes the
    maximum overlap (Zhou 2011, Eq. 5): 1 % of it remains in impacts of several particles.

    tangent:         K [N/m], that of unloading
    loading_energy:  M v^2 / 2 [J]
    """
    mass, rate = contact.mass_eff, contact.overlap_rate
    stiffness_number = tangent * contact.time_step * (contact.time_step / mass)
    slow = loading_energy / (loading_energy + mass * rate * rate * (0.5 / REST_SPEED**2))
    return 2.0 * ti.sqrt(tangent * mass) * ti.max(1.0 - stiffness_number, 0.0) * slow, stiffness_number


@ti.func
def reloading_force(constants, contact, overlap_max, tangent):
    """Viscous force of a contact that reloads [N], for the ratio `rest_damping`, and the part of it without loss [N].

    tangent:  K [N/m], that of unloading

    The loss is booked with `overlap_rate`, half a step before the force. The mean over the step is smaller by half of
    the damping number and, in a vibration about equilibrium, by the share K dt^2/(4 M).
    """
    stiffness, rate = 4.0 / 3.0 * constants.modulus_eff, contact.overlap_rate
    loading_energy = 0.4 * stiffness * ti.sqrt(contact.radius_eff * overlap_max) * overlap_max * overlap_max
    damping, stiffness_number = reloading_damping(contact, tangent, loading_energy)
    damping *= constants.rest_damping
    late = 0.5 * damping * (contact.time_step / contact.mass_eff) + 0.25 * stiffness_number
    return damping * rate, damping * rate * late


@ti.func
def unloading_energy(k, overlap_max, e, y, overlap):
    """Energy recovered by unloading from an overlap [J]: lam u^2/2 + (2/5) e^3 k u^2.5, u = d - ds."""
    energy = 0.0 * k
    above = overlap - overlap_max * (1.0 - y)
    if above > 0.0:
        cube = e * e * e
        slope = ti.sqrt(overlap_max) * (1.0 - cube * y * ti.sqrt(y)) / y
        energy = k * above * above * (0.5 * slope + 0.4 * cube * ti.sqrt(above))
    return energy
