"""Cost of each feature of a scene: time, memory and compile time of a step with and without it.

The scene runs to a given time. From its particles at that time, variants with one feature switched on or off
run short sequences of steps in alternating rounds, in one process; alternation cancels slow changes of the
clock rate and of the load on the machine. `text` is the table in Markdown.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from time import perf_counter
from typing import Any, Literal

import numpy as np

from granflow import (
    GranflowError,
    ParticleData,
    Plan,
    Scene,
    SceneError,
    Simulation,
    estimate_memory,
    plan_for,
)
from granflow.scene.blocks.contact import Contact
from granflow.scene.blocks.materials import MaterialPair

# Variants of a scene, each with one feature switched on or off.
#
# A feature that is forced on without effect on the motion shows the cost of its code alone.

FRICTION, ROLLING_FRICTION = 0.3, 0.02
"""Coefficients of every pair if a variant adds the feature to the scene."""


@dataclass(frozen=True)
class FeatureVariant:
    """A scene, and the features that its plan includes although the scene does not require them.

    `forced_features`: values of fields of `plan.features.Features` by name.
    """

    name: str
    scene: Scene
    forced_features: dict[str, Any] = field(default_factory=dict)

    def plan(self, base: Plan, on_gpu: bool) -> Plan:
        """Plan of this variant with the time step and the skin of the baseline, so that the same work is
        timed."""
        free = self.scene.run.model_copy(update={"time_step": "auto"})
        domain = self.scene.domain.model_copy(update={"on_exit": "delete"})
        plan = plan_for(self.scene.model_copy(update={"run": free, "domain": domain}), on_gpu)
        features = replace(plan.features, **self.forced_features)
        return replace(plan, features=features, step=base.step, skin=base.skin)


def variants_of(scene: Scene, plan: Plan) -> list[FeatureVariant]:
    """Baseline and all variants with one feature changed that do not require other particle positions."""
    features = plan.features
    laws = plan.laws
    return [
        FeatureVariant("baseline", scene),
        *_without_rotational_features(scene, plan),
        *([] if laws.has_tangential else [FeatureVariant("with friction", _with_friction(scene, FRICTION))]),
        *(
            [FeatureVariant("with rolling friction", _with_rolling(scene, "epsd"))]
            if "rolling" not in laws.by_slot
            else []
        ),
        *_without_history(scene, plan),
        *([FeatureVariant("without cohesion", _without_cohesion(scene))] if laws.has_cohesion else []),
        *_other_walls(scene, plan),
        *_other_materials(scene, plan),
        FeatureVariant(
            f"{'without' if features.energy_budget else 'with'} energy budget",
            _with_energy_budget(scene, not features.energy_budget),
        ),
        FeatureVariant("without all of these", _minimal(scene)),
    ]


def _without_rotational_features(scene: Scene, plan: Plan) -> Iterator[FeatureVariant]:
    """Variants without friction, without rolling friction, and without rotation, which excludes both."""
    laws = plan.laws
    if laws.has_tangential:
        yield FeatureVariant("without friction", _with_friction(scene, 0.0), {"rotation": True})
    if "rolling" in laws.by_slot:
        yield FeatureVariant("without rolling friction", _with_rolling(scene, "none"), {"rotation": True})
    if plan.features.rotation:
        yield FeatureVariant("without rotation", _without_rotation(scene))


def _without_history(scene: Scene, plan: Plan) -> Iterator[FeatureVariant]:
    """Variants with elastic Hertz contacts, which have no normal history, and without any contact history."""
    elastic = _elastic(scene)
    if plan.laws.normal.history_names:
        yield FeatureVariant("without normal history", elastic)
    elif plan.features.rate_dependent:
        yield FeatureVariant("without damping", elastic)
    if plan.history:
        yield FeatureVariant(
            "without any history", _without_rotation(elastic), {"rotation": plan.features.rotation}
        )


def _other_walls(scene: Scene, plan: Plan) -> Iterator[FeatureVariant]:
    """Variants without walls, and with the code for moving walls.

    No variant stops a moving wall: its position would differ.
    """
    if plan.features.walls:
        yield FeatureVariant("without walls", scene.model_copy(update={"walls": {}}))
    if plan.features.walls and not plan.features.moving_walls:
        yield FeatureVariant("with moving walls", scene, {"moving_walls": True})


def _other_materials(scene: Scene, plan: Plan) -> Iterator[FeatureVariant]:
    """Variants with several sizes, and with several materials, or with one material if the scene has
    several."""
    if plan.features.one_size:
        yield FeatureVariant("with several sizes", scene, {"one_size": False})
    if plan.features.one_material:
        yield FeatureVariant("with several materials", scene, {"one_material": False})
        return
    one_material = _of_one_material(scene)
    if one_material is not None:
        yield FeatureVariant("with one material", one_material)


def _minimal(scene: Scene) -> Scene:
    """Minimal scene: elastic particles of one material, without walls, rotation, cohesion and energy
    budget."""
    minimal = _with_energy_budget(_without_cohesion(_without_rotation(_elastic(scene))), False)
    return (_of_one_material(minimal) or minimal).model_copy(update={"walls": {}})


def _without_rotation(scene: Scene) -> Scene:
    """The scene without friction and rolling friction, so that its plan has no rotation."""
    return _with_rolling(_with_friction(scene, 0.0), "none")


def _with_friction(scene: Scene, friction: float) -> Scene:
    """The scene with one friction coefficient for all pairs; 0 switches friction off."""
    with_friction = _with_pairs(scene, friction=friction)
    return _with_contact(with_friction, tangential="mindlin") if friction else with_friction


def _with_rolling(scene: Scene, rolling: Literal["none", "epsd"]) -> Scene:
    """The scene with a rolling model; missing coefficients are set to ROLLING_FRICTION."""
    pairs = {name: _rolling_pair(pair) for name, pair in scene.pairs.items()}
    return _with_contact(scene.model_copy(update={"pairs": pairs}), rolling=rolling)


def _rolling_pair(pair: MaterialPair) -> MaterialPair:
    """The pair with its rolling friction, or ROLLING_FRICTION if it has none."""
    return pair.model_copy(
        update={"rolling_friction": pair.model_dump()["rolling_friction"] or ROLLING_FRICTION}
    )


def _elastic(scene: Scene) -> Scene:
    """Hertz's model without dissipation."""
    given = scene.contact.model_dump(by_alias=True, exclude_none=True) | {"normal": "hertz"}
    lossless = _with_pairs(scene, restitution=1.0)
    return lossless.model_copy(update={"contact": Contact.model_validate(given)})


def _without_cohesion(scene: Scene) -> Scene:
    """The scene without cohesion."""
    return _with_contact(scene, cohesion="none")


def _with_energy_budget(scene: Scene, on: bool) -> Scene:
    """The scene with the energy budget switched on or off."""
    return scene.model_copy(update={"output": scene.output.model_copy(update={"energy_budget": on})})


def _of_one_material(scene: Scene) -> Scene | None:
    """All particles of the most frequent material.

    None if the scene does not define the pairs of this material with itself and all wall materials.
    """
    material = max(scene.particles.values(), key=lambda group: group.count).material
    walls = {wall.material for wall in scene.walls.values()}
    if not all(scene.pair_key(material, other) in scene.pairs for other in {material, *walls}):
        return None
    groups = {
        name: group.model_copy(update={"material": material}) for name, group in scene.particles.items()
    }
    return scene.model_copy(update={"particles": groups})


def _with_pairs(scene: Scene, **values: float) -> Scene:
    """The scene with the same values for all pairs."""
    pairs = {name: pair.model_copy(update=values) for name, pair in scene.pairs.items()}
    return scene.model_copy(update={"pairs": pairs})


def _with_contact(scene: Scene, **values: str) -> Scene:
    """The scene with changed contact models."""
    return scene.model_copy(update={"contact": scene.contact.model_copy(update=values)})


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

    `until` is by default SHARE_BEFORE of the longest run time. `threads`: CPU threads, None for all
    available. `rounds`: timings of each variant, alternating between the variants after one round of warm-up.
    `only`: names of the requested variants. `report` receives progress messages.

    Raises GranflowError without particles at that time, RunError if a variant aborts, SceneError with clumps.
    """
    for name, group in scene.particles.items():
        if group.shape.rotates:
            raise SceneError(
                f"{scene.locate('particles', name, 'clump')}: the cost of features cannot be measured "
                "with clumps, because each variant starts from single particles; give a scene without clumps."
            )
    end = SHARE_BEFORE * scene.longest_duration if until is None else until
    report(f"Running to {end:.3g} s")
    baseline = Simulation(scene, arch=arch, threads=threads)  # type: ignore[arg-type]
    baseline.run(until=end)
    start = start_of(baseline)
    if not len(start.particles):
        raise GranflowError(
            f"At {end:.4g} s the scene contains no particles to time: give another time with --until."
        )
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
    engine = simulation.engine
    snapshot = simulation.snapshot()
    names = ("position", "velocity", "angular_velocity", "radius", "material", "group")
    data = ParticleData(*(snapshot.particles[name] for name in names))  # spheres without temperatures
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
    totals = simulation.snapshot().totals
    plan = simulation.plan
    return FeatureCost(
        name=variant.name,
        plan=plan,
        nanoseconds=float(np.median(times_of_variant)),
        ratio=tuple(np.percentile(times_of_variant / base, (25, 50, 75)).tolist()),
        bytes_per_particle=estimate_memory(plan, plan.scene.run.precision).total / plan.particle_capacity,
        compile_seconds=simulation.engine.timing.compile,
        contacts_per_particle=totals["contact_count"] / max(totals["particle_count"], 1.0),
    )


def _nanoseconds(simulation: Simulation, variant: FeatureVariant, start: StartState) -> float:
    """Wall time per particle and step [ns] from the start state, without neighbor-list rebuilds.

    STEPS_BEFORE steps precede the timing of STEPS steps. Raises RunError if the variant aborts.
    """
    restore(simulation, variant, start)
    simulation.step(STEPS_BEFORE)
    rebuild_seconds = simulation.engine.timing.neighbor_list
    began = perf_counter()
    simulation.step(STEPS)
    seconds = perf_counter() - began - (simulation.engine.timing.neighbor_list - rebuild_seconds)
    return 1e9 * seconds / (STEPS * max(simulation.snapshot().totals["particle_count"], 1.0))


# Table of feature costs in Markdown.

HEADS = ("", "step ns", "time", "bytes", "compile s", "contacts")
"""Column headings of `cost_rows`."""


def cost_rows(found: Sequence[FeatureCost]) -> list[tuple[str, ...]]:
    """One row per variant. Step, bytes and contacts are per particle; time is the ratio with its
    quartiles."""
    rows: list[tuple[str, ...]] = []
    for each in found:
        low, median, high = each.ratio
        rows.append(
            (
                each.name,
                f"{each.nanoseconds:.1f}",
                f"{median:.2f} ({low:.2f}-{high:.2f})",
                f"{each.bytes_per_particle:.0f}",
                f"{each.compile_seconds:.1f}",
                f"{each.contacts_per_particle:.2f}",
            )
        )
    return rows


def remarks(found: Sequence[FeatureCost]) -> list[str]:
    """Remarks for the interpretation of the table."""
    simulated_ms = 1e3 * (STEPS_BEFORE + STEPS) * found[0].plan.time_step
    law = found[0].plan.laws.normal
    law_remark = f"Without history, elastic hertz replaces {law.name}. " if law.history_names else ""
    return [
        "Step, bytes and contacts are per particle; time is relative to the baseline, as median and "
        "quartiles over rounds that time every row once. Neighbor-list rebuilds are not included.",
        f"Every timing starts from the same particle positions and covers {simulated_ms:.2g} ms of simulated "
        "time. A feature also changes the motion; the contacts at the end of the timing show to which "
        "extent.",
        f"{law_remark}Without rotation, friction and rolling friction are off, too.",
        "Radius and mass are stored for every particle of any scene: several radii have no additional cost.",
    ]


def text(found: Sequence[FeatureCost], title: str) -> str:
    """Table and remarks in Markdown; `title`: of the scene."""
    lines = [f"## {title}", "", _line(HEADS), _line(["---", *["---:"] * (len(HEADS) - 1)])]
    lines += [*(_line(row) for row in cost_rows(found)), "", *(f"- {each}" for each in remarks(found))]
    return "\n".join(lines)


def _line(cells: Sequence[str]) -> str:
    """One line of a Markdown table."""
    return f"| {' | '.join(cells)} |"
