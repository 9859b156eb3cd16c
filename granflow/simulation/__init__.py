"""One run of one scene: the time loop, and what it keeps account of."""

from granflow.simulation.loop import Simulation

__all__ = ["Simulation"]
