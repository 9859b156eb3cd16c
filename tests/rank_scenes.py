"""Scenes that `rank_runs` runs alone and on MPI ranks, by name."""

import os
import tempfile
from pathlib import Path

import numpy as np
from contact import test_flows
from geometry.meshes import cube, write
from scene_builders import (
    DASHPOTS,
    SOFT,
    SPRINGS,
    box,
    build_scene,
    moving_lattice,
    particle_group,
    vibrating_box,
)
from sheared_scenes import sheared_gas

from granflow import register_contact_model
from granflow.scene.registration import register_particle_equation

FILES = tempfile.TemporaryDirectory()
"""Meshes of this process."""

TIME_STEP = 2e-6
COLLISIONS = {"collision_energies": {"min": 1e-9, "max": 1e-2, "classes": 14}}


def bed(steps=300, groups=None, **changes):
    """216 particles with velocities in all directions in a box with a vibrating floor, in chunks of 32."""
    lattice = moving_lattice((6, 6, 6), largest=0.0062, speed=1.0)
    parts = {
        "normal": "zhou",
        "rolling": "epsd",
        "gravity": [0.0, 3.0, -9.81],
        "numerics": {"chunk_size": 32, "skin": 2e-4},
        "pair": {"friction": 0.4, "rolling_friction": 0.1, "restitution": 0.5},
        "output": {"interval": 1.0, "energy_budget": True, "wall_forces": True, "walls": False} | COLLISIONS,
        "run": {"duration": steps * TIME_STEP, "velocity_max": 4.0, "time_step": TIME_STEP},
        "walls": vibrating_box(0.042),
    }
    return build_scene({"lattice": lattice} | (groups or {}), **(parts | changes))


def with_models(given):
    """The bed with other contact models, in 3000 steps."""
    return bed(3000, numerics={"chunk_size": 32, "skin": 2e-4, "max_overlap": 0.4}, **given)


def with_law(normal, rolling, cohesion, options, restitution=0.5, **material):
    """The bed with a normal, a rolling and a cohesion model; `options` are the values that these models
    require."""
    contact = {"normal": normal, "tangential": "mindlin", "rolling": rolling, "cohesion": cohesion}
    pair = {"friction": 0.4, "rolling_friction": 0.1, "restitution": restitution} | options
    return with_models({"contact": contact, "pair": pair, "materials": {"glass": SOFT | material}})


def inserted():
    """The bed with rain, a wall that appears, and a particle that leaves the domain."""
    region = {"box": {"min": [0.005, 0.005, 0.042], "max": [0.037, 0.037, 0.06]}}
    rain = {"material": "glass", "count": 40, "diameter": 0.004,
            "insert": {"kind": "rain", "region": region, "rate": 20000.0}}  # fmt: skip
    walls = box(0.042)
    del walls["high_z"]
    walls["low_x"]["appears_at"] = 1e-3
    domain = {"min": [-0.001, -0.01, -0.01], "max": [0.05, 0.05, 0.07], "on_exit": "delete"}
    leaving = particle_group([[0.02, 0.02, 0.066]], 0.004, velocity=[0.0, 0.0, 3.0])
    return bed(3000, {"rain": rain, "leaving": leaving}, walls=walls, domain=domain)


def periodic():
    """The bed without side walls in a box that is periodic along x and y."""
    walls = {name: wall for name, wall in box(0.042).items() if name.endswith("z")}
    domain = {
        "min": [0.0, 0.0, -0.01],
        "max": [0.042, 0.042, 0.05],
        "periodic": ["x", "y"],
        "on_exit": "error",
    }
    return bed(3000, walls=walls, domain=domain)


def wide_sizes():
    """The bed with a particle of five times the diameter above it: size classes with separate grids."""
    walls = box(0.042)
    del walls["high_z"]
    large = particle_group([[0.02, 0.02, 0.06]], 0.03, velocity=[0.0, 0.0, -2.0])
    return bed(3000, {"large": large}, walls=walls)


def in_precision(precision):
    """The bed in another precision, in 3000 steps."""
    duration = 3000 * TIME_STEP
    return bed(
        run={"duration": duration, "velocity_max": 4.0, "time_step": TIME_STEP, "precision": precision},
        numerics={"chunk_size": 32, "max_overlap": 0.3},
    )


def with_outlet():
    """The bed above a hole in the floor, with an outlet behind it."""
    walls = box(0.042)
    del walls["low_z"]
    outlets = {"hole": {"box": {"min": [-0.01, -0.01, -0.02], "max": [0.03, 0.05, 0.002]}}}
    domain = {"min": [-0.01, -0.01, -0.03], "max": [0.05, 0.05, 0.05], "on_exit": "delete"}
    return bed(3000, walls=walls, outlets=outlets, domain=domain)


def with_mesh():
    """The bed on a turning cube of triangles above the floor."""
    os.chdir(FILES.name)  # where a scene without a file looks for meshes
    points, corners = cube()
    write(Path("cube.ply"), 0.02 * points + [0.011, 0.011, -0.0185], corners)
    turning = {"kind": "rotation", "point": [0.021, 0.021, 0.0], "axis": [0, 0, 1], "angular_velocity": 40.0}
    walls = box(0.042) | {
        "cube": {"shape": "mesh", "file": "cube.ply", "material": "glass", "motion": turning}
    }
    return bed(3000, walls=walls)


def with_piston(motion):
    """The bed under a lid that a force moves."""
    walls = vibrating_box(0.042)
    walls["high_z"]["motion"] = {"direction": [0, 0, -1], **motion}
    return bed(3000, walls=walls)


def on_belt():
    """The bed between a belt that starts slowly as floor and a turning side wall with a surface velocity."""
    walls = box(0.042)
    walls["low_z"]["motion"] = {
        "kind": "surface_velocity", "velocity": [2.0, 0.5, 0.0], "ramp_duration": 1e-3, "initial_velocity": [0, 1, 0]
    }  # fmt: skip
    turning = {"kind": "rotation", "point": [0.0, 0.021, 0.021], "axis": [1, 0, 0], "angular_velocity": 50.0}
    walls["low_x"]["motion"] = [
        turning,
        {"kind": "surface_velocity", "velocity": [0.0, 1.0, 0.0], "start": 5e-4},
    ]
    table = {
        "kind": "table",
        "direction": [-1, 0, 0],
        "times": [0, 1e-3, 2e-3],
        "displacements": [0, 2e-4, 1e-4],
    }
    walls["high_x"]["motion"] = table
    return bed(3000, walls=walls)


def sheared():
    """A cloud of two sizes in a Lees-Edwards box."""
    return sheared_gas(duration=0.012, sizes=(0.002, 0.0065))


def uneven():
    """125 particles in contact beside 125 without, in a long box: ranks with equal costs have unequal
    counts."""
    dense = 0.01 * 0.99 * (np.argwhere(np.ones((5, 5, 5))) + 0.55)
    dilute = 0.01 * (2.0 * np.argwhere(np.ones((5, 5, 5))) + [6.5, 0.5, 0.5])
    walls = box(0.101)
    walls["high_x"]["point"] = [0.2, 0.0, 0.0]
    velocity = np.random.default_rng(3).uniform(-0.5, 0.5, dilute.shape).tolist()
    groups = {"dense": particle_group(dense), "dilute": particle_group(dilute, velocity=velocity)}
    return build_scene(
        groups, walls, pair={"friction": 0.4, "restitution": 0.2}, gravity=[0.0, 0.0, -9.81],
        numerics={"chunk_size": 32, "skin": 1e-4}, output={"interval": 1.0, "energy_budget": True},
        run={"duration": 500 * TIME_STEP, "velocity_max": 4.0, "time_step": TIME_STEP},
    )  # fmt: skip


def conducting():
    """Particles with a temperature: model and equation are registered as by a program."""
    for model in test_flows.MODELS:
        register_contact_model(model)
    register_particle_equation(test_flows.EQUATION)
    return test_flows.bed(8, run={"duration": 3e-3, "time_step": test_flows.TIME_STEP, "velocity_max": 1.0})


def pair(**changes):
    """Two particles that collide after 1 ms."""
    velocity = [[0.0] * 3, [0.0, 0.0, -1.0]]
    group = particle_group([[0.0, 0.0, 0.0], [0.0, 0.0, 0.011]], velocity=velocity)
    parts = {"run": {"duration": 0.02}, "output": {"interval": 1e-3}}
    return build_scene({"pair": group}, **(parts | changes))


def resumable():
    """64 particles with rain, a vibrating floor, a servo wall, a stage that ends on a quantity, and frames of
    contacts."""
    region = {"box": {"min": [0.005, 0.005, 0.032], "max": [0.023, 0.023, 0.05]}}
    rain = {"material": "glass", "count": 20, "diameter": 0.004,
            "insert": {"kind": "rain", "region": region, "rate": 20000.0}}  # fmt: skip
    walls = vibrating_box(0.028)
    del walls["high_z"]
    walls["high_x"]["motion"] = {"kind": "servo", "direction": [-1, 0, 0], "force": 1.0, "velocity_max": 0.2}
    condition = {"quantity": "contact_count", "above": 10}
    return build_scene(
        {"lattice": moving_lattice((4, 4, 4), largest=0.0062, speed=1.0), "rain": rain}, walls,
        normal="zhou", rolling="epsd", gravity=[0.0, 3.0, -9.81], numerics={"chunk_size": 16},
        pair={"friction": 0.4, "rolling_friction": 0.1, "restitution": 0.5},
        output={"interval": 5e-4, "timeseries_interval": 2e-5, "energy_budget": True, "wall_forces": True,
                "contacts": True, "checkpoint": {"interval": 7e-4}},
        stages=[{"name": "approach", "until": condition, "max_duration": 2e-3}, {"name": "mix", "duration": 3e-3}],
        run={"velocity_max": 4.0, "time_step": 2e-6},
    )  # fmt: skip


SPRING = {"stiffness": {"reference_velocity": 1.0}}
BRIDGE = {"surface_tension": 0.5, "contact_angle": 0.3, "liquid_volume": 1e-9}
SURFACES = {"hamaker_constant": 1e-18, "separation": 1e-8}
ENERGY = {"work_of_adhesion": 0.5}

LAWS = {
    "zhou": lambda: bed(3000),
    "hertz": lambda: bed(3000, normal="hertz"),
    "dashpots": lambda: with_models(DASHPOTS),
    "springs": lambda: with_models(SPRINGS),
    "linear": lambda: with_law({"law": "linear", **SPRING}, "cdt", "sjkr", {"cohesion_energy_density": 1e4}),
    "thornton": lambda: with_law(
        {"law": "thornton", "yield_ratio": 1.6}, "epsd", "dmt", ENERGY, restitution=None, yield_strength=3e6
    ),
    "walton_braun": lambda: with_law(
        {"law": "walton_braun", "unloading": {"reference_velocity": 1.0}, **SPRING}, "cdt", "jkr", ENERGY
    ),
    "luding": lambda: with_law(
        {"law": "luding", "plasticity_depth": 0.02, "tension": 0.3, **SPRING}, "epsd", "capillary", BRIDGE
    ),
    "kuwabara_kono": lambda: with_law(
        {"law": "kuwabara_kono", "reference_velocity": 1.0}, "cdt", "van_der_waals", SURFACES
    ),
}
"""Scenes of 3000 steps that together contain all contact models."""

FEATURES = {
    "inserted": inserted,
    "periodic": periodic,
    "wide_sizes": wide_sizes,
    "outlet": with_outlet,
    "mesh": with_mesh,
    "servo": lambda: with_piston({"kind": "servo", "force": 2.0, "velocity_max": 0.5}),
    "free": lambda: with_piston({"kind": "free", "mass": 0.01}),
    "adaptive": lambda: bed(run={"duration": 6e-3, "velocity_max": 4.0, "time_step": "adaptive"}),
    "belt": on_belt,
    "sheared": sheared,
    "mixed": lambda: in_precision("mixed"),
    "f32": lambda: in_precision("f32"),
}
"""Scenes of at least 3000 steps, each with one feature."""

SCENES = (
    LAWS
    | FEATURES
    | {
        "uneven": uneven,
        "conducting": conducting,
        "short": bed,
        "pair": pair,
        "resumable": resumable,
        "long_lists": lambda: bed(numerics={"chunk_size": 32, "skin": 1.5e-3}),
    }
)
