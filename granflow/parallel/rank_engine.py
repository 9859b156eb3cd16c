"""The engine of one MPI rank, and the program of the ranks that are not the root.

The root (rank 0) executes the program of the user, as without MPI. Its `RankEngine` sends each call that
concerns all ranks as a command, the name of the method with its arguments; the other ranks wait for commands
in `serve`, and call the same method of their engines. A failure of one rank ends all of them.
"""

import atexit
import gc
import sys
import time
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from functools import wraps
from typing import Any, TypeVar

import numpy as np

from granflow.engine.abort import Diagnosis, diagnose
from granflow.engine.backend import Backend
from granflow.engine.codes import ABORT_WALL
from granflow.engine.engine import Engine, host_particles
from granflow.engine.host import HostParticles, joined_particles, saved_particle_table
from granflow.engine.state import NO_CHANGES, State
from granflow.errors import GranflowError
from granflow.fields import PARTICLE_QUANTITIES
from granflow.io.checkpoint import CheckpointError, RankFile
from granflow.load import Scene, identity_of
from granflow.parallel.communicator import END, Communicator
from granflow.parallel.rank_stepper import RankStepper
from granflow.plan.build import rank_plan
from granflow.plan.plan import Plan
from granflow.scene.blocks.motions import TimedMotion
from granflow.snapshot import Snapshot

_T = TypeVar("_T")
START = "start"
"""Command that creates the engines; all others but END are names of methods of `RankEngine`."""


def _ranks_with_another_scene(communicator: Communicator, scene: Scene) -> list[int]:
    """Ranks whose scene, contents of its files or version of granflow differ from those of the root."""
    found = communicator.from_each(identity_of(scene))
    return [rank for rank, identity in enumerate(found) if identity != found[0]]


def _on_all_ranks(name: str) -> Any:
    """The method of Engine with this name; on the root it lets all other ranks call it, too."""
    inherited = getattr(Engine, name)

    @wraps(inherited)
    def call(self: "RankEngine", *arguments: Any) -> Any:
        with self.communicator.commanding(name, arguments):
            return inherited(self, *arguments)

    return call


class OtherScene(GranflowError):
    """A rank has another scene, other contents of its files, or another version of granflow than the root."""


class RankEngine(Engine):
    """As `Engine`, for a part of the particles. On the root, arrays and totals are those of all particles.

    plan:    of the complete scene
    Raises:  OtherScene on all ranks if their scenes differ, before any of them has an engine
    """

    stepper: RankStepper

    def __init__(self, plan: Plan, backend: Backend, communicator: Communicator) -> None:
        self.communicator = communicator
        with communicator.commanding(START):
            different = _ranks_with_another_scene(communicator, plan.scene)
            if not different:
                self._create(plan, backend)
        if different:
            ranks = ", ".join(map(str, different))
            raise OtherScene(
                f"The scene of rank {ranks} differs from that of rank 0, {plan.scene.path}, in its values, "
                "in a file that it reads, or in the version of granflow: give all ranks the same files and "
                "the same installation."
            )

    def _create(self, plan: Plan, backend: Backend) -> None:
        """Create the engine of this rank, together with all other ranks."""
        super().__init__(rank_plan(plan, self.communicator.size, backend.worker_count), backend)
        self.state.ranks = self.communicator
        gc.collect()
        # Otherwise a step in some hundreds takes 60 ms longer: Python searches all objects of the compiler.
        gc.freeze()
        atexit.register(gc.unfreeze)  # else Taichi is not destroyed, which stores the compiled kernels
        self.communicator.barrier()

    def free(self) -> None:
        """As `Engine`; the objects of the process are searched for cycles again."""
        super().free()
        gc.unfreeze()

    insert = _on_all_ranks("insert")
    set_walls = _on_all_ranks("set_walls")
    begin_stage = _on_all_ranks("begin_stage")
    set_stage = _on_all_ranks("set_stage")
    set_gravity = _on_all_ranks("set_gravity")
    apply_settings = _on_all_ranks("apply_settings")
    delete = _on_all_ranks("delete")
    refresh = _on_all_ranks("refresh")
    snapshot = _on_all_ranks("snapshot")
    observe = _on_all_ranks("observe")
    copied = _on_all_ranks("copied")
    synchronized = _on_all_ranks("synchronized")
    saved_sums = _on_all_ranks("saved_sums")
    rest_state = _on_all_ranks("rest_state")
    permit_overlap = _on_all_ranks("permit_overlap")

    def advance(self, steps: int) -> None:
        """As `Engine`, on all ranks; a stop signal of any rank is then known to the root, which stops."""
        with self.communicator.commanding("advance", (steps,)):
            super().advance(steps)
            if self.stepper.stop_signal:
                self.stepper.requested_stop = 0

    def _new_stepper(self) -> RankStepper:
        return RankStepper(self.state, self.communicator, self._account_deleted)

    @property
    def particle_count(self) -> int:
        """Number of particles of all ranks."""
        return self.accounting.inserted_count - self.accounting.deleted_count

    def _snapshot(self, stage: str, quantities: frozenset[str], observed: bool) -> Snapshot:
        """As `Engine`; the stability is checked on the root only, which has all particles."""
        return super()._snapshot(stage, quantities, observed and self.communicator.is_root)

    def _append(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Take a part of the particles; the next rebuild moves them to the ranks that own their positions."""
        share = np.array_split(np.arange(len(arrays["id"])), self.communicator.size)[self.communicator.rank]
        table = saved_particle_table(self.state)
        part = {}
        for name, example in table.take(np.zeros(0, np.int32)).items():
            values = arrays.get(name, PARTICLE_QUANTITIES[name].default)
            values = np.broadcast_to(values, (len(arrays["id"]), *example.shape[1:]))
            part[name] = values[share].astype(example.dtype)
        self.stepper.pending.append(part)

    def on_each_rank(self, task: Callable[[Engine, int], _T]) -> list[_T]:
        """As `Engine`; the results of all ranks on the root. `task` is a function of a module, or a partial
        one."""
        found: _T | OSError
        with self.communicator.commanding("on_each_rank", (task,)):
            try:
                found = task(self, self.communicator.rank)
            except OSError as error:
                found = error
            results = self.communicator.to_root(found)
        for result in results:
            if isinstance(result, OSError):
                raise result
        return [result for result in results if not isinstance(result, OSError)]

    def restore(
        self,
        saved: Mapping[str, Any],
        particles: HostParticles | None,
        motions: Sequence[Sequence[TimedMotion]],
        files: Sequence[RankFile] = (),
    ) -> None:
        """As `Engine`; on the root with particles and the sums of all ranks, on the others without any.

        files:   of further particles; each rank reads a part of them
        Raises:  GranflowError on the root for an invalid file
        """
        arguments = (dict(saved) | {"energy_budget": {}}, None, motions, files)
        with self.communicator.commanding("restore", arguments):
            share, problem = share_of_checkpoint(self.state, self.communicator, particles, files)
            if problem is None:
                super().restore(saved, share, motions)
        if problem is not None and self.communicator.is_root:
            raise CheckpointError(problem)

    def begin_change(self) -> None:
        """Raise GranflowError: the root has a part of the particles only."""
        raise GranflowError(NO_CHANGES)

    def _kick(self, time: float, first_id: int = 0) -> None:
        """As `Engine`, also for the ghosts."""
        super()._kick(time, first_id)
        self.stepper.update_ghosts()

    @property
    def diagnosis(self) -> Diagnosis | None:
        """Diagnosis of an aborted run; None if the run has not aborted."""
        return self.rank_diagnosis() if self.stepper.abort_code else None

    def rank_diagnosis(self) -> Diagnosis | None:
        """Diagnosis on the root, computed by the rank of the particle; None on the other ranks."""
        with self.communicator.commanding("rank_diagnosis"):
            code = self.stepper.abort_code
            particle = int(self.state.control.abort_particle[0])
            found = None
            if self.stepper.holds(particle) or (code == ABORT_WALL and self.communicator.is_root):
                found = diagnose(
                    code, particle, self.state, self.time, self._velocities_lag, self._stopping_change
                )
            return next((each for each in self.communicator.to_root(found) if each is not None), None)


# Reading a checkpoint: each rank reads a part of the files


def share_of_checkpoint(
    state: State, communicator: Communicator, particles: HostParticles | None, files: Sequence[RankFile]
) -> tuple[HostParticles, str | None]:
    """The particles that this rank reads, and a sentence on a problem of any rank, or None; all ranks call
    this.

    particles:   of the checkpoint itself, on the root
    files:       with the other particles
    """
    parts = [no_particles(state) if particles is None else particles]
    problem = None
    try:  # the root, which has particles already, is the last one to read a file
        for file in files[(communicator.rank - 1) % communicator.size :: communicator.size]:
            parts.append(host_particles(state, file.read()))
    except GranflowError as error:
        problem = str(error)
    return joined_particles(parts), next(filter(None, communicator.from_each(problem)), None)


def no_particles(state: State) -> HostParticles:
    """Empty arrays and histories of the state."""
    none = saved_particle_table(state).take(np.zeros(0, np.int32))
    contacts = {"count": np.zeros(0, np.int64), "partner": np.zeros(0, np.int32)}
    return host_particles(state, {"particles": none, "contacts": contacts})


# The program of each rank

TIME_TO_FORWARD = 0.5
"""Time [s] from the message of a failed rank to the end of all ranks, for mpirun to forward the message: it
discards what it has not read when the ranks end."""
EXIT_FAILED_RANK = 3
"""Exit code of all ranks after a failure of one of them."""


def serve(communicator: Communicator, engine: Callable[[], RankEngine]) -> None:
    """Execute the commands of the root until it ends the run.

    engine:  creates the engine of this rank
    """
    with _fatal(communicator):
        present: RankEngine | None = None
        while True:
            name, arguments = communicator.next_command()
            if name == END:
                if present is not None:
                    present.free()  # a later run of this process takes its state, with the compiled kernels
                return
            if name == START:
                with suppress(OtherScene):  # the root reports it and ends the other ranks
                    present = engine()
            else:
                getattr(present, name)(*arguments)


@contextmanager
def controlling(communicator: Communicator) -> Iterator[None]:
    """On the root: in the block, the other ranks execute commands; they end with it.

    An exception that interrupts a command, or that is not an error of the input, ends all ranks at once.
    """
    with _fatal(communicator):
        try:
            yield
        except (GranflowError, OSError, KeyboardInterrupt):
            if not communicator.is_idle:
                _abort(communicator)
            communicator.end()
            raise
    communicator.end()


@contextmanager
def _fatal(communicator: Communicator) -> Iterator[None]:
    """In the block, an exception that is not an error of the input ends all ranks."""
    try:
        yield
    except (GranflowError, OSError, KeyboardInterrupt):
        if communicator.is_root:
            raise
        _abort(communicator)
    except BaseException:
        _abort(communicator)


def _abort(communicator: Communicator) -> None:
    """Print the exception that is handled, one sentence for an error of the input, and end all ranks."""
    error = sys.exc_info()[1]
    is_sentence = isinstance(error, GranflowError | OSError)
    reason = f"granflow: {error}\n" if is_sentence else traceback.format_exc()
    sys.stderr.write(f"granflow: rank {communicator.rank} failed, which ends all ranks.\n{reason}")
    sys.stderr.flush()
    time.sleep(TIME_TO_FORWARD)
    communicator.abort(EXIT_FAILED_RANK)
