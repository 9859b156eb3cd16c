"""Crafted checkpoints with a valid checksum are rejected with one sentence before data is copied to the
device."""

import hashlib
import json
import struct
import zipfile

import numpy as np
import pytest
from scene_builders import build_scene, particle_group, plane

from granflow import Simulation
from granflow.io.checkpoint import (
    CHECKSUM_PLACEHOLDER,
    FORMAT,
    CheckpointError,
    newest_checkpoint,
    read_checkpoint,
    write_checkpoint,
)
from granflow.plan.arrays import particle_arrays, saved_arrays
from granflow.plan.build import plan_for
from granflow.runs.resume import accepted_change


def scene():
    """Eight frictional particles on a floor, in chunks of four; each is in contact with the next and with the
    floor."""
    positions = [[0.0049 * k + 0.01, 0.02, 0.00249] for k in range(8)]
    return build_scene(
        {"row": particle_group(positions, 0.005)},
        walls={"floor": plane([0, 0, 0], [0, 0, 1])},
        pair={"friction": 0.3, "restitution": 0.5},
        gravity=[0.0, 0.0, -9.81],
        numerics={"chunk_size": 4, "max_overlap": 0.3},
        domain={"min": [-0.01, -0.01, -0.01], "max": [0.08, 0.05, 0.05], "on_exit": "error"},
        run={"duration": 2e-4, "time_step": 1e-5},
        output={"interval": 1e-4, "energy_budget": True},
    )


@pytest.fixture(scope="module")
def original(tmp_path_factory, taichi_f64):
    """The last checkpoint of a run of the scene."""
    out = tmp_path_factory.mktemp("run")
    Simulation(scene(), out=out).run()
    checkpoint, _ = newest_checkpoint(out)
    return checkpoint


def crafted(original, directory, change):
    """Write the checkpoint with a changed state and a valid checksum, then read it and check it against the
    plan."""
    saved = read_checkpoint(original.path).saved
    change(saved)
    path = write_checkpoint(directory, original.scene, original.time, 20, saved)
    return accepted_change(read_checkpoint(path), plan_for(scene()), allow_changes=False)


def test_original_checkpoint_is_accepted(original, tmp_path):
    assert not crafted(original, tmp_path, lambda saved: None).differences


def put(*keys, value=None, entry=None):
    """A function that replaces the value at these keys, or one entry of the array at these keys."""

    def change(saved):
        *parents, last = keys
        for key in parents:
            saved = saved[key]
        if entry is None:
            saved[last] = value
        else:
            saved[last] = saved[last].copy()
            saved[last][entry] = value

    return change


CONTACTS, PARTICLES, ACCOUNTING = ("engine", "contacts"), ("engine", "particles"), ("engine", "accounting")
CHANGES = {
    "partner that does not exist": (
        put(*CONTACTS, "partner", entry=1, value=10**8),
        "partner names a particle that does not exist",
    ),
    "triangle that does not exist": (put(*CONTACTS, "partner", entry=0, value=-1000), "partner holds -1000"),
    "huge count": (put("engine", "particle_count", value=10**9), "particle_count is 1000000000"),
    "negative count": (put("engine", "particle_count", value=-1), "particle_count is -1"),
    "text as count": (put("engine", "particle_count", value="8"), "particle_count is '8'"),
    "number of contacts": (put(*CONTACTS, "count", entry=0, value=0), "count adds up to"),
    "negative number of contacts": (put(*CONTACTS, "count", entry=0, value=-5), "count holds -5"),
    "rebuild in the future": (
        put("engine", "clock_at_rebuild", "step_count", value=10**9),
        "step_count is 1000000000",
    ),
    "no rebuild": (put("engine", "clock_at_rebuild", value=None), "must be a mapping"),
    "infinite displacement": (put(*CONTACTS, "tangential", entry=0, value=np.inf), "tangential holds inf"),
    "duplicate id": (put(*PARTICLES, "id", entry=0, value=1), "id holds a number twice"),
    "id above the largest id": (put(*PARTICLES, "id", entry=0, value=99), "id holds 99"),
    "nan position": (put(*PARTICLES, "position", entry=0, value=np.nan), "position holds nan"),
    "position far outside the domain": (
        put(*PARTICLES, "position", entry=0, value=1e30),
        "position is farther",
    ),
    "radius": (put(*PARTICLES, "radius", entry=0, value=1.0), "radius holds 1"),
    "mass": (put(*PARTICLES, "mass", entry=0, value=1.0), "mass differs from density"),
    "reals as ids": (put(*PARTICLES, "id", value=np.zeros(8)), "must be an array .8,. of whole numbers"),
    "shape": (put(*PARTICLES, "velocity", value=np.zeros((8, 2))), "must be an array .8, 3."),
    "group": (put(*ACCOUNTING, "group", entry=0, value=5), "group holds 5"),
    "material": (put(*ACCOUNTING, "material", entry=0, value=-1), "material holds -1"),
    "accounting without an entry": (put(*ACCOUNTING, value={}), "accounting has the keys none"),
    "number of exits": (put(*ACCOUNTING, "exits", "x_min", value=-1), "x_min is -1"),
    "number as particles": (put(*PARTICLES, value=3), "must be a mapping"),
    "step count": (put("engine", "clock", "step_count", value=-5), "step_count is -5"),
    "time step": (put("engine", "clock", "time_step", value=0.0), "time_step is 0.0"),
    "time": (put("engine", "clock", "since_time", value=1e9), "gives the time"),
    "walls": (put("engine", "walls_present", value=[True] * 50), "must be a list of 1"),
    "energy_budget": (
        put("engine", "energy_budget", "losses", value=np.zeros((10**6, 5))),
        "losses is an array",
    ),
    "stage": (put("stage_progress", "stage", value="\x1b[2J"), "stage is "),
    "conditions": (put("stage_progress", "conditions", "met", value=5), "met is "),
    "stage times": (put("stage_progress", "stage_times", value={}), "stage_times has other stages"),
    "plan": (put("plan", value={}), "plan has the keys none"),
    "value of the plan": (put("plan", "time_step", value=[]), "must be a number or a text"),
    "groups of an earlier run": (put("earlier", value=[3]), "earlier/0 is 3"),
    "warnings": (put("warnings", value=[3]), "warnings/0 is 3"),
    "stability": (put("stability", "fastest", value=None), "stability/fastest is None"),
    "no engine": (put("engine", value=None), "must be a mapping"),
}


@pytest.mark.parametrize("name", CHANGES)
def test_crafted_state_is_rejected_with_its_key(original, tmp_path, name):
    change, message = CHANGES[name]
    with pytest.raises(CheckpointError, match=message) as error:
        crafted(original, tmp_path, change)
    assert str(tmp_path) in str(error.value) and "\n" not in str(error.value)
    assert "Remove it to use the checkpoint before it." in str(error.value)


def replaced_partner(saved, replacement):
    """Replaces the partner of one contact between two particles by the result of a function (owner, its
    partners)."""
    contacts = saved["engine"]["contacts"]
    owner = np.repeat(np.arange(8), contacts["count"])
    partner = contacts["partner"].copy()
    entry = np.flatnonzero(partner >= 0)[0]
    partner[entry] = replacement(owner[entry], set(partner[owner == owner[entry]].tolist()))
    contacts["partner"] = partner


def test_contact_must_be_listed_at_both_particles(original, tmp_path):
    def not_in_contact(owner, partners):
        return next(k for k in range(8) if k != owner and k not in partners)

    with pytest.raises(CheckpointError, match="lists a contact between two particles at one of them only"):
        crafted(original, tmp_path, lambda saved: replaced_partner(saved, not_in_contact))


def test_particle_is_not_in_contact_with_itself(original, tmp_path):
    with pytest.raises(CheckpointError, match="lists a particle as in contact with itself"):
        crafted(original, tmp_path, lambda saved: replaced_partner(saved, lambda owner, _: owner))


def test_observer_state_is_checked_before_the_copy_to_the_device(original, tmp_path):
    saved = read_checkpoint(original.path).saved
    name = next(name for name in saved["observers"] if name.startswith("TimeSeries"))
    saved["observers"][name]["size"] = "x"
    path = write_checkpoint(tmp_path, original.scene, original.time, 20, saved)
    with pytest.raises(CheckpointError, match=r"TimeSeries 0/size is 'x'"):
        Simulation(scene(), out=tmp_path, resume=read_checkpoint(path))
    assert {each.name for each in tmp_path.iterdir()} == {path.name}, "no other file is written"


def test_particle_arrays_of_the_plan_equal_those_of_a_checkpoint(original):
    assert set(saved_arrays(particle_arrays(plan_for(scene())))) == set(original.saved["engine"]["particles"])


def sealed(path, data):
    """Write an archive that ends with the checksum of the preceding bytes."""
    data = data[: -len(CHECKSUM_PLACEHOLDER)]
    path.write_bytes(data + hashlib.sha256(data).hexdigest().encode())


def archive(path, entries, compression=zipfile.ZIP_STORED):
    """A checkpoint file of raw entries, with a valid checksum."""
    with zipfile.ZipFile(path, "w", compression) as file:
        file.comment = CHECKSUM_PLACEHOLDER
        for name, data in entries:
            file.writestr(name, data)
    sealed(path, path.read_bytes())
    return path


HEADER = {"format": FORMAT, "engine": "0", "granflow": "0", "scene": "", "time": 0.0, "saved": {}}


def npy(shape, dtype="<f8", data=b""):
    """An npy entry with the given header and data."""
    head = f"{{'descr': {dtype!r}, 'fortran_order': False, 'shape': {shape}, }}".encode().ljust(117) + b"\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(head)) + head + data


ARCHIVES = {
    "compressed entries": ([("header.json", "0" * 10**7)], "compressed entry"),
    "a billion numbers": (
        [("header.json", json.dumps(HEADER)), ("x.npy", npy("(1000000000,)"))],
        "does not match its shape",
    ),
    "negative shape": ([("header.json", json.dumps(HEADER)), ("x.npy", npy("(-1,)"))], "unexpected type"),
    "objects": (
        [("header.json", json.dumps(HEADER)), ("x.npy", npy("(1,)", "|O", b"12345678"))],
        "unexpected type",
    ),
    "nested header": ([("header.json", "[" * 100_000)], "nested too deeply"),
    "list as header": ([("header.json", "[]")], "not a mapping"),
    "no header": ([("x.npy", npy("()"))], "header.json"),
    "empty header": ([("header.json", "{}")], "format None"),
    "no state": ([("header.json", json.dumps(HEADER | {"saved": None}))], "lacks the version"),
    "text as time": ([("header.json", json.dumps(HEADER | {"time": "x"}))], "lacks the time"),
    "array at an unknown key": (
        [("header.json", json.dumps(HEADER)), ("a/b.npy", npy("(1,)", data=b"12345678"))],
        "unexpected entry a/b",
    ),
    "another file": ([("header.json", json.dumps(HEADER)), ("evil.py", "")], "unexpected entry evil.py"),
    "npy syntax": ([("header.json", json.dumps(HEADER)), ("x.npy", npy("((((((((((("))], "not a checkpoint"),
}


@pytest.mark.parametrize("name", ARCHIVES)
def test_crafted_archive_is_rejected(tmp_path, name):
    entries, message = ARCHIVES[name]
    compression = zipfile.ZIP_DEFLATED if name == "compressed entries" else zipfile.ZIP_STORED
    path = archive(tmp_path / "checkpoint_000000000001.npz", entries, compression)
    with pytest.raises(CheckpointError, match=message):
        read_checkpoint(path)


@pytest.mark.slow
def test_random_bytes_in_a_checkpoint_raise_only_granflow_errors(original, tmp_path):
    """60 files with one to three random bytes and a valid checksum."""
    whole = original.path.read_bytes()
    random = np.random.default_rng(3)
    path = tmp_path / original.path.name
    rejected = 0
    for _ in range(60):
        data = bytearray(whole)
        for offset in random.integers(0, len(whole) - len(CHECKSUM_PLACEHOLDER), random.integers(1, 4)):
            data[offset] = random.integers(256)
        sealed(path, bytes(data))
        try:
            accepted_change(read_checkpoint(path), plan_for(scene()), allow_changes=False)
        except Exception as error:
            rejected += 1
            from granflow.errors import GranflowError

            assert isinstance(error, GranflowError), repr(error)
    assert rejected > 15
