"""Correctness checks on one device in one precision. Each check is a value with a limit.

The functions are jobs of subprocesses and return records {name, value, limit, passed}. A GPU evaluates each
contact from both sides (chunks of one particle); on a CPU these checks do the same.
"""

import hashlib
import logging
from pathlib import Path
from typing import Any

import numpy as np
from benchmark.cases import RADIUS_MEAN

from gpu_checks.beds import bed, engine_for

SCENES = Path(__file__).resolve().parents[2] / "scenes"
VERIFIED = (
    "unequal_spheres",
    "wall_limit",
    "chung_ooi_3",
    "conveyor",
    "incline",
    "stack_at_rest",
    "mfix_slip_to_roll",
)
"""Scenes in scenes/verification with closed forms: pairs, walls, moving walls, friction, rest, rolling."""
STEPS = 400
EPS = {"f64": float(np.finfo(np.float64).eps), "mixed": float(np.finfo(np.float32).eps)}
EPS["f32"] = EPS["mixed"]
SPREAD = 6.0
"""Accepted deviation due to rounding, in standard deviations."""
TRAJECTORY_STEPS = 1000
FASTEST = 0.5
"""Largest initial speed [m/s] of the colliding particles: two of them approach at the planned 1 m/s at
most."""
PARTICLE_COUNT = (256, 60)
"""Particles of the vibrated box: those in the box, and those that rain in upward and leave the domain."""


def record(name: str, value: float, limit: float) -> dict[str, Any]:
    """Record of a check that passes if |value| is at most the limit; NaN fails."""
    return {"name": name, "value": float(value), "limit": float(limit), "passed": bool(abs(value) <= limit)}


def collisions(arch: str, precision: str) -> list[dict[str, Any]]:
    """Head-on collisions with each contact model, and one with a wall, against the closed forms.

    The error of a collision of n steps is about 1/n, plus the resolution of positions over the overlap.
    """
    from granflow.contact.registry import models
    from granflow.studies.collide import collide

    logging.getLogger("granflow").setLevel(
        logging.ERROR
    )  # f32 logs a warning; the limit includes its resolution
    found = []
    diameter = 4e-3
    resolved = EPS[precision] * diameter * (10.0 if precision == "f32" else 1.0)
    for law, wall in [*((law, False) for law in models("normal")), ("zhou", True)]:
        requested: dict[str, Any] = (
            {} if models("normal")[law].restitution == "nothing" else {"restitution": 0.7}
        )
        numbers = collide(
            law, "stainless_316", diameter, 0.5, wall=wall, steps_per_contact=STEPS, precision=precision, arch=arch,
            **requested,
        )  # fmt: skip
        limit = 1.0 / STEPS + resolved / numbers["overlap_max"]
        for name in ("restitution", "duration", "overlap_max", "force_max"):
            expected = numbers.get(f"{name}_asked", numbers.get(f"{name}_theory", 0.0))
            where = f"{law} on a wall" if wall else law
            found.append(record(f"{name} of {where}", numbers[name] / expected - 1.0, limit))
    return found


def momentum(arch: str, precision: str, bed_file: str) -> list[dict[str, Any]]:
    """Momentum of colliding particles without walls and gravity is conserved within rounding.

    Each velocity is rounded in each step: half an ulp times sqrt(steps) times the root of the sum of (m v)^2.
    """
    from granflow.engine.backend import start
    from granflow.simulation import Simulation

    start(arch, precision)  # type: ignore[arg-type]
    simulation = Simulation(_colliding_particles(bed_file, precision), arch=arch, precision=precision)  # type: ignore[arg-type]
    snapshots = [simulation.snapshot()]
    simulation.run()
    snapshots.append(simulation.snapshot())
    before, after = (each.particles["mass"][:, None] * each.particles["velocity"] for each in snapshots)
    collided = float(np.any(after != before, axis=1).mean())
    steps = simulation.engine.step_count
    bound = SPREAD * 0.5 * EPS[precision] * np.sqrt(steps) * np.linalg.norm(after)
    drift = np.linalg.norm(after.sum(axis=0) - before.sum(axis=0))
    without_collision = record("particles without collision", 1.0 - collided, 0.2)
    return [record("momentum drift over rounding", drift / bound, 1.0), without_collision]


def _colliding_particles(bed_file: str, precision: str) -> Any:
    """Particles of a settled bed with random velocities, without walls."""
    case = bed(bed_file, 0)
    rng = np.random.default_rng(7)
    center = case.position.mean(axis=0)
    selected = np.argsort(np.linalg.norm(case.position - center, axis=1))[:1000]
    position = case.position[selected] - center
    velocity = rng.normal(0.0, 0.3, position.shape)
    velocity *= np.minimum(1.0, FASTEST / np.linalg.norm(velocity, axis=1, keepdims=True))
    return _scene(
        {"balls": _particle_group(position, case.diameter[selected], velocity)},
        walls={},
        gravity=[0.0, 0.0, 0.0],
        run={"duration": 0.005, "velocity_max": 2.0 * FASTEST, "precision": precision},
    )


def _particle_group(position: np.ndarray, diameter: Any, velocity: np.ndarray) -> dict[str, Any]:
    insertion = {"kind": "positions", "positions": position.tolist()}
    sizes = np.asarray(diameter).tolist()
    return {
        "material": "m", "count": len(position), "diameter": sizes, "velocity": velocity.tolist(), "insert": insertion
    }  # fmt: skip


def _scene(groups: dict[str, Any], walls: dict[str, Any], **parts: Any) -> Any:
    from granflow.load import Scene

    defaults = {
        "title": "GPU check",
        "materials": {"m": {"young_modulus": 1e7, "poisson_ratio": 0.25, "density": 2500.0}},
        "pairs": {"m-m": {"restitution": 0.6, "friction": 0.4, "rolling_friction": 0.05}},
        "contact": {"normal": "zhou", "tangential": "mindlin", "rolling": "epsd"},
        "domain": {"min": [-0.1] * 3, "max": [0.1] * 3, "on_exit": "delete"},
        "numerics": {"chunk_size": 1},
        "output": {"interval": 1.0, "energy_budget": True},
    }
    return Scene.from_dict(defaults | {"walls": walls, "particles": groups} | parts)


def _vibrated_box(precision: str) -> Any:
    """A lattice falls into a vibrated box; particles rain in upward and leave the domain. Friction and
    rolling."""
    rng = np.random.default_rng(4)
    positions = 0.0065 * (np.argwhere(np.ones((8, 8, 4))) + 0.75)
    walls: dict[str, Any] = {}
    for axis, name in enumerate("xyz"):
        unit = np.eye(3)[axis]
        walls[f"low_{name}"] = {
            "shape": "plane",
            "point": [0.0] * 3,
            "normal": unit.tolist(),
            "material": "m",
        }
        if name != "z":
            far = {"point": (0.06 * unit).tolist(), "normal": (-unit).tolist()}
            walls[f"high_{name}"] = {"shape": "plane", "material": "m", **far}
    motion = {"kind": "vibration", "direction": [0, 0, 1], "amplitude": 1e-3, "frequency": 60.0}
    walls["low_z"] |= {"motion": motion}
    sizes = rng.uniform(0.004, 0.006, len(positions))
    region = {"box": {"min": [0.005, 0.005, 0.045], "max": [0.055, 0.055, 0.059]}}
    rain = {
        "material": "m", "count": PARTICLE_COUNT[1], "diameter": 0.005, "velocity": [0.0, 0.0, 1.5],
        "insert": {"kind": "rain", "region": region, "rate": 6000.0},
    }  # fmt: skip
    return _scene(
        {"lattice": _particle_group(positions, sizes, rng.normal(0.0, 0.3, positions.shape)), "rain": rain}, walls,
        gravity=[0.0, 0.0, -9.81], domain={"min": [-0.01] * 3, "max": [0.07, 0.07, 0.07], "on_exit": "delete"},
        run={"duration": 0.04, "velocity_max": 2.0, "time_step": 4e-6, "precision": precision},
    )  # fmt: skip


def vibrated_box(arch: str, precision: str) -> dict[str, Any]:
    """One run of the vibrated box: counts, energy error, overlap, and a digest of its final state."""
    from granflow.simulation import Simulation

    simulation = Simulation(_vibrated_box(precision), arch=arch, precision=precision)  # type: ignore[arg-type]
    totals = simulation.run().totals
    last = simulation.snapshot().particles
    names = ("id", "position", "velocity", "angular_velocity", "force", "torque", "coordination_number")
    digest = hashlib.sha256(b"".join(np.ascontiguousarray(last[name]).tobytes() for name in names))
    energy_limit = 1e-2 if precision == "f32" else 1e-3
    return {
        "digest": digest.hexdigest(),
        "checks": [
            record("vibrated box: particles missing", totals["particle_count"] - PARTICLE_COUNT[0], 0.0),
            record(
                "vibrated box: deleted particles missing", totals["deleted_count"] - PARTICLE_COUNT[1], 0.0
            ),
            record("vibrated box: energy error", totals["energy_error"], energy_limit),
            record("vibrated box: maximum overlap over radius", totals["overlap_largest"], 0.1),
        ],
    }


def scenes(arch: str, precision: str) -> list[dict[str, Any]]:
    """Scenes of the repository: the start of the hopper, and in f64 the expectations of verification
    scenes."""
    found = hopper(arch, precision)
    if precision != "f64":
        return found
    from granflow.load import load_scene
    from granflow.simulation import Simulation

    for name in VERIFIED:
        scene = load_scene(SCENES / "verification" / f"{name}.yaml", ["numerics.chunk_size=1"])
        simulation = Simulation(scene, arch=arch)  # type: ignore[arg-type]
        messages = [message for message, satisfied in simulation.run().expectations if not satisfied]
        simulation.free()
        result = record(f"{name}: unsatisfied expectations", len(messages), 0.0)
        found.append(result | ({"message": messages} if messages else {}))
    return found


def hopper(arch: str, precision: str) -> list[dict[str, Any]]:
    """Rain of 400 particles into the closed hopper: cone, cylinder, disc, friction, energy budget."""
    from granflow.load import load_scene
    from granflow.simulation import Simulation

    scene = load_scene(SCENES / "hopper.yaml", ["particles.beads.count=400", "numerics.chunk_size=1"])
    simulation = Simulation(scene, arch=arch, precision=precision)  # type: ignore[arg-type]
    totals = simulation.run(until=0.1).totals
    simulation.free()
    return [
        record("hopper: particles missing", totals["particle_count"] - 400.0, 0.0),
        record("hopper: energy error", totals["energy_error"], 1e-2 if precision == "f32" else 1e-3),
        record("hopper: maximum overlap over radius", totals["overlap_largest"], 0.1),
    ]


def trajectory(
    arch: str, precision: str, bed_file: str, out: str, moved: float, chunk_size: int | None
) -> None:
    """Writes the state of a settled bed after TRAJECTORY_STEPS with random velocities of 0.1 m/s.

    `moved` [m] is a displacement of random sign of each initial position.
    """
    case = bed(bed_file, 0)
    rng = np.random.default_rng(11)
    velocity = rng.normal(0.0, 0.1, case.position.shape)
    case.position[:] += moved * rng.choice([-1.0, 1.0], case.position.shape)
    engine = engine_for(case, arch, precision, velocity, chunk_size)
    engine.advance(TRAJECTORY_STEPS)
    snapshot = engine.snapshot("run", frozenset({"particles", "totals"}))
    totals = {name: snapshot.totals[name] for name in ("kinetic_energy", "overlap_largest", "contact_count")}
    arrays: dict[str, Any] = {
        name: np.asarray(snapshot.particles[name], float) for name in ("position", "velocity", "radius")
    }
    np.savez(out, steps=engine.step_count, **totals, **arrays)


def displacement(precision: str, bed_file: str) -> float:
    """Resolution [m] of particle surfaces in a precision: of positions (f64, f32) or of distances (mixed)."""
    extent = float(np.abs(bed(bed_file, 0).position).max())
    return EPS[precision] * (2.0 * RADIUS_MEAN if precision == "mixed" else extent)


def agreement(here: Path, reference: Path, disturbed: Path, margin: float) -> list[dict[str, Any]]:
    """Compares a trajectory with that of the CPU in f64.

    Collisions amplify differences, so that the limit is measured: `margin` times the change of the reference
    if each initial position is displaced by the resolution of the precision. The root mean square bounds the
    energy:
    |dE| / E <= 2 rms(dv) / rms(v).
    """
    one, other, shifted = (dict(np.load(path)) for path in (here, reference, disturbed))

    def max_difference(name: str, first: dict[str, np.ndarray]) -> float:
        return float(np.abs(first[name] - other[name]).max())

    def rms_difference(name: str) -> float:
        return float(np.sqrt(np.mean((shifted[name] - other[name]) ** 2)))

    limit = {name: margin * max_difference(name, shifted) for name in ("position", "velocity")}
    energy = margin * 2.0 * rms_difference("velocity") / float(np.sqrt(np.mean(other["velocity"] ** 2)))
    overlap = margin * 2.0 * rms_difference("position") / float(other["radius"].min())
    diameter = 2.0 * float(other["radius"].mean())
    position = max_difference("position", one)
    return [
        record("steps missing", float(one["steps"]) - TRAJECTORY_STEPS, 0.0),
        record("position difference [diameters]", position / diameter, limit["position"] / diameter),
        record("velocity difference [m/s]", max_difference("velocity", one), limit["velocity"]),
        record("kinetic energy difference", one["kinetic_energy"] / other["kinetic_energy"] - 1.0, energy),
        record(
            "maximum overlap difference [radii]", one["overlap_largest"] - other["overlap_largest"], overlap
        ),
    ]
