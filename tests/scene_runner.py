"""Runs of shipped scenes that return frames of the particles and the expectations that are not satisfied."""

from pathlib import Path

from granflow import Simulation, load_scene
from granflow.observers.observer import on_interval

SCENES = Path(__file__).parents[1] / "scenes"


REDUCED_HEAP = (
    "materials.glass.young_modulus=4 MPa",
    "materials.plate.young_modulus=4 MPa",
    "numerics.max_overlap=0.2",
    "particles.base.count=80",
    "particles.base.insert.region.box={min: [-50 mm, -10 mm, 0], max: [50 mm, 10 mm, 5 mm]}",
    "particles.beads.count=500",
    "particles.beads.insert.region.box={min: [-70 mm, -10 mm, 5 mm], max: [70 mm, 10 mm, 55 mm]}",
    "walls.left.corner=[-70 mm, -10 mm, 0]",
    "walls.right.corner=[70 mm, -10 mm, 0]",
    "walls.left_gate.corner=[-70 mm, -10 mm, 0]",
    "walls.right_gate.corner=[50 mm, -10 mm, 0]",
    "domain.min=[-75 mm, -10 mm, -40 mm]",
    "domain.max=[75 mm, 10 mm, 110 mm]",
    "output.metrics.left.region={min: [-40 mm, -10 mm, 0], max: [-5 mm, 10 mm, 100 mm]}",
    "output.metrics.right.region={min: [5 mm, -10 mm, 0], max: [40 mm, 10 mm, 100 mm]}",
)
"""Overrides of angle_of_repose.yaml: 20 particles wide and 4 deep, softer particles."""


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
