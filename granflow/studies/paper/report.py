"""`granflow paper`: all figures as PNG and CSV files, and a page with the figures and their deviations."""

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from granflow.contact import theory
from granflow.contact.material import limit_velocity
from granflow.studies.figures import draw_to, require_plotting, write_columns
from granflow.studies.page import Page, PageTable, Picture, Section, write_page
from granflow.studies.paper.accuracy import accuracy_figure, accuracy_run
from granflow.studies.paper.cases import PAPER_CASES, STEPS_PER_CONTACT
from granflow.studies.paper.comparison import REFERENCE_VELOCITY, LawComparison, compare, comparison_figure
from granflow.studies.paper.cost import BASE, CONTACTS, REPEATS, SIDE, Cost, costs
from granflow.studies.paper.figure_data import FigureData, percent
from granflow.studies.paper.loops import loop_figure, loop_run
from granflow.studies.paper.oblique import oblique_run
from granflow.studies.paper.oblique_figure import oblique_figure
from granflow.studies.paper.residual import error_figure, residual_figure, residual_run
from granflow.studies.paper.velocity import (
    duration_figure,
    estimate_run,
    restitution_figure,
    spring_figure,
    velocity_columns,
    velocity_run,
)

PAGE = "paper.html"
TABULATED = (0.2, 0.5, 0.7, 0.9, 1.0)
"""Restitutions in the table of the model."""

LEAD = (
    "Figures and tables of Y. H. Zhou, A theoretical model of collision between soft-spheres with Hertz elastic "
    "loading and nonlinear plastic unloading, Theor. Appl. Mech. Lett. 1, 041006 (2011), doi 10.1063/2.1104106, "
    "reproduced with the many-particle kernels: each point is a collision of two spheres in a scene of many. "
    "The largest deviation between simulation and theory is given below each figure."
)


def write_paper(out: Path, report: Callable[[str], None] = lambda text: None) -> Path:
    """Write all figures (PNG and CSV) and the page to `out`; return the path of the page.

    Runs on the CPU in double precision. `report` is called with progress messages. Raises GranflowError if matplotlib
    is not installed.
    """
    require_plotting()
    out.mkdir(parents=True, exist_ok=True)
    report("collisions for the figures of the paper")
    figures = paper_figures()
    report("collisions with all contact models")
    comparison = compare()
    laws = comparison_figure(comparison)
    report("oblique impacts")
    oblique = oblique_figure(oblique_run())
    report("cost per contact of all contact models")
    law_costs = costs({name: model for name, (model, _) in comparison.ran.items()})
    report("drawing")
    for figure_data in (*figures.values(), laws, oblique):
        write_columns(out / f"{figure_data.name}.csv", figure_data.columns)
        draw_to(out / f"{figure_data.name}.png", _drawing(figure_data), figure_data.height)
    page = Page("Reproduction of Zhou (2011)", LEAD, [
        *_paper_sections(figures, out), _laws_section(laws, comparison, law_costs, out),
        Section(oblique.title, _figure_parts(oblique, out)), _numerics_section(),
    ])  # fmt: skip
    write_page(page, out / PAGE)
    return out / PAGE


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


def _drawing(figure_data: FigureData) -> Callable[[Any], None]:
    return lambda figure: figure_data.draw(figure, figure_data.columns)


def _figure_parts(figure_data: FigureData, out: Path) -> list[str | PageTable | Picture]:
    """A figure followed by its deviations."""
    files = (f"{figure_data.name}.png", f"{figure_data.name}.csv")
    picture = Picture(out / files[0], figure_data.caption, files)
    return [picture, *(deviation.sentence() for deviation in figure_data.deviations)]


def _paper_sections(figures: dict[str, FigureData], out: Path) -> Iterable[Section]:
    extra = {"figure1_residual": _model_table(figures["figure1_residual"]), "figure3_restitution": _material_table()}
    for name, figure_data in figures.items():
        parts = _figure_parts(figure_data, out)
        if name in extra:
            parts.append(extra[name])
        yield Section(figure_data.title, parts)


def _model_table(figure_data: FigureData) -> PageTable:
    """Theoretical x, Lambda, eta2 and T/Ts of Eqs. 7, 8, 15, and simulated values.

    One row for each restitution in TABULATED.
    """
    columns, rows = figure_data.columns, []
    for e in TABULATED:
        index = int(abs(columns["restitution"] - e).argmin())
        scaled = columns["duration_over_ts_theory"][index]
        rows.append((
            f"{e:g}", f"{columns['restitution_simulated'][index]:.5f}",
            f"{columns['residual_exact'][index]:.6f}", f"{columns['residual_simulated'][index]:.6f}",
            f"{float(theory.unloading_slope(e)):.5g}", f"{theory.unloading_duration(e):.4f}",
            f"{scaled:.4f}", f"{scaled * columns['duration_simulated_over_theory'][index]:.4f}",
        ))  # fmt: skip
    heads = ("e given", "e simulated", "x theory", "x simulated", "Λ(e)", "η₂", "T/Ts theory", "T/Ts simulated")
    caption = f"Theory (Eqs. 7, 8, 13-15) and simulated collisions of {STEPS_PER_CONTACT} steps."
    return PageTable(caption, heads, rows)


def _material_table() -> PageTable:
    """Materials of the paper, with the ratio of E/Y of the two, which the paper gives as well."""
    rows = []
    ratios = []
    for case in PAPER_CASES:
        solid, fit = case.solid, case.fit
        strength = solid.yield_strength or float("nan")
        ratios.append(case.modulus_eff / strength)
        rows.append((
            case.title, f"{solid.young_modulus / 1e9:g}", f"{solid.poisson_ratio:g}", f"{solid.density:g}",
            f"{strength / 1e9:g}", f"{fit.sigma:g}" if fit else "", f"{fit.psi:g}" if fit else "",
            f"{limit_velocity(solid, solid):.1f}", f"{case.yield_velocity:g}",
        ))  # fmt: skip
    heads = ("", "E (GPa)", "ν", "ρ (kg/m³)", "Y (GPa)", "σ", "ψ", "v limit (m/s), Eq. 11", "v yield (m/s)")
    caption = (
        "Materials of Figs. 3 and 4. The ratio of effective modulus to yield strength is "
        f"{ratios[0] / ratios[1]:.2f} times as large for the first as for the second; the paper gives 6.5."
    )
    return PageTable(caption, heads, rows)


def _laws_section(figure_data: FigureData, comparison: LawComparison, law_costs: dict[str, Cost], out: Path) -> Section:
    """Figure of all contact models, largest deviation, table of cost and parameters, table of limitations."""
    worst = max(figure_data.deviations, key=lambda deviation: deviation.largest)
    picture = Picture(
        out / f"{figure_data.name}.png", figure_data.caption, (f"{figure_data.name}.png", f"{figure_data.name}.csv")
    )
    intro = (
        "A reproducible comparison in the manner of Stevens and Hrenya (2005). The parameter of each model that "
        f"determines its restitution is matched to Eq. 12 at {REFERENCE_VELOCITY:g} m/s; linear springs have the "
        "stiffness of Eq. 19 at that velocity. Differences at other velocities result from the models, not from the "
        "matching."
    )
    tables = (_cost_table(figure_data, comparison, law_costs), _failure_table(comparison))
    return Section(figure_data.title, [intro, picture, worst.sentence(), *tables])


def _cost_table(figure_data: FigureData, comparison: LawComparison, law_costs: dict[str, Cost]) -> PageTable:
    """Table of cost, deviation and parameters of each contact model."""
    rows = []
    for (name, (model, _)), deviation in zip(comparison.ran.items(), figure_data.deviations, strict=True):
        cost = law_costs[name]
        spread = "" if name == BASE else f"{cost.low:.2f}–{cost.high:.2f}"
        history = str(model.law.history_count)
        rows.append((name, history, f"{cost.median:.2f}", spread, percent(deviation.largest), model.text()))
    heads = ("model", "history fields", "cost", "quartiles", "deviation of e", "parameters, SI (316 and 52100)")
    caption = (
        f"Cost: time per step on a compressed lattice of {SIDE**3} particles with {CONTACTS} contacts, relative to "
        f"{BASE} with damping, in {REPEATS} rounds that alternate between all models in one process, integration "
        f"included; {law_costs[BASE].nanoseconds:.0f} ns per contact and step with {BASE} on this machine. "
        "Other load on the machine increases the spread."
    )
    return PageTable(caption, heads, rows)


def _failure_table(comparison: LawComparison) -> PageTable:
    """Table of sources and limitations, and of the models that could not run."""
    rows = [(name, model.law.source, model.law.limits) for name, (model, _) in comparison.ran.items()]
    rows += [(name, "", f"not compared: {reason}") for name, reason in comparison.refused.items()]
    return PageTable("Sources and limitations of the contact models.", ("model", "source", "limitations"), rows)


def _numerics_section() -> Section:
    text = (
        "Double precision on cpu. The pairs are far apart in one scene; the times of first touch are "
        "evenly distributed over the phases of a step. A collision begins at first touch, which follows from the gap, "
        "and ends where the force, extrapolated from its last three values as a t + b t^1.5, vanishes within a step. "
        "The restitution is the ratio of separation to approach velocity. In Fig. 1, the loops and the figure of "
        f"accuracy the diameters are such that all collisions take the same number of steps, {STEPS_PER_CONTACT} "
        "unless stated otherwise."
    )
    return Section("Method", [text])
