"""`granflow compare`: runs, collisions, output files and the page of the comparison."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from granflow import Scene
from granflow.studies.compare.bed_statistics import FORCE_EDGES, MIN_CONTACTS, SURFACE_PERCENTILE
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
from granflow.studies.compare.drawing import drawings, has_forces
from granflow.studies.compare.paraview import SCRIPT, write_script
from granflow.studies.compare.runs import BURSTS, SAMPLES, SAMPLES_PER_CONTACT, VariantRun, hertz_duration, run_all
from granflow.studies.compare.soft_spring import soft_spring_note
from granflow.studies.compare.spring_assessment import Assessment, assess
from granflow.studies.compare.summary import SummaryRow, as_text, densest_stage, heads, summary, summary_columns
from granflow.studies.compare.variants import reduced_counts, reference_velocity_of, variants_of
from granflow.studies.page import write_study
from granflow.studies.tables import PageTable, stacked

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
    prepare: Callable[[Path], None] = lambda directory: None,
    repeat: bool = False,
) -> SceneComparison:
    """Run the scene with each contact model and write tables, figures, PVD files and the page into `out`.

    `laws`: names of contact models. `reference_velocity` [m/s]: impact velocity for the constant linear spring, by
    default a tenth of the largest impact velocity. `until` [s] ends each run early. Unless `all_particles`, scenes with
    more than MOST_PARTICLES particles are reduced. `report` receives progress messages. Runs of an earlier call with
    the same arguments in `out` are kept, unless `repeat`; `prepare`: called with the directory of each other run.

    Raises GranflowError if no contact model can run the scene.
    """
    velocity = reference_velocity or reference_velocity_of(scene)
    most = None if all_particles else MOST_PARTICLES
    variants = variants_of(scene, laws, velocity, most)
    out.mkdir(parents=True, exist_ok=True)
    runs, refused = run_all(
        variants, [out / each.key for each in variants], arch, velocity, until, report, prepare, repeat
    )
    subject = subject_of(scene, velocity)
    sweeps: list[LawSweep] = []
    if subject is not None:
        report("collisions over three decades of velocity")
        sweeps = sweeps_of(scene, subject, [each for each in variants if each.scene is not None], arch)
    columns = sweep_columns(subject, sweeps) if subject is not None else {}
    found = SceneComparison(
        scene, velocity, reduced_counts(scene, most), until, runs, refused, subject, sweeps, columns
    )  # fmt: skip
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
        surface_percentile=SURFACE_PERCENTILE,
        bursts=BURSTS,
        samples=SAMPLES,
        spacing=1e6 * hertz_duration(found.scene, found.reference_velocity) / SAMPLES_PER_CONTACT,
        assessments=PageTable(("statement", "conclusion", "numbers"), assessed, "Assessment."),
        floor=floor_velocity(found.subject) if found.subject else None,
        fine_steps=FINE_STEPS,
        coarse_steps=COARSE_STEPS,
        script=SCRIPT,
    )
    if missing:
        report(f"no figures: {missing}")


def _tables(found: SceneComparison) -> dict[str, dict[str, np.ndarray]]:
    """Columns of compare.csv, heights.csv, forces.csv, durations.csv and collisions.csv.

    All in SI units; forces are relative to the mean of their frame. collisions.csv only if collisions were simulated.
    """
    keyed = [(run.variant.key, run) for run in found.runs]
    forces = ("force_over_mean_from", "force_over_mean_to", "density", "contact_count")
    bins = (FORCE_EDGES[:-2], FORCE_EDGES[1:-1])  # without the open last bin
    tables = {
        "compare.csv": summary_columns(found.runs, found.rows),
        "heights.csv": stacked(
            ("law", "time", "height_of_center", "height_of_surface"), [(key, *run.heights.T) for key, run in keyed]
        ),
        "forces.csv": stacked(("law", "stage", *forces), [
            (key, stage, *bins, run.forces.density(stage), count[:-1])
            for key, run in keyed for stage, count in run.forces.counts.items()
        ]),
        "durations.csv": stacked(
            ("law", "time_in_contact", "share_lasting_longer"), [(key, *run.duration_survival) for key, run in keyed]
        ),
    }  # fmt: skip
    return tables | ({"collisions.csv": found.collisions} if found.collisions else {})


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
