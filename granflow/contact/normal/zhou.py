"""Zhou (2011): Hertz elastic loading, nonlinear plastic unloading. The primary contact model of granflow.

Equation numbers are those of the paper, Theor. Appl. Mech. Lett. 1, 041006, doi 10.1063/2.1104106. For one
collision, with the overlap d, its maximum dmax, the residual overlap ds and the restitution coefficient e:

    F = k d^1.5                               loading, k = (4/3) E sqrt(R)                      (Eq. 4)
    F = lam (d - ds) + e^3 k (d - ds)^1.5     unloading, d > ds, else 0                         (Eq. 4)
    lam = k sqrt(dmax) (1 - e^3 y^1.5) / y    continuous force at dmax                          (Eq. 7)
    y = (4/5) e^2 + (1/5) e^3 y^2.5           y = 1 - ds/dmax; a share e^2 of the energy returns (Eq. 8)
    e = exp(-sigma (v / (vlim - v))^psi)      0 for an impact velocity v >= vlim                (Eq. 12)

`theory` has the closed forms of the paper on the host, such as the maximum overlap (Eq. 5) and the duration
of a collision (Eqs. 13-16); `material.limit_velocity` is vlim (Eq. 11).

Contacts in a bed do more than collide, which the paper does not treat. A contact remembers dmax until the
particles separate. It reloads along the unloading curve up to dmax and follows the Hertz curve beyond, so
that the force is continuous: F = min(k d^1.5, unloading curve of dmax). The steep unloading of a small e is
bounded by the time step, contacts that reload are damped, and contacts of the restitution 0 have their own
law.

The file follows this order: the equations as device functions, the additions, the law `Zhou`, the restitution
0, the reference implementation in numpy, and the record `MODEL`. It is an example for a model of your own;
`granflow.contact.law` tells what a model must define.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field

from granflow.contact import theory
from granflow.contact.law import (
    ContactModel,
    ContactState,
    HistoryField,
    ModelRequest,
    NormalLaw,
    Options,
)
from granflow.contact.material import PairMaterial, VelocityRestitution
from granflow.contact.step_corrections import (
    build_step_mean,
    mean_above,
    reference_mean_above,
    reference_step_mean,
    reference_turning_point,
    turning_point,
)
from granflow.device_functions import exponential, power, ti
from granflow.schema.quantities import Number

# The unloading curve and its parameters (Zhou 2011, Eqs. 4, 7, 8 and 12)


@ti.func
def restitution_of(constants, velocity):
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


NEWTON_STEPS = 5
"""Newton iterations from y = (4/5) e^2: five reach float64 precision for every e, four leave 25 ulps at e =
1."""


@ti.func
def recovery_of(e):
    """Recovered fraction y of the maximum overlap (Zhou 2011, Eq. 8), by NEWTON_STEPS Newton iterations.

    y = (4/5) e^2 + (1/5) e^3 y^2.5
    """
    first = 0.8 * e * e
    share = 0.2 * e * e * e
    y = first
    # The loop is not unrolled: several kernels contain it several times, and would compile slowly.
    for _ in range(NEWTON_STEPS):
        root = y * ti.sqrt(y)
        y -= (y - first - share * y * root) / (1.0 - 2.5 * share * root)
    return y


@ti.func
def unloading_force(stiffness, radius, overlap_max, e, y, overlap, rate, time_step):
    """Force on the unloading branch [N], zero below the residual overlap, and its tangent [N/m].

        F = lam (d - ds) + e^3 k (d - ds)^1.5        d > ds        (Zhou 2011, Eq. 4)

    with k = stiffness sqrt(radius), stiffness = (4/3) E, and d - ds averaged over the step, in which the
    particles may separate. Up to 1/e^2 steeper than loading; limited by the time step as e -> 0.
    """
    above = mean_above(overlap - overlap_max * (1.0 - y), rate, time_step)
    cube = e * e * e
    slope = ti.sqrt(radius * overlap_max) * (1.0 - cube * y * ti.sqrt(y)) / y
    hertz = cube * ti.sqrt(radius * above)
    return stiffness * above * (slope + hertz), stiffness * (slope + 1.5 * hertz)


@ti.func
def unloading_energy(k, overlap_max, e, y, overlap):
    """Energy recovered by unloading from an overlap [J], the integral of Eq. 4.

    lam u^2/2 + (2/5) e^3 k u^2.5        u = d - ds > 0
    """
    energy = 0.0 * k
    above = overlap - overlap_max * (1.0 - y)
    if above > 0.0:
        cube = e * e * e
        slope = ti.sqrt(overlap_max) * (1.0 - cube * y * ti.sqrt(y)) / y
        energy = k * above * above * (0.5 * slope + 0.4 * cube * ti.sqrt(above))
    return energy


# Contacts in a bed: steep unloading, and damping of contacts that reload (not in the paper)


@ti.func
def least_restitution(k, mass, overlap_max, time_step, angle):
    """Smallest restitution at this time step: unloading tangent <= angle^2 M / dt^2.

    Device form of `theory.least_restitution`.
    """
    return ti.sqrt(1.25 * k * ti.sqrt(overlap_max) / mass) * time_step / angle


REST_SPEED = 0.1
"""Velocity over the impact velocity of the maximum overlap at which rest damping is halved."""


@ti.func
def reloading_damping(contact, tangent, loading_energy):
    """Damping c [N s/m] of a contact that reloads, for the damping ratio 1, and its stiffness number n.

        c = 2 sqrt(K M) (1 - n) / (1 + (d' / (s v))^2),      n = K dt^2/M < 1, else 0

    with s = REST_SPEED. The first factor preserves the stability limit of dense packings, 4 n + 4 c dt/M <=
    4, for damping ratios up to 1/2: the damping acts on approach only, in half of the steps of the fastest
    mode. The second one restricts the damping to vibrations that are slow compared with the impact velocity v
    that causes the maximum overlap (Zhou 2011, Eq. 5): 1 % of it remains in impacts of several particles.

    tangent:         K [N/m], that of unloading
    loading_energy:  M v^2 / 2 [J]
    """
    mass = contact.mass_eff
    rate = contact.overlap_rate
    stiffness_number = tangent * contact.time_step * (contact.time_step / mass)
    slow = loading_energy / (loading_energy + mass * rate * rate * (0.5 / REST_SPEED**2))
    return 2.0 * ti.sqrt(tangent * mass) * ti.max(1.0 - stiffness_number, 0.0) * slow, stiffness_number


@ti.func
def reloading_force(constants, contact, overlap_max, tangent):
    """Viscous force [N] of a contact that reloads, with the ratio `rest_damping`, and its part without loss.

    tangent:  K [N/m], that of unloading

    The loss is booked with `overlap_rate`, half a step before the force. The mean over the step is smaller by
    half of the damping number and, in a vibration about equilibrium, by the share K dt^2/(4 M).
    """
    stiffness = 4.0 / 3.0 * constants.modulus_eff
    rate = contact.overlap_rate
    loading_energy = 0.4 * stiffness * ti.sqrt(contact.radius_eff * overlap_max) * overlap_max * overlap_max
    damping, stiffness_number = reloading_damping(contact, tangent, loading_energy)
    damping *= constants.rest_damping
    late = 0.5 * damping * (contact.time_step / contact.mass_eff) + 0.25 * stiffness_number
    return damping * rate, damping * rate * late


@ti.func
def half_step_rate(contact, force_before):
    """Overlap rate [m/s] half a step before the present time level, from the one at that level.

        d'(t - dt/2) = d'(t) + dt F / (2 M)

    `overlap_rate` is at the time level t only if the law is rate-dependent; otherwise it is that of the half
    step already.

    force_before:  F [N], force on the isolated pair at the level t - dt
    """
    return contact.overlap_rate + 0.5 * contact.time_step * force_before / contact.mass_eff


# The law

RestitutionAt = Literal["impact", "max_overlap", "constant"]
LEAST_RESOLVED = 0.1
"""Smallest restitution whose unloading the time step resolves; below it, the tangent is bounded."""
DAMPING_POWER = 0.25
"""Exponent of the overlap in the viscous force of the option `damping_ratio`."""
_step_mean = build_step_mean(DAMPING_POWER)


@dataclass(frozen=True)
class Zhou(NormalLaw):
    """Zhou's model with the options of one scene.

    restitution_at:   velocity at which e is evaluated
    angle:            bound theta on sqrt(K/M) dt, where K is the unloading tangent
    damping_ratio:    zeta of a viscous force 2 zeta sqrt(K M) times the overlap rate on the elastic branch,
                      where K is the Hertz tangent; 0: no viscous force
    rest_damping:     the same of contacts that reload, where K is the unloading tangent; 0: none
    has_inelastic:    whether a pair has the restitution 0; contacts then have INELASTIC_HISTORY, too
    """

    restitution_at: RestitutionAt
    angle: float
    damping_ratio: float = 0.0
    rest_damping: float = 0.0
    has_inelastic: bool = False

    name = "zhou"
    source = "Zhou 2011, doi 10.1063/2.1104106, Eqs. 4-12"
    limits = (
        "with a restitution coefficient near 0, the force falls to zero within one time step of unloading, "
        "so that the simulated restitution remains above 0; sigma and psi must be measured"
    )
    constant_names = ("modulus_eff", "shear_modulus_eff", "restitution", "sigma", "psi", "limit_velocity")
    """Constant restitution; sigma, psi and vlim [m/s] of Eq. 12."""
    limits_restitution = True

    # From a scene

    @classmethod
    def from_scene(cls, request: ModelRequest) -> "Zhou":
        """The law that a scene requests; constant restitution if that of every pair is a number."""
        fitted = any(pair.fit for pair in request.pairs)
        restitution_at: RestitutionAt = request.options.restitution_at if fitted else "constant"
        elastic = all(pair.restitution == 1.0 for pair in request.pairs)
        return cls(
            restitution_at,
            request.unloading_angle,
            request.options.damping_ratio,
            0.0 if elastic else request.options.rest_damping,
            any(is_inelastic(pair) for pair in request.pairs),
        )

    @property
    def parameters(self) -> Mapping[str, float]:
        """Bound on the unloading tangent, and the ratios of the viscous forces that are not disabled."""
        numbers = {"unloading_angle": self.angle}
        if self.damping_ratio > 0.0:
            numbers["damping_ratio"] = self.damping_ratio
        if self.rest_damping > 0.0:
            numbers["rest_damping"] = self.rest_damping
        return numbers

    def pair_constants(self, pair: PairMaterial) -> tuple[float, ...]:
        """Values of `constant_names`; unused ones are 0 (psi: 1).

        Raises ValueError if the pair has no restitution.
        """
        moduli = (pair.modulus_eff, pair.shear_modulus_eff)
        if pair.fit:
            return (*moduli, 0.0, pair.fit.sigma, pair.fit.psi, pair.fit.limit_velocity)
        return (*moduli, pair.restitution_at(0.0), 0.0, 1.0, 0.0)

    @property
    def history(self) -> tuple[HistoryField, ...]:
        """Maximum overlap, restitution of the contact, and recovery y while it unloads (0: loading)."""
        fields = (
            HistoryField("overlap_max", "maximum overlap", "m", in_output=True),
            HistoryField("restitution", "restitution coefficient", in_output=True),
            HistoryField("recovery", "recovered fraction of the maximum overlap"),
        )
        return (*fields, *INELASTIC_HISTORY) if self.has_inelastic else fields

    # Properties of the force

    @property
    def rate_dependent(self) -> bool:
        """Whether the force needs the overlap rate at the time level: with `damping_ratio`, not with
        `rest_damping`, which takes the rate of the half step."""
        return self.damping_ratio > 0.0

    @property
    def prepares(self) -> bool:
        """The restitution and the start of unloading need branches."""
        return True

    # Device functions

    @ti.func
    def prepare(self, constants, contact, history):
        """Set the restitution at first contact; set maximum overlap, e and y when unloading begins."""
        history_new = history
        if ti.static(self.restitution_at != "max_overlap"):
            if history_new.overlap_max == 0.0:
                history_new.restitution = restitution_of(constants, contact.overlap_rate)
        unloads = contact.overlap < history_new.overlap_max and history_new.recovery == 0.0
        if ti.static(self.has_inelastic):
            unloads = unloads and not inelastic_pair(constants)
        if unloads:
            largest = history_new.overlap_max
            mass = contact.mass_eff
            stiffness = 4.0 / 3.0 * constants.modulus_eff
            largest_force = stiffness * ti.sqrt(contact.radius_eff * largest) * largest
            overlap_rate_half = contact.overlap_rate
            if ti.static(self.rate_dependent):
                overlap_rate_half = half_step_rate(contact, largest_force)
            history_new.overlap_max = turning_point(
                largest, largest_force, mass, contact.time_step, overlap_rate_half
            )
            e, y = self.unloading_parameters(constants, contact, history_new)
            history_new.restitution = e
            history_new.recovery = y
        return history_new

    @ti.func
    def unloading_parameters(self, constants, contact, history):
        """Restitution and recovery for unloading from the present maximum overlap."""
        k = 4.0 / 3.0 * constants.modulus_eff * ti.sqrt(contact.radius_eff)
        e = history.restitution
        y = history.recovery
        largest = history.overlap_max
        mass = contact.mass_eff
        if y == 0.0:
            if ti.static(self.restitution_at == "max_overlap"):
                e = restitution_of(constants, ti.sqrt(0.8 * k * largest**2 * ti.sqrt(largest) / mass))
            least = least_restitution(k, mass, largest, contact.time_step, constants.unloading_angle)
            e = ti.max(e, ti.min(least, 1.0))
            y = recovery_of(e)
        return e, y

    @ti.func
    def force(self, constants, contact, history):
        """Force of the present branch [N] (Zhou 2011, Eq. 4), its viscous part, and the history.

        The viscous part is limited so that the total is >= 0.
        """
        overlap = contact.overlap
        radius = contact.radius_eff
        rate = contact.overlap_rate
        stiffness = 4.0 / 3.0 * constants.modulus_eff
        overlap_max = history.overlap_max
        recovery = history.recovery
        loading = overlap >= overlap_max
        y = ti.select(loading, 1.0, recovery)
        unloading, tangent = unloading_force(
            stiffness, radius, overlap_max, history.restitution, y, overlap, rate, contact.time_step
        )
        loading_force = stiffness * ti.sqrt(radius * overlap) * overlap
        normal_force = ti.select(loading, loading_force, unloading)
        viscous = 0.0 * stiffness
        excess = 0.0 * stiffness
        if ti.static(self.rest_damping > 0.0):
            reloads = (
                (overlap < overlap_max) & (rate > 0.0) & (unloading > 0.0) & (constants.restitution < 1.0)
            )
            damping_force, damping_excess = reloading_force(constants, contact, overlap_max, tangent)
            viscous = ti.select(reloads, damping_force, 0.0)
            excess = ti.select(reloads, damping_excess, 0.0)
        if ti.static(self.rate_dependent):
            viscous += self.viscous_force(constants, contact)
            viscous = ti.select(normal_force > 0.0, ti.max(viscous, -normal_force), 0.0)
        total = normal_force + viscous
        viscous -= excess
        history_new = history
        history_new.overlap_max = ti.max(overlap, overlap_max)
        history_new.recovery = ti.select(loading, 0.0, recovery)
        if ti.static(self.has_inelastic):
            inelastic = inelastic_pair(constants)
            rate_half = rate
            if ti.static(self.rate_dependent):
                rate_half = half_step_rate(contact, history.force_before)
            force, history_inelastic = inelastic_force(
                contact, stiffness * ti.sqrt(radius), rate_half, history
            )
            total = ti.select(inelastic, force, total)
            viscous = ti.select(inelastic, 0.0, viscous)
            largest = history_new.overlap_max
            state = history_new.recovery
            history_new = history_inelastic  # other pairs do not read the fields of INELASTIC_HISTORY
            history_new.overlap_max = ti.select(inelastic, history_inelastic.overlap_max, largest)
            history_new.recovery = ti.select(inelastic, history_inelastic.recovery, state)
        return total, viscous, history_new

    @ti.func
    def viscous_force(self, constants, contact):
        """Viscous force of the option `damping_ratio` [N], mean over the step."""
        overlap_at, weight = _step_mean(contact.overlap, contact.overlap_rate, contact.time_step)
        tangent = 2.0 * constants.modulus_eff * ti.sqrt(contact.radius_eff * overlap_at)
        root = ti.sqrt(tangent * contact.mass_eff)
        return 2.0 * constants.damping_ratio * weight * root * contact.overlap_rate

    @ti.func
    def stored_energy(self, constants, contact, history):
        """Energy recovered by unloading from the present overlap [J]; an inelastic pair stores none."""
        k = 4.0 / 3.0 * constants.modulus_eff * ti.sqrt(contact.radius_eff)
        e, y = self.unloading_parameters(constants, contact, history)
        energy = unloading_energy(k, history.overlap_max, e, y, contact.overlap)
        if ti.static(self.has_inelastic):
            if inelastic_pair(constants):
                energy = 0.0
        return energy

    @ti.func
    def lost_energy(self, constants, contact, history):
        """Work of loading, (2/5) k dmax^2.5, minus the energy recovered by unloading from dmax [J].

        All work on an inelastic pair.
        """
        k = 4.0 / 3.0 * constants.modulus_eff * ti.sqrt(contact.radius_eff)
        largest = history.overlap_max
        e, y = self.unloading_parameters(constants, contact, history)
        loading_energy = 0.4 * k * largest * largest * ti.sqrt(largest)
        energy_lost = loading_energy - unloading_energy(k, largest, e, y, largest)
        if ti.static(self.has_inelastic):
            if inelastic_pair(constants):
                energy_lost = history.work
        return energy_lost

    # Reference implementation

    def reference(self, contact: ContactState) -> tuple[float, Mapping[str, float]]:
        """Reference implementation of the model for one contact, in float64."""
        return reference_contact(self, contact)

    # Closed forms of a binary collision

    def phase_durations(
        self, pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float
    ) -> tuple[float, float]:
        """Loading and unloading durations [s] (Zhou 2011, Eqs. 13-15): eta1 Ts and eta2(e(v)) Ts."""
        k = float(theory.hertz_stiffness(pair.modulus_eff, radius_eff))
        scale = float(theory.time_scale(k, mass_eff, velocity))
        e = pair.restitution_at(velocity)
        return theory.LOADING_DURATION * scale, theory.unloading_duration(e) * scale

    def unloading_stiffness(
        self, pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float
    ) -> float:
        """Tangent stiffness at the start of unloading [N/m]; infinite at e = 0 (Zhou 2011, Eqs. 4, 7)."""
        k = float(theory.hertz_stiffness(pair.modulus_eff, radius_eff))
        largest = float(theory.overlap_max(k, mass_eff, velocity))
        return k * np.sqrt(largest) * float(theory.unloading_tangent(pair.restitution_at(velocity)))

    def stable_stiffness(
        self, pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float
    ) -> float:
        """Hertz tangent [N/m]; the unloading tangent is bounded by the time step."""
        return theory.hertz_tangent(pair, radius_eff, mass_eff, velocity)

    def viscosity(self, pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float) -> float:
        """Viscous force over overlap rate [N s/m]: 2 zeta sqrt(K M), K the Hertz tangent at dmax."""
        tangent = theory.hertz_tangent(pair, radius_eff, mass_eff, velocity)
        return 2.0 * self.damping_ratio * float(np.sqrt(tangent * mass_eff))

    # Unloading tangents that the time step bounds

    @property
    def unloading_angle(self) -> float:
        """Bound on the unloading tangent, see `least_restitution`."""
        return self.angle

    @property
    def reloading_damping(self) -> float:
        """Damping ratio of contacts that reload."""
        return self.rest_damping

    def unloading_number(self, pair: PairMaterial) -> float:
        """theta^2; that of the support and its damping for an inelastic pair, see SUPPORT_MODES."""
        return SUPPORT_MODES if is_inelastic(pair) else self.angle**2

    def unresolved_unloading(self, pair: PairMaterial) -> float:
        """Ratio of the durations at LEAST_RESOLVED; 1 for an inelastic pair, which does not unload."""
        if is_inelastic(pair):
            return 1.0
        return theory.unloading_duration(LEAST_RESOLVED) / theory.LOADING_DURATION

    def least_restitution(
        self, pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float, time_step: float
    ) -> float:
        """Smallest restitution that the bound on the unloading tangent permits; 0 for an inelastic pair."""
        if is_inelastic(pair):
            return 0.0
        k = float(theory.hertz_stiffness(pair.modulus_eff, radius_eff))
        largest = theory.overlap_max(k, mass_eff, velocity)
        return float(min(theory.least_restitution(k, mass_eff, largest, time_step, self.angle), 1.0))


# Contacts of the restitution 0: Eq. 4 for e -> 0, where unloading is vertical (not in the paper)
#
# In the limit a contact yields along k d^1.5 while its overlap d increases, and at d = dmax carries any
# force between 0 and k dmax^1.5 without moving: the force that the other forces W on the pair require, M
# d'' = W - F = 0. A contact is in one of three states:
#
#     yielding    F = min(k d^1.5, G),  G: force that stops the approach within this step, until it is the
#                 smaller one
#     stopping    F = G, as long as the force exceeds the load of the pair
#     supporting  F = P + K (d - dmax) + c d' >= 0, until it exceeds k d^1.5
#
# The forces on the pair follow from its deceleration over the last step, D = M (d'(t - dt) - d'(t))/dt, as
# W = F(t - dt) - D. The contact stops the pair where the velocity would change its sign at this
# deceleration, with
#
#     G = P + (F(t - dt) - P) M d'/(D dt) >= 0,     P = max(2 W - F(t - dt), 0)
#
# In an impact the contact itself decelerates the pair, alone (W = 0), or together with others that stop at
# the same time (W < F/2): P is 0 and the velocity exactly 0 after this step, whatever the time step.
# Contacts that load each other more strongly, as those of a particle in an acute wedge, stop within some
# steps, with a rebound of first order in the time step. Under a load that changes slowly D is small, P = W,
# and the contact keeps its force: a bed that is loaded slowly has the overlaps of Hertz contacts.
#
# The support replaces the vertical line by one of the slope K, which passes through (dmax, P), with
#
#     K = max(0.1 M/dt^2, 1.5 k sqrt(dmax)),     c = (1 - K dt^2/M) M/(4 dt)
#
# It is never softer than the loading curve; its displacement under a load is of second order in the time
# step. A densely packed bed, 4 (K dt^2/M + 2 c dt/M) < 4, is stable. A pair that separates from the
# support, but not from the overlap, finds the line at dmax with P = 0, and is stopped there without rebound
# as in an impact.
#
# All work of the force is lost. The contact accumulates it, mean of the forces at both ends of the step
# times the change of the overlap, which is the change of the kinetic energy in the leapfrog scheme.

SUPPORT_NUMBER = 0.1
"""Smallest K dt^2/M of the support."""
SUPPORT_DAMPING = 0.25
"""c dt/M of the support for K dt^2/M -> 0."""
SUPPORT_MODES = SUPPORT_NUMBER + 2.0 * SUPPORT_DAMPING * (1.0 - SUPPORT_NUMBER)
"""K dt^2/M + 2 c dt/M of the support: times the number of contacts that act on a mode, at most 4."""
YIELDING = 0.0
STOPPING = 1.0
SUPPORTING = 2.0
"""States of a contact, in the history field `recovery`."""
INELASTIC_HISTORY = (
    HistoryField("support", "force of the support at the maximum overlap", "N"),
    HistoryField("force_before", "normal force one step before", "N"),
    HistoryField("rate_before", "overlap rate one step before", "m/s"),
    HistoryField("work", "work on the contact", "J"),
)
"""Further history of contacts in a scene with a pair of the restitution 0."""


def is_inelastic(pair: PairMaterial) -> bool:
    """Whether the restitution of a pair is the number 0."""
    return pair.restitution == 0.0


@ti.func
def inelastic_pair(constants):
    """Device form of `is_inelastic`; the constant restitution of a pair with e(v) is 0, too."""
    return constants.restitution + constants.limit_velocity == 0.0


@ti.func
def stopping_force(mass_rate, rate, capacity, history):
    """G [N], the load P [N] that remains, and whether the force exceeds the load W of the pair.

    G is `capacity` where an approaching pair does not decelerate.

    mass_rate:  M/dt [kg/s]
    rate:       overlap rate at the half step [m/s]
    capacity:   k d^1.5 [N]
    """
    change = history.rate_before - rate
    decelerates = (change > 0.0) & (history.force_before > 0.0)
    load = ti.min(ti.max(history.force_before - 2.0 * mass_rate * change, 0.0), history.force_before)
    share = rate / ti.select(decelerates, change, 1.0)
    stopping = ti.max(load + share * (history.force_before - load), 0.0)
    force = ti.select(decelerates, stopping, ti.select(rate > 0.0, capacity, load))
    begins = history.overlap_max == 0.0
    return ti.select(begins, mass_rate * ti.max(rate, 0.0), force), load, decelerates


@ti.func
def inelastic_force(contact, k, rate, history):
    """Force [N] and history of an inelastic pair; `recovery` is its state: YIELDING, STOPPING or SUPPORTING.

    k:     Hertz stiffness [N/m^1.5]
    rate:  overlap rate at the half step [m/s]
    """
    overlap = contact.overlap
    mass_rate = contact.mass_eff / contact.time_step
    largest = ti.max(overlap, history.overlap_max)
    capacity = k * ti.sqrt(largest) * largest
    stopping, load, decelerates = stopping_force(mass_rate, rate, capacity, history)
    yields = history.recovery == YIELDING
    stops = (history.recovery == STOPPING) & decelerates

    number = ti.max(1.5 * k * ti.sqrt(largest) * (contact.time_step / mass_rate), SUPPORT_NUMBER)
    stiffness = number * (mass_rate / contact.time_step)
    line = history.support + stiffness * (overlap - history.overlap_max)
    damping = SUPPORT_DAMPING * ti.max(1.0 - number, 0.0) * mass_rate
    held = ti.select(line > 0.0, ti.max(line + damping * rate, 0.0), 0.0)
    separates = (line <= 0.0) & (overlap < history.overlap_max)
    # A pair without load that returns to the line finds it at its end, and is stopped as in an impact.
    arrives = decelerates & (load == 0.0) & (history.support == 0.0)
    lands = arrives & (stopping < history.force_before) & ~stops

    trial = ti.select(yields | stops | lands, stopping, held)
    force = ti.min(trial, capacity)
    reloads = ~(stops | lands) & (trial >= capacity) & (overlap >= history.overlap_max)
    state = ti.select(stops, STOPPING, ti.select(reloads, YIELDING, SUPPORTING))
    state = ti.select(yields, ti.select(trial < capacity, STOPPING, YIELDING), state)

    history_new = history
    history_new.recovery = state
    history_new.overlap_max = ti.select(yields | (state == YIELDING), largest, history.overlap_max)
    anchored = stiffness * (history_new.overlap_max - overlap)
    support = ti.select(lands, anchored, ti.select(separates, 0.0, history.support))
    history_new.support = ti.select(yields | stops, load + anchored, support)
    travel = contact.time_step * ti.select(history.overlap_max == 0.0, ti.max(rate, 0.0), rate)
    history_new.work += 0.5 * (force + history.force_before) * travel
    history_new.force_before = force
    history_new.rate_before = rate
    return force, history_new


# Reference implementation in numpy


def reference_contact(law: Zhou, contact: ContactState) -> tuple[float, Mapping[str, float]]:
    """Normal force [N] and changed history fields of one contact, in float64."""
    overlap = contact.overlap
    rate = contact.overlap_rate
    constants = contact.constants
    history = contact.history
    k = float(theory.hertz_stiffness(constants.modulus_eff, contact.radius_eff))
    largest = history.overlap_max
    e = history.restitution
    y = history.recovery
    if constants.restitution == constants.limit_velocity == 0.0:
        if law.rate_dependent:
            rate += 0.5 * contact.time_step * history.force_before / contact.mass_eff
        return reference_inelastic(contact, k, rate)
    if law.restitution_at != "max_overlap" and largest == 0.0:
        e = _restitution(constants, rate)
    viscous = 0.0
    if overlap >= largest:
        elastic = k * overlap**1.5
        largest = overlap
        y = 0.0
    else:
        if y == 0.0:
            largest, e, y = _unloading_start(law, contact, k)
        above = reference_mean_above(overlap - largest * (1.0 - y), rate, contact.time_step)
        lam = k * np.sqrt(largest) * float(theory.unloading_slope(e))
        elastic = lam * above + e**3 * k * above**1.5
        if elastic > 0.0 and constants.restitution < 1.0:
            tangent = lam + 1.5 * e**3 * k * np.sqrt(above)
            share = max(1.0 - tangent * contact.time_step**2 / contact.mass_eff, 0.0)
            share /= 1.0 + max(rate, 0.0) ** 2 * contact.mass_eff / (0.8 * k * largest**2.5 * REST_SPEED**2)
            viscous = 2.0 * law.rest_damping * share * np.sqrt(tangent * contact.mass_eff) * max(rate, 0.0)
    if elastic > 0.0 and law.rate_dependent:
        root = reference_step_mean(DAMPING_POWER, overlap, rate, contact.time_step)
        viscous += 2.0 * law.damping_ratio * np.sqrt(1.5 * k * contact.mass_eff) * root * rate
    total = float(max(elastic + viscous, 0.0))
    return total, {"overlap_max": largest, "restitution": e, "recovery": y}


def _unloading_start(law: Zhou, contact: ContactState, k: float) -> tuple[float, float, float]:
    """Maximum overlap [m], restitution and recovery at the start of unloading."""
    largest = contact.history.overlap_max
    mass = contact.mass_eff
    time_step = contact.time_step
    force = k * largest**1.5
    rate = contact.overlap_rate
    e = contact.history.restitution
    if law.rate_dependent:
        rate += 0.5 * time_step * force / mass
    largest = reference_turning_point(largest, force, mass, time_step, rate)
    if law.restitution_at == "max_overlap":
        e = _restitution(contact.constants, np.sqrt(0.8 * k * largest**2.5 / mass))
    least = float(theory.least_restitution(k, mass, largest, time_step, law.angle))
    e = min(max(e, least), 1.0)
    return largest, e, float(theory.recovery(e))


def _restitution(constants: SimpleNamespace, velocity: float) -> float:
    """Restitution at an approach velocity [m/s]."""
    if constants.limit_velocity == 0.0:
        return float(constants.restitution)
    fit = VelocityRestitution(constants.sigma, constants.psi, constants.limit_velocity)
    return float(fit(max(velocity, 0.0)))


def reference_inelastic(contact: ContactState, k: float, rate: float) -> tuple[float, dict[str, float]]:
    """Reference implementation of `inelastic_force` in numpy: force [N] and changed history fields."""
    before: SimpleNamespace = contact.history
    mass = contact.mass_eff
    time_step = contact.time_step
    overlap = contact.overlap
    mass_rate = mass / time_step
    change = before.rate_before - rate
    deceleration = mass_rate * change
    load = float(np.clip(before.force_before - 2.0 * deceleration, 0.0, before.force_before))
    if before.overlap_max == 0.0:
        stopping = mass_rate * max(rate, 0.0)
    elif deceleration > 0.0 and before.force_before > 0.0:
        stopping = max(load + rate / change * (before.force_before - load), 0.0)
    else:
        stopping = np.inf if rate > 0.0 else load
    largest = max(overlap, before.overlap_max)
    hertz = k * np.sqrt(largest) * largest
    number = max(1.5 * k * np.sqrt(largest) * (time_step / mass_rate), SUPPORT_NUMBER)
    stiffness = number * (mass_rate / time_step)
    force = min(stopping, hertz)
    state = STOPPING
    largest_new = before.overlap_max
    if before.recovery == YIELDING:
        state = STOPPING if stopping < hertz else YIELDING
        largest_new = largest
        support = load + stiffness * (largest - overlap)
    elif before.recovery == STOPPING and deceleration > 0.0 and before.force_before > 0.0:
        support = load + stiffness * (largest_new - overlap)
    else:
        depth = overlap - before.overlap_max
        elastic = before.support + stiffness * depth
        if 0.0 == before.support == load and deceleration > 0.0 and stopping < before.force_before:
            state = SUPPORTING
            support = -stiffness * depth
        else:
            viscous = SUPPORT_DAMPING * max(1.0 - number, 0.0) * mass_rate * rate
            force = min(max(elastic + viscous, 0.0), hertz) if elastic > 0.0 else 0.0
            if force < hertz or depth < 0.0:
                state = SUPPORTING
                support = 0.0 if elastic <= 0.0 and depth < 0.0 else before.support
            else:
                state = YIELDING
                support = before.support
                largest_new = largest
    travel = time_step * (max(rate, 0.0) if before.overlap_max == 0.0 else rate)
    return force, {
        "overlap_max": largest_new,
        "restitution": 0.0,
        "recovery": state,
        "support": support,
        "force_before": force,
        "rate_before": rate,
        "work": before.work + 0.5 * (force + before.force_before) * travel,
    }


# The record: options and restitution that a scene gives

REST_DAMPING = 0.1
"""Default of the option `rest_damping`."""


class ZhouOptions(Options):
    """Options of the model."""

    with_numbers: ClassVar[Mapping[str, str]] = {"restitution_at": "constant"}

    restitution_at: RestitutionAt = Field(
        "impact",
        description="velocity at which e is evaluated: impact (at first contact), max_overlap (from the "
        "maximum overlap, Zhou 2011, Eq. 5) or constant (e does not depend on velocity; always used if the "
        "restitution of every pair is a number)",
    )
    damping_ratio: Annotated[float, Number(noun="a damping ratio", at_least=0, at_most=1)] = Field(
        0.0,
        description="damping ratio of the viscous force on the elastic branch; 0: no viscous force, 1: "
        "critical damping",
        examples=["0.1"],
    )
    rest_damping: Annotated[float, Number(noun="a damping ratio", at_least=0, at_most=0.5)] = Field(
        REST_DAMPING,
        description="damping ratio of a viscous force on contacts that are compressed again without having "
        "separated, as in a bed at rest; binary collisions are not affected; 0: no such force",
        examples=["0.1"],
    )

    @property
    def rate_reason(self) -> str:
        """The damping ratio, and whether `rest_damping` acts without it."""
        rests = self.rest_damping and not self.damping_ratio
        addition = ", and rest_damping acts only on contacts that reload" if rests else ""
        return f"contact.normal.damping_ratio is {self.damping_ratio:g}{addition}"


MODEL = ContactModel(
    Zhou,
    "Hertz loading, nonlinear plastic unloading (Zhou 2011).",
    options=ZhouOptions,
    restitution="number or fit",
)
