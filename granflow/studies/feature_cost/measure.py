"""Timing of all variants of a scene from the same particles, in one process, in alternating rounds.

Alternation cancels slow changes of the clock rate and of the load on the machine.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from time import perf_counter
from typing import Any

import numpy as np

from granflow import GranflowError, ParticleData, Plan, Scene, SceneError, Simulation, estimate_memory
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
    motions: tuple[Any, ...]
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
    arch: str = "cpu",
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

    Raises GranflowError without particles at that time, RunError if a variant aborts, SceneError with clumps.
    """
    for name, group in scene.particles.items():
        if group.clump:
            raise SceneError(
                f"{scene.locate('particles', name, 'clump')}: explain --measure cannot time clumps, because each "
                "variant starts from single particles; give a scene without clumps."
            )
    end = SHARE_BEFORE * scene.longest_duration if until is None else until
    report(f"Running to {end:.3g} s")
    baseline = Simulation(scene, arch=arch, threads=threads)  # type: ignore[arg-type]
    baseline.run(until=end)
    start = start_of(baseline)
    if not len(start.particles):
        raise GranflowError(f"At {end:.4g} s the scene contains no particles to time: give another time with --until.")
    wanted = [each for each in variants_of(scene, baseline.plan) if only is None or each.name in only]
    baseline.free()
    simulations = []
    for variant in wanted:
        report(f"Compiling {variant.name}")
        plan = variant.plan(baseline.plan, on_gpu=arch != "cpu")
        simulations.append(simulation_for(variant, plan, start, arch, threads))
    report(f"Timing {len(simulations)} variants in {rounds} rounds")
    pairs = list(zip(simulations, wanted, strict=True))
    times = np.array([[_nanoseconds(*pair, start) for pair in pairs] for _ in range(rounds + 1)])[1:]
    found = [
        _feature_cost(variant, simulation, times_of_variant, times[:, 0])
        for (simulation, variant), times_of_variant in zip(pairs, times.T, strict=True)
    ]
    for simulation in simulations:
        simulation.free()
    return found


def start_of(simulation: Simulation) -> StartState:
    """Present particles and walls of a simulation."""
    engine, snapshot = simulation.engine, simulation.snapshot()
    names = [name for name in ParticleData.__dataclass_fields__ if name != "orientation"]  # only clumps are turned
    data = ParticleData(*(snapshot.particles[name] for name in names))
    present = tuple(pose.present for pose in snapshot.walls.values())
    return StartState(data, present, engine.state.wall_motions, engine.state.clock.state_dict())


def simulation_for(
    variant: FeatureVariant, plan: Plan, start: StartState, arch: str, threads: int | None
) -> Simulation:
    """Simulation of a variant with the particles and the walls of the start state."""
    particles = _with_materials(start.particles, variant.scene)
    simulation = Simulation(variant.scene, arch=arch, threads=threads, plan=plan, particles=particles)  # type: ignore[arg-type]
    simulation.step(1)  # the first step places the walls of the first stage
    count = len(variant.scene.walls)
    simulation.engine.set_walls(start.present[:count], start.motions[:count])
    return simulation


def restore(simulation: Simulation, variant: FeatureVariant, start: StartState) -> None:
    """Restore particles and time of the start state, with forces and an empty contact history."""
    simulation.engine.state.clock.load_state_dict(start.clock)
    simulation.restart(_with_materials(start.particles, variant.scene))


def _with_materials(particles: ParticleData, scene: Scene) -> ParticleData:
    """The same particles with the materials of their groups in this scene."""
    names = list(scene.materials)
    numbers = np.array([names.index(group.material) for group in scene.particles.values()], dtype=np.int32)
    return replace(particles, material=numbers[particles.group])


def _feature_cost(
    variant: FeatureVariant, simulation: Simulation, times_of_variant: np.ndarray, base: np.ndarray
) -> FeatureCost:
    """Cost of one variant from its times and those of the baseline (rounds,) [ns]."""
    totals, plan = simulation.snapshot().totals, simulation.plan
    return FeatureCost(
        name=variant.name,
        plan=plan,
        nanoseconds=float(np.median(times_of_variant)),
        ratio=tuple(np.percentile(times_of_variant / base, (25, 50, 75)).tolist()),
        bytes_per_particle=estimate_memory(plan, plan.precision).total / plan.particle_capacity,
        compile_seconds=simulation.engine.timing.compile,
        contacts_per_particle=totals["contact_count"] / max(totals["particle_count"], 1.0),
    )


def _nanoseconds(simulation: Simulation, variant: FeatureVariant, start: StartState) -> float:
    """Wall time per particle and step [ns] from the start state, without neighbor-list rebuilds.

    STEPS_BEFORE steps precede the timing of STEPS steps. Raises RunError if the variant aborts.
    """
    restore(simulation, variant, start)
    simulation.step(STEPS_BEFORE)
    rebuild_seconds, began = simulation.engine.timing.neighbor_list, perf_counter()
    simulation.step(STEPS)
    seconds = perf_counter() - began - (simulation.engine.timing.neighbor_list - rebuild_seconds)
    return 1e9 * seconds / (STEPS * max(simulation.snapshot().totals["particle_count"], 1.0))
