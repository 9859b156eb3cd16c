"""One scene on several MPI ranks: the same bits as without MPI."""

from pathlib import Path

import numpy as np
import pytest
import rank_launcher
from rank_launcher import alone, on_ranks
from rank_scenes import FEATURES, LAWS
from resume.runs import complex_scene, files_of

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

    Returns the numbers of particles that each rank has sent to each rank after the first rebuild, the number
    of reallocations, and the number of particles of each rank at the end.
    """
    migrations = found.pop("migrations")
    growths = found.pop("growths")
    owned = found.pop("owned")
    assert found.keys() == expected.keys()
    different = [name for name, values in expected.items() if not np.array_equal(values, found[name])]
    assert not different
    return migrations, growths, owned


def test_two_ranks_give_the_bits_of_a_run_without_mpi(tmp_path):
    expected = state_of(tmp_path, "short")
    found = state_of(tmp_path, "short", 2)
    migrations, _, _ = assert_same_bits(expected, found)
    assert expected["rebuilds"] >= 5
    assert len(expected["history.pairs"].T) > 40
    assert (migrations.sum(axis=0) > 0).all()


def test_sums_and_properties_of_a_program_have_the_bits_of_a_run_without_mpi(tmp_path):
    expected = state_of(tmp_path, "conducting")
    assert_same_bits(expected, state_of(tmp_path, "conducting", 2))
    assert any(name.endswith("temperature") for name in expected)


@pytest.mark.slow
@pytest.mark.parametrize("scene", LAWS)
def test_any_number_of_ranks_gives_the_same_bits_over_3000_steps(tmp_path, scene):
    expected = state_of(tmp_path, scene)
    assert expected["steps"] == 3000
    assert expected["rebuilds"] >= 10
    assert len(expected["history.pairs"].T) > 10
    for ranks in (1, 2, 3, 4):
        migrations, _, _ = assert_same_bits(expected, state_of(tmp_path, scene, ranks))
        if ranks > 1:
            assert (migrations.sum(axis=0) > 0).all(), "each rank receives particles"
            assert (migrations.sum(axis=1) > 0).all(), "each rank sends particles"


ACTIVE = {
    "inserted": "exits.z_max",
    "outlet": "totals.outlet_count.hole",
    "belt": "totals.wall_work",
    "mesh": "totals.wall_work",
    "servo": "totals.wall_displacement.high_z",
    "free": "totals.wall_displacement.high_z",
    "sheared": "totals.boundary_work",
}
"""Totals and counts that show that the feature of a scene has had an effect."""


@pytest.mark.slow
@pytest.mark.parametrize("scene", FEATURES)
def test_features_have_the_same_bits_on_any_number_of_ranks(tmp_path, scene):
    expected = state_of(tmp_path, scene)
    assert expected[ACTIVE.get(scene, "totals.kinetic_energy")] != 0.0
    assert expected["steps"] >= 3000
    assert expected["rebuilds"] >= 10
    for ranks in (1, 2, 3, 4):
        migrations, _, _ = assert_same_bits(expected, state_of(tmp_path, scene, ranks))
        assert ranks == 1 or (migrations.sum(axis=0) > 0).all(), "each rank receives particles"


@pytest.mark.slow
def test_threads_of_ranks_do_not_change_the_bits(tmp_path):
    expected = state_of(tmp_path, "zhou")
    assert_same_bits(expected, state_of(tmp_path, "zhou", 2, "threads"))


@pytest.mark.slow
def test_ranks_with_more_contacts_have_fewer_particles(tmp_path):
    _, _, owned = assert_same_bits(state_of(tmp_path, "uneven"), state_of(tmp_path, "uneven", 2))
    assert owned.sum() == 250
    assert owned.min() < 110


@pytest.mark.slow
def test_arrays_grow_on_all_ranks(tmp_path):
    _, growths, _ = assert_same_bits(
        state_of(tmp_path, "long_lists"), state_of(tmp_path, "long_lists", 3, "small")
    )
    assert growths >= 2, "for particles and for neighbor lists"


@pytest.mark.slow
def test_files_of_all_observers_equal_those_without_mpi(tmp_path):
    """Insertion, deletion, stages, flow meters, metrics, fields, wall forces and contacts."""
    scene = complex_scene(0.01).save(tmp_path / "scene.yaml")
    for done in (
        alone("-m", "granflow", "run", scene, "--out", tmp_path / "one", "--threads", "1"),
        on_ranks(3, "-m", "granflow", "run", scene, "--mpi", "--out", tmp_path / "three"),
    ):
        assert done.returncode == 0, done.stderr[-3000:]
    expected, found = (files_of(tmp_path / name) for name in ("one", "three"))
    assert len(expected) > 20
    assert found == expected
