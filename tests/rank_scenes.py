"""Scenes that run alone and on MPI ranks."""

import numpy as np
from clumps import clump_group
from scene_builders import SOFT, build_scene, moving_lattice, particle_group, vibrating_box


def pair(**changes):
    """Two particles that collide after 1 ms."""
    velocity = [[0.0] * 3, [0.0, 0.0, -1.0]]
    group = particle_group([[0.0, 0.0, 0.0], [0.0, 0.0, 0.011]], velocity=velocity)
    parts = {"run": {"duration": 0.02}, "output": {"interval": 1e-3}}
    return build_scene({"pair": group}, **(parts | changes))


def resumable():
    """64 particles and 9 rods of three spheres with rain, a vibrating floor that wears, a servo wall, heat
    conduction, an outlet, a stage that ends on a quantity, one that sets temperatures and deletes particles, and
    frames of contacts."""
    region = {"box": {"min": [0.005, 0.005, 0.032], "max": [0.023, 0.023, 0.05]}}
    rain = {"material": "glass", "count": 20, "diameter": 0.004,
            "insert": {"kind": "rain", "region": region, "rate": 20000.0}}  # fmt: skip
    sites = 0.0085 * np.argwhere(np.ones((3, 3, 1))) + [0.0055, 0.0055, 0.0297]
    velocity = np.random.default_rng(7).normal([0.0, 0.0, -1.0], 0.5, sites.shape)
    rods = clump_group(
        sites, [[-1.5e-3, 0, 0], [0, 0, 0], [1.5e-3, 0, 0]], 1.2e-3, "random", velocity=velocity
    )
    walls = vibrating_box(0.028)
    del walls["high_z"]
    walls["high_x"]["motion"] = {"kind": "servo", "direction": [-1, 0, 0], "force": 1.0, "velocity_max": 0.2}
    walls["low_z"] |= {
        "temperature": 400.0, "wear": {"law": "archard", "coefficient": 1e-3, "hardness": "2 GPa"}
    }  # fmt: skip
    condition = {"quantity": "contact_count", "above": 10}
    lattice = moving_lattice((4, 4, 4), largest=0.0062, speed=1.0)
    groups = {"lattice": lattice | {"heat_source": 0.2}, "rods": rods, "rain": rain}
    heat = {"law": "conduction", "from_dissipation": True, "gas": {"conductivity": 0.05, "min_gap": 1e-5}}
    half = {"half_space": {"point": [0.014, 0.0, 0.0], "normal": [1.0, 0.0, 0.5]}}
    mix = {
        "name": "mix", "duration": 3e-3, "set": [{"temperature": 500.0, "region": half}],
        "delete": [{"groups": ["rain"], "fraction": 0.5}],
    }  # fmt: skip
    return build_scene(
        {name: group | {"temperature": 350.0} for name, group in groups.items()}, walls,
        contact={"normal": "zhou", "tangential": "mindlin", "rolling": "epsd", "heat": heat},
        materials={"glass": SOFT | {"thermal_conductivity": 50.0, "heat_capacity": 0.5}},
        outlets={"corner": {"box": {"min": [0.021, 0.0, -0.001], "max": [0.03, 0.03, 0.0042]}}},
        gravity=[0.0, 3.0, -9.81], numerics={"chunk_size": 16},
        pair={"friction": 0.4, "rolling_friction": 0.1, "restitution": 0.5},
        output={"interval": 5e-4, "timeseries_interval": 2e-5, "energy_budget": True, "wall_forces": True,
                "contacts": True, "checkpoint": {"interval": 7e-4}},
        stages=[{"name": "approach", "until": condition, "max_duration": 2e-3}, mix],
        run={"velocity_max": 4.0, "time_step": 2e-6},
    )  # fmt: skip
