"""Metrics of the time series: numbers that a snapshot gives, such as a mixing index or an angle of repose.

Each entry of `output.metrics` becomes a `MetricMeter`, which evaluates the metric for each row of the time
series and computes its mean over the last stage. Each section has one metric: its formula, a function of
arrays, and its meter, which selects these arrays from a snapshot.
"""

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from granflow.geometry.shape import sphere_volume
from granflow.observers.coarse_graining import CoarseGrid, grid_for, mobile_particles, selected
from granflow.observers.observer import CONTACTS, PARTICLES
from granflow.particles.sampling import frame_along
from granflow.plan.plan import Plan
from granflow.scene.blocks.output import (
    AnyMetric,
    CenterOfMassMetric,
    ContentMetric,
    CoordinationMetric,
    FabricMetric,
    LaceyMetric,
    ProbeMetric,
    ReposeMetric,
    SegregationMetric,
    SlidingMetric,
    TwoComponentGrid,
)
from granflow.scene.blocks.shapes import Box
from granflow.snapshot import Snapshot


class MetricMeter:
    """Evaluates `measure` for snapshots with the parts `wants`; values by name in METRIC_QUANTITIES.

    The mean restarts with each stage. Values that are NaN (not defined for the present state) do not enter
    the mean. `remark`: of the last evaluation, a sentence for a warning at the end of the run, or an empty
    text.

    get_remark:  function that returns the remark after an evaluation
    """

    def __init__(
        self,
        measure: Callable[[Snapshot], Mapping[str, float]],
        wants: frozenset[str],
        get_remark: Callable[[], str] = lambda: "",
    ) -> None:
        self.wants = wants
        self._measure = measure
        self._get_remark = get_remark
        self.remark = ""
        self._stage = ""
        self._last: dict[str, float] = {}
        self._sums: dict[str, float] = {}
        self._counts: dict[str, int] = {}
        self._sums_before: dict[str, float] = {}
        self._counts_before: dict[str, int] = {}

    def update(self, snapshot: Snapshot, replaces_last: bool = False) -> None:
        """Evaluate the metric with a snapshot, which must have the parts `wants`.

        `replaces_last`: the last values, of the same stage, do not enter the mean any more.
        """
        if replaces_last:
            self._sums = self._sums_before
            self._counts = self._counts_before
        if snapshot.stage != self._stage:
            self._stage = snapshot.stage
            self._sums = {}
            self._counts = {}
        self._sums_before = dict(self._sums)
        self._counts_before = dict(self._counts)
        self._last = {name: float(value) for name, value in self._measure(snapshot).items()}
        self.remark = self._get_remark()
        for name, number in self._last.items():
            known = number == number
            self._sums[name] = self._sums.get(name, 0.0) + (number if known else 0.0)
            self._counts[name] = self._counts.get(name, 0) + known

    def readings(self) -> dict[str, float]:
        """Return the values of the last snapshot, in the units of METRIC_QUANTITIES; empty before the
        first."""
        return self._last

    def result(self) -> dict[str, float]:
        """Return the last values, and as `NAME_mean` the means over the values of the last stage that are not
        NaN."""
        means = {
            f"{name}_mean": self._sums[name] / count if count else float("nan")
            for name, count in self._counts.items()
        }
        return self._last | means

    def state_dict(self) -> dict[str, Any]:
        """Return the stage, the last values and their remark, and sums and counts of the stage, also without
        these."""
        return {
            "stage": self._stage,
            "last": self._last,
            "remark": self.remark,
            "sums": self._sums,
            "counts": self._counts,
            "sums_before": self._sums_before,
            "counts_before": self._counts_before,
        }

    def load_state_dict(self, saved: dict[str, Any]) -> None:
        """Restore the state of `state_dict`."""
        self._stage = saved["stage"]
        self._last = saved["last"]
        self.remark = saved["remark"]
        self._sums = saved["sums"]
        self._counts = saved["counts"]
        self._sums_before = saved["sums_before"]
        self._counts_before = saved["counts_before"]


# The meters of a scene

NEEDS_PARTICLES = frozenset({PARTICLES})
NEEDS_CONTACTS = frozenset({CONTACTS})


def metric_meters(plan: Plan) -> dict[str, MetricMeter]:
    """Return a meter for each metric of the plan, by its name in `output.metrics`."""
    return {name: _metric_meter(plan, spec) for name, spec in plan.scene.output.metrics.items()}


def _metric_meter(plan: Plan, spec: AnyMetric) -> MetricMeter:
    """Return the meter of one metric; the class of `spec` determines the kind."""
    match spec:
        case LaceyMetric():
            return _lacey_meter(plan, spec)
        case SegregationMetric():
            return _segregation_meter(plan, spec)
        case ReposeMetric():
            return _repose_meter(plan, spec)
        case CoordinationMetric(region=region):
            return MetricMeter(lambda snapshot: _coordination(snapshot, region), NEEDS_PARTICLES)
        case FabricMetric(region=region):
            return MetricMeter(lambda snapshot: _fabric(snapshot, region), NEEDS_CONTACTS)
        case SlidingMetric():
            return _sliding_meter(plan, spec)
        case CenterOfMassMetric():
            return _center_of_mass_meter(plan, spec)
        case ContentMetric(region=region):
            return MetricMeter(lambda snapshot: _content(snapshot, region), NEEDS_PARTICLES)
        case ProbeMetric(id=particle_id):
            return MetricMeter(lambda snapshot: _probe(snapshot.particles, particle_id), NEEDS_PARTICLES)


# Mixing of two kinds of particles, by number: Lacey's index

DROPPED_SHARE = 0.1
"""Share of the particles of a component outside the cells of a Lacey index above which a remark reports
it."""


def lacey_index(position: np.ndarray, is_kind_a: np.ndarray, grid: CoarseGrid, at_least: int) -> float:
    """Return Lacey's mixing index of particles at `position` (n, 3) [m]; `is_kind_a` (n,): whether of the
    first kind.

        M = (S0^2 - S^2) / (S0^2 - SR^2)
        S^2 = sum n_k (p_k - p)^2 / sum n_k,   S0^2 = p (1 - p),   SR^2 = S0^2 / n

    p_k is the share by number of the first kind among the n_k particles of cell k, p the share in all cells,
    n the mean of n_k; cells with fewer than `at_least` particles are excluded. 0: each cell contains one kind
    only; 1: randomly mixed, except for statistical scatter; above 1: more uniform than random. NaN without
    such cells or with one kind. (P. M. C. Lacey, J. Appl. Chem. 4 (1954) 257.)
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
    if not segregated > mixed:
        return float("nan")
    found = (number * (kind / number - share) ** 2).sum() / total
    return float((segregated - found) / (segregated - mixed))


def dropped_share(position: np.ndarray, is_kind_a: np.ndarray, grid: CoarseGrid, at_least: int) -> float:
    """Return the share by number of the particles of one kind that `lacey_index` excludes, the larger of both
    kinds.

    Arguments as `lacey_index`. 0 without particles in the grid.
    """
    cell, inside = grid.cells_of(position)
    number = np.bincount(cell[inside], minlength=grid.cell_count)
    is_dropped = number[cell[inside]] < at_least
    is_kind_a = is_kind_a[inside]
    return max(
        (float(is_dropped[kind].mean()) for kind in (is_kind_a, ~is_kind_a) if kind.any()), default=0.0
    )


def _lacey_meter(plan: Plan, spec: LaceyMetric) -> MetricMeter:
    """Return a meter of the Lacey index, with a remark if it excludes more than DROPPED_SHARE of a kind."""
    grid = grid_for(plan.scene.domain, spec)
    is_kind_a = _first_component(plan, spec)
    dropped = 0.0

    def measure(snapshot: Snapshot) -> dict[str, float]:
        nonlocal dropped
        particles = mobile_particles(snapshot.particles)
        arguments = particles["position"], is_kind_a(particles), grid, spec.at_least
        dropped = dropped_share(*arguments)
        return {"lacey_index": lacey_index(*arguments)}

    def remark() -> str:
        if dropped <= DROPPED_SHARE:
            return ""
        return (
            f"the Lacey index excludes {dropped:.0%} of the particles of one component, because their cells "
            f"contain fewer than {spec.at_least} particles (at_least): increase cell, or use kind: "
            "segregation, which weights particles by volume and excludes no cell"
        )

    return MetricMeter(measure, NEEDS_PARTICLES, remark)


# Segregation of two kinds of particles, by volume


def segregation_intensity(
    position: np.ndarray, volume: np.ndarray, is_kind_a: np.ndarray, grid: CoarseGrid
) -> float:
    """Return the intensity of segregation of particles at `position` (n, 3) [m] with volumes (n,) [m3].

        I = sum V_k (c_k - c)^2 / (c (1 - c) sum V_k)

    V_k: volume of the particles with centers in cell k; c_k, c: share by volume of the first kind
    (`is_kind_a` (n,)) in cell k and in all cells. 1: each cell contains one kind only; 0: the same share in
    all cells. No cell is excluded. NaN with one kind. (sigma^2 / (c (1 - c)) of P. V. Danckwerts, Appl. Sci.
    Res. A 3 (1952) 279, with samples weighted by their volume.)
    """
    cell, inside = grid.cells_of(position)
    total = np.bincount(cell[inside], weights=volume[inside], minlength=grid.cell_count)
    first = np.bincount(cell[inside], weights=(volume * is_kind_a)[inside], minlength=grid.cell_count)
    first = first[total > 0.0]
    total = total[total > 0.0]
    share = first.sum() / total.sum() if len(total) else np.nan
    segregated = share * (1.0 - share) * total.sum()
    if not segregated > 0.0:
        return float("nan")
    return float((total * (first / total - share) ** 2).sum() / segregated)


def random_intensity(
    position: np.ndarray, volume: np.ndarray, is_kind_a: np.ndarray, grid: CoarseGrid
) -> float:
    """Return the expected intensity of segregation of a random mixture of the same particles in the same
    cells.

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


def _segregation_meter(plan: Plan, spec: SegregationMetric) -> MetricMeter:
    """Return a meter of the intensity of segregation."""
    grid = grid_for(plan.scene.domain, spec)
    is_kind_a = _first_component(plan, spec)

    def measure(snapshot: Snapshot) -> dict[str, float]:
        particles = mobile_particles(snapshot.particles)
        volume = sphere_volume(particles["radius"].astype(float))
        arguments = particles["position"], volume, is_kind_a(particles), grid
        return {
            "segregation_intensity": segregation_intensity(*arguments),
            "segregation_intensity_random": random_intensity(*arguments),
        }

    return MetricMeter(measure, NEEDS_PARTICLES)


def _first_component(plan: Plan, spec: TwoComponentGrid) -> Callable[[Mapping[str, np.ndarray]], np.ndarray]:
    """Return the function that selects particles (n,): given groups or materials, or diameters below
    `smaller_than`."""
    names = [group.name for group in plan.groups]
    groups = [names.index(name) for name in spec.groups or ()]
    materials = [list(plan.solids).index(name) for name in spec.materials or ()]

    def is_first(particles: Mapping[str, np.ndarray]) -> np.ndarray:
        if spec.smaller_than is not None:
            return np.asarray(2.0 * particles["radius"] < spec.smaller_than)
        return np.isin(particles["group"], groups) | np.isin(particles["material"], materials)

    return is_first


# Angle of repose
#
# The surface of a heap, or of a bed in a drum, consists of the highest particle of each square column; a line
# or plane is fitted to the tops of these spheres.

COLUMN_WIDTH = 2.0
"""Edge of the columns in which the surface of a heap is determined, in largest diameters."""
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


def _repose_meter(plan: Plan, spec: ReposeMetric) -> MetricMeter:
    """Return a meter of the angle of repose [rad]; the vertical is opposite to gravity, also if gravity is
    inclined.

    Particles with fewer than MIN_CONTACTS contacts are not part of the heap: one that rolls away on the floor
    has one.
    """
    upwards = -np.array(plan.scene.gravity) / np.linalg.norm(plan.scene.gravity)
    frame = frame_along(upwards)
    edge = COLUMN_WIDTH * 2.0 * plan.radius_max
    axis = None if spec.axis is None else (frame @ np.array(spec.axis))[:2]
    reason = ""

    def measure(snapshot: Snapshot) -> dict[str, float]:
        nonlocal reason
        particles = mobile_particles(snapshot.particles)
        contacts = particles["coordination_number"] + _wall_contacts(particles)
        heap = selected(particles, (contacts >= MIN_CONTACTS) & _inside(particles["position"], spec.region))
        points = heap["position"].astype(float) @ frame.T
        if spec.surface == "cone":
            slope = slope_of_cone(points, heap["radius"], edge, axis)
        else:
            slope = slope_of_plane(points, heap["radius"], edge)
        reason = slope.reason
        return {"angle_of_repose": slope.angle, "angle_of_repose_error": slope.error}

    return MetricMeter(measure, NEEDS_PARTICLES, lambda: reason and f"the angle of repose is NaN: {reason}")


@dataclass(frozen=True)
class Slope:
    """Angle to the horizontal and its standard error from the scatter about the fit [rad].

    Both are NaN if the surface has no slope; `reason` is then a sentence.
    """

    angle: float
    error: float
    reason: str = ""


def no_slope(reason: str) -> Slope:
    """Return a slope that is NaN, with the reason."""
    return Slope(float("nan"), float("nan"), reason)


def slope_of_cone(
    points: np.ndarray, radius: np.ndarray, edge: float, axis: np.ndarray | None = None
) -> Slope:
    """Return the slope of the flank of a conical heap of spheres with centers (n, 3), z upward, and radii
    (n,) [m].

    `edge` [m]: of the columns, about two diameters; `axis` (2,) [m]: of the cone, the mean of all centers if
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
    """Return the slope of the plane fitted to the surface of spheres with centers (n, 3), z upward, and radii
    (n,) [m].

    `edge` [m]: of the columns. For one side of a wedge, or for the middle of a drum. NaN without particles,
    with fewer than FEWEST surface points, if these lie on a line, or if the fit is not significant, see
    `_slope`.
    """
    if not len(points):
        return no_slope("there are no particles with enough contacts in the region")
    surface = surface_points(points, radius, edge)
    return _slope(surface[:, :2], surface[:, 2])


def surface_points(points: np.ndarray, radius: np.ndarray, edge: float) -> np.ndarray:
    """Return the tops (m, 3) [m] of the highest spheres, one for each column that contains spheres.

    The columns are about `edge` [m] wide and divide the extent of the points evenly: in a narrow column at
    the border, the highest sphere would be deep inside the heap.
    """
    low = points[:, :2].min(axis=0)
    extent = np.maximum(points[:, :2].max(axis=0) - low, np.finfo(float).tiny)
    number = np.maximum(np.round(extent / edge), 1)
    column = np.minimum((points[:, :2] - low) / extent * number, number - 1).astype(np.int64)
    top = points[:, 2] + radius
    order = np.lexsort((-top, column[:, 1], column[:, 0]))
    changes = (np.diff(column[order], axis=0) != 0).any(axis=1)
    first = order[np.flatnonzero(np.append(True, changes))]
    return np.column_stack([points[first, :2], top[first]])


def _slope(position: np.ndarray, height: np.ndarray) -> Slope:
    """Return the angle of the line or plane fitted to heights (n,) [m] over horizontal positions (n, d = 1 or
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


# Contacts per particle

MIN_CONTACTS = 2
"""Smallest number of contacts, with particles and walls, of a particle that carries a load."""


def coordination(with_particles: np.ndarray, with_walls: np.ndarray) -> dict[str, float]:
    """Return the mean number of contacts per particle, with and without rattlers, and the share of rattlers.

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


def _coordination(snapshot: Snapshot, region: Box | None) -> Mapping[str, float]:
    """Return the coordination numbers of the mobile particles with centers inside the region."""
    particles = mobile_particles(snapshot.particles)
    inside = _inside(particles["position"], region)
    return coordination(particles["coordination_number"][inside], _wall_contacts(particles)[inside])


def _wall_contacts(particles: Mapping[str, np.ndarray]) -> np.ndarray:
    """Return the number of contacts of each particle with walls (n,); zeros in a scene without walls."""
    return particles.get("wall_contact_count", np.zeros(len(particles["position"]), np.int32))


# Directions of contacts


def fabric_tensor(contacts: Mapping[str, np.ndarray]) -> np.ndarray:
    """Return the mean of n n over the contacts between particles, n their direction: (3, 3), symmetric, with
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
    """Return the anisotropy of a fabric tensor (3, 3), from 0 (isotropic) to 1 (all contacts parallel).

    a = sqrt(3/2 D:D),      D = F - 1/3
    """
    deviator = fabric - np.eye(3) / 3.0
    return float(np.sqrt(1.5 * (deviator**2).sum()))


def _fabric(snapshot: Snapshot, region: Box | None) -> Mapping[str, float]:
    """Return the anisotropy and the diagonal of the fabric tensor of contacts with midpoints inside the
    region."""
    contacts = snapshot.contacts or {}
    middle = 0.5 * (contacts["position_i"] + contacts["position_j"])
    tensor = fabric_tensor(selected(contacts, _inside(middle, region)))
    parts = {f"fabric_{axis}{axis}": float(tensor[k, k]) for k, axis in enumerate("xyz")}
    return {"fabric_anisotropy": anisotropy(tensor)} | parts


# Sliding contacts


def sliding_share(contacts: Mapping[str, np.ndarray], walls: Collection[int] | None) -> dict[str, float]:
    """Return the share of contacts whose friction force is at the Coulomb limit; NaN without contacts.

    `contacts`: arrays `wall` and `sliding` (n,); `walls`: numbers of the walls in the scene, or None for the
    contacts between particles.
    """
    selected = contacts["wall"] < 0 if walls is None else np.isin(contacts["wall"], list(walls))
    return {"sliding_share": _mean(contacts["sliding"][selected])}


def _sliding_meter(plan: Plan, spec: SlidingMetric) -> MetricMeter:
    """Return a meter of the share of sliding contacts, between particles or with the given walls."""
    names = [wall.name for wall in plan.walls]
    walls = None if spec.walls is None else [names.index(name) for name in spec.walls]
    return MetricMeter(lambda snapshot: sliding_share(snapshot.contacts or {}, walls), NEEDS_CONTACTS)


# Position and content


def center_of_mass(position: np.ndarray, mass: np.ndarray) -> dict[str, float]:
    """Return the center of mass [m] of particles at `position` (n, 3) [m] with `mass` (n,) [kg]; NaN without
    any."""
    total = float(mass.sum())
    center = mass.astype(float) @ position.astype(float) / total if total else np.full(3, np.nan)
    return {f"center_of_mass_{axis}": float(center[k]) for k, axis in enumerate("xyz")}


def _center_of_mass_meter(plan: Plan, spec: CenterOfMassMetric) -> MetricMeter:
    """Return a meter of the center of mass [m] of the mobile particles of the given groups, by default of
    all."""
    names = [group.name for group in plan.groups]
    groups = [names.index(name) for name in spec.groups or names]

    def measure(snapshot: Snapshot) -> dict[str, float]:
        particles = mobile_particles(snapshot.particles)
        own = np.isin(particles["group"], groups)
        return center_of_mass(particles["position"][own], particles["mass"][own])

    return MetricMeter(measure, NEEDS_PARTICLES)


def _content(snapshot: Snapshot, region: Box) -> Mapping[str, float]:
    """Return number, mass [kg] and volume [m3] of the mobile particles with centers inside the region."""
    particles = mobile_particles(snapshot.particles)
    selected_particles = selected(particles, _inside(particles["position"], region))
    volume = float(sphere_volume(selected_particles["radius"].astype(float)).sum())
    mass = float(selected_particles["mass"].astype(float).sum())
    return {
        "content_count": float(len(selected_particles["mass"])),
        "content_mass": mass,
        "content_volume": volume,
    }


def _probe(particles: Mapping[str, np.ndarray], particle_id: int) -> Mapping[str, float]:
    """Return position [m], velocity [m/s] and angular velocity [rad/s] of a particle; NaN if it does not
    exist.

    Without friction, particles do not rotate and have the angular velocity 0.
    """
    own = np.flatnonzero(particles["id"] == particle_id)
    found: dict[str, float] = {}
    for name in ("position", "velocity", "angular_velocity"):
        values = particles.get(name, np.zeros_like(particles["velocity"]))[own]
        vector = values[0] if len(own) else np.full(3, np.nan)
        found |= {f"{name}_{axis}": float(vector[k]) for k, axis in enumerate("xyz")}
    return found


# Shared by several metrics


def _inside(points: np.ndarray, region: Box | None) -> np.ndarray:
    """Return whether points (n, 3) [m] are inside the region; True without a region."""
    if region is None:
        return np.ones(len(points), bool)
    above = points >= np.array(region.min)
    below = points <= np.array(region.max)
    return np.asarray(np.logical_and(above, below).all(axis=1))


def _mean(values: np.ndarray) -> float:
    return float(values.mean()) if len(values) else float("nan")
