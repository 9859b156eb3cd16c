"""`granflow compare`: runs, collisions, output files and the page of the comparison."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from granflow.engine.backend import start
from granflow.errors import GranflowError
from granflow.load import Scene
from granflow.runs.result import readable
from granflow.studies.compare.bed_statistics import FORCE_EDGES, SURFACE_PERCENTILE
from granflow.studies.compare.collisions import (
    COARSE_STEPS,
    FINE_STEPS,
    CollisionSubject,
    LawSweep,
    floor_velocity,
    subject_of,
    sweep_columns,
    sweeps_of,
)
from granflow.studies.compare.drawing import draw_all
from granflow.studies.compare.paraview import SCRIPT, write_script
from granflow.studies.compare.runs import BURSTS, SAMPLES, SAMPLES_PER_CONTACT, VariantRun, hertz_duration, run_all
from granflow.studies.compare.spring_assessment import Assessment, assess
from granflow.studies.compare.summary import SummaryRow, as_text, densest_stage, heads, summary, summary_columns
from granflow.studies.compare.variants import reduced_counts, reference_velocity_of, variants_of
from granflow.studies.figures import write_columns
from granflow.studies.page import Page, PageTable, Picture, Section, write_page

PAGE = "compare.html"
MOST_PARTICLES = 4000
"""Particle count to which a scene is reduced, unless all particles are requested.

Four contact models then run within minutes on two cores.
"""


@dataclass(frozen=True)
class SceneComparison:
    """Settings and results of a comparison.

    `reference_velocity` [m/s]; `reduced`: particle counts of the groups that were reduced; `until` [s]: end of each
    run; `refused`: reason by title of the variant; `collisions`: columns of collisions.csv.
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

    @property
    def assessments(self) -> list[Assessment]:
        """Assessment of the spring constants of the linear contact model."""
        return assess(self.collisions, self.runs)

    @property
    def rows(self) -> list[SummaryRow]:
        """Rows of the summary table."""
        return summary(self.runs)


def compare(
    scene: Scene,
    laws: Sequence[str],
    out: Path,
    arch: str = "cpu",
    reference_velocity: float | None = None,
    until: float | None = None,
    all_particles: bool = False,
    report: Callable[[str], None] = lambda text: None,
) -> SceneComparison:
    """Run the scene with each contact model and write tables, figures, PVD files and the page into `out`.

    `laws`: names of contact models. `reference_velocity` [m/s]: impact velocity for the constant linear spring, by
    default a tenth of the largest impact velocity. `until` [s] ends each run early. Unless `all_particles`, scenes with
    more than MOST_PARTICLES particles are reduced. `report` receives progress messages.

    Raises GranflowError if no contact model can run the scene.
    """
    velocity = reference_velocity or reference_velocity_of(scene)
    most = None if all_particles else MOST_PARTICLES
    variants = variants_of(scene, laws, velocity, most)
    out.mkdir(parents=True, exist_ok=True)
    runs, refused = run_all(variants, [out / each.key for each in variants], arch, velocity, until, report)
    subject = subject_of(scene, velocity)
    sweeps: list[LawSweep] = []
    if subject is not None:
        report("collisions over three decades of velocity")
        backend = start(arch, scene.run.precision)  # type: ignore[arg-type]
        sweeps = sweeps_of(scene, subject, [each for each in variants if each.scene is not None], backend)
    columns = sweep_columns(subject, sweeps) if subject is not None else {}
    found = SceneComparison(
        scene, velocity, reduced_counts(scene, most), until, runs, refused, subject, sweeps, columns
    )  # fmt: skip
    write_all(found, out, report)
    return found


def write_all(found: SceneComparison, out: Path, report: Callable[[str], None] = lambda text: None) -> None:
    """Write all files except the output of the runs; without matplotlib the page has no figures."""
    _write_tables(found, out)
    write_script(out, found.scene, found.runs, max(run.typical_speed for run in found.runs) or 1.0)
    try:
        figures = draw_all(out, found.runs, found.subject, found.collisions)
        missing = ""
    except GranflowError as error:
        figures, missing = [], str(error)
        report(f"no figures: {missing}")
    write_page(_page(found, out, figures, missing), out / PAGE)


def _write_tables(found: SceneComparison, out: Path) -> None:
    """Write compare.csv, heights.csv, forces.csv, durations.csv and collisions.csv.

    All in SI units; collisions.csv only if collisions were simulated.
    """
    runs = found.runs
    write_columns(out / "compare.csv", summary_columns(runs, found.rows))
    write_columns(out / "heights.csv", {
        "law": np.concatenate([np.repeat(run.variant.key, len(run.heights)) for run in runs]),
        **{name: np.concatenate([run.heights[:, column] for run in runs])
           for column, name in enumerate(("time", "height_of_center", "height_of_surface"))},
    })  # fmt: skip
    write_columns(out / "forces.csv", _force_columns(runs))
    survival = [run.duration_survival for run in runs]
    write_columns(out / "durations.csv", {
        "law": np.concatenate([np.repeat(r.variant.key, len(t)) for r, (t, _) in zip(runs, survival, strict=True)]),
        "time_in_contact": np.concatenate([times for times, _ in survival]),
        "share_lasting_longer": np.concatenate([share for _, share in survival]),
    })  # fmt: skip
    if found.collisions:
        write_columns(out / "collisions.csv", found.collisions)


def _force_columns(runs: Sequence[VariantRun]) -> dict[str, np.ndarray]:
    """Columns of forces.csv: one row per contact model, stage and bin.

    Forces are relative to the mean of their frame; the open last bin is omitted.
    """
    parts: list[tuple[np.ndarray, ...]] = []
    low, high = FORCE_EDGES[:-2], FORCE_EDGES[1:-1]
    for run in runs:
        for stage in run.forces.counts:
            density, count = run.forces.density(stage), run.forces.counts[stage][:-1]
            text = (np.repeat(run.variant.key, len(low)), np.repeat(stage, len(low)))
            parts.append((*text, low, high, density, count))
    names = ("law", "stage", "force_over_mean_from", "force_over_mean_to", "density", "contact_count")
    empty = tuple(np.empty(0) for _ in names)
    return {name: np.concatenate([part[n] for part in parts or [empty]]) for n, name in enumerate(names)}


def _page(found: SceneComparison, out: Path, figures: Sequence[str], missing: str) -> Page:
    """HTML page of the comparison; `missing` replaces the figures without matplotlib."""
    names = [run.variant.title for run in found.runs]
    lead = (
        f"The scene {found.scene.path.name or found.scene.title} with the same seed and initial state, run with "
        f"{', '.join(names[:-1]) + ' and ' if names[1:] else ''}{names[-1]}. "
        f"Only contact.normal, the time step and the form of the restitution differ."
    )
    sections = [
        _result_section(found), _course_section(found, out, figures, missing), _contact_section(found, out, figures),
        _spring_section(found, out, figures), _paraview_section(found), _method_section(found),
    ]  # fmt: skip
    return Page(f"{found.scene.title}: contact models side by side", lead, sections)


def _picture(out: Path, name: str, figures: Sequence[str], caption: str, linked_files: tuple[str, ...]) -> list[Any]:
    """The figure `name` if it was drawn, with links to the files `linked_files`; otherwise an empty list."""
    return [Picture(out / f"{name}.png", caption, (f"{name}.png", *linked_files))] if name in figures else []


def size_note(found: SceneComparison) -> str:
    """Sentence on the particle counts and the end time of the runs."""
    text = "The runs include all particles."
    if found.reduced:
        counts = ", ".join(
            f"{count} of {found.scene.particles[name].count} {name}" for name, count in found.reduced.items()
        )
        text = f"For a short run time the scene is reduced to {counts}; --full runs all particles."
    return text + (f" Every run ends at {found.until:g} s." if found.until is not None else "")


def stage_note(found: SceneComparison) -> str:
    """Sentence on the stage of the starred rows."""
    return (
        f"* at the end of the stage {densest_stage(found.runs)}, which has the most contacts; forces: all frames of it."
    )


def stop_notes(found: SceneComparison) -> list[str]:
    """Sentences on aborted runs and on contact models that cannot run the scene."""
    text = [
        f"{run.variant.title} was aborted at {run.time:.6g} s: {run.stopped.removeprefix('Stopped: ')}"
        for run in found.runs
        if run.stopped
    ]
    return text + [f"{title} cannot run this scene: {why}" for title, why in found.refused.items()]


def _result_section(found: SceneComparison) -> Section:
    """Section with the summary table."""
    first = found.runs[0].variant.title
    caption = (
        f"Ratios are relative to {first}. {stage_note(found)} Heights of the center of mass and of the surface "
        f"({SURFACE_PERCENTILE:g} % of all particle tops lie below it) are relative to the origin, against gravity. "
        "<f> is the mean normal force of a frame."
    )
    return Section("Side by side", [
        size_note(found), *stop_notes(found), PageTable(caption, heads(found.runs), as_text(found.rows)),
        "Numbers: compare.csv. Each run has a separate directory with timeseries.csv, result.json, run.log, the "
        "resolved scene and the PVD files.",
    ])  # fmt: skip


def _course_section(found: SceneComparison, out: Path, figures: Sequence[str], missing: str) -> Section:
    """Section with time series and energies."""
    course = (
        "Time series of the runs: flow (kinetic energy without a flow meter), height of the center of mass and of the "
        f"surface ({SURFACE_PERCENTILE:g} % of all particle tops lie below it, including particles in free fall), "
        "coordination number, mean overlap."
    )
    energies = "Stored and dissipated energies. The contact models dissipate by plastic unloading or by damping."
    pictures = [
        *_picture(out, "course", figures, course, ("heights.csv",)), *_picture(out, "energies", figures, energies, ()),
    ]  # fmt: skip
    return Section("Flow, height, energies", pictures or [missing])


def _contact_section(found: SceneComparison, out: Path, figures: Sequence[str]) -> Section:
    """Section with force distribution and contact durations."""
    spacing = 1e6 * hertz_duration(found.scene, found.reference_velocity) / SAMPLES_PER_CONTACT
    method = (
        f"Durations: {BURSTS} bursts, evenly spaced over the run, each sample all contacts with a nonzero force "
        f"{SAMPLES} times at intervals of {spacing:.3g} µs, an eighth of an elastic collision at the reference "
        f"velocity. Contacts that begin within a burst count; those that persist at its end, after "
        f"{readable(spacing * (SAMPLES - 1))} µs, are censored (Kaplan and Meier 1958). A contact shorter than the "
        "sampling interval can be missed; the interval is also the resolution of the durations."
    )
    counted = [
        f"{run.variant.title}: {len(run.followed.arrays()[0])} contacts began, {int(run.followed.arrays()[1].sum())} "
        "of them ended within a burst"
        for run in found.runs
    ]
    caption = (
        "Left: distribution of normal forces between particles over their mean in the same frame, all frames of the "
        f"stage {densest_stage(found.runs)}. Right: share of new contacts that last longer than a time."
    )
    picture = _picture(out, "contacts", figures, caption, ("forces.csv", "durations.csv"))
    return Section("Forces and durations of contacts", [*picture, method, "; ".join(counted) + "."])


def _spring_section(found: SceneComparison, out: Path, figures: Sequence[str]) -> Section:
    """Section with the assessment of the linear springs."""
    assessed = [(each.part, each.conclusion, each.why) for each in found.assessments]
    tables = [PageTable("Assessment.", ("statement", "conclusion", "numbers"), assessed)] if assessed else []
    if found.subject is None:
        return Section("Is one spring constant sufficient?", tables)
    subject = found.subject
    caption = (
        f"Head-on collisions of two particles of {1e3 * subject.diameter:.3g} mm ({subject.pair_key}), relative to "
        f"Zhou's exact duration (Eq. 13), Hertz's maximum overlap (Eq. 5) and the target restitution: (a) to (c) with "
        f"{FINE_STEPS} steps in the shortest collision, (d) with {COARSE_STEPS} steps in an elastic collision at the "
        f"reference velocity of {subject.reference_velocity:.3g} m/s (dotted). Below {floor_velocity(subject):.3g} m/s "
        "(dotted, fainter) Eq. 19 per contact uses the spring of that velocity, as in the scene."
    )
    refused = [
        f"{sweep.variant.title}, {step} time step, rejected: {why}"
        for sweep in found.sweeps
        for step, why in sweep.refused.items()
    ]
    return Section(
        "Is one spring constant sufficient?",
        [*tables, *_picture(out, "collisions", figures, caption, ("collisions.csv",)), *refused],
    )


def _paraview_section(found: SceneComparison) -> Section:
    """Section on the ParaView script."""
    names = ", ".join(f"{run.variant.key}/particles.pvd" for run in found.runs)
    return Section("Side by side in ParaView", [
        f"{SCRIPT} shows all runs side by side, colored by speed: in ParaView with File > Load State, or as an "
        f"image with pvpython {SCRIPT} picture.png. Individual runs: {names}.",
    ])  # fmt: skip


def _method_section(found: SceneComparison) -> Section:
    """Section on restitution, time steps and timings."""
    steps = "; ".join(
        f"{run.variant.title} {run.plan.time_step:.3g} s ({run.plan.step.limited_by})" for run in found.runs
    )
    given = "" if found.scene.run.time_step == "auto" else " The time step of the scene is ignored."
    return Section("Method", [
        f"The spring from one velocity is that of Eq. 19 at {found.reference_velocity:.3g} m/s. If the scene defines "
        "the restitution by Eq. 12 and a contact model requires a number, it is the value of Eq. 12 at that velocity.",
        f"Every contact model runs with its automatic time step, from the same settings: {steps}.{given}",
        "All runs compute the energy budget, at the same relative cost. They run one after the other in one process, "
        "on the same threads; wall time covers neighbor-list rebuilds and steps, without compilation "
        "and output. Inserted particles use the same random numbers in all runs; if a sampled position is occupied, "
        "another one is sampled, so that different beds can fill differently.",
    ])  # fmt: skip
