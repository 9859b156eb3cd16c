"""Runs of shipped scenes that return frames of the particles and the expectations that are not satisfied."""

from pathlib import Path

from granflow import Simulation, load_scene
from granflow.observers.observer import on_interval

SCENES = Path(__file__).parents[1] / "scenes"


def run_shipped_scene(name, out, interval=1e3, overrides=()):
    """Frames (snapshots of particles) of a shipped scene, every `interval` [s], and the unsatisfied
    expectations."""
    frames = []
    observer = on_interval(interval, frames.append, wants=("particles",))
    scene = load_scene(SCENES / f"{name}.yaml", ["output.interval=1000 s", *overrides])
    simulation = Simulation(scene, threads=2, out=out, observers=[observer])
    result = simulation.run()
    simulation.free()
    assert result.expectations
    return frames, [sentence for sentence, met in result.expectations if not met]
