"""One run of one scene: time loop, stages, insertion and timings."""

from granflow.simulation.loop import Simulation

__all__ = ["Simulation"]
