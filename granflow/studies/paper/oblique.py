"""Oblique and spinning impacts of spheres on a plate: tests 4, 5, 6 and 8 of Chung & Ooi, and measurements.

`oblique_run` simulates all impacts on the collision bench; `oblique_figure` compares them with published
curves, measured rebounds, and the closed form of a contact that slides throughout. The published data are in
`published/`. Sources: Chung & Ooi 2011, Granular Matter 13:643, doi 10.1007/s10035-011-0277-0; Kharaz, Gorham
& Salman 2001, doi 10.1016/S0032-5910(01)00283-2.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from granflow.contact import theory
from granflow.geometry.sphere import sphere_mass
from granflow.io.tables import table_in
from granflow.studies.bench import Collision, CollisionBench
from granflow.studies.figures import COLORS, POINTS, stacked_panels
from granflow.studies.paper.figures import FigureData, FigureDeviation, relative_deviation

SAFETY = 0.005
"""Time step over the shortest loading or unloading time."""
LONGEST = 2.0
"""Length of the simulation in elastic contact durations; all spheres, including damped ones, have separated
then."""
CLOSE = 0.01
"""Initial gap over the distance traveled in one elastic contact duration."""
SLIDING = 1.05
"""Factor on 3.5 mu (1 + e) above which a contact certainly slides throughout."""
Solid = Mapping[str, float]
"""Young's modulus [Pa], Poisson ratio and density [kg/m3] by name."""
ALUMINA = {"young_modulus": 380e9, "poisson_ratio": 0.23, "density": 4000.0}
GLASS = {"young_modulus": 70e9, "poisson_ratio": 0.25, "density": 2500.0}
STEEL = {"young_modulus": 208e9, "poisson_ratio": 0.30, "density": 7850.0}
ALLOY = {"young_modulus": 70e9, "poisson_ratio": 0.33, "density": 2700.0}
RIGIDITY = 1e10
"""Ratio of Young's modulus of a rigid plate to that of the sphere."""
HEAVY = {
    "young_modulus": 1e3 * ALLOY["young_modulus"],
    "poisson_ratio": 0.33,
    "density": 1e3 * ALLOY["density"],
}
"""Partner sphere of test 8: 1000 times the modulus and density of the alloy."""


@dataclass(frozen=True)
class ImpactSetup:
    """Sphere, plate, radius [m], restitution and friction of an impact.

    `partner_radius` [m]: radius of a sphere that replaces the plate; None for a plate.
    """

    sphere: Solid
    plate: Solid
    radius: float
    restitution: float
    friction: float
    partner_radius: float | None = None

    @property
    def reduced(self) -> tuple[float, float]:
        """Hertz stiffness k [N/m^1.5] and effective mass [kg] of the contact; a plate has infinite mass and
        radius."""
        solids = (self.sphere, self.plate)
        compliance = sum((1.0 - each["poisson_ratio"] ** 2) / each["young_modulus"] for each in solids)
        mass = sphere_mass(self.radius, self.sphere["density"])
        if self.partner_radius is None:
            return float(theory.hertz_stiffness(1.0 / compliance, self.radius)), mass
        other = sphere_mass(self.partner_radius, self.plate["density"])
        radius_eff = self.radius * self.partner_radius / (self.radius + self.partner_radius)
        return float(theory.hertz_stiffness(1.0 / compliance, radius_eff)), mass * other / (mass + other)


def rigid(solid: Solid) -> Solid:
    """Properties of a rigid plate for a solid."""
    return {**solid, "young_modulus": RIGIDITY * solid["young_modulus"]}


TEST_4 = ImpactSetup(ALUMINA, rigid(ALUMINA), 2.5e-3, 0.98, 0.092)
KHARAZ = ImpactSetup(ALUMINA, GLASS, 2.5e-3, 0.98, 0.092)
TEST_5 = ImpactSetup(STEEL, rigid(STEEL), 1e-5, 1.0, 0.3)
TEST_6 = ImpactSetup(ALLOY, rigid(ALLOY), 0.1, 0.5, 0.4)
TEST_8 = ImpactSetup(ALLOY, HEAVY, 0.1, 0.5, 0.4, partner_radius=0.5)
"""Spheres, plates and coefficients of the tests: radii [m], restitution, friction (Chung & Ooi; Kharaz et
al.)."""
SPEED_4, SPEED_5, SPEED_6 = 3.9, 5.0, 0.2
"""Impact speeds of tests 4, 5 and 6 [m/s]."""


@dataclass(frozen=True)
class ImpactMotion:
    """Motion of n spheres above a plate: velocity away from the plate and along it [m/s], angular velocity
    [rad/s].

    Friction on a positive velocity along the plate generates a positive angular velocity.
    """

    normal: np.ndarray
    along: np.ndarray
    spin: np.ndarray

    def slip(self, radius: float) -> np.ndarray:
        """Tangential velocity (n,) [m/s] of the lowest point of a sphere of the given radius [m]: v_t - R
        w."""
        return self.along - radius * self.spin


def rebound(setup: ImpactSetup, law: str, before: ImpactMotion) -> ImpactMotion:
    """Motion after the impact, simulated with one plate and spheres far apart; `before.normal` is negative.

    `law`: contact model. With `setup.partner_radius`, each sphere hits a separate partner sphere instead of
    the plate.
    """
    speeds = -before.normal
    elastic = theory.duration(1.0, *setup.reduced, speeds)
    partner = setup.partner_radius
    pair = {"restitution": setup.restitution, "friction": setup.friction}
    motions = np.stack([speeds, np.ones_like(speeds), before.along, before.spin, CLOSE * elastic], axis=1)
    bench = CollisionBench(
        materials={"sphere": setup.sphere, "plate": setup.plate},
        pairs=dict.fromkeys(("sphere-sphere", "sphere-plate", "plate-plate"), pair),
        contact={"normal": law, "tangential": "mindlin"},
        collisions=[Collision("sphere", "plate", setup.radius, partner, *motion) for motion in motions],
        run={"duration": LONGEST * float(np.max(elastic)), "velocity_max": float(np.max(speeds))},
        numerics={"time_step_fraction": SAFETY, "rayleigh_fraction": 1.0},
    )
    with bench:
        bench.rebound()
        velocity, spin = bench.motions()
    return ImpactMotion(-velocity[:, 0, 0], velocity[:, 0, 1], -spin[:, 0, 2])


# ---------------------------------------------------------------- contacts that slide throughout


def mean_overlap_share(e: float) -> float:
    """Overlap over the maximum overlap, averaged over the impulse of a collision (model of Zhou 2011).

    Integration by parts, with F dt = -M dv:   int F d dt / int F dt = (eta1/1.8 + e x + J) / (1 + e)
    where loading gives int_0^1 sqrt(1 - u^2.5) du = eta1/1.8, and unloading, with s = u - x:
    J = int_0^y sqrt((5/4) Lambda (y^2 - s^2) + e^3 (y^2.5 - s^2.5)) ds
    """
    from scipy.integrate import quad

    y = float(theory.recovery(e))
    slope = float(theory.unloading_slope(e))

    def rate(s: float) -> float:
        return float(np.sqrt(max(1.25 * slope * (y**2 - s**2) + e**3 * (y**2.5 - s**2.5), 0.0)))

    unloading = quad(
        lambda angle: rate(y * np.sin(angle)) * y * np.cos(angle), 0.0, 0.5 * np.pi, epsabs=1e-14
    )[0]
    return (theory.LOADING_DURATION / 1.8 + e * (1.0 - y) + unloading) / (1.0 + e)


def sliding_solution(setup: ImpactSetup, before: ImpactMotion) -> ImpactMotion:
    """Motion after an impact that slides throughout, with Zhou's model.

    v_n' = e v,  v_t' = v_t - mu (1 + e) v,  R w' = R w + (5/2) mu (1 + e) v (1 - <d>/(2 R)). The tangential
    impulse is mu (1 + e) m v, its lever arm the radius minus half of the overlap; textbook relations use R.
    """
    speed = -before.normal
    direction = np.sign(before.slip(setup.radius))
    k, mass = setup.reduced
    overlap = mean_overlap_share(setup.restitution) * theory.overlap_max(k, mass, speed)
    change = direction * setup.friction * (1.0 + setup.restitution) * speed
    arm = 1.0 - 0.5 * overlap / setup.radius
    return ImpactMotion(
        setup.restitution * speed, before.along - change, before.spin + 2.5 * change * arm / setup.radius
    )


def slides(setup: ImpactSetup, before: ImpactMotion) -> np.ndarray:
    """Whether the contact slides throughout (n,): |slip| > 3.5 mu (1 + e) v, with a margin."""
    limit = 3.5 * setup.friction * (1.0 + setup.restitution) * -before.normal
    return np.abs(before.slip(setup.radius)) > SLIDING * limit


# ---------------------------------------------------------------- published data, and all impacts


def published(source: str) -> dict[str, np.ndarray]:
    """Curves of `published/<source>.csv` by quantity, each (n, 2): abscissa and ordinate as published."""
    text = (files("granflow.studies.paper") / "published" / f"{source}.csv").read_text(encoding="utf-8")
    table = table_in(text, Path(source))
    assert table is not None
    rows = [cells for _, cells in table.rows]
    return {
        name: np.array([(float(x), float(y)) for each, x, y in rows if each == name]) for name, _, _ in rows
    }


def at_angles(angle: np.ndarray) -> ImpactMotion:
    """Motion without spin at angles (n,) from the normal [deg] at SPEED_4."""
    turned = np.radians(angle)
    return ImpactMotion(-SPEED_4 * np.cos(turned), SPEED_4 * np.sin(turned), np.zeros(len(angle)))


def with_slip(ratio: np.ndarray) -> ImpactMotion:
    """Motion of test 5 (n,); `ratio` (n,) is the tangential velocity over friction times normal velocity."""
    return ImpactMotion(
        np.full(len(ratio), -SPEED_5), ratio * TEST_5.friction * SPEED_5, np.zeros(len(ratio))
    )


def with_spin(ratio: np.ndarray) -> ImpactMotion:
    """Motion of tests 6 and 8 (n,) for ratios (n,) of 3.5 mu (1 + e) v to the slip due to spin.

    v: normal velocity, SPEED_6.
    """
    slip = 3.5 * TEST_6.friction * (1.0 + TEST_6.restitution) * SPEED_6 / ratio
    return ImpactMotion(np.full(len(ratio), -SPEED_6), np.zeros(len(ratio)), -slip / TEST_6.radius)


@dataclass(frozen=True)
class ImpactSweep:
    """One setup with one contact model, over a range of impacts.

    `x` (n,): abscissa of the published plot; `before`, `after`: motions of n spheres.
    """

    setup: ImpactSetup
    law: str
    x: np.ndarray
    before: ImpactMotion
    after: ImpactMotion


def oblique_run(angles: int = 44, ratios: int = 41) -> dict[str, ImpactSweep]:
    """Simulate all impacts of the figure; fewer points take less time.

    `angles`, `ratios`: number of points of each curve. The keys consist of the plate or test and the contact
    model, such as test5_zhou.
    """
    angle = np.linspace(2.0, 88.0, angles)
    slip = np.linspace(0.25, 20.0, ratios)
    spin = np.geomspace(0.15, 12.0, ratios)
    cases: dict[str, tuple[ImpactSetup, str, np.ndarray, ImpactMotion]] = {
        f"{name}_{law}": (setup, law, angle, at_angles(angle))
        for name, setup in (("glass", KHARAZ), ("test4", TEST_4))
        for law in ("hertz", "zhou")
    }
    cases["test5_zhou"] = (TEST_5, "zhou", slip, with_slip(slip))
    cases["test6_zhou"] = (TEST_6, "zhou", spin, with_spin(spin))
    cases["test6_hertz"] = (TEST_6, "hertz", spin, with_spin(spin))
    cases["test8_zhou"] = (TEST_8, "zhou", spin, with_spin(spin))
    return {name: ImpactSweep(*case, rebound(case[0], case[1], case[3])) for name, case in cases.items()}


def plotted_quantities(sweep: ImpactSweep, kind: str) -> dict[str, np.ndarray]:
    """Quantities (n,) of the published plots of tests 4, 5 or 6, by the name of the published curve.

    Angles [deg], angular velocities [rad/s], all others dimensionless.
    """
    before = sweep.before
    after = sweep.after
    radius = sweep.setup.radius
    slip = after.slip(radius)
    if kind == "test4":
        return {
            "tangential_restitution": after.along / before.along,
            "spin": -after.spin,
            "rebound_angle": np.degrees(np.arctan2(slip, after.normal)),
        }
    if kind == "test5":
        unit = sweep.setup.friction * -before.normal
        return {"slip": slip / unit, "spin": -radius * after.spin / unit}
    return {"slip": -slip / before.slip(radius)}


# ---------------------------------------------------------------- figure

TARGET = 1e-3
"""Target of the relative deviation for contacts that slide throughout."""
TITLES = {
    "glass": "oxide on glass",
    "test4": "test 4",
    "test5": "test 5",
    "test6": "test 6",
    "test8": "test 8",
}
"""Titles of the tests in the deviations."""


def oblique_figure(run: Mapping[str, ImpactSweep]) -> FigureData:
    """Figure of oblique impacts, with measured points and the deviations of contacts that slide
    throughout."""
    return FigureData(
        name="oblique_impacts",
        title="Oblique impacts: Chung & Ooi, tests 4 to 8, and Kharaz, Gorham & Salman",
        caption=(
            "Spheres of aluminum oxide of 5 mm at 3.9 m/s on glass (solid lines; measured: circles) and on a "
            "rigid plate (dashed; Chung & Ooi's test 4: crosses): tangential restitution, spin, rebound "
            "angle of the contact patch. (d) to (f): tests 5 (steel, 20 µm), 6 and 8 (spinning spheres of "
            "aluminum alloy). If the contact sticks temporarily, the published curve of test 5 corresponds "
            "to half the tangential stiffness (a plate rigid along its normal only), and those of tests 6 "
            "and 8 to a tangential dashpot, tension at the end of the contact, and a friction limit without "
            "the viscous part of the normal force."
        ),
        columns=_columns(run),
        deviations=_deviations(run),
        draw=lambda figure, _: _draw(figure, run),
        height=13.0,
    )


def _columns(run: Mapping[str, ImpactSweep]) -> dict[str, np.ndarray]:
    """Each curve as two columns, simulated and published; shorter columns are padded with nan."""
    columns: dict[str, np.ndarray] = {}
    for name, sweep in run.items():
        columns[f"{name}_x"] = sweep.x
        for quantity, values in plotted_quantities(sweep, _kind(name)).items():
            columns[f"{name}_{quantity}"] = values
    for source in ("kharaz_2001", "chung_ooi_2011"):
        for quantity, points in published(source).items():
            columns |= {f"{source}_{quantity}_x": points[:, 0], f"{source}_{quantity}": points[:, 1]}
    longest = max(len(values) for values in columns.values())
    return {
        name: np.pad(values, (0, longest - len(values)), constant_values=np.nan)
        for name, values in columns.items()
    }


def _kind(name: str) -> str:
    return {"test5": "test5", "test6": "test6", "test8": "test6"}.get(name.split("_")[0], "test4")


def _deviations(run: Mapping[str, ImpactSweep]) -> tuple[FigureDeviation, ...]:
    """Deviations of contacts that slide throughout from the closed forms, with Zhou's model, in the order of
    tests."""
    found = []
    for name, sweep in run.items():
        if sweep.law == "zhou":
            found += list(_sliding_deviations(name, sweep))
    return tuple(found)


def _sliding_deviations(name: str, sweep: ImpactSweep) -> list[FigureDeviation]:
    """Deviations of tangential velocity and spin, with a remark about the lever arm of textbooks.

    Only for impacts that slide throughout, for which `sliding_solution` holds.
    """
    sliding = slides(sweep.setup, sweep.before)
    closed_form = sliding_solution(sweep.setup, sweep.before)
    after = sweep.after
    radius = sweep.setup.radius
    title = TITLES[name.split("_")[0]]
    axis = {"test4": "the impact angle", "test5": "the slip ratio", "test6": "the ratio"}[_kind(name)]
    x = sweep.x[sliding]
    change = (after.spin - sweep.before.spin)[sliding]
    textbook = 2.5 * (closed_form.along - sweep.before.along)[sliding] / -radius
    remark = (
        f"Textbook relations use the radius as lever arm instead of the radius minus half of the overlap: "
        f"{100.0 * float(np.max(np.abs(change / textbook - 1.0))):.2g} % less spin."
    )
    expected = (closed_form.spin - sweep.before.spin)[sliding]
    return [
        relative_deviation(
            f"the change of tangential velocity, sliding ({title})",
            (after.along - sweep.before.along)[sliding],
            (closed_form.along - sweep.before.along)[sliding],
            lambda n: f"{axis} {x[n]:.3g}",
            TARGET,
        ),
        relative_deviation(
            f"the change of spin, sliding ({title})",
            change,
            expected,
            lambda n: f"{axis} {x[n]:.3g}",
            TARGET,
            remark,
        ),
    ]


def _draw(figure: Any, run: Mapping[str, ImpactSweep]) -> None:
    panels = stacked_panels(figure, 6)
    _draw_angles(panels[:3], run)
    _draw_test_5(panels[3:5], run)
    _draw_test_6(panels[5], run)
    for letter, panel in zip("abcdef", panels, strict=True):
        panel.set_title(f"({letter})")


def _draw_angles(panels: Any, run: Mapping[str, ImpactSweep]) -> None:
    """Draw test 4 and the measurements: Hertz with damping, and Zhou's model."""
    measured = published("kharaz_2001")
    curves = published("chung_ooi_2011")
    labels = {
        "tangential_restitution": r"tangential restitution $v_t'/v_t$",
        "spin": r"spin $\omega'$ [rad/s]",
        "rebound_angle": "rebound angle of the patch [deg]",
    }
    for panel, (quantity, label) in zip(panels, labels.items(), strict=True):
        for plate, line in (("glass", "-"), ("test4", "--")):
            for number, law in enumerate(("hertz", "zhou")):
                sweep = run[f"{plate}_{law}"]
                text = {"glass": f"{law}, glass", "test4": f"{law}, rigid"}[plate]
                panel.plot(
                    sweep.x,
                    plotted_quantities(sweep, "test4")[quantity],
                    line,
                    color=COLORS[number],
                    label=text,
                )
        panel.plot(*curves[f"test4_{quantity}"].T, "x", color="0.45", ms=3.5, label="Chung & Ooi, rigid")
        panel.plot(*measured[quantity].T, marker="o", color="black", label="measured, glass", **POINTS)
        panel.set(xlabel="impact angle [deg]", ylabel=label, xlim=(0.0, 90.0))
    panels[2].legend(loc="upper left")


def _draw_test_5(panels: Any, run: Mapping[str, ImpactSweep]) -> None:
    """Draw final slip and spin against initial slip, and the lines of a contact that slides throughout."""
    sweep = run["test5_zhou"]
    curves = published("chung_ooi_2011")
    sliding = np.array([7.0, 20.0])
    lines = {"slip": sliding - 7.0, "spin": np.full(2, -5.0)}
    labels = {
        "slip": r"test 5: slip after $V_s'/(\mu V_n)$",
        "spin": r"test 5: spin after $r\omega'/(\mu V_n)$",
    }
    for panel, quantity in zip(panels, labels, strict=True):
        panel.plot(sweep.x, plotted_quantities(sweep, "test5")[quantity], color=COLORS[1], label="zhou")
        panel.plot(*curves[f"test5_{quantity}"].T, "x", color="0.45", ms=3.5, label="Chung & Ooi")
        panel.plot(sliding, lines[quantity], ":", color="black", label="sliding throughout")
        panel.set(xlabel=r"slip before $V_t/(\mu V_n)$", ylabel=labels[quantity], xlim=(0.0, 14.0))
    panels[0].set_ylim(-3.5, 7.0)
    panels[0].legend(loc="upper left")


def _draw_test_6(panel: Any, run: Mapping[str, ImpactSweep]) -> None:
    """Draw minus final over initial slip against the largest change by friction over initial slip."""
    for name, line, color in (("test6_hertz", "-", 0), ("test6_zhou", "-", 1), ("test8_zhou", ":", 2)):
        sweep = run[name]
        label = {"test6_hertz": "hertz", "test6_zhou": "zhou", "test8_zhou": "zhou, test 8"}[name]
        panel.semilogx(
            sweep.x, plotted_quantities(sweep, "test6")["slip"], line, color=COLORS[color], label=label
        )
    curves = published("chung_ooi_2011")
    panel.plot(*curves["test6_slip"].T, "x", color="0.45", ms=3.5, label="Chung & Ooi, 6")
    panel.plot(*curves["test8_slip"].T, "+", color="0.45", ms=3.5, label="Chung & Ooi, 8")
    panel.set(xlabel=r"$3.5\,\mu(1+e)V_n/V_s$", ylabel=r"tests 6 and 8: $-V_s'/V_s$")
    panel.legend(loc="upper left")
