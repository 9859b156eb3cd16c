"""The page of a sweep."""

from pathlib import Path

from granflow.fields import unit_of
from granflow.io.atomic_files import write_text
from granflow.studies.page import page_text
from granflow.studies.report.plots import library
from granflow.studies.sweep import plots
from granflow.studies.sweep.axes import last_key, plain
from granflow.studies.sweep.schema import Grid, SweepInput
from granflow.studies.sweep.sensitivity import sobol_indices
from granflow.studies.sweep.series_overlay import series_overlay
from granflow.studies.sweep.table import SweepTable, label
from granflow.studies.tables import PageTable
from granflow.visible_text import in_degrees

PAGE = "sweep.html"
NO_LIBRARY = "Plots require plotly, which is not installed: pip install granflow[sweep], then repeat the command."


def write_sweep_page(out: Path, sweep: SweepInput, name: str, table: SweepTable) -> None:
    """Write `sweep.html` to the directory of the sweep; without plotly, it has tables only."""
    script = library()
    has_plots = bool(script and plots.usable_rows(table))
    indices, why_none = sobol_indices(sweep, table)
    gridded = isinstance(sweep.sampling, Grid)
    text = page_text(
        "sweep.html",
        plotly=script,
        title=sweep.title or f"Sweep {name}",
        lead=sweep.description or f"{len(table.rows)} points of {sweep.scene}.",
        statuses=_statuses(table),
        no_library="" if script else NO_LIBRARY,
        effects=[plots.main_effects(table, each) for each in table.quantities] if has_plots else [],
        heat_maps=plots.heat_maps(table) if has_plots and gridded else [],
        parallel=plots.parallel_coordinates(table) if has_plots else None,
        matrix=plots.scatter_matrix(table) if has_plots else None,
        sobol=[plots.sobol_plot(table, each) for each in indices] if script else [],
        why_no_sobol=why_none,
        overlay=series_overlay(_series_names(table), table.quantities) if script else None,
        points=_points(table),
    )
    write_text(out / PAGE, text)


def _series_names(table: SweepTable) -> dict[str, Path]:
    """Directories of the runs that have begun, by a name with their parameters and their seed."""
    named: dict[str, Path] = {}
    for row in table.rows:
        values = ", ".join(f"{last_key(name)} {plain(row.point.values[name], 4)}" for name in table.parameters)
        for each in row.runs:
            if each.run is not None and each.run.directory.is_dir():
                seed = f", seed {each.run.seed}" if table.seed_count > 1 else ""
                named[f"{values}{seed}<br>runs/{each.run.directory.name}"] = each.run.directory
    return named


def _statuses(table: SweepTable) -> PageTable:
    """Number of points with each status."""
    statuses = [row.outcome.status for row in table.rows]
    return PageTable(("status", "points"), [(each, str(statuses.count(each))) for each in dict.fromkeys(statuses)])


def _points(table: SweepTable) -> PageTable:
    """All points: parameters, status, quantities with standard errors, run directories, reasons if there are any."""
    rows = []
    for row in table.rows:
        values = [str(plain(row.point.values[name], 6)) for name in table.parameters]
        numbers = [
            _with_error(row.mean(name), row.standard_error(name)) + in_degrees(row.mean(name), unit_of(name))
            for name in table.quantities
        ]
        rows.append([*values, row.outcome.status, *numbers, " ".join(row.directories), row.outcome.reason])
    heads = [*map(last_key, table.parameters), "status", *map(label, table.quantities), "runs", "reason"]
    if not any(row[-1] for row in rows):
        heads, rows = heads[:-1], [row[:-1] for row in rows]
    return PageTable(heads, rows)


def _with_error(value: float, error: float) -> str:
    """A number with its standard error, if there is one; a dash without a number."""
    if value != value:
        return "–"
    return f"{value:.5g}" + (f" ± {error:.2g}" if error == error else "")
