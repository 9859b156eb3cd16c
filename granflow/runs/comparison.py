"""Comparison of runs that exist: the keys of their scenes and the numbers of their results that differ."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite, nan
from pathlib import Path

from granflow.errors import GranflowError
from granflow.io.files import replacing, resolved
from granflow.io.tables import write_table
from granflow.runs.read_run import Run, read_run
from granflow.runs.resume import differences, shown_value
from granflow.scene.blocks.output import unit_of

OF_THE_MACHINE = ("timings.", "wall_clock", "steps_per_second", "particle_steps_per_second")
"""Beginnings of the names of numbers that depend on the machine, which are not compared."""


@dataclass(frozen=True)
class NumberRow:
    """A number of several runs by its name in `expect`; nan for a run that does not have it."""

    name: str
    values: tuple[float, ...]

    @property
    def unit(self) -> str:
        """Its unit; empty without one."""
        return unit_of(self.name)

    @property
    def differs(self) -> bool:
        """Whether the runs have different values, or some have none."""
        first = self.values[0]
        return any(each != first and not (each != each and first != first) for each in self.values[1:])

    def relative(self, index: int) -> float:
        """Difference of a run from the first one, over the magnitude of the first; nan without."""
        first = self.values[0]
        return (self.values[index] - first) / abs(first) if first else nan


@dataclass(frozen=True)
class RunComparison:
    """Runs side by side.

    names:      of the runs: directories, or their paths if names are equal
    keys:       of the scenes that differ, with the value of each run as text
    numbers:    of the results, in the order of the first run
    of_stages:  names of those that are means or largest values of one stage
    remarks:    a sentence for each run that is not complete
    """

    names: tuple[str, ...]
    keys: tuple[tuple[str, tuple[str, ...]], ...]
    numbers: tuple[NumberRow, ...]
    of_stages: frozenset[str]
    remarks: tuple[str, ...]

    def write(self, out: Path) -> list[Path]:
        """Write `numbers.csv` and `scene.csv` to a directory, each atomically; return their paths."""
        out.mkdir(parents=True, exist_ok=True)
        numbers: list[list[object]] = [
            [row.name, row.unit, *(each if isfinite(each) else None for each in row.values)]
            for row in self.numbers
        ]
        tables: dict[str, tuple[list[str], list[list[object]]]] = {
            "numbers.csv": (["quantity", "unit", *self.names], numbers),
            "scene.csv": (["key", *self.names], [[key, *values] for key, values in self.keys]),
        }
        for name, (heads, rows) in tables.items():
            with replacing(out / name) as temporary:
                write_table(temporary, heads, rows)
        return [out / name for name in tables]


def compare_runs(directories: Sequence[Path]) -> RunComparison:
    """Compare runs in their directories with the first one.

    Raises GranflowError for fewer than two runs, a repeated one, and a run without results.
    """
    if len(directories) < 2:
        raise GranflowError(f"{directories[0]} is one run: give at least two, or a scene file.")
    if len({resolved(each) for each in directories}) < len(directories):
        raise GranflowError("A run is given twice: give each once.")
    runs = [read_run(each) for each in directories]
    for run in runs:
        if run.result is None:
            raise GranflowError(
                f"{run.directory} has no result.json: the run is {run.status}. Continue it with granflow "
                f"resume {run.directory}, or leave it out."
            )
    found = [{} if run.result is None else run.result.numbers for run in runs]
    named = dict.fromkeys(name for each in found for name in each if not name.startswith(OF_THE_MACHINE))
    return RunComparison(
        names=_names(directories),
        keys=_differing_keys(runs),
        numbers=tuple(NumberRow(name, tuple(float(each.get(name, nan)) for each in found)) for name in named),
        of_stages=frozenset(
            f"{name}.{stage}"
            for run in runs
            if run.result is not None
            for stage, numbers in run.result.stages.items()
            for name in numbers
        ),
        remarks=tuple(
            f"{run.directory} is {run.status}, at {run.time:.6g} s."
            for run in runs
            if run.status != "complete"
        ),
    )


def _names(directories: Sequence[Path]) -> tuple[str, ...]:
    """Names of the directories, or their paths if names are equal."""
    names = tuple(resolved(each).name for each in directories)
    return names if len(set(names)) == len(names) else tuple(map(str, directories))


def _differing_keys(runs: Sequence[Run]) -> tuple[tuple[str, tuple[str, ...]], ...]:
    """Keys of the scenes that differ from those of the first run, and their values as text."""
    first, *others = (run.scene for run in runs)
    by_run = [{each.key: each for each in differences(first, other)} for other in others]
    found = []
    for key in dict.fromkeys(key for each in by_run for key in each):
        before = next(each[key].before for each in by_run if key in each)
        values = [before, *(each[key].now if key in each else before for each in by_run)]
        found.append((key, tuple("–" if value is None else shown_value(value) for value in values)))
    return tuple(found)
