"""A scene with all state that a checkpoint must restore, and digests of files and states to compare two
runs."""

import hashlib
import json
import shutil

import numpy as np
from scene_builders import box, build_scene, particle_group, plane

from granflow.io.checkpoint import newest_checkpoint, read_checkpoint
from granflow.simulation import Simulation

MOVING = {"kind": "vibration", "direction": [0, 0, 1], "amplitude": 1e-3, "frequency": 60.0}


def complex_scene(duration=0.02, of_groups=None, **parts):
    """Rain into a vibrated box above a falling lattice; two materials, three stages, chunks of 32 particles.

    Friction, rolling springs, the energy budget, collision energies, a flow meter, fields and metrics are
    enabled. A row of fixed particles lies in the gate, which is removed after the first stage; an inlet
    inserts particles through a face. The floor and one side wall are removed after the second stage;
    particles are deleted at `domain.max` before they reach that wall.

    of_groups:  further keys of all groups
    """
    walls = {name: wall for name, wall in box(0.06).items() if name != "low_z"}
    walls["floor"] = plane([0, 0, 0.0195], [0, 0, 1], "steel", motion=[MOVING], stages=["fill", "shake"])
    walls["high_x"]["stages"] = ["fill", "shake"]
    walls["gate"] = plane([0, 0, 0.02], [0, 0, 1], "glass", stages=["fill"])
    rng = np.random.default_rng(4)
    positions = 0.0065 * (np.argwhere(np.ones((7, 7, 3))) + 0.75) + [0.011, 0.0, 0.021]
    lattice = particle_group(
        positions,
        rng.uniform(0.004, 0.006, len(positions)),
        velocity=rng.normal([0.8, 0.0, -0.6], 0.5, positions.shape),
    )
    region = {"box": {"min": [0.005, 0.005, 0.045], "max": [0.055, 0.055, 0.059]}}
    rain = {
        "material": "steel", "count": 60, "diameter": 0.005,
        "insert": {"kind": "rain", "region": region, "rate": 8000.0},
    }  # fmt: skip
    row = particle_group(0.006 * np.argwhere(np.ones((9, 1, 1))) + [0.004, 0.03, 0.02], 0.005, "steel") | {
        "fixed": True
    }
    classes = [{"diameter": 0.003, "fraction": 2}, {"diameter": 0.004, "fraction": 1}]
    inlet = {
        "material": "glass", "velocity": [1.0, 0.0, 0.0],
        "diameter": {"distribution": "classes", "by": "mass", "classes": classes},
        "insert": {
            "kind": "inlet", "mass_flow": 0.08, "stages": ["shake"],
            "face": {"disc": {"center": [0.001, 0.05, 0.052], "normal": [1, 0, 0], "radius": 0.006}},
        },
    }  # fmt: skip
    stage_duration = duration / 3.0
    defaults = {
        "walls": walls, "rolling": "epsd", "normal": "zhou",
        "pair": {"friction": 0.4, "rolling_friction": 0.1, "restitution": 0.4},
        "gravity": [0.0, 0.0, -9.81], "numerics": {"chunk_size": 32, "max_overlap": 0.3},
        "run": {"velocity_max": 2.0, "time_step": 4e-6},
        "stages": [
            {"name": "fill", "duration": stage_duration}, {"name": "shake", "duration": stage_duration},
            {"name": "out", "duration": stage_duration},
        ],
        "domain": {"min": [-0.01, -0.01, -0.03], "max": [0.0576, 0.07, 0.07], "on_exit": "delete"},
        "output": {
            "interval": duration / 7.0, "timeseries_interval": duration / 31.0, "energy_budget": True, "contacts": True,
            "wall_forces": True,
            "checkpoint": {"interval": duration / 11.0, "keep": 100},
            "flow_meters": {
                "gate": {"point": [0.03, 0.03, 0.03], "normal": [0, 0, -1]},
                "outlet": {"point": [0.03, 0.03, 0.02], "normal": [0, 0, -1], "passages": True},
            },
            "residence_time": {"from": "gate", "to": "outlet"},
            "metrics": {
                "mix": {"kind": "lacey", "cell": 0.02, "at_least": 4, "groups": ["rain"]}, "web": {"kind": "fabric"},
            },
            "fields": {"bed": {"cell": 0.01, "stages": ["shake", "out"]}},
            "collision_energies": {"min": 1e-9, "max": 1e-2, "classes": 14},
        },
    }  # fmt: skip
    groups = {"lattice": lattice, "rain": rain, "row": row, "inlet": inlet}
    return build_scene(
        {name: group | (of_groups or {}) for name, group in groups.items()}, **(defaults | parts)
    )


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


def last_state(out):
    """Content of the newest checkpoint of a directory, as returned by `state_of`."""
    checkpoint, skipped = newest_checkpoint(out)
    assert checkpoint is not None and not skipped
    return state_of(checkpoint.path)


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
