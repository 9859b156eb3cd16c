"""The observers of a run: one snapshot for all that are due, their readings, and their state."""

import logging
from collections.abc import Callable, Mapping, Sequence
from math import inf

from granflow.arguments import GuardedList, items_of, shown
from granflow.errors import FunctionError, GranflowError, StopRun
from granflow.observers.frames import Frames
from granflow.observers.observer import (
    Checkpointable,
    Observer,
    ScheduledObserver,
    WritesFiles,
    refuse_generator,
)
from granflow.observers.timeseries import Row, TimeSeries
from granflow.runs.timings import Readings
from granflow.snapshot import Snapshot

TakeSnapshot = Callable[[frozenset[str]], Snapshot]
"""Function from the requested quantities to a snapshot of the present state."""


class ObserverList(GuardedList[Observer]):
    """The observers of a run, in the order in which they receive snapshots.

    Those of the scene come first, then those from Python.

    `append` and `remove` change the list, also while the simulation runs and from within an observer. A
    checkpoint contains which observers of the scene were removed, and the names of the functions from Python.

    from_scene:  observers of the scene's output block
    added:       observers from Python
    """

    _name = "observers"

    def __init__(self, from_scene: Sequence[Observer], added: Sequence[Observer]) -> None:
        refuse_other_objects(added)
        for observer in added:
            self._begin(observer)
        self._from_scene = tuple(from_scene)
        self._items = (*from_scene, *added)
        self._series = [observer for observer in self._items if isinstance(observer, TimeSeries)][:1]
        self._last_time: float | None = None
        self._raised: BaseException | None = None

    def _begin(self, observer: Observer) -> None:
        """Take an observer into this run.

        Raises GranflowError if it belongs to another one, which has not ended.
        """
        if isinstance(observer, ScheduledObserver) and not observer.begin(self):
            raise GranflowError(
                f"{name_of(observer)} is an observer of another simulation, which has not been freed: create "
                "one for each simulation with granflow.on_interval(interval, function)."
            )

    def __repr__(self) -> str:
        return f"[{', '.join(map(name_of, self._items))}]"

    def append(self, observer: Observer) -> None:
        """Add an observer; after the start of the run, its first snapshot is that of its next due time.

        Raises GranflowError for another object, such as a function without an interval.
        """
        refuse_other_objects([observer])
        if observer in self._items:
            raise GranflowError(f"{name_of(observer)} is an observer of this simulation already.")
        self._begin(observer)
        if self._last_time is not None and isinstance(observer, ScheduledObserver):
            observer.skip_to(self._last_time)
        self._items = (*self._items, observer)

    def remove(self, observer: Observer) -> None:
        """Remove an observer and close its files. Raises GranflowError if it is not in the list."""
        if observer not in self._items:
            raise GranflowError(f"{name_of(observer)} is not an observer of this simulation.")
        self._items = tuple(each for each in self._items if each is not observer)
        observer.finish()
        if isinstance(observer, ScheduledObserver):
            observer.end()

    @property
    def raised(self) -> BaseException | None:
        """Exception, such as SystemExit, by which a function from Python ended the program.

        The state is complete then.
        """
        return self._raised

    def next_time(self) -> float:
        """Return the simulated time [s] of the next due observer; infinite without."""
        return min((observer.next_time() for observer in self._items), default=inf)

    def notify_due(self, is_reached: Callable[[float], bool], take: TakeSnapshot) -> None:
        """Pass one snapshot to the observers that are due; `is_reached`: whether a time [s] is reached.

        Raises StopRun after all of them have received it, FunctionError if a function from Python fails.
        """
        if due := [observer for observer in self._items if is_reached(observer.next_time())]:
            self._pass_snapshot(due, take, frozenset(), only_finite=False)

    def notify_all(
        self, take: TakeSnapshot, quantities: frozenset[str] = frozenset(), only_finite: bool = False
    ) -> Snapshot:
        """Pass a snapshot to all observers and return it.

        quantities:   quantities in addition to those that the observers request
        only_finite:  pass it only if all its numbers are finite
        Raises:       as `notify_due`
        """
        return self._pass_snapshot(self._items, take, quantities, only_finite)

    def _pass_snapshot(
        self, observers: Sequence[Observer], take: TakeSnapshot, quantities: frozenset[str], only_finite: bool
    ) -> Snapshot:
        snapshot = take(quantities.union(*(observer.wants for observer in observers)))
        self._last_time = snapshot.time
        stop = None
        for observer in observers if not only_finite or snapshot.is_finite else ():
            if observer in self._items:  # another one may have removed it
                try:
                    self._observe(observer, snapshot)
                except StopRun as stopped:
                    stop = stopped
        if stop is not None:
            raise stop
        return snapshot

    def _observe(self, observer: Observer, snapshot: Snapshot) -> None:
        """Pass a snapshot to an observer; an Exception of one from Python becomes a FunctionError."""
        try:
            observer.observe(snapshot)
        except (StopRun, FunctionError):
            raise
        except Exception as error:
            if observer in self._from_scene:
                raise
            raise FunctionError(
                f"The function {name_of(observer)} failed at {snapshot.time:.6g} s: {type(error).__name__}: "
                f"{error}"
            ) from error
        except BaseException as error:
            if observer not in self._from_scene:
                self._raised = error
            raise

    def readings(self) -> Mapping[str, Readings]:
        """Return the numbers of the flow meters, wall forces and metrics."""
        return self._series[0].results_by_kind() if self._series else {}

    def row_at(self, time: float) -> Row | None:
        """Return the row of the time series at `time` [s]; None if there is none."""
        rows = [series.last_row for series in self._series if series in self._items]
        return next((row for row in rows if row is not None and row.time == time), None)

    def log_end(self) -> None:
        """Log a warning for each metric whose last value is undefined or misleading.

        One more warning reports missing frames.
        """
        sentences = [sentence for series in self._series for sentence in series.remarks()]
        for sentence in [*sentences, *self._remark_on_frames()]:
            logging.getLogger("granflow").warning("%s", sentence)

    def _remark_on_frames(self) -> list[str]:
        """A sentence on frames that another program has deleted or moved since; empty without such frames."""
        found = []
        for series in (observer.series for observer in self._items if isinstance(observer, Frames)):
            if missing := series.missing():
                counts = f"{len(missing)} of the {len(series.frames)} frames in {series.listing.name}"
                found.append(f"{counts} (the first is {missing[0]})")
        if not found:
            return []
        return [f"Frames no longer exist: {', '.join(found)}. Another program has deleted or moved them."]

    @property
    def rows_intact(self) -> bool:
        """Whether the time series still has all rows of the resumed run."""
        return all(series.rows_intact for series in self._series)

    @property
    def function_names(self) -> list[str]:
        """Names of the functions of the observers from Python."""
        return [name_of(observer) for observer in self._items if observer not in self._from_scene]

    @property
    def removed_names(self) -> list[str]:
        """Names in checkpoints of the observers of the scene that were removed."""
        return [name for name, each in _by_name(self._from_scene).items() if each not in self._items]

    def remove_named(self, names: Sequence[str]) -> None:
        """Remove the observers of the scene with these names in checkpoints, without an effect on files."""
        removed = [each for name, each in _by_name(self._from_scene).items() if name in names]
        self._items = tuple(each for each in self._items if each not in removed)

    def checkpointed(self) -> dict[str, Checkpointable]:
        """Return the observers whose state is part of checkpoints, by unique names."""
        named = _by_name(self._from_scene) | _by_name([each for each in self if each not in self._from_scene])
        return {
            name: each for name, each in named.items() if isinstance(each, Checkpointable) and each in self
        }

    def sync(self) -> None:
        """Flush the files of the observers of the scene to the disk: a checkpoint names their sizes."""
        for observer in self._items:
            if isinstance(observer, WritesFiles):
                observer.sync()

    def finish(self) -> None:
        """Close the files of all observers."""
        for observer in self._items:
            observer.finish()

    def end(self) -> None:
        """Leave the observers to later simulations."""
        for observer in self._items:
            if isinstance(observer, ScheduledObserver):
                observer.end()


def refuse_other_objects(given: Sequence[object]) -> None:
    """Raise GranflowError for an object that is not an observer."""
    for each in items_of("observers", given, "observers, such as granflow.on_interval(interval, function)"):
        if not all(hasattr(each, name) for name in ("wants", "next_time", "observe", "finish")):
            name = getattr(each, "__name__", shown(each))
            raise GranflowError(f"{name} is not an observer: give granflow.on_interval(interval, {name}).")
        refuse_generator(each.observe)


def name_of(observer: Observer) -> str:
    """Name of the function of an observer, otherwise of its class."""
    return str(getattr(observer, "name", type(observer).__name__))


def _by_name(observers: Sequence[Observer]) -> dict[str, Observer]:
    """The observers by class or function and number: "ParticleFrames 0", "report 0"."""
    found: dict[str, Observer] = {}
    for observer in observers:
        name = name_of(observer)
        found[f"{name} {sum(other.rpartition(' ')[0] == name for other in found)}"] = observer
    return found
