"""Viscoelastic spheres (Kuwabara & Kono 1987): a Hertz spring with the damping of a viscoelastic solid.

The dissipative force is proportional to the square root of the overlap, and e decreases with velocity as
1 - C v^(1/5). The single parameter follows from the restitution of the pair at a reference velocity.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache

from pydantic import Field

from granflow.contact import theory
from granflow.contact.law import ContactModel, ContactState, ModelRequest, Options
from granflow.contact.material import PairMaterial
from granflow.contact.normal.hertz import HertzSpring
from granflow.contact.step_corrections import build_step_mean, reference_step_mean
from granflow.device_functions import power, ti
from granflow.schema import quantities as q

DAMPING_POWER = 0.5
"""Exponent of the overlap in the dissipative force."""
EXPONENT = 0.2
"""Exponent of the impact velocity in the dimensionless dissipation of a collision."""
STEPS = 500
"""Number of steps of the fourth-order integration of a collision; the error of e is then below 1e-8."""
LARGEST_DISSIPATION = 64.0
"""Largest dissipation considered; e is 0.0013 there."""


_step_mean = build_step_mean(DAMPING_POWER)


@dataclass(frozen=True)
class KuwabaraKono(HertzSpring):
    """Viscoelastic spheres; the restitution of a pair applies at the reference velocity, for all sizes.

    e depends only on g v^(1/5) (Brilliantov et al. 1996), so that g = g_ref / v_ref^(1/5), where g_ref gives
    e at 1 m/s.
    """

    reference_velocity: float

    name = "kuwabara_kono"
    source = (
        "Kuwabara & Kono 1987, Jpn. J. Appl. Phys. 26:1230; Brilliantov et al. 1996, doi "
        "10.1103/PhysRevE.53.5382"
    )
    limits = (
        "valid for slow viscoelastic impacts: 1 - e increases as v^(1/5) for every material; the power of "
        "the mass in the force takes extra time for every contact and step"
    )
    constant_names = ("modulus_eff", "shear_modulus_eff", "dissipation")
    """Dissipation: g at 1 m/s [(s/m)^(1/5)]."""
    branch_free = False

    @classmethod
    def from_scene(cls, request: ModelRequest) -> "KuwabaraKono":
        """The law that a scene requests."""
        return cls(request.options.reference_velocity)

    @property
    def rate_dependent(self) -> bool:
        """The contact has damping."""
        return True

    def pair_constants(self, pair: PairMaterial) -> tuple[float, ...]:
        """Values of `constant_names`. Raises ValueError if the restitution is 0 or depends on velocity."""
        if not isinstance(pair.restitution, float):
            raise ValueError("the contact model kuwabara_kono requires one number as restitution coefficient")
        dissipation = self.reference_velocity**-EXPONENT * dissipation_for(pair.restitution)
        return pair.modulus_eff, pair.shear_modulus_eff, dissipation

    @ti.func
    def force(self, constants, contact, history):
        """F = max(k d^1.5 + g k^(3/5) M^(2/5) d^(1/2) d', 0), where g is the dissipation at 1 m/s.

        d^(1/2) of the damping is averaged over the step.
        """
        k = 4.0 / 3.0 * constants.modulus_eff * ti.sqrt(contact.radius_eff)
        elastic = k * ti.sqrt(contact.overlap) * contact.overlap
        overlap_at, weight = _step_mean(contact.overlap, contact.overlap_rate, contact.time_step)
        damping = constants.dissipation * k * power(contact.mass_eff / k, 0.4) * weight * ti.sqrt(overlap_at)
        viscous = ti.max(damping * contact.overlap_rate, -elastic)
        return elastic + viscous, viscous, history

    @ti.func
    def damping(self, constants, contact, history):
        """g k^(3/5) M^(2/5) d^(1/2) [N s/m]."""
        k = 4.0 / 3.0 * constants.modulus_eff * ti.sqrt(contact.radius_eff)
        return constants.dissipation * k * power(contact.mass_eff / k, 0.4) * ti.sqrt(contact.overlap)

    def reference(self, contact: ContactState) -> tuple[float, Mapping[str, float]]:
        """Reference implementation of `force` in numpy."""
        k = theory.hertz_stiffness(contact.constants.modulus_eff, contact.radius_eff)
        damping = contact.constants.dissipation * k**0.6 * contact.mass_eff**0.4
        root = reference_step_mean(DAMPING_POWER, contact.overlap, contact.overlap_rate, contact.time_step)
        dissipative = damping * root * contact.overlap_rate
        return float(max(k * contact.overlap**1.5 + dissipative, 0.0)), {}

    def _rebound(self, pair: PairMaterial, velocity: float) -> tuple[float, float, float]:
        """Restitution and dimensionless durations at an approach velocity [m/s], see `rebound_of`."""
        return rebound_of(self.pair_constants(pair)[2] * velocity**EXPONENT)

    def restitution(self, pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float) -> float:
        """Restitution of the undisturbed collision."""
        return self._rebound(pair, velocity)[0]

    def phase_durations(
        self, pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float
    ) -> tuple[float, float]:
        """Loading and unloading durations [s]; the unit of time is (M^2 / (k^2 v))^(1/5)."""
        k = float(theory.hertz_stiffness(pair.modulus_eff, radius_eff))
        unit = (mass_eff**2 / (k**2 * velocity)) ** EXPONENT
        _, loading, unloading = self._rebound(pair, velocity)
        return unit * loading, unit * unloading

    def viscosity(self, pair: PairMaterial, radius_eff: float, mass_eff: float, velocity: float) -> float:
        """Ratio of dissipative force to overlap rate at the maximum overlap of the undamped contact [N
        s/m]."""
        k = float(theory.hertz_stiffness(pair.modulus_eff, radius_eff))
        largest = float(theory.overlap_max(k, mass_eff, velocity))
        return self.pair_constants(pair)[2] * k**0.6 * mass_eff**0.4 * math.sqrt(largest)


class KuwabaraKonoOptions(Options):
    """Options of the model."""

    reference_velocity: q.Speed = Field(
        description="approach velocity [m/s] at which e equals the restitution of the pair",
        examples=["1 m/s"],
    )


MODEL = ContactModel(
    KuwabaraKono,
    "Viscoelastic spheres: Hertz spring with damping proportional to the square root of the overlap; e "
    "decreases with velocity (Kuwabara & Kono 1987).",
    options=KuwabaraKonoOptions,
)


@cache
def dissipation_for(e: float) -> float:
    """Dissipation g that gives the restitution e, by bisection of `rebound_of`.

    Raises ValueError for e outside (0, 1], and for e below the restitution at LARGEST_DISSIPATION.
    """
    if not 0.0 < e <= 1.0:
        raise ValueError("a viscous contact model supports any restitution in (0, 1], not 0")
    low, high = 0.0, 1.0
    while rebound_of(high)[0] > e:
        low, high = high, 2.0 * high
        if high > LARGEST_DISSIPATION:
            raise ValueError(
                f"the contact model kuwabara_kono does not support a restitution as small as {e:g}"
            )
    for _ in range(40):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if rebound_of(middle)[0] > e else (low, middle)
    return 0.5 * (low + high) if e < 1.0 else 0.0


@cache
def rebound_of(dissipation: float) -> tuple[float, float, float]:
    """Restitution, loading duration and unloading duration of a collision in dimensionless form.

        x'' + g x^(1/2) x' + x^(3/2) = 0,   x(0) = 0, x'(0) = 1,   until the force is 0

    The unit of length is (M v^2 / k)^(2/5), the unit of time that length over v. With s = t^(1/2) as the
    variable the solution is smooth at the start.
    """
    state = (0.0, 1.0)
    s = 0.0
    turning_time = 0.0
    step = math.sqrt(2.0 * theory.LOADING_DURATION) / STEPS / max(1.0, dissipation)
    while True:
        after = _runge_kutta_step(state, s, step, dissipation)
        if turning_time == 0.0 and after[1] <= 0.0:
            turning_time = (s + step * state[1] / (state[1] - after[1])) ** 2
        if after[1] < 0.0 and after[0] + dissipation * after[1] <= 0.0:
            break
        state = after
        s = s + step
    low, high = 0.0, step
    for _ in range(40):
        middle = 0.5 * (low + high)
        x, w = _runge_kutta_step(state, s, middle, dissipation)
        low, high = (middle, high) if x + dissipation * w > 0.0 else (low, middle)
    end = (s + low) ** 2
    return -_runge_kutta_step(state, s, low, dissipation)[1], turning_time, end - turning_time


def _runge_kutta_step(state: tuple[float, float], s: float, step: float, g: float) -> tuple[float, float]:
    """One step of the classical fourth-order Runge-Kutta method in s = t^(1/2).

    state:    x and x' = w
    s, step:  variable and step length
    g:        dissipation
    Returns:  state after the step
    """

    def slope(s: float, x: float, w: float) -> tuple[float, float]:
        root = max(x, 0.0) ** 0.5
        return 2.0 * s * w, -2.0 * s * root * (x + g * w)

    x, w = state
    half = 0.5 * step
    a = slope(s, x, w)
    b = slope(s + half, x + half * a[0], w + half * a[1])
    c = slope(s + half, x + half * b[0], w + half * b[1])
    d = slope(s + step, x + step * c[0], w + step * c[1])
    sixth = step / 6.0
    return (
        x + sixth * (a[0] + 2.0 * (b[0] + c[0]) + d[0]),
        w + sixth * (a[1] + 2.0 * (b[1] + c[1]) + d[1]),
    )
