"""Executes the scenes of `scenes` in one of several ways, and saves what a run leaves behind.

    python executions.py host|usual|gpu|long|forked|ranks FOLDER SCENE ...

host:   one worker, two workers, more workers than the pool has threads, other chunks and skin, resumed from three
        checkpoints
usual:  some of `host`, see USUAL
gpu:    the code path of a GPU on the CPU, with fields in several trees
long:   with the kernels that are compiled for long runs; other chunks and skin
forked: with the kernel language Quadrants, which `test_bits` selects; other chunks and skin
ranks:  on the MPI ranks of mpirun; with arrays that must grow in the scene walls

FOLDER/EXECUTION/SCENE contains the files of each run and `state.npz`, its state at the end.
"""

import os
import shutil
import sys
from functools import partial
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent.parent))

from bits.scenes import SCENES  # noqa: E402
from gpu.code_path import use_gpu_code_path  # noqa: E402

from granflow.engine import backend, threads  # noqa: E402
from granflow.engine.host import joined_particles  # noqa: E402
from granflow.io.checkpoint import read_checkpoint  # noqa: E402
from granflow.load import Scene  # noqa: E402
from granflow.plan import build, cost, plan  # noqa: E402
from granflow.simulation import Simulation  # noqa: E402

RESUMED = ("resumed_1", "resumed_4", "resumed_8")
"""Executions that continue the reference from its checkpoint of this number."""
HOST = ("one", "two", "lists", "begun", *RESUMED, "pool")
"""Executions of `host` in their order, the reference first; `begun` continues a run that was stopped before
its first step."""
FOR_CHANGE = ("one", "two", "lists", RESUMED[-1], "pool")
"""Executions of a scene with a change, which the earlier checkpoints do not contain."""
USUAL = {
    "walls": ("one", "begun", "resumed_4"),
    "clumps": ("one", "begun", "resumed_4"),
    "films": ("one", "two", RESUMED[-1]),
    "heat": ("one", "lists", "begun", "resumed_4"),
}
"""Executions of the usual test run by scene: begun and resumed runs have two workers; those with other kernels have
other lists, too, for which kernels are compiled in any case."""
OTHER_LISTS = ("lists", "gpu", "long", "forked")
"""Executions with other chunks than the reference."""
SINGLE_WORKER_PARTICLES = threads.SINGLE_WORKER_PARTICLES
MORE_THAN_POOL = 4 * (os.cpu_count() or 1)
"""Number of workers that exceeds the number of threads in Taichi's pool."""


def main(execution, folder, names):
    cost.OPTIMIZED_ABOVE = 1e9
    for name in names:
        if execution == "ranks" and not SCENES[name].on_ranks:
            continue
        KINDS[execution](name, Path(folder))


def host_executions(name, usual=False):
    """Executions of a scene in `host`, or in `usual`, in their order."""
    if usual:
        return USUAL[name]
    return HOST if SCENES[name].change is None else FOR_CHANGE


def on_host(name, folder, usual=False):
    row = SCENES[name]
    executions = host_executions(name, usual)
    threads.SINGLE_WORKER_PARTICLES = SINGLE_WORKER_PARTICLES  # above the number of particles
    run(name, folder / "one", row.build(), 2)
    threads.SINGLE_WORKER_PARTICLES = 0
    if "two" in executions:
        run(name, folder / "two", row.build(), 2)
    if "lists" in executions:
        run(name, folder / "lists", with_lists(row.build(), 7), 2)
    if "begun" in executions:
        begin(name, folder)
    for execution in RESUMED:
        if execution in executions:
            resume(name, folder, execution)
    if "pool" in executions:
        count = backend.worker_count
        backend.worker_count = lambda requested: (requested, "")
        run(name, folder / "pool", row.build(), MORE_THAN_POOL)
        backend.worker_count = count


def on_gpu(name, folder):
    use_gpu_code_path()
    run(name, folder / "gpu", with_lists(SCENES[name].build(), 1), 1)


def for_long(name, folder):
    cost.OPTIMIZED_ABOVE = 0.0
    run(name, folder / "long", with_lists(SCENES[name].build(), 7), 1)


def with_fork(name, folder):
    run(name, folder / "forked", with_lists(SCENES[name].build(), 7), 2)


def on_ranks(name, folder):
    from granflow.engine.state_cache import start
    from granflow.parallel import rank_stepper
    from granflow.parallel.communicator import Communicator
    from granflow.parallel.rank_engine import RankEngine, controlling, serve

    rank_stepper.MIGRATION_INTERVAL = 2  # every other rebuild keeps the particles
    if name == "walls":
        plan.MIN_PARTICLES = plan.MIN_LIST_ENTRIES = 64
        plan.neighbors_per_particle = lambda _count, _skin: 0.5
        build.BALANCE = 0.1
        build.GHOST_LAYERS = 0.0
    scene = SCENES[name].build()
    communicator = Communicator()
    if communicator.is_root:
        with controlling(communicator):
            run(name, folder / "ranks", scene, 1, communicator=communicator)
        return
    serve(
        communicator,
        lambda: RankEngine(build.plan_for(scene), start("cpu", scene.run.precision, 1), communicator),
    )


def with_lists(scene, chunk_size):
    """The scene with another chunk size, and another skin unless that changes when particles are deleted."""
    changed = scene.to_dict()
    changed["numerics"]["chunk_size"] = chunk_size
    if not scene.outlets and scene.domain.on_exit != "delete":
        changed["numerics"]["skin"] = 6e-4
    return Scene.from_dict(changed)


def run(name, folder, scene, workers, **options):
    """Run a scene to its end, with the change of its row, and save its state."""
    change = SCENES[name].change
    simulation = Simulation(scene, out=folder / name, threads=workers, **options)
    if change is not None:
        simulation.run(until=0.5 * scene.longest_duration)
        change(simulation)
    simulation.run()
    save(folder / name, simulation)


def begin(name, folder):
    """Stop a run before its first step, and continue it."""
    out = folder / "begun" / name
    simulation = Simulation(SCENES[name].build(), out=out, threads=2)
    simulation.run(until=0)
    simulation.free()
    simulation = Simulation(SCENES[name].build(), out=out, threads=2, resume=out)
    simulation.run()
    save(out, simulation)


def resume(name, folder, execution):
    """Continue the run `one` in a copy of its folder from one of its checkpoints."""
    out = folder / execution / name
    shutil.copytree(folder / "one" / name, out)
    number = int(execution.rpartition("_")[2])
    checkpoint = sorted(out.glob("checkpoint_*.npz"))[number]
    scene = SCENES[name].build()
    simulation = Simulation(scene, out=out, threads=2, resume=read_checkpoint(checkpoint))
    simulation.run()
    save(out, simulation)


def save(out, simulation):
    """Write the state at the end of a run."""
    stride = np.array(simulation.engine.state.stride)
    growths = np.array(simulation.engine.timing.growth_count)
    np.savez(out / "state.npz", **arrays_of(simulation), stride=stride, growths=growths)
    simulation.free()


def arrays_of(simulation):
    """Particles, contacts, totals, wall impulses and offsets, contact histories, exits and counts by name."""
    last = simulation.snapshot(contacts=True)
    engine = simulation.engine
    kinds = ("particles", "contacts", "totals", "impulses", "collisions")
    arrays = {
        f"{kind}.{name}": np.asarray(value) for kind in kinds for name, value in getattr(last, kind).items()
    }
    arrays |= {f"offset.{name}": wall.offset for name, wall in last.walls.items()}
    arrays |= {f"exits.{face}": np.array(count) for face, count in engine.accounting.exits.items()}
    arrays |= {"steps": np.array(engine.step_count), "rebuilds": np.array(engine.timing.rebuild_count)}
    return arrays | histories_of(engine)


def histories_of(engine):
    """Contact histories of all particles, ordered by the ids of owner and partner."""
    particles = joined_particles(engine.on_each_rank(own_particles)).by_id()
    found = particles.histories
    pairs = np.stack([particles.arrays["id"][found.owner], found.partner])
    return {"history.pairs": pairs} | {f"history.{slot}": values for slot, values in found.values.items()}


def own_particles(engine, _rank):
    """Particles and contact histories of one rank."""
    return engine.saved_particles()


KINDS = {
    "host": on_host,
    "usual": partial(on_host, usual=True),
    "gpu": on_gpu,
    "long": for_long,
    "forked": with_fork,
    "ranks": on_ranks,
}

if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2], sys.argv[3:])
