"""Another execution, the same bits: one matrix of scenes and executions, one process per kind of execution."""

import fcntl
import os
from functools import partial
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
import rank_launcher
from bits.executions import OTHER_LISTS, RESUMED, host_executions
from bits.scenes import QUICK, SCENES
from resume.runs import files_of, states_of

from granflow.fields import PART_KINDS, RUN_QUANTITIES, STAGE_QUANTITIES, TOTAL_QUANTITIES
from granflow.runs.result import read_sections, result_of
from granflow.scene.run_numbers import reason_without

PROGRAM = Path(__file__).parent / "executions.py"
pytestmark = pytest.mark.timeout(1200)

NOT_COMPARED = {"stride", "rebuilds", "growths"}
"""The stride and the growths differ by intent; a resumed run begins with a rebuild."""


@pytest.fixture(scope="session")
def folder(tmp_path_factory):
    """One folder for all test processes, so that only one of them makes the reference."""
    base = tmp_path_factory.getbasetemp()
    found = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "bits"
    found.mkdir(exist_ok=True)
    return found


def execute(kind, folder, scenes):
    """Run scenes in one kind of execution."""
    with pytest.MonkeyPatch.context() as changed:
        if kind == "forked":
            changed.setenv("GRANFLOW_KERNELS", "quadrants")
        run = partial(rank_launcher.on_ranks, 2) if kind == "ranks" else rank_launcher.alone
        done = run(PROGRAM, kind, folder, *scenes, seconds=900)
    assert done.returncode == 0, done.stderr[-3000:]


def execute_on_host(folder, scenes, kind):
    """Run scenes in the executions of `host` or `usual`, unless a test process has done it."""
    last = host_executions(scenes[-1], kind == "usual")[-1]
    with open(folder / f"lock_{scenes[0]}", "w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not (folder / last / scenes[-1] / "state.npz").exists():
            execute(kind, folder, scenes)


def loaded(path):
    """Arrays of the state at the end of a run."""
    with np.load(path / "state.npz") as arrays:
        return dict(arrays)


def differences(folder, execution, scene):
    """Names of the arrays and files in which an execution of a scene differs from the reference.

    Signs of zeros in arrays do not count: a code path that adds other zeros has others.
    """
    expected, found = (loaded(folder / each / scene) for each in ("one", execution))
    arrays = {
        name
        for name in (expected.keys() | found.keys()) - NOT_COMPARED
        if not np.array_equal(expected.get(name), found.get(name), equal_nan=True)
    }
    if execution in OTHER_LISTS:  # frames have zeros of other signs
        return sorted(arrays)
    reference, files = (files_of(folder / each / scene) for each in ("one", execution))
    assert len(files) > 3
    return sorted(arrays | {n for n in reference.keys() | files.keys() if reference.get(n) != files.get(n)})


def assert_same_bits(folder, scene, executions):
    found = {execution: differences(folder, execution, scene) for execution in executions}
    assert found and not {key: names for key, names in found.items() if names}, scene


def skip_if_missing(kind):
    """Skip a test without the package that a kind of execution needs."""
    if kind == "ranks" and rank_launcher.MISSING:
        pytest.skip(rank_launcher.MISSING)
    if kind == "forked" and find_spec("quadrants") is None:
        pytest.skip("needs Quadrants: pip install quadrants")


def check_host(folder, scenes, kind):
    """Workers, in slow tests more than threads of the pool, other lists, and runs resumed from checkpoints.

    The features of the scenes have had effects in the reference, over several rebuilds.
    """
    execute_on_host(folder, scenes, kind)
    for scene in scenes:
        found = loaded(folder / "one" / scene)
        assert found["rebuilds"] >= 3 and found["totals.contact_count"] >= 1  # one at a time in a gas
        assert all(found[f"totals.{name}"] != 0.0 for name in SCENES[scene].effects), scene
        _one, *others = host_executions(scene, kind == "usual")
        assert_same_bits(folder, scene, others)
        whole = states_of(folder / "one" / scene)
        assert len(whole) >= 10
        last_resumed = [each for each in others if each in RESUMED][-1]
        assert states_of(folder / last_resumed / scene) == whole


def check_kind(folder, kind, scene):
    """Another kind of execution than those of `host`, which have been run."""
    execute(kind, folder, [scene])
    assert_same_bits(folder, scene, [kind])
    if (kind, scene) == ("ranks", "walls"):
        assert loaded(folder / kind / scene)["growths"] >= 2, "for particles and for neighbor lists"
    if kind == "gpu":
        strides = {int(loaded(folder / each / scene)["stride"]) for each in ("one", "gpu")}
        assert len(strides) == 2, "the code paths differ"


def test_threads_lists_and_resumed_runs_have_the_same_bits(folder):
    check_host(folder, list(QUICK), "usual")


def test_the_numbers_of_a_run_are_those_that_the_check_of_the_scene_allows(folder):
    """Of all names of numbers, with all names of parts, the check refuses those that the result lacks.

    A program can add forces, whose work is `external_work`; ranks have further timings.
    """
    execute_on_host(folder, list(QUICK), "usual")
    for name in QUICK:
        scene = QUICK[name].build()
        parts = [
            *(*scene.walls, *scene.particles, *scene.stage_names, *scene.outlets, *scene.output.metrics),
            *(*scene.output.flow_meters, "forces"),
        ]
        quantities = {each for kind in PART_KINDS for each in kind.quantities}
        whole = (*TOTAL_QUANTITIES, *STAGE_QUANTITIES, *RUN_QUANTITIES)
        names = {*whole, *(f"{quantity}.{part}" for quantity in quantities for part in parts)}
        found = result_of(read_sections(folder / "one" / name / "result.json")).numbers.keys() & names
        allowed = {each for each in names if not reason_without(scene, each)}
        differing = {each for each in allowed ^ found if not each.startswith("external_work")}
        assert len(found) > 50 and not differing, name


OTHER_KERNELS = {"gpu": "clumps", "long": "films", "forked": "walls"}
"""Scene of the usual test run by kind of execution that compiles other kernels; for ranks: `mpi/test_ranks`."""


@pytest.mark.parametrize("kind", OTHER_KERNELS)
def test_other_kernels_give_the_same_bits(folder, kind):
    skip_if_missing(kind)
    execute_on_host(folder, list(QUICK), "usual")
    check_kind(folder, kind, OTHER_KERNELS[kind])


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("scene", SCENES)
@pytest.mark.parametrize("kind", ["host", *OTHER_KERNELS, "ranks"])
def test_each_scene_has_the_same_bits(folder, scene, kind):
    skip_if_missing(kind)
    folder = folder / "each"
    folder.mkdir(exist_ok=True)
    if kind == "host":
        check_host(folder, [scene], kind)
    elif kind != "ranks" or SCENES[scene].on_ranks:
        execute_on_host(folder, [scene], "host")
        check_kind(folder, kind, scene)
