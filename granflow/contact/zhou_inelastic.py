"""Contacts of the restitution 0 (Zhou 2011, Eq. 4 for e -> 0), where unloading is vertical; not from the paper.

The force decreases to zero at the maximum overlap without elastic recovery. A contact is in one of two states:

    yielding    F = min(k d^1.5, M max(d', 0)/dt)       until the second term, which stops the pair, is smaller
    supporting  F = K (d - dmax) + b M max(d', 0)/dt    for d > dmax, else 0; until it exceeds k d^1.5

with K = theta^2 M/dt^2, the largest unloading tangent. An isolated pair has exactly the relative velocity 0 after an
impact, whatever the time step. The stiff support carries a resting load and resists approach only, so that any external
force separates the pair, and its damping b brings the pair to rest.
"""

from types import SimpleNamespace

from granflow.contact.law import ContactState
from granflow.contact.material import PairMaterial
from granflow.device_functions import ti

SUPPORT_DAMPING = 0.25
"""b: share of the relative momentum that the support absorbs in one step, while the overlap increases."""


def is_inelastic(pair: PairMaterial) -> bool:
    """Whether the restitution of a pair is the number 0."""
    return pair.restitution == 0.0


@ti.func
def inelastic_pair(constants):
    """Device form of `is_inelastic`: a pair with e(v) has a limit velocity, and the constant restitution 0."""
    return constants.restitution + constants.limit_velocity == 0.0


@ti.func
def support_force(constants, contact, overlap_max):
    """Elastic and viscous force [N] of a supporting contact."""
    above, step = contact.overlap - overlap_max, contact.time_step
    supports = ti.select(above > 0.0, 1.0, 0.0)
    angle = constants.unloading_angle / step
    elastic = supports * angle * angle * contact.mass_eff * above
    return elastic, supports * SUPPORT_DAMPING * contact.mass_eff * ti.max(contact.overlap_rate, 0.0) / step


@ti.func
def inelastic_force(constants, contact, yield_force, history):
    """Force and its viscous part [N], maximum overlap [m], and state: 0 yielding, 1 supporting.

    yield_force:  k d^1.5 [N]
    """
    elastic, viscous = support_force(constants, contact, history.overlap_max)
    stopping = contact.mass_eff * ti.max(contact.overlap_rate, 0.0) / contact.time_step
    yielding = history.recovery == 0.0
    trial = ti.select(yielding, stopping, elastic + viscous)
    force = ti.min(trial, yield_force)
    state = ti.select(trial < yield_force, 1.0, 0.0)
    deeper = ti.max(contact.overlap, history.overlap_max)
    viscous_part = ti.select(yielding, 0.0, ti.max(force - elastic, 0.0))
    return force, viscous_part, ti.select(yielding, deeper, ti.select(state == 1.0, history.overlap_max, deeper)), state


@ti.func
def support_energy(constants, contact, history):
    """Energy of the support [J]."""
    elastic, _viscous = support_force(constants, contact, history.overlap_max)
    return 0.5 * history.recovery * elastic * (contact.overlap - history.overlap_max)


def reference_inelastic(contact: ContactState, angle: float, yield_force: float) -> tuple[float, dict[str, float]]:
    """Reference implementation of `inelastic_force` in numpy: force [N] and changed history fields.

    angle:  theta
    """
    history: SimpleNamespace = contact.history
    momentum_rate = contact.mass_eff * max(contact.overlap_rate, 0.0) / contact.time_step
    above = contact.overlap - history.overlap_max
    if history.recovery == 0.0:
        force, deeper = momentum_rate, True
    elif above > 0.0:
        force = (angle / contact.time_step) ** 2 * contact.mass_eff * above + SUPPORT_DAMPING * momentum_rate
        deeper = force >= yield_force
    else:
        force, deeper = 0.0, False
    largest = max(contact.overlap, history.overlap_max) if deeper else history.overlap_max
    state = 1.0 if force < yield_force else 0.0
    return min(force, yield_force), {"overlap_max": largest, "restitution": 0.0, "recovery": state}
