"""What precedes a run: its plan with changes and forces from Python, its particles, its engine, and refusals."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from granflow.engine.backend import Backend
from granflow.engine.device_memory import free_device_memory
from granflow.engine.engine import Engine
from granflow.io.checkpoint import Checkpoint
from granflow.live.forces import ParticleForce, plan_with_forces
from granflow.load import Scene
from granflow.particles.particle_data import ParticleData
from granflow.plan.build import plan_for
from granflow.plan.memory_check import refuse_too_many, refuse_without_device_memory, refuse_without_memory
from granflow.plan.plan import Plan
from granflow.plan.ranks import rank_plan
from granflow.plan.run_time import refuse_run_time
from granflow.runs.initial_particles import initial_state, warnings_before
from granflow.runs.insertion import ParticleInsertion
from granflow.runs.python_changes import changed_plan, refuse_other_functions
from granflow.runs.resume import Change, accepted_change, engine_difference

if TYPE_CHECKING:
    from granflow.parallel.communicator import Communicator


@dataclass(frozen=True)
class RunStart:
    """All decisions on a run before files are written and arrays allocated.

    plan:       of the run, with changes from Python
    original:   of the scene
    initial:    particles to insert; None for a resumed run
    earlier:    names of the groups whose particles do not come from the scene
    change:     differences of the scene from that of the checkpoint; None without one
    insertion:  inserters of the scene
    warnings:   sentences on the scene
    """

    plan: Plan
    original: Plan
    initial: ParticleData | None
    earlier: list[str]
    change: Change | None
    insertion: ParticleInsertion
    warnings: list[str]


def run_start(
    scene: Scene,
    backend: Backend,
    given: ParticleData | None,
    resume: Checkpoint | None,
    forces: Sequence[ParticleForce],
    observers: Iterable[str],
    plan: Plan | None = None,
    communicator: "Communicator | None" = None,
    allow_changes: bool = False,
    allow_long: bool = False,
) -> RunStart:
    """Decide on a run; arguments as for `Simulation`, but the names of its observers.

    Raises the errors of `Simulation`.
    """
    original = plan or plan_for(scene, on_gpu=not backend.on_cpu)
    plan = original if resume is None else changed_plan(original, resume)
    plan = plan_with_forces(plan, forces, backend)
    refuse_run_time(plan, allow_long)
    _refuse_size(plan if communicator is None else rank_plan(plan, communicator.size), backend)
    change = None if resume is None else accepted_change(resume, scene, plan, allow_changes)
    if resume is not None:
        refuse_other_functions(resume, plan.external_forces, [*observers], allow_changes)
    initial, earlier = initial_state(scene, plan, given, resume)
    warnings = warnings_before(scene, plan, initial)
    if resume is not None:
        warnings += filter(None, [engine_difference(resume)])
    return RunStart(plan, original, initial, earlier, change, ParticleInsertion(scene, earlier), warnings)


def engine_for(plan: Plan, backend: Backend, communicator: "Communicator | None", scene: Scene) -> Engine:
    """The engine of a run; with a communicator that of the root, and only such runs import it."""
    if communicator is None:
        return Engine(plan, backend)
    from granflow.parallel.rank_engine import RankEngine

    return RankEngine(plan, backend, communicator, scene)


def _refuse_size(plan: Plan, backend: Backend) -> None:
    """Raise SceneError if the particles of this process exceed the range of indices or the memory."""
    refuse_too_many(plan)
    if backend.on_cpu:
        refuse_without_memory(plan)
    else:
        refuse_without_device_memory(plan, free_device_memory(backend.arch), backend.largest_buffer)
