"""Particles at the start of a run: from the scene, an earlier run or arrays; none for a resumed run."""

from math import ceil
from pathlib import Path
from typing import Any

import numpy as np
from pydantic_core import PydanticCustomError

from granflow.errors import GranflowError, SceneError
from granflow.geometry.clump import ClumpBody, product
from granflow.geometry.periodic_box import AXES
from granflow.geometry.sphere import sphere_inertia
from granflow.io.checkpoint import Checkpoint, newest_checkpoint
from granflow.load import Scene, scene_of
from granflow.particles.group import ParticleData, SceneGroup, groups_of
from granflow.particles.insertion import initial_particles
from granflow.plan.overlaps import particle_warnings, refuse_initial_overlaps, without_overlaps_of_walls
from granflow.plan.plan import Plan
from granflow.scene.blocks.particle_shapes.shape import ParticleShape


def initial_state(
    plan: Plan, given: ParticleData | None, resumed: Checkpoint | None
) -> tuple[ParticleData | None, list[str], list[str]]:
    """The particles at the start, the names of the groups whose particles do not come from the scene, and
    warnings about particles inside walls.

    given:    particles that replace those of the scene, or None
    resumed:  checkpoint from which a run continues; there are then no particles to insert
    Raises:   SceneError if particles do not fit, GranflowError for invalid `given` particles
    """
    if resumed is not None:
        if given is not None:
            raise GranflowError("A resumed run has the particles of its checkpoint: leave particles out.")
        return None, list(resumed.saved["earlier"]), []
    if given is not None:
        refuse_other_particles(plan, given)
        names = [group.name for number, group in enumerate(plan.groups) if number in given.group]
        return given, names, list(particle_warnings(plan, given))
    earlier = particles_from_run(plan.scene)
    particles, left_out = without_overlaps_of_walls(plan, initial_particles(plan.scene, earlier), earlier)
    return particles, list(earlier), [*left_out, *particle_warnings(plan, particles)]


def refuse_other_particles(plan: Plan, given: ParticleData) -> None:
    """Raise GranflowError for particles that are not those of the groups, for which the plan was made."""
    count = len(given)
    for name, limit in (("group", len(plan.groups)), ("material", len(plan.scene.materials))):
        values = getattr(given, name)
        if values.shape != (count,) or np.any((values < 0) | (values >= limit)):
            raise GranflowError(f"particles.{name} has values outside the {limit} of the scene.")
    for number, group in enumerate(plan.groups):
        own = given.group == number
        if own.sum() > group.spec.count:
            raise GranflowError(
                f"particles has {own.sum()} of {group.name}, but the scene only {group.spec.count}."
            )
        if np.any(given.material[own] != group.material_number):
            raise GranflowError(f"particles.material is not {group.spec.material} for all of {group.name}.")
    bodies = {number: body for number, group in enumerate(plan.groups) if (body := group.spec.shape.body)}
    radius = given.radius[~np.isin(given.group, list(bodies))]
    if len(radius) and not plan.radius_min <= radius.min() <= radius.max() <= plan.radius_max:
        raise GranflowError(
            f"particles.radius lies in [{radius.min():.6g}, {radius.max():.6g}] m, but those of "
            f"the scene in [{plan.radius_min:.6g}, {plan.radius_max:.6g}] m."
        )
    for number, body in bodies.items():
        _refuse_other_clumps(plan.groups[number].name, body, given, given.group == number)
    _refuse_other_values(plan.scene, given)
    for name in ("position", "velocity", "angular_velocity"):
        if getattr(given, name).shape != (count, 3) or not np.isfinite(getattr(given, name)).all():
            raise GranflowError(f"particles.{name} is not an array ({count}, 3) of finite numbers.")


def _refuse_other_values(scene: Scene, given: ParticleData) -> None:
    """Raise GranflowError for a property that no equation of the scene changes, or values out of range."""
    equations = {each.name: each for each in scene.equations}
    for name, values in given.initial_values.items():
        if name not in equations:
            known = f"changes {', '.join(equations)}" if equations else "has no particle equation"
            raise GranflowError(f"particles.initial_values has {name}, but the scene {known}; leave it out.")
        known_values = values[~np.isnan(values)]
        for value in (known_values.min(), known_values.max()) if len(known_values) else ():
            try:
                equations[name].initial.read(float(value))
            except PydanticCustomError as error:
                raise GranflowError(
                    f"particles.initial_values has a {name} of {value:.6g}: {error.message()}."
                ) from None


def _refuse_other_clumps(name: str, body: ClumpBody, given: ParticleData, own: np.ndarray) -> None:
    """Raise GranflowError for clumps without orientations, or of another size than their body.

    own:  (n,) which of the particles are these clumps
    """
    if not own.any():
        return
    if given.orientation is None:
        raise GranflowError(
            f"particles.orientation is missing: {name} has clumps; give unit quaternions ({len(given)}, 4)."
        )
    length = np.linalg.norm(given.orientation[own], axis=1)
    if not np.all(np.abs(length - 1.0) < ROUNDING):
        raise GranflowError(f"particles.orientation has quaternions of {name} whose length is not 1.")
    if not np.allclose(given.radius[own], body.outer_radius, rtol=ROUNDING, atol=0.0):
        raise GranflowError(
            f"particles.radius of {name} must be {body.outer_radius:.10g} m, that of the sphere around the "
            "center of mass that contains the clump."
        )


# Initial particles of a new run from the last state of an earlier run: `start_from:` of a scene.

ROUNDING = 1e-6
"""Relative tolerance of the diameters from an earlier run, which may be rounded to single precision."""


def particles_from_run(scene: Scene) -> dict[str, ParticleData]:
    """Return the particles of each group that the earlier run also has, from its newest checkpoint, by group.

    Positions, velocities, angular velocities, orientations and sizes are those of the run, materials those of
    the scene. Properties of particle equations, such as the temperature, are those of the run, or of the
    group if the run has none; sources are those of the scene. All are float64, synchronized to the same time,
    ordered by id. Particles of a `fixed` group are at rest. The contact history is not transferred. Empty
    without `start_from`.

    Raises SceneError if the run does not exist, if the count or the sizes of its particles exceed those of
    the group in the scene, or if their clumps differ; CheckpointError if its newest checkpoint has another
    format.
    """
    if scene.start_from is None:
        return {}
    location = f"{scene.locate('start_from')}: start_from is {scene.start_from}, but"
    if not Path(scene.start_from).exists():
        raise SceneError(f"{location} it does not exist; give the directory of a completed run.")
    checkpoint, skipped = newest_checkpoint(Path(scene.start_from))
    if checkpoint is None:
        reason = f": {skipped[0]}" if skipped else "; give the directory of a completed run."
        raise SceneError(f"{location} it contains no usable checkpoint{reason}")
    before = scene_of(checkpoint.scene, str(checkpoint.path))
    names = list(before.particles)
    shared = {name: group for name, group in groups_of(scene).items() if name in names}
    if not shared:
        raise SceneError(
            f"{location} its groups are {', '.join(names)}; give the groups to continue the same names under "
            "particles."
        )
    other_clumps = [
        f"{group.locate()}: particles.{name} has {_spheres(group.spec.shape)}, but start_from has other "
        f"ones, {_spheres(before.particles[name].shape)}; give the group the same clump, or another name."
        for name, group in shared.items()
        if not _same_body(before.particles[name].shape.body, group.spec.shape.body)
    ]
    if other_clumps:
        raise SceneError(other_clumps)
    _refuse_other_widths(scene, before, checkpoint, location)
    _refuse_displaced_images(scene, before, checkpoint, location)
    stage_times = checkpoint.saved["stage_progress"]["stage_times"]
    gravity = before.gravity_course(stage_times).at(np.array([checkpoint.time]))[0]
    found = {
        name: _particles_of_group(group, checkpoint, names.index(name), gravity)
        for name, group in shared.items()
    }
    if not any(len(particles) for particles in found.values()):
        raise SceneError(
            f"{location} at {checkpoint.time:.6g} s it has no particles of {', '.join(shared)}; give a run "
            "that ends before they are deleted (granflow run --until TIME)."
        )
    problems = [problem for name, group in shared.items() for problem in _inconsistencies(group, found[name])]
    if problems:
        raise SceneError(problems)
    return found


def checked_particles(plan: Plan) -> list[str]:
    """Warnings about the particles of a scene at its start.

    Raises SceneError if they overlap by more than `numerics.max_overlap` or do not fit in their regions, and
    as `particles_from_run`.
    """
    particles, _, warnings = initial_state(plan, None, None)
    assert particles is not None
    refuse_initial_overlaps(plan.scene, particles)
    return warnings


WIDTH_TOLERANCE = 0.01
"""Largest difference between the width of a box and that of the earlier run, over the smallest radius: given
widths are rounded, and images shift by the difference."""


def _refuse_other_widths(scene: Scene, before: Scene, checkpoint: Checkpoint, location: str) -> None:
    """Raise SceneError if a periodic axis has another width than at the end of an earlier run whose box has
    deformed."""
    widths = checkpoint.saved["engine"]["deformation"].get("width")
    if widths is None:
        return
    low = np.array(scene.domain.min)
    given = np.array(scene.domain.max) - low
    smallest = 0.5 * min(group.diameters[0] for group in before.particles.values())
    axes = [
        k for k, axis in enumerate(AXES) if axis in before.domain.periodic and axis in scene.domain.periodic
    ]
    if not any(abs(given[k] - widths[k]) > WIDTH_TOLERANCE * smallest for k in axes):
        return
    high = [float(low[k] + widths[k]) if k in axes else scene.domain.max[k] for k in range(3)]
    corners = (", ".join(f"{x:.8g}" for x in corner) for corner in (low, high))
    raise SceneError(
        f"{location} its box has deformed, and its particles need the domain {{min: [{next(corners)}], max: "
        f"[{next(corners)}]}}; give these numbers, and insert: {{kind: python}} to groups whose region is "
        "then not in the domain: their particles are those of the earlier run."
    )


def _refuse_displaced_images(scene: Scene, before: Scene, checkpoint: Checkpoint, location: str) -> None:
    """Raise SceneError if the images of a sheared box are displaced at the end of an earlier run: those of a
    new run are not, so that particles at the faces would have other neighbors."""
    at_start = before.domain.periodic_box()
    motion = at_start.image_motion
    if motion is None or AXES[motion.gradient] not in scene.domain.periodic:
        return
    box = at_start.at(checkpoint.time)
    smallest = 0.5 * min(group.diameters[0] for group in before.particles.values())
    in_a_step = abs(motion.speed) * checkpoint.saved["engine"]["clock"]["time_step"]
    if abs(box.offset) <= WIDTH_TOLERANCE * smallest + in_a_step:
        return
    period = float(box.width[motion.flow]) / abs(motion.speed)
    aligned = motion.start + ceil((checkpoint.time - motion.start) / period) * period
    raise SceneError(
        f"{location} at {checkpoint.time:.6g} s the images of its sheared box are displaced by "
        f"{box.offset:.4g} m along {AXES[motion.flow]}, and those of a new run are not; end the earlier run "
        f"when they are aligned, such as at {aligned:.9g} s."
    )


def _spheres(shape: ParticleShape) -> str:
    """What the particles of a group are, for a message."""
    return shape.title.strip() or "spheres"


def _same_body(first: ClumpBody | None, second: ClumpBody | None) -> bool:
    """Whether the particles of two groups are spheres, or clumps of the same spheres."""
    if first is None or second is None:
        return first is second
    tolerance = ROUNDING * first.outer_radius
    return (
        len(first) == len(second)
        and bool(np.allclose(first.radius, second.radius, rtol=0.0, atol=tolerance))
        and bool(np.allclose(first.offset, second.offset, rtol=0.0, atol=tolerance))
    )


def _particles_of_group(
    group: SceneGroup, checkpoint: Checkpoint, number: int, gravity: np.ndarray
) -> ParticleData:
    """Return the particles of group `number` of the earlier scene, ordered by id; gravity (3,) [m/s2] at the
    time of the checkpoint."""
    saved = checkpoint.saved["engine"]
    particles = saved["particles"]
    order = np.argsort(particles["id"], kind="stable")
    in_group = order[saved["accounting"]["group"][particles["id"][order]] == number]
    arrays = {key: values[in_group].astype(np.float64) for key, values in particles.items()}
    time_step = saved["clock"]["time_step"]
    if group.spec.shape.body is not None:
        return _clumps_of_group(group, group.spec.shape.body, arrays, time_step, gravity)
    velocity, angular_velocity = _at_the_time_of_positions(arrays, time_step)
    if group.spec.fixed:
        velocity = np.zeros_like(velocity)
        angular_velocity = np.zeros_like(angular_velocity)
    count = len(in_group)
    return ParticleData(
        position=arrays["position"],
        velocity=velocity,
        angular_velocity=angular_velocity,
        radius=arrays["radius"],
        material=np.full(count, group.material_number, np.int32),
        group=np.full(count, group.number, np.int32),
        initial_values=_values_of_equations(group, arrays),
    )


def _values_of_equations(group: SceneGroup, arrays: dict[str, Any]) -> dict[str, np.ndarray]:
    """Properties of the particle equations of the scene that the earlier run has."""
    names = [each.name for each in group.scene.equations]
    return {name: arrays[name] for name in names if name in arrays}


def _clumps_of_group(
    group: SceneGroup, body: ClumpBody, arrays: dict[str, Any], time_step: float, gravity: np.ndarray
) -> ParticleData:
    """The clumps of a group from the arrays of all their spheres; orientations are those from the given
    positions of the spheres."""
    from granflow.engine.clumps import synchronized_clumps  # `check` does not load Taichi

    first = arrays["id"] == arrays["clump"]
    present = synchronized_clumps(arrays, 0.5 * time_step, gravity)
    count = int(first.sum())
    share = 0.0 if group.spec.fixed else 1.0
    return ParticleData(
        position=arrays["clump_position"][first],
        velocity=share * present["clump_velocity"][first],
        angular_velocity=share * present["angular_velocity"][first],
        radius=np.full(count, body.outer_radius),
        material=np.full(count, group.material_number, np.int32),
        group=np.full(count, group.number, np.int32),
        orientation=product(arrays["orientation"][first], body.principal_axes * [1.0, -1.0, -1.0, -1.0]),
        initial_values={name: each[first] for name, each in _values_of_equations(group, arrays).items()},
    )


def _at_the_time_of_positions(arrays: dict[str, Any], time_step: float) -> tuple[np.ndarray, np.ndarray]:
    """Return velocities [m/s] and angular velocities [rad/s] (n, 3).

    A checkpoint stores those half a step earlier.

    v(t) = v(t - dt/2) + dt/2 F/m,      w(t) = w(t - dt/2) + dt/2 T/I,      I = 2/5 m R^2
    """
    mass = arrays["mass"][:, None]
    radius = arrays["radius"][:, None]
    half = 0.5 * time_step
    velocity = arrays["velocity"] + half * arrays["force"] / mass
    if "angular_velocity" not in arrays:
        return velocity, np.zeros_like(velocity)
    return velocity, arrays["angular_velocity"] + half * arrays["torque"] / sphere_inertia(mass, radius)


def _inconsistencies(group: SceneGroup, particles: ParticleData) -> list[str]:
    """Return a sentence for each contradiction between a group and its particles of the earlier run."""
    spec = group.spec
    name = group.name
    found = []
    if len(particles) > spec.count:
        found.append(
            f"{group.locate('count')}: particles.{name}.count is {spec.count}, but start_from has "
            f"{len(particles)} particles."
        )
    smallest, largest = spec.outer_diameters
    sizes = 2.0 * particles.radius
    if len(particles) and (sizes.min() < smallest * (1 - ROUNDING) or sizes.max() > largest * (1 + ROUNDING)):
        found.append(
            f"{group.locate('diameter')}: particles.{name}.diameter lies in [{smallest:.6g}, "
            f"{largest:.6g}] m, but {name} of the run in start_from has diameters in [{sizes.min():.6g}, "
            f"{sizes.max():.6g}] m. Particles of that run keep their sizes: give its diameter, or insert "
            "those of this size as another group."
        )
    return found
