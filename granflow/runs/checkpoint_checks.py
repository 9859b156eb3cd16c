"""Checks the state in a checkpoint against the scene and the plan before it is copied to the device.

A checkpoint with a valid checksum can still have been written for another scene or be edited. Each section
checks a part of it: the state of the run (`check_run`, `check_engine`), the files of MPI ranks, contacts,
clumps, observers and inserters. All raise CheckpointError with the key of the value.
"""

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from granflow.engine.checkpoint import CLOCKS
from granflow.engine.totals import BY_ID, BY_NAME, EXIT_FACES, SAVED_NUMBERS
from granflow.geometry.sphere import sphere_mass
from granflow.io.checkpoint import (
    LARGEST_COUNT,
    LARGEST_REAL,
    Checkpoint,
    Part,
    RankFile,
    damaged,
    insert_array,
)
from granflow.io.files import FormatError
from granflow.load import Scene, scene_of
from granflow.plan.arrays import DeviceArray, particle_arrays, saved_arrays, sum_arrays, wall_dynamics_arrays
from granflow.plan.plan import Plan
from granflow.runs.stages import STATE

SIZE_ROUNDING = 1e-5
"""Relative tolerance of radii and masses: rounding in single precision, and sizes from an earlier run."""
MOST_IDS = 2**31 - 1
"""Largest number of ids of a run."""
KEYS = (
    "stage_progress",
    "wall_clock",
    "plan",
    "changes",
    "earlier",
    "insertion",
    "observers",
    "rank_files",
    "stability",
    "engine",
    "warnings",
)
"""Keys of the state of a run."""


def check_run(checkpoint: Checkpoint, before: Scene, decided: dict[str, object]) -> None:
    """Check the state that does not depend on the present scene: stages, clocks, plan fingerprint.

    `before`: scene of the checkpoint. `decided`: fingerprint of the current plan, see
    `resume.plan_fingerprint`; only its keys are compared here. Raises CheckpointError.
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

    `plan`: of the scene that continues the run; `before`: scene of the checkpoint, whose densities and
    materials determine the masses. The ranges exclude indices that would be out of range on the device.
    Raises CheckpointError.
    """
    _check_servo_samples(
        Part.of(checkpoint)["stage_progress"]["servos"]["samples"], len(plan.controlled_motions)
    )
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
    check_particles(
        engine, own, engine["accounting"], plan, densities(before), complete=not checkpoint.rank_files
    )
    _check_wall_dynamics(engine["wall_dynamics"], plan)
    _check_arrays(engine["energy_budget"], saved_arrays(sum_arrays(plan)))


def check_particles_alone(checkpoint: Checkpoint, before: Scene) -> None:
    """Check the state that `start_from` reads: particles and their groups.

    Independent of any plan, because the new run may have other groups and features; `before`: scene of the
    checkpoint. Raises CheckpointError.
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
    progress.mapping(
        ("stage", "stage_times", "next_check", "target", "arrived", "changes", "servos", "conditions")
    )
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
    """Check that step count and time step [s] give the `time` [s] of the header, within half a step."""
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
    inserted = accounting["inserted_count"].integer(
        count, MOST_IDS
    )  # Python can remove particles and add others
    accounting["deleted_count"].integer(inserted - count, inserted - count)
    for name, kind in SAVED_NUMBERS.items():
        accounting[name].amount(kind)
    for outlet in accounting["outlets"].parts(list(plan.scene.outlets)):
        for each in outlet.items(2):
            each.number(0.0, LARGEST_REAL)
    for face in accounting["exits"].parts(EXIT_FACES):
        face.integer(0, MOST_IDS)
    accounting["material"].integers(inserted, high=len(plan.scene.materials) - 1)
    accounting["group"].integers(inserted, high=len(plan.groups) - 1)
    accounting["insertion_time"].floats(inserted)


def _check_arrays(
    part: Part, arrays: Mapping[str, DeviceArray], count: int | None = None, others: Collection[str] = ()
) -> None:
    """Check names, types and shapes of arrays.

    `count`: length of the first axis, by default the capacity, or none for sums over the chunks; `others`:
    further keys of the mapping.
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
    engine: Part,
    count: int,
    accounting: Part,
    plan: Plan,
    density_by_name: Mapping[str, float],
    complete: bool,
) -> None:
    """Check particles and contacts: shape and range of arrays, and sizes and materials as in the scene.

    `engine`: with "particles", which must be `count`, and "contacts"; `density_by_name`: see `densities`;
    `complete`:
    whether these are all particles. The mass must be density times 4/3 pi R^3, within the rounding of single
    precision. Raises CheckpointError.
    """
    particles = engine["particles"]
    inserted = accounting["inserted_count"].integer()
    arrays = saved_arrays(particle_arrays(plan))
    _check_arrays(particles, arrays, count)
    ids = particles["id"].distinct(count, high=inserted - 1)
    sizes = (plan.radius_min * (1.0 - SIZE_ROUNDING), plan.radius_max * (1.0 + SIZE_ROUNDING))
    radius = particles["radius"].floats(count, low=sizes[0], high=sizes[1]).astype(float)
    number = accounting["material"].integers(inserted, high=len(density_by_name) - 1)[ids]
    density = np.array([*density_by_name.values()])[number]
    mass = sphere_mass(radius, density)
    if "clump" in arrays:
        group = accounting["group"].integers(inserted, high=len(plan.groups) - 1)[ids]
        mass = check_clumps(particles, ids.astype(np.int64), group, density, plan)
    if np.any(np.abs(particles["mass"].floats(count) - mass) > SIZE_ROUNDING * mass):
        raise particles["mass"].error("differs from density times volume")
    if "fixed" in arrays:
        particles["fixed"].integers(count, high=1)
    if "material" in arrays:
        known = {name: index for index, name in enumerate(plan.materials)}
        expected = np.array([known.get(name, 0) for name in density_by_name])[number]
        if np.any(particles["material"].integers(count, high=len(plan.materials) - 1) != expected):
            raise particles["material"].error("differs from the materials in accounting")
    _check_positions(particles, count, plan)
    check_contacts(engine["contacts"], ids, plan, complete)


def _check_positions(particles: Part, count: int, plan: Plan) -> None:
    """Check that particles were inside the domain at the last rebuild and have moved little since.

    Displacements up to twice the largest reach and positions up to one skin outside the domain are accepted,
    of spheres of clumps also the outer radius, plus rounding [m].
    """
    position = particles["position"].floats(count, 3).astype(float)
    at_rebuild = particles["position_at_rebuild"].floats(count, 3).astype(float)
    rounding = np.abs(at_rebuild).max(initial=0.0) * float(np.finfo(np.float32).eps)
    if np.any(np.linalg.norm(position - at_rebuild, axis=1) > 2.0 * plan.reach_max + rounding):
        raise particles["position"].error("is farther from position_at_rebuild than its reach")
    margin = (
        plan.skin + max(0.5 * (group.spec.shape.outer_diameter or 0.0) for group in plan.groups) + rounding
    )
    low, high = plan.domain_low - margin, plan.domain_high + margin
    if plan.scene.domain.on_exit != "expand" and np.any((at_rebuild < low) | (at_rebuild > high)):
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


# The files of MPI ranks of a checkpoint: reading with all checks, on the rank that reads them.


@dataclass(frozen=True)
class CheckedRankFiles:
    """As `engine.engine.RankFiles`.

    `density_by_name` [kg/m3]: of the materials of the checkpoint.
    """

    files: tuple[RankFile, ...]
    density_by_name: Mapping[str, float]

    @property
    def count(self) -> int:
        """Number of files."""
        return len(self.files)

    def read(self, number: int, plan: Plan, accounting: Mapping[str, Any]) -> Mapping[str, Any]:
        """Particles and contacts of a file. Raises CheckpointError."""
        file = self.files[number]
        saved: dict[str, Any] = {"engine": {"particles": {}, "contacts": {}}}
        try:
            for path, array in file.arrays().items():
                insert_array(saved, path, array)
        except FormatError as error:
            raise damaged(file.path, str(error)) from None
        engine = Part(file.path, "", saved)["engine"]
        check_particles(
            engine,
            file.count,
            Part(file.path, "accounting", dict(accounting)),
            plan,
            self.density_by_name,
            False,
        )
        return engine.mapping()


def rank_files_of(checkpoint: Checkpoint) -> CheckedRankFiles | None:
    """The files of the ranks with particles that the checkpoint does not contain; None if it contains all."""
    if not checkpoint.rank_files:
        return None
    return CheckedRankFiles(
        checkpoint.rank_files, densities(scene_of(checkpoint.scene, str(checkpoint.path)))
    )


# Checks the contacts of a checkpoint: valid partners, and each contact between two particles at both of
# them.


def check_contacts(contacts: Part, ids: np.ndarray, plan: Plan, complete: bool = True) -> None:
    """Check the contact histories of the particles with these ids (n,). Raises CheckpointError.

    `complete`: whether these are all particles; otherwise partners can be in the files of other ranks.
    `count` (n,): contacts per particle. `partner` (contacts,): id of a particle, or a negative number for a
    wall or triangle. The histories (contacts, components) exist if the contact models have some.
    """
    names = set(contacts.mapping()) - {"count", "partner"}
    contacts.mapping(("count", "partner", *(plan.history if names else ())))
    total = len(contacts["partner"].value) if isinstance(contacts["partner"].value, np.ndarray) else 0
    if total and not names:
        raise contacts.error("has no histories")
    count = contacts["count"].integers(len(ids), high=total).astype(np.int64)
    if count.sum() != total:
        raise contacts["count"].error(f"adds up to {count.sum()}, but partner has {total} entries")
    surfaces = len(plan.walls) + sum(mesh.triangle_count for mesh in plan.meshes.values())
    partner = contacts["partner"].integers(total, low=-surfaces).astype(np.int64)
    for name in names:
        contacts[name].floats(total, plan.history[name])
    _check_pairs(contacts["partner"], np.repeat(ids.astype(np.int64), count), partner, ids, complete)


def _check_pairs(part: Part, owner: np.ndarray, partner: np.ndarray, ids: np.ndarray, complete: bool) -> None:
    """Check that each contact occurs once at each of its particles, which have the ids (n,).

    Raises CheckpointError.
    """
    particles = partner >= 0
    if complete and not np.isin(partner[particles], ids).all():
        raise part.error("names a particle that does not exist")
    if np.any(owner == partner):
        raise part.error("lists a particle as in contact with itself")
    pairs = np.stack([owner, partner], axis=1)
    if len(np.unique(pairs, axis=0)) < len(pairs):
        raise part.error("lists a contact twice for one particle")
    forward = pairs[particles]
    back = pairs[particles][:, ::-1]
    if complete and not np.array_equal(_in_order(forward), _in_order(back)):
        raise part.error("lists a contact between two particles at one of them only")


def _in_order(pairs: np.ndarray) -> np.ndarray:
    """The rows of an array (n, 2) in lexicographic order."""
    found: np.ndarray = pairs[np.lexsort(pairs.T)]
    return found


# Checks the clumps of a checkpoint.

CLUMP_ROUNDING = 1e-5
"""Relative tolerance of masses, moments, lengths and norms: rounding in single precision."""


def check_clumps(
    particles: Part, ids: np.ndarray, group: np.ndarray, density: np.ndarray, plan: Plan
) -> np.ndarray:
    """Check the clumps of particles with these ids, groups and densities [kg/m3], all (n,).

    Returns the masses (n,).

    The device reads the spheres of a clump by their ids, which follow each other: each must exist. Raises
    CheckpointError.
    """
    count = len(ids)
    clump = particles["clump"].integers(count, low=-1).astype(np.int64)
    size = np.array([each.spec.shape.sphere_count for each in plan.groups])[group]
    if np.any((clump >= 0) != np.array([each.spec.shape.body is not None for each in plan.groups])[group]):
        raise particles["clump"].error("differs from the groups in accounting")
    if np.any(particles["clump_size"].integers(count) != size):
        raise particles["clump_size"].error("differs from the number of spheres in the scene")
    member = np.where(clump >= 0, ids - clump, 0)
    of_clump, found = np.unique(clump[clump >= 0], return_counts=True)
    sizes = size[np.searchsorted(ids, of_clump)] if np.isin(of_clump, ids).all() else np.zeros(len(of_clump))
    if np.any((member < 0) | (member >= size)) or np.any(found != sizes):
        raise particles["clump"].error("describes a clump without some of its spheres")
    return _check_shapes(particles, group, density, member, plan)


def _check_shapes(
    particles: Part, group: np.ndarray, density: np.ndarray, member: np.ndarray, plan: Plan
) -> np.ndarray:
    """Check masses, moments and spheres of the clumps; returns the masses (n,) [kg] of all spheres."""
    count = len(group)
    radius = particles["radius"].floats(len(group)).astype(float)
    mass = sphere_mass(radius, density)
    expected = {"mass": mass, "clump_mass": mass.copy()}
    expected |= {name: np.zeros((count, 3)) for name in ("clump_inertia", "clump_offset")}
    for number, body in enumerate(each.spec.shape.body for each in plan.groups):
        rows = group == number
        if body is not None:
            arrays = body.sphere_arrays(density[rows], member[rows])
            for name, values in expected.items():
                values[rows] = arrays[name]
    mass = expected.pop("mass")
    for name, values in expected.items():
        scale = np.abs(values).max(axis=tuple(range(1, values.ndim)), keepdims=True)
        if np.any(np.abs(particles[name].floats(*values.shape) - values) > CLUMP_ROUNDING * scale):
            raise particles[name].error("differs from the clumps of the scene")
    norm = np.linalg.norm(particles["orientation"].floats(count, 4).astype(float), axis=1)
    if np.any(np.abs(norm - 1.0) > CLUMP_ROUNDING):
        raise particles["orientation"].error("is not a unit quaternion")
    return mass


# Checks the saved state of observers and inserters against the structure of the state of new ones.

LIST_TYPES: dict[str, tuple[str, ...]] = {
    "frames": ("number", "text"),
    "history": ("number", "text", "number"),
    "columns": ("text",),
}
"""Lists that grow during a run, by key, with the types of the values of each entry."""
SAMPLE_ARRAYS = ("id", "mass", "position", "distance", "insertion_time", "part")
"""Arrays of the previous sample of a flow meter."""


def check_observers(checkpoint: Checkpoint, fresh: Mapping[str, Mapping[str, Any]]) -> None:
    """Check the state of each saved observer against that of a new one.

    `fresh`: state of each new observer by name, which defines the keys and types; saved observers that are
    not in `fresh` are ignored. Raises CheckpointError.
    """
    observers = Part.of(checkpoint)["observers"]
    for name, template in fresh.items():
        if name in observers.mapping():
            _check_like(observers[name], template)


def check_streams(
    checkpoint: Checkpoint, fresh: Mapping[str, Mapping[str, Any]], counts: Mapping[str, int]
) -> None:
    """Check the state of each inserter by group.

    `fresh`: states of new inserters by group; `counts`: number of particles of each group, an upper bound of
    the particles due. Raises CheckpointError.
    """
    insertion = Part.of(checkpoint)["insertion"]
    insertion.mapping(fresh)
    for name, template in fresh.items():
        insertion[name].mapping(template)
        due = insertion[name]["due_count"].integer(0, counts[name])
        queued = insertion[name]["queued"]
        size = queued.value.size if isinstance(queued.value, np.ndarray) else 0
        queued.distinct(size, high=due - 1)
        insertion[name]["batch_count"].integer()
        insertion[name]["next_time"].number(0.0)


def _check_like(part: Part, template: Any) -> None:
    """Check for the keys and types of `template`; values that are empty or None there may have grown.

    Lists, the previous sample of a flow meter and accumulated fields grow during a run and have separate
    checks. Raises CheckpointError.
    """
    key = part.key.rsplit("/", 1)[-1]
    if key == "last" and isinstance(part.value, dict) and any(name in part.value for name in SAMPLE_ARRAYS):
        _check_sample(part)
    elif key == "total":
        _check_sums(part)
    elif isinstance(template, dict) and template:
        for each in part.parts(template):
            _check_like(each, template[each.key.rsplit("/", 1)[-1]])
    elif isinstance(template, dict):
        for each in part.parts():
            each.plain()
    elif isinstance(template, list):
        for row in part.items():
            _check_row(row, LIST_TYPES.get(key, ()))
    elif isinstance(template, np.ndarray) and template.dtype.kind == "i":
        part.integers(*template.shape, high=LARGEST_COUNT)
    elif isinstance(template, np.ndarray):
        part.floats(*template.shape)
    elif template is None:
        part.plain()
    else:
        _check_plain(part, template)


def _check_row(row: Part, kinds: tuple[str, ...]) -> None:
    """Check an entry of a list: a value, or a list with one value for each kind, "number" or "text"."""
    cells = [row] if len(kinds) == 1 else row.items(len(kinds))
    for cell, kind in zip(cells, kinds, strict=True):
        check: Callable[[], object] = cell.number if kind == "number" else cell.text
        check()


def _check_plain(part: Part, template: Any) -> None:
    """Check a value that is not a container.

    `count` may be negative: it is the net number of particles of a flow meter.
    """
    if isinstance(template, bool):
        part.flag()
    elif isinstance(template, int):
        part.integer(-(2**53) if part.key.endswith("/count") else 0)
    elif isinstance(template, float):
        part.plain()
    else:
        part.text()


def _check_sample(part: Part) -> None:
    """Check the previous sample of a flow meter: arrays (n,), `position` (n, 3)."""
    part.mapping(SAMPLE_ARRAYS)
    ids = part["id"].value
    count = len(ids) if isinstance(ids, np.ndarray) and ids.ndim == 1 else 0
    part["id"].distinct(count)
    part["part"].integers(count)
    for name in ("mass", "distance", "insertion_time"):
        part[name].floats(count)
    part["position"].floats(count, 3)


def _check_sums(part: Part) -> None:
    """Check the accumulated fields: arrays (cells, numbers) for the cells of one grid."""
    lengths = {
        len(each.value) if isinstance(each.value, np.ndarray) and each.value.ndim else -1
        for each in part.parts()
    }
    for each in part.parts():
        width = each.value.shape[-1] if isinstance(each.value, np.ndarray) and each.value.ndim else 0
        each.floats(*(lengths if len(lengths) == 1 else (0,)), width, high=LARGEST_REAL)
