"""Saves and restores the device state that determines how a run continues, bit for bit.

The state consists of the particles with velocities half a step behind, the histories of their contacts, and sums; all
in the order of the ids, so that it does not depend on threads, chunks or MPI ranks. Saving rebuilds and evaluates
nothing, so that a checkpoint does not influence the run. Restoring repeats the last rebuild of the neighbor lists, with
the positions of that time: the next one is then due at the same step as in the run that continues without interruption.
"""

from collections.abc import Sequence
from typing import Any

from granflow.engine.contact_histories import Histories
from granflow.engine.engine import Engine
from granflow.engine.host_copy import saved_particle_table
from granflow.engine.host_particles import HostParticles
from granflow.engine.saved_sums import refuse_other_names
from granflow.geometry.motion import Motion

SavedState = dict[str, Any]
"""Numbers, texts and numpy arrays in nested dictionaries."""

CLOCKS = {
    "neighbor_list": float,
    "advance": float,
    "sampled_forces": float,
    "sampled_integration": float,
    "rebuild_count": int,
    "step_count": int,
    "particle_steps": int,
}
"""Attributes of Timing that a checkpoint contains, with their types."""


def saved_state(engine: Engine) -> SavedState:
    """The state of the engine that determines how it continues, without the data of the scene.

    Nested dictionaries of numbers and numpy arrays; particle arrays (n,) or (n, 3) in the order of the ids; contacts as
    `Histories`, with histories by the slots of the contact models.
    """
    state, particles = engine.state, engine.saved_particles().by_id()
    contacts = particles.histories
    return {
        "clock": state.clock.state_dict(),
        "clock_at_rebuild": None if engine.is_changed else engine.stepper.clock_at_rebuild,
        "steps_since_update": engine.steps_since_update,
        "particle_count": len(particles.arrays["id"]),
        "walls_present": [bool(state.walls.present[index]) for index in range(len(engine.plan.walls))],
        "accounting": engine.accounting.state_dict(),
        "clocks": {name: getattr(engine.timing, name) for name in CLOCKS},
        "particles": particles.arrays,
        "contacts": {"count": contacts.count, "partner": contacts.partner, **contacts.values},
        **engine.saved_sums(),
    }


def restore_state(engine: Engine, saved: SavedState, motions: Sequence[Sequence[Motion]]) -> None:
    """Restore a state into a new engine.

    saved:    result of `saved_state`. Without `clock_at_rebuild`, a rebuild must follow after a change
    motions:  motions of each wall
    Raises:   GranflowError if the scene needs other arrays than the saved state has, or has other force-controlled
              motions
    """
    table, history = saved_particle_table(engine.state), engine.plan.history
    refuse_other_names(saved["particles"], table.fields)
    contacts = dict(saved["contacts"])
    count, partner = contacts.pop("count"), contacts.pop("partner")
    refuse_other_names(contacts, history if len(partner) or contacts else {})
    particles = HostParticles(saved["particles"], Histories(count, partner, contacts))
    rest = {name: value for name, value in saved.items() if name not in ("particles", "contacts")}
    engine.restore(rest, particles, motions)
    for name in CLOCKS:
        setattr(engine.timing, name, saved["clocks"][name])
