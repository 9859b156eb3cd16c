"""Scenes that cannot run on MPI ranks yet."""

from collections.abc import Iterator, Sequence

from granflow.errors import GranflowError, SceneError
from granflow.load import Scene
from granflow.observers.coarse_graining.accumulation import CONTACT_FIELDS
from granflow.plan.walls import is_force_controlled
from granflow.scene.schema.analysis import FabricMetric, SlidingMetric

REMEDY = "run the scene without --mpi"


def refuse_on_ranks(scene: Scene, arch: str = "cpu", forces: Sequence[object] = ()) -> None:
    """Raise SceneError for parts of a scene that do not run on ranks.

    arch:    architecture; GranflowError for another one than the CPU
    forces:  forces from Python; GranflowError for any
    """
    if arch != "cpu":
        raise GranflowError(f"--arch {arch} does not work with --mpi, which runs on CPUs only: leave --arch out.")
    if forces:
        raise GranflowError("Forces from Python do not work on MPI ranks: run without a communicator.")
    if problems := [*rank_problems(scene)]:
        raise SceneError(problems)


def rank_problems(scene: Scene) -> Iterator[str]:
    """One sentence with position for each key of the scene that does not work with --mpi."""
    for keys, value, remedy in _refused(scene):
        yield f"{scene.locate(*keys)}: {'.'.join(keys)} {value} does not work with --mpi: {remedy}."


def _refused(scene: Scene) -> Iterator[tuple[tuple[str, ...], str, str]]:
    """Key, its value in words, and the remedy."""
    if scene.domain.lees_edwards is not None:
        yield ("domain", "lees_edwards"), "(a sheared box)", REMEDY
    if scene.run.time_step == "adaptive":
        yield ("run", "time_step"), "adaptive", "set it to auto"
    for name in scene.outlets:
        yield ("outlets", name), "(an outlet)", REMEDY
    for name, wall in scene.walls.items():
        if is_force_controlled(wall):
            kinds = " and ".join(dict.fromkeys(each.kind for each in wall.motion))
            yield ("walls", name, "motion"), f"({kinds})", "prescribe the motion"
    yield from _refused_output(scene)


def _refused_output(scene: Scene) -> Iterator[tuple[tuple[str, ...], str, str]]:
    """The same for the block `output`: what needs a list of all contacts."""
    output = scene.output
    if output.contacts:
        yield ("output", "contacts"), "true", "set it to false"
    if scene.measured_walls and output.walls:
        yield ("output", "walls"), "true with output.wall_forces", "set it to false; timeseries.csv has the forces"
    for name, field in output.fields.items():
        if not set(CONTACT_FIELDS).isdisjoint(field.quantities):
            yield ("output", "fields", name), "with stresses of contacts", "select other quantities"
    for name, metric in output.metrics.items():
        if isinstance(metric, FabricMetric | SlidingMetric):
            yield ("output", "metrics", name), f"({metric.kind})", "remove it"
