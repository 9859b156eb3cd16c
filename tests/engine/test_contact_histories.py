"""Contact histories of selected particles, from neighbor lists with each pair of a chunk in one list only."""

import numpy as np

from granflow.engine.contact_histories import ListedHistories, joined_histories

WALL = -2


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


def test_both_sides_of_a_pair_in_one_list():
    found = listed().of(np.arange(3))
    assert found.count.tolist() == [1, 2, 2]
    assert found.partner.tolist() == [3, 9, 7, 3, WALL]
    # The first component is one of a vector, which has the other sign for the partner.
    assert found.values["slot"].tolist() == [[1.0, 10.0], [2.0, 20.0], [-1.0, 10.0], [-2.0, 20.0], [4.0, 40.0]]


def test_selected_particles_have_the_same_histories_as_among_all():
    rows = np.array([2, 1])
    found, expected = listed().of(rows), listed().of(np.arange(3)).of(rows)
    assert found.count.tolist() == expected.count.tolist() == [2, 2]
    assert found.partner.tolist() == expected.partner.tolist()
    assert found.values["slot"].tolist() == expected.values["slot"].tolist()


def test_no_particle_has_no_history():
    none = listed().of(np.zeros(0, np.int64))
    assert none.count.tolist() == none.partner.tolist() == []
    joined = joined_histories([none, listed().of(np.array([0]))])
    assert joined.partner.tolist() == [3]
    assert joined.values["slot"].tolist() == [[1.0, 10.0]]
