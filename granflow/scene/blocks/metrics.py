"""Metrics: numbers of the time series that a snapshot gives, such as a mixing index or an angle of repose.

A kind of metric is one class below. It has the keys of the kind, the quantities that it yields, the parts of
a snapshot that it reads, its checks against the rest of the scene, and its measurement. The formulas,
functions of arrays, precede it. `AnyMetric` at the end lists the kinds; a program adds others with
`granflow.register_metric`. `observers.metrics` evaluates the
metrics of a run for each row of the time series.
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import nan, pi
from typing import Annotated, ClassVar, Literal, Protocol, get_args

import numpy as np
from pydantic import Field

from granflow.arguments import shown
from granflow.fields import METRIC_PARTS, METRIC_QUANTITIES, STAGE_PARTS, Quantity, parts_with
from granflow.geometry.coarse_grid import CoarseGrid
from granflow.geometry.vectors import RIGHT_ANGLE_COSINE, frame_along, is_parallel
from granflow.scene.blocks.domain import Domain
from granflow.scene.blocks.grids import GridSpec
from granflow.scene.blocks.particles import Group
from granflow.scene.blocks.primitives import Box
from granflow.schema import quantities as q
from granflow.schema.faults import Fault, whole
from granflow.schema.messages import selecting_keys, unknown_names
from granflow.schema.model import (
    GroupNames,
    MaterialNames,
    Model,
    WallNames,
    choose_by_key,
    is_name,
    optional,
)
from granflow.schema.quantities import Vector3
from granflow.snapshot import (
    CONTACTS,
    PARTICLES,
    PARTS,
    WALLS,
    Snapshot,
    bodies_of,
    body_ids,
    mobile_particles,
    selected,
    touching,
)

# What a metric is


class CheckedScene(Protocol):
    """The sections of a scene that checks of metrics read."""

    @property
    def domain(self) -> Domain:
        """The simulated box."""

    @property
    def usual_gravity(self) -> Vector3:
        """The largest gravity that the scene gives [m/s2]."""

    @property
    def particles(self) -> Mapping[str, Group]:
        """Groups of particles by name."""

    @property
    def scale(self) -> float:
        """Factor of equipment lengths."""


class CheckedParts(Protocol):
    """The scene that contains a metric, which may lack parts; `scene.checks.PartialScene` is one."""

    @property
    def scene(self) -> CheckedScene:
        """The valid sections."""

    def names(self, section: str) -> tuple[str, ...]:
        """All names in a section of the file."""


@dataclass(frozen=True)
class MeasuredScene:
    """What measurements need to know of the scene of a run.

    groups, materials, walls:  names; the index of a name is that in the arrays of a snapshot
    densities:                 of the materials [kg/m3]
    planes:                    of each flat wall a point (3,) [m] and the unit normal (3,), at rest
    """

    domain: Domain
    gravity: Vector3
    groups: tuple[str, ...]
    materials: tuple[str, ...]
    densities: tuple[float, ...]
    walls: tuple[str, ...]
    planes: Mapping[str, tuple[np.ndarray, np.ndarray]] = field(default_factory=dict)


@dataclass(frozen=True)
class Reading:
    """Numbers by name of the quantity.

    `remark`: a sentence, for a warning if the reading is the last one of a run; may be empty.
    """

    numbers: Mapping[str, float]
    remark: str = ""


class Metric(Model):
    """Numbers that a snapshot gives. Base class of the kinds.

    `quantities`: what it yields; the time series adds the mean of each, NAME_mean. `wants`: parts that a
    snapshot must have.
    """

    quantities: ClassVar[tuple[Quantity, ...]]
    wants: ClassVar[frozenset[str]] = frozenset({PARTICLES})

    def faults_in(self, parts: CheckedParts) -> Iterator[Fault]:
        """Contradictions to the rest of the scene; key paths begin at the metric."""
        yield from ()

    def measure(self, snapshot: Snapshot, scene: MeasuredScene) -> Reading:
        """The numbers of a snapshot, which has the parts `wants`, in the order of `quantities`."""
        raise NotImplementedError


# Shared by several metrics
#
# A clump is one particle with its center of mass, its mass and the diameter of its largest sphere
# (`bodies_of`), except where its surface counts: in the angle of repose and the height.

MIN_CONTACTS = 2
"""Smallest number of contacts, with particles and walls, of a particle that carries a load."""


def _volume(particles: Mapping[str, np.ndarray], scene: MeasuredScene) -> np.ndarray:
    """Volume (n,) [m3] of particles; of a clump, and of a sphere of one its part, without overlaps."""
    return np.asarray(particles["mass"].astype(float) / np.array(scene.densities)[particles["material"]])


def _wall_contacts(particles: Mapping[str, np.ndarray]) -> np.ndarray:
    """The number of contacts of each particle with walls (n,); zeros in a scene without walls."""
    return particles.get("wall_contact_count", np.zeros(len(particles["position"]), np.int32))


def _inside(points: np.ndarray, region: Box | None) -> np.ndarray:
    """Whether points (n, 3) [m] are inside the region; True without a region."""
    if region is None:
        return np.ones(len(points), bool)
    above = points >= np.array(region.min)
    below = points <= np.array(region.max)
    return np.asarray(np.logical_and(above, below).all(axis=1))


def _in_groups(
    particles: Mapping[str, np.ndarray], names: Collection[str] | None, scene: MeasuredScene
) -> np.ndarray:
    """Whether each particle (n,) belongs to one of the groups; to any without names."""
    numbers = [scene.groups.index(name) for name in names or scene.groups]
    return np.isin(particles["group"], numbers)


def _bodies(particles: Mapping[str, np.ndarray]) -> np.ndarray:
    """Number (n,), from 0, of the clump of each sphere, or of a sphere without one."""
    body: np.ndarray = np.unique(body_ids(particles), return_inverse=True)[1]
    return body


def _contacts_of_bodies(particles: Mapping[str, np.ndarray]) -> np.ndarray:
    """The number of contacts (n,), with particles and walls, of the clump of each sphere, or of a sphere
    without one."""
    body = _bodies(particles)
    return np.asarray(np.bincount(body, particles["coordination_number"] + _wall_contacts(particles))[body])


def _mean(values: np.ndarray) -> float:
    return float(values.mean()) if len(values) else float("nan")


# Shares of two components


class TwoComponentGrid(GridSpec, Metric):
    """Grid for the shares of two components: particles of some groups, materials or sizes, and all others."""

    groups: GroupNames | None = Field(
        None, description="groups whose particles form the first component", examples=[["red"]]
    )
    materials: MaterialNames | None = Field(
        None, description="materials whose particles form the first component"
    )
    smaller_than: q.UnscaledLength | None = Field(
        None, description="diameter below which particles belong to the first component [m]"
    )

    def faults(self) -> Iterator[Fault]:
        """Yield a fault unless exactly one definition of the first component is given."""
        yield from super().faults()
        given = [key for key in ("groups", "materials", "smaller_than") if getattr(self, key) is not None]
        if len(given) != 1:
            found = f"has {' and '.join(given)}" if given else "does not define the first component"
            yield whole((), f"{found}; give exactly one of groups, materials and smaller_than")

    def faults_in(self, parts: CheckedParts) -> Iterator[Fault]:
        """See `Metric`."""
        yield from self.too_many_cells(parts.scene.domain)
        yield from unknown_names(("groups",), self.groups, parts.names("particles"), "group")
        yield from unknown_names(("materials",), self.materials, parts.names("materials"), "material")

    def is_first(self, particles: Mapping[str, np.ndarray], scene: MeasuredScene) -> np.ndarray:
        """Whether each particle (n,) belongs to the first component."""
        if self.smaller_than is not None:
            return np.asarray(2.0 * particles["radius"] < self.smaller_than)
        groups = [scene.groups.index(name) for name in self.groups or ()]
        materials = [scene.materials.index(name) for name in self.materials or ()]
        return np.isin(particles["group"], groups) | np.isin(particles["material"], materials)

    def reason_without(self, position: np.ndarray, is_first: np.ndarray, grid: CoarseGrid) -> str:
        """Why particles at `position` (n, 3) [m] form no mixture of two components in cells; may be empty."""
        cell, inside = grid.cells_of(position)
        if not inside.any():
            return "there are no particles in the grid"
        count = int(is_first[inside].sum())
        if count in (0, inside.sum()):
            which = "second" if count == 0 else "first"
            return f"all {inside.sum()} particles in the grid belong to the {which} component"
        if len(np.unique(cell[inside])) == 1:
            return "all particles are in one cell; decrease cell"
        return ""

    def size_remark(self, radius: np.ndarray, is_first: np.ndarray) -> str:
        """That components by size hardly differ in size, for radii (n,) [m]; otherwise empty."""
        if self.smaller_than is None or is_first.all() or not is_first.any():
            return ""
        ratio = float(radius[~is_first].mean() / radius[is_first].mean())
        if ratio >= SIZE_RATIO:
            return ""
        return (
            f"the mean diameters of both components differ by {ratio - 1.0:.2g} of the smaller one: "
            "particles of such similar sizes hardly segregate by size, and the number is that of tracers"
        )


SIZE_RATIO = 1.1
"""Ratio of the mean diameters below which a remark says that two components by size hardly differ."""


# Mixing of two kinds of particles, by number: Lacey's index

DROPPED_SHARE = 0.1
"""Share of the particles of a component outside the cells of a Lacey index above which a remark reports
it."""


def lacey_index(position: np.ndarray, is_kind_a: np.ndarray, grid: CoarseGrid, at_least: int) -> float:
    """Lacey's mixing index of particles at `position` (n, 3) [m].

    `is_kind_a` (n,): whether of the first kind.

        M = (S0^2 - S^2) / (S0^2 - SR^2)
        S^2 = sum n_k (p_k - p)^2 / sum n_k,   S0^2 = p (1 - p),   SR^2 = S0^2 / n

    p_k is the share by number of the first kind among the n_k particles of cell k, p the share in all cells,
    n the mean of n_k; cells with fewer than `at_least` particles are excluded. 0: each cell contains one kind
    only; 1: randomly mixed, except for statistical scatter; above 1: more uniform than random. NaN with fewer
    than two cells or with one kind. (P. M. C. Lacey, J. Appl. Chem. 4 (1954) 257.)
    """
    cell, inside = grid.cells_of(position)
    number = np.bincount(cell[inside], minlength=grid.cell_count)
    kind = np.bincount(cell[inside], weights=is_kind_a[inside], minlength=grid.cell_count)
    used = number >= max(at_least, 1)
    number = number[used]
    kind = kind[used]
    total = number.sum()
    share = kind.sum() / total if total else np.nan
    segregated = share * (1.0 - share)
    mixed = segregated * len(number) / total if total else np.nan
    if len(number) < 2 or not segregated > mixed:
        return float("nan")
    found = (number * (kind / number - share) ** 2).sum() / total
    return float((segregated - found) / (segregated - mixed))


def dropped_share(position: np.ndarray, is_kind_a: np.ndarray, grid: CoarseGrid, at_least: int) -> float:
    """The share by number of the particles of one kind that `lacey_index` excludes, the larger of both kinds.

    Arguments as `lacey_index`. 0 without particles in the grid.
    """
    cell, inside = grid.cells_of(position)
    number = np.bincount(cell[inside], minlength=grid.cell_count)
    is_dropped = number[cell[inside]] < at_least
    is_kind_a = is_kind_a[inside]
    return max(
        (float(is_dropped[kind].mean()) for kind in (is_kind_a, ~is_kind_a) if kind.any()), default=0.0
    )


class LaceyMetric(TwoComponentGrid):
    """Lacey mixing index of the particles of some groups, materials or sizes among all particles, by number.

    0: separated, 1: randomly mixed. (P. M. C. Lacey, J. Appl. Chem. 4 (1954) 257.) For components of
    different sizes, `kind: segregation` weights particles by their volume.

    >>> gf.LaceyMetric(cell="1 cm", groups=["red"]).cell
    0.01
    """

    kind: Literal["lacey"] = Field("lacey", description="kind of metric")
    at_least: q.Count = Field(10, description="smallest number of particles in a cell that is evaluated")
    quantities = (Quantity("lacey_index", "M", "1", "Lacey's mixing index: 0 segregated, 1 randomly mixed"),)

    def measure(self, snapshot: Snapshot, scene: MeasuredScene) -> Reading:
        """See `Metric`; the remark says that more than DROPPED_SHARE of a component is excluded."""
        particles = mobile_particles(bodies_of(snapshot.particles))
        is_first = self.is_first(particles, scene)
        arguments = particles["position"], is_first, self.grid_in(scene.domain), self.at_least
        index = lacey_index(*arguments)
        dropped = dropped_share(*arguments)
        reason = self.reason_without(arguments[0], is_first, arguments[2]) if np.isnan(index) else ""
        if reason:
            remark = f"the Lacey index is NaN: {reason}"
        elif dropped > DROPPED_SHARE:
            remark = (
                f"the Lacey index excludes {dropped:.0%} of the particles of one component, because their "
                f"cells contain fewer than {self.at_least} particles (at_least): increase cell, or use kind: "
                "segregation, which weights particles by volume and excludes no cell"
            )
        elif np.isnan(index):
            few = f"fewer than two cells contain {self.at_least} particles (at_least), or all contain one"
            remark = f"the Lacey index is NaN: {few}; increase cell"
        else:
            remark = self.size_remark(particles["radius"], is_first)
        return Reading({"lacey_index": index}, remark)


# Segregation of two kinds of particles, by volume


RANDOM_LIMIT = 0.2
"""Intensity of a random mixture above which a remark says that the cells contain few particles: five of equal
size."""


def segregation_intensity(
    position: np.ndarray, volume: np.ndarray, is_kind_a: np.ndarray, grid: CoarseGrid
) -> float:
    """The intensity of segregation of particles at `position` (n, 3) [m] with volumes (n,) [m3].

        I = sum V_k (c_k - c)^2 / (c (1 - c) sum V_k)

    V_k: volume of the particles with centers in cell k; c_k, c: share by volume of the first kind
    (`is_kind_a` (n,)) in cell k and in all cells. 1: each cell contains one kind only; 0: the same share in
    all cells. No cell is excluded. NaN with one kind or one cell. (sigma^2 / (c (1 - c)) of
    P. V. Danckwerts, Appl. Sci. Res. A 3 (1952) 279, with samples weighted by their volume.)
    """
    cell, inside = grid.cells_of(position)
    total = np.bincount(cell[inside], weights=volume[inside], minlength=grid.cell_count)
    first = np.bincount(cell[inside], weights=(volume * is_kind_a)[inside], minlength=grid.cell_count)
    first = first[total > 0.0]
    total = total[total > 0.0]
    share = first.sum() / total.sum() if len(total) else np.nan
    segregated = share * (1.0 - share) * total.sum()
    if len(total) < 2 or not segregated > 0.0:
        return float("nan")
    return float((total * (first / total - share) ** 2).sum() / segregated)


def random_intensity(
    position: np.ndarray, volume: np.ndarray, is_kind_a: np.ndarray, grid: CoarseGrid
) -> float:
    """The expected intensity of segregation of a random mixture of the same particles in the same cells.

        I_R = K (c v_b + (1 - c) v_a) / sum V_k,      v_a, v_b = sum v^2 / sum v

    K: number of cells with particles; v_a, v_b: mean volumes of the particles of each kind, weighted by
    volume. In a random mixture, the volumes V_a and V_b in a cell are sums over independent particles, with
    the variances V_a v_a and V_b v_b. To first order, the variance of c = V_a / (V_a + V_b) = V_a / V is

        ((1 - c)^2 V_a v_a + c^2 V_b v_b) / V^2 = c (1 - c) (c v_b + (1 - c) v_a) / V

    For equal volumes v, it is that of Lacey, c (1 - c) v / V. Arguments as `segregation_intensity`; NaN with
    one kind.
    """
    cell, inside = grid.cells_of(position)
    volume = volume[inside]
    is_kind_a = is_kind_a[inside]
    if is_kind_a.all() or not is_kind_a.any():
        return float("nan")
    first = volume[is_kind_a]
    second = volume[~is_kind_a]
    mean_a = (first**2).sum() / first.sum()
    mean_b = (second**2).sum() / second.sum()
    share = first.sum() / volume.sum()
    return float(len(np.unique(cell[inside])) * (share * mean_b + (1.0 - share) * mean_a) / volume.sum())


class SegregationMetric(TwoComponentGrid):
    """Intensity of segregation of two components by volume, and its value for a random mixture.

    If that value is above RANDOM_LIMIT, the cells contain too few particles, which a warning says.

    1: each cell contains one component only, 0: the same share in all cells. (P. V. Danckwerts, Appl. Sci.
    Res. A 3 (1952) 279.)

    >>> gf.SegregationMetric(cell="1 cm", smaller_than="2 mm").smaller_than
    0.002
    """

    kind: Literal["segregation"] = Field("segregation", description="kind of metric")
    quantities = (
        Quantity(
            "segregation_intensity", "I", "1", "intensity of segregation by volume: 1 segregated, 0 uniform"
        ),
        Quantity(
            "segregation_intensity_random", "I_R", "1", "the same for a random mixture of the same particles"
        ),
    )

    def measure(self, snapshot: Snapshot, scene: MeasuredScene) -> Reading:
        """See `Metric`; the remark gives the reason of a value without meaning."""
        particles = mobile_particles(bodies_of(snapshot.particles))
        volume = _volume(particles, scene)
        is_first = self.is_first(particles, scene)
        grid = self.grid_in(scene.domain)
        arguments = particles["position"], volume, is_first, grid
        intensity = segregation_intensity(*arguments)
        random = random_intensity(*arguments)
        numbers = {"segregation_intensity": intensity, "segregation_intensity_random": random}
        if np.isnan(intensity):
            reason = self.reason_without(particles["position"], is_first, grid)
            return Reading(numbers, f"the intensity of segregation is NaN: {reason}")
        if random > RANDOM_LIMIT:
            remark = (
                f"a random mixture of these particles has an intensity of segregation of {random:.2g}, "
                "because the cells contain few of them, so that smaller intensities are chance; increase cell"
            )
            return Reading(numbers, remark)
        return Reading(numbers, self.size_remark(particles["radius"], is_first))


# Angle of repose
#
# The surface of a heap, or of a bed in a drum, consists of the highest particle of each square column; a line
# or plane is fitted to the tops of these spheres.

COLUMN_WIDTH = 2.0
"""Edge of the columns in which the surface of a heap is determined, in Sauter mean diameters."""
FLANK = (0.8, 0.2)
"""Upper and lower end of the fitted flank, over the height of the cone: excludes the rounded top and the
foot."""
FEWEST = 4
"""Smallest number of surface points for a fit."""
SIGNIFICANCE = 0.05
"""Largest share of rough level surfaces, with independent heights of the points, that a fit takes for a
slope."""
RELATIVE_ERROR = 0.25
"""Largest standard error of a gradient over its magnitude."""


@dataclass(frozen=True)
class Slope:
    """Angle to the horizontal and its standard error from the scatter about the fit [rad].

    Both are NaN if the surface has no slope; `reason` is then a sentence. `remark`: a sentence on a doubtful
    slope.
    """

    angle: float
    error: float
    reason: str = ""
    remark: str = ""


def no_slope(reason: str) -> Slope:
    """A slope that is NaN, with the reason."""
    return Slope(float("nan"), float("nan"), reason)


def slope_of_cone(
    points: np.ndarray, radius: np.ndarray, edge: float, axis: np.ndarray | None = None
) -> Slope:
    """The slope of the flank of a conical heap of spheres with centers (n, 3), z upward, and radii (n,) [m].

    `edge` [m]: of the columns, see `column_edge`; `axis` (2,) [m]: of the cone, the mean of all centers if
    None. The flank is where the mean height of a ring around the axis is between 0.8 and 0.2 of the largest;
    a straight line is fitted to the height over the distance from the axis by least squares. The angle is not
    negative. NaN without particles, with fewer than FEWEST surface points on the flank, or if the fit is not
    significant, see `_slope`.
    """
    if not len(points):
        return no_slope("there are no particles with enough contacts in the region")
    middle = points[:, :2].mean(axis=0) if axis is None else axis
    surface = surface_points(points, radius, edge)
    distance = np.linalg.norm(surface[:, :2] - middle, axis=1)
    height = surface[:, 2] - (points[:, 2] - radius).min()
    ring = (distance / edge).astype(int)
    number = np.bincount(ring)
    mean = np.divide(np.bincount(ring, height), number, out=np.zeros(len(number)), where=number > 0)
    flank = (mean <= FLANK[0] * mean.max()) & (mean >= FLANK[1] * mean.max())
    flank[: int(mean.argmax())] = False
    selected = flank[ring]
    return _slope(distance[selected, None], height[selected])


def slope_of_plane(points: np.ndarray, radius: np.ndarray, edge: float) -> Slope:
    """The slope of the plane fitted to the surface of spheres with centers (n, 3), z upward, and radii
    (n,) [m].

    `edge` [m]: of the columns. For one side of a wedge, or for the middle of a drum. NaN without particles,
    with fewer than FEWEST surface points, if these lie on a line, or if the fit is not significant, see
    `_slope`. The remark of a curved surface says how steep its steepest part is, see `_steepest`.
    """
    if not len(points):
        return no_slope("there are no particles with enough contacts in the region")
    surface = surface_points(points, radius, edge)
    slope = _slope(surface[:, :2], surface[:, 2])
    steepest = _steepest(surface[:, :2], surface[:, 2]) if not slope.reason else None
    if steepest is None or steepest - slope.angle < CURVED:
        return slope
    return replace(
        slope,
        remark=(
            f"the surface is curved: the plane has {np.rad2deg(slope.angle):.3g} deg, the steepest part of "
            f"the surface {np.rad2deg(steepest):.3g} deg. A crest or a foot inside the region lowers the "
            "angle; choose a region on the straight part"
        ),
    )


CURVED = np.deg2rad(4.0)
"""Difference [rad] of the steepest part of a surface to its plane from which a remark says so."""
INNER = 0.8
"""Share of the extent of a surface in which its steepest part is searched: at its ends, a cubic has the
largest error."""


def _steepest(position: np.ndarray, height: np.ndarray) -> float | None:
    """Steepest angle [rad] of the surface along the gradient of its plane, of a fitted cubic; None if the
    cubic is better than the plane by chance in more than one of a thousand plane surfaces (F-test).

    position (n, 2) [m], height (n,) [m]
    """
    offsets = position - position.mean(axis=0)
    plane = np.column_stack([np.ones(len(height)), offsets])
    found, _, _, _ = np.linalg.lstsq(plane, height, rcond=None)
    along = found[1:] / np.linalg.norm(found[1:])
    half = 0.5 * float(np.ptp(offsets @ along))
    share = offsets @ along / half
    freedom = len(height) - 5
    cubic = np.column_stack([plane, share**2, share**3])
    better, _, rank, _ = np.linalg.lstsq(cubic, height, rcond=None)
    if freedom < 1 or rank < 5:
        return None
    before = float(((height - plane @ found) ** 2).sum())
    after = float(((height - cubic @ better) ** 2).sum())
    if not before > 0.0 or not _chance(after / before, 2, freedom) < 0.001:
        return None
    places = np.linspace(-INNER, INNER, 33)
    slopes = better[1:3] @ along + (2.0 * better[3] * places + 3.0 * better[4] * places**2) / half
    return float(np.arctan(slopes.max()))


def column_edge(radius: np.ndarray) -> float:
    """Edge [m] of the columns for spheres with radii (n,) [m]: COLUMN_WIDTH Sauter mean diameters.

        d32 = sum d^3 / sum d^2

    Of the area of a section through a packing, particles of each size have the same share as of its volume,
    so that their number per area is that share over d^2 and the spacing of particles in the surface follows
    the frequent small ones. Few large particles do not widen the columns: in wide columns, the highest
    particle is an outlier and the surface too high. (J. Sauter, Forschungsarb. Ing.-Wes. 279 (1926).)
    """
    share = radius / radius.max()  # exact for equal radii
    return COLUMN_WIDTH * 2.0 * float(radius.max() * ((share**3).sum() / (share**2).sum()))


def surface_points(points: np.ndarray, radius: np.ndarray, edge: float) -> np.ndarray:
    """The tops (m, 3) [m] of the highest spheres, one for each column that contains spheres.

    The columns are about `edge` [m] wide and divide the extent of the points evenly: in a narrow column at
    the border, the highest sphere would be deep inside the heap. A top inside or below a larger sphere, whose
    center is in another column, is no point of the surface.
    """
    low = points[:, :2].min(axis=0)
    extent = np.maximum(points[:, :2].max(axis=0) - low, np.finfo(float).tiny)
    number = np.maximum(np.round(extent / edge), 1)
    column = np.minimum((points[:, :2] - low) / extent * number, number - 1).astype(np.int64)
    top = points[:, 2] + radius
    order = np.lexsort((-top, column[:, 1], column[:, 0]))
    changes = (np.diff(column[order], axis=0) != 0).any(axis=1)
    first = order[np.flatnonzero(np.append(True, changes))]
    found = np.column_stack([points[first, :2], top[first]])
    return found[~_are_hidden(found, radius[first])]


def _are_hidden(tops: np.ndarray, radius: np.ndarray) -> np.ndarray:
    """Which of the tops (m, 3) [m] of spheres with radii (m,) [m] are inside or below a larger one."""
    from scipy.spatial import cKDTree

    hidden = np.zeros(len(tops), bool)
    larger = np.flatnonzero(radius > radius.min())
    if not len(larger):
        return hidden
    lists = cKDTree(tops[:, :2]).query_ball_point(tops[larger, :2], radius[larger])
    below = np.concatenate(lists).astype(np.int64)
    above = np.repeat(larger, [len(each) for each in lists])
    offset = ((tops[below, :2] - tops[above, :2]) ** 2).sum(axis=1)
    upper = tops[above, 2] - radius[above] + np.sqrt(np.maximum(radius[above] ** 2 - offset, 0.0))
    hidden[below[(radius[below] < radius[above]) & (tops[below, 2] < upper)]] = True
    return hidden


def _slope(position: np.ndarray, height: np.ndarray) -> Slope:
    """The angle of the line or plane fitted to heights (n,) [m] over horizontal positions (n, d = 1 or
    2) [m].

        angle = arctan |g|,      error = sqrt(d C d) / (1 + |g|^2)

    g: gradient, d = g / |g|, C: covariance of g from the residuals of the least-squares fit. The fit is a
    slope if a level surface with independent, normally distributed heights has the same coefficient of
    determination R^2 with a probability below SIGNIFICANCE (F-test of the regression), and if sqrt(d C d) is
    at most RELATIVE_ERROR |g|. The second condition is the stricter one for few points, or if the points
    extend little along g.
    """
    if len(height) < FEWEST:
        return no_slope(f"the surface has {len(height)} points, but a fit needs at least {FEWEST}")
    offsets = position - position.mean(axis=0)
    matrix = np.column_stack([np.ones(len(height)), offsets])
    found, _, rank, _ = np.linalg.lstsq(matrix, height, rcond=None)
    if rank < matrix.shape[1]:
        return no_slope("the points of the surface lie on a line")
    gradient = found[1:]
    freedom = len(height) - matrix.shape[1]
    steepness = float(np.linalg.norm(gradient))
    residual = height - matrix @ found
    total = float(((height - height.mean()) ** 2).sum())
    unexplained = float(residual @ residual) / total if total > 0.0 else 1.0
    spread = np.linalg.inv(matrix.T @ matrix)[1:, 1:] * (residual @ residual) / freedom
    along = gradient / steepness if steepness > 0.0 else gradient
    error = float(np.sqrt(along @ spread @ along))
    if not _chance(unexplained, len(gradient), freedom) < SIGNIFICANCE:
        return no_slope(
            f"the fit to {len(height)} points of the surface explains {1.0 - unexplained:.0%} of the "
            "variance of their heights, and rough level surfaces reach as much by chance: the surface is not "
            "a slope, or the region is too small"
        )
    if error > RELATIVE_ERROR * steepness:
        return no_slope(
            f"the gradient of the fit to {len(height)} points of the surface has a standard error of "
            f"{error / steepness:.0%} of it, above {RELATIVE_ERROR:.0%}: the region is too small or too "
            "narrow"
        )
    return Slope(float(np.arctan(steepness)), error / (1.0 + steepness**2))


def _chance(unexplained: float, slopes: int, freedom: int) -> float:
    """Probability that a fit of `slopes` coefficients to independent heights leaves at most this share
    unexplained.

    The share 1 - R^2 has the beta distribution with the parameters freedom / 2 and slopes / 2.
    """
    from scipy.special import betainc

    return float(betainc(0.5 * freedom, 0.5 * slopes, min(unexplained, 1.0)))


class ReposeMetric(Metric):
    """Angle of repose [rad] of the heap; particles with fewer than two contacts are excluded.

    The angle is that of a line or plane fitted to the tops of the highest particles.

    >>> gf.ReposeMetric(surface="cone")
    ReposeMetric(surface='cone')
    """

    kind: Literal["repose"] = Field("repose", description="kind of metric")
    surface: Literal["cone", "plane"] = Field(
        description="cone: a heap around a vertical axis; plane: one side of a wedge, or the bed in a drum"
    )
    region: Box | None = optional("box whose particles are evaluated", "all particles")
    axis: q.Point | None = optional(
        "with surface: cone, a point on its axis [m]", "mean position of the particles"
    )
    quantities = (
        Quantity("angle_of_repose", "", "rad", "slope of the free surface"),
        Quantity("angle_of_repose_error", "", "rad", "standard error of the slope"),
    )

    def faults(self) -> Iterator[Fault]:
        """Yield a fault for an axis with a plane: it applies to a cone only."""
        if self.surface == "plane" and self.axis is not None:
            yield Fault(("axis",), "it applies only to surface: cone; remove it")

    def faults_in(self, parts: CheckedParts) -> Iterator[Fault]:
        """See `Metric`."""
        if not any(parts.scene.usual_gravity):
            yield Fault(("kind",), "gravity is zero, so the slope is undefined; remove this metric")

    def measure(self, snapshot: Snapshot, scene: MeasuredScene) -> Reading:
        """See `Metric`; the vertical is opposite to gravity, also if gravity is inclined.

        Particles with fewer than MIN_CONTACTS contacts are not part of the heap: one that rolls away on the
        floor has one.
        """
        frame = frame_along(-np.array(scene.gravity) / np.linalg.norm(scene.gravity))
        particles = mobile_particles(snapshot.particles)
        rests = _contacts_of_bodies(particles) >= MIN_CONTACTS
        heap = selected(particles, rests & _inside(particles["position"], self.region))
        points = heap["position"].astype(float) @ frame.T
        edge = column_edge(heap["radius"].astype(float)) if len(points) else 0.0
        if self.surface == "cone":
            axis = None if self.axis is None else (frame @ np.array(self.axis))[:2]
            slope = slope_of_cone(points, heap["radius"], edge, axis)
        else:
            slope = slope_of_plane(points, heap["radius"], edge)
        numbers = {"angle_of_repose": slope.angle, "angle_of_repose_error": slope.error}
        why = slope.reason and f"the angle of repose is NaN: {slope.reason}"
        return Reading(numbers, why or slope.remark)


# Height of a bed or heap


def height_of_share(height: np.ndarray, radius: np.ndarray, volume: np.ndarray, share: float) -> float:
    """The height [m] below which a share of the volume of particles lies; NaN without particles.

    height (n,): of the centers of spheres [m]; radius (n,) [m]; volume (n,) [m3]: of each sphere, or its part
    of the volume of a clump, without overlaps; share: above 0, at most 1. A sphere that the level cuts counts
    with the share of its cap of the height h, pi h^2 (r - h/3). The root is found by bisection.
    """
    if not len(height):
        return float("nan")
    low = float((height - radius).min())
    high = float((height + radius).max())
    wanted = share * float(volume.sum())
    while (middle := 0.5 * (low + high)) not in (low, high):
        cap = np.clip(0.5 * (middle - height + radius) / radius, 0.0, 1.0)
        if float((volume * cap**2 * (3.0 - 2.0 * cap)).sum()) < wanted:
            low = middle
        else:
            high = middle
    return high


class HeightMetric(Metric):
    """Height [m] of a bed or heap above a base: mean and highest point of its free surface, and the level
    below which a share of the particle volume lies.

    The vertical is opposite to gravity. The free surface consists of the tops of the highest particles of
    columns that are two Sauter mean diameters wide. Particles with fewer than two contacts, such as those
    that fall, are excluded from the surface, but not from the volume. If these are more than half, as in a
    vibrated bed in flight, there is no free surface, and its heights are NaN.

    >>> gf.HeightMetric(base="5 mm").share
    0.95
    """

    kind: Literal["height"] = Field("height", description="kind of metric")
    region: Box | None = optional("box whose particles are evaluated", "all particles")
    base: q.Length = Field(
        0.0, description="level from which heights are measured, along the axis opposite to gravity [m]"
    )
    share: Annotated[float, q.Number(above=0, at_most=1)] = Field(
        0.95, description="share of the particle volume that lies below height_of_volume"
    )
    quantities = (
        Quantity("bed_height", "", "m", "mean height of the free surface above the base"),
        Quantity("heap_height", "", "m", "height of the highest point of the free surface above the base"),
        Quantity("height_of_volume", "", "m", "height below which a share of the particle volume lies"),
    )

    def faults_in(self, parts: CheckedParts) -> Iterator[Fault]:
        """See `Metric`."""
        if not any(parts.scene.usual_gravity):
            yield Fault(("kind",), "gravity is zero, so the height is undefined; remove this metric")

    def measure(self, snapshot: Snapshot, scene: MeasuredScene) -> Reading:
        """See `Metric`; the vertical is opposite to gravity, also if gravity is inclined."""
        frame = frame_along(-np.array(scene.gravity) / np.linalg.norm(scene.gravity))
        particles = mobile_particles(snapshot.particles)
        particles = selected(particles, _inside(particles["position"], self.region))
        points = particles["position"].astype(float) @ frame.T
        radius = particles["radius"].astype(float)
        volume = _volume(particles, scene)
        rests = _contacts_of_bodies(particles) >= MIN_CONTACTS
        _, first = np.unique(body_ids(particles), return_index=True)
        of_bodies = rests[first]
        tops: np.ndarray = np.zeros(0)
        if rests.any() and of_bodies.mean() >= LEAST_RESTING:
            tops = surface_points(points[rests], radius[rests], column_edge(radius[rests]))[:, 2]
        numbers = {
            "bed_height": _mean(tops) - self.base,
            "heap_height": float(tops.max(initial=-np.inf)) - self.base if len(tops) else float("nan"),
            "height_of_volume": height_of_share(points[:, 2], radius, volume, self.share) - self.base,
        }
        remark = (
            f"the height of the bed is NaN: {of_bodies.sum()} of {len(of_bodies)} particles in the region "
            "have two contacts, but at least half are required for a free surface; height_of_volume needs no "
            "contacts"
        )
        return Reading(numbers, "" if len(tops) else remark)


LEAST_RESTING = 0.5
"""Share of particles with MIN_CONTACTS contacts from which a bed has a free surface: in a bed at rest nine
of ten have them, in a vibrated bed in flight few, which are somewhere in it."""


# Directions of contacts


def fabric_tensor(contacts: Mapping[str, np.ndarray]) -> np.ndarray:
    """The mean of n n over the contacts between particles, n their direction: (3, 3), symmetric, with
    trace 1.

    `contacts`: arrays `wall` (n,) (negative between particles), `position_i` and `position_j` (n, 3) [m]. NaN
    without contacts. (M. Satake, in: Deformation and Failure of Granular Materials, 1982, 63.)
    """
    between = contacts["wall"] < 0
    branch = contacts["position_j"][between] - contacts["position_i"][between]
    normal = branch / np.linalg.norm(branch, axis=1)[:, None]
    if not len(normal):
        return np.full((3, 3), np.nan)
    return np.einsum("na,nb->ab", normal, normal) / len(normal)


def anisotropy(fabric: np.ndarray) -> float:
    """The anisotropy of a fabric tensor (3, 3), from 0 (isotropic) to 1 (all contacts parallel).

    a = sqrt(3/2 D:D),      D = F - 1/3
    """
    return _size(fabric - np.eye(3) / 3.0)


def _size(deviator: np.ndarray) -> float:
    """sqrt(3/2 D:D) of a deviator (3, 3)."""
    return float(np.sqrt(1.5 * (deviator**2).sum()))


class FabricMetric(Metric):
    """Fabric tensor of the contacts between particles: mean of n n, with n the unit vector between the
    centers.

    (M. Satake, in: Deformation and Failure of Granular Materials, 1982, 63.)

    >>> gf.FabricMetric(region=gf.Box(min=[0, 0, 0], max=[0.1, 0.1, 0.1])).kind
    'fabric'
    """

    kind: Literal["fabric"] = Field("fabric", description="kind of metric")
    region: Box | None = optional("box whose contacts are evaluated", "all contacts")
    quantities = (
        Quantity("fabric_anisotropy", "a", "1", "anisotropy of the fabric tensor, 0 to 1"),
        Quantity("fabric_xx", "Fxx", "1", "mean square of the x component of contact directions"),
        Quantity("fabric_yy", "Fyy", "1", "mean square of the y component of contact directions"),
        Quantity("fabric_zz", "Fzz", "1", "mean square of the z component of contact directions"),
    )
    wants = frozenset({CONTACTS})

    def measure(self, snapshot: Snapshot, scene: MeasuredScene) -> Reading:
        """See `Metric`; of the contacts with midpoints inside the region."""
        contacts = touching(snapshot.contacts or {})
        if self.region is not None:  # the midpoint of a contact across a periodic face can be outside the box
            middle = 0.5 * (contacts["position_i"] + contacts["position_j"])
            box = scene.domain.periodic_box().at(snapshot.time)
            contacts = selected(contacts, _inside(box.wrap(middle), self.region))
        tensor = fabric_tensor(contacts)
        parts = {f"fabric_{axis}{axis}": float(tensor[k, k]) for k, axis in enumerate("xyz")}
        return Reading({"fabric_anisotropy": anisotropy(tensor)} | parts)


# Directions of clumps


ROUND = 1e-6
"""Relative difference of the two largest moments of a clump below which it has no longest axis."""


def longest_axes(position: np.ndarray, mass: np.ndarray, body: np.ndarray) -> np.ndarray:
    """Unit vectors (k, 3) along the longest axis of each of k bodies of spheres; NaN for one without.

    position (n, 3) [m] without jumps within a body, mass (n,) [kg], body (n,): number of the body of each
    sphere

    It is the eigenvector of the largest eigenvalue of sum m (x - X) (x - X), X the mean of x with the
    weights m.
    """
    sums = np.column_stack([np.bincount(body, mass * each) for each in position.T])
    arm = position - (sums / np.bincount(body, mass)[:, None])[body]
    moments = np.zeros((body.max(initial=-1) + 1, 3, 3))
    np.add.at(moments, body, mass[:, None, None] * arm[:, :, None] * arm[:, None, :])
    values, vectors = np.linalg.eigh(moments)
    found = vectors[:, :, 2].copy()
    found[values[:, 2] - values[:, 1] <= ROUND * values[:, 2]] = np.nan
    return np.asarray(found)


class OrientationMetric(Metric):
    """Directions of the longest axes of clumps: order parameter, mean inclination to the horizontal, and mean
    squares of the components.

    The order parameter is the largest eigenvalue of 3/2 <u u> - 1/2 with the unit vectors u: 1 if all axes
    are parallel, about 0 for random directions. Random directions have a mean inclination of 1 rad less than
    a right angle, 0.571 rad or 32.7 degrees. (P. G. de Gennes, J. Prost, The Physics of Liquid Crystals,
    1993, 2.1.)

    >>> gf.OrientationMetric(groups=["rods"]).groups
    ('rods',)
    """

    kind: Literal["orientation"] = Field("orientation", description="kind of metric")
    region: Box | None = optional("box whose clumps are evaluated", "all clumps")
    groups: GroupNames | None = optional("groups whose clumps are evaluated", "all", examples=[["rods"]])
    quantities = (
        Quantity("order_parameter", "S", "1", "order of the longest axes of clumps, 1 if they are parallel"),
        Quantity("inclination", "", "rad", "mean angle of the longest axes of clumps to the horizontal"),
        Quantity("alignment_x", "", "1", "mean square of the x component of the longest axes of clumps"),
        Quantity("alignment_y", "", "1", "mean square of the y component of the longest axes of clumps"),
        Quantity("alignment_z", "", "1", "mean square of the z component of the longest axes of clumps"),
    )

    def faults_in(self, parts: CheckedParts) -> Iterator[Fault]:
        """See `Metric`."""
        yield from unknown_names(("groups",), self.groups, parts.names("particles"), "group")
        if not any(group.shape.body is not None for group in parts.scene.particles.values()):
            yield Fault(
                ("kind",), "no group of particles has clumps, and spheres have no axis; remove this metric"
            )

    def measure(self, snapshot: Snapshot, scene: MeasuredScene) -> Reading:
        """See `Metric`; of the clumps whose center of mass is inside the region."""
        particles = mobile_particles(snapshot.particles)
        chosen = _in_groups(particles, self.groups, scene) & (particles["clump"] >= 0)
        particles = selected(particles, chosen)
        body = _bodies(particles)
        position = _unwrapped(particles["position"].astype(float), body, scene.domain)
        mass = particles["mass"].astype(float)
        axes = longest_axes(position, mass, body)
        axes = axes[_inside(bodies_of(particles)["position"], self.region) & np.isfinite(axes[:, 0])]
        names = [each.name for each in self.quantities]
        if not len(axes):
            return Reading(dict.fromkeys(names, float("nan")), "there are no clumps with a longest axis")
        squares = axes.T @ axes / len(axes)
        order = float(np.linalg.eigvalsh(1.5 * squares - 0.5 * np.eye(3))[2])
        up = np.array(scene.gravity) / (np.linalg.norm(scene.gravity) or 1.0)
        inclination = (
            float(np.arcsin(np.clip(np.abs(axes @ up), 0.0, 1.0)).mean()) if up.any() else float("nan")
        )
        return Reading(dict(zip(names, (order, inclination, *map(float, np.diag(squares))), strict=True)))


def _unwrapped(position: np.ndarray, body: np.ndarray, domain: Domain) -> np.ndarray:
    """Positions (n, 3) [m] without the jumps of periodic axes between the spheres of a body."""
    first = np.unique(body, return_index=True)[1]
    offset = position - position[first[body]]
    for k, axis in enumerate("xyz"):
        if axis in domain.periodic:
            width = domain.max[k] - domain.min[k]
            offset[:, k] -= width * np.round(offset[:, k] / width)
    return np.asarray(position[first[body]] + offset)


# Stress


def shares_inside(start: np.ndarray, branch: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Share (n,) of each segment from `start` (n, 3) along `branch` (n, 3) that is inside a box.

    low, high: corners (3,) of the box; infinite along axes without limits
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        ends = np.stack([(low - start) / branch, (high - start) / branch])
    parallel = branch == 0.0
    inside = (start >= low) & (start <= high)
    first = np.where(parallel, np.where(inside, -np.inf, np.inf), ends.min(axis=0)).max(axis=1)
    last = np.where(parallel, np.where(inside, np.inf, -np.inf), ends.max(axis=0)).min(axis=1)
    share: np.ndarray = np.maximum(np.minimum(last, 1.0) - np.maximum(first, 0.0), 0.0)
    return share


def stress_tensor(
    contacts: Mapping[str, np.ndarray],
    mass: np.ndarray,
    fluctuation: np.ndarray,
    region: Box,
    whole: Collection[int] = (),
) -> np.ndarray:
    """Mean stress (3, 3) [Pa] in a box, positive in tension; its symmetric part.

        s = (1/V) [sum over contacts of L f b - sum over particles of m u u]

    f: force on particle i, b: branch vector to its partner or to the contact point on a wall, L: share of it
    in the box, u: velocity fluctuation. (A. E. H. Love, A Treatise on the Mathematical Theory of Elasticity,
    1927, Note B; M. Babic, Int. J. Eng. Sci. 35 (1997) 523.)

    contacts:     position_i, position_j [m] and force [N] (n, 3)
    mass:         (k,) [kg] of the particles in the box; fluctuation: (k, 3) [m/s]
    whole:        axes along which the box is periodic, and contains everything
    """
    start = contacts["position_i"].astype(float)
    branch = contacts["position_j"].astype(float) - start
    low, high = np.array(region.min), np.array(region.max)
    volume = float(np.prod(high - low))
    for axis in whole:
        low[axis], high[axis] = -np.inf, np.inf
    share = shares_inside(start, branch, low, high)
    static = np.einsum("n,na,nb->ab", share, contacts["force"].astype(float), branch)
    kinetic = np.einsum("n,na,nb->ab", mass.astype(float), fluctuation, fluctuation)
    found = (static - kinetic) / volume
    return np.asarray(0.5 * (found + found.T))


def deviatoric_stress(stress: np.ndarray) -> float:
    """q = sqrt(3/2 s:s) with the deviator s of a stress (3, 3).

    In a triaxial test it is the difference of the axial and the lateral stress.
    """
    return _size(stress - np.trace(stress) / 3.0 * np.eye(3))


class StressMetric(Metric):
    """Mean stress [Pa] in a box, of contact forces and of velocity fluctuations; positive in tension.

    Fluctuations are relative to the mean velocity in the box; under Lees-Edwards shear to the linear profile
    along the gradient that fits the velocities. Scenes with clumps have no such metric.

    >>> gf.StressMetric(region=gf.Box(min=[0, 0, 0], max=[0.1, 0.1, 0.1])).kind
    'stress'
    """

    kind: Literal["stress"] = Field("stress", description="kind of metric")
    region: Box | None = optional("box in which the stress is evaluated", "the domain")
    quantities = (
        Quantity("pressure", "p", "Pa", "minus a third of the trace of the stress in a box"),
        Quantity("deviatoric_stress", "q", "Pa", "sqrt(3/2 s:s) with the deviator s of the stress in a box"),
        *(
            Quantity(f"stress_{a}{b}", "", "Pa", f"{a}{b} component of the stress in a box, tension positive")
            for a, b in ("xx", "yy", "zz", "xy", "xz", "yz")
        ),
    )
    wants = frozenset({PARTICLES, CONTACTS})
    emptiest: ClassVar[float] = 0.5  # share of the domain below which a remark asks for a region

    def faults_in(self, parts: CheckedParts) -> Iterator[Fault]:
        """See `Metric`: no clumps; along periodic axes, the region covers the domain."""
        for name, group in parts.scene.particles.items():
            if group.shape.body is not None:
                reason = f"particles.{name} are clumps, for which it is not implemented; remove this metric"
                yield Fault(("kind",), reason)
        if self.region is None:
            return
        domain = parts.scene.domain
        for k, axis in enumerate("xyz"):
            reach = f"{domain.min[k]:g} to {domain.max[k]:g} m"
            if axis in domain.periodic:
                if (self.region.min[k], self.region.max[k]) != (domain.min[k], domain.max[k]):
                    reason = f"must extend from {reach} in {axis}, where the domain is periodic"
                    yield whole(("region",), reason)
            elif domain.on_exit != "expand" and (
                self.region.min[k] < domain.min[k] or self.region.max[k] > domain.max[k]
            ):
                given = f"from {self.region.min[k]:g} to {self.region.max[k]:g} m in {axis}"
                yield whole(("region",), f"extends {given}, beyond the domain, {reach}: no particle is there")

    def measure(self, snapshot: Snapshot, scene: MeasuredScene) -> Reading:
        """See `Metric`; fixed particles have no kinetic part."""
        domain = scene.domain
        region = self.region or Box(min=domain.min, max=domain.max)
        particles = mobile_particles(snapshot.particles)
        inside = selected(particles, _inside(particles["position"], region))
        mass = inside["mass"].astype(float)
        velocity = inside["velocity"].astype(float)
        fluctuation = velocity - (mass @ velocity / mass.sum() if len(mass) else 0.0)
        if domain.lees_edwards is not None and len(mass):
            flow, gradient = ("xyz".index(getattr(domain.lees_edwards, key)) for key in ("flow", "gradient"))
            height = inside["position"][:, gradient].astype(float)
            height = height - mass @ height / mass.sum()
            spread = mass @ height**2
            slope = (mass * height) @ velocity[:, flow] / spread if spread > 0.0 else 0.0
            fluctuation[:, flow] -= slope * height
        periodic = ["xyz".index(axis) for axis in domain.periodic]
        stress = stress_tensor(snapshot.contacts or {}, mass, fluctuation, region, periodic)
        found = {"pressure": -float(np.trace(stress)) / 3.0, "deviatoric_stress": deviatoric_stress(stress)}
        for each in self.quantities[2:]:
            row, column = ("xyz".index(axis) for axis in each.name.removeprefix("stress_"))
            found[each.name] = float(stress[row, column])
        remark = ""
        if self.region is None and len(mass):
            size = np.ptp(inside["position"], axis=0) + 2.0 * float(np.max(inside["radius"]))
            share = np.minimum(size / np.subtract(domain.max, domain.min), 1.0)
            filled = float(np.prod(np.delete(share, periodic)))
            if filled < self.emptiest:
                remark = (
                    f"the stress is a mean over the domain, of which the particles take {filled:.0%}: give a "
                    "region among them"
                )
        return Reading(found, remark)


# Contacts per particle


def coordination(with_particles: np.ndarray, with_walls: np.ndarray) -> dict[str, float]:
    """The mean number of contacts per particle, with and without rattlers, and the share of rattlers.

        Zm = (sum Z_i) / (N - N0 - N1)       over the particles with at least two contacts

    `with_particles`, `with_walls` (n,): number of contacts of each particle. Rattlers carry no load: N0 have
    no contact and N1 have one, of either kind. Z and Zm count contacts with particles only, so that they do
    not depend on the size of the container. NaN without particles, Zm also without particles that carry a
    load. (C. Thornton, Geotechnique 50 (2000) 43, for a periodic box.)
    """
    count = len(with_particles)
    carries = with_particles + with_walls >= MIN_CONTACTS
    return {
        "coordination_number": _mean(with_particles),
        "mechanical_coordination_number": _mean(with_particles[carries]),
        "wall_coordination_number": _mean(with_walls),
        "rattler_share": 1.0 - carries.sum() / count if count else float("nan"),
    }


class CoordinationMetric(Metric):
    """Mean number of contacts with particles, with and without rattlers (fewer than two contacts), and with
    walls; a clump is one particle with the contacts of its spheres.

    (C. Thornton, Geotechnique 50 (2000) 43.)

    >>> gf.CoordinationMetric()
    CoordinationMetric()
    """

    kind: Literal["coordination"] = Field("coordination", description="kind of metric")
    region: Box | None = optional("box whose particles are evaluated", "all particles")
    quantities = (
        Quantity("coordination_number", "Z", "1", "mean number of contacts with particles per particle"),
        Quantity("mechanical_coordination_number", "Zm", "1", "the same without rattlers"),
        Quantity("wall_coordination_number", "", "1", "mean number of contacts with walls per particle"),
        Quantity("rattler_share", "", "1", "share of particles with no contact or one contact"),
    )

    def measure(self, snapshot: Snapshot, scene: MeasuredScene) -> Reading:
        """See `Metric`; of the mobile particles with centers inside the region."""
        particles = mobile_particles(bodies_of(snapshot.particles))
        inside = selected(particles, _inside(particles["position"], self.region))
        return Reading(coordination(inside["coordination_number"], _wall_contacts(inside)))


# Position and content


class ContentMetric(Metric):
    """Number, mass [kg] and volume [m3] of the mobile particles with their center in a box.

    >>> gf.ContentMetric(region=gf.Box(min=[0, 0, 0], max=[0.1, 0.1, 0.1])).region.max
    (0.1, 0.1, 0.1)
    """

    kind: Literal["content"] = Field("content", description="kind of metric")
    region: Box = Field(description="box whose particles are counted")
    quantities = (
        Quantity("content_count", "", "1", "number of particles in a box"),
        Quantity("content_mass", "", "kg", "mass of the particles in a box"),
        Quantity("content_volume", "", "m3", "volume of the particles in a box"),
    )

    def measure(self, snapshot: Snapshot, scene: MeasuredScene) -> Reading:
        """See `Metric`."""
        particles = mobile_particles(bodies_of(snapshot.particles))
        inside = selected(particles, _inside(particles["position"], self.region))
        mass = inside["mass"].astype(float)
        return Reading(
            {
                "content_count": float(len(mass)),
                "content_mass": float(mass.sum()),
                "content_volume": float(_volume(inside, scene).sum()),
            }
        )


class SolidFractionMetric(Metric):
    """Solid fraction and void ratio of the mobile particles between pairs of opposite flat walls, where these
    are now: of an oedometer, a shear cell or a triaxial sample.

        phi = sum V_i / V,    e = (1 - phi) / phi,    V = A product of the distances of the pairs

    over the particles with their center between the walls of all pairs. The section A across them is that of
    the periodic axes, pi R^2 of a cylinder of radius R around a single pair, or 1 with three pairs. Overlaps
    belong to both particles.

    >>> gf.SolidFractionMetric(between=["floor", "lid"], radius="25 mm").radius
    0.025
    """

    kind: Literal["solid_fraction"] = Field("solid_fraction", description="kind of metric")
    between: WallNames = Field(
        description="pairs of opposite flat walls around the particles, such as [floor, lid, left, right]",
        examples=[["floor", "lid"]],
    )
    radius: q.PositiveLength | None = optional(
        "radius of the cylinder around a single pair [m]", "the section is that of the periodic axes"
    )
    quantities = (
        Quantity("solid_fraction", "phi", "1", "volume of particles over that between walls"),
        Quantity("void_ratio", "e", "1", "volume of voids between walls over that of particles"),
        Quantity("enclosed_volume", "V", "m3", "volume between walls"),
    )
    wants = frozenset({PARTICLES, WALLS})

    def faults(self) -> Iterator[Fault]:
        """Yield a fault unless one to three pairs of different walls are given, and one with a radius."""
        if len(self.between) not in (2, 4, 6) or len(set(self.between)) < len(self.between):
            yield Fault(("between",), "it has two, four or six different walls, such as [floor, lid]")
        elif self.radius is not None and len(self.between) > 2:
            yield Fault(("radius",), "a cylinder is around a single pair of walls; remove radius")

    def faults_in(self, parts: CheckedParts) -> Iterator[Fault]:
        """See `Metric`."""
        yield from unknown_names(("between",), self.between, parts.names("walls"), "wall")

    def measure(self, snapshot: Snapshot, scene: MeasuredScene) -> Reading:
        """See `Metric`; NaN while a wall is absent, if walls are not parallel, or without particles."""
        particles = mobile_particles(bodies_of(snapshot.particles))
        inside = np.ones(len(particles["position"]), bool)
        volume = 1.0 if self.radius is None else pi * self.radius**2
        normals = []
        remark = ""
        for names in zip(self.between[::2], self.between[1::2], strict=True):
            absent = [name for name in names if not snapshot.walls[name].present]
            (point, first), (opposite, second) = (
                (pose.moved(scene.planes[name][0][None])[0], pose.rotation @ scene.planes[name][1])
                for name in names
                for pose in [snapshot.walls[name]]
            )
            length = float((opposite - point) @ first)
            if absent or not is_parallel(first, second) or length == 0.0:
                remark = f"{' and '.join(absent or names)} {'is absent' if absent else 'are not parallel'}"
                break
            share = (particles["position"].astype(float) - point) @ first / length
            inside &= (share >= 0.0) & (share <= 1.0)
            volume *= abs(length)
            normals.append(first)
        if self.radius is None:
            size = np.subtract(scene.domain.max, scene.domain.min)
            volume *= float(np.prod([size[k] for k in across(normals)]))
        solid = float(_volume(selected(particles, inside), scene).sum())
        if not remark and solid == 0.0:
            remark = "there are no particles between the walls"
        values = (nan, nan, nan) if remark else (solid / volume, volume / solid - 1.0, volume)
        return Reading(dict(zip([each.name for each in self.quantities], values, strict=True)), remark)


def across(normals: Sequence[np.ndarray]) -> list[int]:
    """The axes that are perpendicular to all of some unit vectors (3,)."""
    return [k for k in range(3) if all(abs(each[k]) < RIGHT_ANGLE_COSINE for each in normals)]


def center_of_mass(position: np.ndarray, mass: np.ndarray) -> dict[str, float]:
    """The center of mass [m] of particles at `position` (n, 3) [m] with `mass` (n,) [kg]; NaN without any."""
    total = float(mass.sum())
    center = mass.astype(float) @ position.astype(float) / total if total else np.full(3, np.nan)
    return {f"center_of_mass_{axis}": float(center[k]) for k, axis in enumerate("xyz")}


class CenterOfMassMetric(Metric):
    """Center of mass [m] of the particles of some groups or sizes, or of all mobile particles; in periodic
    boxes, of wrapped positions.

    >>> gf.CenterOfMassMetric(groups=["red"])
    CenterOfMassMetric(groups=('red',))
    """

    kind: Literal["center_of_mass"] = Field("center_of_mass", description="kind of metric")
    groups: GroupNames | None = optional(
        "groups whose particles are evaluated, fixed ones too", "all mobile particles", examples=[["red"]]
    )
    smaller_than: q.UnscaledLength | None = optional(
        "diameter below which particles are evaluated [m]", "no limit"
    )
    at_least: q.UnscaledLength | None = optional(
        "diameter from which particles are evaluated [m]", "no limit"
    )
    quantities = (
        Quantity("center_of_mass_x", "x", "m", "x coordinate of the center of mass"),
        Quantity("center_of_mass_y", "y", "m", "y coordinate of the center of mass"),
        Quantity("center_of_mass_z", "z", "m", "z coordinate of the center of mass"),
    )

    def faults(self) -> Iterator[Fault]:
        """Yield a fault for limits between which there is no diameter."""
        if self.smaller_than is not None and self.at_least is not None and self.smaller_than <= self.at_least:
            yield Fault(("smaller_than",), f"it must be above at_least, {self.at_least:g} m")

    def faults_in(self, parts: CheckedParts) -> Iterator[Fault]:
        """See `Metric`."""
        yield from unknown_names(("groups",), self.groups, parts.names("particles"), "group")

    def measure(self, snapshot: Snapshot, scene: MeasuredScene) -> Reading:
        """See `Metric`."""
        bodies = bodies_of(snapshot.particles)
        particles = mobile_particles(bodies)
        if self.groups:
            particles = selected(bodies, _in_groups(bodies, self.groups, scene))
        if self.smaller_than is not None:
            particles = selected(particles, 2.0 * particles["radius"] < self.smaller_than)
        if self.at_least is not None:
            particles = selected(particles, 2.0 * particles["radius"] >= self.at_least)
        center = center_of_mass(particles["position"], particles["mass"])
        return Reading(center, "" if len(particles["mass"]) else "there are no such particles")


# Granular temperature


def granular_temperature(velocity: np.ndarray, mass: np.ndarray, cell: np.ndarray) -> np.ndarray:
    """Mean square (3,) [m2/s2] of each component of the velocity about the mean velocity of the cell.

        T_k = sum_i m_i (v_ik - V_k)^2 / sum_c M_c (1 - 1/N_c)

    velocity (n, 3) [m/s], mass (n,) [kg], cell (n,): index of the cell of each particle. The divisor has the
    degrees of freedom that the mean of a cell of N particles leaves, exactly for equal masses; cells with one
    particle do not count. NaN without cells of two.
    """
    _, own, count = np.unique(cell, return_inverse=True, return_counts=True)
    masses = np.bincount(own, weights=mass, minlength=len(count))
    freedom = float((masses * (1.0 - 1.0 / np.maximum(count, 1))).sum())
    if freedom <= 0.0:
        return np.full(3, np.nan)
    found = np.zeros(3)
    for k in range(3):
        mean = np.bincount(own, weights=mass * velocity[:, k], minlength=len(count)) / masses
        found[k] = float((mass * (velocity[:, k] - mean[own]) ** 2).sum()) / freedom
    return found


class GranularTemperatureMetric(Metric):
    """Granular temperature [m2/s2] of the mobile particles of all or of some groups, in a box or everywhere.

    >>> gf.GranularTemperatureMetric(cell="20 mm").cell
    0.02
    """

    kind: Literal["granular_temperature"] = Field("granular_temperature", description="kind of metric")
    region: Box | None = optional("box whose particles are evaluated", "everywhere")
    groups: GroupNames | None = optional("groups whose particles are evaluated", "all", examples=[["red"]])
    cell: q.PositiveLength | None = optional(
        "edge of cubic cells [m], with the mean velocity of each cell in place of that of all", "one cell"
    )
    quantities = (
        Quantity(
            "granular_temperature", "T", "m2/s2", "mean of the three components of the granular temperature"
        ),
        Quantity("granular_temperature_x", "", "m2/s2", "mean square of the x component of v - V"),
        Quantity("granular_temperature_y", "", "m2/s2", "mean square of the y component of v - V"),
        Quantity("granular_temperature_z", "", "m2/s2", "mean square of the z component of v - V"),
    )

    def faults_in(self, parts: CheckedParts) -> Iterator[Fault]:
        """See `Metric`."""
        yield from unknown_names(("groups",), self.groups, parts.names("particles"), "group")

    def measure(self, snapshot: Snapshot, scene: MeasuredScene) -> Reading:
        """See `Metric`; NaN if no cell has two particles."""
        particles = mobile_particles(bodies_of(snapshot.particles))
        own = _in_groups(particles, self.groups, scene) & _inside(particles["position"], self.region)
        velocity = particles["velocity"][own].astype(float)
        cell = np.zeros(len(velocity), np.int64)
        if self.cell is not None:
            at = np.floor(particles["position"][own].astype(float) / self.cell).astype(np.int64)
            cell = np.unique(at, axis=0, return_inverse=True)[1].reshape(-1)
        found = granular_temperature(velocity, particles["mass"][own].astype(float), cell)
        named = {f"granular_temperature_{axis}": float(found[k]) for k, axis in enumerate("xyz")}
        return Reading({"granular_temperature": float(found.mean()), **named})


# Sliding contacts


def sliding_share(contacts: Mapping[str, np.ndarray], walls: Collection[int] | None) -> dict[str, float]:
    """The share of contacts whose friction force is at the Coulomb limit; NaN without contacts.

    `contacts`: arrays `wall` and `sliding` (n,); `walls`: numbers of the walls in the scene, or None for the
    contacts between particles.
    """
    selected = contacts["wall"] < 0 if walls is None else np.isin(contacts["wall"], list(walls))
    return {"sliding_share": _mean(contacts["sliding"][selected])}


class SlidingMetric(Metric):
    """Share of the contacts whose friction force is at the Coulomb limit.

    >>> gf.SlidingMetric(walls=["floor"])
    SlidingMetric(walls=('floor',))
    """

    kind: Literal["sliding"] = Field("sliding", description="kind of metric")
    walls: WallNames | None = optional(
        "walls whose contacts are evaluated", "the contacts between particles", examples=[["floor"]]
    )
    quantities = (
        Quantity("sliding_share", "", "1", "share of contacts whose friction force is at the Coulomb limit"),
    )
    wants = frozenset({CONTACTS})

    def faults_in(self, parts: CheckedParts) -> Iterator[Fault]:
        """See `Metric`."""
        yield from unknown_names(("walls",), self.walls, parts.names("walls"), "wall")

    def measure(self, snapshot: Snapshot, scene: MeasuredScene) -> Reading:
        """See `Metric`."""
        walls = None if self.walls is None else [scene.walls.index(name) for name in self.walls]
        return Reading(sliding_share(touching(snapshot.contacts or {}), walls))


# Motion of one particle


class ProbeMetric(Metric):
    """Position [m], velocity [m/s] and angular velocity [rad/s] of one particle.

    NaN before its insertion and after its deletion; in periodic boxes, the wrapped position.
    """

    kind: Literal["probe"] = Field(description="kind of metric")
    id: q.ParticleId = Field(description="id of the particle: 0, 1, ... in the order of insertion")
    quantities = (
        Quantity("position_x", "x", "m", "x component of the position of the particle"),
        Quantity("position_y", "y", "m", "y component of the position of the particle"),
        Quantity("position_z", "z", "m", "z component of the position of the particle"),
        Quantity("velocity_x", "vx", "m/s", "x component of the velocity of the particle"),
        Quantity("velocity_y", "vy", "m/s", "y component of the velocity of the particle"),
        Quantity("velocity_z", "vz", "m/s", "z component of the velocity of the particle"),
        Quantity("angular_velocity_x", "wx", "rad/s", "x component of the angular velocity of the particle"),
        Quantity("angular_velocity_y", "wy", "rad/s", "y component of the angular velocity of the particle"),
        Quantity("angular_velocity_z", "wz", "rad/s", "z component of the angular velocity of the particle"),
    )

    def faults_in(self, parts: CheckedParts) -> Iterator[Fault]:
        """See `Metric`: an id that no particle has; none if the number of particles is not given."""
        counts = [group.count_given for group in parts.scene.particles.values()]
        known = sum(count or 0 for count in counts)
        if parts.scene.scale == 1.0 and all(counts) and self.id >= known:
            yield Fault(("id",), f"the ids of the {known} particles are 0 to {known - 1}")

    def measure(self, snapshot: Snapshot, scene: MeasuredScene) -> Reading:
        """See `Metric`; without friction, particles do not rotate and have the angular velocity 0."""
        particles = snapshot.particles
        own = np.flatnonzero(particles["id"] == self.id)
        found: dict[str, float] = {}
        for name in ("position", "velocity", "angular_velocity"):
            values = particles.get(name, np.zeros_like(particles["velocity"]))[own]
            vector = values[0] if len(own) else np.full(3, np.nan)
            found |= {f"{name}_{axis}": float(vector[k]) for k, axis in enumerate("xyz")}
        return Reading(found)


# All kinds

AnyMetric = Annotated[
    LaceyMetric
    | SegregationMetric
    | ReposeMetric
    | HeightMetric
    | FabricMetric
    | OrientationMetric
    | StressMetric
    | CoordinationMetric
    | ContentMetric
    | SolidFractionMetric
    | CenterOfMassMetric
    | GranularTemperatureMetric
    | SlidingMetric
    | ProbeMetric,
    choose_by_key("kind"),
]
"""Any built-in kind of metric; the key `kind` selects it."""
METRICS: list[type[Metric]] = []
"""The kinds of metrics: built in, and registered by a program."""


def add_metric(metric: type[Metric]) -> None:
    """Add a kind of metric. Raises ValueError with the reason if it is not valid."""
    problem = next(_problems(metric), None)
    if problem:
        raise ValueError(f"metric {metric.__name__}: {problem}")
    METRICS.append(metric)
    _use_quantities()


def remove_metric(metric: type[Metric]) -> None:
    """Remove a kind of metric that was added."""
    METRICS.remove(metric)
    _use_quantities()


def _use_quantities() -> None:
    """Set METRIC_QUANTITIES, which other tables contain, to those of METRICS."""
    METRIC_QUANTITIES.clear()
    for metric in METRICS:
        for each in metric.quantities:
            meaning = f"{each.meaning}, mean over the rows of the last stage"
            METRIC_QUANTITIES[each.name] = each
            METRIC_QUANTITIES[f"{each.name}_mean"] = replace(each, name=f"{each.name}_mean", meaning=meaning)


def _problems(metric: type[Metric]) -> Iterator[str]:
    """Reasons why a class is not a valid kind of metric."""
    kind = selecting_keys(metric).get("kind")
    if kind is None or not is_name(str(kind)):
        yield 'it needs a field kind of the type Literal["name"], of lowercase letters, digits and _'
        return
    if kind in [selecting_keys(each)["kind"] for each in METRICS]:
        yield f"a metric of the kind {kind} exists"
    quantities = getattr(metric, "quantities", ())
    if not (isinstance(quantities, tuple) and quantities):
        yield "it needs quantities, a tuple of at least one Quantity"
        return
    for each in quantities:
        if not isinstance(each, Quantity):
            yield f"its quantities contain {shown(each)}, which is not a Quantity"
        elif not is_name(each.name) or each.name.endswith("_mean"):
            yield f"its quantity {shown(each.name)} must have lowercase letters, digits and _, without _mean"
        elif METRIC_QUANTITIES.get(each.name, each) != each or any(
            kind not in (METRIC_PARTS, STAGE_PARTS) for kind in parts_with(each.name)
        ):
            yield f"the quantity {each.name} exists with another meaning"
        elif each.kind != "scalar":
            yield f"its quantity {each.name} must be a scalar"
    if not isinstance(metric.wants, frozenset) or not metric.wants <= PARTS:
        parts = ", ".join(sorted(PARTS))
        yield f"its wants is {shown(metric.wants)}, but must be a frozenset of parts of a snapshot: {parts}"
    if metric.measure is Metric.measure:
        yield "it must define measure(snapshot, scene)"


for _metric in get_args(get_args(AnyMetric)[0]):
    add_metric(_metric)
