"""Wall-clock time of a run by phase."""

from dataclasses import dataclass


@dataclass
class Timing:
    """Wall-clock time [s] by phase, and counts.

    neighbor_list:        neighbor-list rebuilds
    advance:              all other phases of the steps
    sampled_forces:       forces of the sampled steps
    sampled_integration:  integration of the sampled steps; the ratio of both divides `advance`
    rebuild_count:        number of neighbor-list rebuilds
    step_count:           number of completed steps
    particle_steps:       sum of the particle counts of all steps
    growth_count:         number of reallocations with a larger list capacity
    compile:              compilation of kernels
    exchange:             part of `advance`: messages between MPI ranks
    waiting:              part of `advance`: agreement of MPI ranks on each step, which waits for the slowest rank
    """

    neighbor_list: float = 0.0
    advance: float = 0.0
    sampled_forces: float = 0.0
    sampled_integration: float = 0.0
    rebuild_count: int = 0
    step_count: int = 0
    particle_steps: int = 0
    growth_count: int = 0
    compile: float = 0.0
    exchange: float = 0.0
    waiting: float = 0.0

    @property
    def _computing(self) -> float:
        """Wall-clock time [s] of forces and integration."""
        return self.advance - self.exchange - self.waiting

    @property
    def forces(self) -> float:
        """Wall-clock time [s] of contact forces."""
        sampled = self.sampled_forces + self.sampled_integration
        return self._computing * self.sampled_forces / sampled if sampled else self._computing

    @property
    def integration(self) -> float:
        """Wall-clock time [s] of time integration."""
        return self._computing - self.forces
