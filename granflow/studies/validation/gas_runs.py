"""Runs of cooling gases, and collisions of two of their particles.

The gases are the periodic box of the shipped scene `verification/haff_periodic`, with more particles and with
random velocities.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from granflow import Scene, Simulation, on_interval
from granflow.studies.validation.gas import Gas, Restitution
from granflow.studies.validation.shipped import shipped_scene

DIAMETER, DENSITY_OF_SCENE = 1e-3, 600 / 0.02**3
"""Diameter [m] and particles per volume [1/m3] of the shipped scene."""
THETA = 1.0 / 3.0
"""Initial temperature [m2/s2] of the shipped scene: all particles move at 1 m/s."""
RESTITUTION = 0.8
"""Restitution of the shipped scene, and of viscoelastic spheres at 1 m/s."""
START = 0.003
"""Start of the evaluation [s], about one collision per particle."""
FASTEST = 4.0
"""Largest relative velocity [m/s] for which the time step is chosen."""
FRACTION, PAIR_FRACTION = 0.1, 0.01
"""Time step over the shorter of loading and unloading time, of gases (0.1 % less loss) and of two
particles."""
SAMPLES = 100
"""Temperatures of each run."""
IMPACTS, SPEEDS = 16, 4
"""Impact parameters and relative velocities of the collisions of two particles."""


@dataclass(frozen=True)
class Softness:
    """Effect of soft contacts in a gas.

    oblique:   energy dissipated by collisions over that of rigid spheres
    duration:  mean duration of contacts [s]
    """

    oblique: float
    duration: float


def gas_of(count: int) -> Gas:
    """A gas with the density of the shipped scene."""
    return Gas(count, DIAMETER, count / DENSITY_OF_SCENE)


def gas_scene(count: int, modulus: float, normal: Any, end: float, seed: int = 1) -> Scene:
    """A gas like that of the shipped scene, with Young's modulus [Pa], normal contact model and duration
    [s]."""
    half = 0.5 * gas_of(count).volume ** (1.0 / 3.0)
    corners = {"min": [-half] * 3, "max": [half] * 3}
    pack = {"kind": "pack", "region": {"box": corners}}
    group = {
        "material": "ball",
        "count": count,
        "diameter": DIAMETER,
        "insert": pack,
        "thermal": {"velocity_rms": (3.0 * THETA) ** 0.5},
    }
    domain = corners | {"periodic": ["x", "y", "z"], "on_exit": "error"}
    return changed_scene(modulus, normal, end, {"gas": group}, domain, seed)


def changed_scene(
    modulus: float,
    normal: Any,
    end: float,
    groups: dict[str, Any],
    domain: dict[str, Any],
    seed: int = 1,
    time_step_fraction: float = FRACTION,
) -> Scene:
    """The shipped scene with other particles, Young's modulus [Pa], normal contact model, duration [s] and
    domain."""
    data = shipped_scene("verification/haff_periodic").to_dict()
    data["materials"]["ball"]["young_modulus"] = modulus
    data["contact"]["normal"] = normal
    data["numerics"] = {"time_step_fraction": time_step_fraction, "max_overlap": 0.5}
    return Scene.from_dict(
        {
            **data,
            "seed": seed,
            "particles": groups,
            "domain": domain,
            "expect": [],
            "output": {"interval": end},
            "run": {"duration": end, "velocity_max": FASTEST, "precision": "f64"},
        }
    )


def temperatures(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """Times (n,) [s] from START and temperatures (n,) [m2/s2] of a gas."""
    rows: list[tuple[float, float]] = []

    def record(snapshot: Any) -> None:
        velocity = snapshot.particles["velocity"]
        rows.append(
            (snapshot.time, float(np.mean(np.sum((velocity - velocity.mean(axis=0)) ** 2, axis=1))) / 3.0)
        )

    observer = on_interval((scene.run.duration or 1.0) / SAMPLES, record, ("particles",))
    simulation = Simulation(scene, observers=[observer])
    simulation.run()
    simulation.free()
    time, theta = np.array(rows).T
    return time[time >= START], theta[time >= START]


def softness(modulus: float, normal: Any, theta: float, restitution: Restitution) -> Softness:
    """Collisions of two particles with all impact parameters, averaged over the collisions of a gas at theta
    [m2/s2].

    With g^2 = 4 theta u, collisions have the weight u exp(-u) du, and equal weight for equal intervals of
    b^2.
    """
    from scipy.special import roots_genlaguerre

    u, weight = roots_genlaguerre(SPEEDS, 1.0)
    cosine = np.sqrt((np.arange(IMPACTS) + 0.5) / IMPACTS)
    speed, cosine = (each.ravel() for each in np.meshgrid(np.sqrt(4.0 * theta * u), cosine, indexing="ij"))
    weight = np.repeat(weight / weight.sum(), IMPACTS) / IMPACTS
    mass, loss, duration = collide_pairs(modulus, normal, speed, cosine)
    rigid = 0.25 * mass * (speed * cosine) ** 2 * (1.0 - restitution(speed * cosine) ** 2)
    return Softness(float(weight @ loss / (weight @ rigid)), float(weight @ duration))


def collide_pairs(
    modulus: float, normal: Any, speed: np.ndarray, cosine: np.ndarray
) -> tuple[float, np.ndarray, np.ndarray]:
    """Mass [kg], dissipated energies (n,) [J] and durations (n,) [s] of separate collisions of two equal
    particles.

    speed, cosine:  (n,) relative velocity [m/s], and cosine between it and the normal at first contact
    """
    count = len(speed)
    normals = np.stack([cosine, np.sqrt(1.0 - cosine**2), np.zeros(count)], axis=1)
    places = np.zeros((count, 3))
    places[:, 2] = 4.0 * DIAMETER * np.arange(count)
    approach = np.zeros((count, 3))
    approach[:, 0] = 0.5 * speed
    gap = 1.0 + 1e-9
    position = np.concatenate(
        [places - 0.5 * gap * DIAMETER * normals, places + 0.5 * gap * DIAMETER * normals]
    )
    group = {
        "material": "ball",
        "diameter": DIAMETER,
        "velocity": np.concatenate([approach, -approach]).tolist(),
        "insert": {"kind": "positions", "positions": position.tolist()},
    }
    reach = 20.0 * DIAMETER
    domain = {
        "min": [-reach, -reach, -reach],
        "max": [reach, reach, places[-1, 2] + reach],
        "on_exit": "error",
    }
    end = 40.0 * (5e7 / modulus) ** 0.4 * 5e-5 / min(1.0, float(speed.min())) ** 0.2
    times: list[float] = []
    rows: list[np.ndarray] = []

    def record(snapshot: Any) -> None:
        times.append(snapshot.time)
        rows.append(np.bincount(snapshot.contacts["id_i"] % count, minlength=count))

    observer = on_interval(end / 4000, record, ("contacts", "particles"))
    scene = changed_scene(modulus, normal, end, {"pairs": group}, domain, time_step_fraction=PAIR_FRACTION)
    simulation = Simulation(scene, observers=[observer])
    while not rows or rows[-1].any() or len(rows) < 20:
        simulation.run(duration=end / 40)
    particles = simulation.snapshot().particles
    simulation.free()
    mass = float(particles["mass"][0])
    after = particles["velocity"]
    relative = after[:count] - after[count:]
    return mass, 0.25 * mass * (speed**2 - np.sum(relative**2, axis=1)), np.gradient(times) @ np.array(rows)
