"""The state at the end of a run as arrays, alone or on MPI ranks, to compare two executions."""

import numpy as np

from granflow.engine.host import joined_particles


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
    return arrays | _histories(engine)


def _histories(engine):
    """Contact histories of all particles, ordered by the ids of owner and partner."""
    particles = joined_particles(engine.on_each_rank(_own_particles)).by_id()
    found = particles.histories
    pairs = np.stack([particles.arrays["id"][found.owner], found.partner])
    return {"history.pairs": pairs} | {f"history.{slot}": values for slot, values in found.values.items()}


def _own_particles(engine, _rank):
    """Particles and contact histories of one rank."""
    return engine.saved_particles()
