"""Contacts of the restitution 0 (Zhou 2011, Eq. 4 for e -> 0), where unloading is vertical; not from the paper.

The force decreases to zero at the maximum overlap without elastic recovery. A contact is in one of two states:

    yielding    F = min(k d^1.5, M max(d', 0)/dt)       until the second term, which stops the pair, is smaller
    supporting  F = K (d - dmax) + b M d'/dt            for d > dmax and F > 0, else 0; until it exceeds k d^1.5

with K = a^2 M/dt^2. An isolated pair has exactly the relative velocity 0 after an impact, whatever the time step. The
stiff support carries a resting load without tension, so that any external force separates the pair, and its damping b
brings the pair to rest. A pair that separates from the support, but not from the overlap, and approaches again, has the
restitution of a spring-dashpot with the damping ratio b/2a = 2.5, 0.03.
"""

from types import SimpleNamespace

from granflow.contact.law import ContactState
from granflow.contact.material import PairMaterial
from granflow.device_functions import ti

SUPPORT_DAMPING = 0.25
"""b: share of the relative momentum that the support absorbs in one step; the sum over up to 8 contacts is stable."""

SUPPORT_ANGLE = 0.05
"""a: sqrt(K/M) dt of the support."""


def is_inelastic(pair: PairMaterial) -> bool:
    """Whether the restitution of a pair is the number 0."""
    return pair.restitution == 0.0


@ti.func
def inelastic_pair(constants):
    """Device form of `is_inelastic`: a pair with e(v) has a limit velocity, and the constant restitution 0."""
    return constants.restitution + constants.limit_velocity == 0.0


@ti.func
def support_force(contact, overlap_max):
    """Elastic and viscous force [N] of a supporting contact."""
    above = contact.overlap - overlap_max
    supports, mass_rate = ti.select(above > 0.0, 1.0, 0.0), contact.mass_eff / contact.time_step
    elastic = supports * SUPPORT_ANGLE**2 * mass_rate / contact.time_step * above
    return elastic, ti.max(supports * SUPPORT_DAMPING * mass_rate * contact.overlap_rate, -elastic)


@ti.func
def inelastic_force(contact, yield_force, history):
    """Force and its viscous part [N], maximum overlap [m], and state: 0 yielding, 1 supporting.

    yield_force:  k d^1.5 [N]
    """
    elastic, viscous = support_force(contact, history.overlap_max)
    stopping = contact.mass_eff * ti.max(contact.overlap_rate, 0.0) / contact.time_step
    yielding = history.recovery == 0.0
    trial = ti.select(yielding, stopping, elastic + viscous)
    force = ti.min(trial, yield_force)
    state = ti.select(trial < yield_force, 1.0, 0.0)
    deeper = ti.max(contact.overlap, history.overlap_max)
    viscous_part = ti.select(yielding, 0.0, ti.select(state == 1.0, viscous, ti.max(force - elastic, 0.0)))
    return force, viscous_part, ti.select(yielding, deeper, ti.select(state == 1.0, history.overlap_max, deeper)), state


@ti.func
def support_energy(contact, history):
    """Energy of the support [J]."""
    elastic, _viscous = support_force(contact, history.overlap_max)
    return 0.5 * history.recovery * elastic * (contact.overlap - history.overlap_max)


def reference_inelastic(contact: ContactState, yield_force: float) -> tuple[float, dict[str, float]]:
    """Reference implementation of `inelastic_force` in numpy: force [N] and changed history fields."""
    history: SimpleNamespace = contact.history
    mass_rate = contact.mass_eff / contact.time_step
    above = contact.overlap - history.overlap_max
    if history.recovery == 0.0:
        force, deeper = contact.mass_eff * max(contact.overlap_rate, 0.0) / contact.time_step, True
    elif above > 0.0:
        elastic = SUPPORT_ANGLE**2 * mass_rate / contact.time_step * above
        force = elastic + max(SUPPORT_DAMPING * mass_rate * contact.overlap_rate, -elastic)
        deeper = force >= yield_force
    else:
        force, deeper = 0.0, False
    largest = max(contact.overlap, history.overlap_max) if deeper else history.overlap_max
    state = 1.0 if force < yield_force else 0.0
    return min(force, yield_force), {"overlap_max": largest, "restitution": 0.0, "recovery": state}
