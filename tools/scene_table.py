"""The tables of docs/scenes.md, written between markers from stored numbers; nothing in them is edited by hand.

python tools/scene_table.py                     write the tables into docs/scenes.md
python tools/scene_table.py --check             exit code 1 where the tables are not what the stored numbers give
python tools/scene_table.py --record out/mixer  store the numbers of a finished run first, from its result.json

docs/scenes_comparisons.yaml holds the published values beside the measured ones of the comparisons, with the date and
commit of the measurement. docs/scenes_results.json holds what runs of the shipped scenes gave for the quantities of
their `expect`, with date and commit.
"""

import argparse
import datetime
import json
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML

from granflow.scene import Scene, load

ROOT = Path(__file__).resolve().parents[1]
PAGE, SCENES = ROOT / "docs" / "scenes.md", ROOT / "scenes"
COMPARISONS, RESULTS = ROOT / "docs" / "scenes_comparisons.yaml", ROOT / "docs" / "scenes_results.json"
COLUMNS = ("scene", "what should be seen", "granflow", "published or theory", "deviation", "run time", "measured")


def names() -> list[str]:
    """Every shipped scene: its path below scenes/ without the ending."""
    return sorted(path.relative_to(SCENES).with_suffix("").as_posix() for path in SCENES.rglob("*.yaml"))


def row(cells: Sequence[str]) -> str:
    """One line of a Markdown table."""
    return f"| {' | '.join(cells)} |".replace("|  |", "| |")


def comparisons() -> Iterator[str]:
    """The comparisons with published values."""
    yield row(COLUMNS)
    yield row(["---"] * len(COLUMNS))
    for each in YAML(typ="safe").load(COMPARISONS):
        yield row([str(each.get(column, "")) for column in COLUMNS])


def expected(expectation: Any) -> str:
    """What a scene expects of a quantity [SI]."""
    if expectation.between is not None:
        return "{:.6g} to {:.6g}".format(*expectation.between)
    if expectation.equals is not None:
        return f"{expectation.equals:.6g} within {expectation.tolerance:.2g}"
    bound = "below" if expectation.below is not None else "above"
    return f"{bound} {getattr(expectation, bound):.6g}"


def expectations() -> Iterator[str]:
    """One row for each quantity that a shipped scene expects, with what a run gave."""
    stored = json.loads(RESULTS.read_text(encoding="utf-8"))
    yield row(("scene", "quantity [SI]", "expected", "run", "recorded"))
    yield row(["---"] * 5)
    for name in names():
        run = stored.get(name, {})
        recorded = f"{run['date']}, {run['commit']}" if run else "not recorded"
        for each in load(SCENES / f"{name}.yaml").expect:
            number = run.get("numbers", {}).get(each.quantity)
            shown = "" if number is None else f"{number:.5g}"
            yield row((f"`{name}`", f"`{each.quantity}`", expected(each), shown, recorded))


TABLES = {"comparisons": comparisons, "expectations": expectations}


def written(text: str) -> str:
    """The page with its tables as the stored numbers give them. Raises ValueError where a marker is missing."""
    for name, table in TABLES.items():
        begin, end = f"<!-- {name}: written by tools/scene_table.py -->\n", f"<!-- end of {name} -->\n"
        if begin not in text or end not in text:
            raise ValueError(f"{PAGE.name} lacks the markers of the table {name}: {begin.strip()} and {end.strip()}")
        before, _, rest = text.partition(begin)
        text = before + begin + "\n" + "\n".join(table()) + "\n\n" + end + rest.partition(end)[2]
    return text


def record(folder: Path) -> None:
    """Store the numbers of a finished run of a shipped scene. Raises ValueError for a run of another scene."""
    result = json.loads((folder / "result.json").read_text(encoding="utf-8"))
    numbers = numbers_of(result)
    name, scene = shipped(load(folder / "scene_as_run.yaml"))
    stored = json.loads(RESULTS.read_text(encoding="utf-8"))
    wanted = [each.quantity for each in scene.expect]
    stored[name] = {
        "date": datetime.date.fromtimestamp((folder / "result.json").stat().st_mtime).isoformat(),
        "commit": git("rev-parse", "--short", "HEAD"),
        "numbers": {quantity: numbers[quantity] for quantity in wanted if quantity in numbers},
    }
    RESULTS.write_text(json.dumps(stored, indent=1, sort_keys=True) + "\n", encoding="utf-8")


def numbers_of(result: dict[str, Any]) -> dict[str, float]:
    """The numbers of a result.json by the names that `expect` uses."""
    found = {**result["run"], **result["totals"]}
    for section in ("flow_meters", "wall_forces", "metrics", "insertion"):
        for part, readings in result[section].items():
            found |= {f"{quantity}.{part}": number for quantity, number in readings.items()}
    return found


def shipped(scene: Scene) -> tuple[str, Scene]:
    """Name and text of the shipped scene that this one is, by its title and its expectations."""
    for name in names():
        other = load(SCENES / f"{name}.yaml")
        if (other.title, other.expect) == (scene.title, scene.expect):
            return name, other
    raise ValueError(f"{scene.title} is not a shipped scene with its own expectations: run it without --set.")


def git(*arguments: str) -> str:
    """What git says of the repository."""
    return subprocess.run(
        ["git", "-C", str(ROOT), *arguments], capture_output=True, text=True, check=True
    ).stdout.strip()


def main() -> int:
    """Write or check the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true", help="only compare")
    parser.add_argument("--record", nargs="+", type=Path, default=[], metavar="OUT", help="folders of finished runs")
    options = parser.parse_args()
    for folder in options.record:
        record(folder)
    before = PAGE.read_text(encoding="utf-8")
    after = written(before)
    if options.check:
        print("The tables are up to date." if before == after else "docs/scenes.md: run python tools/scene_table.py.")
        return int(before != after)
    PAGE.write_text(after, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
