"""`granflow compare`: one scene with several normal contact models, side by side.

`compare` runs the scene with each contact model (`granflow.studies.compare.runs`), collides two of its
particles over three decades of velocity (`granflow.studies.compare.collisions`), and writes the results: the
summary table `compare.csv`, further CSV tables, the figures, a script for ParaView, and the page
`compare.html`.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from granflow import Scene
from granflow.scene.blocks.output import FLOW_BLOCKS
from granflow.studies.compare.bed import FORCE_EDGES, MIN_CONTACTS, SURFACE_PERCENTILE
from granflow.studies.compare.collisions import (
    COARSE_STEPS,
    FINE_STEPS,
    Assessment,
    CollisionSubject,
    LawSweep,
    assess,
    floor_velocity,
    soft_spring_note,
    subject_of,
    sweep_columns,
    sweeps_of,
)
from granflow.studies.compare.differences import Difference, Estimate, difference_of
from granflow.studies.compare.runs import (
    BURSTS,
    SAMPLES,
    SAMPLES_PER_CONTACT,
    VariantRun,
    at_end,
    densest_stage,
    hertz_duration,
    reduced_counts,
    reference_velocity_of,
    repetitions_of,
    run_all,
    variants_of,
)
from granflow.studies.figures import (
    COLORS,
    MARKERS,
    Drawing,
    PageTable,
    attribute_columns,
    stacked,
    stacked_panels,
)
from granflow.studies.page import write_page, write_study
from granflow.visible_text import readable

PAGE = "compare.html"
MOST_PARTICLES = 4000
"""Particle count to which a scene is reduced, unless all particles are requested.

Four contact models then run within minutes on two cores.
"""


@dataclass(frozen=True)
class SceneComparison:
    """Settings and results of a comparison.

    `reference_velocity` [m/s]; `reduced`: particle counts of the groups that were reduced; `until` [s]: end
    of each run; `refused`: reason by title of the variant; `collisions`: columns of collisions.csv; `seeds`:
    number of runs of each contact model.
    """

    scene: Scene
    reference_velocity: float
    reduced: dict[str, int]
    until: float | None
    runs: list[VariantRun]
    refused: dict[str, str]
    subject: CollisionSubject | None
    sweeps: list[LawSweep]
    collisions: dict[str, np.ndarray]
    seeds: int = 1

    @property
    def assessments(self) -> list[Assessment]:
        """Assessment of the spring constants of the linear contact model."""
        return assess(self.collisions, self.runs)

    @property
    def rows(self) -> "list[SummaryRow]":
        """Rows of the summary table."""
        return summary(self.runs)

    @property
    def differences(self) -> list[Difference]:
        """Differences with intervals from all seeds; with one seed, those of mass flow rates from their
        fluctuation."""
        return differences_between_seeds(self.runs) if self.seeds > 1 else differences_in_time(self.runs)


def compare(
    scene: Scene,
    laws: Sequence[str],
    out: Path,
    arch: str = "cpu",
    reference_velocity: float | None = None,
    until: float | None = None,
    all_particles: bool = False,
    report: Callable[[str], None] = lambda text: None,
    prepare: Callable[[Path], None] = lambda directory: None,
    repeat: bool = False,
    seeds: int = 1,
) -> SceneComparison:
    """Run the scene with each contact model and write tables, figures, PVD files and the page into `out`.

    `laws`: names of contact models. `reference_velocity` [m/s]: impact velocity for the constant linear
    spring, by default a tenth of the largest impact velocity. `until` [s] ends each run early. Unless
    `all_particles`, scenes with more than MOST_PARTICLES particles are reduced. `report` receives progress
    messages. Runs of an earlier call with the same arguments in `out` are kept, unless `repeat`; `prepare`:
    called with the directory of each other run. `seeds`: number of runs of each contact model, with the seed
    of the scene and those after it.

    Raises GranflowError if no contact model can run the scene.
    """
    velocity = reference_velocity or reference_velocity_of(scene)
    most = None if all_particles else MOST_PARTICLES
    variants = variants_of(scene, laws, velocity, most)
    planned = [*variants, *repetitions_of(variants, seeds)]
    out.mkdir(parents=True, exist_ok=True)
    runs, refused = run_all(
        planned, [out / each.key for each in planned], arch, velocity, until, report, prepare, repeat
    )
    subject = subject_of(scene, velocity)
    sweeps: list[LawSweep] = []
    if subject is not None:
        report("collisions over three decades of velocity")
        sweeps = sweeps_of(scene, subject, [each for each in variants if each.scene is not None], arch)
    columns = sweep_columns(subject, sweeps) if subject is not None else {}
    found = SceneComparison(
        scene, velocity, reduced_counts(scene, most), until, runs, refused, subject, sweeps, columns, seeds
    )
    write_all(found, out, report)
    return found


def write_all(found: SceneComparison, out: Path, report: Callable[[str], None] = lambda text: None) -> None:
    """Write all files except the output of the runs; without matplotlib the page has no figures."""
    runs = found.runs
    write_script(out, found.scene, runs, max(run.typical_speed for run in runs) or 1.0)
    assessed = [(each.part, each.conclusion, each.why) for each in found.assessments]
    missing = write_study(
        out / PAGE,
        "compare.html",
        tables=_tables(found),
        figures=drawings(runs, found.subject, found.collisions),
        found=found,
        notes=notes_on(found),
        stage_note=stage_note(found),
        stage=densest_stage(runs),
        has_forces=has_forces(runs),
        least_contacts=MIN_CONTACTS,
        summary=PageTable(heads(runs), as_text(found.rows)),
        differences=differences_table(found.differences),
        scatter_note=scatter_note(found),
        surface_percentile=SURFACE_PERCENTILE,
        bursts=BURSTS,
        samples=SAMPLES,
        spacing=1e6 * hertz_duration(found.scene, found.reference_velocity) / SAMPLES_PER_CONTACT,
        assessments=PageTable(("question", "answer", "numbers"), assessed, "Assessment."),
        floor=floor_velocity(found.subject) if found.subject else None,
        fine_steps=FINE_STEPS,
        coarse_steps=COARSE_STEPS,
        script=SCRIPT,
    )
    if missing:
        report(f"no figures: {missing}")


def _tables(found: SceneComparison) -> dict[str, dict[str, np.ndarray]]:
    """Columns of compare.csv, seeds.csv, differences.csv, heights.csv, forces.csv, durations.csv and
    collisions.csv.

    All in SI units; forces are relative to the mean of their frame. collisions.csv only if collisions were
    simulated, differences.csv only with intervals, seeds.csv only with several seeds.
    """
    keyed = [(run.variant.key, run) for run in found.runs]
    forces = ("force_over_mean_from", "force_over_mean_to", "density", "contact_count")
    bins = (FORCE_EDGES[:-2], FORCE_EDGES[1:-1])  # without the open last bin
    tables = {
        "compare.csv": summary_columns(found.runs, found.rows),
        "heights.csv": stacked(
            ("law", "time", "height_of_center", "height_of_surface"),
            [(key, *run.heights.T) for key, run in keyed],
        ),
        "forces.csv": stacked(
            ("law", "stage", *forces),
            [
                (key, stage, *bins, run.forces.density(stage), count[:-1])
                for key, run in keyed
                for stage, count in run.forces.counts.items()
            ],
        ),
        "durations.csv": stacked(
            ("law", "time_in_contact", "share_lasting_longer"),
            [(key, *run.duration_survival) for key, run in keyed],
        ),
    }
    if found.seeds > 1:
        tables["seeds.csv"] = seed_columns(found.runs)
    if found.differences:
        tables["differences.csv"] = attribute_columns(
            found.differences,
            ("quantity", "unit", "title", "first", "reference", "value", "low", "high", "conclusion"),
        )
    return tables | ({"collisions.csv": found.collisions} if found.collisions else {})


# ---------------------------------------------------------------- sentences


def notes_on(found: SceneComparison) -> list[str]:
    """Sentences on the size of the runs, a spring that is too soft, and aborted and impossible runs."""
    soft = soft_spring_note(found.runs, found.subject)
    return [size_note(found), *filter(None, [soft]), *stop_notes(found)]


def size_note(found: SceneComparison) -> str:
    """Sentence on the particle counts and the end time of the runs."""
    text = "The runs include all particles."
    if found.reduced:
        counts = ", ".join(
            f"{count} of {found.scene.particles[name].count} {name}" for name, count in found.reduced.items()
        )
        text = f"To shorten the runs, the scene has only {counts}; --full runs all particles."
    return text + (f" Every run ends at {found.until:g} s." if found.until is not None else "")


def stop_notes(found: SceneComparison) -> list[str]:
    """Sentences on aborted runs and on contact models that cannot run the scene."""
    text = [
        f"{run.variant.title} was aborted at {run.time:.6g} s: {run.stopped.removeprefix('Stopped: ')}"
        for first in found.runs
        for run in (first, *first.repetitions)
        if run.stopped
    ]
    return text + [f"{title} cannot run this scene: {why}" for title, why in found.refused.items()]


def stage_note(found: SceneComparison) -> str:
    """Sentence on the stage of the starred rows."""
    return (
        f"Rows with a star (*) refer to the end of the stage {densest_stage(found.runs)}, which has the most "
        "contacts; those on forces to all frames of this stage."
    )


# ---------------------------------------------------------------- summary table

STRONG = 2.0
"""Multiple of the mean force above which a contact counts as strong."""
MISSING = "–"
"""Cell without a value."""


class Unit(NamedTuple):
    """SI unit of a value, unit in the table, and its value in SI units; empty text for dimensionless
    values."""

    si: str
    shown: str
    per_si: float


SECOND, MICROSECOND, MILLIMETER = Unit("s", "s", 1.0), Unit("s", "µs", 1e6), Unit("m", "mm", 1e3)
MILLIJOULE, MASS_FLOW = Unit("J", "mJ", 1e3), Unit("kg/s", "kg/s", 1.0)
NUMBER, PERCENT = Unit("", "", 1.0), Unit("", "%", 1e2)
Quantity = tuple[str, Unit, Callable[[VariantRun], float]]
"""Name, unit, and function that returns the value of a run in SI units, or nan."""


@dataclass(frozen=True)
class SummaryRow:
    """One quantity in SI units for all runs, in the order of the runs; nan if a run has no value.

    With several seeds, values are means. The first run is the reference of the ratios. `is_complete`: whether
    the value refers to a complete run, or does not depend on the run; ratios of other values are nan.
    `at_stage`: whether the value refers to the densest stage.
    """

    name: str
    unit: Unit
    values: tuple[float, ...]
    is_complete: tuple[bool, ...]
    at_stage: bool = False

    @property
    def label(self) -> str:
        """Name, with a star if the value refers to the densest stage."""
        return f"{self.name} *" if self.at_stage else self.name

    @property
    def ratios(self) -> tuple[float, ...]:
        """Ratios to the value of the first run; nan if that is 0 or missing, or for part of a run."""
        first = self.values[0] if self.is_complete[0] else 0.0
        pairs = zip(self.values, self.is_complete, strict=True)
        return tuple(value / first if first and is_complete else float("nan") for value, is_complete in pairs)


TIME_STEP: Quantity = ("time step", MICROSECOND, lambda run: run.time_step)
COST: tuple[Quantity, ...] = (
    ("simulated time", SECOND, lambda run: run.time),
    ("steps needed", NUMBER, lambda run: run.step_count),
    ("wall time of steps", SECOND, lambda run: run.seconds),
    ("wall time per step", MICROSECOND, lambda run: run.seconds / max(run.step_count, 1)),
    ("compilation", SECOND, lambda run: run.compile_seconds),
)
"""Steps and wall time."""
CONTACTS: tuple[Quantity, ...] = (
    ("maximum overlap/radius", PERCENT, lambda run: np.nanmax(run.columns["overlap_largest"])),
    ("median contact duration", MICROSECOND, lambda run: run.median_duration),
)
"""Contacts of the complete run."""
ENERGY_QUANTITIES: tuple[Quantity, ...] = (
    ("kinetic energy, end", MILLIJOULE, lambda run: run.columns["kinetic_energy"][-1]),
    ("lost: plastic", MILLIJOULE, lambda run: run.columns["plastic_dissipation"][-1]),
    ("lost: friction", MILLIJOULE, lambda run: run.columns["friction_dissipation"][-1]),
    ("lost: rolling", MILLIJOULE, lambda run: run.columns["rolling_dissipation"][-1]),
    ("lost: damping", MILLIJOULE, lambda run: run.columns["damping_dissipation"][-1]),
)
"""Energies at the end of the run."""
ENERGY_ERROR: Quantity = ("energy error, end", PERCENT, lambda run: abs(run.columns["energy_error"][-1]))


def summary(runs: Sequence[VariantRun]) -> list[SummaryRow]:
    """All rows with a finite value of at least one run: cost, flow, bed, contacts, energies that are not all
    zero."""

    is_complete = tuple(any(not each.stopped for each in run.of_all_seeds) for run in runs)

    def rows(quantities: Iterable[Quantity], at_stage: bool = False) -> list[SummaryRow]:
        return [
            SummaryRow(name, unit, tuple(run.mean(number) for run in runs), is_complete, at_stage)
            for name, unit, number in quantities
        ]

    time_steps = [replace(row, is_complete=(True,) * len(runs)) for row in rows([TIME_STEP])]
    found = [
        *time_steps,
        *rows(COST),
        *rows(map(_flow, runs[0].meters)),
        *rows(_bed(densest_stage(runs)), at_stage=True),
    ]
    found += [
        *rows(CONTACTS),
        *(row for row in rows(ENERGY_QUANTITIES) if any(row.values)),
        *rows([ENERGY_ERROR]),
    ]
    return [row for row in found if np.isfinite(row.values).any()]


def physical_quantities(runs: Sequence[VariantRun]) -> list[Quantity]:
    """Quantities of the summary that describe the material, neither cost nor numerics."""
    return [
        *map(_flow, runs[0].meters),
        *_bed(densest_stage(runs)),
        *CONTACTS,
        *ENERGY_QUANTITIES,
    ]


def _flow(meter: str) -> Quantity:
    """Mass flow rate through a meter."""
    return f"mass flow rate, {meter}", MASS_FLOW, lambda run: run.mass_flow(meter)


def _bed(stage: str) -> tuple[Quantity, ...]:
    """State of the bed at the end of a stage."""
    return (
        ("end of stage", SECOND, at_end(stage, "time")),
        ("center of mass", MILLIMETER, partial(_height, stage, 1)),
        ("surface", MILLIMETER, partial(_height, stage, 2)),
        ("coordination number", NUMBER, at_end(stage, "coordination_number")),
        ("mean overlap/radius", PERCENT, at_end(stage, "overlap_mean")),
        (f"contacts above {STRONG:g} <f>", PERCENT, lambda run: run.forces.share_above(stage, STRONG)),
    )


def _height(stage: str, column: int, run: VariantRun) -> float:
    """Height [m] in the sample nearest to the end of a stage; nan if a run did not complete the stage."""
    time = at_end(stage, "time")(run)
    return (
        run.heights[np.argmin(np.abs(run.heights[:, 0] - time)), column]
        if np.isfinite(time)
        else float("nan")
    )


def heads(runs: Sequence[VariantRun], is_short: bool = False) -> list[str]:
    """Column headings of the table, on several lines; `is_short`: those of ratios name the first contact
    model only."""
    first, *others = (run.variant.title.replace(" ", "\n", 1) for run in runs)
    pairs = ((title, f"over\n{first}" if is_short else f"{title}\nover {first}") for title in others)
    return ["", "unit", first, *(head for pair in pairs for head in pair)]


def as_text(rows: Sequence[SummaryRow]) -> list[list[str]]:
    """Cells of the table: value of the first contact model, then value and ratio of each other."""
    found = []
    for row in rows:
        _, unit, factor = row.unit
        first, *others = (factor * value for value in row.values)
        cells = [row.label, unit, _number(first)]
        for value, ratio in zip(others, row.ratios[1:], strict=True):
            cells += [_number(value), f"{ratio:.3g}" if np.isfinite(ratio) else MISSING]
        found.append(cells)
    return found


def summary_columns(runs: Sequence[VariantRun], rows: Sequence[SummaryRow]) -> dict[str, np.ndarray]:
    """Columns of compare.csv: one row per quantity and contact model, with values in SI units and their
    ratios."""
    laws = [run.variant.key for run in runs]
    return {
        "quantity": np.repeat([row.name for row in rows], len(laws)),
        "unit": np.repeat([row.unit.si for row in rows], len(laws)),
        "law": np.tile(laws, len(rows)),
        "value": np.array([value for row in rows for value in row.values]),
        "ratio": np.array([ratio for row in rows for ratio in row.ratios]),
    }


# ---------------------------------------------------------------- scatter and differences


def seed_columns(runs: Sequence[VariantRun]) -> dict[str, np.ndarray]:
    """Columns of seeds.csv: one row per quantity, contact model and seed of a complete run, in SI units."""
    return stacked(
        ("quantity", "unit", "law", "seed", "value"),
        [
            (name, unit.si, run.variant.key, [_seed(each)], [float(number(each))])
            for name, unit, number in physical_quantities(runs)
            for run in runs
            for each in run.of_all_seeds
        ],
    )


def _seed(run: VariantRun) -> int:
    assert run.variant.scene is not None
    return run.variant.scene.seed


def differences_between_seeds(runs: Sequence[VariantRun]) -> list[Difference]:
    """Differences of the complete runs to those of the first contact model, with the scatter between seeds.

    Without quantities that are zero in all runs, and without contact models that have fewer than two complete
    runs.
    """
    return _differences(
        runs,
        [(name, unit, partial(_between_seeds, number)) for name, unit, number in physical_quantities(runs)],
    )


def _samples(run: VariantRun, number: Callable[[VariantRun], float]) -> list[float]:
    """Finite values of a number in the complete runs of all seeds."""
    complete = [each for each in run.of_all_seeds if not each.stopped]
    return [value for each in complete if np.isfinite(value := float(number(each)))]


def differences_in_time(runs: Sequence[VariantRun]) -> list[Difference]:
    """Differences of the mass flow rates of single runs, with their fluctuation in time."""
    return _differences(
        [run for run in runs if not run.stopped],
        [(_flow(meter)[0], MASS_FLOW, partial(_in_time, meter)) for meter in runs[0].meters],
    )


def _between_seeds(number: Callable[[VariantRun], float], run: VariantRun) -> Estimate:
    return Estimate.of(_samples(run, number))


def _in_time(meter: str, run: VariantRun) -> Estimate:
    return Estimate(run.mass_flow(meter), run.mass_flow_error(meter), FLOW_BLOCKS)


def _differences(
    runs: Sequence[VariantRun], quantities: Iterable[tuple[str, Unit, Callable[[VariantRun], Estimate]]]
) -> list[Difference]:
    """Differences of estimates to those of the first run, where both errors are known and not all are 0."""
    found = []
    for name, unit, estimate in quantities:
        estimates = [estimate(run) for run in runs]
        if not any(each.mean for each in estimates):
            continue
        for run, each in zip(runs[1:], estimates[1:], strict=True):
            titles = (runs[0].variant.title, run.variant.title)
            found.append(difference_of(name, unit.si, titles, estimates[0], each))
    return [each for each in found if each is not None]


def differences_table(differences: Sequence[Difference]) -> PageTable:
    """Differences with their intervals, also relative to the mean of the first contact model."""
    first = differences[0].first if differences else ""
    rows = []
    for each in differences:
        value, *bounds = each.relative
        rows.append(
            [
                each.quantity,
                each.title,
                f"{readable(each.value)} {each.unit}".strip(),
                f"{readable(each.low)} to {readable(each.high)}",
                _signed_percent(value),
                " to ".join(map(_signed_percent, bounds)),
                each.conclusion,
            ]
        )
    heads = ("", "model", f"minus\n{first}", "95 %\ninterval", "%", "95 %\ninterval, %", f"than\n{first}")
    return PageTable(heads, rows)


def _signed_percent(share: float) -> str:
    """A fraction in percent with two digits and its sign; a dash for nan."""
    value = 100.0 * share
    if not np.isfinite(value):
        return MISSING
    return f"{value:+.2g}" if abs(value) < 100.0 else f"{value:+.0f}"


def scatter_note(found: SceneComparison) -> str:
    """What the intervals of the differences contain, and how to get those that are missing."""
    if found.seeds == 1:
        text = (
            "Each contact model has run with one seed: the scatter between random packings is unknown, and "
            "small differences can be chance. --seeds 5 repeats each run with four other seeds and keeps "
            "those that have ended."
        )
        if found.differences:
            text += (
                " The intervals of the mass flow rates contain the fluctuation of the flow in time within "
                "each run, not the scatter between packings."
            )
        return text
    if has_no_scatter(found.runs):
        return (
            "The seed changes no result of this scene: there is no scatter, and differences between contact "
            "models are exact."
        )
    count = len(found.differences)
    return (
        f"The intervals are those of Welch from the scatter between {found.seeds} seeds. About one in 20 "
        f"of these {count} intervals excludes 0 by chance."
    )


def has_no_scatter(runs: Sequence[VariantRun]) -> bool:
    """Whether all seeds give the same numbers with every contact model."""
    samples = [_samples(run, number) for _, _, number in physical_quantities(runs) for run in runs]
    return all(len(set(values)) <= 1 for values in samples) and any(len(values) > 1 for values in samples)


def _number(value: float) -> str:
    """Text of a value, or a dash for nan."""
    return readable(value) if np.isfinite(value) else MISSING


# ---------------------------------------------------------------- figures

DASHES = ("-", "--", "-.", ":", (0, (5, 1, 1, 1, 1, 1)), (0, (1, 1)), (0, (8, 2)), (0, (3, 1, 1, 1)))
"""Line styles by index of the run."""
ENERGIES = {
    "kinetic": ("kinetic_energy", "rotational_energy"),
    "elastic": ("elastic_energy",),
    "lost: plastic": ("plastic_dissipation",),
    "lost: friction": ("friction_dissipation", "rolling_dissipation"),
    "lost: damping": ("damping_dissipation",),
}
"""Columns of timeseries.csv that are summed to each curve [J]."""


def drawings(
    runs: Sequence[VariantRun], subject: CollisionSubject | None, collisions: Mapping[str, np.ndarray]
) -> dict[str, Drawing]:
    """All figures by file name.

    `collisions`: columns of collisions.csv; without a subject or collisions, their figure is omitted.
    """
    figures = {
        "course.png": Drawing(lambda figure: draw_course(figure, runs), 7.0),
        "energies.png": Drawing(lambda figure: draw_energies(figure, runs), 0.8 + 1.6 * len(runs)),
        "contacts.png": Drawing(
            lambda figure: draw_contacts(figure, runs), 0.6 + 2.4 * (1 + has_forces(runs))
        ),
    }
    if subject is not None and collisions:
        figures["collisions.png"] = Drawing(
            lambda figure: draw_collisions(figure, subject, collisions, runs), 8.0
        )
    return figures


def _style(number: int) -> dict[str, Any]:
    """Color and line style of a run by its index."""
    return {"color": COLORS[number % len(COLORS)], "linestyle": DASHES[number % len(DASHES)]}


def _legend(figure: Any, axes: Any) -> None:
    """Shared legend of a figure, above the panels."""
    handles, names = axes.get_legend_handles_labels()
    figure.legend(handles, names, loc="outside upper center", ncols=2)


def draw_course(figure: Any, runs: Sequence[VariantRun]) -> None:
    """Draw flow, bed heights, contacts and overlaps against time.

    A cross marks an aborted run. Without flow meters, the kinetic energy replaces the flow.
    """
    panels = stacked_panels(figure, 4, sharex=True)
    meters = runs[0].meters
    for number, run in enumerate(runs):
        style = _style(number)
        columns = run.columns
        first = columns[f"flow_mass.{meters[0]}"] if meters else 1e3 * columns["kinetic_energy"]
        panels[0].plot(columns["time"], first, label=run.variant.title, **style)
        panels[1].plot(run.heights[:, 0], 1e3 * run.heights[:, 1], **style)
        panels[1].plot(run.heights[:, 0], 1e3 * run.heights[:, 2], **style, alpha=0.6, linewidth=0.8)
        panels[2].plot(columns["time"], columns["coordination_number"], **style)
        panels[3].plot(columns["time"], 100.0 * columns["overlap_mean"], **style)
        if run.stopped:
            panels[0].plot(columns["time"][-1], first[-1], marker="x", color=style["color"])
    panels[0].set_ylabel(f"mass through {meters[0]} (kg)" if meters else "kinetic energy (mJ)")
    panels[1].set_ylabel("height (mm): center, surface")
    panels[2].set_ylabel("coordination number")
    panels[3].set(ylabel="mean overlap / radius (%)", xlabel="time (s)")
    _legend(figure, panels[0])


def draw_energies(figure: Any, runs: Sequence[VariantRun]) -> None:
    """Draw stored and dissipated energies, one panel per contact model."""
    panels = stacked_panels(figure, len(runs), sharex=True, sharey=True)
    for number, (axes, run) in enumerate(zip(panels, runs, strict=True)):
        for kind, (label, names) in enumerate(ENERGIES.items()):
            total = sum(run.columns[name] for name in names)
            axes.plot(run.columns["time"], 1e3 * total, label=label, **_style(kind))
        axes.set_title(f"({'abcdefghij'[number]}) {run.variant.title}")
        axes.set_ylabel("energy (mJ)")
    panels[-1].set_xlabel("time (s)")
    _legend(figure, panels[0])


def draw_contacts(figure: Any, runs: Sequence[VariantRun]) -> None:
    """Draw the distribution of normal forces and the survival function of the contact duration, if there are
    any.

    The forces are those of the densest stage; the duration is the last panel.
    """
    panels = stacked_panels(figure, 2 if has_forces(runs) else 1)
    if has_forces(runs):
        _draw_forces(panels[0], runs)
    for number, run in enumerate(runs):
        times, share = run.duration_survival
        steps = (1e6 * np.append(0.0, times), np.append(1.0, share))
        panels[-1].step(*steps, where="post", label=run.variant.title, **_style(number))
    panels[-1].set(xlabel="contact duration (µs)", ylabel="share of longer contacts", ylim=(0.0, 1.02))
    _legend(figure, panels[-1])


def has_forces(runs: Sequence[VariantRun]) -> bool:
    """Whether a run has a frame of the densest stage with enough contacts for a distribution of forces."""
    stage = densest_stage(runs)
    return any(np.any(run.forces.density(stage) > 0.0) for run in runs)


def _draw_forces(axes: Any, runs: Sequence[VariantRun]) -> None:
    """Draw the distributions of normal forces of the densest stage."""
    stage = densest_stage(runs)
    middles = 0.5 * (FORCE_EDGES[:-2] + FORCE_EDGES[1:-1])
    for number, run in enumerate(runs):
        density = run.forces.density(stage)
        axes.plot(middles, np.where(density > 0.0, density, np.nan), **_style(number))
    axes.set(yscale="log", xlabel="$f/\\langle f \\rangle$", ylabel=f"$P(f/\\langle f \\rangle)$, {stage}")


def draw_collisions(
    figure: Any, subject: CollisionSubject, columns: Mapping[str, np.ndarray], runs: Sequence[VariantRun]
) -> None:
    """Draw duration, maximum overlap and restitution over the exact values, with the fine and the reference
    step.

    `columns`: of collisions.csv. Dotted: reference velocity, and the lower velocity limit of Eq. 19 per
    contact.
    """
    panels = stacked_panels(figure, 4, sharex=True)
    shown = (
        ("duration", "fine"),
        ("overlap_max", "fine"),
        ("restitution", "fine"),
        ("restitution", "coarse"),
    )
    titles = {run.variant.key: run.variant.title for run in runs}
    for number, law in enumerate(dict.fromkeys(columns["law"].tolist())):
        style = _style(number) | {
            "marker": MARKERS[number % len(MARKERS)],
            "markersize": 3.5,
            "markerfacecolor": "w",
        }
        for axes, (name, step) in zip(panels, shown, strict=True):
            is_row = (columns["law"] == law) & (columns["step"] == step)
            ratio = columns[name][is_row] / columns[f"{name}_exact"][is_row]
            axes.plot(columns["velocity"][is_row], ratio, label=titles.get(law, law), **style)
    for letter, axes in zip("abcd", panels, strict=True):
        axes.axhline(1.0, color="0.6", linewidth=0.6, zorder=0)
        axes.axvline(subject.reference_velocity, color="0.5", linestyle=":", linewidth=0.8)
        axes.axvline(floor_velocity(subject), color="0.7", linestyle=":", linewidth=0.8)
        axes.set_title(f"({letter})")
    panels[0].set(xscale="log", ylabel="contact duration,\nsimulated / exact", yscale="log")
    panels[1].set(ylabel="maximum overlap,\nsimulated / exact", yscale="log")
    panels[2].set(ylabel="restitution / target,\nfine time step")
    panels[3].set(ylabel="restitution / target,\nreference time step", xlabel="approach velocity (m/s)")
    low, high = (f(a.get_ylim()[k] for a in panels[2:]) for k, f in enumerate((min, max)))
    for axes in panels[2:]:
        axes.set_ylim(low, high)
    for axes in panels[:2]:
        axes.set_yticks([0.4, 0.6, 0.8, 1.0, 1.5, 2.0], ["0.4", "0.6", "0.8", "1", "1.5", "2"])
        axes.set_yticks([], minor=True)
    _legend(figure, panels[0])


# ---------------------------------------------------------------- script for ParaView
#
# It shows the PVD files of all variants side by side, and finds them at their absolute path, or in its
# directory if they were moved together.

SCRIPT = "side_by_side.py"
"""Name of the script."""
GAP = 0.25
"""Gap between two variants, over the width of the domain."""


def write_script(out: Path, scene: Scene, runs: Sequence[VariantRun], speed: float) -> None:
    """Write the script into `out`; `speed` [m/s] is the upper end of the color scale.

    The variants are shifted along the horizontal axis by the width of the domain plus a gap.
    """
    low, high = np.array(scene.domain.min), np.array(scene.domain.max)
    up = -np.array(scene.usual_gravity, dtype=float)
    vertical = int(np.argmax(np.abs(up))) if up.any() else 2
    horizontal = 0 if vertical != 0 else 1
    depth = 3 - vertical - horizontal
    shift = np.zeros(3)
    axis = np.zeros(3)
    view_axis = np.zeros(3)
    shift[horizontal] = (1.0 + GAP) * (high - low)[horizontal]
    axis[vertical] = 1.0 if up[vertical] >= 0.0 else -1.0
    view_axis[depth] = -1.0 if (horizontal, vertical, depth) == (0, 2, 1) else 1.0
    top = 0.5 * (low + high)
    top[vertical] = high[vertical] if axis[vertical] > 0.0 else low[vertical]
    write_page(
        out / SCRIPT,
        "side_by_side.py.jinja",
        title=scene.title.replace('"', "'"),
        names={run.variant.key: run.variant.title + (" (aborted)" if run.stopped else "") for run in runs},
        script=SCRIPT,
        directory=str(out.resolve()),
        shift=shift.tolist(),
        speed=speed,
        top=top.tolist(),
        view_axis=view_axis.tolist(),
        up=axis.tolist(),
    )
