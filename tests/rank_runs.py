"""Runs a scene of this module and writes its last state as npz: alone, or on the ranks of mpirun.

python rank_runs.py SCENE FILE alone|ranks|small|failing

small: with arrays that must grow; failing: with a fault in all ranks but the root
"""

import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))

from scene_builders import (  # noqa: E402
    DASHPOTS,
    SPRINGS,
    box,
    build_scene,
    moving_lattice,
    particle_group,
    vibrating_box,
)  # noqa: E402
from sheared_scenes import sheared_gas  # noqa: E402

from granflow.engine.backend import start  # noqa: E402
from granflow.engine.engine import Engine  # noqa: E402
from granflow.engine.host_particles import joined_particles  # noqa: E402
from granflow.parallel import decomposition, rank_engine  # noqa: E402
from granflow.parallel.communicator import Communicator  # noqa: E402
from granflow.parallel.decomposition import Decomposition  # noqa: E402
from granflow.parallel.rank_engine import RankEngine  # noqa: E402
from granflow.parallel.serve import controlling, serve  # noqa: E402
from granflow.plan import plan as plan_module  # noqa: E402
from granflow.plan import ranks  # noqa: E402
from granflow.plan.build import plan_for  # noqa: E402
from granflow.simulation import Simulation  # noqa: E402

TIME_STEP = 2e-6
FAILING_STEP = 60


def bed(steps=300, groups=None, **changes):
    """216 particles with velocities in all directions in a box with a vibrating floor, in chunks of 32."""
    lattice = moving_lattice((6, 6, 6), largest=0.0062, speed=1.0)
    parts = {
        "normal": "zhou",
        "rolling": "epsd",
        "gravity": [0.0, 3.0, -9.81],
        "numerics": {"chunk_size": 32, "skin": 2e-4},
        "pair": {"friction": 0.4, "rolling_friction": 0.1, "restitution": 0.5},
        "output": {"interval": 1.0, "energy_budget": True, "wall_forces": True, "walls": False},
        "run": {"duration": steps * TIME_STEP, "velocity_max": 4.0, "time_step": TIME_STEP},
        "walls": vibrating_box(0.042),
    }
    return build_scene({"lattice": lattice} | (groups or {}), **(parts | changes))


def models(given):
    """The bed with other contact models, in 1000 steps."""
    return bed(1000, numerics={"chunk_size": 32, "max_overlap": 0.4}, **given)


def inserted():
    """The bed with rain, a wall that appears, and a particle that leaves the domain."""
    region = {"box": {"min": [0.005, 0.005, 0.042], "max": [0.037, 0.037, 0.06]}}
    rain = {"material": "glass", "count": 40, "diameter": 0.004,
            "insert": {"kind": "rain", "region": region, "rate": 20000.0}}  # fmt: skip
    walls = box(0.042)
    del walls["high_z"]
    walls["low_x"]["appears_at"] = 1e-3
    domain = {"min": [-0.001, -0.01, -0.01], "max": [0.05, 0.05, 0.07], "on_exit": "delete"}
    leaving = particle_group([[0.02, 0.02, 0.066]], 0.004, velocity=[0.0, 0.0, 3.0])
    return bed(1500, {"rain": rain, "leaving": leaving}, walls=walls, domain=domain)


def periodic():
    """The bed without side walls in a box that is periodic along x and y."""
    walls = {name: wall for name, wall in box(0.042).items() if name.endswith("z")}
    domain = {"min": [0.0, 0.0, -0.01], "max": [0.042, 0.042, 0.05], "periodic": ["x", "y"], "on_exit": "error"}
    return bed(1500, walls=walls, domain=domain)


def wide_sizes():
    """The bed with a particle of five times the diameter above it: size classes with separate grids."""
    walls = box(0.042)
    del walls["high_z"]
    large = particle_group([[0.02, 0.02, 0.06]], 0.03, velocity=[0.0, 0.0, -2.0])
    return bed(1500, {"large": large}, walls=walls)


def in_precision(precision):
    """The bed in another precision, in 1500 steps."""
    duration = 1500 * TIME_STEP
    return bed(
        run={"duration": duration, "velocity_max": 4.0, "time_step": TIME_STEP, "precision": precision},
        numerics={"chunk_size": 32, "max_overlap": 0.3},
    )


def with_outlet():
    """The bed above a hole in the floor, with an outlet behind it."""
    walls = box(0.042)
    del walls["low_z"]
    outlets = {"hole": {"box": {"min": [-0.01, -0.01, -0.02], "max": [0.03, 0.05, 0.002]}}}
    domain = {"min": [-0.01, -0.01, -0.03], "max": [0.05, 0.05, 0.05], "on_exit": "delete"}
    return bed(1500, walls=walls, outlets=outlets, domain=domain)


def with_piston(motion):
    """The bed under a lid that a force moves."""
    walls = vibrating_box(0.042)
    walls["high_z"]["motion"] = {"direction": [0, 0, -1], **motion}
    return bed(1500, walls=walls)


def on_belt():
    """The bed between a belt that starts slowly as floor and a turning side wall with a surface velocity."""
    walls = box(0.042)
    walls["low_z"]["motion"] = {
        "kind": "surface_velocity", "velocity": [2.0, 0.5, 0.0], "ramp_duration": 1e-3, "initial_velocity": [0, 1, 0]
    }  # fmt: skip
    turning = {"kind": "rotation", "point": [0.0, 0.021, 0.021], "axis": [1, 0, 0], "angular_velocity": 50.0}
    walls["low_x"]["motion"] = [turning, {"kind": "surface_velocity", "velocity": [0.0, 1.0, 0.0], "start": 5e-4}]
    table = {"kind": "table", "direction": [-1, 0, 0], "times": [0, 1e-3, 2e-3], "displacements": [0, 2e-4, 1e-4]}
    walls["high_x"]["motion"] = table
    return bed(1500, walls=walls)


def sheared():
    """A cloud of two sizes in a Lees-Edwards box."""
    return sheared_gas(duration=0.008, sizes=(0.002, 0.0065))


def uneven():
    """125 particles in contact beside 125 without, in a long box: ranks with equal costs have unequal counts."""
    dense = 0.01 * 0.99 * (np.argwhere(np.ones((5, 5, 5))) + 0.55)
    dilute = 0.01 * (2.0 * np.argwhere(np.ones((5, 5, 5))) + [6.5, 0.5, 0.5])
    walls = box(0.101)
    walls["high_x"]["point"] = [0.2, 0.0, 0.0]
    velocity = np.random.default_rng(3).uniform(-0.5, 0.5, dilute.shape).tolist()
    groups = {"dense": particle_group(dense), "dilute": particle_group(dilute, velocity=velocity)}
    return build_scene(
        groups, walls, pair={"friction": 0.4, "restitution": 0.2}, gravity=[0.0, 0.0, -9.81],
        numerics={"chunk_size": 32, "skin": 1e-4}, output={"interval": 1.0, "energy_budget": True},
        run={"duration": 500 * TIME_STEP, "velocity_max": 4.0, "time_step": TIME_STEP},
    )  # fmt: skip


SCENES = {
    "uneven": uneven,
    "short": bed,
    "long_lists": lambda: bed(numerics={"chunk_size": 32, "skin": 1.5e-3}),
    "hertz": lambda: bed(3000, normal="hertz"),
    "zhou": lambda: bed(3000),
    "dashpots": lambda: models(DASHPOTS),
    "springs": lambda: models(SPRINGS),
    "inserted": inserted,
    "periodic": periodic,
    "wide_sizes": wide_sizes,
    "outlet": with_outlet,
    "servo": lambda: with_piston({"kind": "servo", "force": 2.0, "velocity_max": 0.5}),
    "free": lambda: with_piston({"kind": "free", "mass": 0.01}),
    "adaptive": lambda: bed(run={"duration": 3e-3, "velocity_max": 4.0, "time_step": "adaptive"}),
    "belt": on_belt,
    "sheared": sheared,
    "mixed": lambda: in_precision("mixed"),
    "f32": lambda: in_precision("f32"),
}


def main(name, path, kind):
    scene = SCENES[name]()
    if kind == "alone":
        return save(path, Simulation(scene, threads=1))
    if kind == "small":
        plan_module.MIN_PARTICLES = plan_module.MIN_LIST_ENTRIES = 64
        plan_module.neighbors_per_particle = lambda _count, _skin: 0.5
        ranks.BALANCE, ranks.GHOST_LAYERS = 0.1, 0.0
    communicator = Communicator()
    Recorded.rank_here = communicator.rank
    decomposition.Decomposition = Recorded
    rank_engine.RankEngine = ObservedEngine
    if communicator.is_root:
        with controlling(communicator):
            save(path, Simulation(scene, threads=1, communicator=communicator))
    else:
        engine = failing_engine() if kind == "failing" else ObservedEngine
        serve(communicator, lambda: engine(plan_for(scene), start("cpu", scene.run.precision, 1), communicator))


def failing_engine():
    """The class of an engine that fails within a command."""

    class FailingEngine(RankEngine):
        def advance(self, steps):
            if self.step_count >= FAILING_STEP:
                raise ArithmeticError("a fault of this test")
            Engine.advance(self, steps)

    return FailingEngine


def save(path, simulation):
    """Run to the end and write particles, totals, wall impulses, contact histories and counts."""
    simulation.run()
    last, engine = simulation.snapshot(contacts=True), simulation.engine
    arrays = {f"{kind}.{name}": np.asarray(value) for kind in ("particles", "contacts", "totals", "impulses")
              for name, value in getattr(last, kind).items()}  # fmt: skip
    counts = {"steps": engine.step_count, "rebuilds": engine.timing.rebuild_count}
    if isinstance(engine, ObservedEngine):
        counts |= {"growths": engine.timing.growth_count, "migrations": engine.migrations(), "owned": engine.owned()}
    np.savez(path, **arrays, **histories(engine), **{name: np.array(value) for name, value in counts.items()})
    simulation.free()


def histories(engine):
    """Contact histories of all particles, ordered by the ids of owner and partner."""
    particles = joined_particles(engine.on_each_rank(own_particles)).by_id()
    found = particles.histories
    pairs = np.stack([particles.arrays["id"][found.owner], found.partner])
    return {"history.pairs": pairs} | {f"history.{slot}": values for slot, values in found.values.items()}


def own_particles(engine, _rank):
    """Particles and contact histories of one rank."""
    return engine.saved_particles()


class ObservedEngine(RankEngine):
    """An engine whose root also returns the numbers of migrations and of particles."""

    def migrations(self):
        with self.communicator.commanding("migrations"):
            return np.array(self.communicator.to_root(sum(Recorded.sent[1:])))

    def owned(self):
        """Number of particles of each rank."""
        with self.communicator.commanding("owned"):
            return np.array(self.communicator.to_root(self.state.count))


class Recorded(Decomposition):
    """A decomposition that records how many particles each rebuild sends to each rank, 0 for the own rank."""

    sent = []

    def owners(self, position):
        found = super().owners(position)
        counts = np.bincount(found, minlength=self.rank.max() + 1)
        counts[Recorded.rank_here] = 0
        Recorded.sent.append(counts)
        return found


if __name__ == "__main__":
    main(*sys.argv[1:])
