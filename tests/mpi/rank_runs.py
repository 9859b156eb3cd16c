"""Runs a scene of this module on all ranks of mpirun, or alone, and writes the last state as npz.

python rank_runs.py SCENE FILE [--alone]
"""

import sys
from pathlib import Path

import numpy as np

sys.path[:0] = [str(Path(__file__).parent.parent), str(Path(__file__).parent.parent.parent)]

from scene_builders import box, build_scene, particle_group  # noqa: E402

from granflow.engine.backend import start  # noqa: E402
from granflow.parallel.communicator import Communicator  # noqa: E402
from granflow.parallel.rank_engine import END, START, RankEngine  # noqa: E402
from granflow.plan.build import plan_for  # noqa: E402
from granflow.simulation import Simulation  # noqa: E402


def bed(normal="zhou", steps=300, **changes):
    """512 particles with random velocities in a box with a vibrating floor: contacts, friction, rolling, rebuilds."""
    walls = box(0.055)
    walls["low_z"] |= {"motion": {"kind": "vibration", "direction": [0, 0, 1], "amplitude": 1e-3, "frequency": 60.0}}
    rng = np.random.default_rng(4)
    positions = 0.0065 * (np.argwhere(np.ones((8, 8, 8))) + 0.75)
    lattice = particle_group(
        positions, rng.uniform(0.004, 0.0062, len(positions)), velocity=rng.normal(0.0, 0.5, positions.shape)
    )
    parts = {
        "numerics": {"chunk_size": 64, "skin": 2e-4},
        "rolling": "epsd",
        "pair": {"friction": 0.4, "rolling_friction": 0.1, "restitution": 0.5},
        "output": {"interval": 1.0, "energy_budget": True, "wall_forces": True},
        "run": {"duration": steps * 2e-6, "velocity_max": 3.0, "time_step": 2e-6},
    }
    return build_scene({"lattice": lattice}, walls=walls, gravity=[0.0, 3.0, -9.81], normal=normal, **(parts | changes))


SCENES = {
    "short": lambda: bed(),
    "hertz": lambda: bed("hertz", 3000),
    "zhou": lambda: bed("zhou", 3000),
}


def main(name, path, *options):
    scene = SCENES[name]()
    if "--alone" in options:
        return save(path, Simulation(scene, threads=1))
    communicator = Communicator()
    if communicator.is_root:
        with communicator_released(communicator):
            save(path, Simulation(scene, threads=1, communicator=communicator))
        return
    engine = None
    while (command := communicator.next_command())[0] != END:
        if command[0] == START:
            engine = RankEngine(plan_for(scene), start("cpu", scene.run.precision, 1), communicator)
        else:
            getattr(engine, command[0])(*command[1])


class communicator_released:
    def __init__(self, communicator):
        self.communicator = communicator

    def __enter__(self):
        return self

    def __exit__(self, *error):
        if error[0] is None:
            self.communicator.send_command(END)
        else:
            import traceback

            traceback.print_exception(*error)
            self.communicator.abort(3)


def save(path, simulation):
    simulation.run()
    last = simulation.snapshot()
    engine = simulation.engine
    arrays = {f"particles.{k}": v for k, v in last.particles.items()}
    arrays |= {f"totals.{k}": np.array(v) for k, v in last.totals.items()}
    arrays |= {f"impulses.{k}": v for k, v in last.impulses.items()}
    arrays |= {"rebuilds": np.array(engine.timing.rebuild_count), "steps": np.array(engine.step_count)}
    np.savez(path, **arrays)
    print(
        path,
        engine.step_count,
        engine.timing.rebuild_count,
        getattr(engine.stepper, "exchange_seconds", 0),
        engine.timing,
    )
    simulation.free()


if __name__ == "__main__":
    main(*sys.argv[1:])
