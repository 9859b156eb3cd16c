"""Jobs of granflow in a separate process: measurement of a case, settling of a bed. Taichi starts once per
process."""

import resource
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmark import cases, loops
from benchmark.cases import Case

MATERIAL = f"""
gravity: [0, 0, {-cases.GRAVITY}]
materials:
  m: {{{{young_modulus: {cases.YOUNG_MODULUS}, poisson_ratio: {cases.POISSON_RATIO}, density: {cases.DENSITY}}}}}
"""
BED = """
title: Settled bed
pairs: {{m-m: {{restitution: {restitution}, friction: {friction}}}}}
contact: {{normal: {normal}, tangential: mindlin, rolling: none}}
walls:
  floor: {{shape: plane, point: [0, 0, 0], normal: [0, 0, 1], material: m}}
  left: {{shape: plane, point: [0, 0, 0], normal: [1, 0, 0], material: m}}
  right: {{shape: plane, point: [{x}, 0, 0], normal: [-1, 0, 0], material: m}}
  front: {{shape: plane, point: [0, 0, 0], normal: [0, 1, 0], material: m}}
  back: {{shape: plane, point: [0, {y}, 0], normal: [0, -1, 0], material: m}}
particles: {{grains: {{material: m, count: {count}, diameter: {sizes}, insert: {place}}}}}
domain: {{min: [-0.01, -0.01, -0.01], max: [{x_high}, {y_high}, 2], on_exit: error}}
run: {{duration: {duration}, time_step: {time_step}, velocity_max: 0.3 m/s, precision: {precision}}}
numerics: {{skin: {skin}}}
output: {{interval: 10 s}}
"""
"""The group name is part of the seed of the diameters: another name gives other settled beds."""
HOPPER = """
title: Hopper
pairs: {{m-m: {{restitution: {restitution}, friction: {friction}}}}}
contact: {{normal: {normal}, tangential: mindlin, rolling: none}}
walls:
  cone: {{shape: cone, from: [0, 0, 0], to: [0, 0, {cone}], radius_from: {orifice}, radius_to: {tube}, material: m}}
  tube: {{shape: cylinder, from: [0, 0, {cone}], to: [0, 0, {top}], radius: {tube}, material: m}}
particles: {{beads: {{material: m, count: {count}, diameter: {sizes}, insert: {place}}}}}
domain: {{min: [-{reach}, -{reach}, {floor}], max: [{reach}, {reach}, 1], on_exit: delete}}
run: {{duration: 1 s, time_step: {time_step}, velocity_max: 1.5 m/s, precision: {precision}}}
numerics: {{skin: {skin}}}
output: {{interval: 10 s}}
"""
NORMAL = {
    "hertz": "hertz",
    "zhou": "zhou",
    "linear": f"{{law: linear, stiffness: {{value: {cases.LINEAR_STIFFNESS} N/m}}}}",
}


def scene_text(case: Case, law: str, precision: str, skin: str) -> str:
    """The case as a scene; its group defines count and sizes, the particles are inserted as arrays."""
    low, high = float(case.diameter.min()), float(case.diameter.max())
    sizes = f"{{distribution: uniform, min: {low}, max: {high}}}" if low < high else low
    x, y = case.sides
    common = {
        "restitution": cases.RESTITUTION, "friction": cases.FRICTION, "normal": NORMAL[law], "count": case.count,
        "sizes": sizes, "precision": precision, "skin": skin,
        "time_step": cases.TIME_STEP, "place": f"{{kind: lattice, region: {{box: {region(case)}}}}}",
    }  # fmt: skip
    if case.kind == "bed":
        return (MATERIAL + BED).format(**common, x=x, y=y, x_high=x + 0.01, y_high=y + 0.01, duration=1)
    return (MATERIAL + HOPPER).format(
        **common, cone=cases.CONE_HEIGHT, orifice=cases.ORIFICE_RADIUS, tube=cases.TUBE_RADIUS, top=cases.TUBE_TOP,
        reach=cases.HOPPER_REACH, floor=cases.HOPPER_FLOOR
    )  # fmt: skip


def region(case: Case) -> str:
    """Insertion region of the scene; it is not used, since the particles are inserted as arrays."""
    if case.kind == "bed":
        return f"{{min: [0, 0, 0], max: [{case.sides[0]}, {case.sides[1]}, 1.9]}}"
    half = 0.5 * cases.TUBE_RADIUS
    return f"{{min: [-{half}, -{half}, {cases.CONE_HEIGHT}], max: [{half}, {half}, {cases.TUBE_TOP}]}}"


def scene_for(case: Case, law: str, precision: str, skin: str) -> Any:
    """The scene of the case."""
    from granflow import load_scene

    with tempfile.TemporaryDirectory() as folder:
        scene_file = Path(folder) / "case.yaml"
        scene_file.write_text(scene_text(case, law, precision, skin))
        return load_scene(scene_file)


def simulation_for(
    case: Case, law: str, precision: str, threads: int, skin: str, communicator: Any = None
) -> Any:
    """Simulation with the particles of the case, before the first step."""
    from granflow import ParticleData, Simulation

    zeros = np.zeros((case.count, 3))
    zero_indices = np.zeros(case.count, np.int32)
    particles = ParticleData(case.position, zeros, zeros, 0.5 * case.diameter, zero_indices, zero_indices)
    scene = scene_for(case, law, precision, skin)
    return Simulation(scene, threads=threads, particles=particles, communicator=communicator)


def engine_for(case: Case, law: str, precision: str, threads: int, skin: str) -> Any:
    """Engine of the simulation after the first step, which sets the walls, for measurements of its phases."""
    simulation = simulation_for(case, law, precision, threads, skin)
    simulation.step(1)
    return simulation.engine


def measure(
    path: str, law: str, precision: str, threads: int, skin: str, warm: int, window: int
) -> dict[str, Any]:  # fmt: skip
    """Rate of one time window [particle-steps/s], memory, contacts, rebuilds; first_step in s since 1970.

    share_of_loops: time of the two loops in C++ over that of a step, rebuilds included.
    """
    case = Case.load(Path(path))
    simulation = simulation_for(case, law, precision, threads, skin)
    found = measured(simulation, case, warm, window)
    in_cpp = loops.seconds(simulation.engine, law, precision, threads)
    share = None if in_cpp is None else found["rate"] * sum(in_cpp.values()) / case.count
    return found | {"loops": in_cpp, "share_of_loops": share}


def measure_on_ranks(
    path: str, law: str, precision: str, threads: int, skin: str, warm: int, window: int
) -> dict[str, Any] | None:  # fmt: skip
    """As `measure`, on the ranks of mpirun with one thread each; None on all but the root. `threads` has no
    effect."""
    from granflow.engine.backend import start
    from granflow.parallel.communicator import Communicator
    from granflow.parallel.rank_engine import RankEngine, controlling, serve
    from granflow.plan.build import plan_for

    case = Case.load(Path(path))
    communicator = Communicator()
    if communicator.is_root:
        with controlling(communicator):
            return measured(simulation_for(case, law, precision, 1, skin, communicator), case, warm, window)
    scene = scene_for(case, law, precision, skin)
    serve(
        communicator,
        lambda: RankEngine(plan_for(scene), start("cpu", scene.run.precision, 1), communicator),
    )
    return None


def measured(simulation: Any, case: Case, warm: int, window: int) -> dict[str, Any]:
    """The result of `measure` for a simulation before its first step."""
    simulation.step(1)
    first_step = time.time()
    simulation.step(warm)
    timing = simulation.engine.timing
    above = mass_above(simulation)
    before = replace(timing)
    began = time.perf_counter()
    simulation.step(window)
    seconds = time.perf_counter() - began
    rebuilds = timing.rebuild_count - before.rebuild_count
    memory = peak_memory()
    span = window * cases.TIME_STEP
    return {
        "rate": window * case.count / seconds,
        "first_step": first_step,
        "compile": timing.compile,
        "memory": memory,
        "field_bytes": field_bytes(simulation.engine) / case.count,
        "contacts": particle_contacts(simulation) / case.count,
        "rebuilds": 1000.0 * rebuilds / window,
        "mass_flow": (above - mass_above(simulation)) / span if case.kind == "hopper" else None,
        "exchange": (timing.exchange - before.exchange) / seconds,
        "waiting": (timing.waiting - before.waiting) / seconds,
    }


def mass_above(simulation: Any) -> float:
    """Mass whose centers are above the orifice [kg]."""
    particles = simulation.snapshot().particles
    return float(particles["mass"][particles["position"][:, 2] > 0.0].sum())


def particle_contacts(simulation: Any) -> int:
    """Number of contacts between two particles."""
    contacts = simulation.snapshot(contacts=True).contacts
    return int((contacts["id_j"] >= 0).sum())


def field_bytes(engine: Any) -> int:
    """Size of all fields of the state on the device [bytes]."""
    return sum(field_size(field) for field in engine.state._block.fields)


def field_size(field: Any) -> int:
    """Size of one Taichi field [bytes], without overhead of the allocator."""
    components = getattr(field, "n", 1) * getattr(field, "m", 1)
    return int(np.prod(field.shape)) * components * (8 if "64" in str(field.dtype) else 4)


def peak_memory() -> int:
    """Peak resident memory of this process [bytes]."""
    unit = 1 if sys.platform == "darwin" else 1024
    return unit * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def relax(count: int, path: str, threads: int | None) -> None:
    """Settles a loose lattice of particles in a square box about as wide as the bed is high."""
    from granflow import Simulation, load_scene

    side = round((count * 4.0 / 3.0 * np.pi * cases.RADIUS_MEAN**3 / 0.6) ** (1.0 / 3.0) * 0.95, 4)
    edge = 0.5 * 2.2 * cases.RADIUS_MEAN
    box = f"{{min: [0, 0, 0], max: [{side}, {side}, {3 * side + 4 * edge}]}}"
    low, high = 1.8 * cases.RADIUS_MEAN, 2.2 * cases.RADIUS_MEAN
    text = (MATERIAL + BED).format(
        restitution=0.3, friction=cases.FRICTION, normal="hertz", x=side, y=side, x_high=side + 0.01,
        y_high=side + 0.01, count=count, sizes=f"{{distribution: uniform, min: {low}, max: {high}}}",
        place=f"{{kind: lattice, region: {{box: {box}}}, jitter: 0.5}}", time_step=2 * cases.TIME_STEP,
        precision="f64", skin="0.4 mm", duration="0.6 s"
    )  # fmt: skip
    with tempfile.TemporaryDirectory() as folder:
        scene_file = Path(folder) / "settle.yaml"
        scene_file.write_text(text)
        simulation = Simulation(load_scene(scene_file), threads=threads)
        simulation.run()
    particles = simulation.snapshot().particles
    Case(f"bed {count}", "bed", 2.0 * particles["radius"], particles["position"], (side, side)).save(
        Path(path)
    )
