"""What the study of two bodies varies: law, integrator, precision, time step, and the collisions themselves."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from granflow.device.backend import Precision
from granflow.laws.material import Solid
from granflow.scene.presets import PRESETS
from granflow.study.accuracy.exact import EXACT, Exact
from granflow.study.paper.cases import PaperCase
from granflow.study.paper.head_on_collisions import HeadOnCollision

PRECISIONS: tuple[Precision, ...] = ("f64", "mixed", "f32")
STEPS = (5, 7, 10, 14, 20, 28, 40, 56, 80, 112, 160, 320, 640, 1250, 2500, 5000)
"""Of one collision: its duration over the time step."""
FULL_STEPS = tuple(float(f"{steps:.3g}") for steps in np.geomspace(5.0, 5000.0, 31))
"""The same, ten to a decade."""
VELOCITIES = (0.1, 1.0, 5.0)
"""Of approach [m/s]."""
PHASES = 32
"""Collisions of each kind, first touching at times spread evenly over a step."""
BEAD = 5e-3
"""Diameter [m] of the bead whose elastic collision at 1 m/s all others last as long as."""
YOUNG_MODULUS = 50e6
"""Of the beads [Pa]: glass softened as in the scenes that ship. Stiffer ones overlap less, and single precision has
fewer digits for that."""
DISTANCE = 60e-3
"""Of the collisions from the origin [m]: so far out in a hopper, single precision has this much fewer digits left."""


@dataclass(frozen=True)
class StudiedLaw:
    """A law of the study: its name there, `contact.normal` of a scene, and the restitutions asked of it."""

    name: str
    normal: Any
    restitutions: tuple[float, ...]

    @property
    def law_name(self) -> str:
        """Its name in the catalog."""
        return str(self.normal if isinstance(self.normal, str) else self.normal["law"])


@dataclass(frozen=True)
class Integrator:
    """A way to step."""

    name: str


@dataclass(frozen=True)
class CollisionKind:
    """One kind of collision: restitution asked, approach velocity [m/s], diameter [m], and its exact numbers."""

    restitution: float
    velocity: float
    diameter: float
    exact: Exact

    @property
    def words(self) -> str:
        """For people."""
        return f"e = {self.restitution:g} at {self.velocity:g} m/s"


RESTITUTIONS = (0.2, 0.5, 0.9)
STUDIED_LAWS = (
    StudiedLaw("zhou", "zhou", RESTITUTIONS),
    StudiedLaw("hertz", "hertz", RESTITUTIONS),
    StudiedLaw("linear", {"law": "linear", "stiffness": "onset"}, RESTITUTIONS),
    StudiedLaw("hertz, elastic", "hertz", (1.0,)),
)


INTEGRATORS = (Integrator("leapfrog"),)
"""The only one: docs/accuracy.md says what became of others."""


def bead_case() -> PaperCase:
    """Two beads of softened glass."""
    glass = PRESETS["glass"]
    solid = Solid(YOUNG_MODULUS, glass.poisson_ratio, glass.density)
    return PaperCase("glass", "glass", solid, {"preset": "glass", "young_modulus": YOUNG_MODULUS}, diameter=BEAD)


def common_duration() -> float:
    """How long every collision of the study lasts [s]."""
    return bead_case().duration(1.0, 1.0)


def kinds_of(law: StudiedLaw) -> tuple[CollisionKind, ...]:
    """All collisions of one law, in sizes that make them last equally long (durations go with the diameter)."""
    case, found = bead_case(), []
    for e in law.restitutions:
        for velocity in VELOCITIES:
            matching = exact_of(law.law_name, case, e, velocity, BEAD)
            diameter = BEAD * common_duration() / matching.duration
            found.append(CollisionKind(e, velocity, diameter, exact_of(law.law_name, case, e, velocity, diameter)))
    return tuple(found)


def exact_of(law: str, case: PaperCase, e: float, velocity: float, diameter: float) -> Exact:
    """Exact numbers of two spheres of a diameter [m] meeting at a velocity [m/s]."""
    return EXACT[law](e, case.stiffness(diameter), case.mass_eff(diameter), velocity)


def collisions_of(kinds: tuple[CollisionKind, ...]) -> list[HeadOnCollision]:
    """Every kind `PHASES` times over."""
    case = bead_case()
    return [case.head_on(kind.restitution, kind.velocity, kind.diameter) for kind in kinds for _ in range(PHASES)]


def first_contact_times(kinds: tuple[CollisionKind, ...], time_step: float) -> np.ndarray:
    """When each of them first touches [s]: within the first step, evenly spread for every kind."""
    return np.tile(time_step * (np.arange(PHASES) + 0.5) / PHASES, len(kinds))
