"""The report page of a run, from the files in its directory."""

from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

from granflow import Run, read_run
from granflow.io.atomic_files import write_text
from granflow.studies.page import page_text
from granflow.studies.report import sections
from granflow.studies.report.collisions import collision_topics
from granflow.studies.report.field_grids import field_content
from granflow.studies.report.pictures import RunPictures, pictures_for
from granflow.studies.report.plots import library
from granflow.studies.report.topics import NO_LIBRARY, expected_topic, topics
from granflow.studies.report.view import interactive_view


def write_report(
    directory: Path, out: Path | None = None, pictures: bool = True, report: Callable[[str], None] = print
) -> Path:
    """Write the report page of a run to its directory or to `out`; return its path.

    `pictures`: include pictures, and render some if there are none. `report` is called with a message about missing
    packages. Raises GranflowError if the directory is not that of a run, or if files cannot be read.
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


def report_text(record: Run, script: str, pictures: RunPictures | None) -> str:
    """The page: results first, then the computation. `script` is the plot library; empty for a page without plots."""
    plan, problem = sections.plan(record)
    fields = field_content(record.directory, bool(script))
    return page_text(
        "report.html",
        record=record,
        plotly=script,
        pictures=pictures,
        view_content=interactive_view(record) if pictures else None,
        state=sections.state_of(record),
        progress=sections.progress(record),
        warnings=sections.warnings(record),
        expected=expected_topic(record, bool(script)),
        topics=[*topics(record, bool(script)), *collision_topics(record.directory, bool(script))],
        field_tables=fields[0],
        field_plots=fields[1],
        timings=sections.timings(record),
        remaining=sections.remaining_numbers(record),
        plan=plan,
        plan_problem=problem,
        machine=sections.machine(record),
    )
