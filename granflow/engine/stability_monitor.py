"""Warnings during a run from values of the snapshots, without additional work in a step."""

import logging
from math import inf
from typing import Any

from granflow.engine.accounting import Accounting, energy_input
from granflow.engine.totals import LARGEST_ERROR, ROUNDING
from granflow.plan.plan import Plan
from granflow.plan.time_step import stable_step

SPEED_INCREASE = 1.1
"""Factor by which the particle speed must exceed the previous maximum for another check."""


class StabilityMonitor:
    """Checks at every observation that the time step is stable for the current speeds and that energy is conserved.

    With the energy budget, the magnitude of its error must be below LARGEST_ERROR. Without it, kinetic and potential
    energy must not exceed those at the start and of particles inserted since. The excess is relative to the same scale,
    the largest energy input so far. This check requires a start without contacts, walls at rest and no cohesion.

    `warnings`: logged warnings by kind ("energy", "speed"), each logged once.
    """

    def __init__(self, plan: Plan) -> None:
        self.plan = plan
        self.warnings: dict[str, str] = {}
        self._fastest = plan.velocity_max
        self._rounding = ROUNDING[plan.precision]
        self._initial_energy = 0.0
        self._above_since: float | None = None
        self._enabled = not plan.features.energy_budget and _conserves_energy(plan)
        self._started = False

    def check(
        self,
        time: float,
        energies: tuple[float, float, float],
        accounting: Accounting,
        totals: dict[str, float],
        speed: float,
    ) -> None:
        """Check one snapshot; logs a warning if the energy error exceeds its limit in two consecutive snapshots.

        time:        simulated time [s]
        energies:    kinetic, rotational and gravitational energy [J]
        accounting:  counts and energies since the start; its `energy_put_in` is updated
        totals:      totals of the snapshot
        speed:       largest speed of a particle [m/s]
        """
        self._check_speed(time, speed)
        works = (totals[name] for name in ("wall_work", "boundary_work", "external_work") if name in totals)
        accounting.energy_put_in = max(accounting.energy_put_in, energy_input(accounting, energies[2], works))
        share = totals.get("energy_error", self._gained_share(energies, accounting, totals["contact_count"]))
        earlier = self._above_since
        self._above_since = None if not abs(share) > LARGEST_ERROR else time if earlier is None else earlier
        if earlier is not None and self._above_since is not None and time > earlier:
            self._enabled = False
            self._warn_once(
                "energy",
                f"At {time:.6g} s the energy error is {share:.2%} of the energy input, more than {LARGEST_ERROR:.1%}: "
                f"the time step is too long for the contacts. Lower run.time_step (now {self.plan.time_step:.3g} s) or "
                "set run.velocity_max to the fastest impact; output.energy_budget shows the terms of the energy "
                "budget.",
            )

    def state_dict(self) -> dict[str, Any]:
        """Return the state for a checkpoint, so that a resumed run repeats no warning."""
        return {
            "warnings": dict(self.warnings), "fastest": self._fastest, "initial_energy": self._initial_energy,
            "above_since": self._above_since, "enabled": self._enabled, "started": self._started,
        }  # fmt: skip

    def load_state_dict(self, saved: dict[str, Any]) -> None:
        """Restore the state of `state_dict`; the plan may have changed so that the energy is not conserved any more."""
        self.warnings, self._fastest = dict(saved["warnings"]), saved["fastest"]
        self._initial_energy, self._above_since = saved["initial_energy"], saved["above_since"]
        self._enabled, self._started = self._enabled and saved["enabled"], saved["started"]

    def _gained_share(
        self, energies: tuple[float, float, float], accounting: Accounting, contact_count: float
    ) -> float:
        """Excess energy over the largest energy input so far."""
        energy_gain = self._energy_gain(energies, accounting, contact_count)
        return energy_gain / accounting.energy_put_in if accounting.energy_put_in > 0.0 else 0.0

    def _energy_gain(self, energies: tuple[float, float, float], accounting: Accounting, contact_count: float) -> float:
        """Energy above the conserved total [J]; 0 if the check does not apply."""
        if not self._enabled:
            return 0.0
        energy_inserted = accounting.inserted_energy - accounting.removed_energy
        present_energy = sum(energies) - energy_inserted
        if not self._started:
            self._started = True
            self._enabled = contact_count == 0
            self._initial_energy = present_energy
        return max(
            present_energy - self._initial_energy - self._rounding * (abs(energies[2]) + abs(energy_inserted)), 0.0
        )

    def _check_speed(self, time: float, speed: float) -> None:
        """Compare a fixed time step with the stable time step at the speed of the fastest particle."""
        if self.plan.adaptive_time_step is not None or not SPEED_INCREASE * self._fastest < speed < inf:
            return
        self._fastest = speed
        stable = min(stable_step(pair_case, self.plan.law, speed) for pair_case in self.plan.pair_cases)
        if self.plan.time_step > stable:
            self._warn_once(
                "speed",
                f"At {time:.6g} s the fastest particle moves at {speed:.3g} m/s, above the "
                f"planned {self.plan.velocity_max:.3g} m/s: an impact at that speed requires a time step below "
                f"{stable:.3g} s, but it is {self.plan.time_step:.3g} s. Set run.velocity_max to {speed:.3g} m/s.",
            )

    def _warn_once(self, kind: str, sentence: str) -> None:
        """Log the warning once per kind."""
        if kind not in self.warnings:
            self.warnings[kind] = sentence
            logging.getLogger("granflow").warning("%s", sentence)


def _conserves_energy(plan: Plan) -> bool:
    """True if only inserted particles can increase the energy."""
    walls_static = all(wall.is_permanent for wall in plan.walls)
    # Gravity along a periodic axis accelerates particles without limit.
    has_other_work = any(plan.gravity[axis] for axis in plan.periodic_box.axes)
    has_other_work = has_other_work or plan.features.lees_edwards
    has_other_work = has_other_work or plan.features.external_forces
    return walls_static and not has_other_work and not plan.features.moving_walls and not plan.laws.attracts
