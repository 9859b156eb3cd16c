"""Yield loci and the flow function from the runs of a sweep of shear tests: key `evaluate` of a sweep.

Each run is one shear test, with two stages in which a wall slides under a normal stress that a servo keeps:

    preshear    under sigma_pre until the shear stress is steady: tau_pre
    shear       under a smaller sigma_sh, to the peak of the shear stress: tau_sh

The runs with the same sigma_pre give one yield locus, the regression line through their shear points, and two
Mohr circles that touch it. The circle through the preshear point has the larger principal stress sigma_1, the
consolidation stress; that through the origin has the unconfined yield strength sigma_c. The flow function is
sigma_c over sigma_1 of several sigma_pre. (ASTM D6773; D. Schulze, Powders and Bulk Solids, Springer 2008,
ch. 3 and 4.)

`faults_in` checks a scene before the runs, `evaluate` reads the runs, and `write_loci` writes tables and
figures.
"""

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from math import atan, degrees, hypot, inf, isfinite, nan, sqrt
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from pydantic import Field

from granflow import Scene, load_scene
from granflow.io.files import replacing, write_text
from granflow.io.tables import TimeSeriesTable, read_series, write_table
from granflow.scene.blocks.motions import Servo, Translation
from granflow.schema.faults import Fault, KeyPath
from granflow.schema.messages import unknown
from granflow.schema.model import Model, Name, Text
from granflow.studies.figures import COLORS, FULL_WIDTH, MARKERS, Drawing, PageTable, write_figures

# Keys


class ShearTestStages(Model):
    """Stages of a shear test."""

    preshear: Name = Field("preshear", description="stage of the preshear")
    shear: Name = Field("shear", description="stage of the shear to failure")


class ShearTestParameters(Model):
    """Parameters of the sweep by their meaning in the shear test."""

    shear: Text = Field(
        description="parameter that changes the normal stress at failure: its values are the points of one "
        "yield locus; all other parameters distinguish yield loci"
    )
    preshear: Text | None = Field(
        None,
        description="parameter that changes the normal stress of the preshear: its values are the points of "
        "one flow function",
    )


class YieldLocusEvaluation(Model):
    """Yield loci and flow functions from runs that are shear tests."""

    kind: Literal["yield_locus"] = Field("yield_locus", description="kind of evaluation")
    wall: Text = Field(description="wall that slides, with a servo across it; output.wall_forces includes it")
    parameters: ShearTestParameters = Field(
        description="parameters of the sweep by their meaning in the test"
    )
    stages: ShearTestStages = Field(ShearTestStages(), description="stages of the test")

    def faults_of_parameters(self, names: Sequence[str]) -> Iterator[Fault]:
        """Faults of parameters that are not among those of the sweep."""
        for key in ("shear", "preshear"):
            name = getattr(self.parameters, key)
            if name is not None and name not in names:
                yield unknown(("parameters", key), name, names, "parameter of vary")
        if self.parameters.shear == self.parameters.preshear:
            yield Fault(("parameters", "preshear"), "it is that of shear, too; give another parameter")


def faults_in(evaluation: YieldLocusEvaluation, scene: Scene) -> Iterator[Fault]:
    """Faults of a scene that is no shear test: stages, wall, its servo and its translation in both stages."""
    stages = scene.stage_names
    for key in ("preshear", "shear"):
        if getattr(evaluation.stages, key) not in stages:
            yield unknown(("stages", key), getattr(evaluation.stages, key), stages, "stage")
            return
    if evaluation.wall not in scene.walls:
        yield unknown(("wall",), evaluation.wall, scene.walls, "wall")
        return
    path: KeyPath = ("wall",)
    if evaluation.wall not in scene.measured_walls:
        yield Fault(path, "output.wall_forces of the scene does not include it; write wall_forces: true")
    if _area(scene, evaluation.wall) is None:
        yield Fault(path, "it is infinite and has no area; make both axes along it periodic")
    found = []
    for stage in (evaluation.stages.preshear, evaluation.stages.shear):
        motions = [each for each in scene.walls[evaluation.wall].motion if each.is_in_stage(stage)]
        servos = [each for each in motions if isinstance(each, Servo)]
        slides = [each for each in motions if isinstance(each, Translation)]
        if len(servos) != 1 or len(slides) != 1:
            yield Fault(
                path,
                f"it has {len(servos)} servos and {len(slides)} translations in the stage {stage}; a shear "
                "test needs one of each",
            )
            return
        found.append((_unit(servos[0].direction), _unit(slides[0].velocity)))
    (normal, slide), (normal_shear, slide_shear) = found
    if not np.allclose(normal, normal_shear) or not np.allclose(slide, slide_shear):
        yield Fault(path, "servo or translation have other directions in the two stages")
    elif abs(normal @ slide) > LEVEL:
        yield Fault(path, "its translation is not perpendicular to the direction of its servo")


LEVEL = 1e-6
"""Largest cosine between two directions that are perpendicular."""


def _unit(vector: Sequence[float]) -> np.ndarray:
    """The direction (3,) of a vector; 0 for 0."""
    length = float(np.linalg.norm(vector))
    return np.asarray(vector, dtype=float) / (length or 1.0)


def _area(scene: Scene, name: str) -> float | None:
    """Area [m2] of a wall; None if it is infinite."""
    wall = scene.walls[name]
    return wall.surface(scene.folder).area if wall.is_bounded else wall.periodic_area(scene.domain)


# One run

STEADY_SHARE = 0.5
"""Last part of the preshear over which its stresses are averaged."""
STEADY_CHANGE = 0.1
"""Relative change of the mean shear stress, from one half of that part to the other, above which the preshear
is not steady."""
WINDOW = 0.05
"""Part of the stage of the shear to failure over which the stresses are averaged at its peak."""
LEAST_ROWS = 40
"""Least number of rows of the time series in each stage: two in a window."""
LATE = 0.9
"""Part of the stage in which the peak must occur, unless the shear stress does not increase any more."""
STILL_RISING = 0.02
"""Relative increase of the shear stress, from the third to the last quarter of the stage, below which it does
not increase any more."""


class ShearTest(NamedTuple):
    """One run of the sweep that has reached its end: values of its parameters in SI units, seed, directory,
    and the values as texts with the units of the sweep file."""

    values: Mapping[str, Any]
    seed: int
    directory: Path
    texts: Mapping[str, str]


@dataclass
class ShearPoint:
    """Stresses [Pa] of one run, and remarks on them.

    preshear:   normal and shear stress of the preshear, means over the last STEADY_SHARE of the stage
    normal:     normal stress at the peak of the shear stress
    shear:      peak of the running mean of the shear stress over WINDOW of the stage
    prorated:   shear stress multiplied by the mean tau_pre of all runs of the yield locus over that of this
                run
    is_used:    whether the point is part of the yield locus
    """

    run: ShearTest
    preshear: tuple[float, float] = (nan, nan)
    normal: float = nan
    shear: float = nan
    prorated: float = nan
    is_used: bool = True
    remarks: list[str] = field(default_factory=list)

    def drop(self, remark: str) -> None:
        """Leave the point out of the yield locus, for a reason."""
        self.is_used = False
        self.remarks.append(remark)


def shear_point(evaluation: YieldLocusEvaluation, run: ShearTest) -> ShearPoint:
    """The stresses of a run from its time series, whose rows are means since the row before."""
    point = ShearPoint(run)
    series = read_series(run.directory / "timeseries.csv")
    scene = load_scene(run.directory / "scene_as_run.yaml")
    stages = evaluation.stages
    parts = []
    for stage in (stages.preshear, stages.shear):
        rows = _rows(series, stage)
        if series is None or rows.stop - rows.start < LEAST_ROWS:
            point.drop(
                f"the stage {stage} has {max(rows.stop - rows.start, 0)} rows of the time series, and needs "
                f"{LEAST_ROWS}: reduce output.timeseries_interval"
            )
            return point
        parts.append(_stresses(series, rows, evaluation.wall, stage, scene))
    (time, normal, shear), (time_shear, normal_shear, shear_shear) = parts
    steady = _after(time, 1.0 - STEADY_SHARE)
    point.preshear = float(normal[steady].mean()), float(shear[steady].mean())
    first, second = np.array_split(shear[steady], 2)
    change = (second.mean() - first.mean()) / shear[steady].mean()
    if abs(change) > STEADY_CHANGE:
        point.remarks.append(
            f"the preshear is not steady: its shear stress changes by {100 * change:+.0f} % within the last "
            f"{100 * STEADY_SHARE:.0f} % of the stage; make it longer, or the sample larger"
        )
    width = max(round(WINDOW * len(time_shear)), 2)
    running = _running_mean(shear_shear, width)
    peak = int(np.argmax(running))
    point.normal = float(_running_mean(normal_shear, width)[peak])
    point.shear = float(running[peak])
    quarters = [each.mean() for each in np.array_split(shear_shear, 4)]
    if peak >= LATE * len(running) and quarters[3] > (1.0 + STILL_RISING) * quarters[2]:
        point.drop(
            "the shear stress still increases at the end of the shear: there is no peak; make it longer"
        )
    elif point.normal >= point.preshear[0]:
        point.drop("the normal stress at failure is not below that of the preshear")
    elif point.normal <= 0.0:
        point.drop("the normal stress at failure is not positive: the servo does not press the wall")
    elif point.shear <= 0.0 or point.preshear[1] <= 0.0:
        point.drop("the shear stress is not positive")
    return point


def _rows(series: TimeSeriesTable | None, stage: str) -> slice:
    """The rows of a stage, which follow each other; an empty slice without."""
    found = np.flatnonzero(series.stage == stage) if series is not None else np.empty(0, int)
    return slice(int(found[0]), int(found[-1]) + 1) if len(found) else slice(0, 0)


def _after(time: np.ndarray, share: float) -> np.ndarray:
    """Whether times (k,) lie in the part of their span after a share of it."""
    return np.asarray(time >= time[0] + share * (time[-1] - time[0]))


def _running_mean(values: np.ndarray, width: int) -> np.ndarray:
    """Means of each `width` values that follow each other."""
    return np.convolve(values, np.full(width, 1.0 / width), mode="valid")


def _stresses(
    series: TimeSeriesTable, rows: slice, wall: str, stage: str, scene: Scene
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times [s], normal and shear stress [Pa] of a stage, from the force of the particles on the wall."""
    columns = {column.name: column.values[rows] for column in series.columns}
    force = np.stack([columns[f"wall_force_{axis}.{wall}"] for axis in "xyz"], axis=1)
    motions = [each for each in scene.walls[wall].motion if each.is_in_stage(stage)]
    normal = next(_unit(each.direction) for each in motions if isinstance(each, Servo))
    slide = next(_unit(each.velocity) for each in motions if isinstance(each, Translation))
    area = _area(scene, wall)
    assert area is not None
    return series.time[rows], -force @ normal / area, -force @ slide / area


# One yield locus


@dataclass(frozen=True)
class YieldLocus:
    """The line tau = c + sigma tan(phi) and the two Mohr circles that touch it; SI units, angles in rad.

    cohesion:      c
    slope:         tan(phi)
    covariance:    of c and tan(phi), (2, 2); nan from two points
    preshear:      normal and shear stress of the preshear point, not above the line
    """

    cohesion: float
    slope: float
    covariance: np.ndarray
    preshear: tuple[float, float]

    @property
    def friction_angle(self) -> float:
        """Angle phi of the yield locus."""
        return atan(self.slope)

    @property
    def unconfined_center(self) -> float:
        """Center, and radius, of the circle through the origin.

        A circle of center m touches the line if r = (c + m tan phi) cos phi; here r = m:

            m = c cos(phi) / (1 - sin(phi)) = c (tan(phi) + sqrt(1 + tan(phi)^2))
        """
        return self.cohesion * (self.slope + hypot(1.0, self.slope))

    @property
    def unconfined_strength(self) -> float:
        """sigma_c = 2 c cos(phi) / (1 - sin(phi)); 0 for a negative c."""
        return max(2.0 * self.unconfined_center, 0.0)

    @property
    def unconfined_error(self) -> float:
        """Standard error of sigma_c, from that of the line."""
        length = hypot(1.0, self.slope)
        gradient = 2.0 * np.array([self.slope + length, self.cohesion * (1.0 + self.slope / length)])
        return float(np.sqrt(gradient @ self.covariance @ gradient))

    @property
    def center(self) -> float:
        """Center m of the circle through the preshear point, of those two that touch the line the smaller.

            (sigma - m)^2 + tau^2 = r^2,     r = (c + m tan phi) cos phi
            m = (1 + t^2) sigma + c t - sqrt((1 + t^2) ((c + sigma t)^2 - tau^2)),    t = tan(phi)

        It touches the line to the left of the preshear point, where the yield locus ends.
        """
        sigma, tau = self.preshear
        stretch = 1.0 + self.slope**2
        above = max((self.cohesion + sigma * self.slope) ** 2 - tau**2, 0.0)
        return float(stretch * sigma + self.cohesion * self.slope - sqrt(stretch * above))

    @property
    def radius(self) -> float:
        """Radius of the circle through the preshear point."""
        return (self.cohesion + self.center * self.slope) / hypot(1.0, self.slope)

    @property
    def consolidation_stress(self) -> float:
        """sigma_1: larger principal stress of the circle through the preshear point."""
        return self.center + self.radius

    @property
    def flowability(self) -> float:
        """ff_c = sigma_1 / sigma_c; infinite without strength."""
        return self.consolidation_stress / self.unconfined_strength if self.unconfined_strength else inf

    @property
    def effective_angle(self) -> float:
        """Effective angle of internal friction: of the line through the origin that touches the circle
        through the preshear point; nan if its smaller principal stress is negative."""
        ratio = self.radius / self.center
        return float(np.arcsin(ratio)) if ratio <= 1.0 else nan

    @property
    def steady_angle(self) -> float:
        """Angle of internal friction at steady-state flow, arctan(tau_pre / sigma_pre)."""
        return atan(self.preshear[1] / self.preshear[0])

    @property
    def least_normal(self) -> float:
        """Normal stress at which the circle through the origin touches the line: the yield locus begins
        there."""
        return self.unconfined_center * (1.0 - self.slope / hypot(1.0, self.slope))


CLASSES = (
    (1.0, "not flowing"),
    (2.0, "very cohesive"),
    (4.0, "cohesive"),
    (10.0, "easy-flowing"),
    (inf, "free-flowing"),
)
"""Upper bounds of ff_c, and the classes of Jenike in the form of Schulze."""


def class_of(flowability: float) -> str:
    """Class of a powder by ff_c; empty for nan."""
    return next((name for bound, name in CLASSES if flowability < bound or flowability == bound == inf), "")


ABOVE_LINE = 0.05
"""Relative height of the preshear point above the line up to which it is taken to lie on the line: such
points result from scatter; above it, the line is no yield locus of this preshear."""
BELOW_LINE = 0.2
"""Relative depth of the preshear point below the line from which on a remark says so: steady flow under the
preshear is at the end of the yield locus, or little below it (Schulze 2008, ch. 4)."""


def line_through(normal: np.ndarray, shear: np.ndarray) -> tuple[float, float, np.ndarray]:
    """Cohesion c [Pa] and slope of the regression line through points (n,) [Pa], with covariance (2, 2).

    The covariance is nan for two points.
    """
    design = np.stack([np.ones_like(normal), normal], axis=1)
    scale = np.array([1.0, float(np.abs(normal).max())])  # of similar columns, for the inverse
    inverse = np.linalg.inv((design / scale).T @ (design / scale)) / np.outer(scale, scale)
    cohesion, slope = (float(each) for each in inverse @ design.T @ shear)
    residual = shear - cohesion - slope * normal
    variance = float(residual @ residual) / (len(normal) - 2) if len(normal) > 2 else nan
    return cohesion, slope, variance * inverse


@dataclass
class Locus:
    """The runs of one yield locus: values of the parameters that they share, points, the locus, and remarks.

    regression:  the line through the points; None if they give none that rises
    line:        it with its Mohr circles; None if there is no yield locus; the remarks say why
    """

    values: Mapping[str, Any]
    points: Sequence[ShearPoint]
    preshear: tuple[float, float] = (nan, nan)
    regression: YieldLocus | None = None
    line: YieldLocus | None = None
    remarks: list[str] = field(default_factory=list)

    @property
    def texts(self) -> dict[str, str]:
        """The values as texts with units."""
        return {name: self.points[0].run.texts[name] for name in self.values}

    @property
    def used(self) -> list[ShearPoint]:
        """The points of the line."""
        return [each for each in self.points if each.is_used]


def locus_of(values: Mapping[str, Any], points: Sequence[ShearPoint]) -> Locus:
    """The yield locus of some shear points with the same preshear.

    Points to the left of where the circle through the origin touches the line are left out, and the line is
    formed again.
    """
    locus = Locus(values, points)
    if locus.used:
        stresses = np.array([each.preshear for each in locus.used])
        locus.preshear = float(stresses[:, 0].mean()), float(stresses[:, 1].mean())
    for each in locus.used:
        each.prorated = each.shear * locus.preshear[1] / each.preshear[1]
    while True:
        normal = np.array([each.normal for each in locus.used])
        if len(normal) < 2 or np.ptp(normal) < LEAST_SPAN * normal.max():
            locus.remarks.append(
                f"there is no yield locus: {len(normal)} of {len(points)} shear points are valid, and it "
                "needs two or more with different normal stresses"
            )
            return locus
        line = YieldLocus(
            *line_through(normal, np.array([each.prorated for each in locus.used])), locus.preshear
        )
        if line.slope <= 0.0:
            locus.remarks.append(
                f"there is no yield locus: its slope is {line.slope:.3g}, so that the shear stress at "
                "failure does not increase with the normal stress"
            )
            return locus
        outside = [each for each in locus.used if each.normal < line.least_normal]
        if not outside:
            break
        for each in outside:
            each.drop(
                f"the normal stress is below {line.least_normal:.4g} Pa, where the circle of the unconfined "
                "yield strength touches the yield locus"
            )
    locus.regression = line
    sigma, tau = locus.preshear
    excess = tau / (line.cohesion + line.slope * sigma) - 1.0
    if excess > ABOVE_LINE:
        locus.remarks.append(
            f"there are no Mohr circles: the preshear point is {100.0 * excess:.0f} % above the yield locus; "
            "use larger samples, more seeds, or normal stresses at failure nearer to that of the preshear"
        )
        return locus
    if excess < -BELOW_LINE:
        locus.remarks.append(
            f"the preshear point is {-100.0 * excess:.0f} % below the yield locus, but it is expected at its "
            "end: a sample that fails far above its steady flow is overconsolidated; check the preshear, and "
            "make the sample larger"
        )
    if excess > 0.0:
        locus.remarks.append(
            f"the preshear point, {100.0 * excess:.1f} % above the yield locus, is taken to lie on it"
        )
    if len(normal) == 2:
        locus.remarks.append("two points have no error; use three or more")
    if line.cohesion < 0.0:
        locus.remarks.append(
            f"the cohesion of the line is {line.cohesion:.3g} Pa: the unconfined yield strength is 0"
        )
    locus.line = line
    return locus


LEAST_SPAN = 0.02
"""Smallest difference of the normal stresses of a yield locus, over the largest one."""


def evaluate(evaluation: YieldLocusEvaluation, runs: Iterable[ShearTest]) -> list[Locus]:
    """The yield loci of all runs, in their order."""
    groups: dict[tuple[Any, ...], list[ShearTest]] = {}
    names: list[str] = []
    for run in runs:
        names = [name for name in run.values if name != evaluation.parameters.shear]
        groups.setdefault(tuple(run.values[name] for name in names), []).append(run)
    return [
        locus_of(dict(zip(names, key, strict=True)), [shear_point(evaluation, run) for run in group])
        for key, group in groups.items()
    ]


# Files

NUMBERS: Mapping[str, str] = {
    "preshear_normal_stress": "Pa",
    "preshear_shear_stress": "Pa",
    "cohesion": "Pa",
    "cohesion_error": "Pa",
    "friction_angle": "deg",
    "consolidation_stress": "Pa",
    "unconfined_yield_strength": "Pa",
    "unconfined_yield_strength_error": "Pa",
    "flowability": "",
    "effective_friction_angle": "deg",
    "steady_state_friction_angle": "deg",
}
"""Numbers of a yield locus, with their units in tables."""


def numbers_of(locus: Locus) -> dict[str, float]:
    """The NUMBERS of a yield locus by name; nan without one, or without Mohr circles."""
    found = dict.fromkeys(NUMBERS, nan)
    found["preshear_normal_stress"], found["preshear_shear_stress"] = locus.preshear
    fit = locus.regression
    if fit is not None:
        found |= {
            "cohesion": fit.cohesion,
            "cohesion_error": float(np.sqrt(fit.covariance[0, 0])),
            "friction_angle": degrees(fit.friction_angle),
            "steady_state_friction_angle": degrees(fit.steady_angle),
        }
    line = locus.line
    if line is not None:
        found |= {
            "consolidation_stress": line.consolidation_stress,
            "unconfined_yield_strength": line.unconfined_strength,
            "unconfined_yield_strength_error": line.unconfined_error,
            "flowability": line.flowability,
            "effective_friction_angle": degrees(line.effective_angle),
        }
    return found


def locus_columns(loci: Sequence[Locus]) -> dict[str, list[Any]]:
    """Columns of `yield_loci.csv`: parameters, numbers, class, numbers of points, remarks."""
    names = list(loci[0].values) if loci else []
    found: dict[str, list[Any]] = {name: [each.values[name] for each in loci] for name in names}
    for name, unit in NUMBERS.items():
        found[f"{name} [{unit}]" if unit else name] = [_cell(numbers_of(each)[name]) for each in loci]
    found["class"] = [class_of(numbers_of(each)["flowability"]) for each in loci]
    found["used_points"] = [len(each.used) for each in loci]
    found["points"] = [len(each.points) for each in loci]
    found["remarks"] = [" | ".join(each.remarks) for each in loci]
    return found


def point_columns(loci: Sequence[Locus]) -> dict[str, list[Any]]:
    """Columns of `shear_points.csv`: parameters, seed, stresses, whether the point is used, remarks, run."""
    points = [point for locus in loci for point in locus.points]
    names = list(points[0].run.values) if points else []
    found: dict[str, list[Any]] = {name: [each.run.values[name] for each in points] for name in names}
    found["seed"] = [each.run.seed for each in points]
    found["preshear_normal_stress [Pa]"] = [_cell(each.preshear[0]) for each in points]
    found["preshear_shear_stress [Pa]"] = [_cell(each.preshear[1]) for each in points]
    found["normal_stress [Pa]"] = [_cell(each.normal) for each in points]
    found["shear_stress [Pa]"] = [_cell(each.shear) for each in points]
    found["prorated_shear_stress [Pa]"] = [_cell(each.prorated) for each in points]
    found["used"] = ["yes" if each.is_used else "no" for each in points]
    found["remarks"] = [" | ".join(each.remarks) for each in points]
    found["run"] = [each.run.directory.name for each in points]
    return found


def _cell(value: float) -> float | None:
    return None if value != value else value


def write_loci(out: Path, evaluation: YieldLocusEvaluation, loci: Sequence[Locus]) -> Mapping[str, Drawing]:
    """Write `yield_loci.csv`, `shear_points.csv`, `yield_loci.json` and the figures into `out`.

    Returns the figures by file name; none without matplotlib.
    """
    for name, columns in (
        ("yield_loci.csv", locus_columns(loci)),
        ("shear_points.csv", point_columns(loci)),
    ):
        with replacing(out / name) as temporary:
            write_table(temporary, columns, zip(*columns.values(), strict=True))
    write_text(out / "yield_loci.json", json.dumps([_in_json(each) for each in loci], indent=2) + "\n")
    figures = figures_of(evaluation, loci)
    return {} if write_figures(out, figures) else figures


def _in_json(locus: Locus) -> dict[str, Any]:
    """A yield locus with its points, in SI units, angles in degrees; null without a number."""
    numbers = {name: value if isfinite(value) else None for name, value in numbers_of(locus).items()}
    return {
        "parameters": dict(locus.values),
        **numbers,
        "class": class_of(numbers_of(locus)["flowability"]),
        "points": [
            {
                "normal_stress": _cell(each.normal),
                "shear_stress": _cell(each.shear),
                "prorated_shear_stress": _cell(each.prorated),
                "used": each.is_used,
                "run": each.run.directory.name,
            }
            for each in locus.points
        ],
        "remarks": locus.remarks,
    }


# Tables and figures

KILO = 1e3
"""Pascal in a kilopascal: figures and shown tables have kPa."""
HEIGHT = 3.2
"""Height of a figure [inch]."""
LEGEND_COLUMNS = 3
"""Columns of the legend above the yield loci."""


def shown_table(loci: Sequence[Locus]) -> PageTable:
    """The yield loci for a terminal or a page, stresses in kPa, angles in degrees."""
    names = list(loci[0].values) if loci else []
    heads = [
        *(name.rpartition(".")[2] for name in names),
        "sigma_pre kPa", "tau_pre kPa", "c kPa", "phi deg", "sigma_1 kPa", "sigma_c kPa", "ff_c", "phi_e deg",
        "phi_sf deg", "class",
    ]  # fmt: skip
    rows = []
    for each in loci:
        n = numbers_of(each)
        strength = _shown(n["unconfined_yield_strength"] / KILO)
        if isfinite(error := n["unconfined_yield_strength_error"] / KILO):
            strength += f" ± {error:.2g}"
        rows.append(
            [
                *each.texts.values(),
                _shown(n["preshear_normal_stress"] / KILO),
                _shown(n["preshear_shear_stress"] / KILO),
                _shown(n["cohesion"] / KILO),
                _shown(n["friction_angle"]),
                _shown(n["consolidation_stress"] / KILO),
                strength,
                _shown(n["flowability"]),
                _shown(n["effective_friction_angle"]),
                _shown(n["steady_state_friction_angle"]),
                class_of(n["flowability"]),
            ]
        )
    return PageTable(heads, rows)


def _shown(value: float) -> str:
    return "–" if value != value else f"{value:.3g}"


def remarks_of(loci: Sequence[Locus]) -> list[str]:
    """Sentences on the yield loci and on their points, each with the values of its parameters."""
    found = []
    for locus in loci:
        name = _named(locus.texts)
        found += [f"{name}{remark}." for remark in locus.remarks]
        for point in locus.points:
            state = "" if point.is_used else " (left out)"
            found += [f"{_named(point.run.texts, state)}{remark}." for remark in point.remarks]
    return list(dict.fromkeys(found))


def _named(texts: Mapping[str, str], state: str = "") -> str:
    """Values of parameters before a remark."""
    found = ", ".join(f"{name.rpartition('.')[2]} = {text}" for name, text in texts.items())
    return f"{found}{state}: " if found else ""


def figures_of(evaluation: YieldLocusEvaluation, loci: Sequence[Locus]) -> dict[str, Drawing]:
    """The sigma-tau diagram with all yield loci, and the flow functions, if there are any."""
    if not any(isfinite(point.normal) for locus in loci for point in locus.points):
        return {}
    found = {"yield_loci.png": Drawing(lambda figure: _draw_loci(figure, loci), HEIGHT, FULL_WIDTH)}
    if functions := flow_functions(evaluation, loci):
        found["flow_function.png"] = Drawing(lambda figure: _draw_functions(figure, functions), HEIGHT)
    return found


def flow_functions(
    evaluation: YieldLocusEvaluation, loci: Sequence[Locus]
) -> dict[str, tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """sigma_1, sigma_c and the error of sigma_c [Pa], each (k,), by the values of the other parameters; those
    with at least two points."""
    groups: dict[str, list[YieldLocus]] = {}
    for locus in loci:
        if locus.line is not None and evaluation.parameters.preshear is not None:
            others = {k: v for k, v in locus.texts.items() if k != evaluation.parameters.preshear}
            groups.setdefault(_named(others).rstrip(": "), []).append(locus.line)
    found = {}
    for name, lines in groups.items():
        if len(lines) > 1:
            lines.sort(key=lambda each: each.consolidation_stress)
            found[name] = (
                np.array([each.consolidation_stress for each in lines]),
                np.array([each.unconfined_strength for each in lines]),
                np.array([each.unconfined_error for each in lines]),
            )
    return found


def _draw_loci(figure: Any, loci: Sequence[Locus]) -> None:
    """Shear points (open if left out), preshear points (filled), yield loci and Mohr circles."""
    axes = figure.subplots()
    angles = np.linspace(0.0, np.pi, 200)
    right = top = 0.0
    for k, locus in enumerate(loci):
        color = COLORS[k % len(COLORS)]
        for point in locus.points:
            face = color if point.is_used else "white"
            axes.plot(
                point.normal / KILO, (point.prorated if point.is_used else point.shear) / KILO, color=color,
                marker="o", markersize=3.5, markerfacecolor=face, linestyle="none",
            )  # fmt: skip
        sigma, tau = locus.preshear
        axes.plot(
            sigma / KILO, tau / KILO, color=color, marker="s", markersize=4.5, linestyle="none",
            label=_named(locus.texts).rstrip(": ") or None,
        )  # fmt: skip
        points = [(point.normal, point.shear) for point in locus.points] + [locus.preshear]
        right, top = (float(each) for each in np.nanmax([*points, (right, top)], axis=0))
        fit = locus.regression
        if fit is None:
            continue
        ends = np.array([0.0, sigma])
        axes.plot(ends / KILO, (fit.cohesion + fit.slope * ends) / KILO, color=color)
        line = locus.line
        if line is None:
            continue
        circles = ((line.center, line.radius), (line.unconfined_center, line.unconfined_center))
        for center, radius in circles:
            if radius > 0.0:
                x, y = center + radius * np.cos(angles), radius * np.sin(angles)
                axes.plot(x / KILO, y / KILO, color=color, linewidth=0.6)
        right, top = max(right, line.consolidation_stress), max(top, line.radius)
    axes.set(xlabel=r"normal stress $\sigma$ [kPa]", ylabel=r"shear stress $\tau$ [kPa]")
    axes.set_xlim(0.0, 1.05 * right / KILO)
    axes.set_ylim(0.0, 1.1 * top / KILO)
    axes.set_aspect("equal")
    if any(locus.values for locus in loci):
        axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=LEGEND_COLUMNS)


def _draw_functions(figure: Any, functions: Mapping[str, tuple[np.ndarray, ...]]) -> None:
    """sigma_c over sigma_1, and the lines of constant ff_c between the classes."""
    axes = figure.subplots()
    right = 1.15 * max(float(stress.max()) for stress, _, _ in functions.values()) / KILO
    top = 1.3 * max(float(strength.max()) for _, strength, _ in functions.values()) / KILO or right
    for k, (name, (stress, strength, error)) in enumerate(functions.items()):
        axes.errorbar(
            stress / KILO, strength / KILO, np.nan_to_num(error) / KILO, color=COLORS[k % len(COLORS)],
            marker=MARKERS[k % len(MARKERS)], markersize=4.0, label=name or None,
        )  # fmt: skip
    for bound, _ in CLASSES[:-1]:
        axes.plot([0.0, right], [0.0, right / bound], color=COLORS[8], linewidth=0.5, linestyle="--")
        x = min(right, top * bound)
        axes.annotate(
            f"{bound:g}", (x, x / bound), color=COLORS[8], fontsize=8, ha="right", va="top", xytext=(-2, -2),
            textcoords="offset points",
        )  # fmt: skip
    axes.set(
        xlabel=r"consolidation stress $\sigma_1$ [kPa]", ylabel=r"unconfined yield strength $\sigma_c$ [kPa]"
    )
    axes.set_xlim(0.0, right)
    axes.set_ylim(0.0, top)
    if any(functions):
        axes.legend(loc="upper left")
