"""`granflow paper`: all figures as PNG and CSV files, and a page with the figures and their deviations."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from granflow.contact import theory
from granflow.contact.material import limit_velocity
from granflow.studies.figures import Drawing, PageTable, percent, require_plotting
from granflow.studies.page import write_study
from granflow.studies.paper import comparison as cost
from granflow.studies.paper.comparison import REFERENCE_VELOCITY, LawComparison, compare, comparison_figure
from granflow.studies.paper.figures import (
    PAPER_CASES,
    STEPS_PER_CONTACT,
    FigureData,
    accuracy_figure,
    accuracy_run,
    duration_figure,
    error_figure,
    estimate_run,
    loop_figure,
    loop_run,
    residual_figure,
    residual_run,
    restitution_figure,
    spring_figure,
    velocity_columns,
    velocity_run,
)
from granflow.studies.paper.oblique import oblique_figure, oblique_run

TABULATED = (0.2, 0.5, 0.7, 0.9, 1.0)
"""Restitutions in the table of the model."""


def write_paper(out: Path, report: Callable[[str], None] = lambda text: None) -> Path:
    """Write all figures (PNG and CSV) and the page to `out`; return the path of the page.

    Runs on the CPU in double precision. `report` is called with progress messages. Raises GranflowError if
    matplotlib is not installed.
    """
    require_plotting()
    report("collisions for the figures of the paper")
    figures = paper_figures()
    report("collisions with all contact models")
    comparison = compare()
    laws = comparison_figure(comparison)
    report("oblique impacts")
    oblique = oblique_figure(oblique_run())
    report("cost per contact of all contact models")
    costs = cost.costs({name: model for name, (model, _) in comparison.ran.items()})
    report("drawing")
    everything = (*figures.values(), laws, oblique)
    materials, modulus_ratio = _materials()
    write_study(
        out / "paper.html",
        "paper.html",
        tables={f"{each.name}.csv": each.columns for each in everything},
        figures={f"{each.name}.png": Drawing(partial(_draw, each), each.height) for each in everything},
        paper_figures=figures.values(),
        laws=laws,
        oblique=oblique,
        model=_model(figures["figure1_residual"]),
        materials=materials,
        modulus_ratio=modulus_ratio,
        costs=_costs(laws, comparison, costs),
        nanoseconds=costs[cost.BASE].nanoseconds,
        limitations=_limitations(comparison),
        cost=cost,
        reference_velocity=REFERENCE_VELOCITY,
        steps_per_contact=STEPS_PER_CONTACT,
    )
    return out / "paper.html"


def paper_figures() -> dict[str, FigureData]:
    """Data of all figures of the paper, by name."""
    columns = velocity_columns(velocity_run())
    figures = (
        residual_figure(residual_run()),
        error_figure(),
        restitution_figure(columns),
        duration_figure(columns),
        spring_figure(columns, estimate_run()),
        loop_figure(loop_run()),
        accuracy_figure(*accuracy_run()),
    )
    return {figure_data.name: figure_data for figure_data in figures}


def _draw(data: FigureData, figure: Any) -> None:
    data.draw(figure, data.columns)


def _model(figure_data: FigureData) -> PageTable:
    """Table of theoretical x, Lambda, eta2 and T/Ts of Eqs. 7, 8, 15, and simulated values.

    One row for each restitution in TABULATED.
    """
    columns = figure_data.columns
    rows = []
    for e in TABULATED:
        index = int(abs(columns["restitution"] - e).argmin())
        scaled = columns["duration_over_ts_theory"][index]
        rows.append(
            (
                f"{e:g}",
                f"{columns['restitution_simulated'][index]:.5f}",
                f"{columns['residual_exact'][index]:.6f}",
                f"{columns['residual_simulated'][index]:.6f}",
                f"{float(theory.unloading_slope(e)):.5g}",
                f"{theory.unloading_duration(e):.4f}",
                f"{scaled:.4f}",
                f"{scaled * columns['duration_simulated_over_theory'][index]:.4f}",
            )
        )
    heads = (
        "e given",
        "e simulated",
        "x theory",
        "x simulated",
        "Λ(e)",
        "η₂",
        "T/Ts theory",
        "T/Ts simulated",
    )
    return PageTable(heads, rows)


def _materials() -> tuple[PageTable, float]:
    """Table of the materials, and the ratio of E/Y of the two, which the paper gives as well."""
    rows = []
    ratios = []
    for case in PAPER_CASES:
        solid = case.solid
        fit = case.fit
        strength = solid.yield_strength or float("nan")
        ratios.append(case.modulus_eff / strength)
        rows.append(
            (
                case.title,
                f"{solid.young_modulus / 1e9:g}",
                f"{solid.poisson_ratio:g}",
                f"{solid.density:g}",
                f"{strength / 1e9:g}",
                f"{fit.sigma:g}" if fit else "",
                f"{fit.psi:g}" if fit else "",
                f"{limit_velocity(solid, solid):.1f}",
                f"{case.yield_velocity:g}",
            )
        )
    heads = ("", "E (GPa)", "ν", "ρ (kg/m³)", "Y (GPa)", "σ", "ψ", "v limit (m/s), Eq. 11", "v yield (m/s)")
    return PageTable(heads, rows), ratios[0] / ratios[1]


def _costs(figure_data: FigureData, comparison: LawComparison, costs: dict[str, cost.Cost]) -> PageTable:
    """Table of cost, deviation and parameters of each contact model."""
    rows = []
    for (name, (model, _)), deviation in zip(comparison.ran.items(), figure_data.deviations, strict=True):
        found = costs[name]
        spread = "" if name == cost.BASE else f"{found.low:.2f}–{found.high:.2f}"
        history = str(model.law.history_count)
        rows.append((name, history, f"{found.median:.2f}", spread, percent(deviation.largest), model.text()))
    heads = (
        "model",
        "history fields",
        "cost",
        "quartiles",
        "deviation of e",
        "parameters, SI (316 and 52100)",
    )
    return PageTable(heads, rows)


def _limitations(comparison: LawComparison) -> PageTable:
    """Table of source and limitations of each contact model, and of the reason of those that could not
    run."""
    rows = [(name, model.law.source, model.law.limits) for name, (model, _) in comparison.ran.items()]
    rows += [(name, "", f"not compared: {reason}") for name, reason in comparison.refused.items()]
    return PageTable(
        ("model", "source", "limitations"), rows, "Sources and limitations of the contact models."
    )
