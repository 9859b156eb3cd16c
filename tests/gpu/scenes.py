"""Small scenes that together use each phase of the engine: one particle per chunk, some hundred steps."""

import os
from pathlib import Path

import numpy as np
from engine.test_outlets import chute
from engine.test_wall_dynamics import compression_scene
from geometry.meshes import sheet, write
from scene_builders import SOFT, box, build_scene, moving_lattice, particle_group, vibrating_box
from sheared_scenes import sheared_gas

from granflow.load import Scene

SPRING = {"stiffness": {"reference_velocity": 1.0}}
LAWS = {
    "zhou": {"law": "zhou", "restitution_at": "max_overlap"},
    "hertz": {"law": "hertz"},
    "linear": {"law": "linear", **SPRING},
    "thornton": {"law": "thornton", "yield_ratio": 1.6},
    "walton_braun": {"law": "walton_braun", "unloading": {"reference_velocity": 1.0}, **SPRING},
    "luding": {"law": "luding", "plasticity_depth": 0.02, "tension": 0.3, **SPRING},
    "eepa": {"law": "eepa", "stiffness": "hertz", "adhesion_exponent": 3.0},
    "kuwabara_kono": {"law": "kuwabara_kono", "reference_velocity": 1.0},
}

"""Normal contact models."""

GPU_CHUNKS = {"numerics": {"chunk_size": 1}}
COLLISIONS = {"collision_energies": {"min": 1e-9, "max": 1e-2, "classes": 14}}
RUN = {"velocity_max": 2.0, "time_step": 4e-6}


def shaken_box(duration=0.003):
    """A lattice of 256 particles falls into a vibrating box: friction, rolling friction, rebuilds, all outputs."""
    output = {"interval": 1.0, "energy_budget": True, "wall_forces": True} | COLLISIONS
    return build_scene(
        {"lattice": moving_lattice((8, 8, 4), largest=0.006, speed=0.3)}, walls=vibrating_box(0.06), rolling="epsd",
        gravity=[0.0, 0.0, -9.81], pair={"friction": 0.4, "rolling_friction": 0.1, "restitution": 0.1},
        run={"duration": duration, **RUN}, output=output, **GPU_CHUNKS,
    )  # fmt: skip


def periodic_gas(**contact):
    """A periodic gas that collides from the first steps on; `contact`: arguments of `build_scene`."""
    rng = np.random.default_rng(3)
    positions = 0.0102 * (np.argwhere(np.ones((4, 4, 4))) + 0.5)
    balls = particle_group(positions, 0.01, velocity=rng.normal(0.0, 0.5, positions.shape))
    domain = {"min": [0.0] * 3, "max": [0.0408] * 3, "periodic": ["x", "y", "z"], "on_exit": "error"}
    defaults = {"pair": {"friction": 0.4, "restitution": 0.7}, "run": {"duration": 0.002, **RUN}}
    return build_scene({"balls": balls}, domain=domain, **GPU_CHUNKS, **(defaults | contact))


def with_law(law):
    """The periodic gas with one normal contact model."""
    pair = {"friction": 0.3, "restitution": None if law == "thornton" else 0.7}
    if law == "eepa":
        pair |= {"plasticity": 0.4, "work_of_adhesion": 20.0, "pull_off_force": 0.01}
    return periodic_gas(normal=LAWS[law], pair=pair, materials={"glass": SOFT | {"yield_strength": 3e6}})


def cohesive():
    """The periodic gas with cohesion and the rolling model cdt."""
    return periodic_gas(
        contact={"normal": "hertz", "tangential": "mindlin", "rolling": "cdt", "cohesion": "sjkr"},
        pair={"friction": 0.3, "restitution": 0.7, "rolling_friction": 0.1, "cohesion_energy_density": 3e4},
    )


def mesh_floor(folder):
    """Particles that slide over the triangles of a bumpy floor, and over the seam of two plates in it."""
    os.chdir(folder)  # meshes of a scene without a file are in the working directory
    write(Path("floor.stl"), *sheet(6, 0.06, bumps=0.0005))
    positions = np.argwhere(np.ones((4, 4, 2))) * 0.011 + [-0.0165, -0.0165, 0.0065]
    balls = particle_group(positions, 0.01, velocity=np.tile([0.6, 0.3, -0.5], (len(positions), 1)))
    wear = {"law": "finnie", "coefficient": 0.1, "hardness": "1 GPa"}
    walls = {"floor": {"shape": "mesh", "file": "floor.stl", "material": "glass", "wear": wear}}
    for name, x in (("left", -0.03), ("right", 0.0)):
        sides = [[0.03, 0, 0], [0, 0.06, 0]]
        walls[name] = {"shape": "rectangle", "corner": [x, -0.03, 0], "sides": sides, "material": "glass"}
    return build_scene(
        {"balls": balls}, walls=walls, pair={"friction": 0.4}, gravity=[0, 0, -9.81],
        run={"duration": 0.002, **RUN}, **GPU_CHUNKS,
    )  # fmt: skip


def size_classes():
    """Particles of sizes 1:8 in a box: one grid per size class."""
    rng = np.random.default_rng(5)
    small = 0.003 * (np.argwhere(np.ones((9, 9, 2))) + 0.6)
    large = [[0.01, 0.01, 0.018], [0.02, 0.017, 0.019]]
    groups = {
        "small": particle_group(small, 0.0025, velocity=rng.normal(0.0, 0.4, small.shape)),
        "large": particle_group(large, 0.02 * np.array([0.9, 0.4]), velocity=[[0.0, 0.0, -0.8]] * 2),
    }
    return build_scene(
        groups, walls=box(0.03), pair={"friction": 0.4}, gravity=[0, 0, -9.81],
        numerics={"chunk_size": 1, "max_overlap": 0.3}, run={"duration": 0.002, **RUN},
    )  # fmt: skip


def compressed():
    """A servo wall, whose pressure refers to the section between three walls at rest and a free wall."""
    scene = compression_scene(0.004, **GPU_CHUNKS).to_dict()
    scene["walls"]["lid"]["motion"][0]["between"] = ["low_x", "side", "low_y", "high_y"]
    return Scene.from_dict(scene)


FLOWING = {
    "run": {"duration": 0.04, "velocity_max": 3.0, "time_step": 1e-5},
    "output": {"interval": 1.0, "energy_budget": True},
}
SCENES = {
    "shaken box": lambda folder: shaken_box(),
    "periodic": lambda folder: periodic_gas(),
    "sheared": lambda folder: sheared_gas(duration=0.001, sizes=(0.005, 0.0065), chunk_size=1),
    "mesh": mesh_floor,
    "servo and free wall": lambda folder: compressed(),
    "inlet and outlets": lambda folder: chute(**FLOWING, **GPU_CHUNKS),
    "size classes": lambda folder: size_classes(),
    "cohesion": lambda folder: cohesive(),
    **{f"law {law}": (lambda folder, law=law: with_law(law)) for law in LAWS},
}
"""Builders by name; argument: folder of mesh files."""

QUICK = ("shaken box", "servo and free wall", "law zhou")
"""Scenes of the quick test: kernels take most of its time to compile."""
