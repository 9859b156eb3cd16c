"""Figure of oblique impacts: simulated, published and measured rebounds."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from granflow.studies.figures import COLORS, POINTS, stacked_panels
from granflow.studies.paper.figure_data import FigureData, FigureDeviation, relative_deviation
from granflow.studies.paper.oblique import ImpactSweep, plotted_quantities, published, slides, sliding_solution

TARGET = 1e-3
"""Target of the relative deviation for contacts that slide throughout."""

TITLES = {"glass": "oxide on glass", "test4": "test 4", "test5": "test 5", "test6": "test 6", "test8": "test 8"}
"""Titles of the tests in the deviations."""


def oblique_figure(run: Mapping[str, ImpactSweep]) -> FigureData:
    """Figure of oblique impacts, with measured points and the deviations of contacts that slide throughout."""
    return FigureData(
        name="oblique_impacts",
        title="Oblique impacts: Chung & Ooi, tests 4 to 8, and Kharaz, Gorham & Salman",
        caption=(
            "Spheres of aluminum oxide of 5 mm at 3.9 m/s on glass (solid lines; measured: circles) and on a rigid "
            "plate (dashed; Chung & Ooi's test 4: crosses): tangential restitution, spin, rebound angle of the contact "
            "patch. (d) to (f): tests 5 (steel, 20 µm), 6 and 8 (spinning spheres of aluminum alloy). If the contact "
            "sticks temporarily, the published curve of test 5 corresponds to half the tangential stiffness (a plate "
            "rigid along its normal only), and those of tests 6 and 8 to a tangential dashpot, tension at the end of "
            "the contact, and a friction limit without the viscous part of the normal force."
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
        name: np.pad(values, (0, longest - len(values)), constant_values=np.nan) for name, values in columns.items()
    }


def _kind(name: str) -> str:
    return {"test5": "test5", "test6": "test6", "test8": "test6"}.get(name.split("_")[0], "test4")


def _deviations(run: Mapping[str, ImpactSweep]) -> tuple[FigureDeviation, ...]:
    """Deviations of contacts that slide throughout from the closed forms, with Zhou's model, in the order of tests."""
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
    closed_form, after, radius = sliding_solution(sweep.setup, sweep.before), sweep.after, sweep.setup.radius
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
            f"the change of tangential velocity, sliding ({title})", (after.along - sweep.before.along)[sliding],
            (closed_form.along - sweep.before.along)[sliding], lambda n: f"{axis} {x[n]:.3g}", TARGET,
        ),
        relative_deviation(
            f"the change of spin, sliding ({title})", change, expected, lambda n: f"{axis} {x[n]:.3g}", TARGET, remark
        ),
    ]  # fmt: skip


def _draw(figure: Any, run: Mapping[str, ImpactSweep]) -> None:
    panels = stacked_panels(figure, 6)
    _draw_angles(panels[:3], run)
    _draw_test_5(panels[3:5], run)
    _draw_test_6(panels[5], run)
    for letter, panel in zip("abcdef", panels, strict=True):
        panel.set_title(f"({letter})")


def _draw_angles(panels: Any, run: Mapping[str, ImpactSweep]) -> None:
    """Draw test 4 and the measurements: Hertz with damping, and Zhou's model."""
    measured, curves = published("kharaz_2001"), published("chung_ooi_2011")
    labels = {
        "tangential_restitution": r"tangential restitution $v_t'/v_t$", "spin": r"spin $\omega'$ [rad/s]",
        "rebound_angle": "rebound angle of the patch [deg]",
    }  # fmt: skip
    for panel, (quantity, label) in zip(panels, labels.items(), strict=True):
        for plate, line in (("glass", "-"), ("test4", "--")):
            for number, law in enumerate(("hertz", "zhou")):
                sweep = run[f"{plate}_{law}"]
                text = {"glass": f"{law}, glass", "test4": f"{law}, rigid"}[plate]
                panel.plot(
                    sweep.x, plotted_quantities(sweep, "test4")[quantity], line, color=COLORS[number], label=text
                )
        panel.plot(*curves[f"test4_{quantity}"].T, "x", color="0.45", ms=3.5, label="Chung & Ooi, rigid")
        panel.plot(*measured[quantity].T, marker="o", color="black", label="measured, glass", **POINTS)
        panel.set(xlabel="impact angle [deg]", ylabel=label, xlim=(0.0, 90.0))
    panels[2].legend(loc="upper left")


def _draw_test_5(panels: Any, run: Mapping[str, ImpactSweep]) -> None:
    """Draw final slip and spin against initial slip, and the lines of a contact that slides throughout."""
    sweep, curves = run["test5_zhou"], published("chung_ooi_2011")
    sliding = np.array([7.0, 20.0])
    lines = {"slip": sliding - 7.0, "spin": np.full(2, -5.0)}
    labels = {"slip": r"test 5: slip after $V_s'/(\mu V_n)$", "spin": r"test 5: spin after $r\omega'/(\mu V_n)$"}
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
        panel.semilogx(sweep.x, plotted_quantities(sweep, "test6")["slip"], line, color=COLORS[color], label=label)
    curves = published("chung_ooi_2011")
    panel.plot(*curves["test6_slip"].T, "x", color="0.45", ms=3.5, label="Chung & Ooi, 6")
    panel.plot(*curves["test8_slip"].T, "+", color="0.45", ms=3.5, label="Chung & Ooi, 8")
    panel.set(xlabel=r"$3.5\,\mu(1+e)V_n/V_s$", ylabel=r"tests 6 and 8: $-V_s'/V_s$")
    panel.legend(loc="upper left")
