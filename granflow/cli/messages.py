"""What a verb says: one sentence on stderr, an exit code, a table."""

import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO

from granflow.errors import FileError, GranflowError
from granflow.visible_text import visible

if TYPE_CHECKING:
    from granflow.observe import Result

COLLIDE_UNITS = {
    "duration": "s",
    "overlap_max": "m",
    "overlap_residual": "m",
    "force_max": "N",
    "spring_equation19": "N/m",
    "time_step": "s",
    "velocity": "m/s",
}
WIDE = 160
"""Columns of a table that goes to a file: wide enough that no number is cut."""
EXIT_INTERRUPTED = 130
EXIT_TERMINATED = 143


class Terminated(KeyboardInterrupt):
    """SIGTERM came: ends a run in the same orderly way as Ctrl-C."""


def say(*parts: object, sep: str = " ", file: TextIO | None = None, flush: bool = False) -> None:
    """Print text that may hold titles, names or headers of files from elsewhere; the only `print` of the commands."""
    print(visible(sep.join(map(str, parts))), file=file, flush=flush)


def print_refusal(error: GranflowError) -> int:
    """Show an error of ours without a traceback and give its exit code; problems of a file are counted."""
    problems = error.problems if isinstance(error, FileError) else ()
    if not problems:
        return print_error(str(error), error.exit_code)
    for problem in problems:
        say(problem, file=sys.stderr)
    say(f"{len(problems)} problem{'s' if len(problems) > 1 else ''} found.", file=sys.stderr)
    return error.exit_code


def print_error(sentence: str, exit_code: int = GranflowError.exit_code) -> int:
    """Say one sentence on stderr and give the exit code."""
    say(f"granflow: {sentence}", file=sys.stderr)
    return exit_code


def warn(sentences: Iterable[str]) -> None:
    """Say on stderr what does not keep a scene from running but should be known."""
    for sentence in sentences:
        say(f"granflow: warning: {sentence}", file=sys.stderr)


def exit_code_of(stop: KeyboardInterrupt) -> int:
    """The exit code that shells give to a process ended by that signal."""
    return EXIT_TERMINATED if isinstance(stop, Terminated) else EXIT_INTERRUPTED


def write_study(out: Path, write: Callable[..., None], *numbers: Any) -> None:
    """Write the files of a study; without matplotlib those that need none, and say so."""
    try:
        write(out, *numbers)
    except GranflowError as error:
        say(error)
    say(f"Written to {out}")


def show_result(title: str, result: "Result", out: Path) -> None:
    """Print the closing table, the expectations, and what to open."""
    from rich.console import Console

    from granflow.observe import closing_table

    Console().print(closing_table(result, visible(title)))
    for sentence, met in result.expectations:
        say(sentence if met else f"NOT AS EXPECTED: {sentence}")
    for group, numbers in result.insertion.items():
        if numbers["not_inserted_count"]:
            say(f"{numbers['not_inserted_count']:.0f} {group} have not come: {out / 'run.log'} says why.")
    series = sorted(str(path) for path in out.glob("*.pvd"))
    if series:
        say(f"For ParaView: {', '.join(series)}")
    say(f"Numbers: {out / 'timeseries.csv'}, {out / 'result.json'}")


def show_comparison(numbers: Mapping[str, Any]) -> None:
    """Print what a collision reached beside what was asked of it or what theory promises."""
    promises = ("_asked", "_theory")
    rows = []
    for name in (name for name in numbers if not name.endswith(promises)):
        promised = [as_text(numbers[name + end]) for end in promises if name + end in numbers]
        unit = COLLIDE_UNITS.get(name, "")
        rows.append(
            (
                name.replace("_", " ").replace("equation19", "of Eq. 19"),
                as_text(numbers[name]),
                *(promised or [""]),
                unit,
            )
        )
    show_table("head-on collision", ("", "reached", "asked or closed form", "unit"), rows)


def show_table(title: str, heads: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print a table with right-aligned figures to the terminal, or plain to a file."""
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table(title=Text(visible(title)), title_justify="left", show_header=any(heads), box=None, pad_edge=False)
    for column, head in enumerate(heads):
        table.add_column(visible(head), justify="left" if column == 0 else "right", no_wrap=column > 0)
    for row in rows:
        table.add_row(*(Text(visible(cell)) for cell in row))
    Console(width=None if sys.stdout.isatty() else WIDE).print(table)


def as_text(value: Any) -> str:
    """A number with seven digits, anything else as it is."""
    return f"{value:.7g}" if isinstance(value, float) else str(value)
