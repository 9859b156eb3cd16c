"""The page of a sweep."""

from dataclasses import replace
from math import floor, inf, log10
from pathlib import Path

from granflow.io.atomic_files import write_text
from granflow.studies.page import page_text
from granflow.studies.report.plots import library
from granflow.studies.sweep import plots
from granflow.studies.sweep.axes import level_text
from granflow.studies.sweep.schema import Grid, SweepInput
from granflow.studies.sweep.sensitivity import sobol_indices
from granflow.studies.sweep.series_overlay import NamedRun, series_overlay
from granflow.studies.sweep.shown import ShownTable, shown
from granflow.studies.sweep.table import SweepTable
from granflow.studies.tables import PageTable, without_empty_ends

PAGE = "sweep.html"
NO_LIBRARY = "Plots require plotly, which is not installed: pip install plotly, then repeat the command."


def write_sweep_page(out: Path, sweep: SweepInput, table: SweepTable) -> None:
    """Write `sweep.html` to the directory of the sweep; without plotly, it has tables only."""
    script = library()
    found = shown(sweep, table)
    drawn = replace(found, in_plots=True)
    has_plots = bool(script and plots.usable_rows(found))
    indices, why_none = sobol_indices(sweep, table)
    gridded = isinstance(sweep.sampling, Grid)
    text = page_text(
        "sweep.html",
        plotly=script,
        title=sweep.title or f"Sweep of {Path(sweep.scene).stem}",
        lead=sweep.description or f"{len(table.rows)} points of {sweep.scene}.",
        statuses=_statuses(table),
        no_library="" if script else NO_LIBRARY,
        effects=[plots.main_effects(drawn, each) for each in found.quantities] if has_plots else [],
        heat_maps=plots.heat_maps(drawn) if has_plots and gridded else [],
        parallel=plots.parallel_coordinates(drawn) if has_plots else None,
        matrix=plots.scatter_matrix(drawn) if has_plots else None,
        sobol=[plots.sobol_plot(drawn, each) for each in indices] if script else [],
        why_no_sobol=why_none,
        overlay=series_overlay(_named_runs(drawn), table.quantities, _named_by(found)) if script else None,
        points=_points(found),
    )
    write_text(out / PAGE, text)


def _named_runs(table: ShownTable) -> list[NamedRun]:
    """The runs that have begun, named by their parameters and their seed."""
    found = []
    for row in table.rows:
        values = [level_text(table.value(row, name), 4) for name in table.parameters]
        texts = [
            f"{table.parameter_label(name)} = {value}" for name, value in zip(table.parameters, values, strict=True)
        ]
        for each in row.runs:
            if each.run is not None and each.run.directory.is_dir():
                seed = [str(each.run.seed)] if table.table.seed_count > 1 else []
                hover = [*texts, *(f"seed = {number}" for number in seed), f"runs/{each.run.directory.name}"]
                found.append(NamedRun(", ".join(values + seed), "<br>".join(hover), each.run.directory))
    return found


def _named_by(table: ShownTable) -> str:
    """What the names of the runs contain."""
    return ", ".join([*map(table.parameter_label, table.parameters), *["seed"][: table.table.seed_count - 1]])


def _statuses(table: SweepTable) -> PageTable:
    """Number of points with each status."""
    statuses = [row.outcome.status for row in table.rows]
    return PageTable(("status", "points"), [(each, str(statuses.count(each))) for each in dict.fromkeys(statuses)])


def _points(table: ShownTable) -> PageTable:
    """All points: parameters, status, quantities with standard errors, run directories, reasons and warnings if any."""
    rows = []
    for row in table.rows:
        values = [level_text(table.value(row, name)) for name in table.parameters]
        numbers = [with_error(table.mean(row, name), table.standard_error(row, name)) for name in table.quantities]
        ends = (" ".join(row.directories), row.outcome.reason, row.warnings)
        rows.append([*values, row.outcome.status, *numbers, *ends])
    parameters, quantities = map(table.parameter_label, table.parameters), map(table.label, table.quantities)
    return without_empty_ends([*parameters, "status", *quantities, "runs", "reason", "warnings"], rows)


FIXED_POINT = (1e-4, 1e3)
"""Standard errors between these bounds are written without an exponent."""


def with_error(value: float, error: float) -> str:
    """A number and its standard error with two digits, if there is one: 19.1 ± 4.1; a dash without a number."""
    if value != value:
        return "–"
    if error != error:
        return f"{value:.5g}"
    if not 0.0 < error < inf or not abs(value) < inf:
        return f"{value:.5g} ± {error:.2g}"
    last = floor(log10(error)) - 1  # power of ten of the last digit
    if FIXED_POINT[0] <= error < FIXED_POINT[1]:
        return " ± ".join(f"{round(each, -last):.{max(-last, 0)}f}" for each in (value, error))
    digits = max(floor(log10(abs(value) or error)) - last, 0)
    return f"{value:.{digits}e} ± {error:.1e}"
