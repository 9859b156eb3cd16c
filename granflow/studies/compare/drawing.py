"""Figures of a comparison."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from granflow.studies.compare.bed_statistics import FORCE_EDGES
from granflow.studies.compare.collisions import CollisionSubject, floor_velocity
from granflow.studies.compare.runs import VariantRun
from granflow.studies.compare.summary import densest_stage
from granflow.studies.figures import COLORS, MARKERS, Drawing, stacked_panels

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
        "contacts.png": Drawing(lambda figure: draw_contacts(figure, runs), 0.6 + 2.4 * (1 + has_forces(runs))),
    }
    if subject is not None and collisions:
        figures["collisions.png"] = Drawing(lambda figure: draw_collisions(figure, subject, collisions, runs), 8.0)
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
        style, columns = _style(number), run.columns
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
    """Draw the distribution of normal forces and the survival function of the contact duration, if there are any.

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
    """Draw duration, maximum overlap and restitution over the exact values, with the fine and the reference step.

    `columns`: of collisions.csv. Dotted: reference velocity, and the lower velocity limit of Eq. 19 per contact.
    """
    panels = stacked_panels(figure, 4, sharex=True)
    shown = (("duration", "fine"), ("overlap_max", "fine"), ("restitution", "fine"), ("restitution", "coarse"))
    titles = {run.variant.key: run.variant.title for run in runs}
    for number, law in enumerate(dict.fromkeys(columns["law"].tolist())):
        style = _style(number) | {"marker": MARKERS[number % len(MARKERS)], "markersize": 3.5, "markerfacecolor": "w"}
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
