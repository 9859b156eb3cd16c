"""A new particle takes no contacts of a deleted one."""

import numpy as np
from scene_builders import build_scene, particle_group, prepared_simulation

from granflow.engine.host import HistoryTable, append_particles, copy_to_host


def test_inserted_particle_has_no_contacts_of_a_deleted_one(taichi_f64):
    """A new particle that takes the array entry of a deleted one finds its neighbor list; it has no
    contacts."""
    positions = 0.0098 * np.argwhere(np.ones((2, 2, 2)))
    simulation = prepared_simulation(
        build_scene({"balls": particle_group(positions)}, numerics={"chunk_size": 1})
    )
    state = simulation.engine.state
    histories = HistoryTable(state)
    assert histories.read(np.arange(8), 8).count.tolist() == [3] * 8
    new = {
        name: values[-1:]
        for name, values in copy_to_host(state, ("id", "position", "radius", "mass")).items()
    }
    state.count = 7
    append_particles(state, new)
    assert histories.listed(np.arange(8), 8).count[-1] == 0
    simulation.free()
