"""Executes the scenes of `scenes` in one of several ways, and saves what a run leaves behind.

    python executions.py host|gpu|long|forked|ranks FOLDER SCENE ...

host:   one thread, two threads, more threads than the pool has, other chunks and skin, resumed from three checkpoints
gpu:    the code path of a GPU on the CPU, with fields in several trees
long:   with the kernels that are compiled for long runs
forked: with the kernel language Quadrants, which `test_bits` selects
ranks:  on the MPI ranks of mpirun

FOLDER/EXECUTION/SCENE contains the files of each run and `state.npz`, its state at the end.
"""

import os
import shutil
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent.parent))

from bits.scenes import SCENES  # noqa: E402

from granflow.engine import backend, fields, threads  # noqa: E402
from granflow.engine.host import joined_particles  # noqa: E402
from granflow.io.checkpoint import read_checkpoint  # noqa: E402
from granflow.load import Scene  # noqa: E402
from granflow.plan import cost  # noqa: E402
from granflow.simulation import Simulation  # noqa: E402

HOST = ("one", "two", "pool", "lists", "begun", "resumed_1", "resumed_4", "resumed_8")
"""Executions of `host`, the reference first; `resumed_N` continues from checkpoint N of the first,
`begun` a run that was stopped before its first step."""
MORE_THAN_POOL = 4 * (os.cpu_count() or 1)
"""Number of workers that exceeds the number of threads in Taichi's pool."""
LARGEST_BUFFER = 2**18
"""Bytes of the buffers of the imitated GPU; the fields of each scene are in several trees."""


def main(execution, folder, names):
    cost.OPTIMIZED_ABOVE = 1e9
    for name in names:
        if execution == "ranks" and not SCENES[name].on_ranks:
            continue
        KINDS[execution](name, Path(folder))


def on_host(name, folder):
    row = SCENES[name]
    run(name, folder / "one", row.build(), 1)
    threads.SINGLE_WORKER_PARTICLES = 0  # scenes of this size use one worker by default
    run(name, folder / "two", row.build(), 2)
    scene = row.build()
    skin = None if scene.outlets else 6e-4  # particles are deleted at rebuilds
    run(name, folder / "lists", with_lists(scene, 7, skin), 2)
    if row.change is None:
        begin(name, folder)
    for execution in HOST[5:] if row.change is None else HOST[-1:]:  # a checkpoint contains earlier changes
        resume(name, folder, execution)
    count = backend.worker_count
    backend.worker_count = lambda requested: (requested, "")
    run(name, folder / "pool", row.build(), MORE_THAN_POOL)
    backend.worker_count = count


def on_gpu(name, folder):
    backend.Backend.on_cpu = property(lambda self: False)
    prepare = fields.FieldBlock.__init__

    def prepare_with_limit(block, started):
        prepare(block, replace(started, largest_buffer=LARGEST_BUFFER))

    fields.FieldBlock.__init__ = prepare_with_limit
    run(name, folder / "gpu", with_lists(SCENES[name].build(), 1), 1)
    fields.FieldBlock.__init__ = prepare


def for_long(name, folder):
    cost.OPTIMIZED_ABOVE = 0.0
    run(name, folder / "long", SCENES[name].build(), 1)


def with_fork(name, folder):
    run(name, folder / "forked", SCENES[name].build(), 2)


def on_ranks(name, folder):
    from granflow.engine.state_cache import start
    from granflow.parallel import rank_stepper
    from granflow.parallel.communicator import Communicator
    from granflow.parallel.rank_engine import RankEngine, controlling, serve
    from granflow.plan.build import plan_for

    rank_stepper.MIGRATION_INTERVAL = 2  # every other rebuild keeps the particles
    scene = SCENES[name].build()
    communicator = Communicator()
    if communicator.is_root:
        with controlling(communicator):
            run(name, folder / "ranks", scene, 1, communicator=communicator)
        return
    serve(
        communicator,
        lambda: RankEngine(plan_for(scene), start("cpu", scene.run.precision, 1), communicator),
    )


def with_lists(scene, chunk_size, skin=None):
    """The scene with another chunk size and another skin [m]; None: that of the scene."""
    changed = scene.to_dict()
    changed["numerics"]["chunk_size"] = chunk_size
    if skin is not None:
        changed["numerics"]["skin"] = skin
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
    """Write particles, contacts, totals, wall impulses, contact histories and counts at the end of a run."""
    last = simulation.snapshot(contacts=True)
    engine = simulation.engine
    kinds = ("particles", "contacts", "totals", "impulses", "collisions")
    arrays = {
        f"{kind}.{name}": np.asarray(value) for kind in kinds for name, value in getattr(last, kind).items()
    }
    arrays |= {f"offset.{name}": wall.offset for name, wall in last.walls.items()}
    arrays |= {f"exits.{face}": np.array(count) for face, count in engine.accounting.exits.items()}
    arrays |= {
        "steps": np.array(engine.step_count),
        "rebuilds": np.array(engine.timing.rebuild_count),
        "stride": np.array(engine.state.stride),
    }
    np.savez(out / "state.npz", **arrays, **histories(engine))
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


KINDS = {"host": on_host, "gpu": on_gpu, "long": for_long, "forked": with_fork, "ranks": on_ranks}

if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2], sys.argv[3:])
