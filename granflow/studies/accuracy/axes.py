"""Parameters of the two-particle study: contact model, precision, time step and kinds of collision."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from granflow.contact.material import Solid
from granflow.scene.schema.presets import PRESETS
from granflow.studies.accuracy.exact import EXACT, Exact
from granflow.studies.head_on import HeadOnCollision
from granflow.studies.paper.cases import PaperCase

PRECISIONS = ("f64", "mixed", "f32")
"""Precisions of the study, the most accurate first."""

STEPS = (5, 7, 10, 14, 20, 28, 40, 56, 80, 112, 160, 320, 640, 1250, 2500, 5000)
"""Steps per collision: duration of the collision over the time step."""
FULL_STEPS = tuple(float(f"{steps:.3g}") for steps in np.geomspace(5.0, 5000.0, 31))
"""Steps per collision of the full study, ten per decade."""
VELOCITIES = (0.1, 1.0, 5.0)
"""Approach velocities [m/s]."""
PHASES = 32
"""Collisions of each kind; their times of first contact are evenly spaced over one step."""
DIAMETER = 5e-3
"""Diameter [m] of the reference particle; its elastic collision at 1 m/s sets the duration of all collisions."""
YOUNG_MODULUS = 50e6
"""Young's modulus of the particles [Pa]: glass, softened as in the example scenes.

Stiffer particles overlap less, so that single precision resolves fewer digits of the overlap.
"""
DISTANCE = 60e-3
"""Distance of the collisions from the origin [m].

Representative of a hopper: single precision resolves fewer digits of the overlap at this distance.
"""


@dataclass(frozen=True)
class StudiedLaw:
    """A contact model of the study: its label, its `contact.normal` in a scene, and the restitutions to reproduce.

    `normal`: name of the contact model, or a mapping with `law` and its parameters.
    """

    name: str
    normal: Any
    restitutions: tuple[float, ...]

    @property
    def law_name(self) -> str:
        """Name of the contact model in the catalog."""
        return str(self.normal if isinstance(self.normal, str) else self.normal["law"])


@dataclass(frozen=True)
class CollisionKind:
    """One kind of collision: target restitution, approach velocity [m/s], diameter [m], and the exact solution."""

    restitution: float
    velocity: float
    diameter: float
    exact: Exact

    @property
    def text(self) -> str:
        """Text for reports."""
        return f"e = {self.restitution:g} at {self.velocity:g} m/s"


RESTITUTIONS = (0.2, 0.5, 0.9)
"""Target restitutions of the contact models with dissipation."""

STUDIED_LAWS = (
    StudiedLaw("zhou", "zhou", RESTITUTIONS),
    StudiedLaw("hertz", "hertz", RESTITUTIONS),
    StudiedLaw("linear", {"law": "linear", "stiffness": "onset"}, RESTITUTIONS),
    StudiedLaw("hertz, elastic", "hertz", (1.0,)),
)
"""Contact models of the study; an elastic contact separates errors of the integration from those of damping."""


def reference_case() -> PaperCase:
    """Two particles of softened glass, with the diameter DIAMETER [m] and Young's modulus YOUNG_MODULUS [Pa].

    Density and Poisson ratio are those of the preset glass.
    """
    glass = PRESETS["glass"]
    solid = Solid(YOUNG_MODULUS, glass.poisson_ratio, glass.density)
    return PaperCase("glass", "glass", solid, {"preset": "glass", "young_modulus": YOUNG_MODULUS}, diameter=DIAMETER)


def common_duration() -> float:
    """Duration of every collision of the study [s]: that of an elastic collision of the reference case at 1 m/s.

    It is Zhou's duration (2011, Eq. 13) with e = 1.
    """
    return reference_case().duration(1.0, 1.0)


def kinds_of(law: StudiedLaw) -> tuple[CollisionKind, ...]:
    """All kinds of collision of one contact model: each restitution at each velocity.

    The diameters make all durations equal: at given restitution and velocity, the duration is proportional to the
    diameter.
    """
    case, found = reference_case(), []
    for e in law.restitutions:
        for velocity in VELOCITIES:
            matching = exact_of(law.law_name, case, e, velocity, DIAMETER)
            diameter = DIAMETER * common_duration() / matching.duration
            found.append(CollisionKind(e, velocity, diameter, exact_of(law.law_name, case, e, velocity, diameter)))
    return tuple(found)


def exact_of(law: str, case: PaperCase, e: float, velocity: float, diameter: float) -> Exact:
    """Exact solution for two particles of a diameter [m] that collide at a velocity [m/s].

    `law`: key of EXACT; `e`: restitution. Raises KeyError for a contact model without an exact solution.
    """
    return EXACT[law](e, case.stiffness(diameter), case.mass_eff(diameter), velocity)


def collisions_of(kinds: tuple[CollisionKind, ...]) -> list[HeadOnCollision]:
    """Every kind of collision, repeated `PHASES` times: (kinds * PHASES,) in the order of the kinds."""
    case = reference_case()
    return [case.head_on(kind.restitution, kind.velocity, kind.diameter) for kind in kinds for _ in range(PHASES)]


def first_contact_times(kinds: tuple[CollisionKind, ...], time_step: float) -> np.ndarray:
    """Times of first contact [s], (kinds * PHASES,): within the first step, evenly spaced for every kind."""
    return np.tile(time_step * (np.arange(PHASES) + 0.5) / PHASES, len(kinds))
