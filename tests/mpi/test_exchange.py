"""What ranks exchange: 1 to 4 ranks, arrays that grow. `bits` compares the features on 2 ranks."""

from pathlib import Path

import numpy as np
import pytest
import rank_launcher
from rank_launcher import alone, on_ranks

pytestmark = pytest.mark.skipif(
    bool(rank_launcher.MISSING), reason=rank_launcher.MISSING or "ranks can be started"
)

PROGRAM = Path(__file__).parent.parent / "rank_runs.py"


def state_of(folder, scene, ranks=0, kind="ranks"):
    """Arrays of the last state of a scene of `rank_runs`, without MPI or on a number of ranks; `kind` as
    there."""
    path = folder / f"{scene}_{ranks}.npz"
    options = (PROGRAM, scene, path, kind if ranks else "alone")
    done = on_ranks(ranks, *options) if ranks else alone(*options)
    assert done.returncode == 0, done.stderr[-3000:]
    with np.load(path) as arrays:
        return dict(arrays)


def assert_same_bits(expected, found):
    """Assert that a run on ranks has the arrays of one without MPI.

    Returns the numbers of particles that each rank has sent to each rank after the first rebuild, and the
    number of reallocations.
    """
    migrations = found.pop("migrations")
    growths = found.pop("growths")
    assert found.keys() == expected.keys()
    different = [name for name, values in expected.items() if not np.array_equal(values, found[name])]
    assert not different
    return migrations, growths


@pytest.mark.slow
def test_any_number_of_ranks_gives_the_same_bits_over_3000_steps(tmp_path):
    expected = state_of(tmp_path, "long")
    assert expected["steps"] == 3000
    assert expected["rebuilds"] >= 10
    assert len(expected["history.pairs"].T) > 10
    for ranks in (1, 2, 3, 4):
        migrations, _ = assert_same_bits(expected, state_of(tmp_path, "long", ranks))
        if ranks > 1:
            assert (migrations.sum(axis=0) > 0).all(), "each rank receives particles"
            assert (migrations.sum(axis=1) > 0).all(), "each rank sends particles"


@pytest.mark.slow
def test_arrays_grow_on_all_ranks(tmp_path):
    _, growths = assert_same_bits(
        state_of(tmp_path, "long_lists"), state_of(tmp_path, "long_lists", 3, "small")
    )
    assert growths >= 2, "for particles and for neighbor lists"
