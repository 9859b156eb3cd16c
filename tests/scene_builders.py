"""Builders of small scenes for tests, and runs that return their snapshots."""

from itertools import combinations_with_replacement

import numpy as np

from granflow.load import Scene
from granflow.observers.observer import on_interval
from granflow.scene.blocks.scene import SceneInput
from granflow.simulation import Simulation

SOFT = {"young_modulus": 1e8, "poisson_ratio": 0.25, "density": 2500.0}
"""Material with a time step of some microseconds at an impact velocity of 1 m/s."""


def particle_group(positions, diameter=0.01, material="glass", **more):
    """A group of particles at positions (n, 3) [m]; `velocity` and `angular_velocity` as in scenes, or as
    arrays."""
    positions = np.atleast_2d(np.asarray(positions, dtype=float))
    given = {
        name: np.asarray(value, dtype=float).tolist()
        for name, value in (more | {"diameter": diameter}).items()
    }
    insertion = {"kind": "positions", "positions": positions.tolist()}
    return {"material": material, "count": len(positions), "insert": insertion} | given


def moving_lattice(counts, largest, speed):
    """Particles on a lattice of 6.5 mm with random diameters and velocities.

    counts:   particles along x, y and z
    largest:  largest diameter [m]; the smallest is 4 mm
    speed:    standard deviation of each velocity component [m/s]
    """
    rng = np.random.default_rng(4)
    positions = 0.0065 * (np.argwhere(np.ones(counts)) + 0.75)
    diameters = rng.uniform(0.004, largest, len(positions))
    return particle_group(positions, diameters, velocity=rng.normal(0.0, speed, positions.shape))


def build_scene(groups, walls=None, pair=None, **parts):
    """A scene of groups and walls, without gravity; `pair` applies to all pairs of materials that `pairs`
    lacks.

    `rolling`, `normal`, `domain`, `run`, `numerics`, `materials` and other keys replace the defaults given
    here.
    """
    walls = walls or {}
    used = dict.fromkeys(part["material"] for part in [*groups.values(), *walls.values()])
    rolling = parts.pop("rolling", "none")
    usual = {"restitution": 0.8, "friction": 0.0} | ({} if rolling == "none" else {"rolling_friction": 0.0})
    pairs = {f"{a}-{b}": usual | (pair or {}) for a, b in combinations_with_replacement(used, 2)}
    scene = {
        "title": "Trial",
        "gravity": [0.0, 0.0, 0.0],
        "materials": dict.fromkeys(used, SOFT) | parts.pop("materials", {}),
        "pairs": pairs | parts.pop("pairs", {}),
        "contact": {"normal": parts.pop("normal", "zhou"), "tangential": "mindlin", "rolling": rolling},
        "walls": walls,
        "particles": groups,
        "domain": {"min": [-1.0] * 3, "max": [1.0] * 3, "on_exit": "error"},
        "run": {"duration": 1.0},
        "output": {"interval": parts.get("run", {}).get("duration") or 1.0},
    }
    return Scene.of(SceneInput.model_validate(scene | parts))


DASHPOTS = {
    "contact": {
        "normal": "hertz",
        "tangential": {"law": "mindlin", "increments": "displacement", "unloading": "kept", "damping": 1.0},
        "rolling": "sds",
        "twisting": {"law": "marshall", "damping": 1.0},
    },
    "pair": {"restitution": 0.5, "friction": 0.4, "rolling_friction": 0.1, "rolling_damping": 0.3},
    "damping": {"cundall": 0.1, "drag": 5.0},
}
"""Parts of a scene: models with dashpots in all slots, and damping of all motion."""

SPRINGS = {
    "contact": {
        "normal": "zhou",
        "tangential": {"law": "linear_history", "stiffness": 1e4},
        "rolling": "viscous",
        "twisting": {"law": "torsion_spring", "stiffness": 1e-4, "damping": 1e-9},
    },
    "pair": {"restitution": 0.0, "friction": 0.4, "rolling_dissipation": 1e-5, "twisting_friction": 1e-4},
}
"""Parts of a scene: inelastic contacts (restitution 0) and springs of given stiffness."""


LIQUID = {
    "contact": {
        "normal": "hertz",
        "tangential": "mindlin",
        "rolling": "none",
        "cohesion": {"law": "capillary_transfer", "max_bridge_volume": 2e-11},
    },
    "pair": {"restitution": 0.5, "friction": 0.4, "surface_tension": 0.01, "contact_angle": 0.3},
}
"""Parts of a scene with liquid films; all groups require a `liquid_content`."""


def plane(point, normal, material="glass", **more):
    """A wall that fills a half space."""
    return {"shape": "plane", "point": list(point), "normal": list(normal), "material": material, **more}


def box(size, material="glass"):
    """Six walls that enclose the cube from 0 to `size` [m]."""
    walls = {}
    for axis, name in enumerate("xyz"):
        unit = np.eye(3)[axis]
        walls[f"low_{name}"] = plane([0.0] * 3, unit.tolist(), material)
        walls[f"high_{name}"] = plane((size * unit).tolist(), (-unit).tolist(), material)
    return walls


def vibrating_box(size):
    """The walls of `box`, whose floor vibrates with 1 mm at 60 Hz."""
    walls = box(size)
    walls["low_z"] |= {
        "motion": {"kind": "vibration", "direction": [0, 0, 1], "amplitude": 1e-3, "frequency": 60.0}
    }
    return walls


def run_to_end(scene, until=None, **options):
    """The last snapshot of a run, and the simulation after its device memory is freed."""
    simulation = Simulation(scene, **options)
    simulation.run(until)
    last = simulation.snapshot()
    simulation.free()
    return last, simulation


def run_and_sample(scene, interval, until=None, contacts=False, **options):
    """The snapshots of a run at an interval [s]."""
    snapshots = []
    wants = ("particles", "walls", "totals", "contacts") if contacts else ("particles", "walls", "totals")
    simulation = Simulation(scene, observers=[on_interval(interval, snapshots.append, wants)], **options)
    simulation.run(until)
    simulation.free()
    return snapshots


def column(snapshots, name):
    """One particle quantity of all snapshots: array (times, particles, ...)."""
    return np.array([snapshot.particles[name] for snapshot in snapshots])


def times(snapshots):
    """Times [s] of snapshots."""
    return np.array([snapshot.time for snapshot in snapshots])


def neighbors_of(engine):
    """For each neighbor-list entry: id of the owner, id of the partner (-1 - wall), whether both share a
    chunk."""
    state = engine.state
    begin, end = (f.to_numpy()[: state.count] for f in (state.neighbors.list_begin, state.neighbors.list_end))
    partner = state.neighbors.partner.to_numpy()
    ids = state.particles.id.to_numpy()
    found = []
    for i in range(state.count):
        for j in partner[begin[i] : end[i]]:
            same = j >= 0 and i // state.plan.chunk_size == j // state.plan.chunk_size
            found.append((ids[i], ids[j] if j >= 0 else j, same))
    return found


def assert_lists_hold(simulation, pairs):
    """The neighbor lists contain these pairs (smaller id, larger id) of particles, and no others.

    A pair within a chunk is in one list, a pair across two chunks in both.
    """
    entries = [entry for entry in neighbors_of(simulation.engine) if entry[1] >= 0]
    within = [tuple(sorted(entry[:2])) for entry in entries if entry[2]]
    across = [entry[:2] for entry in entries if not entry[2]]
    assert len(within) == len(set(within)) and len(across) == len(set(across))
    assert {(j, i) for i, j in across} == set(across)
    assert not set(within) & set(across)
    assert set(within) | {tuple(sorted(pair)) for pair in across} == {tuple(pair) for pair in pairs}


def prepared_simulation(scene, step=0):
    """A simulation with a built neighbor list, at the time of step number `step`."""
    simulation = Simulation(scene)
    simulation.engine.state.clock.step_count = step
    simulation.engine.set_walls([True] * len(scene.walls), [()] * len(scene.walls))
    simulation.engine.refresh()
    return simulation


def few_spheres(groups, walls=None, pair=None, **parts):
    """A scene of a few spheres whose compiled kernels are those of all such scenes with the same models.

    They have an energy budget, a plane wall, and far from all others a fixed particle of a second material, as
    the last one; its pairs have friction and damping, and the restitution 0 if the model permits it.
    """
    first = next(iter(groups.values()))
    diameter = float(np.ravel(first["diameter"])[0])
    fixed = particle_group([[0.9, 0.9, 0.9]], diameter, "fixed") | {"fixed": True}
    materials = parts.pop("materials", {})
    materials = materials | {"fixed": materials.get(first["material"], SOFT)}
    contact = {"normal": "zhou", "rolling": "none"} | parts | parts.get("contact", {})
    own = {"restitution": 0.0 if contact["normal"] == "zhou" else 0.5, "friction": 0.5}
    own |= {} if contact["rolling"] == "none" else {"rolling_friction": 0.1}
    pairs = {"fixed-fixed": own} | parts.pop("pairs", {})
    parts = {"output": {"interval": 1.0, "energy_budget": True}} | parts
    walls = walls or {"floor": plane([0.0, 0.0, -0.9], [0.0, 0.0, 1.0])}
    if any(wall.get("motion") for wall in walls.values()):
        walls = walls | {
            "side": plane([-0.95, 0.0, 0.0], [1.0, 0.0, 0.0])
        }  # all of them may touch another wall
    return build_scene(groups | {"fixed": fixed}, walls, pair, materials=materials, pairs=pairs, **parts)


def colliding(distance, diameters, velocity, axis=(1.0, 0.0, 0.0), **more):
    """Two spheres about the origin, centers `distance` [m] apart along the axis, that approach with half of the
    relative velocity [m/s] each."""
    directions = np.array([[-0.5], [0.5]]) * np.asarray(axis)
    return particle_group(distance * directions, diameters, velocity=-velocity * directions, **more)
