"""Particles at the start of a run: from the scene, from an earlier run, from arrays, or none for a resumed run."""

import numpy as np

from granflow.errors import GranflowError
from granflow.io.checkpoint import Checkpoint
from granflow.load import Scene
from granflow.particles.generate import initial_particles
from granflow.particles.particle_data import ParticleData
from granflow.plan.forecast.regions import particle_warnings
from granflow.plan.plan import Plan
from granflow.runs.initial_from_run import particles_from_run


def initial_state(
    scene: Scene, plan: Plan, given: ParticleData | None, resumed: Checkpoint | None
) -> tuple[ParticleData | None, list[str]]:
    """The particles at the start, and the names of the groups whose particles do not come from the scene.

    given:    particles that replace those of the scene, or None
    resumed:  checkpoint from which a run continues; there are then no particles to insert
    Raises:   SceneError if particles do not fit, GranflowError for invalid `given` particles
    """
    if resumed is not None:
        if given is not None:
            raise GranflowError("A resumed run has the particles of its checkpoint: leave particles out.")
        return None, list(resumed.saved["earlier"])
    if given is not None:
        refuse_other_particles(plan, given)
        return given, [group.name for number, group in enumerate(plan.groups) if number in given.group]
    earlier = particles_from_run(scene)
    return initial_particles(scene, earlier), list(earlier)


def warnings_before(scene: Scene, plan: Plan, initial: ParticleData | None) -> list[str]:
    """The warnings of the plan, and those about initial particles inside walls; `initial`: None for a resumed run."""
    inside = [] if initial is None else particle_warnings(scene, plan, initial)
    return [*plan.warnings, *inside]


def refuse_other_particles(plan: Plan, given: ParticleData) -> None:
    """Raise GranflowError for particles that are not those of the groups, for which the plan was made."""
    count = len(given)
    if plan.features.clumps:
        raise GranflowError("Particles from Python are not possible in a scene with clumps: leave particles out.")
    for name, limit in (("group", len(plan.groups)), ("material", len(plan.solids))):
        values = getattr(given, name)
        if values.shape != (count,) or np.any((values < 0) | (values >= limit)):
            raise GranflowError(f"particles.{name} has values outside the {limit} of the scene.")
    for number, group in enumerate(plan.groups):
        own = given.group == number
        if own.sum() > group.count:
            raise GranflowError(f"particles has {own.sum()} of {group.name}, but the scene only {group.count}.")
        if any(list(plan.solids)[each] != group.material for each in np.unique(given.material[own])):
            raise GranflowError(f"particles.material is not {group.material} for all of {group.name}.")
    if count and not plan.radius_min <= given.radius.min() <= given.radius.max() <= plan.radius_max:
        raise GranflowError(
            f"particles.radius lies in [{given.radius.min():.6g}, {given.radius.max():.6g}] m, but those of the scene "
            f"in [{plan.radius_min:.6g}, {plan.radius_max:.6g}] m."
        )
    for name in ("position", "velocity", "angular_velocity"):
        if getattr(given, name).shape != (count, 3) or not np.isfinite(getattr(given, name)).all():
            raise GranflowError(f"particles.{name} is not an array ({count}, 3) of finite numbers.")
