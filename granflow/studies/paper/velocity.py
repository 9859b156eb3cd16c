"""Figs. 3 and 4 and Eq. 19: restitution, duration and equivalent spring against approach velocity.

alpha = (4/5) k sqrt(dmax)      (Zhou 2011, Eq. 19)
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from granflow.studies.figures import COLORS, MARKERS, POINTS, stacked_panels
from granflow.studies.head_on import Outcomes, collide_all
from granflow.studies.paper.cases import PAPER_CASES, STEPS_PER_CONTACT, PaperCase, small_soft_case
from granflow.studies.paper.figure_data import FigureData, FigureDeviation, relative_deviation
from granflow.studies.paper.residual import TARGET_DURATION, TARGET_RESTITUTION
from granflow.studies.paper.thornton import thornton_restitution
from granflow.studies.tables import percent

VELOCITIES = np.geomspace(0.01, 100.0, 33)
"""Approach velocities of the simulated collisions of Figs. 3 and 4 [m/s]."""

ESTIMATE_VELOCITIES = np.geomspace(1.0, 10.0, 9)
"""Approach velocities of the estimate below Eq. 19 [m/s]."""

Columns = Mapping[str, np.ndarray]
"""Columns of a CSV file by name, of equal length."""


def velocity_run(velocities: np.ndarray = VELOCITIES) -> Outcomes:
    """Simulate both materials at all velocities (n,) [m/s] in one scene; the shortest collision takes 200 steps."""
    pairs = [case.head_on({"preset": case.name}, float(v)) for case in PAPER_CASES for v in velocities]
    return collide_all("zhou", pairs, _shortest(PAPER_CASES, velocities) / STEPS_PER_CONTACT)


def _shortest(cases: Sequence[PaperCase], velocities: np.ndarray) -> float:
    """Shortest collision duration [s] of all cases and velocities."""
    return min(float(case.durations(restitution_of(case, velocities), velocities).min()) for case in cases)


def restitution_of(case: PaperCase, velocity: np.ndarray) -> np.ndarray:
    """Given restitution (Zhou 2011, Eq. 12) at velocities [m/s] of any shape.

    Raises ValueError for a case without Eq. 12.
    """
    if case.fit is None:
        raise ValueError(f"{case.name} has no restitution that depends on velocity")
    return case.fit(velocity)


def velocity_columns(outcomes: Outcomes, velocities: np.ndarray = VELOCITIES) -> dict[str, np.ndarray]:
    """Theory and simulation by material and velocity, for Figs. 3 and 4 and the figure of Eq. 19.

    Columns (materials * n,) in SI units; theory: Zhou (2011), Eqs. 12, 13 and 19, and Thornton (1997).
    """
    e = [restitution_of(case, velocities) for case in PAPER_CASES]
    yields = [thornton_restitution(velocities, case.yield_velocity or np.inf) for case in PAPER_CASES]
    durations = np.concatenate([case.durations(a, velocities) for case, a in zip(PAPER_CASES, e, strict=True)])
    return {
        "material": np.repeat([case.name for case in PAPER_CASES], len(velocities)),
        "velocity": np.tile(velocities, len(PAPER_CASES)),
        "restitution_theory": np.concatenate(e),
        "restitution_simulated": outcomes.restitution,
        "restitution_thornton": np.concatenate(yields),
        "duration_theory": durations,
        "duration_simulated": outcomes.duration,
        "spring_theory": np.concatenate([case.springs(velocities) for case in PAPER_CASES]),
        "spring_simulated": spring_of(outcomes),
        "steps_per_contact": durations / outcomes.time_step,
    }


def spring_of(outcomes: Outcomes) -> np.ndarray:
    """Stiffness [N/m] of the spring with the same work W at the maximum overlap: 2 W / dmax^2 (Eq. 18)."""
    return 2.0 * outcomes.stored_energy / outcomes.overlap_max**2


def _chosen(columns: Columns, *names: str) -> dict[str, np.ndarray]:
    return {name: columns[name] for name in ("material", "velocity", *names)}


def _compared(columns: Columns, quantity: str, text: str, target: float | None = None) -> FigureDeviation:
    def where(index: int) -> str:
        case = next(case for case in PAPER_CASES if case.name == columns["material"][index])
        return f"{columns['velocity'][index]:.3g} m/s ({case.title})"

    return relative_deviation(
        text, columns[f"{quantity}_simulated"], columns[f"{quantity}_theory"], where, target
    )  # fmt: skip


def _steps(columns: Columns) -> str:
    steps = columns["steps_per_contact"]
    return f"All collisions have the same time step: {steps.min():.0f} to {steps.max():.0f} steps per contact"


def restitution_figure(columns: Columns) -> FigureData:
    """Fig. 3: given and simulated e(v), and Thornton's model."""
    caption = (
        "Restitution coefficient against approach velocity of spheres of 25.4 mm: Eq. 12 (line), simulated collisions "
        "(points), and Thornton's prediction (1997) with the yield velocities 0.0082 and 0.9090 m/s (dashed). "
        f"{_steps(columns)}. Measured points are omitted, because their values are not available."
    )
    names = ("restitution_theory", "restitution_simulated", "restitution_thornton", "steps_per_contact")
    deviation = _compared(columns, "restitution", "simulated e from Eq. 12", TARGET_RESTITUTION)
    title = "Fig. 3: restitution coefficient against velocity"
    return FigureData(
        "figure3_restitution", title, caption, _chosen(columns, *names), (deviation,), draw_restitution, 5.2
    )


def draw_restitution(figure: Any, columns: Columns) -> None:
    """Draw one panel per material."""
    panels = stacked_panels(figure, len(PAPER_CASES), sharex=True, sharey=True)
    for letter, case, axes in zip("abcd", PAPER_CASES, panels, strict=False):
        mine = columns["material"] == case.name
        v = columns["velocity"][mine]
        fine = np.geomspace(v.min(), v.max(), 400)
        axes.plot(fine, restitution_of(case, fine), color=COLORS[0], label="Eq. 12")
        thornton = thornton_restitution(fine, case.yield_velocity or np.inf)
        axes.plot(fine, thornton, "--", color=COLORS[1], label="Thornton (1997)")
        axes.plot(v, columns["restitution_simulated"][mine], "o", color=COLORS[6], label="simulated", **POINTS)
        axes.set(xscale="log", ylim=(0, 1.04), title=f"({letter}) {case.title}")
        axes.set_ylabel("restitution coefficient $e$")
    panels[-1].set_xlabel("approach velocity (m/s)")
    panels[0].legend(loc="lower left")


def duration_figure(columns: Columns) -> FigureData:
    """Fig. 4: T(v)."""
    caption = (
        "Collision duration against approach velocity of spheres of 25.4 mm: Eqs. 13-16 (lines), simulated collisions "
        f"(points), and elastic Hertz contacts (dotted). {_steps(columns)}."
    )
    names = ("duration_theory", "duration_simulated", "steps_per_contact")
    deviation = _compared(columns, "duration", "the duration T from Eq. 13", TARGET_DURATION)
    title = "Fig. 4: collision duration against velocity"
    return FigureData("figure4_duration", title, caption, _chosen(columns, *names), (deviation,), draw_duration, 3.4)


def draw_duration(figure: Any, columns: Columns) -> None:
    """Draw both materials in one panel."""
    axes = figure.subplots()
    for case, color, marker in zip(PAPER_CASES, COLORS, MARKERS, strict=False):
        mine = columns["material"] == case.name
        v = columns["velocity"][mine]
        fine = np.geomspace(v.min(), v.max(), 200)
        axes.plot(fine, 1e6 * case.durations(restitution_of(case, fine), fine), color=color)
        axes.plot(fine, 1e6 * case.durations(np.ones_like(fine), fine), ":", color=color, linewidth=0.9)
        axes.plot(v, 1e6 * columns["duration_simulated"][mine], marker, color=color, label=case.title, **POINTS)
    axes.plot([], [], color="0.3", label="Eqs. 13$-$16")
    axes.plot([], [], ":", color="0.3", linewidth=0.9, label="elastic Hertz contact")
    axes.set(xscale="log", yscale="log", xlabel="approach velocity (m/s)", ylabel=r"collision duration $T$ (µs)")
    axes.set_yticks([20, 50, 100, 200], ["20", "50", "100", "200"])
    axes.set_yticks([30, 40, 60, 70, 80, 90], [], minor=True)
    axes.legend(loc="lower left")


def estimate_run(velocities: np.ndarray = ESTIMATE_VELOCITIES) -> Outcomes:
    """Simulate the small soft spheres of the estimate below Eq. 19 at velocities (n,) [m/s].

    The restitution, 0.9, has no effect up to the maximum overlap.
    """
    case, e = small_soft_case(), 0.9
    pairs = [case.head_on(e, float(v)) for v in velocities]
    shortest = case.duration(e, float(velocities.max()))
    return collide_all("zhou", pairs, shortest / STEPS_PER_CONTACT)


def spring_figure(columns: Columns, estimate: Outcomes) -> FigureData:
    """Eq. 19: equivalent spring of both materials and of the estimate in the paper.

    `columns`: from `velocity_columns`; `estimate`: from `estimate_run`.
    """
    case = small_soft_case()
    springs, count = case.springs(ESTIMATE_VELOCITIES), len(ESTIMATE_VELOCITIES)
    combined = {
        "material": np.concatenate([columns["material"], np.repeat(case.name, count)]),
        "velocity": np.concatenate([columns["velocity"], ESTIMATE_VELOCITIES]),
        "spring_theory": np.concatenate([columns["spring_theory"], springs]),
        "spring_simulated": np.concatenate([columns["spring_simulated"], spring_of(estimate)]),
    }
    first, second = (each.springs(np.ones(1))[0] for each in PAPER_CASES)
    caption = (
        "Stiffness of the linear spring with the energy of the Hertz contact at the same maximum overlap: Eq. 19 "
        "(lines), and twice the work done on the simulated contact over the square of its maximum overlap (points). "
        f"(a) The two steels, which differ by only {percent(abs(second / first - 1.0))}. (b) The estimate of the paper "
        "for R = 1e-4 m, E = 1e8 Pa, 1e3 kg/m³, for two equal spheres with a Poisson ratio of 0.3: "
        f"{springs[0]:.0f} to {springs[-1]:.0f} N/m, of the order of the 1e3 N/m in the paper (dashed)."
    )
    deviations = (
        _compared(columns, "spring", "the spring of the steels from Eq. 19"),
        relative_deviation(
            "the spring of the estimate",
            spring_of(estimate),
            springs,
            lambda index: f"{ESTIMATE_VELOCITIES[index]:.3g} m/s",
        ),
    )
    return FigureData("equation19_spring", "Eq. 19: equivalent spring", caption, combined, deviations, draw_spring, 5.2)


def draw_spring(figure: Any, columns: Columns) -> None:
    """Draw one panel of the steels and one of the estimate."""
    above, below = stacked_panels(figure, 2)
    for case, color, marker in zip((*PAPER_CASES, small_soft_case()), COLORS, MARKERS, strict=False):
        axes = above if case in PAPER_CASES else below
        mine = columns["material"] == case.name
        v = columns["velocity"][mine]
        fine = np.geomspace(v.min(), v.max(), 100)
        axes.plot(fine, case.springs(fine), color=color)
        size = POINTS | {"markersize": 6.5 if marker == "o" else 3.5}  # the two steels coincide
        axes.plot(v, columns["spring_simulated"][mine], marker, color=color, label=case.title, **size)
    below.axhline(1e3, linestyle="--", color="0.5", linewidth=0.8)
    below.set_ylim(1e2, 1e4)
    for axes, title in ((above, "(a) spheres of 25.4 mm"), (below, "(b) estimate of the paper")):
        axes.set(xscale="log", yscale="log", xlabel="approach velocity (m/s)", title=title)
        axes.set_ylabel(r"equivalent spring $\alpha$ (N/m)")
        axes.legend(loc="upper left")
