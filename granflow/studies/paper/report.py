"""`granflow paper`: all figures as PNG and CSV files, and a page with the figures and their deviations."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from granflow import ParticleData, Scene, SceneError, Simulation
from granflow.contact import theory
from granflow.contact.material import PairMaterial, limit_velocity, shear_modulus_eff
from granflow.contact.registry import models
from granflow.studies.bench import HeadOnCollision, Outcomes, collide, head_on_bench
from granflow.studies.figures import (
    COLORS,
    MARKERS,
    Drawing,
    PageTable,
    percent,
    require_plotting,
    stacked_panels,
)
from granflow.studies.page import write_study
from granflow.studies.paper.figures import (
    PAPER_CASES,
    STEPS_PER_CONTACT,
    FigureData,
    PaperCase,
    accuracy_figure,
    accuracy_run,
    duration_figure,
    error_figure,
    estimate_run,
    loop_figure,
    loop_run,
    relative_deviation,
    residual_figure,
    residual_run,
    restitution_figure,
    restitution_of,
    spring_figure,
    velocity_columns,
    velocity_run,
)
from granflow.studies.paper.oblique import oblique_figure, oblique_run

VELOCITIES = np.geomspace(0.01, 10.0, 19)
"""Approach velocities [m/s]."""
REFERENCE_VELOCITY = 1.0
"""Approach velocity [m/s] at which all contact models have the restitution of Eq. 12."""
_AT_REFERENCE = {"reference_velocity": REFERENCE_VELOCITY}
SETTINGS: Mapping[str, Mapping[str, Any]] = {
    "linear": {"stiffness": _AT_REFERENCE},
    "walton_braun": {"stiffness": _AT_REFERENCE, "unloading": _AT_REFERENCE},
    "luding": {"stiffness": _AT_REFERENCE, "plasticity_depth": 0.01, "tension": 0.0},
    "kuwabara_kono": _AT_REFERENCE,
}
"""Settings that replace the example of the catalog in this comparison."""


@dataclass(frozen=True)
class CandidateModel:
    """A contact model with its settings and the matched parameter of each material: restitution or yield
    strength [Pa].

    One entry per case of PAPER_CASES; None for the parameter that the model does not use.
    """

    name: str
    settings: Mapping[str, Any]
    law: Any
    """Contact model of the plan."""
    restitutions: tuple[Any, ...]
    yield_strengths: tuple[float | None, ...]

    @property
    def normal(self) -> dict[str, Any]:
        """The entry `contact.normal` of a scene."""
        return {"law": self.name, **self.settings}

    def text(self) -> str:
        """Settings and matched parameters, for a table."""
        text_parts = [f"{key} {_as_text(value)}" for key, value in self.settings.items()]
        if any(isinstance(value, float) for value in self.restitutions):
            text_parts.append("restitution " + " and ".join(f"{value:.4g}" for value in self.restitutions))
        elif self.restitutions[0] is not None:
            text_parts.append("Eq. 12 with sigma and psi of the paper")
        if any(self.yield_strengths):
            text_parts.append(
                "yield strength "
                + " and ".join(f"{(y or 0.0) / 1e9:.3g}" for y in self.yield_strengths)
                + " GPa"
            )
        return "; ".join(text_parts)


def _as_text(value: Any) -> str:
    if isinstance(value, Mapping):
        return " ".join(f"{key} {_as_text(inner)}" for key, inner in value.items()).replace("_", " ")
    return f"{value:g}" if isinstance(value, int | float) else str(value)


def candidate_model(name: str) -> CandidateModel:
    """Contact model matched to Eq. 12 at the reference velocity for both materials, by its single free
    parameter.

    Raises KeyError for an unknown name, ValueError if the model rejects the materials or has further
    parameters, which are not those of a collision.
    """
    kind = models("normal")[name]
    if further := kind.pair_properties.model_fields:
        raise ValueError(f"it has more parameters than the restitution: {', '.join(further)}")
    settings = SETTINGS.get(name, kind.example)
    wanted = [float(restitution_of(case, np.array(REFERENCE_VELOCITY))) for case in PAPER_CASES]
    fits = tuple({"preset": case.name} for case in PAPER_CASES)
    given = {"number or fit": fits, "nothing": (None, None)}.get(kind.restitution, wanted)
    pairs = [case.head_on(e, float(VELOCITIES.max())) for case, e in zip(PAPER_CASES, given, strict=True)]
    law = head_on_bench(pairs, {"law": name, **settings}, "auto", np.zeros(len(pairs))).plan.laws.normal
    if kind.restitution == "number or fit":
        return CandidateModel(name, settings, law, fits, (None, None))
    if kind.restitution == "nothing":
        found = [_matched_strength(law, case, e) for case, e in zip(PAPER_CASES, wanted, strict=True)]
        return CandidateModel(name, settings, law, (None, None), tuple(found))
    numbers = [_matched_number(law, case, e) for case, e in zip(PAPER_CASES, wanted, strict=True)]
    return CandidateModel(name, settings, law, tuple(numbers), (None, None))


def pair_of(case: PaperCase, restitution: Any, strength: float | None = None) -> PairMaterial:
    """Material pair of the case for contact models, without friction."""
    shear = shear_modulus_eff(case.solid, case.solid)
    yields = strength or case.solid.yield_strength
    return PairMaterial(case.modulus_eff, shear, restitution, yield_strength=yields)


def theoretical_restitution(law: Any, case: PaperCase, pair: PairMaterial, velocity: float) -> float:
    """Theoretical restitution of a contact model for the case at an approach velocity [m/s]."""
    return float(law.restitution(pair, 0.25 * case.diameter, case.mass_eff(), velocity))


def _matched_number(law: Any, case: PaperCase, e: float) -> float:
    """Restitution number of the pair for which the contact model has restitution e at the reference
    velocity."""
    return _root(
        lambda number: theoretical_restitution(law, case, pair_of(case, number), REFERENCE_VELOCITY) - e,
        0.05,
        1.0,
    )


def _matched_strength(law: Any, case: PaperCase, e: float) -> float:
    """Yield strength [Pa] for which the contact model has restitution e at the reference velocity."""
    low, high = 1e-3 * case.modulus_eff, 0.1 * case.modulus_eff
    return _root(
        lambda y: theoretical_restitution(law, case, pair_of(case, None, y), REFERENCE_VELOCITY) - e,
        low,
        high,
    )


def _root(function: Callable[[float], float], low: float, high: float) -> float:
    """Root of a function between two numbers; the end with the smaller value if it has no root there."""
    from scipy.optimize import brentq

    if function(low) * function(high) > 0.0:
        return min(low, high, key=lambda end: abs(function(end)))
    return float(brentq(function, low, high, xtol=1e-16 * high))


# ---------------------------------------------------------------- collisions and figure


@dataclass(frozen=True)
class LawComparison:
    """Outcomes of each contact model, and the models that could not run, with the reason."""

    ran: dict[str, tuple[CandidateModel, Outcomes]] = field(default_factory=dict)
    refused: dict[str, str] = field(default_factory=dict)


def compare(velocities: np.ndarray = VELOCITIES) -> LawComparison:
    """Simulate collisions of both materials at all velocities (n,) [m/s] with all contact models.

    The time step is the shortest collision duration of Zhou's model over STEPS_PER_CONTACT. Models that
    reject the materials or the time step are in `LawComparison.refused`.
    """
    comparison = LawComparison()
    shortest = min(
        float(case.durations(restitution_of(case, velocities), velocities).min()) for case in PAPER_CASES
    )
    for name in models("normal"):
        try:
            model = candidate_model(name)
            outcomes = collide(_collisions(model, velocities), model.normal, shortest / STEPS_PER_CONTACT)
        except (SceneError, ValueError) as error:
            comparison.refused[name] = str(error)
            continue
        comparison.ran[name] = (model, outcomes)
    return comparison


def _collisions(model: CandidateModel, velocities: np.ndarray) -> list[HeadOnCollision]:
    """Head-on collisions of a model: both materials, each at all velocities (n,) [m/s]."""
    found = []
    for case, e, strength in zip(PAPER_CASES, model.restitutions, model.yield_strengths, strict=True):
        material = case.material if strength is None else {**case.material, "yield_strength": strength}
        modified = replace(case, material=material)
        found += [modified.head_on(e, float(v)) for v in velocities]
    return found


def comparison_figure(comparison: LawComparison, velocities: np.ndarray = VELOCITIES) -> FigureData:
    """e(v) and T(v) of all contact models, with the deviation of e from the theory of each model.

    `velocities` (n,) [m/s]: those of `compare`. One deviation per model that ran.
    """
    count = len(velocities)
    rows = []
    deviations = []
    for name, (model, outcomes) in comparison.ran.items():
        requested_values = []
        for number, case in enumerate(PAPER_CASES):
            given = case.fit if isinstance(model.restitutions[number], dict) else model.restitutions[number]
            pair = pair_of(case, given, model.yield_strengths[number])
            requested_values += [theoretical_restitution(model.law, case, pair, float(v)) for v in velocities]
        materials, titles = (
            np.repeat([getattr(c, n) for c in PAPER_CASES], count) for n in ("name", "title")
        )
        speeds = np.tile(velocities, len(PAPER_CASES))
        laws = np.repeat(name, len(speeds))
        rows.append(
            (laws, materials, speeds, np.array(requested_values), outcomes.restitution, outcomes.duration)
        )
        where = [f"{v:.3g} m/s ({m})" for v, m in zip(speeds, titles, strict=True)]
        text = f"simulated e with {name} from its theoretical value"
        deviations.append(
            relative_deviation(text, outcomes.restitution, np.array(requested_values), where.__getitem__)
        )
    names = (
        "law",
        "material",
        "velocity",
        "restitution_promised",
        "restitution_simulated",
        "duration_simulated",
    )
    columns = {key: np.concatenate(parts) for key, parts in zip(names, zip(*rows, strict=True), strict=True)}
    caption = (
        "Restitution coefficient (above) and collision duration (below) of simulated collisions of two "
        "spheres of 25.4 mm with all contact models, against approach velocity. Each model has the "
        f"restitution of Eq. 12 at {REFERENCE_VELOCITY:g} m/s (dotted)."
    )
    title = "Comparison of all contact models"
    return FigureData("laws", title, caption, columns, tuple(deviations), draw_comparison, 8.6)


def draw_comparison(figure: Any, columns: Mapping[str, np.ndarray]) -> None:
    """Panels of restitution (above) and of duration (below), each with a panel for each material."""
    panels = stacked_panels(figure, 2 * len(PAPER_CASES), sharex=True).reshape(2, -1)
    laws = list(dict.fromkeys(columns["law"].tolist()))
    for column, case in enumerate(PAPER_CASES):
        for number, law in enumerate(laws):
            mine = (columns["law"] == law) & (columns["material"] == case.name)
            style = {
                "color": COLORS[number % len(COLORS)],
                "marker": MARKERS[number % len(MARKERS)],
                "label": law,
                "markersize": 6.0 - 0.5 * number,
                "markerfacecolor": "white",
                "markeredgewidth": 0.8,
                "linewidth": 0.9,
            }
            velocity = columns["velocity"][mine]
            panels[0, column].plot(velocity, columns["restitution_simulated"][mine], **style)
            panels[1, column].plot(velocity, 1e6 * columns["duration_simulated"][mine], **style)
        for axes in panels[:, column]:
            axes.axvline(REFERENCE_VELOCITY, linestyle=":", color="0.5", linewidth=0.8)
        above, below = panels[:, column]
        above.set(xscale="log", title=f"({'ab'[column]}) {case.title}", ylabel="restitution coefficient $e$")
        above.set_ylim(top=1.02)
        below.set(yscale="log", title=f"({'cd'[column]}) {case.title}", ylabel=r"collision duration $T$ (µs)")
        below.set_yticks([50, 100, 200], ["50", "100", "200"])
        below.set_yticks([40, 60, 70, 80, 90], [], minor=True)
    panels[1, -1].set_xlabel("approach velocity (m/s)")
    handles, names = panels[0, 0].get_legend_handles_labels()
    figure.legend(handles, names, loc="outside upper center", ncols=3)


# ---------------------------------------------------------------- cost per contact, relative to Hertz

SIDE = 16
"""Particles along an edge of the lattice."""
CONTACTS = 3 * SIDE**2 * (SIDE - 1)
"""Number of contacts of the lattice."""
REPEATS = 15
"""Number of timings of each contact model."""
STEPS = 60
"""Number of steps per timing."""
TIME_STEP = 1e-12
"""Time step [s], so short that the lattice does not change, while particles approach and separate."""
CLOSENESS = 0.9999
"""Distance of neighboring particles over the diameter."""
BASE = "hertz"
"""Contact model to which times are relative."""


@dataclass(frozen=True)
class Cost:
    """Time per step relative to the Hertz model: median and quartiles; time per contact and step [ns]."""

    median: float
    low: float
    high: float
    nanoseconds: float


def costs(candidate_models: Mapping[str, CandidateModel]) -> dict[str, Cost]:
    """Measure the time per step of all models on the same compressed lattice, alternating, REPEATS times.

    The result is relative to BASE, which must be among the models; median and quartiles over the repeats.
    """
    simulations = {name: _simulation(model) for name, model in candidate_models.items()}
    for simulation in simulations.values():
        simulation.step(STEPS)
    times = {name: np.array([]) for name in simulations}
    for _ in range(REPEATS):
        for name, simulation in simulations.items():
            times[name] = np.append(times[name], _timed(simulation))
    for simulation in simulations.values():
        simulation.free()
    found = {}
    for name, seconds in times.items():
        low, median, high = np.percentile(seconds / times[BASE], (25, 50, 75))
        found[name] = Cost(median, low, high, 1e9 * float(np.median(seconds)) / (STEPS * CONTACTS))
    return found


def _timed(simulation: Simulation) -> float:
    """Wall time [s] of STEPS steps."""
    start = perf_counter()
    simulation.step(STEPS)
    return perf_counter() - start


def _simulation(model: CandidateModel) -> Simulation:
    """Cubic lattice of overlapping particles of the first material, with velocities of both signs.

    SIDE^3 particles at CLOSENESS diameters; loading and unloading contacts occur with equal frequency.
    """
    case = PAPER_CASES[0]
    strength = model.yield_strengths[0]
    restitution = model.restitutions[0]
    count = SIDE**3
    reach = case.diameter * (SIDE + 1)
    low, high = [-case.diameter] * 3, [reach] * 3
    scene = Scene.from_dict(
        {
            "title": "Lattice for timing of contacts",
            "gravity": [0, 0, 0],
            "materials": {"steel": {**case.material, **({"yield_strength": strength} if strength else {})}},
            "pairs": {
                "steel-steel": {"friction": 0} | ({} if restitution is None else {"restitution": restitution})
            },
            "contact": {"normal": model.normal, "tangential": "none", "rolling": "none"},
            "particles": {
                "lattice": {
                    "material": "steel",
                    "diameter": case.diameter,
                    "count": count,
                    "insert": {"kind": "lattice", "region": {"box": {"min": low, "max": high}}},
                }
            },
            "domain": {"min": low, "max": high, "on_exit": "error"},
            "run": {"duration": 1.0, "time_step": TIME_STEP, "velocity_max": 1.0, "precision": "f64"},
            "output": {"interval": 1.0},
        }
    )
    axis = CLOSENESS * case.diameter * np.arange(SIDE)
    positions = np.stack(np.meshgrid(axis, axis, axis), axis=-1).reshape(-1, 3)
    velocities = np.random.default_rng(1).uniform(-1.0, 1.0, positions.shape)
    numbers = np.zeros(count, dtype=np.int32)
    radii = np.full(count, 0.5 * case.diameter)
    particles = ParticleData(positions, velocities, np.zeros_like(positions), radii, numbers, numbers)
    return Simulation(scene, particles=particles)


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
    measured = costs({name: model for name, (model, _) in comparison.ran.items()})
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
        costs=_costs(laws, comparison, measured),
        nanoseconds=measured[BASE].nanoseconds,
        limitations=_limitations(comparison),
        base=BASE,
        side=SIDE,
        contact_count=CONTACTS,
        repeats=REPEATS,
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


def _costs(figure_data: FigureData, comparison: LawComparison, measured: dict[str, Cost]) -> PageTable:
    """Table of cost, deviation and parameters of each contact model."""
    rows = []
    for (name, (model, _)), deviation in zip(comparison.ran.items(), figure_data.deviations, strict=True):
        found = measured[name]
        spread = "" if name == BASE else f"{found.low:.2f}–{found.high:.2f}"
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
