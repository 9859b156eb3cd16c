"""Warnings while a run goes on, from numbers that a snapshot has fetched anyway: nothing is added to a step."""

import logging

import numpy as np

from granflow.device.books import Books
from granflow.plan import Plan
from granflow.plan.plan import meetings_of
from granflow.plan.time_step import stable_step

GAINED = 0.05
"""Energy from nowhere over the largest kinetic energy so far from which on it is said."""

ROUNDING = {"f64": 1e-9, "mixed": 1e-6, "f32": 1e-5}
"""Share of the potential energies that is rounding, by precision: masses have it, in f32 positions, too."""

FASTER = 1.1
"""By how much the fastest particle must outdo the fastest so far to be looked at again."""


class Watch:
    """Looks at every snapshot: is the step still stable for the speeds there are, has energy come from nowhere?

    Kinetic and potential energy may never exceed what they were, without contacts, at the start, with what particles
    bring and take: contacts only borrow. That needs walls that stay and stand still, and no adhesion; where the
    energy ledger is kept, its error is taken instead, which needs neither.
    """

    def __init__(self, plan: Plan) -> None:
        self.plan = plan
        self.warnings: dict[str, str] = {}
        self._fastest = plan.velocity_max
        self._rounding = ROUNDING[plan.scene.run.precision]
        self._start = 0.0
        self._kinetic_largest = 0.0
        self._asked = not plan.features.ledger and _keeps_energy(plan)
        self._begun = False

    def look(
        self, time: float, energies: tuple[float, float, float], books: Books, totals: dict[str, float], speed: float
    ) -> None:
        """See what stands at `time` [s]: kinetic, rotational, potential energy [J], totals, largest speed [m/s]."""
        self._look_at_speed(time, speed)
        gained = self._gained(energies, books, totals["contact_count"])
        self._kinetic_largest = max(self._kinetic_largest, energies[0] + energies[1])
        share = gained / self._kinetic_largest if self._kinetic_largest else 0.0
        share = max(share, totals.get("energy_error", 0.0))
        if share > GAINED:
            self._asked = False
            self._say(
                "energy",
                f"At {time:.6g} s there is energy from nowhere, {share:.1%} of the largest kinetic energy so far: the "
                f"contacts are integrated too coarsely. Lower run.time_step (now {self.plan.time_step:.3g} s) or set "
                "run.velocity_max to the fastest impact; output.energy shows where it comes from.",
            )

    def _gained(self, energies: tuple[float, float, float], books: Books, contact_count: float) -> float:
        """Energy above what there can be [J]; 0 where that cannot be told."""
        if not self._asked:
            return 0.0
        flow = books.brought_energy - books.removed_energy
        held = sum(energies) - flow
        if not self._begun:
            self._begun = True
            self._asked = contact_count == 0
            self._start = held
        return max(held - self._start - self._rounding * (abs(energies[2]) + abs(flow)), 0.0)

    def _look_at_speed(self, time: float, speed: float) -> None:
        """Hold a step that does not follow the scene against the stable one at the speed of the fastest particle."""
        if self.plan.pace is not None or not speed > FASTER * self._fastest:
            return
        self._fastest = speed
        stable = min(stable_step(meeting, self.plan.law, speed) for meeting in meetings_of(self.plan.scene))
        if self.plan.time_step > stable:
            self._say(
                "speed",
                f"At {time:.6g} s the fastest particle moves at {speed:.3g} m/s, faster than the "
                f"{self.plan.velocity_max:.3g} m/s planned for: an impact at that speed needs a time step below "
                f"{stable:.3g} s, but it is {self.plan.time_step:.3g} s. Set run.velocity_max to {speed:.3g} m/s.",
            )

    def _say(self, kind: str, sentence: str) -> None:
        """Once for each kind."""
        if kind not in self.warnings:
            self.warnings[kind] = sentence
            logging.getLogger("granflow").warning("%s", sentence)


def _keeps_energy(plan: Plan) -> bool:
    """Whether nothing but arriving particles can bring energy."""
    walls = plan.scene.walls.values()
    stay = all(wall.stages is None and not wall.appears_at and wall.vanishes_at is None for wall in walls)
    turns = any(plan.gravity[axis] for axis in plan.border.axes)  # who passes a border may fall for ever
    turns = turns or plan.features.shear
    return stay and not turns and not plan.features.moving_walls and not plan.law.attracts


def largest_speed(velocity: np.ndarray) -> float:
    """Largest speed [m/s] of velocities (n, 3)."""
    return float(np.sqrt(np.einsum("ij,ij->i", velocity, velocity).max(initial=0.0)))
