"""Largest overlap of one contact in an impact and under a static load, by the reference implementation of its model."""

from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np

from granflow.contact import theory
from granflow.contact.law import ContactState, Law
from granflow.contact.laws import ContactLaws
from granflow.contact.material import PairMaterial

STEPS_OF_LOADING = 200
"""Steps of the integration of an impact in its loading time; the error of the overlap is below 0.1 %."""

MAX_LOADING_TIMES = 5
"""Longest integration in loading times: with an attraction the loading lasts longer than without."""

MAX_OVERLAP_SHARE = 2.0
"""Largest overlap, over the smaller radius, of the search for a static overlap."""

BISECTIONS = 30
"""Halvings of the interval in which a static overlap lies: resolves it to 2e-9 of the radius."""


@dataclass(frozen=True)
class TouchingPair:
    """Two bodies that can be in contact.

    materials:   names of both materials, those of the particle first
    pair:        mixed constants of the materials
    radius:      of the smaller particle [m], to which overlaps refer
    radius_eff:  [m]
    mass_eff:    [kg]
    """

    name: str
    materials: tuple[str, str]
    pair: PairMaterial
    radius: float
    radius_eff: float
    mass_eff: float

    def stiffer(self, factor: float) -> "TouchingPair":
        """The same pair with both effective moduli multiplied by `factor`."""
        pair = replace(
            self.pair,
            modulus_eff=factor * self.pair.modulus_eff,
            shear_modulus_eff=factor * self.pair.shear_modulus_eff,
        )
        return replace(self, pair=pair)


class ContactForces:
    """Force of the normal and the cohesion model of a pair, by their reference implementations; keeps the history.

    `time_step` [s]: for which models average their damping. At rest, an inelastic contact (restitution 0) carries any
    load up to the loading curve, which does not depend on the restitution: it is evaluated for the restitution 1.
    """

    def __init__(self, laws: ContactLaws, pair: TouchingPair, time_step: float) -> None:
        self.laws: list[tuple[float, Law]] = [(1.0, laws.normal)]
        self.laws += [(-1.0, laws.cohesion)] if laws.cohesion is not None else []
        self.pair, self.time_step = pair, time_step
        self.reset()
        loading = replace(pair.pair, restitution=1.0) if pair.pair.restitution == 0.0 else pair.pair
        self.constants = [
            SimpleNamespace(**dict(zip(law.constant_names, law.pair_constants(loading), strict=False)))
            for _, law in self.laws
        ]

    def reset(self) -> None:
        """Begin a new contact."""
        self.history = [dict.fromkeys(law.history_names, 0.0) for _, law in self.laws]

    def parts(self, overlap: float, rate: float) -> list[float]:
        """Normal force [N], and minus the attraction of the cohesion model if there is one.

        `overlap` [m], `rate` [m/s]: overlap rate, positive during approach.
        """
        forces = []
        for index, (sign, law) in enumerate(self.laws):
            state = ContactState(
                self.constants[index], self.pair.radius_eff, self.pair.mass_eff, self.time_step, overlap, rate,
                SimpleNamespace(**self.history[index]),
            )  # fmt: skip
            force, changed = law.reference(state)  # type: ignore[attr-defined]
            self.history[index] |= changed
            forces.append(sign * float(force))
        return forces

    def total(self, overlap: float, rate: float) -> float:
        """Repulsive force [N], negative if the attraction is larger."""
        return sum(self.parts(overlap, rate))


def impact_overlap(laws: ContactLaws, pair: TouchingPair, velocity: float, enough: float = 0.0) -> float:
    """Largest overlap over the smaller radius of a head-on impact at `velocity` [m/s].

        M d'' = -F(d, d'),     d(0) = 0,     d'(0) = v,     until d' = 0

    by leapfrog, unless the closed form is below `enough`: without attraction it is an upper bound. For elastic loading
    the energy balance gives d = (5 M v^2 / (4 k))^(2/5) with k = (4/3) E sqrt(R) (Hertz 1882; Zhou 2011, Eq. 5);
    viscous forces lower it, attractions raise it. Closed form of the model if it has no reference implementation.
    """
    arguments = (pair.pair, pair.radius_eff, pair.mass_eff, velocity)
    elastic = laws.normal.overlap_max(*arguments) / pair.radius
    if elastic <= enough and not laws.attracts:
        return elastic
    step = laws.normal.phase_durations(*arguments)[0] / STEPS_OF_LOADING
    forces = ContactForces(laws, pair, step)
    overlap, rate = 0.5 * step * velocity, velocity
    try:
        for _ in range(MAX_LOADING_TIMES * STEPS_OF_LOADING):
            rate -= step * forces.total(overlap, rate) / pair.mass_eff
            if rate <= 0.0:
                break
            overlap += step * rate
    except NotImplementedError:
        return elastic
    return overlap / pair.radius


def impact_velocity(laws: ContactLaws, pair: TouchingPair, overlap: float, approach: float) -> float:
    """Velocity [m/s] of an impact that has reached `overlap` [m] and approaches at `approach` [m/s], without losses.

        v^2 = approach^2 + (2 / M) int_0^d F(x, 0) dx     e.g. (4/5) (k/M) d^2.5, k = (4/3) E sqrt(R) (Hertz 1882)

    The work of attractions, which act before contact too, is not included. Hertz's if the model has no reference
    implementation.
    """
    width = overlap / STEPS_OF_LOADING
    forces = ContactForces(laws, pair, 1.0)
    try:
        work = width * sum(forces.parts((k + 0.5) * width, 0.0)[0] for k in range(STEPS_OF_LOADING))
    except NotImplementedError:
        work = 0.4 * theory.hertz_stiffness(pair.pair.modulus_eff, pair.radius_eff) * overlap**2.5
    return float(np.hypot(approach, np.sqrt(2.0 * work / pair.mass_eff)))


def static_overlap(laws: ContactLaws, pair: TouchingPair, load: float) -> float:
    """Overlap over the smaller radius at which a contact carries `load` [N] at rest; 2 if no smaller one does.

        F(d, 0) = load       e.g. d = (load / k)^(2/3), k = (4/3) E sqrt(R), without attraction (Hertz 1882)

    The contact has no history: it is loaded for the first time. NaN if a model has no reference implementation.
    """

    forces = ContactForces(laws, pair, 1.0)

    def excess(overlap: float) -> float:
        forces.reset()
        return forces.total(overlap, 0.0) - load

    low, high = 0.0, MAX_OVERLAP_SHARE * pair.radius
    try:
        if excess(high) < 0.0:
            return MAX_OVERLAP_SHARE
        for _ in range(BISECTIONS):
            middle = 0.5 * (low + high)
            low, high = (low, middle) if excess(middle) > 0.0 else (middle, high)
    except NotImplementedError:
        return float("nan")
    return high / pair.radius


def attraction_share(laws: ContactLaws, pair: TouchingPair, overlap: float) -> float:
    """Attraction over normal force at an overlap [m] at rest; 0 without a cohesion model."""
    if laws.cohesion is None:
        return 0.0
    normal, attraction = ContactForces(laws, pair, 1.0).parts(overlap, 0.0)
    return float(-attraction / normal) if normal > 0.0 else np.inf
