"""Checks a checkpoint against the plan of the run before it is copied to the device; see `checkpoint_parts`."""

from collections.abc import Collection, Mapping

import numpy as np

from granflow.engine.accounting import BY_ID, BY_NAME, EXIT_FACES, SAVED_NUMBERS
from granflow.engine.checkpoint import CLOCKS
from granflow.geometry.sphere import sphere_mass
from granflow.io.checkpoint import Checkpoint
from granflow.io.checkpoint_parts import LARGEST_REAL, Part
from granflow.load import Scene
from granflow.plan.device_arrays import DeviceArray, particle_arrays, saved_arrays, sum_arrays, wall_dynamics_arrays
from granflow.plan.plan import Plan
from granflow.runs.checkpoint_clumps import check_clumps
from granflow.runs.checkpoint_contacts import check_contacts
from granflow.runs.stage_conditions import STATE

ROUNDING = 1e-5
"""Relative tolerance of radii and masses: rounding in single precision, and sizes from an earlier run."""

MOST_IDS = 2**31 - 1
"""Largest number of ids of a run."""

KEYS = (
    *("stage_progress", "wall_clock", "plan", "changes", "earlier", "insertion", "observers", "rank_files"),
    *("stability", "engine", "warnings"),
)
"""Keys of the state of a run."""


def check_run(checkpoint: Checkpoint, before: Scene, decided: dict[str, object]) -> None:
    """Check the state that does not depend on the current scene: stages, clocks, the keys of the plan fingerprint.

    `before`: scene of the checkpoint. `decided`: fingerprint of the current plan, see `resume.plan_fingerprint`; only
    its keys are compared here. Raises CheckpointError.
    """
    part = Part.of(checkpoint)
    part.mapping(KEYS)
    _check_stage_progress(part["stage_progress"], [stage.name for stage in before.schedule])
    for each in part["wall_clock"].parts(("output_seconds", "wall_clock")):
        each.number(0.0)
    for each in part["plan"].parts(decided):
        if not isinstance(each.value, bool | int | float | str):
            raise each.mismatch("a number or a text")
    for name in part["earlier"].items():
        name.text(list(before.particles))
    for sentence in part["warnings"].items():
        sentence.text()
    _check_stability(part["stability"])
    for key in ("insertion", "observers", "engine"):
        part[key].mapping()
    clock = part["engine"]["clock"]
    _check_clock(clock, checkpoint.time)


def check_engine(checkpoint: Checkpoint, plan: Plan, before: Scene) -> None:
    """Check all values for the device: counts, types, shapes, ranges, indices.

    `plan`: of the scene that continues the run; `before`: scene of the checkpoint, whose densities and materials
    determine the masses. The ranges exclude indices that would be out of range on the device. Raises CheckpointError.
    """
    _check_servo_samples(Part.of(checkpoint)["stage_progress"]["servos"]["samples"], len(plan.controlled_motions))
    engine = Part.of(checkpoint)["engine"]
    count = engine["particle_count"].integer(0, plan.particle_capacity)
    steps = engine["clock"]["step_count"].integer()
    engine["steps_since_update"].integer(0, steps)
    _check_clock_at_rebuild(engine["clock_at_rebuild"], steps)
    for wall in engine["walls_present"].items(len(plan.walls)):
        wall.flag()
    _check_accounting(engine["accounting"], count, plan)
    engine["clocks"].mapping(CLOCKS)
    for name, kind in CLOCKS.items():
        engine["clocks"][name].amount(kind, 0)
    own = count - sum(file.count for file in checkpoint.rank_files)
    check_particles(engine, own, engine["accounting"], plan, densities(before), complete=not checkpoint.rank_files)
    _check_wall_dynamics(engine["wall_dynamics"], plan)
    _check_arrays(engine["energy_budget"], saved_arrays(sum_arrays(plan)))


def check_particles_alone(checkpoint: Checkpoint, before: Scene) -> None:
    """Check the state that `start_from` reads: particles and their groups.

    Independent of any plan, because the new run may have other groups and features; `before`: scene of the checkpoint.
    Raises CheckpointError.
    """
    engine = Part.of(checkpoint)["engine"]
    count = engine["particle_count"].integer(0, 2**31 - 1)
    inserted = len(group) if isinstance(group := engine["accounting"]["group"].value, np.ndarray) else 0
    engine["accounting"]["group"].integers(inserted, high=len(before.particles) - 1)
    engine["clock"]["time_step"].number(0.0, LARGEST_REAL)
    particles = engine["particles"]
    for name in (
        "position",
        "velocity",
        "force",
        *(("angular_velocity", "torque") if "angular_velocity" in particles.mapping() else ()),
    ):
        particles[name].floats(count, 3)
    for name in ("radius", "mass"):
        particles[name].floats(count, low=float(np.finfo(np.float32).tiny))
    particles["id"].distinct(count, high=inserted - 1)
    for array in particles.parts():
        if not isinstance(array.value, np.ndarray) or len(array.value) != count:
            raise array.mismatch(f"an array of {count} particles")


def _check_stage_progress(progress: Part, stages: list[str]) -> None:
    """Check the present stage, the start and end [s] of each stage up to it, in the order `stages`."""
    progress.mapping(("stage", "stage_times", "next_check", "target", "arrived", "changes", "servos", "conditions"))
    present = progress["stage"].text(stages)
    times = progress["stage_times"]
    if list(times.mapping()) != stages[: stages.index(present) + 1]:
        raise times.error("has other stages than those up to the present one")
    for each in times.parts():
        began, ended = each.items(2)
        ended.number(began.number(0.0, LARGEST_REAL))
    progress["next_check"].number()
    progress["arrived"].flag()
    if progress["target"].value is not None:
        progress["target"].number(0.0, LARGEST_REAL)
    for change in progress["changes"].items():
        change.number(0.0)
    progress["servos"].mapping(("next_sample", "samples"))
    progress["servos"]["next_sample"].number(0.0)
    _check_conditions(progress["conditions"])


def _check_conditions(conditions: Part) -> None:
    """Check times [s] and values of the conditions of the present stage."""
    conditions.mapping(STATE)
    count = len(conditions["since"].items())
    for since in conditions["since"].items():
        since.number(0.0)
    for value in conditions["values"].items(count):
        if not isinstance(value.value, float):
            raise value.mismatch("a number")
    conditions["last_row"].number(0.0, LARGEST_REAL)
    if conditions["met"].value is not None:
        conditions["met"].integer(0, count - 1)


def _check_stability(stability: Part) -> None:
    """Check the warnings, numbers and flags of the stability monitor."""
    stability.mapping(("warnings", "fastest", "initial_energy", "above_since", "enabled", "started"))
    for sentence in stability["warnings"].parts():
        sentence.text()
    stability["fastest"].number(0.0)
    stability["initial_energy"].number()
    if stability["above_since"].value is not None:
        stability["above_since"].number(0.0)
    stability["enabled"].flag()
    stability["started"].flag()


def _check_servo_samples(samples: Part, motion_count: int) -> None:
    """Check the force samples [N] of the controlled motions."""
    for sample in samples.items():
        for force in sample.items(motion_count):
            force.number(-LARGEST_REAL, LARGEST_REAL)


def _check_clock(clock: Part, time: float) -> None:
    """Check that the step count and the time step [s] result in the `time` [s] of the header, within half a step."""
    clock.mapping(("time_step", "step_count", "since_step", "since_time"))
    step = clock["time_step"].number(np.finfo(float).tiny, LARGEST_REAL)
    count = clock["step_count"].integer()
    since_step = clock["since_step"].integer(0, count)
    now = clock["since_time"].number(0.0, LARGEST_REAL) + (count - since_step) * step
    if not abs(now - time) <= 0.5 * step:
        raise clock.error(f"gives the time {now:.6g} s, but the header {time:.6g} s")


def _check_clock_at_rebuild(clock: Part, steps: int) -> None:
    """Check the clock at the last rebuild; `steps`: number of completed steps."""
    clock.mapping(("time_step", "step_count", "since_step", "since_time"))
    clock["time_step"].number(np.finfo(float).tiny, LARGEST_REAL)
    count = clock["step_count"].integer(0, steps)
    clock["since_step"].integer(0, count)
    clock["since_time"].number(0.0, LARGEST_REAL)


def _check_accounting(accounting: Part, count: int, plan: Plan) -> None:
    """Check counts, masses [kg] and energies [J] of inserted and deleted particles, and the arrays by id.

    `count`: particles present, which is the inserted minus the deleted number.
    """
    accounting.mapping((*SAVED_NUMBERS, *BY_NAME, *BY_ID))
    inserted = accounting["inserted_count"].integer(count, MOST_IDS)  # Python can remove particles and add others
    accounting["deleted_count"].integer(inserted - count, inserted - count)
    for name, kind in SAVED_NUMBERS.items():
        accounting[name].amount(kind)
    for outlet in accounting["outlets"].parts([outlet.name for outlet in plan.outlets]):
        for each in outlet.items(2):
            each.number(0.0, LARGEST_REAL)
    for face in accounting["exits"].parts(EXIT_FACES):
        face.integer(0, MOST_IDS)
    accounting["material"].integers(inserted, high=len(plan.solids) - 1)
    accounting["group"].integers(inserted, high=len(plan.groups) - 1)
    accounting["insertion_time"].floats(inserted)


def _check_arrays(
    part: Part, arrays: Mapping[str, DeviceArray], count: int | None = None, others: Collection[str] = ()
) -> None:
    """Check names, types and shapes of arrays.

    `count`: length of the first axis, by default the capacity, or none for sums over the chunks; `others`: further keys
    of the mapping.
    """
    part.mapping((*arrays, *others))
    for name, array in arrays.items():
        saved_shape = array.full_shape
        if count is not None or array.by_chunk:
            saved_shape = (*(() if count is None else (count,)), *array.full_shape[1:])
        if array.dtype == "i64":
            part[name].integers(*saved_shape, low=-(2**63), high=2**63 - 1)
        elif array.dtype == "i32":
            part[name].integers(*saved_shape, low=-1 if name == "clump" else 0)  # -1 for single spheres
        else:
            part[name].floats(*saved_shape)


def densities(before: Scene) -> dict[str, float]:
    """Density [kg/m3] of each material of the scene of a checkpoint, in the order of their numbers."""
    return {name: material.density for name, material in before.materials.items()}


def check_particles(
    engine: Part, count: int, accounting: Part, plan: Plan, density_by_name: Mapping[str, float], complete: bool
) -> None:
    """Check particles and contacts: shape and range of arrays, and radius, mass and material against the scene.

    `engine`: with "particles", which must be `count`, and "contacts"; `density_by_name`: see `densities`; `complete`:
    whether these are all particles. The mass must be density times 4/3 pi R^3, within the rounding of single precision.
    Raises CheckpointError.
    """
    particles, inserted = engine["particles"], accounting["inserted_count"].integer()
    arrays = saved_arrays(particle_arrays(plan))
    _check_arrays(particles, arrays, count)
    ids = particles["id"].distinct(count, high=inserted - 1)
    sizes = (plan.radius_min * (1.0 - ROUNDING), plan.radius_max * (1.0 + ROUNDING))
    radius = particles["radius"].floats(count, low=sizes[0], high=sizes[1]).astype(float)
    number = accounting["material"].integers(inserted, high=len(density_by_name) - 1)[ids]
    density = np.array([*density_by_name.values()])[number]
    mass = sphere_mass(radius, density)
    if "clump" in arrays:
        group = accounting["group"].integers(inserted, high=len(plan.groups) - 1)[ids]
        mass = check_clumps(particles, ids.astype(np.int64), group, density, plan)
    if np.any(np.abs(particles["mass"].floats(count) - mass) > ROUNDING * mass):
        raise particles["mass"].error("differs from density times volume")
    if "fixed" in arrays:
        particles["fixed"].integers(count, high=1)
    if "material" in arrays:
        known = {name: index for index, name in enumerate(plan.materials)}
        expected = np.array([known.get(name, 0) for name in density_by_name])[number]
        if np.any(particles["material"].integers(count, high=plan.material_count - 1) != expected):
            raise particles["material"].error("differs from the materials in accounting")
    _check_positions(particles, count, plan)
    check_contacts(engine["contacts"], ids, plan, complete)


def _check_positions(particles: Part, count: int, plan: Plan) -> None:
    """Check that particles were inside the domain at the last rebuild and have moved little since.

    Displacements up to twice the largest reach and positions up to one skin outside the domain are accepted, of spheres
    of clumps also the outer radius, plus rounding [m].
    """
    position = particles["position"].floats(count, 3).astype(float)
    at_rebuild = particles["position_at_rebuild"].floats(count, 3).astype(float)
    rounding = np.abs(at_rebuild).max(initial=0.0) * float(np.finfo(np.float32).eps)
    if np.any(np.linalg.norm(position - at_rebuild, axis=1) > 2.0 * plan.reach_max + rounding):
        raise particles["position"].error("is farther from position_at_rebuild than its reach")
    margin = max([plan.skin, *(each.clump.outer_radius + plan.skin for each in plan.groups if each.clump)]) + rounding
    low, high = plan.domain_low - margin, plan.domain_high + margin
    if plan.domain.on_exit != "expand" and np.any((at_rebuild < low) | (at_rebuild > high)):
        raise particles["position_at_rebuild"].error("is outside the domain")


def _check_wall_dynamics(dynamics: Part, plan: Plan) -> None:
    """Check the controlled walls; if they differ from those of the plan, another check reports it."""
    if [each.text() for each in dynamics["controlled_motions"].items()] != [
        each.key for each in plan.controlled_motions
    ]:
        return
    arrays = saved_arrays(wall_dynamics_arrays(plan)) if plan.controlled_motions else {}
    _check_arrays(dynamics, arrays, others=("controlled_motions",))
    if arrays:
        dynamics["was_active"].integers(*arrays["was_active"].shape, high=1)
