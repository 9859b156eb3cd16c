"""Warnings while a run goes on, from numbers that a snapshot has fetched anyway: nothing is added to a step."""

import logging

import numpy as np

from granflow.device.books import LARGEST_ERROR, ROUNDING, Books, put_in
from granflow.plan import Plan
from granflow.plan.plan import meetings_of
from granflow.plan.time_step import stable_step

FASTER = 1.1
"""By how much the fastest particle must outdo the fastest so far to be looked at again."""


class Watch:
    """Checks every snapshot: is the step still stable for the speeds there are, is energy conserved?

    With the energy budget, the magnitude of its error must stay below LARGEST_ERROR. Without, kinetic and potential
    energy must not exceed those at the start and of particles inserted since; what is above is taken over the same
    scale, the largest energy put in so far. That requires a start without contacts, walls at rest and no cohesion.
    """

    def __init__(self, plan: Plan) -> None:
        self.plan = plan
        self.warnings: dict[str, str] = {}
        self._fastest = plan.velocity_max
        self._rounding = ROUNDING[plan.scene.run.precision]
        self._start = 0.0
        self._asked = not plan.features.ledger and _keeps_energy(plan)
        self._begun = False

    def look(
        self, time: float, energies: tuple[float, float, float], books: Books, totals: dict[str, float], speed: float
    ) -> None:
        """See what stands at `time` [s]: kinetic, rotational, potential energy [J], totals, largest speed [m/s]."""
        self._look_at_speed(time, speed)
        share = totals.get("energy_error", self._gained_share(energies, books, totals["contact_count"]))
        if abs(share) > LARGEST_ERROR:
            self._asked = False
            self._say(
                "energy",
                f"At {time:.6g} s the energy error is {share:.2%} of the energy put in, more than {LARGEST_ERROR:.1%}: "
                f"the contacts are integrated too coarsely. Lower run.time_step (now {self.plan.time_step:.3g} s) or "
                "set run.velocity_max to the fastest impact; output.energy shows the terms of the energy budget.",
            )

    def _gained_share(self, energies: tuple[float, float, float], books: Books, contact_count: float) -> float:
        """Energy above what there can be, over the largest energy put in so far."""
        gained = self._gained(energies, books, contact_count)
        books.energy_put_in = max(books.energy_put_in, put_in(books, energies[2]))
        return gained / books.energy_put_in if gained else 0.0

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
