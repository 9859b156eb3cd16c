"""All variants of a scene from the same particles, side by side in one process, in turn, many times over."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from time import perf_counter

import numpy as np

from granflow.device.backend import Arch, Backend
from granflow.device.engine import Engine
from granflow.device.limits import abort_message
from granflow.errors import GranflowError, RunError
from granflow.plan import Plan
from granflow.plan.memory_estimate import estimate_memory
from granflow.scene import Scene
from granflow.scene.generate import ParticleData
from granflow.simulation import Simulation
from granflow.study.feature_cost.variants import FeatureVariant, variants_of
from granflow.walls.motion import Motion

SHARE_BEFORE = 1.0 / 3.0
"""Of the scene's longest run, simulated before the timing unless another time is given."""
ROUNDS = 25
STEPS_BEFORE, STEPS = 10, 40
"""Of each timing: steps in which contacts begin to remember, and steps that are timed."""


@dataclass(frozen=True)
class StartState:
    """Where a scene stands when the timing begins: particles in the order of their id, and walls by plan order."""

    particles: ParticleData
    present: tuple[bool, ...]
    motions: tuple[tuple[Motion, ...], ...]
    clock: dict[str, float]


@dataclass(frozen=True)
class FeatureCost:
    """What a step costs with one variant; its ratio is that to the scene as it stands, round by round."""

    name: str
    plan: Plan
    nanoseconds: float
    """Per particle and step, median."""
    ratio: tuple[float, float, float]
    """Lower quartile, median and upper quartile."""
    bytes_per_particle: float
    compile_seconds: float
    contacts_per_particle: float
    """At the end of a timing; a contact between two particles counts once."""


def feature_costs(
    scene: Scene,
    arch: Arch = "cpu",
    threads: int | None = None,
    until: float | None = None,
    report: Callable[[str], None] = lambda words: None,
    rounds: int = ROUNDS,
    only: Sequence[str] | None = None,
) -> list[FeatureCost]:
    """Run a scene to the time `until` [s], then time it as it stands, first in the list, and every variant.

    `only`: names of the variants wanted. Raises GranflowError where no particle is there at that time or where a
    guard stops a variant.
    """
    end = SHARE_BEFORE * _longest(scene) if until is None else until
    report(f"Running to {end:.3g} s")
    simulation = Simulation(scene, arch=arch, threads=threads)
    simulation.run(until=end)
    start, base, backend = start_of(simulation), simulation.plan, simulation.engine.state.backend
    simulation.free()
    if not len(start.particles):
        raise GranflowError(f"At {end:.4g} s no particle is there to time steps on: give another time with --until.")
    wanted = [each for each in variants_of(base) if only is None or each.name in only]
    engines = []
    for variant in wanted:
        report(f"Compiling {variant.name}")
        engines.append(engine_for(variant, base, start, backend))
    report(f"Timing {len(engines)} variants {rounds} times in turn")
    pairs = list(zip(engines, wanted, strict=True))
    times = np.array([[_nanoseconds(*pair, start) for pair in pairs] for _ in range(rounds + 1)])[1:]
    found = [
        _feature_cost(variant, engine, times_of_variant, times[:, 0])
        for (engine, variant), times_of_variant in zip(pairs, times.T, strict=True)
    ]
    for engine in engines:
        engine.free()
    return found


def _longest(scene: Scene) -> float:
    return sum(stage.duration or stage.max_duration or 0.0 for stage in scene.schedule)


def start_of(simulation: Simulation) -> StartState:
    """The particles and walls of a simulation as they are now."""
    engine = simulation.engine
    particles = simulation.snapshot().particles
    data = ParticleData(*(particles[name] for name in ParticleData.__dataclass_fields__))
    present = tuple(pose.present for pose in engine.wall_poses().values())
    return StartState(data, present, engine.state.wall_motions, engine.state.clock.state_dict())


def engine_for(variant: FeatureVariant, base: Plan, start: StartState, backend: Backend) -> Engine:
    """An engine for this variant of the scene with its walls as they stood, and no particles."""
    engine = Engine(variant.plan(base, on_gpu=not backend.on_cpu), backend)
    engine.state.clock.load_state_dict(start.clock)
    count = len(variant.scene.walls)
    engine.set_walls(start.present[:count], start.motions[:count])
    return engine


def restore(engine: Engine, variant: FeatureVariant, start: StartState) -> None:
    """All particles where they stood, forces known, contacts without memory."""
    engine.state.count = 0
    for row in (engine.state.neighbors.list_begin, engine.state.neighbors.list_end):
        row.fill(0)
    engine.state.clock.load_state_dict(start.clock)
    engine.insert(_with_materials(start.particles, variant.scene))
    engine.refresh()


def _with_materials(particles: ParticleData, scene: Scene) -> ParticleData:
    """The same grains of the materials that this scene gives their groups."""
    names = list(scene.materials)
    numbers = np.array([names.index(group.material) for group in scene.particles.values()], dtype=np.int32)
    return replace(particles, material=numbers[particles.group])


def _feature_cost(
    variant: FeatureVariant, engine: Engine, times_of_variant: np.ndarray, base: np.ndarray
) -> FeatureCost:
    """Numbers of one variant from its times and those of the scene as it stands, round by round."""
    plan = engine.plan
    return FeatureCost(
        name=variant.name,
        plan=plan,
        nanoseconds=float(np.median(times_of_variant)),
        ratio=tuple(np.percentile(times_of_variant / base, (25, 50, 75)).tolist()),
        bytes_per_particle=estimate_memory(plan, engine.state.backend.precision).total / plan.particle_capacity,
        compile_seconds=engine.timing.compile,
        contacts_per_particle=engine.contact_statistics.measure()["contact_count"] / max(engine.state.count, 1),
    )


def _nanoseconds(engine: Engine, variant: FeatureVariant, start: StartState) -> float:
    """Wall time per particle and step [ns], from where the particles stood; without the neighbor search."""
    restore(engine, variant, start)
    engine.advance(STEPS_BEFORE)
    rebuild_seconds, began = engine.timing.neighbor_list, perf_counter()
    engine.advance(STEPS)
    times_of_variant = perf_counter() - began - (engine.timing.neighbor_list - rebuild_seconds)
    diagnosis = engine.diagnosis
    if diagnosis is not None:
        raise RunError(abort_message(diagnosis, engine.plan, engine.time))
    return 1e9 * times_of_variant / (STEPS * max(engine.state.count, 1))
