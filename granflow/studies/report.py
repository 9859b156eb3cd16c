"""The report page of a run, from the files in its directory.

`write_report` writes one self-contained HTML page: results first, then the computation. A run in progress or
without a result has the parts that its log and its time series give; the page omits empty parts. The
functions below return the parts in the order of the page, as tables (`PageTable`), plots (`Plot`) and
sentences.
"""

import re
import subprocess
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np

from granflow import Run, explain, plan_for, read_run
from granflow.errors import GranflowError
from granflow.fields import (
    ENERGY_BUDGET_QUANTITIES,
    FIELD_QUANTITIES,
    FLOW_METER_QUANTITIES,
    METRIC_QUANTITIES,
    WALL_FORCE_QUANTITIES,
    WEAR_QUANTITIES,
    quantity_of,
)
from granflow.io.files import write_text
from granflow.io.frames import is_empty, listed_frames, read_mesh
from granflow.io.log import LOG, sessions, warnings_and_errors
from granflow.io.tables import (
    COLLISION_FILE,
    RESIDENCE_FILE,
    SeriesColumn,
    TimeSeriesTable,
    collision_table,
    read_table,
)
from granflow.scene.blocks.output import unit_of
from granflow.scene.blocks.sizes import SizeDistribution
from granflow.studies.figures import COLORS, PageTable
from granflow.studies.frames import VIEWS, Frame, filled_frames, frames_of
from granflow.studies.interactive_plots import (
    Plot,
    curve_layout,
    groups_of,
    library,
    plain_numbers,
    plot_of,
)
from granflow.studies.page import page_text
from granflow.studies.render import PictureStyle, picture_path
from granflow.studies.report_view import interactive_view
from granflow.visible_text import in_degrees, readable

NO_LIBRARY = "Plots require plotly, which is not installed: pip install plotly, then granflow report again."


def write_report(
    directory: Path, out: Path | None = None, pictures: bool = True, report: Callable[[str], None] = print
) -> Path:
    """Write the report page of a run to its directory or to `out`; return its path.

    `pictures`: include pictures, and render some if there are none. `report` is called with a message about
    missing packages. Raises GranflowError if the directory is not that of a run, or if files cannot be read.
    """
    record = read_run(directory)
    script = library()
    if not script:
        report(NO_LIBRARY)
    path = out or directory / "report.html"
    path.parent.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory() as scratch:
        text = report_text(record, script, pictures_for(directory, Path(scratch)) if pictures else None)
    write_text(path, text)
    return path


def report_text(record: Run, script: str, pictures: "RunPictures | None") -> str:
    """The text of the page; `script`: the plot library, empty for a page without plots."""
    plan, problem = plan_and_problem(record)
    fields = field_content(record.directory, bool(script))
    return page_text(
        "report.html",
        record=record,
        plotly=script,
        pictures=pictures,
        view_content=interactive_view(record) if pictures else None,
        state=state_of(record),
        progress=progress(record),
        warnings=warnings(record),
        expected=expected_topic(record, bool(script)),
        topics=[
            *topics(record, bool(script)),
            *size_topics(record, bool(script)),
            *residence_topics(record, bool(script)),
            *collision_topics(record.directory, bool(script)),
        ],
        field_tables=fields[0],
        field_plots=fields[1],
        timings=timings(record),
        remaining=remaining_numbers(record),
        plan=plan,
        plan_problem=problem,
        machine=machine(record),
    )


# State and progress


def state_of(record: Run) -> str:
    """One sentence on how the run ended."""
    if record.is_running:
        return "The run is in progress; this page shows its present state."
    if record.result_sections:
        parts = len(sessions(record.record))
        resumed = f"; it was resumed ({parts} sessions)" if parts > 1 else ""
        if not record.result_sections.get("complete", True):
            return (
                f"The run ended before its last stage{resumed}: granflow resume {record.directory} continues "
                "it."
            )
        return f"The run is complete{resumed}."
    name = next((entry.ended_by for entry in reversed(record.record) if entry.ended_by), "")
    why = f" (ended by {name}: see the warnings)" if name else ""
    resume = f"granflow resume {record.directory} continues from its last checkpoint, if it has one."
    return f"The run did not finish{why}. {resume}"


def progress(record: Run) -> PageTable:
    """Simulated time, performance and particle counts."""
    numbers = dict(record.result_sections.get("run", {}))
    if record.time is not None:
        numbers = {"simulated_time": record.time} | numbers
    totals = record.result_sections.get("totals", {})
    numbers |= {name: totals.get(name) for name in ("particle_count", "inserted_count")}
    rows = [row for row in map(_number_row, numbers.items()) if row[1]]
    return PageTable(("", "", ""), rows, "Progress and performance.")


def _number_row(item: tuple[str, Any]) -> tuple[str, str, str]:
    """Name, number and unit."""
    name, number = item
    unit = unit_of(name)
    return (
        name.replace("_", " "),
        shown(number),
        unit + (in_degrees(number, unit) if number is not None else ""),
    )


def shown(number: Any, unit: str = "") -> str:
    """A number as text, of an angle [rad] with degrees; another value as it is; empty for None."""
    if isinstance(number, int | float):
        return readable(number) + in_degrees(number, unit)
    return "" if number is None else str(number)


FROM_LOG = f"As in {LOG}."


def warnings(record: Run) -> PageTable:
    """Warnings and errors of the run."""
    return PageTable(("time", "level", "message"), list(warnings_and_errors(record.record)), FROM_LOG)


# Pictures: a few of the course of the run, rendered if necessary, and others from `granflow render`.
# Pictures older than the last frame show another run and are not used.

MOST_PICTURES = 6
"""Maximum number of pictures in the page besides those of the course of the run."""
SHOWN_FRAMES = 4
"""Number of pictures of the course of the run: evenly spaced frames, including the last one."""
PICTURE_HEIGHT = 800
"""Height of a picture in the page [pixels]: twice its displayed size."""
QUALITY = 85
"""JPEG quality of embedded pictures, 0 to 100."""
FILM_BYTES = 3_000_000
"""Maximum size of an embedded film in bytes; larger films are referenced by name."""
TIMEOUT = 600.0
"""Time limit of rendering [s]."""
NAME = re.compile(rf"(?:picture|film)_(.+?)_({'|'.join(VIEWS)}|from_[-+.e\d_]+?)(_cut)?(?:_(\d+))?")
"""File names of granflow render: color, view, cut, frame number."""
HOW_TO_ADD = "The files are in pictures/. To add pictures, run granflow render, then granflow report again."


class Picture(NamedTuple):
    """Image or film file, and its caption."""

    path: Path
    caption: str


class CoursePicture(NamedTuple):
    """Picture of the course of a run: frame, style, and file in `pictures/`."""

    frame: Frame
    style: PictureStyle
    path: Path = Path()


class RunPictures(NamedTuple):
    """Pictures and films of the page, and a sentence about them."""

    shown: Sequence[Picture]
    statement: str


def pictures_for(directory: Path, scratch: Path) -> RunPictures:
    """Pictures and films for the page, scaled down in `scratch`, and a sentence about them.

    First those of the course of the run, rendered if they are not newer than its last frame; then at most
    MOST_PICTURES others and one film of at most FILM_BYTES. Raises GranflowError if the list of frames is
    damaged.
    """
    if not listed_frames(directory, "particles"):
        return RunPictures((), "The run has no frames to render.")
    frames = frames_of(directory)
    course = course_pictures(directory, frames)
    problem = render_missing(directory, course, recent_pictures(directory, frames))
    found = recent_pictures(directory, frames)
    images = [each.path for each in course if each.path in found]
    images += [path for path in found if path.suffix == ".png" and path not in images][-MOST_PICTURES:]
    films = [path for path in found if path.suffix == ".mp4"]
    small = [path for path in films if path.stat().st_size <= FILM_BYTES][-1:]
    large = [f"pictures/{path.name}" for path in films if path not in small]
    shown = [Picture(path, _caption(path, frames)) for path in small]
    shown += [Picture(reduced(path, scratch), _caption(path, frames)) for path in images]
    omitted_films = f" Animations not embedded: {', '.join(large)}." if large else ""
    return RunPictures(shown, (problem or HOW_TO_ADD) + omitted_films)


def recent_pictures(directory: Path, frames: Sequence[Frame]) -> list[Path]:
    """PNG and MP4 files in `pictures/` that are newer than the last frame, sorted by name."""
    last = frames[-1].particles.stat().st_mtime
    found = [*(directory / "pictures").glob("*.png"), *(directory / "pictures").glob("*.mp4")]
    return sorted(path for path in found if path.stat().st_mtime >= last)


def course_pictures(directory: Path, frames: Sequence[Frame]) -> list[CoursePicture]:
    """Pictures of the course of a run: evenly spaced frames with particles, and the one with the most
    contacts."""
    filled = filled_frames(frames)
    indices = np.unique(np.linspace(0, len(filled) - 1, SHOWN_FRAMES + 1).astype(int)[1:])
    chosen = [filled[index] for index in indices]
    found = [CoursePicture(frame, PictureStyle()) for frame in chosen]
    with_contacts = [frame for frame in chosen if frame.contacts is not None and not is_empty(frame.contacts)]
    if with_contacts:
        most = max(with_contacts, key=lambda frame: frame.contacts.stat().st_size if frame.contacts else 0)
        found.append(CoursePicture(most, PictureStyle(chains=True)))
    return [each._replace(path=picture_path(directory, each.style, each.frame)) for each in found]


def render_missing(directory: Path, course: Sequence[CoursePicture], present: Sequence[Path]) -> str:
    """Render the pictures that are not `present` in a subprocess, because VTK aborts if it cannot render.

    Returns an error message or "". The time limit is TIMEOUT for each command.
    """
    missing = [each for each in course if each.path not in present]
    if missing and find_spec("pyvista") is None:
        return (
            "No pictures of the course of the run, because pyvista is not installed: pip install pyvista "
            "matplotlib"
        )
    for chains in (False, True):
        numbers = ",".join(str(each.frame.number) for each in missing if each.style.chains == chains)
        if not numbers:
            continue
        command = [sys.executable, "-m", "granflow", "render", str(directory), "--frame", numbers]
        command += ["--chains"] if chains else []
        try:
            completed = subprocess.run(command, capture_output=True, text=True, timeout=TIMEOUT)
        except subprocess.TimeoutExpired:
            return f"No pictures: rendering took longer than {TIMEOUT:.0f} s."
        if completed.returncode:
            statement = (completed.stderr.strip().splitlines() or ["no message"])[-1]
            return f"Rendering failed (granflow render, exit code {completed.returncode}): {statement}"
    return ""


def reduced(path: Path, scratch: Path) -> Path:
    """The picture as JPEG of PICTURE_HEIGHT pixels; unchanged if Pillow is not installed."""
    try:
        from PIL import Image
    except ImportError:
        return path
    with Image.open(path) as image:
        size = (max(1, round(image.width * PICTURE_HEIGHT / image.height)), PICTURE_HEIGHT)
        jpeg = scratch / f"{path.stem}.jpg"
        image.convert("RGB").resize(size, Image.Resampling.LANCZOS).save(jpeg, quality=QUALITY, optimize=True)
    return jpeg


def _caption(path: Path, frames: Sequence[Frame]) -> str:
    """Caption of a file of `granflow render`, from its name."""
    match = NAME.fullmatch(path.stem)
    if match is None:
        return path.stem.replace("_", " ")
    color, view, cut, number = match.groups()
    times = [f"{frame.time:.4g} s" for frame in frames if number and frame.number == int(number)]
    return (
        ", ".join([color.replace("_", " "), view.replace("_", " "), *(["cut"] if cut else []), *times]) + "."
    )


# Quantities over time: those that the scene expects, then metrics, flow, walls, energies and others


class Topic(NamedTuple):
    """Section of quantities over time; `folded` is shown after a click."""

    title: str
    tables: Sequence[PageTable]
    sentences: Sequence[str]
    plots: Sequence[Plot]
    folded: Sequence[PageTable] = ()


class Readings(NamedTuple):
    """Topic of metrics, flow meters or walls: its quantities, its key in result.json, and the caption of its
    table."""

    quantities: Iterable[str]
    key: str
    caption: str


METRIC_CAPTION = "Metrics of the bed at the end of the run."
FLOW_CAPTION = "Flow meters at the end of the run; the mass flow rate is the steady one."
FORCE_CAPTION = (
    "Forces of the particles on the walls: means over the last stage, and the largest value of a row in the "
    "run."
)
EXPECTED = "Expectations"
FORCES = "Wall forces"
ENERGIES = "Energy budget"
HEAT = "Heat"
WEAR = "Wear of walls"
OTHERS = "Over time"
"""Titles of topics."""
TABLE_CAPTIONS = {
    ENERGIES: "Energies in J, without heat.",
    HEAT: "Temperatures in K, heat in J. Heat is no part of the mechanical energy budget.",
    WEAR: "Worn volumes in m3, depths in m, work of the contacts in J: sums since the start.",
}
"""Captions of the topics whose table has the first, last and largest value of each column."""
READINGS = {
    "Metrics": Readings(METRIC_QUANTITIES, "metrics", METRIC_CAPTION),
    "Flow": Readings(FLOW_METER_QUANTITIES, "flow_meters", FLOW_CAPTION),
    FORCES: Readings(WALL_FORCE_QUANTITIES, "wall_forces", FORCE_CAPTION),
}
"""Topics with one part, such as a metric, a flow meter or a wall, per row, by title."""


def expected_topic(record: Run, with_plots: bool) -> Topic:
    """Expectations of the scene, their results, and plots of the expected quantities.

    Counts and ratios of the whole run, such as `particle_count` and `energy_error`, have no plot here.
    """
    rows = [
        ("\N{CHECK MARK} satisfied" if entry["met"] else "\N{BALLOT X} not satisfied", entry["sentence"])
        for entry in record.result_sections.get("expect", ())
    ]
    table = PageTable(("", "result"), rows, "Expectations of the scene (expect).")
    columns = [each for each in _expected_columns(record) if not is_zero(each)]
    plots = (
        [plot_of(group, record.series) for group in groups_of(columns)]
        if record.series and with_plots
        else []
    )
    return Topic(EXPECTED, [table] if rows else [], [], plots)


def _expected_columns(record: Run) -> list[SeriesColumn]:
    """Columns of expected quantities with a unit or a part, in the order of the scene."""
    if record.series is None or record.scene_problem:
        return []
    columns = {column.name: column for column in record.series.columns}
    names = dict.fromkeys(expectation.quantity for expectation in record.scene.expect)
    return [columns[name] for name in names if name in columns and (columns[name].unit or "." in name)]


def is_zero(column: SeriesColumn) -> bool:
    """Whether a column is zero or nan in every row."""
    return not np.nan_to_num(column.values).any()


def topics(record: Run, with_plots: bool) -> Iterator[Topic]:
    """Sections of metrics, flow, wall forces, energy budget, heat, wear, and all other quantities over time.

    Columns of zeros are listed instead of plotted, a plot of expected quantities only is not repeated, and
    small components of forces and torques are folded. Without an energy budget, energies are among the other
    quantities. `with_plots`: whether the plot library is available.
    """
    series = record.series
    if series is None:
        yield Topic(OTHERS, (), ["The run has written no rows of timeseries.csv yet."], ())
        return
    shown_before = {column.name for column in _expected_columns(record)}
    has_budget = any(column.name in ENERGY_BUDGET_QUANTITIES for column in series.columns)
    for title in (*READINGS, ENERGIES, HEAT, WEAR, OTHERS):
        columns = [each for each in _columns_of(title, series, has_budget) if not is_zero(each)]
        small = negligible_columns(_columns_of(FORCES, series), SMALL) if title == FORCES else []
        tables, folded = _folded(_tables(record, title, has_budget), small)
        groups = groups_of([each for each in columns if each not in small])
        groups = [group for group in groups if not {each.name for each in group.columns} <= shown_before]
        plots = [plot_of(group, series) for group in groups] if with_plots else []
        sentences = _sentences(record, title, bool(tables)) + (
            [NO_LIBRARY] if columns and not with_plots else []
        )
        if tables or sentences or plots:
            yield Topic(title, tables, sentences, plots, folded)


def topic_of(column: SeriesColumn, has_budget: bool = True) -> str:
    """Title of the topic of a column; energies have their own only in a run with an energy budget."""
    quantity, _, part = column.name.partition(".")
    topics = (title for title, readings in READINGS.items() if part and quantity in readings.quantities)
    if quantity in WEAR_QUANTITIES:
        return WEAR
    if "heat" in quantity.split("_") or quantity.startswith("temperature"):
        return HEAT
    is_energy = has_budget and (column.unit == "J" or quantity.startswith("energy"))
    return next(topics, ENERGIES if is_energy else OTHERS)


def _columns_of(title: str, series: TimeSeriesTable, has_budget: bool = True) -> list[SeriesColumn]:
    """Columns of a topic."""
    return [column for column in series.columns if topic_of(column, has_budget) == title]


def _tables(record: Run, title: str, has_budget: bool) -> list[PageTable]:
    """Tables of a topic."""
    if title in READINGS:
        return _readings(record, title)
    if title not in TABLE_CAPTIONS or record.series is None:
        return []
    return _first_and_last(_columns_of(title, record.series, has_budget), TABLE_CAPTIONS[title])


def _sentences(record: Run, title: str, has_table: bool) -> list[str]:
    """Sentences of a topic: the energy error, or the columns that are always zero."""
    error = record.result_sections.get("totals", {}).get("energy_error")
    if title == ENERGIES and has_table and error is not None:
        return [f"Energy error: {error:.3g} of the largest energy input."]
    zero_columns = (
        [column.text for column in record.series.columns if is_zero(column)] if record.series else []
    )
    return [f"Always zero: {', '.join(zero_columns)}."] if title == OTHERS and zero_columns else []


SMALL = 0.01
"""Share of the largest force or torque of the run below which a component is folded."""


def _folded(
    tables: Sequence[PageTable], small: Sequence[SeriesColumn]
) -> tuple[list[PageTable], list[PageTable]]:
    """The tables without rows of small columns, and a table of the largest values of those that are not zero.

    A row is removed if it is a quantity whose column is small for every wall.
    """
    names = {column.name for column in small}
    kept = []
    for table in tables:
        kept.append(
            table._replace(rows=[row for row in table.rows if not _is_small(row[0], table.heads[1:], names)])
        )
    caption = (
        f"Components below {SMALL:.0%} of the largest force or torque of a row: largest absolute values."
    )
    rows = [
        (column.text, f"{largest_of(column):.3g}", column.unit) for column in small if not is_zero(column)
    ]
    return kept, [PageTable(("", "", ""), rows, caption)] if rows else []


def _is_small(head: str, parts: Sequence[str], small: set[str]) -> bool:
    """Whether the row of a quantity contains small columns only; `head`: its name with its unit."""
    quantity = head.partition(" (")[0].replace(" ", "_")
    return all(f"{quantity}.{part}" in small for part in parts)


def negligible_columns(columns: Sequence[SeriesColumn], share: float) -> list[SeriesColumn]:
    """Columns whose largest absolute value is below `share` of that of all columns of the same unit."""
    largest: dict[str, float] = {}
    for column in columns:
        largest[column.unit] = max(largest.get(column.unit, 0.0), largest_of(column))
    return [column for column in columns if largest_of(column) < share * largest[column.unit]]


def largest_of(column: SeriesColumn) -> float:
    """Largest absolute value of a column; values that are not finite are ignored."""
    return float(np.max(np.abs(column.values[np.isfinite(column.values)]), initial=0.0))


def _readings(record: Run, title: str) -> list[PageTable]:
    """Final values of metrics, flow meters or walls.

    They are those of the last row of the time series if there is no result.
    """
    readings = record.result_sections.get(READINGS[title].key, {})
    caption = READINGS[title].caption
    if not readings and record.series is not None:
        caption = "The last row of timeseries.csv."
        for column in record.series.columns:
            quantity, _, part = column.name.partition(".")
            if topic_of(column) == title:
                readings.setdefault(part, {})[quantity] = float(column.values[-1])
    return [table_of(caption, readings)] if readings else []


MOST_COLUMNS = 8
"""Largest number of quantities of flow meters or walls that are columns of a table."""


def table_of(caption: str, parts: Mapping[str, Mapping[str, Any]]) -> PageTable:
    """Table with a row for each part, such as a flow meter or a wall, and a column for each quantity.

    With more than MOST_COLUMNS quantities and fewer parts, the rows are the quantities and the columns the
    parts.
    """
    names = list(dict.fromkeys(name for numbers in parts.values() for name in numbers))
    units = [unit_of(name + ".x") for name in names]
    heads = [
        name.replace("_", " ") + (f" ({unit})" if unit else "")
        for name, unit in zip(names, units, strict=True)
    ]
    columns = list(zip(names, units, strict=True))
    rows = [
        [part, *(shown(numbers.get(name), unit) for name, unit in columns)] for part, numbers in parts.items()
    ]
    if len(parts) < MOST_COLUMNS < len(names):
        return PageTable(["", *parts], list(zip(heads, *(row[1:] for row in rows), strict=True)), caption)
    return PageTable(["", *heads], rows, caption)


NEGLIGIBLE = 1e-15
"""Share of its largest value in the run below which a quantity is rounding, and shown as 0."""


def _first_and_last(columns: Iterable[SeriesColumn], caption: str) -> list[PageTable]:
    """Each quantity at the start and at the end, and its largest absolute value.

    Values below NEGLIGIBLE of the largest one are shown as 0.
    """
    rows = []
    for column in columns:
        if column.unit not in ("", "1") and not is_zero(column):
            known = quantity_of(column.name)
            values = column.values[np.isfinite(column.values)]
            numbers = (values[0], values[-1], max(values.max(), values.min(), key=abs))
            kept = (number if abs(number) > NEGLIGIBLE * abs(numbers[-1]) else 0.0 for number in numbers)
            rows.append(
                [column.text, *(f"{number + 0.0:.4g}" for number in kept), known.meaning if known else ""]
            )
    return [PageTable(("", "first", "last", "largest", "meaning"), rows, caption)] if rows else []


# Sizes of the particles

SIZE_TITLE = "Particle sizes"


def size_topics(record: Run, with_plots: bool) -> Iterator[Topic]:
    """The section on the sizes of groups with several diameters, at the frame with the largest file.

    Shares are by mass. None without such a group, and if the scene cannot be read.
    """
    paths = record.frames.paths
    if not paths or record.scene_problem:
        return
    frame = record.frames[max(range(len(paths)), key=lambda k: paths[k].stat().st_size)]
    rows: list[tuple[str, ...]] = []
    curves: list[dict[str, Any]] = []
    for number, (name, group) in enumerate(record.scene.particles.items()):
        found = frame.particles["diameter"][frame.particles["group"] == number].astype(np.float64)
        if not len(found) or found.min() == found.max():
            continue
        diameter, share = mass_curve(found)
        reached = (1e3 * diameter[np.searchsorted(share, part)] for part in (0.1, 0.5, 0.9))
        line = {"color": COLORS[len(rows) % len(COLORS)], "width": 1.8}
        rows.append((name, readable(float(len(diameter))), *(f"{each:.4g}" for each in reached)))
        curves.append(size_curve(name, diameter, share, line))
        if isinstance(given := group.diameter, SizeDistribution):
            drawn = given.draw(SAMPLE, np.random.default_rng(0))
            curves.append(size_curve(f"{name}, as given", *mass_curve(drawn), line | {"dash": "dot"}))
    if not rows:
        return
    heads = ("group", "particles", "d10 (mm)", "d50 (mm)", "d90 (mm)")
    caption = (
        f"Particles at {frame.time:.4g} s, when they are most: 10, 50 and 90 % of the mass of a group are "
        "finer than d10, d50 and d90. A dotted curve is the distribution in the scene."
    )
    figure = {
        "data": curves,
        "layout": curve_layout("diameter (mm)", "share of the mass that is finer", True),
    }
    plots = [Plot(SIZE_TITLE, figure)] if with_plots else []
    yield Topic(SIZE_TITLE, [PageTable(heads, rows, caption)], [], plots)


MOST_SIZES = 400
"""Largest number of points of a curve of sizes."""
SAMPLE = 100_000
"""Number of diameters that represent a given distribution."""


def mass_curve(diameter: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Ascending diameters (n,) and the share of the mass in particles up to each of them (n,)."""
    ascending = np.sort(diameter)
    mass = np.cumsum(ascending**3)
    return ascending, mass / mass[-1]


def size_curve(name: str, diameter: np.ndarray, share: np.ndarray, line: dict[str, Any]) -> dict[str, Any]:
    """A curve of the plot, with at most MOST_SIZES of the ascending diameters (n,) [m]."""
    kept = np.unique(np.linspace(0, len(diameter) - 1, MOST_SIZES).astype(int))
    return {
        "type": "scatter",
        "mode": "lines",
        "name": name,
        "x": plain_numbers(1e3 * diameter[kept]),
        "y": plain_numbers(share[kept]),
        "line": line,
    }


# Residence times (`output.residence_time`)

RESIDENCE_TITLE = "Residence times"
MOST_RESIDENCE_CLASSES = 50
"""Largest number of classes of the distribution E(t); fewer for few particles."""


def residence_topics(record: Run, with_plots: bool) -> Iterator[Topic]:
    """The section on the residence times of a run; none without `output.residence_time`.

    E(t): density of the distribution by mass, in classes. F(t): fraction of the mass with a residence time
    up to t. Raises GranflowError if the file cannot be read.
    """
    path = record.directory / RESIDENCE_FILE
    table = read_table(path) if path.exists() else None
    if table is None:
        return
    rows = table.complete()
    columns = {name: rows.numbers(k) for k, name in enumerate(rows.names) if name in _RESIDENCE_COLUMNS}
    if len(columns) < len(_RESIDENCE_COLUMNS):
        raise GranflowError(f"{path} has no columns {' and '.join(_RESIDENCE_COLUMNS)}.")
    times, masses = (columns[name] for name in _RESIDENCE_COLUMNS)
    order = np.argsort(times, kind="stable")
    times, masses = times[order], masses[order]
    caption = (
        "Times from the entrance to the exit, weighted with the mass of the particles that left. The longest "
        "times are missing as long as particles are inside."
    )
    if not len(times):
        yield Topic(RESIDENCE_TITLE, [], ["No particle has left."], [])
        return
    share = np.cumsum(masses) / np.sum(masses)
    named = []
    for numbers in () if record.result is None else record.result.residence_time.values():
        named += [
            ("particles that left", readable(numbers["residence_count"])),
            ("particles inside at the end", readable(numbers["residing_count"])),
            ("mean (s)", readable(numbers["residence_mean"])),
            ("standard deviation (s)", readable(numbers["residence_deviation"])),
            ("variance (s2)", readable(numbers["residence_deviation"] ** 2)),
            ("tanks in series", readable(numbers["tanks_in_series"])),
        ]
    for percent in (10, 50, 90):
        reached = float(times[np.searchsorted(share, percent / 100)])
        named.append((f"{percent} % of the mass within (s)", readable(reached)))
    plots = []
    if with_plots and np.ptp(times) > 0.0:
        classes = int(np.clip(np.sqrt(len(times)), 5, MOST_RESIDENCE_CLASSES))
        density, edges = np.histogram(times, classes, weights=masses, density=True)
        centers = 0.5 * (edges[1:] + edges[:-1])
        plots = [
            Plot("E(t)", _residence_figure(centers, density, "E (1/s)", "bar")),
            Plot("F(t)", _residence_figure(times, share, "F", "scatter")),
        ]
    yield Topic(RESIDENCE_TITLE, [PageTable(("", ""), named, caption)], [], plots)


_RESIDENCE_COLUMNS = ("residence_time [s]", "mass [kg]")


def _residence_figure(times: np.ndarray, values: np.ndarray, label: str, kind: str) -> dict[str, Any]:
    """Figure of a distribution over the residence time [s], in the format of plotly."""
    curve: dict[str, Any] = {
        "type": kind,
        "x": plain_numbers(times),
        "y": plain_numbers(values),
        "name": label,
    }
    if kind == "bar":
        curve["marker"] = {"color": COLORS[0]}
    else:
        curve |= {"mode": "lines", "line": {"color": COLORS[0], "width": 1.8, "shape": "hv"}}
    return {"data": [curve], "layout": curve_layout("residence time (s)", label, False) | {"bargap": 0.0}}


# Collisions by impact energy (`output.collision_energies`)

TITLE = "Collisions by impact energy"


def collision_topics(directory: Path, with_plots: bool) -> Iterator[Topic]:
    """The section on the collisions of a run since its start; none without `output.collision_energies`.

    Raises GranflowError if the file cannot be read.
    """
    path = directory / COLLISION_FILE
    table = read_table(path) if path.exists() else None
    collisions = None if table is None else collision_table(table)
    if collisions is None:
        return
    total = {kind: counts[-1] for kind, counts in collisions.totals.items()}
    rows = [
        (f"{low:.3g} to {high:.3g} J", *(readable(float(counts[row])) for counts in total.values()))
        for row, (low, high) in enumerate(collisions.edges)
        if any(counts[row] for counts in total.values())
    ]
    caption = (
        "Contacts that began since the start of the run, by impact energy; classes without collisions are "
        "absent."
    )
    heads = ("impact energy", *(f"with a {kind}" for kind in total))
    plots = [Plot(TITLE, _figure(collisions.energy, total))] if with_plots else []
    yield Topic(TITLE, (), [], plots, (PageTable(heads, rows, caption),))


def _figure(energy: np.ndarray, total: dict[str, np.ndarray]) -> dict[str, Any]:
    """Numbers of collisions over the centers of their classes, both logarithmic, in the format of plotly."""
    known = np.isfinite(energy)
    curves = [
        {
            "type": "scatter",
            "mode": "lines+markers",
            "name": f"with a {kind}",
            "x": plain_numbers(energy[known]),
            "y": [count or None for count in plain_numbers(counts[known])],
            "line": {"color": color, "width": 1.8},
        }
        for color, (kind, counts) in zip(COLORS, total.items(), strict=False)
    ]
    layout = curve_layout("impact energy (J)", "collisions per class", True)
    for axis in ("xaxis", "yaxis"):
        layout[axis] = layout[axis] | {"type": "log", "exponentformat": "power"}
    return {"data": curves, "layout": layout}


# Fields on grids (`output.fields`): profiles of a grid of one row of cells, tables of other grids

PROFILES = 4
"""Maximum number of frames in the plot of a profile: evenly spaced, including the last one."""
AXES = ("x", "y", "z")


class GridFrame(NamedTuple):
    """One frame of fields: time [s], centers of the cells (k, 3) [m], and arrays (k,) by name."""

    time: float
    centers: np.ndarray
    values: Mapping[str, np.ndarray]


def field_content(directory: Path, with_plots: bool) -> tuple[list[PageTable], list[Plot]]:
    """Tables and plots of all fields of a run.

    A grid with several cells along one axis only has plots of its last frames, unless `with_plots` is False;
    another has a table of its last frame. Raises GranflowError if a file cannot be read.
    """
    tables = []
    plots = []
    for listing in sorted(directory.glob("fields_*.pvd")):
        series = listed_frames(directory, listing.stem)
        chosen = np.unique(np.linspace(0, len(series) - 1, PROFILES + 1).astype(int)[1:]) if series else ()
        frames = [_frame(*series[k]) for k in chosen]
        name = listing.stem.removeprefix("fields_")
        axes = [axis for axis in range(3) if frames and np.ptp(frames[-1].centers[:, axis]) > 0.0]
        if len(axes) == 1 and with_plots:
            plots += [_profile(name, quantity, axes[0], frames) for quantity in frames[-1].values]
        elif frames:
            tables.append(_range_table(name, frames[-1]))
    return tables, plots


def _frame(time: float, path: Path) -> GridFrame:
    """Frame of a file; vectors and tensors by their magnitude."""
    mesh = read_mesh(path)
    centers = np.concatenate(
        [np.zeros((0, 3)), *(mesh.points[block.data].mean(axis=1) for block in mesh.cells)]
    )
    arrays = {name: np.concatenate(parts) for name, parts in mesh.cell_data.items()}
    scalars = {
        name: np.linalg.norm(each, axis=1) if each.ndim == 2 else each for name, each in arrays.items()
    }
    return GridFrame(time, centers, scalars)


def _title(quantity: str) -> tuple[str, str]:
    """Name of a field for display, and its unit in parentheses."""
    known = FIELD_QUANTITIES.get(quantity)
    unit = f" ({known.unit})" if known and known.unit != "1" else ""
    return quantity.replace("_", " ") + (", magnitude" if known and known.kind != "scalar" else ""), unit


def _profile(name: str, quantity: str, axis: int, frames: Sequence[GridFrame]) -> Plot:
    """Plot of one field along one axis, a curve for each frame."""
    title, unit = _title(quantity)
    curves: list[dict[str, Any]] = []
    for frame in frames:
        order = np.argsort(frame.centers[:, axis])
        values = frame.values[quantity][order]
        is_number = np.isfinite(values)
        curves.append(
            {
                "type": "scatter",
                "mode": "lines",
                "name": f"{frame.time:.4g} s",
                "y": plain_numbers(values[is_number]),
                "x": plain_numbers(frame.centers[order, axis][is_number]),
                "line": {"color": COLORS[len(curves) % len(COLORS)]},
            }
        )
    layout = curve_layout(f"{AXES[axis]} (m)", title + unit, len(curves) > 1)
    return Plot(f"Field {name}: {title}{unit} over {AXES[axis]}", {"data": curves, "layout": layout})


def _range_table(name: str, frame: GridFrame) -> PageTable:
    """Smallest, mean and largest value of each field over the cells; cells without a number are left out."""
    rows = []
    for quantity, values in frame.values.items():
        finite = values[np.isfinite(values)]
        numbers = (finite.min(), finite.mean(), finite.max()) if len(finite) else ()
        rows.append(["".join(_title(quantity)), *(readable(float(number)) for number in numbers)])
    caption = (
        f"Field {name} at {frame.time:.4g} s over {len(frame.centers)} cells; fields_{name}.pvd has all "
        "frames."
    )
    return PageTable(("", "smallest", "mean", "largest"), [row for row in rows if row[1:]], caption)


# The computation: timings, other numbers, plan, machine

BAR_STEPS = 20
"""Length of the bar of the total wall-clock time, in blocks."""


def timings(record: Run) -> PageTable | None:
    """Wall-clock time by phase [s], in descending order; None if the run has no timings."""
    seconds = {
        name: number
        for name, number in record.result_sections.get("timings", {}).items()
        if number is not None
    }
    total = max(record.result_sections.get("run", {}).get("wall_clock") or 0.0, sum(seconds.values()))
    if not seconds or not total > 0.0:
        return None
    seconds["other"] = total - sum(seconds.values())
    rows = []
    for name, number in sorted(seconds.items(), key=lambda each: -each[1]):
        bar = "\N{FULL BLOCK}" * round(BAR_STEPS * number / total)
        rows.append((name.replace("_", " "), f"{number:.2f}", f"{number / total:.0%}", bar))
    return PageTable(("", "s", "share", ""), rows, f"Total wall-clock time: {total:.4g} s.")


SEPARATE = ("run", "timings", "expect", "residence_time", *(each.key for each in READINGS.values()))
"""Sections of result.json that the page shows separately."""


def remaining_numbers(record: Run) -> list[PageTable]:
    """Numbers of the result without a separate section."""
    found = []
    for name, numbers in record.result_sections.items():
        if name in SEPARATE or not isinstance(numbers, Mapping) or not numbers:
            continue
        caption = f"{name} in result.json"
        if name == "totals":
            numbers = {key: _unless_negligible(record, key, number) for key, number in numbers.items()}
        if all(isinstance(each, Mapping) for each in numbers.values()):
            found.append(table_of(caption, numbers))
        else:
            found.append(PageTable(("", "", ""), list(map(_number_row, numbers.items())), caption))
    return found


def _unless_negligible(record: Run, name: str, number: Any) -> Any:
    """The last value of a quantity, 0 if it is a NEGLIGIBLE share of its largest value in the time series."""
    columns = record.series.columns if record.series is not None else ()
    largest = max(
        (np.nanmax(np.abs(each.values), initial=0.0) for each in columns if each.name == name), default=0.0
    )
    return 0.0 if isinstance(number, float) and abs(number) < NEGLIGIBLE * largest else number


def plan_and_problem(record: Run) -> tuple[str, str]:
    """Decisions of the plan with their reasons, and the problem if there is no plan.

    They are those of the last session, or recomputed from the resolved scene.
    """
    text = next((facts.explanation for _, facts in reversed(sessions(record.record))), "")
    if not text and not record.scene_problem:
        try:
            text = explain(plan_for(record.scene))
        except GranflowError as error:
            return "", str(error)
    return text, ""


def machine(record: Run) -> PageTable:
    """Versions, backend and machine of each session."""
    rows = [
        (
            started,
            each.arch,
            each.precision,
            "" if each.threads is None else str(each.threads),
            f"{each.compile_seconds:.3g} s",
            each.versions,
            each.resumed_from and f"resumed from {each.resumed_from} at {each.resumed_at:.6g} s",
        )
        for started, each in sessions(record.record)
    ]
    header = ("start", "backend", "precision", "threads", "compilation", "versions and system", "")
    return PageTable(header, rows, FROM_LOG)
