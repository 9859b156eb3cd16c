"""Timing of all variants of a scene from the same particles, in one process, in alternating rounds.

Alternation cancels slow changes of the clock rate and of the load on the machine.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from time import perf_counter

import numpy as np

from granflow.engine.backend import Arch, Backend
from granflow.engine.engine import Engine
from granflow.engine.limits import abort_message
from granflow.errors import GranflowError, RunError
from granflow.geometry.motion import Motion
from granflow.load import Scene
from granflow.particles.generate import ParticleData
from granflow.plan.memory_estimate import estimate_memory
from granflow.plan.plan import Plan
from granflow.simulation import Simulation
from granflow.studies.feature_cost.variants import FeatureVariant, variants_of

SHARE_BEFORE = 1.0 / 3.0
"""Default simulated time before the timing, over the longest run time of the scene."""
ROUNDS = 25
"""Number of timings of each variant."""

STEPS_BEFORE, STEPS = 10, 40
"""Steps of each timing: warm-up steps that build the contact history, and timed steps."""


@dataclass(frozen=True)
class StartState:
    """State at the start of the timing: particles in the order of their ids, and walls in plan order.

    `present`: of each wall; `motions`: of each wall; `clock`: state of the simulated clock.
    """

    particles: ParticleData
    present: tuple[bool, ...]
    motions: tuple[tuple[Motion, ...], ...]
    clock: dict[str, float]


@dataclass(frozen=True)
class FeatureCost:
    """Cost of a step of one variant.

    `ratio` is relative to the baseline of the same round, so that slow changes of the machine load cancel.
    """

    name: str
    plan: Plan
    nanoseconds: float
    """Wall time per particle and step [ns], median."""
    ratio: tuple[float, float, float]
    """Lower quartile, median and upper quartile."""
    bytes_per_particle: float
    compile_seconds: float
    contacts_per_particle: float
    """Contacts at the end of a timing; a contact between two particles counts once."""


def feature_costs(
    scene: Scene,
    arch: Arch = "cpu",
    threads: int | None = None,
    until: float | None = None,
    report: Callable[[str], None] = lambda text: None,
    rounds: int = ROUNDS,
    only: Sequence[str] | None = None,
) -> list[FeatureCost]:
    """Run a scene to the time `until` [s], then time the baseline, first in the list, and every variant.

    `until` is by default SHARE_BEFORE of the longest run time. `threads`: CPU threads, None for all available.
    `rounds`: timings of each variant, alternating between the variants after one round of warm-up. `only`: names of the
    requested variants. `report` receives progress messages.

    Raises GranflowError without particles at that time, RunError if a variant aborts.
    """
    end = SHARE_BEFORE * _longest(scene) if until is None else until
    report(f"Running to {end:.3g} s")
    simulation = Simulation(scene, arch=arch, threads=threads)
    simulation.run(until=end)
    start, base, backend = start_of(simulation), simulation.plan, simulation.engine.state.backend
    simulation.free()
    if not len(start.particles):
        raise GranflowError(f"At {end:.4g} s the scene contains no particles to time: give another time with --until.")
    wanted = [each for each in variants_of(scene, base) if only is None or each.name in only]
    engines = []
    for variant in wanted:
        report(f"Compiling {variant.name}")
        engines.append(engine_for(variant, base, start, backend))
    report(f"Timing {len(engines)} variants in {rounds} rounds")
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
    """Longest run time of the scene [s]: sum over the stages."""
    return sum(stage.duration or stage.max_duration or 0.0 for stage in scene.schedule)


def start_of(simulation: Simulation) -> StartState:
    """Current particles and walls of a simulation."""
    engine = simulation.engine
    particles = simulation.snapshot().particles
    data = ParticleData(*(particles[name] for name in ParticleData.__dataclass_fields__))
    present = tuple(pose.present for pose in engine.wall_poses().values())
    return StartState(data, present, engine.state.wall_motions, engine.state.clock.state_dict())


def engine_for(variant: FeatureVariant, base: Plan, start: StartState, backend: Backend) -> Engine:
    """Engine for a variant with the walls of the start state, without particles."""
    engine = Engine(variant.plan(base, on_gpu=not backend.on_cpu), backend)
    engine.state.clock.load_state_dict(start.clock)
    count = len(variant.scene.walls)
    engine.set_walls(start.present[:count], start.motions[:count])
    return engine


def restore(engine: Engine, variant: FeatureVariant, start: StartState) -> None:
    """Restore the particles of the start state, with forces and an empty contact history.

    The particles have the materials of the scene of the variant.
    """
    engine.state.count = 0
    for row in (engine.state.neighbors.list_begin, engine.state.neighbors.list_end):
        row.fill(0)
    engine.state.clock.load_state_dict(start.clock)
    engine.insert(_with_materials(start.particles, variant.scene))
    engine.refresh()


def _with_materials(particles: ParticleData, scene: Scene) -> ParticleData:
    """The same particles with the materials of their groups in this scene."""
    names = list(scene.materials)
    numbers = np.array([names.index(group.material) for group in scene.particles.values()], dtype=np.int32)
    return replace(particles, material=numbers[particles.group])


def _feature_cost(
    variant: FeatureVariant, engine: Engine, times_of_variant: np.ndarray, base: np.ndarray
) -> FeatureCost:
    """Cost of one variant from its times and those of the baseline (rounds,) [ns]."""
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
    """Wall time per particle and step [ns] from the start state, without neighbor-list rebuilds.

    STEPS_BEFORE steps precede the timing of STEPS steps. Raises RunError if the variant aborts.
    """
    restore(engine, variant, start)
    engine.advance(STEPS_BEFORE)
    rebuild_seconds, began = engine.timing.neighbor_list, perf_counter()
    engine.advance(STEPS)
    seconds = perf_counter() - began - (engine.timing.neighbor_list - rebuild_seconds)
    diagnosis = engine.diagnosis
    if diagnosis is not None:
        raise RunError(abort_message(diagnosis, engine.plan, engine.time))
    return 1e9 * seconds / (STEPS * max(engine.state.count, 1))
