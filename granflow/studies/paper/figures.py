"""The figures of Zhou (2011) from simulated collisions: data, deviations from the theory, and drawings.

A `PaperCase` is two equal spheres of one material, with the closed forms of their collision. Each figure has
a run (`..._run`) on the collision bench, a function (`..._figure`) that compares its outcomes with the theory
and gives `FigureData`, and a drawing (`draw_...`). `granflow.studies.paper.report` writes them.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from granflow.contact import theory
from granflow.contact.material import Solid, VelocityRestitution, limit_velocity, modulus_eff
from granflow.geometry.sphere import sphere_mass
from granflow.scene.blocks.materials import PRESETS, Material
from granflow.studies.bench import HeadOnCollision, Outcomes, collide
from granflow.studies.figures import COLORS, MARKERS, POINTS, percent, stacked_panels

# ---------------------------------------------------------------- cases: two equal spheres of one material

DIAMETER = 25.4e-3
"""Diameter of the spheres in Figs. 3 and 4 [m] (Stevens & Hrenya 2005)."""
STEPS_PER_CONTACT = 200
"""Ratio of collision duration to time step for the reported deviations."""


@dataclass(frozen=True)
class PaperCase:
    """Two equal spheres of one solid.

    `material` as in a scene; `fit`: e(v) of Zhou (2011), Eq. 12; `yield_velocity` [m/s] for Thornton's e(v);
    `diameter` [m].
    """

    name: str
    title: str
    solid: Solid
    material: Mapping[str, Any]
    fit: VelocityRestitution | None = None
    yield_velocity: float | None = None
    diameter: float = DIAMETER

    @cached_property
    def modulus_eff(self) -> float:
        """Effective modulus of the pair [Pa]."""
        return modulus_eff(self.solid, self.solid)

    def mass_eff(self, diameter: float | None = None) -> float:
        """Effective mass [kg] of two equal spheres: half the mass of one."""
        return 0.5 * sphere_mass(0.5 * (diameter or self.diameter), self.solid.density)

    def stiffness(self, diameter: float | None = None) -> float:
        """Hertz stiffness k [N/m^1.5]; the effective radius is a quarter of the diameter."""
        return float(theory.hertz_stiffness(self.modulus_eff, 0.25 * (diameter or self.diameter)))

    def duration(self, e: float, velocity: float, diameter: float | None = None) -> float:
        """Collision duration [s] for a restitution `e`, an approach velocity [m/s] and a diameter [m] (Eq.
        13)."""
        return float(theory.duration(e, self.stiffness(diameter), self.mass_eff(diameter), velocity))

    def durations(self, e: np.ndarray, velocity: np.ndarray) -> np.ndarray:
        """Collision durations (n,) [s] at the diameter of the case, for restitutions (n,) and velocities (n,)
        [m/s]."""
        return np.array([self.duration(float(a), float(v)) for a, v in zip(e, velocity, strict=True)])

    def springs(self, velocity: np.ndarray) -> np.ndarray:
        """Stiffness (n,) [N/m] of the linear spring with the same energy at velocities (n,) [m/s] (Eq.
        19)."""
        return np.asarray(theory.equivalent_spring(self.stiffness(), self.mass_eff(), velocity))

    def diameter_lasting(self, duration: float, e: float, velocity: float) -> float:
        """Diameter [m] of spheres with the given collision duration [s], which is proportional to the
        diameter."""
        return self.diameter * duration / self.duration(e, velocity)

    def head_on(self, restitution: Any, velocity: float, diameter: float | None = None) -> HeadOnCollision:
        """Head-on collision of the case at a velocity [m/s]; `restitution` as in a scene."""
        return HeadOnCollision(self.material, restitution, diameter or self.diameter, velocity)


def paper_case(preset: str, title: str, yield_velocity: float) -> PaperCase:
    """Case with one of the materials of Figs. 3 and 4.

    `preset`: name of the material; the limit velocity of Eq. 12 is that of Eq. 11. `yield_velocity` [m/s].
    """
    known = PRESETS[preset]
    solid = Material.model_validate({"preset": preset})
    sigma, psi = known.restitution_fit or (0.0, 1.0)
    fit = VelocityRestitution(sigma, psi, limit_velocity(solid, solid))
    return PaperCase(preset, title, solid, {"preset": preset}, fit, yield_velocity)


PAPER_CASES = (
    paper_case("stainless_316", "stainless steel 316", 0.0082),
    paper_case("chrome_52100", "chrome steel 52100", 0.9090),
)
"""Yield velocities [m/s] of the paper, from Stevens & Hrenya (2005)."""


def small_soft_case() -> PaperCase:
    """Spheres of the estimate below Eq. 19: 1e-4 m, 1e8 Pa, 1e3 kg/m3; no Poisson ratio is given, 0.3 is
    chosen."""
    solid = Material(young_modulus=1e8, poisson_ratio=0.3, density=1e3)
    material = {"young_modulus": 1e8, "poisson_ratio": 0.3, "density": 1e3}
    return PaperCase("estimate", "R = 0.1 mm, E = 0.1 GPa", solid, material, diameter=2e-4)


def restitution_of(case: PaperCase, velocity: np.ndarray) -> np.ndarray:
    """Given restitution (Zhou 2011, Eq. 12) at velocities [m/s] of any shape.

    Raises ValueError for a case without Eq. 12.
    """
    if case.fit is None:
        raise ValueError(f"{case.name} has no restitution that depends on velocity")
    return case.fit(velocity)


# ---------------------------------------------------------------- data of a figure


@dataclass(frozen=True)
class FigureDeviation:
    """Largest relative deviation: `quantity` names simulated and reference value, `where` the point.

    `largest`, `target`: fractions, not percentages; `target` is None without one.
    """

    quantity: str
    largest: float
    where: str
    target: float | None = None
    remark: str = ""

    @property
    def is_within_target(self) -> bool:
        """Whether the deviation is within its target; True without a target."""
        return self.target is None or self.largest <= self.target

    def sentence(self) -> str:
        """Sentence with the deviation, its target and a remark."""
        target = ""
        if self.target is not None:
            target = (
                f" (target {percent(self.target)}, "
                f"{'satisfied' if self.is_within_target else 'not satisfied'})"
            )
        text = (
            f"Largest deviation of {self.quantity}: {percent(self.largest)} at {self.where}{target}. "
            f"{self.remark}"
        )
        return text.strip()


@dataclass(frozen=True)
class FigureData:
    """One figure: file name, title, caption, columns of its CSV file, deviations, and drawing function.

    `columns`: name -> array (rows,), all of the same length.
    """

    name: str
    title: str
    caption: str
    columns: Mapping[str, np.ndarray]
    deviations: tuple[FigureDeviation, ...]
    draw: Callable[[Any, Mapping[str, np.ndarray]], None]
    """Called with an empty matplotlib figure and the columns."""
    height: float
    """Height of the figure [inch]."""


def relative_deviation(
    quantity: str,
    simulated: np.ndarray,
    theory: np.ndarray,
    where: Callable[[int], str],
    target: float | None = None,
    remark: str = "",
) -> FigureDeviation:
    """Largest value of |simulated / theory - 1|; `where` describes the point of an index.

    `simulated`, `theory` (n,): values in the same unit.
    """
    shares = np.abs(np.asarray(simulated) / np.asarray(theory) - 1.0)
    worst = int(np.argmax(shares))
    return FigureDeviation(quantity, float(shares[worst]), where(worst), target, remark)


Columns = Mapping[str, np.ndarray]
"""Columns of a CSV file by name, of equal length."""


# ---------------------------------------------------------------- figures 1 and 2: residual overlap
#
#     x = 1 - y,      y = (4/5) e^2 + (1/5) e^3 y^2.5      (Zhou 2011, Eq. 8)

CASE = PAPER_CASES[0]
"""Material of the collisions; x(e) and T/Ts depend on the restitution only, not on the material."""
VELOCITY = 1.0
"""Approach velocity [m/s]."""
RESIDUAL_RESTITUTIONS = np.linspace(0.025, 1.0, 40)
"""Target restitutions of the simulated collisions."""
RESOLVED = 0.1
"""Smallest restitution for which unloading takes enough of the 200 steps for the target accuracy."""
TARGET_RESTITUTION, TARGET_DURATION = 1e-3, 5e-3
"""Targets of the relative deviations of restitution and duration."""


def residual_run(restitutions: np.ndarray = RESIDUAL_RESTITUTIONS) -> Outcomes:
    """Simulate one pair per restitution (n,), with a diameter such that each collision takes exactly 200
    steps.

    The duration is that of Zhou (2011), Eq. 13.
    """
    duration = CASE.duration(1.0, VELOCITY)
    pairs = [
        CASE.head_on(float(e), VELOCITY, CASE.diameter_lasting(duration, float(e), VELOCITY))
        for e in restitutions
    ]
    return collide(pairs, "zhou", duration / STEPS_PER_CONTACT)


def residual_figure(outcomes: Outcomes, e: np.ndarray = RESIDUAL_RESTITUTIONS) -> FigureData:
    """Fig. 1: x(e) from Eq. 8 (exact root), Eq. 9 and simulation, with the deviations of T and e.

    `e` (n,): restitutions of the outcomes.
    """
    exact = 1.0 - theory.recovery(e)
    simulated = outcomes.overlap_residual / outcomes.overlap_max
    whole = np.full_like(e, STEPS_PER_CONTACT * outcomes.time_step)
    plain = slice(None)
    clear = e >= RESOLVED - 1e-9

    def at(chosen: Any) -> Any:
        return lambda index: f"e = {e[chosen][index]:.3g}"

    deviations = (
        relative_deviation(
            "x from Eq. 8, relative to δmax", 1.0 + simulated - exact, np.ones_like(e), at(plain)
        ),
        relative_deviation("T from Eq. 13", outcomes.duration, whole, at(plain), TARGET_DURATION),
        relative_deviation(
            f"simulated from given e, for e from {RESOLVED:g} on",
            outcomes.restitution[clear],
            e[clear],
            at(clear),
            TARGET_RESTITUTION,
        ),
        relative_deviation(
            "simulated from given e, for all e",
            outcomes.restitution,
            e,
            at(plain),
            TARGET_RESTITUTION,
            _few_steps(),
        ),
    )
    columns = {
        "restitution": e,
        "residual_exact": exact,
        "residual_equation9": theory.residual_closed_form(e),
        "residual_simulated": simulated,
        "restitution_simulated": outcomes.restitution,
        "duration_over_ts_theory": np.array(
            [theory.LOADING_DURATION + theory.unloading_duration(float(a)) for a in e]
        ),
        "duration_simulated_over_theory": outcomes.duration / whole,
    }
    caption = (
        "Ratio of residual to maximum overlap, x = δ*/δmax, against the restitution coefficient: exact root "
        "of Eq. 8 (line), Eq. 9 of the paper (dashed), and simulated collisions of 200 time steps each "
        "(circles)."
    )
    return FigureData(
        "figure1_residual", "Fig. 1: residual overlap", caption, columns, deviations, draw_residual, 3.4
    )


def _few_steps() -> str:
    steps = [unloading_steps(e) for e in (RESOLVED, 0.5 * RESOLVED)]
    return (
        f"Below e = {RESOLVED:g} unloading takes fewer than {steps[0]:.0f} of the {STEPS_PER_CONTACT} steps "
        f"({steps[1]:.0f} at e = {0.5 * RESOLVED:g}), too few for this accuracy."
    )


def unloading_steps(e: float) -> float:
    """Number of unloading steps among the STEPS_PER_CONTACT of a collision."""
    unloading = theory.unloading_duration(e)
    return STEPS_PER_CONTACT * unloading / (theory.LOADING_DURATION + unloading)


def draw_residual(figure: Any, columns: Mapping[str, np.ndarray]) -> None:
    """Draw theory as lines and simulation as points."""
    e = np.linspace(0.0, 1.0, 401)
    axes = figure.subplots()
    axes.plot(e, 1.0 - theory.recovery(e), color=COLORS[0], label="exact (Eq. 8)")
    axes.plot(e, theory.residual_closed_form(e), "--", color=COLORS[1], label="closed form (Eq. 9)")
    axes.plot(
        columns["restitution"],
        columns["residual_simulated"],
        "o",
        color=COLORS[6],
        label="simulated",
        **POINTS,
    )
    axes.set(
        xlabel="restitution coefficient $e$", ylabel=r"residual overlap $x = \delta^{*}\!/\delta_{\max}$"
    )
    axes.set(xlim=(0, 1.01), ylim=(-0.01, 1.02))
    axes.legend(loc="lower left")


def error_figure(e: np.ndarray | None = None) -> FigureData:
    """Fig. 2: relative error of Eq. 9 with respect to the exact root of Eq. 8, without simulation."""
    e = np.linspace(0.0, 0.9999, 1000) if e is None else e
    exact = 1.0 - theory.recovery(e)
    closed_form = theory.residual_closed_form(e)
    worst = relative_deviation(
        "x by Eq. 9 from the exact root", closed_form, exact, lambda index: f"e = {e[index]:.4g}"
    )
    columns = {"restitution": e, "error": closed_form / exact - 1.0}
    caption = (
        "Relative error of the closed form of the paper, Eq. 9, with respect to the exact root of Eq. 8."
    )
    return FigureData(
        "figure2_error", "Fig. 2: error of the closed form", caption, columns, (worst,), draw_error, 2.8
    )


def draw_error(figure: Any, columns: Mapping[str, np.ndarray]) -> None:
    """Draw the error and a zero line."""
    axes = figure.subplots()
    axes.axhline(0.0, color="0.6", linewidth=0.6)
    axes.plot(columns["restitution"], 100.0 * columns["error"], color=COLORS[1])
    axes.set(xlabel="restitution coefficient $e$", ylabel="error of $x$ by Eq. 9 (%)", xlim=(0, 1))


# ---------------------------------------------------------------- figures 3 and 4: velocity

VELOCITIES = np.geomspace(0.01, 100.0, 33)
"""Approach velocities of the simulated collisions of Figs. 3 and 4 [m/s]."""


def velocity_run(velocities: np.ndarray = VELOCITIES) -> Outcomes:
    """Simulate both materials at all velocities (n,) [m/s] in one scene; the shortest collision takes 200
    steps."""
    pairs = [case.head_on({"preset": case.name}, float(v)) for case in PAPER_CASES for v in velocities]
    return collide(pairs, "zhou", _shortest(PAPER_CASES, velocities) / STEPS_PER_CONTACT)


def _shortest(cases: Sequence[PaperCase], velocities: np.ndarray) -> float:
    """Shortest collision duration [s] of all cases and velocities."""
    return min(float(case.durations(restitution_of(case, velocities), velocities).min()) for case in cases)


def velocity_columns(outcomes: Outcomes, velocities: np.ndarray = VELOCITIES) -> dict[str, np.ndarray]:
    """Theory and simulation by material and velocity, for Figs. 3 and 4 and the figure of Eq. 19.

    Columns (materials * n,) in SI units; theory: Zhou (2011), Eqs. 12, 13 and 19, and Thornton (1997).
    """
    e = [restitution_of(case, velocities) for case in PAPER_CASES]
    yields = [thornton_restitution(velocities, case.yield_velocity or np.inf) for case in PAPER_CASES]
    durations = np.concatenate(
        [case.durations(a, velocities) for case, a in zip(PAPER_CASES, e, strict=True)]
    )
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


def thornton_restitution(velocity: np.ndarray, yield_velocity: float) -> np.ndarray:
    """Restitution of Thornton's elastic, perfectly plastic sphere at approach velocities [m/s].

    r is the yield velocity over the velocity; the restitution is 1 up to the yield velocity.

        e^2 = (6 sqrt(3) / 5) (1 - r^2 / 6) sqrt(r / (r + 2 sqrt(6/5 - r^2 / 5)))     (Thornton 1997)

    Source: C. Thornton, J. Appl. Mech. 64, 383 (1997), doi 10.1115/1.2787319.
    """
    r = np.minimum(yield_velocity / np.asarray(velocity, dtype=float), 1.0)
    flattening = np.sqrt(r / (r + 2.0 * np.sqrt(6.0 / 5.0 - r**2 / 5.0)))
    return np.sqrt(6.0 * math.sqrt(3.0) / 5.0 * (1.0 - r**2 / 6.0) * flattening)


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
    )


def _steps(columns: Columns) -> str:
    steps = columns["steps_per_contact"]
    return f"All collisions have the same time step: {steps.min():.0f} to {steps.max():.0f} steps per contact"


def restitution_figure(columns: Columns) -> FigureData:
    """Fig. 3: given and simulated e(v), and Thornton's model."""
    caption = (
        "Restitution coefficient against approach velocity of spheres of 25.4 mm: Eq. 12 (line), simulated "
        "collisions (points), and Thornton's prediction (1997) with the yield velocities 0.0082 and 0.9090 "
        f"m/s (dashed). {_steps(columns)}. Measured points are omitted, because their values are not "
        "available."
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
        axes.plot(
            v, columns["restitution_simulated"][mine], "o", color=COLORS[6], label="simulated", **POINTS
        )
        axes.set(xscale="log", ylim=(0, 1.04), title=f"({letter}) {case.title}")
        axes.set_ylabel("restitution coefficient $e$")
    panels[-1].set_xlabel("approach velocity (m/s)")
    panels[0].legend(loc="lower left")


def duration_figure(columns: Columns) -> FigureData:
    """Fig. 4: T(v)."""
    caption = (
        "Collision duration against approach velocity of spheres of 25.4 mm: Eqs. 13-16 (lines), simulated "
        f"collisions (points), and elastic Hertz contacts (dotted). {_steps(columns)}."
    )
    names = ("duration_theory", "duration_simulated", "steps_per_contact")
    deviation = _compared(columns, "duration", "the duration T from Eq. 13", TARGET_DURATION)
    title = "Fig. 4: collision duration against velocity"
    return FigureData(
        "figure4_duration", title, caption, _chosen(columns, *names), (deviation,), draw_duration, 3.4
    )


def draw_duration(figure: Any, columns: Columns) -> None:
    """Draw both materials in one panel."""
    axes = figure.subplots()
    for case, color, marker in zip(PAPER_CASES, COLORS, MARKERS, strict=False):
        mine = columns["material"] == case.name
        v = columns["velocity"][mine]
        fine = np.geomspace(v.min(), v.max(), 200)
        axes.plot(fine, 1e6 * case.durations(restitution_of(case, fine), fine), color=color)
        axes.plot(fine, 1e6 * case.durations(np.ones_like(fine), fine), ":", color=color, linewidth=0.9)
        axes.plot(
            v, 1e6 * columns["duration_simulated"][mine], marker, color=color, label=case.title, **POINTS
        )
    axes.plot([], [], color="0.3", label="Eqs. 13$-$16")
    axes.plot([], [], ":", color="0.3", linewidth=0.9, label="elastic Hertz contact")
    axes.set(
        xscale="log", yscale="log", xlabel="approach velocity (m/s)", ylabel=r"collision duration $T$ (µs)"
    )
    axes.set_yticks([20, 50, 100, 200], ["20", "50", "100", "200"])
    axes.set_yticks([30, 40, 60, 70, 80, 90], [], minor=True)
    axes.legend(loc="lower left")


# ---------------------------------------------------------------- equation 19: equivalent spring
#
#     alpha = (4/5) k sqrt(dmax)      (Zhou 2011, Eq. 19)

ESTIMATE_VELOCITIES = np.geomspace(1.0, 10.0, 9)
"""Approach velocities of the estimate below Eq. 19 [m/s]."""


def estimate_run(velocities: np.ndarray = ESTIMATE_VELOCITIES) -> Outcomes:
    """Simulate the small soft spheres of the estimate below Eq. 19 at velocities (n,) [m/s].

    The restitution, 0.9, has no effect up to the maximum overlap.
    """
    case = small_soft_case()
    e = 0.9
    pairs = [case.head_on(e, float(v)) for v in velocities]
    shortest = case.duration(e, float(velocities.max()))
    return collide(pairs, "zhou", shortest / STEPS_PER_CONTACT)


def spring_figure(columns: Columns, estimate: Outcomes) -> FigureData:
    """Eq. 19: equivalent spring of both materials and of the estimate in the paper.

    `columns`: from `velocity_columns`; `estimate`: from `estimate_run`.
    """
    case = small_soft_case()
    springs = case.springs(ESTIMATE_VELOCITIES)
    count = len(ESTIMATE_VELOCITIES)
    combined = {
        "material": np.concatenate([columns["material"], np.repeat(case.name, count)]),
        "velocity": np.concatenate([columns["velocity"], ESTIMATE_VELOCITIES]),
        "spring_theory": np.concatenate([columns["spring_theory"], springs]),
        "spring_simulated": np.concatenate([columns["spring_simulated"], spring_of(estimate)]),
    }
    first, second = (each.springs(np.ones(1))[0] for each in PAPER_CASES)
    caption = (
        "Stiffness of the linear spring with the energy of the Hertz contact at the same maximum overlap: "
        "Eq. 19 (lines), and twice the work done on the simulated contact over the square of its maximum "
        f"overlap (points). (a) The two steels, which differ by only {percent(abs(second / first - 1.0))}. "
        "(b) The estimate of the paper for R = 1e-4 m, E = 1e8 Pa, 1e3 kg/m³, for two equal spheres with a "
        f"Poisson ratio of 0.3: {springs[0]:.0f} to {springs[-1]:.0f} N/m, of the order of the 1e3 N/m in "
        "the paper (dashed)."
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
    return FigureData(
        "equation19_spring", "Eq. 19: equivalent spring", caption, combined, deviations, draw_spring, 5.2
    )


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


# ---------------------------------------------------------------- loops of force against overlap

LOOP_RESTITUTIONS = np.array([0.0, 0.25, 0.5, 0.75, 1.0])
"""Target restitutions, from plastic to elastic."""
DRAWN_EVERY = 6
"""Interval of the drawn simulated steps."""


def loop_run() -> Outcomes:
    """Simulate one pair per restitution, with a diameter such that each collision takes 200 steps."""
    return residual_run(LOOP_RESTITUTIONS)


def _diameter(outcomes: Outcomes, index: int) -> float:
    """Diameter [m] of the spheres of collision `index`."""
    duration = STEPS_PER_CONTACT * outcomes.time_step
    return CASE.diameter_lasting(duration, float(LOOP_RESTITUTIONS[index]), VELOCITY)


def loop_force(share: np.ndarray, e: float) -> np.ndarray:
    """Unloading force over the maximum force, at an overlap over the maximum overlap (Zhou 2011, Eq. 4).

        F / Fmax = Lambda(e) (u - x) + e^3 (u - x)^1.5,      u > x

    `share`: u, an array of any shape; x: residual over maximum overlap.
    """
    above = np.maximum(share - 1.0 + float(theory.recovery(e)), 0.0)
    return float(theory.unloading_slope(e)) * above + e**3 * above**1.5


def loop_rows(outcomes: Outcomes, index: int) -> np.ndarray:
    """Columns (m, 4) of all steps with a force: given restitution, overlap, simulated force, theoretical
    force.

    Overlap and forces are divided by their theoretical maxima. At e = 0 unloading is a vertical line, on
    which any last force between 0 and the maximum lies, and the theoretical force is then the simulated one.
    """
    e = float(LOOP_RESTITUTIONS[index])
    diameter = _diameter(outcomes, index)
    k = CASE.stiffness(diameter)
    largest = float(theory.overlap_max(k, CASE.mass_eff(diameter), VELOCITY))
    force = outcomes.force[:, index]
    acting = np.flatnonzero(force)
    share = outcomes.overlap[acting, index] / largest
    loading = acting <= np.argmax(outcomes.overlap[:, index])
    simulated = force[acting] / (k * largest**1.5)
    expected = np.abs(share) ** 1.5
    if e == 0.0:
        expected[-1] = np.clip(simulated[-1], 0.0, 1.0)
    else:
        expected = np.where(loading, expected, loop_force(share, e))
    return np.stack([np.full_like(share, e), share, simulated, expected], axis=1)


def enclosed_share(rows: np.ndarray) -> float:
    """Area of a loop over the area under its loading branch: the fraction of energy lost, 1 - e^2.

    `rows` (m, 4): from `loop_rows`, in the order of the steps.
    """
    share = np.pad(rows[:, 1], 1)
    force = np.pad(rows[:, 2], 1)
    share[-1] = rows[
        -1, 1
    ]  # vertical line from the last force; the overlap changes by at most one step there
    work = 0.5 * (force[1:] + force[:-1]) * np.diff(share)
    return float(work.sum() / work[work > 0.0].sum())


def loop_figure(outcomes: Outcomes) -> FigureData:
    """Figure of the loops; the rows are all steps with a force.

    Deviations: force relative to the maximum force (Zhou 2011, Eq. 4), and fraction of energy lost.
    """
    loops = [loop_rows(outcomes, index) for index in range(len(LOOP_RESTITUTIONS))]
    force_error = [float(np.abs(rows[:, 2] - rows[:, 3]).max()) for rows in loops]
    energy_error = [
        abs(enclosed_share(rows) - (1.0 - float(e) ** 2))
        for rows, e in zip(loops, LOOP_RESTITUTIONS, strict=True)
    ]
    deviations = (
        FigureDeviation(
            "the force from Eq. 4, relative to the maximum force",
            max(force_error),
            f"e = {_worst(force_error)}",
        ),
        FigureDeviation(
            "the fraction of energy lost from 1 − e²", max(energy_error), f"e = {_worst(energy_error)}"
        ),
    )
    caption = (
        "Force against overlap in one collision, both divided by their maxima, for restitution coefficients "
        f"from 0 to 1: Eq. 4 (lines) and every {DRAWN_EVERY}th of {STEPS_PER_CONTACT} simulated steps "
        "(points)."
    )
    names = ("restitution", "overlap_over_max", "force_over_max", "force_over_max_theory")
    columns = dict(zip(names, np.concatenate(loops).T, strict=True))
    return FigureData("loops", "Force-overlap loops", caption, columns, deviations, draw_loops, 3.6)


def _worst(values: list[float]) -> str:
    return f"{LOOP_RESTITUTIONS[int(np.argmax(values))]:g}"


def draw_loops(figure: Any, columns: Mapping[str, np.ndarray]) -> None:
    """Draw the common loading branch and the unloading branches from vertical to elastic."""
    axes = figure.subplots()
    fine = np.linspace(0.0, 1.0, 1001)
    axes.plot(fine, fine**1.5, color="0.3")
    for e, color, marker in zip(LOOP_RESTITUTIONS, COLORS, MARKERS, strict=False):
        mine = columns["restitution"] == e
        if e > 0.0:
            back = np.linspace(1.0 - float(theory.recovery(float(e))), 1.0, 400)
            axes.plot(back, loop_force(back, float(e)), color=color)
        else:
            axes.plot([1.0, 1.0], [0.0, 1.0], color=color)
        share, force = (columns[name][mine][::DRAWN_EVERY] for name in ("overlap_over_max", "force_over_max"))
        axes.plot(share, force, marker, color=color, label=f"$e$ = {e:g}", **POINTS)
    axes.set(
        xlabel=r"overlap $\delta/\delta_{\max}$", ylabel=r"force $F/F_{\max}$", xlim=(0, 1.04), ylim=(0, 1.06)
    )
    axes.legend(loc="upper left", title="unloading with")


# ---------------------------------------------------------------- accuracy by the number of steps

ACCURACY_RESTITUTIONS = np.array([0.05, 0.075, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 1.0])
"""Target restitutions."""
STEPS = np.array([50, 100, 200, 400])
"""Steps per collision."""
PHASES = 8
"""Number of phases of first contact within a step; the largest deviation is shown."""


def accuracy_run() -> tuple[Outcomes, np.ndarray, np.ndarray]:
    """Simulate all restitutions, steps and phases in one scene.

    Returns outcomes, restitution (n,) and steps per contact (n,) of the collisions. The diameters make the
    duration of each collision equal to its number of steps times the common time step.
    """
    steps, e = (np.repeat(each.ravel(), PHASES) for each in np.meshgrid(STEPS, ACCURACY_RESTITUTIONS))
    time_step = CASE.duration(1.0, VELOCITY) / STEPS.max()
    pairs = [
        CASE.head_on(float(a), VELOCITY, CASE.diameter_lasting(count * time_step, float(a), VELOCITY))
        for a, count in zip(e, steps, strict=True)
    ]
    return collide(pairs, "zhou", time_step), e, steps


def accuracy_figure(outcomes: Outcomes, e: np.ndarray, steps: np.ndarray) -> FigureData:
    """Largest deviation over the phases, for each restitution and number of steps.

    `e`, `steps` (n,): from `accuracy_run`. The deviations of the text are those for STEPS_PER_CONTACT steps.
    """
    restitution_error = np.abs(outcomes.restitution / e - 1.0)
    duration_error = np.abs(outcomes.duration / (steps * outcomes.time_step) - 1.0)
    shape = (-1, PHASES)
    columns = {
        "restitution": e.reshape(shape)[:, 0],
        "steps_per_contact": steps.reshape(shape)[:, 0],
        "restitution_deviation": restitution_error.reshape(shape).max(axis=1),
        "duration_deviation": duration_error.reshape(shape).max(axis=1),
    }
    chosen = (columns["steps_per_contact"] == STEPS_PER_CONTACT) & (columns["restitution"] >= RESOLVED)
    e_there = columns["restitution"][chosen]

    def worst(name: str, text: str, target: float) -> Any:
        values = 1.0 + columns[name][chosen]
        return relative_deviation(
            f"{text} at {STEPS_PER_CONTACT} steps, from e = {RESOLVED:g} on",
            values,
            np.ones_like(values),
            lambda index: f"e = {e_there[index]:g}",
            target,
        )

    deviations = (
        worst("restitution_deviation", "e", TARGET_RESTITUTION),
        worst("duration_deviation", "T", TARGET_DURATION),
    )
    caption = (
        "Largest deviation of (a) restitution and (b) duration of simulated collisions from the given "
        f"values, over {PHASES} phases of first contact within a step, by the number of steps per collision. "
        f"Dotted: target with {STEPS_PER_CONTACT} steps. With 50 steps e = 0.05 is not reachable because of "
        "the bound on the unloading tangent."
    )
    return FigureData(
        "accuracy", "Accuracy by number of steps", caption, columns, deviations, draw_accuracy, 5.2
    )


def draw_accuracy(figure: Any, columns: Mapping[str, np.ndarray]) -> None:
    """Panels for e and T, with a line for each number of steps."""
    panels = stacked_panels(figure, 2, sharex=True)
    shown = (
        ("restitution_deviation", TARGET_RESTITUTION, "$e$"),
        ("duration_deviation", TARGET_DURATION, "$T$"),
    )
    for letter, axes, (name, target, symbol) in zip("ab", panels, shown, strict=True):
        for steps, color, marker in zip(STEPS, COLORS, MARKERS, strict=False):
            mine = columns["steps_per_contact"] == steps
            axes.plot(
                columns["restitution"][mine],
                100.0 * columns[name][mine],
                marker=marker,
                color=color,
                label=f"{steps} steps",
                **(POINTS | {"linestyle": "-", "linewidth": 0.8}),
            )
        axes.axhline(100.0 * target, linestyle=":", color="0.4", linewidth=0.9)
        axes.set(
            yscale="log",
            xlim=(0, 1.02),
            title=f"({letter}) {'restitution' if symbol == '$e$' else 'duration'}",
        )
        axes.set_ylabel(f"largest deviation of {symbol} (%)")
    panels[-1].set_xlabel("restitution coefficient $e$")
    panels[0].legend(loc="upper right")
