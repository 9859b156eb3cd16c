"""Checkpoints with files of several ranks, written in one process: read without MPI, refused if a file is
invalid."""

import numpy as np
import pytest
from resume.runs import balls
from scene_builders import particle_group

import granflow as gf
from granflow.engine.engine import host_particles
from granflow.io.checkpoint import (
    CheckpointError,
    RankFileWriter,
    newest_checkpoint,
    read_checkpoint,
    remove_after,
    write_checkpoint,
)
from granflow.parallel.rank_engine import share_of_checkpoint
from granflow.runs.run_directory import CheckpointWriter
from granflow.scene.blocks.output import Checkpoints

STEPS = 200
COUNT = 12


def scene():
    """A lattice of particles on a floor, which slide and collide."""
    positions = 0.0099 * np.argwhere(np.ones((4, 3, 1))) + [0.0, 0.0, 0.004999]
    velocity = np.random.default_rng(1).normal(0.0, 0.1, positions.shape)
    group = particle_group(positions, velocity=velocity)
    return balls(
        groups={"balls": group}, run={"duration": STEPS * 1e-5, "time_step": 1e-5, "velocity_max": 1.0}
    )


@pytest.fixture(scope="module")
def half(tmp_path_factory, taichi_f64):
    """Checkpoint at half of the steps, and positions at the end."""
    out = tmp_path_factory.mktemp("run")
    with gf.Simulation(scene(), out=out, threads=2) as simulation:
        simulation.step(STEPS // 2)
        simulation.save()
        checkpoint = newest_checkpoint(out)[0]
        simulation.run()
        return checkpoint, simulation.snapshot().particles["position"]


def rows_of(saved, rows):
    """Particles and contacts of the particles with these indices."""
    contacts = saved["contacts"]
    end = np.cumsum(contacts["count"])
    entries = np.concatenate(
        [np.arange(end[k] - contacts["count"][k], end[k]) for k in rows] + [np.zeros(0, int)]
    )
    parts = {name: values[entries] for name, values in contacts.items() if name != "count"}
    particles = {name: values[rows] for name, values in saved["particles"].items()}
    return {"particles": particles, "contacts": parts | {"count": contacts["count"][rows]}}


def distributed(checkpoint, directory, step, rank_count=3):
    """Write the checkpoint as ranks do that have every third particle; return the path of the root's file."""
    saved = read_checkpoint(checkpoint.path).saved
    engine = saved["engine"]
    writer = RankFileWriter.of(directory, step)
    shares = [
        rows_of(engine, np.arange(rank, engine["particle_count"], rank_count)) for rank in range(rank_count)
    ]
    entries = [writer.write(k, len(each["particles"]["id"]), each) for k, each in enumerate(shares) if k]
    return write_checkpoint(
        directory, checkpoint.scene, checkpoint.time, step,
        saved | {"rank_files": entries, "engine": engine | shares[0]},
    )  # fmt: skip


def test_a_run_continues_from_the_files_of_ranks_with_the_same_bits(half, tmp_path):
    checkpoint, expected = half
    assert len(checkpoint.saved["engine"]["contacts"]["partner"]) >= 5
    path = distributed(checkpoint, tmp_path, 150)
    assert len(read_checkpoint(path, "root").saved["engine"]["particles"]["id"]) == COUNT // 3
    with gf.Simulation(scene(), out=tmp_path, threads=2, resume=path) as simulation:
        simulation.run()
        np.testing.assert_array_equal(simulation.snapshot().particles["position"], expected)


def truncated(path):
    path.write_bytes(path.read_bytes()[:-20])


def with_a_flipped_bit(path):
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)


@pytest.mark.parametrize(
    ("damage", "reason"),
    [
        (lambda path: path.unlink(), "needs the file rank_.* of a rank, which cannot be read"),
        (truncated, "needs the file rank_.* of a rank, which is another one or truncated"),
        (with_a_flipped_bit, "rank_.* is damaged: it is truncated, or its bytes have changed"),
    ],
)
def test_the_previous_checkpoint_replaces_one_with_an_invalid_file(half, tmp_path, damage, reason):
    before, newest = (distributed(half[0], tmp_path, step) for step in (140, 150))
    damage(max(tmp_path.glob("rank_*")))
    found, skipped = newest_checkpoint(tmp_path)
    assert found.path == before
    with pytest.raises(CheckpointError, match=reason) as error:
        read_checkpoint(newest)
    assert skipped == [str(error.value)]
    assert str(error.value).endswith("Remove it to use the checkpoint before it.")


def test_files_without_a_checkpoint_are_ignored_and_removed(half, tmp_path):
    before, newest = (distributed(half[0], tmp_path, step) for step in (140, 150))
    newest.unlink()
    found, skipped = newest_checkpoint(tmp_path)
    assert (found.path, skipped) == (before, [])
    remove_after(tmp_path, before)
    assert {path.name[:17] for path in tmp_path.glob("rank_*")} == {"rank_000000000140"}


def test_a_checkpoint_of_the_same_step_replaces_the_files_of_ranks(half, tmp_path):
    path = distributed(half[0], tmp_path, 150)
    earlier = {*tmp_path.glob("rank_*")}
    writer = CheckpointWriter(tmp_path, Checkpoints(), half[0].scene)
    entries = []

    def state(files):
        assert read_checkpoint(path).rank_files == (), "the earlier checkpoint remains usable"
        share = {name: half[0].saved["engine"][name] for name in ("particles", "contacts")}
        entries.append(files.write(1, half[0].saved["engine"]["particle_count"], share))
        assert read_checkpoint(path).rank_files == ()
        return half[0].saved | {"rank_files": entries}

    writer.write(half[0].time, 150, state)
    assert {each.name for each in tmp_path.glob("rank_*")} == {entries[0]["file"]}
    assert len(earlier) == 2


class OneRank:
    """A communicator of a single rank."""

    rank, size = 0, 1

    def from_each(self, value):
        return [value]

    def exchanged(self, parts):
        return parts


def test_a_rank_reads_its_files(half, tmp_path):
    checkpoint = read_checkpoint(distributed(half[0], tmp_path, 150), "root")
    with gf.Simulation(scene(), threads=2) as simulation:
        state = simulation.engine.state
        own = host_particles(state, checkpoint.saved["engine"])
        found, problem = share_of_checkpoint(state, OneRank(), own, checkpoint.rank_files)
    assert (problem, found.count) == (None, COUNT)
