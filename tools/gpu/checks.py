"""Correctness on one device in one precision. Each check is a number and the limit it must keep.

Jobs of children, which return records {name, value, limit, passed}; a GPU works out every contact from both sides
(chunks of one particle), and so do these checks on a CPU.
"""

import hashlib
import logging
from pathlib import Path
from typing import Any

import numpy as np
from benchmark.cases import RADIUS_MEAN

from gpu.beds import bed, engine_for

SCENES = Path(__file__).resolve().parents[2] / "scenes"
VERIFIED = ("unequal_spheres", "wall_limit", "chung_ooi_3", "conveyor", "incline", "stack_at_rest", "mfix_slip_to_roll")
"""Scenes under verification/ with closed forms: pairs, walls, moving walls, friction, rest, rolling."""
STEPS = 400
EPS = {"f64": float(np.finfo(np.float64).eps), "mixed": float(np.finfo(np.float32).eps)}
EPS["f32"] = EPS["mixed"]
SPREAD = 6.0
"""Standard deviations that rounding may reach."""
TRAJECTORY_STEPS = 1000
PARTICLE_COUNT = (256, 60)
"""In the shaken box: those that stay and those that rain in upwards and leave the domain."""


def record(name: str, value: float, limit: float) -> dict[str, Any]:
    """A check: passed where |value| is no more than the limit; a value that is no number has failed."""
    return {"name": name, "value": float(value), "limit": float(limit), "passed": bool(abs(value) <= limit)}


def collisions(arch: str, precision: str) -> list[dict[str, Any]]:
    """Head-on collisions of every law, and one with a wall, against the closed forms.

    A collision of n steps is right to about 1/n; coarse positions add the length they resolve over the overlap.
    """
    from granflow.laws.catalog import NORMAL_LAWS
    from granflow.study.collide import collide

    logging.getLogger("granflow").setLevel(logging.ERROR)  # f32 warns that it is coarse: the limit knows
    found, diameter = [], 4e-3
    resolved = EPS[precision] * diameter * (10.0 if precision == "f32" else 1.0)
    for law, wall in [*((law, False) for law in NORMAL_LAWS), ("zhou", True)]:
        requested: dict[str, Any] = {} if NORMAL_LAWS[law].restitution == "nothing" else {"restitution": 0.7}
        numbers = collide(
            law, "stainless_316", diameter, 0.5, wall=wall, steps_per_contact=STEPS, precision=precision, arch=arch,
            **requested,
        )  # fmt: skip
        limit = 1.0 / STEPS + resolved / numbers["overlap_max"]
        for name in ("restitution", "duration", "overlap_max", "force_max"):
            closed = numbers.get(f"{name}_asked", numbers.get(f"{name}_theory", 0.0))
            where = f"{law} on a wall" if wall else law
            found.append(record(f"{name} of {where}", numbers[name] / closed - 1.0, limit))
    return found


def momentum(arch: str, precision: str, bed_file: str) -> list[dict[str, Any]]:
    """A cloud bursts without walls or gravity: its momentum stays, but for the rounding of each velocity in each step.

    The rounding is at random: half an ulp, the root of the steps, times the root of the sum of squares of m v.
    """
    from granflow.device.backend import start
    from granflow.simulation import Simulation

    start(arch, precision)  # type: ignore[arg-type]
    simulation = Simulation(_cloud(bed_file, precision), arch=arch, precision=precision)  # type: ignore[arg-type]
    seen = [simulation.snapshot()]
    simulation.run()
    seen.append(simulation.snapshot())
    before, after = (each.particles["mass"][:, None] * each.particles["velocity"] for each in seen)
    met = float(np.any(after != before, axis=1).mean())
    steps = simulation.engine.step_count
    bound = SPREAD * 0.5 * EPS[precision] * np.sqrt(steps) * np.linalg.norm(after)
    drift = np.linalg.norm(after.sum(axis=0) - before.sum(axis=0))
    return [record("momentum drift over rounding", drift / bound, 1.0), record("grains left untouched", 1.0 - met, 0.2)]


def _cloud(bed_file: str, precision: str) -> Any:
    """Spheres of a settled bed thrown at each other, none near a wall."""
    case, rng = bed(bed_file, 0), np.random.default_rng(7)
    middle = case.position.mean(axis=0)
    saved = np.argsort(np.linalg.norm(case.position - middle, axis=1))[:1000]
    position = case.position[saved] - middle
    return _scene(
        {"balls": _balls(position, case.diameter[saved], rng.normal(0.0, 0.3, position.shape))},
        walls={}, gravity=[0.0, 0.0, 0.0], run={"duration": 0.005, "velocity_max": 1.0, "precision": precision},
    )  # fmt: skip


def _balls(position: np.ndarray, diameter: Any, velocity: np.ndarray) -> dict[str, Any]:
    insertion = {"kind": "positions", "positions": position.tolist()}
    sizes = np.asarray(diameter).tolist()
    return {
        "material": "m", "count": len(position), "diameter": sizes, "velocity": velocity.tolist(), "insert": insertion
    }  # fmt: skip


def _scene(groups: dict[str, Any], walls: dict[str, Any], **parts: Any) -> Any:
    from granflow.scene import Scene

    same = {
        "title": "GPU check",
        "materials": {"m": {"young_modulus": 1e7, "poisson_ratio": 0.25, "density": 2500.0}},
        "pairs": {"m-m": {"restitution": 0.6, "friction": 0.4, "rolling_friction": 0.05}},
        "contact": {"normal": "zhou", "tangential": "mindlin", "rolling": "epsd"},
        "domain": {"min": [-0.1] * 3, "max": [0.1] * 3, "on_exit": "delete"},
        "numerics": {"chunk_size": 1},
        "output": {"interval": 1.0, "energy_budget": True},
    }
    return Scene.model_validate(same | {"walls": walls, "particles": groups} | parts)


def _shaken(precision: str) -> Any:
    """A lattice falls into a shaken box; grains rain in upwards and leave the domain. Friction, rolling, the ledger."""
    rng = np.random.default_rng(4)
    insertion = 0.0065 * (np.argwhere(np.ones((8, 8, 4))) + 0.75)
    walls: dict[str, Any] = {}
    for axis, name in enumerate("xyz"):
        unit = np.eye(3)[axis]
        walls[f"low_{name}"] = {"shape": "plane", "point": [0.0] * 3, "normal": unit.tolist(), "material": "m"}
        if name != "z":
            far = {"point": (0.06 * unit).tolist(), "normal": (-unit).tolist()}
            walls[f"high_{name}"] = {"shape": "plane", "material": "m", **far}
    motion = {"kind": "vibration", "direction": [0, 0, 1], "amplitude": 1e-3, "frequency": 60.0}
    walls["low_z"] |= {"motion": motion}
    sizes = rng.uniform(0.004, 0.006, len(insertion))
    room = {"box": {"min": [0.005, 0.005, 0.045], "max": [0.055, 0.055, 0.059]}}
    rain = {
        "material": "m", "count": PARTICLE_COUNT[1], "diameter": 0.005, "velocity": [0.0, 0.0, 1.5],
        "insert": {"kind": "rain", "region": room, "rate": 6000.0},
    }  # fmt: skip
    return _scene(
        {"lattice": _balls(insertion, sizes, rng.normal(0.0, 0.3, insertion.shape)), "rain": rain}, walls,
        gravity=[0.0, 0.0, -9.81], domain={"min": [-0.01] * 3, "max": [0.07, 0.07, 0.07], "on_exit": "delete"},
        run={"duration": 0.04, "velocity_max": 2.0, "time_step": 4e-6, "precision": precision},
    )  # fmt: skip


def shaken(arch: str, precision: str) -> dict[str, Any]:
    """The shaken box once: counts, ledger, overlap, and a digest of all that is left behind, to compare two runs."""
    from granflow.simulation import Simulation

    simulation = Simulation(_shaken(precision), arch=arch, precision=precision)  # type: ignore[arg-type]
    totals = simulation.run().totals
    last = simulation.snapshot().particles
    names = ("id", "position", "velocity", "angular_velocity", "force", "torque", "coordination_number")
    digest = hashlib.sha256(b"".join(np.ascontiguousarray(last[name]).tobytes() for name in names))
    coarse = 1e-2 if precision == "f32" else 1e-3
    return {
        "digest": digest.hexdigest(),
        "checks": [
            record("shaken box: grains missing", totals["particle_count"] - PARTICLE_COUNT[0], 0.0),
            record("shaken box: deleted grains missing", totals["deleted_count"] - PARTICLE_COUNT[1], 0.0),
            record("shaken box: energy error", totals["energy_error"], coarse),
            record("shaken box: largest overlap over radius", totals["overlap_largest"], 0.1),
        ],
    }


def scenes(arch: str, precision: str) -> list[dict[str, Any]]:
    """Scenes of the repository: in f64 their own expectations, and in any precision the start of the hopper."""
    found = hopper(arch, precision)
    if precision != "f64":
        return found
    from granflow.scene import load
    from granflow.simulation import Simulation

    for name in VERIFIED:
        scene = load(SCENES / "verification" / f"{name}.yaml", ["numerics.chunk_size=1"])
        simulation = Simulation(scene, arch=arch)  # type: ignore[arg-type]
        unmet = [sentence for sentence, met in simulation.run().expectations if not met]
        simulation.free()
        found.append(record(f"{name}: expectations unmet", len(unmet), 0.0) | ({"said": unmet} if unmet else {}))
    return found


def hopper(arch: str, precision: str) -> list[dict[str, Any]]:
    """400 beads rain into the closed hopper: cone, cylinder, disc, friction, the ledger."""
    from granflow.scene import load
    from granflow.simulation import Simulation

    scene = load(SCENES / "hopper.yaml", ["particles.beads.count=400", "numerics.chunk_size=1"])
    simulation = Simulation(scene, arch=arch, precision=precision)  # type: ignore[arg-type]
    totals = simulation.run(until=0.1).totals
    simulation.free()
    return [
        record("hopper: grains missing", totals["particle_count"] - 400.0, 0.0),
        record("hopper: energy error", totals["energy_error"], 1e-2 if precision == "f32" else 1e-3),
        record("hopper: largest overlap over radius", totals["overlap_largest"], 0.1),
    ]


def trajectory(arch: str, precision: str, bed_file: str, out: str, moved: float, chunk_size: int | None) -> None:
    """A settled bed stirred at 0.1 m/s for some steps, into a file; `moved` [m] displaces each start at random."""
    case, rng = bed(bed_file, 0), np.random.default_rng(11)
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
    """Length [m] to which a precision knows where a surface is: of positions (f64, f32), or of distances (mixed)."""
    reach = float(np.abs(bed(bed_file, 0).position).max())
    return EPS[precision] * (2.0 * RADIUS_MEAN if precision == "mixed" else reach)


def agreement(here: Path, reference: Path, disturbed: Path, margin: float) -> list[dict[str, Any]]:
    """A trajectory against that of the CPU in f64.

    The limit is measured, too: `margin` times what the reference changes when every start is displaced by the length
    that the precision resolves, as collisions amplify whatever differs. The root mean square bounds the energy:
    |dE| / E <= 2 rms(dv) / rms(v).
    """
    one, other, shifted = (dict(np.load(path)) for path in (here, reference, disturbed))

    def apart(name: str, first: dict[str, np.ndarray]) -> float:
        return float(np.abs(first[name] - other[name]).max())

    def mean_apart(name: str) -> float:
        return float(np.sqrt(np.mean((shifted[name] - other[name]) ** 2)))

    limit = {name: margin * apart(name, shifted) for name in ("position", "velocity")}
    energy = margin * 2.0 * mean_apart("velocity") / float(np.sqrt(np.mean(other["velocity"] ** 2)))
    overlap = margin * 2.0 * mean_apart("position") / float(other["radius"].min())
    diameter = 2.0 * float(other["radius"].mean())
    return [
        record("steps missing", float(one["steps"]) - TRAJECTORY_STEPS, 0.0),
        record("position off the CPU's [diameters]", apart("position", one) / diameter, limit["position"] / diameter),
        record("velocity off the CPU's [m/s]", apart("velocity", one), limit["velocity"]),
        record("kinetic energy off the CPU's", one["kinetic_energy"] / other["kinetic_energy"] - 1.0, energy),
        record("largest overlap off the CPU's [radii]", one["overlap_largest"] - other["overlap_largest"], overlap),
    ]
