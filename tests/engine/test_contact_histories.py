"""Contact histories of selected particles, from neighbor lists with each pair of a chunk in one list only."""

import numpy as np
from scene_builders import build_scene, particle_group, prepared_simulation

from granflow.engine.host import (
    HistoryTable,
    ListedHistories,
    append_particles,
    copy_to_host,
    joined_histories,
)

WALL = -2


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


def listed():
    """Particles 7 and 3 in one chunk, 9 in another; contacts 7-3, 3-9, and 9 with a wall."""
    return ListedHistories(
        count=np.array([1, 1, 2]),
        partner=np.array([3, 9, 3, WALL], np.int32),
        values={"slot": np.array([[1.0, 10.0], [2.0, 20.0], [-2.0, 20.0], [4.0, 40.0]])},
        ids=np.array([7, 3, 9], np.int32),
        once=np.array([0]),
        other=np.array([1]),
        vectors={"slot": [True, False]},
    )


def test_histories_of_selected_particles_contain_both_sides_of_a_pair_in_one_list():
    found = listed().of(np.arange(3))
    assert found.count.tolist() == [1, 2, 2]
    assert found.partner.tolist() == [3, 9, 7, 3, WALL]
    # The first component is one of a vector, which has the other sign for the partner.
    slots = [[1.0, 10.0], [2.0, 20.0], [-1.0, 10.0], [-2.0, 20.0], [4.0, 40.0]]
    assert found.values["slot"].tolist() == slots
    rows = np.array([2, 1])
    selected, expected = listed().of(rows), found.of(rows)
    assert selected.count.tolist() == expected.count.tolist() == [2, 2]
    assert selected.partner.tolist() == expected.partner.tolist()
    assert selected.values["slot"].tolist() == expected.values["slot"].tolist()
    none = listed().of(np.zeros(0, np.int64))
    assert none.count.tolist() == none.partner.tolist() == []
    joined = joined_histories([none, listed().of(np.array([0]))])
    assert joined.partner.tolist() == [3]
    assert joined.values["slot"].tolist() == [[1.0, 10.0]]
