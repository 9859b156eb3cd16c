"""Writes tables about the shipped scenes from stored numbers; the tables are not edited by hand.

docs/pages/scenes.md has the comparisons with published values between markers, tools/scene_expectations.md the
`expect` of every scene with the results of recorded runs.

python tools/scene_table.py                     write the tables into both files
python tools/scene_table.py --check             exit code 1 if the tables differ from the stored numbers
python tools/scene_table.py --record out/mixer  first store the numbers of a finished run from its result.json

docs/scenes_comparisons.yaml contains the published and the measured values of the comparisons, with date and
commit of the measurement. docs/scenes_results.json contains the results of the shipped scenes for the
quantities of their `expect`, with date, commit, processor and run time. Record a run on the machine that computed
it.
"""

import argparse
import datetime
import json
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from benchmark.machine import machine
from ruamel.yaml import YAML

from granflow import read_run
from granflow.cli.run import scene_paths
from granflow.io.log import sessions
from granflow.load import Scene, load_scene
from granflow.scene.blocks.output import unit_of

ROOT = Path(__file__).resolve().parents[1]
PAGE, SCENES = ROOT / "docs" / "pages" / "scenes.md", ROOT / "scenes"
EXPECTATIONS = ROOT / "tools" / "scene_expectations.md"
COMPARISONS, RESULTS = ROOT / "docs" / "scenes_comparisons.yaml", ROOT / "docs" / "scenes_results.json"
COLUMNS = ("scene", "what it shows", "granflow", "published or theory", "deviation", "run time")


def names() -> list[str]:
    """Names of the shipped scenes, without sweeps and calibrations: paths relative to scenes/ without
    suffix."""
    return sorted(scene_paths())


def row(cells: Sequence[str]) -> str:
    """One line of a Markdown table."""
    return f"| {' | '.join(cells)} |".replace("|  |", "| |")


def comparisons() -> Iterator[str]:
    """Rows of the comparisons with published values."""
    yield row(COLUMNS)
    yield row(["---"] * len(COLUMNS))
    for each in YAML(typ="safe").load(COMPARISONS):
        yield row([str(each.get(column, "")) for column in COLUMNS])


def expected(expectation: Any) -> str:
    """Expected value or range of a quantity [SI] as text."""
    if expectation.between is not None:
        return "{:.6g} to {:.6g}".format(*expectation.between)
    if expectation.equals is not None:
        within = f" within {100.0 * expectation.tolerance:.3g} %" if expectation.tolerance else ""
        return f"{expectation.equals:.6g}{within}"
    bound = "below" if expectation.below is not None else "above"
    return f"{bound} {getattr(expectation, bound):.6g}"


def expectations() -> Iterator[str]:
    """One row for each expectation of a shipped scene, with the result of a run."""
    yield row(("scene", "quantity", "unit", "expected", "run", "recorded"))
    yield row(["---"] * 6)
    stored = stored_results()
    for name in names():
        run = stored.get(name, {})
        recorded = run["date"] if run else "not recorded"
        for quantity, unit, expected_value, value in expected_and_run(name, run.get("numbers", {})):
            yield row((f"`{name}`", f"`{quantity}`", unit, expected_value, value, recorded))


def expected_and_run(name: str, numbers: Mapping[str, float]) -> Iterator[tuple[str, str, str, str]]:
    """Quantity, unit, expected value and recorded result of each expectation of a shipped scene.

    `numbers`: recorded results by quantity.
    """
    for each in load_scene(SCENES / f"{name}.yaml").expect:
        number = numbers.get(each.quantity)
        value = "" if number is None else f"{number:.5g}"
        yield each.quantity, unit_of(each.quantity), expected(each), value


def stored_results() -> dict[str, Any]:
    """Recorded results by name of the scene: date, commit, numbers, processor, threads, wall clock [s]."""
    results: dict[str, Any] = json.loads(RESULTS.read_text(encoding="utf-8"))
    return results


BEGIN = "<!-- comparisons: written by tools/scene_table.py -->\n"
END = "<!-- end of comparisons -->\n"
HEADING = """# Expectations of the shipped scenes

Each scene checks its own `expect`; the tests run the scenes. The column `run` contains the result of the recorded
run, in SI units. `python tools/scene_table.py --record OUT` stores the numbers of a run.

"""


def written(page: str) -> dict[Path, str]:
    """Both files with tables from the stored numbers; `page`: the present text of PAGE.

    Raises ValueError if a marker is missing.
    """
    if BEGIN not in page or END not in page:
        raise ValueError(f"{PAGE.name} lacks the markers of the table: {BEGIN.strip()} and {END.strip()}")
    before, _, rest = page.partition(BEGIN)
    table = "\n".join(comparisons())
    return {
        PAGE: f"{before}{BEGIN}\n{table}\n\n{END}{rest.partition(END)[2]}",
        EXPECTATIONS: HEADING + "\n".join(expectations()) + "\n",
    }


def outdated() -> dict[Path, str]:
    """New text of each file that differs from the stored numbers."""
    files = written(PAGE.read_text(encoding="utf-8"))
    return {
        path: text
        for path, text in files.items()
        if not path.exists() or path.read_text(encoding="utf-8") != text
    }


def record(folder: Path) -> None:
    """Stores the numbers of a finished run of a shipped scene. Raises ValueError for other scenes and
    runs."""
    run = read_run(folder)
    if run.result is None:
        raise ValueError(f"{folder} has no result.json: give the directory of a finished run.")
    numbers = run.result.numbers
    name, scene = shipped(run.scene)
    stored = stored_results()
    quantities = [each.quantity for each in scene.expect]
    stored[name] = {
        "date": datetime.date.fromtimestamp((folder / "result.json").stat().st_mtime).isoformat(),
        "commit": git("rev-parse", "--short", "HEAD"),
        "numbers": {quantity: numbers[quantity] for quantity in quantities if quantity in numbers},
        "processor": machine()["processor"].replace("(R)", "").replace(" Processor", ""),
        "threads": sessions(run.record)[-1][1].threads,
        "wall_clock": round(numbers["wall_clock"], 1),
    }
    RESULTS.write_text(json.dumps(stored, indent=1, sort_keys=True) + "\n", encoding="utf-8")


def shipped(scene: Scene) -> tuple[str, Scene]:
    """Name and content of the shipped scene with this title and these expectations."""
    for name in names():
        other = load_scene(SCENES / f"{name}.yaml")
        if (other.title, other.expect) == (scene.title, scene.expect):
            return name, other
    raise ValueError(
        f"{scene.title} is not a shipped scene with its original expectations: run it without --set."
    )


def git(*arguments: str) -> str:
    """Output of git for this repository."""
    return subprocess.run(
        ["git", "-C", str(ROOT), *arguments], capture_output=True, text=True, check=True
    ).stdout.strip()


def main() -> int:
    """Writes or checks the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--check", action="store_true", help="only compare the tables")
    parser.add_argument(
        "--record", nargs="+", type=Path, default=[], metavar="OUT", help="folders of finished runs"
    )
    options = parser.parse_args()
    for folder in options.record:
        record(folder)
    changed = outdated()
    if options.check:
        names = " and ".join(map(str, changed))
        print(f"{names}: run python tools/scene_table.py." if changed else "The tables are up to date.")
        return int(bool(changed))
    for path, text in changed.items():
        path.write_text(text, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
