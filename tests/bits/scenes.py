"""Scenes whose runs have the same bits in every execution of `executions`, and what shows that they use what
they are for.

The scenes of QUICK contain most features together, because the kernels of each scene are compiled for several
executions; the others add contact models, precisions and numerics.
"""

import os
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from clumps import clump_group, falling_clumps
from geometry.meshes import cube, write
from scene_builders import (
    DASHPOTS,
    LIQUID,
    SOFT,
    SPRINGS,
    box,
    build_scene,
    moving_lattice,
    particle_group,
    plane,
)
from sheared_scenes import sheared_gas

from granflow.load import Scene
from granflow.simulation import Simulation

FILES = tempfile.TemporaryDirectory()
"""Meshes of this process."""


@dataclass(frozen=True)
class Row:
    """One scene of the matrix.

    build:      returns the scene
    effects:    names of totals that are not 0 at the end, because the features of the scene have had an effect
    change:     called with the simulation at half of its duration; None: no change
    on_ranks:   whether granflow accepts the scene on MPI ranks
    """

    build: Callable[[], Scene]
    effects: tuple[str, ...] = ()
    change: Callable[[Simulation], None] | None = None
    on_ranks: bool = True


SIDE = {"side": {"box": {"min": [0.05, 0.0, 0.0], "max": [0.07, 0.06, 0.03]}}}
"""Outlet that deletes particles before they leave the domain."""


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


def moved_walls() -> Scene:
    """A bed with a coarse particle between a turning mesh, a belt, a servo lid, a free and a shaken wall, which
    wear by all laws; particles are attached to the lid and to the mesh. Gravity turns and vibrates."""
    os.chdir(FILES.name)  # where a scene without a file looks for meshes
    points, corners = cube()
    write(Path("cube.stl"), 0.02 * points + [0.011, 0.011, -0.0185], corners)
    walls: dict[str, Any] = box(0.042)
    walls["low_z"]["motion"] = {
        "kind": "surface_velocity", "velocity": [2.0, 0.5, 0.0], "ramp_duration": 1e-3, "initial_velocity": [0, 1, 0]
    }  # fmt: skip
    middle = {"point": [0.021, 0.021, 0.0], "axis": [0, 0, 1]}
    turning = {"kind": "rotation", "angular_velocity": 40.0} | middle
    rocking = {
        "kind": "oscillation",
        "point": [0.019, 0.021, 0.0],
        "axis": [1, 0, 0],
        "amplitude": 0.02,
        "frequency": 300.0,
    }
    walls["cube"] = {
        "shape": "mesh", "file": "cube.stl", "material": "glass", "motion": [turning, rocking],
        "torque_point": [0.0, 0.0, 0.01],
    }  # fmt: skip
    shaken = {"kind": "vibration", "direction": [1, 0, 0], "amplitude": 2e-4, "frequency": 300.0}
    belt = {"kind": "surface_velocity", "velocity": [0.0, 1.0, 0.0], "start": 5e-4}
    table = {
        "kind": "table",
        "direction": [-1, 0, 0],
        "times": [0, 1e-3, 2e-3],
        "displacements": [0, 2e-4, 1e-4],
    }
    walls["low_x"]["motion"] = [shaken, belt]
    walls["high_x"]["motion"] = table
    walls["high_y"]["motion"] = {"kind": "free", "mass": 0.25, "direction": [0, -1, 0]}
    ramps = {"ramp_duration": 5e-4, "end": 2e-3, "end_ramp_duration": 1e-3}
    spinning = {"kind": "rotation", "angular_velocity": 5.0} | middle | ramps
    pressing = {"kind": "servo", "force": 2.0, "velocity_max": 0.5, "direction": [0, 0, -1]}
    walls["high_z"]["motion"] = [pressing, spinning]
    walls["cube"]["wear"] = {"law": "finnie", "coefficient": {"glass": 0.1}, "hardness": "1 GPa"}
    walls["low_z"]["wear"] = {"law": "archard", "coefficient": 1e-3, "hardness": "2 GPa"}
    walls["low_x"]["wear"] = {"law": "relative"}
    turned = {"kind": "rotation", "axis": [1, 0, 0], "angular_velocity": 200.0, "start": 5e-4}
    trembling = {"kind": "vibration", "amplitude": [5.0, 0, 0], "frequency": 700.0}
    lattice = moving_lattice((6, 6, 5), largest=0.0062, speed=1.0)
    coarse = particle_group([[0.021, 0.021, 0.0365]], 0.009, velocity=[[0.0, 0.0, -6.0]])
    on_lid = particle_group(0.026 * np.argwhere(np.ones((2, 2, 1))) + [0.0049, 0.0049, 0.0365], 0.006)
    on_cube = particle_group([[0.0146, 0.0146, 2e-3], [0.0276, 0.0276, 2e-3]], 0.005)
    attached = {
        "on_lid": on_lid | {"fixed": {"to": "high_z"}},
        "on_cube": on_cube | {"fixed": {"to": "cube"}},
    }
    return build_scene(
        {"lattice": lattice, "coarse": coarse, **attached}, walls=walls,
        gravity={"vector": [0.0, 3.0, -9.81], "motion": [turned, trembling]},
        numerics={"chunk_size": 32, "skin": 2e-4},
        run={"duration": 3e-3, "velocity_max": 6.0, "time_step": 2e-6, "precision": "mixed"},
        output={"interval": 1e-3, "energy_budget": True, "wall_forces": True, "walls": False, "checkpoint": {"interval": 2.5e-4, "keep": 100}},
        **SPRINGS,
    )  # fmt: skip


VISCOUS = {"viscous_force": {"viscosity": 0.02, "min_separation_ratio": 0.02}}
VISCOUS_BRIDGES = {"law": "capillary", **VISCOUS}


def wet_clumps() -> Scene:
    """Rods, tetrahedra and spheres with viscous bridges of fixed volume fall into a box that is periodic along x;
    rain of clumps; damping; gravity jumps to a table, and random particles that touch the floor are deleted."""
    corners = 1.2e-3 * np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]])
    contact = {"normal": "hertz", "tangential": "mindlin", "rolling": "none", "cohesion": VISCOUS_BRIDGES}
    walls = {name: wall for name, wall in box(0.055).items() if not name.endswith("x")}
    domain = {"min": [0.0, -0.01, -0.01], "max": [0.055, 0.065, 0.065], "periodic": ["x"], "on_exit": "error"}
    tilted = {"times": [0.0, 0.01], "vectors": [[0.0, 30.0, -95.0], [40.0, 0.0, -90.0]]}
    at_floor = {"half_space": {"point": [0.0, 0.0, 0.0], "normal": [0.0, 0.0, -1.0]}}
    deletions = [{"region": at_floor, "part": "any", "fraction": 0.6}, {"groups": ["balls"], "fraction": 0.2}]
    tilt = {"name": "tilted", "duration": 0.006, "gravity": tilted, "delete": deletions}
    return build_scene(
        falling_clumps(corners, 1.5e-3), walls, contact=contact, domain=domain,
        pair={"friction": 0.4, "restitution": 0.4, "surface_tension": 0.07, "contact_angle": 0.3, "liquid_volume": 1e-10},
        gravity=[0.0, 0.0, -100.0], numerics={"chunk_size": 32, "max_overlap": 0.2},
        stages=[{"name": "fall", "duration": 0.006}, tilt],
        run={"velocity_max": 4.0, "time_step": 2e-6}, damping={"cundall": 0.1, "drag": 2.0},
        output={"interval": 0.004, "energy_budget": True, "checkpoint": {"interval": 0.001, "keep": 100}},
    )  # fmt: skip


def sheared_films() -> Scene:
    """Two sizes with liquid films in a Lees-Edwards box: separate grids, periodic images, viscous bridges."""
    output = {"interval": 0.001, "checkpoint": {"interval": 4e-4, "keep": 100}}
    scene = sheared_gas(duration=0.004, sizes=(0.003, 0.0078), output=output, chunk_size=32).to_dict()
    scene["particles"]["balls"]["liquid_content"] = 0.01
    contact = LIQUID["contact"]
    scene["contact"] = contact | {"cohesion": contact["cohesion"] | VISCOUS}
    scene["pairs"]["glass-glass"] = LIQUID["pair"]
    return Scene.from_dict(scene)


def deformed_films() -> Scene:
    """The same gas in a box that deforms: rates and pressures that change with the stage, compression by a
    tenth."""
    scene = sheared_films().to_dict()
    scene["domain"]["lees_edwards"] = None
    pressures = {"x": {"pressure": 50.0}, "y": {"strain_rate": -20.0}, "max_rate": 40.0, "gain": 0.05}
    scene["stages"] = [
        {"name": "compress", "duration": 2e-3, "deformation": {"z": {"strain_rate": -50.0}}},
        {"name": "control", "duration": 2e-3, "deformation": pressures},
    ]
    scene["run"]["duration"] = None
    return Scene.from_dict(scene)


def conducting() -> Scene:
    """The poured bed and rods with temperatures, of which one wall has one and wears, and another one a heat
    flux."""
    thermal = {"thermal_conductivity": 50.0, "heat_capacity": 0.5, "emissivity": 0.9}
    contact: dict[str, Any] = {"normal": "zhou", "tangential": "mindlin", "rolling": "epsd"}
    gas = {"conductivity": 0.05, "min_gap": 1e-5}
    contact["heat"] = {"law": "conduction", "from_dissipation": True, "surroundings": 280.0, "gas": gas}
    scene = complex_scene(
        0.009,
        of_groups={"temperature": 300.0},
        outlets=SIDE,
        contact=contact,
        materials={"glass": SOFT | thermal, "steel": SOFT | thermal | {"thermal_conductivity": 10.0}},
    ).to_dict()
    scene["particles"]["lattice"]["temperature"] = 350.0
    scene["walls"]["floor"]["temperature"] = 400.0
    scene["walls"]["low_x"]["heat_flux"] = 1e3
    scene["walls"]["floor"]["wear"] = {"law": "archard", "coefficient": 1e-3, "hardness": "2 GPa"}
    scene["walls"]["low_x"]["groups"] = ["lattice", "rain"]
    scene["particles"]["lattice"]["heat_source"] = 0.2
    half = {"half_space": {"point": [0.02, 0.0, 0.0], "normal": [1.0, 0.0, 0.5]}}
    scene["stages"][1]["set"] = [
        {"temperature": 500.0, "region": half},
        {"heat_source": -0.1, "groups": ["rain"]},
    ]
    return with_rods(Scene.from_dict(scene), temperature=320.0, heat_source=0.3)


def disturb(simulation: Simulation) -> None:
    """Change velocities of mobile spheres and delete every seventh particle from Python, of clumps all
    spheres."""
    particles = simulation.particles
    mobile = np.flatnonzero(~np.isin(particles.group, ["row", "rods"]))
    particles.velocity[mobile[::2]] += [0.1, 0.0, -0.2]
    particles.remove(np.arange(len(particles)) % 7 == 0)


SPRING = {"stiffness": {"reference_velocity": 1.0}}
BRIDGE = {"surface_tension": 0.5, "contact_angle": 0.3, "liquid_volume": 1e-9}
SURFACES = {"hamaker_constant": 1e-18, "separation": 1e-8}
ENERGY = {"work_of_adhesion": 0.5}


def with_models(normal, rolling, cohesion, options, restitution=0.5, **material) -> Scene:
    """The poured bed with a normal, a rolling and a cohesion model; `options` are the values that these
    models require."""
    contact = {"normal": normal, "tangential": "mindlin", "rolling": rolling, "cohesion": cohesion}
    pair = {"friction": 0.4, "rolling_friction": 0.1, "restitution": restitution} | options
    materials = {name: SOFT | material for name in ("glass", "steel")}
    run = {"velocity_max": 2.0, "time_step": 2e-6}
    return complex_scene(0.006, contact=contact, pair=pair, materials=materials, run=run)


def periodic() -> Scene:
    """The lattice between two walls in a box that is periodic along x and y; particles move with the upper one
    across the boundary."""
    walls: dict[str, Any] = {name: wall for name, wall in box(0.042).items() if name.endswith("z")}
    walls["high_z"]["motion"] = {"kind": "translation", "velocity": [3.0, -1.0, -0.5]}
    on_top = particle_group(0.0105 * np.argwhere(np.ones((4, 4, 1))) + [0.005, 0.005, 0.0437], 0.006)
    domain = {
        "min": [0.0, 0.0, -0.01], "max": [0.042, 0.042, 0.05], "periodic": ["x", "y"], "on_exit": "error",
    }  # fmt: skip
    return build_scene(
        {
            "lattice": moving_lattice((6, 6, 6), largest=0.0062, speed=1.0),
            "on_top": on_top | {"fixed": {"to": "high_z"}},
        },
        walls, domain=domain,
        rolling="epsd", pair={"friction": 0.4, "rolling_friction": 0.1, "restitution": 0.5}, gravity=[0.0, 3.0, -9.81],
        numerics={"chunk_size": 32, "skin": 2e-4}, run={"duration": 6e-3, "velocity_max": 4.0, "time_step": 2e-6},
        output={"interval": 1e-3, "energy_budget": True, "checkpoint": {"interval": 5e-4, "keep": 100}},
    )  # fmt: skip


def with_rods(scene: Scene, **more) -> Scene:
    """The poured bed with rods of three spheres that fall onto the lattice; `more`: keys of their group."""
    sites = 0.0085 * np.argwhere(np.ones((4, 4, 1))) + [0.014, 0.005, 0.0436]
    centers = [[-1.5e-3, 0.0, 0.0], [0.0, 0.0, 0.0], [1.5e-3, 0.0, 0.0]]
    rods = clump_group(
        sites, centers, 1.4e-3, "random", velocity=[0.3, 0.0, -1.0], angular_velocity=[0, 0, 200]
    )
    changed = scene.to_dict()
    changed["particles"]["rods"] = rods | more
    return Scene.from_dict(changed)


def in_precision(precision) -> Scene:
    """The poured bed in another precision."""
    return complex_scene(0.009, run={"velocity_max": 2.0, "time_step": 4e-6, "precision": precision})


MOVED = tuple(
    "wall_displacement.high_z wall_displacement.high_y wall_work wear_volume.cube wear_volume.low_z "
    "wear_normal_work.low_x gravity_work".split()
)
HEATED = tuple(
    "outlet_count.side wall_work plastic_dissipation friction_dissipation rolling_dissipation surroundings_heat "
    "source_heat heat_content_set wall_heat.floor wear_volume.floor".split()
)
QUICK = {
    "walls": Row(moved_walls, MOVED),
    "clumps": Row(wet_clumps, ("rotational_energy", "contact_count", "gravity_work", "deleted_count")),
    "films": Row(sheared_films, ("boundary_work", "liquid_bridge_volume"), disturb, on_ranks=False),
    "heat": Row(conducting, HEATED),
}
"""Scenes of the usual test run."""

SLOW = {
    "disturbed": Row(lambda: complex_scene(0.009, outlets=SIDE), ("wall_work",), disturb, on_ranks=False),
    "periodic": Row(periodic, ("contact_count", "wall_work")),
    "sheared": Row(
        lambda: sheared_gas(duration=0.012, sizes=(0.002, 0.0065), output={"interval": 2e-3, "checkpoint": {"interval": 1e-3, "keep": 100}}), ("boundary_work",)
    ),
    "adaptive": Row(
        lambda: with_rods(complex_scene(0.006, run={"velocity_max": 2.0, "time_step": "adaptive"}))
    ),
    "mixed": Row(lambda: in_precision("mixed")),
    "f32": Row(lambda: in_precision("f32")),
    "deformed": Row(
        deformed_films, ("boundary_work", "box_strain_x", "box_strain_z", "liquid_bridge_volume"), disturb, on_ranks=False
    ),
    "dashpots": Row(lambda: complex_scene(0.006, **DASHPOTS), ("damping_dissipation",)),
    "springs": Row(lambda: complex_scene(0.006, **SPRINGS)),
    "poured films": Row(
        lambda: with_rods(
            complex_scene(0.009, of_groups={"liquid_content": 0.01}, **LIQUID), liquid_content=0.02
        ),
        ("liquid_bridge_volume",),
        disturb,
        on_ranks=False,
    ),
    "linear": Row(
        lambda: with_models({"law": "linear", **SPRING}, "cdt", "sjkr", {"cohesion_energy_density": 1e4})
    ),
    "thornton": Row(
        lambda: with_models(
            {"law": "thornton", "yield_ratio": 1.6}, "epsd", "dmt", ENERGY, restitution=None, yield_strength=3e6
        )
    ),
    "walton_braun": Row(
        lambda: with_models(
            {"law": "walton_braun", "unloading": {"reference_velocity": 1.0}, **SPRING}, "cdt", "jkr", ENERGY
        )
    ),
    "luding": Row(
        lambda: with_models(
            {"law": "luding", "plasticity_depth": 0.02, "tension": 0.3, **SPRING}, "epsd", VISCOUS_BRIDGES, BRIDGE
        )
    ),
    "eepa": Row(
        lambda: with_models(
            {"law": "eepa", "stiffness": "hertz", "adhesion_exponent": 3.0}, "epsd", "none",
            {"plasticity": 0.4, "work_of_adhesion": 20.0, "pull_off_force": 0.01}
        )
    ),
    "kuwabara_kono": Row(
        lambda: with_models({"law": "kuwabara_kono", "reference_velocity": 1.0}, "cdt", "van_der_waals", SURFACES)
    ),
}  # fmt: skip
"""Scenes of the slow tests."""

SCENES = QUICK | SLOW
