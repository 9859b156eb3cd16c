"""Small scenes to interrupt and resume, and digests of files and states to compare two runs."""

import hashlib
import json
import shutil

import numpy as np
from scene_builders import build_scene, particle_group, plane

from granflow.io.checkpoint import read_checkpoint
from granflow.simulation import Simulation


def delete(folder):
    """Delete a folder in which another thread may just write a frame."""
    while folder.exists():
        shutil.rmtree(folder, ignore_errors=True)


def balls(positions=None, lid_speed=0.1, gate_until=1.0, friction=0.3, groups=None, **parts):
    """Four balls that fall on a gate, on which they are after 18 ms; a lid rises far above them.

    All scenes of this function have one compiled structure: tests that need any small run use it.
    """
    positions = positions or [[0.02 * (k % 2), 0.02 * (k // 2), 0.0065 + 1e-4 * k] for k in range(4)]
    groups = groups or {"balls": particle_group(positions, velocity=[[0.1, 0.0, 0.0]] * len(positions))}
    rising = [{"kind": "translation", "velocity": [0, 0, lid_speed], "start": 0.0}]
    walls = {
        "gate": plane([0, 0, 0], [0, 0, 1], vanishes_at=gate_until),
        "lid": plane([0, 0, 0.5], [0, 0, -1], motion=rising),
    }
    defaults = {
        "pair": {"friction": friction, "restitution": 0.5}, "gravity": [0.0, 0.0, -9.81],
        "domain": {"min": [-1.0] * 3, "max": [1.0] * 3, "on_exit": "delete"},
        "run": {"duration": 0.02, "time_step": 1e-5, "velocity_max": 1.0},
        "numerics": {"chunk_size": 4, "max_overlap": 0.3},
        "output": {"interval": 2e-3, "timeseries_interval": 5e-4, "energy_budget": True, "wall_forces": True},
    }  # fmt: skip
    return build_scene(groups, walls, **(defaults | parts))


def files_of(out):
    """Digest of each result file by name, except files with wall-clock times; of result.json the physical
    results."""
    found = {}
    for path in out.iterdir():
        if path.suffix in (".vtu", ".pvd", ".csv"):
            found[path.name] = hashlib.sha256(path.read_bytes()).hexdigest()
    result = out / "result.json"
    if result.exists():
        content = json.loads(result.read_text())
        found |= {part: content[part] for part in ("totals", "flow_meters", "wall_forces")}
    return found


def state_of(path):
    """Content of a checkpoint without wall-clock times and counters that depend on them; arrays as
    digests."""
    saved = read_checkpoint(path).saved
    del saved["wall_clock"]
    for name in ("neighbor_list", "advance", "sampled_forces", "sampled_integration", "particle_steps"):
        del saved["engine"]["clocks"][name]
    return _digested(saved)


def _digested(saved):
    if isinstance(saved, dict):
        return {name: _digested(each) for name, each in saved.items()}
    if isinstance(saved, np.ndarray):
        saved = saved + np.zeros((), saved.dtype)  # turns -0 into 0: history of an open contact may be either
        return str(saved.dtype), saved.shape, hashlib.sha256(saved.tobytes()).hexdigest()
    return saved


def states_of(out):
    """Content of all checkpoints of a directory by file name, as returned by `state_of`."""
    return {path.name: state_of(path) for path in out.glob("checkpoint_*.npz")}


def run_to_end(scene, out, threads=2):
    """Runs the scene to its end and returns the paths of its checkpoints, at least eleven, in order of
    time."""
    simulation = Simulation(scene, out=out, threads=threads)
    simulation.run()
    simulation.free()
    return sorted(out.glob("checkpoint_*.npz"))


def resume_copy(scene, whole, out, path, threads=2):
    """Resumes a finished run from one of its checkpoints, in a copy of its directory."""
    shutil.copytree(whole, out)
    simulation = Simulation(scene, out=out, threads=threads, resume=read_checkpoint(out / path.name))
    simulation.run()
    simulation.free()
