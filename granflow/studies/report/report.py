"""The report page of a run, from the files in its directory."""

from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

from granflow.errors import GranflowError
from granflow.io.atomic_files import replacing
from granflow.studies.page import Gallery, Page, PagePart, Section, write_page
from granflow.studies.render.frames import Frame, frames_of
from granflow.studies.report import sections
from granflow.studies.report.pictures import pictures_for
from granflow.studies.report.plots import library
from granflow.studies.report.record import RunRecord, read_record

PAGE = "report.html"
LEAD = "Report of a granflow simulation."


def write_report(
    directory: Path, out: Path | None = None, pictures: bool = True, report: Callable[[str], None] = print
) -> Path:
    """Write the report page of a run to its directory or to `out`; return its path.

    `pictures`: include pictures, and render some if there are none. `report` is called with a message about missing
    packages. Raises GranflowError if the directory is not that of a run, or if files cannot be read.
    """
    record = read_record(directory)
    script = library()
    if not script:
        report(sections.NO_LIBRARY)
    path = out or directory / PAGE
    path.parent.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory() as scratch:
        page = page_of(record, script, _pictures(record, Path(scratch)) if pictures else None)
        with replacing(path) as temporary:
            write_page(page, temporary)
    return path


def page_of(record: RunRecord, script: str, pictures: Section | None) -> Page:
    """The page: results first, then the computation. `script` is the plot library; empty for a page without plots."""
    found = [
        sections.summary(record),
        sections.warnings(record),
        pictures,
        sections.expectations(record),
        *sections.over_time(record, bool(script)),
        sections.profile(record),
        sections.remaining_numbers(record),
        sections.plan(record),
        sections.machine(record),
        sections.scene(record),
    ]
    description = record.scene.description if record.scene is not None else None
    return Page(record.title, description or LEAD, [section for section in found if section is not None], script)


def _pictures(record: RunRecord, scratch: Path) -> Section:
    """Section with the pictures of the run."""
    shown, statement = pictures_for(record.directory, _frames(record.directory), scratch)
    parts: list[PagePart] = [Gallery(shown)] if shown else []
    return Section("Pictures", [*parts, statement])


def _frames(directory: Path) -> list[Frame]:
    """Frames of the run; empty if it has none."""
    try:
        return frames_of(directory)
    except GranflowError:
        return []
