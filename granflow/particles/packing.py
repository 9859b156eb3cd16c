"""Packing of spheres in a region: on a lattice, or at random without overlap.

Both avoid existing spheres. The results depend on the random number generator only, not on the number of
threads.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import product
from typing import Protocol

import numpy as np

from granflow.geometry.mesh import expanded
from granflow.geometry.shape import sphere_volume
from granflow.scene.blocks.particles import BoxRegion, CylinderRegion

# Search for close pairs of spheres with a cell list. numpy only.
#
# The cells are cubes with an edge of the largest contact distance plus the reach, so that partners are in
# the 27 cells around a sphere.


def near_pairs(position: np.ndarray, radius: np.ndarray, reach: float) -> tuple[np.ndarray, np.ndarray]:
    """Indices (p,), (p,) of all pairs of spheres with a gap below `reach` [m], each pair once.

    `position` (n, 3) [m], `radius` (n,) [m]. Size classes with a factor of 2 between them keep the cells
    small if a few large spheres are mixed with many small ones. The order of the pairs, and of the two
    indices in a pair, depends on the size classes.
    """
    classes = list(size_classes(radius))
    found: list[np.ndarray] = [np.empty((2, 0), dtype=np.int64)]
    for class_index, larger in enumerate(classes):
        for smaller in classes[class_index:]:
            if smaller is larger:
                first, second = pairs_within(position[larger], radius[larger], reach)
            else:
                first, second = cross_pairs(
                    position[smaller], radius[smaller], position[larger], radius[larger], reach
                )
            found.append(np.stack([smaller[first], larger[second]]))
    first, second = np.concatenate(found, axis=1)
    return first, second


def size_classes(radius: np.ndarray) -> Iterator[np.ndarray]:
    """Indices (k,) of the spheres of each class, largest first; `radius` (n,) [m].

    Within a class radii differ by a factor of 2 at most. Empty without spheres.
    """
    if len(radius) == 0:
        return
    level = np.floor(np.log2(radius.max() / radius)).astype(int)
    for each in np.unique(level):
        yield np.flatnonzero(level == each)


def pairs_within(position: np.ndarray, radius: np.ndarray, reach: float) -> tuple[np.ndarray, np.ndarray]:
    """Indices (p,), (p,) of all pairs of spheres with a gap below `reach` [m], each pair once, smaller index
    first.

    `position` (n, 3) [m], `radius` (n,) [m], n > 0. Visits the rest of the own row of cells and four of the
    eight adjacent rows. The pairs have the order in which the smaller indices find their partners in all nine
    rows.
    """
    key_of = CellKeys(position.min(axis=0), position.max(axis=0), 2 * radius.max() + reach)
    keys = key_of(position)
    count = len(position)
    order = np.argsort(keys, kind="stable")
    keys = keys[order]
    columns = np.ascontiguousarray(position[order].T)
    radius = radius[order]
    found = []
    places = []
    for row, shift in list(enumerate(key_of.adjacent_rows()))[4:]:
        start = (
            np.arange(1, count + 1) if shift == 0 else np.searchsorted(keys, keys + (shift - 1), side="left")
        )
        stop = np.searchsorted(keys, keys + (shift + 1), side="right")
        querying, entry = expanded(start, stop - start)
        one, other = close_pairs(columns, radius, columns, radius, reach, querying, entry)
        pair = np.stack([order[one], order[other]])
        reversed_pair = pair[0] > pair[1]
        found.append(np.where(reversed_pair, pair[::-1], pair))
        rows = np.where(reversed_pair, 8 - row, row)
        entries = np.where(reversed_pair, one, other)
        places.append((rows * count + found[-1][0]) * count + entries)
    first, second = np.concatenate(found, axis=1)[:, np.argsort(np.concatenate(places))]
    return first, second


def cross_pairs(
    first: np.ndarray, first_radius: np.ndarray, second: np.ndarray, second_radius: np.ndarray, reach: float
) -> tuple[np.ndarray, np.ndarray]:
    """Indices (p,), (p,) into the first and the second set of all pairs between them with a gap below `reach`
    [m].

    `first` (n, 3), `second` (m, 3) [m]: centers; radii (n,), (m,) [m]. A sphere in both sets is a pair with
    itself.
    """
    if len(first) == 0 or len(second) == 0:
        return np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64)
    cell = first_radius.max() + second_radius.max() + reach
    low = np.minimum(first.min(axis=0), second.min(axis=0))
    key_of = CellKeys(low, np.maximum(first.max(axis=0), second.max(axis=0)), cell)
    keys = key_of(second)
    order = np.argsort(keys, kind="stable")
    columns = np.ascontiguousarray(first.T)
    other_columns = np.ascontiguousarray(second.T)
    found = [
        close_pairs(columns, first_radius, other_columns, second_radius, reach, *members)
        for members in cell_neighbors(key_of, key_of(first), keys[order], order)
    ]
    return np.concatenate([i for i, _ in found]), np.concatenate([j for _, j in found])


class CellKeys:
    """Cell keys of a grid, numbered row by row along x, with a margin of one cell.

    `low`, `high` (3,) [m]: corners of the grid; `cell` [m]: edge of a cell. The neighbors of a cell along x
    have the keys key - 1 and key + 1; because of the margin, no neighbor is in another row.
    """

    def __init__(self, low: np.ndarray, high: np.ndarray, cell: float) -> None:
        self.low = low
        self.cell = cell
        self.shape = np.floor((high - low) / cell).astype(np.int64) + 3

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """The key (n,) int64 of the cell of each point (n, 3) [m]; the points must lie between `low` and
        `high`."""
        x, y, z = np.floor((points - self.low) / self.cell).astype(np.int64).T + 1
        return x + self.shape[0] * (y + self.shape[1] * z)

    def adjacent_rows(self) -> list[int]:
        """Key offsets from a cell to the middle cells of the nine rows of three cells around it."""
        return [int(self.shape[0] * (y + self.shape[1] * z)) for y, z in product((-1, 0, 1), repeat=2)]


def cell_neighbors(
    key_of: CellKeys, query: np.ndarray, keys: np.ndarray, order: np.ndarray
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """For each of the nine rows: indices of the query points and of all members of the three cells in that
    row.

    `query` (n,): cell keys of the query points; `keys` (m,): sorted cell keys of the members; `order` (m,):
    index of the member with each sorted key. Each of the nine results is two arrays of equal length.
    """
    rank = np.empty(len(query), dtype=np.int64)
    ascending = np.argsort(query, kind="stable")
    rank[ascending] = np.arange(len(query))
    sorted_query = query[ascending]  # searchsorted is several times as fast with sorted queries
    for shift in key_of.adjacent_rows():
        start = np.searchsorted(keys, sorted_query + (shift - 1), side="left")[rank]
        count = np.searchsorted(keys, sorted_query + (shift + 1), side="right")[rank] - start
        querying, entry = expanded(start, count)
        yield querying, order[entry]


def close_pairs(
    first: np.ndarray,
    first_radius: np.ndarray,
    second: np.ndarray,
    second_radius: np.ndarray,
    reach: float,
    i: np.ndarray,
    j: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """The pairs (i, j) with a gap below `reach` [m].

    `first`, `second` (3, n), (3, m) [m]: centers, one row for each coordinate; `i`, `j` (p,): indices of
    candidate pairs. Distances are compared as squares.
    """
    squared = sum((row[i] - other_row[j]) ** 2 for row, other_row in zip(first, second, strict=True))
    limit = first_radius[i] + second_radius[j] + reach
    close = squared < limit * limit
    return i[close], j[close]


def overlaps_any(
    points: np.ndarray, radius: np.ndarray, others: np.ndarray, other_radius: np.ndarray
) -> np.ndarray:
    """Whether each sphere (n,) overlaps any of the others.

    `points` (n, 3), `others` (m, 3): centers [m]; `radius` (n,), `other_radius` (m,) [m].
    """
    overlaps = np.zeros(len(points), dtype=bool)
    first, _ = cross_pairs(points, radius, others, other_radius, 0.0)
    overlaps[first] = True
    return overlaps


# Insertion regions: sampling of sphere centers so that the spheres lie entirely in a box or a cylinder.

SLACK = 1e-9
"""Relative tolerance for exact fits, such as ten spheres of 1 mm across 10 mm."""


class RegionSampler(Protocol):
    """An insertion region; arguments are points (n, 3) [m] and radii (n,) [m].

    `volume` [m3]; `radius_max` [m]: radius of the largest sphere that fits.
    """

    volume: float
    radius_max: float

    def sample(self, radius: np.ndarray, random: np.random.Generator) -> np.ndarray:
        """Uniformly distributed centers (n, 3) [m] with each sphere entirely inside.

        `radius` (n,) [m]: each at most `radius_max`. Spheres may overlap each other.
        """

    def reaches(self, points: np.ndarray, reach: np.ndarray) -> np.ndarray:
        """Whether spheres of radius `reach` (n,) [m] around the points may intersect the region; no false
        negatives."""


class BoxSampler:
    """A box with edges along the coordinate axes from `low` to `high` (3,) [m]."""

    def __init__(self, low: np.ndarray, high: np.ndarray) -> None:
        self.low = np.asarray(low, dtype=np.float64)
        self.high = np.asarray(high, dtype=np.float64)
        self.volume = float(np.prod(self.high - self.low))
        self.radius_max = float((self.high - self.low).min()) / 2

    def sample(self, radius: np.ndarray, random: np.random.Generator) -> np.ndarray:
        margin = radius[:, None]
        return self.low + margin + random.random((len(radius), 3)) * (self.high - self.low - 2 * margin)

    def confine(self, points: np.ndarray, radius: np.ndarray) -> np.ndarray:
        """The nearest centers (n, 3) [m] with the spheres of radii (n,) [m] entirely inside."""
        return np.clip(points, self.low + radius[:, None], self.high - radius[:, None])

    def sites(self, spacing: float, margin: float, jitter: float) -> tuple[np.ndarray, np.ndarray]:
        """Centers (n, 3) [m] of a lattice with cells not smaller than `spacing`, and displacement vectors (3,
        3) [m].

        Spheres of radius `margin` remain inside after a displacement by any sum of the vectors (rows) times
        numbers in [-1, 1]. Order: in layers from the bottom of the box. The cells are stretched to fill the
        box.
        """
        size = self.high - self.low
        cells = np.floor(size / spacing * (1 + SLACK)).astype(int)
        cell = size / np.maximum(cells, 1)
        z, y, x = np.meshgrid(*(np.arange(n) + 0.5 for n in cells[::-1]), indexing="ij")
        centers = self.low + np.stack([x, y, z], axis=-1).reshape(-1, 3) * cell
        return centers, np.diag(jitter * np.maximum(cell / 2 - margin, 0.0))

    def reaches(self, points: np.ndarray, reach: np.ndarray) -> np.ndarray:
        margin = reach[:, None]
        return np.all((points > self.low - margin) & (points < self.high + margin), axis=1)


class CylinderSampler:
    """A solid cylinder of `radius` [m] between the two ends (3,) [m] of its axis.

    `frame` (3, 3): rows are the local axes; the last is the axis of the cylinder.
    """

    def __init__(self, start: np.ndarray, end: np.ndarray, radius: float) -> None:
        self.start = np.asarray(start, dtype=np.float64)
        along = np.asarray(end, dtype=np.float64) - self.start
        self.length = float(np.linalg.norm(along))
        self.radius = radius
        self.volume = float(np.pi * radius**2 * self.length)
        self.radius_max = min(radius, self.length / 2)
        self.frame = frame_along(along / self.length)

    def to_local(self, points: np.ndarray) -> np.ndarray:
        """Local coordinates (n, 3) [m]: two perpendicular to the axis, the third along it."""
        return (points - self.start) @ self.frame.T

    def from_local(self, local: np.ndarray) -> np.ndarray:
        """Points (n, 3) [m] from local coordinates (n, 3) [m]: the inverse of `to_local`."""
        return self.start + local @ self.frame

    def sample(self, radius: np.ndarray, random: np.random.Generator) -> np.ndarray:
        """As in `RegionSampler`; the distance from the axis is (R - r) sqrt(u), with u uniform in [0, 1]."""
        share, turn, height = random.random((3, len(radius)))
        r = (self.radius - radius) * np.sqrt(share)
        angle = 2 * np.pi * turn
        z = radius + height * (self.length - 2 * radius)
        return self.from_local(np.stack([r * np.cos(angle), r * np.sin(angle), z], axis=1))

    def confine(self, points: np.ndarray, radius: np.ndarray) -> np.ndarray:
        """As of `BoxSampler`."""
        local = self.to_local(points)
        r = np.linalg.norm(local[:, :2], axis=1)
        clearance = self.radius - radius
        outside = r > clearance
        local[outside, :2] *= (clearance[outside] / r[outside])[:, None]
        local[:, 2] = np.clip(local[:, 2], radius, self.length - radius)
        return self.from_local(local)

    def sites(self, spacing: float, margin: float, jitter: float) -> tuple[np.ndarray, np.ndarray]:
        """As of `BoxSampler`; layers from the start of the axis are square lattices, stretched to fill the
        length."""
        axes = int(2 * self.radius / spacing * (1 + SLACK))
        layers = int(self.length / spacing * (1 + SLACK))
        height = self.length / max(layers, 1)
        shift = jitter * np.maximum(np.array([spacing, spacing, height]) / 2 - margin, 0.0)
        step = (np.arange(axes) - (axes - 1) / 2) * spacing
        z, y, x = np.meshgrid((np.arange(layers) + 0.5) * height, step, step, indexing="ij")
        farthest = np.hypot(np.abs(x) + shift[0], np.abs(y) + shift[1])
        fits = farthest + margin <= self.radius * (1 + SLACK)
        return self.from_local(np.stack([x, y, z], axis=-1)[fits]), shift[:, None] * self.frame

    def reaches(self, points: np.ndarray, reach: np.ndarray) -> np.ndarray:
        local = self.to_local(points)
        is_within_radius = np.linalg.norm(local[:, :2], axis=1) < self.radius + reach
        return is_within_radius & (local[:, 2] > -reach) & (local[:, 2] < self.length + reach)


class SlabSampler:
    """A box on a rectangle of any orientation: `depth` [m] along the cross product of the two sides.

    `corner` (3,) [m]; `first`, `second` (3,) [m]: perpendicular edge vectors.
    """

    def __init__(self, corner: np.ndarray, first: np.ndarray, second: np.ndarray, depth: float) -> None:
        lengths = np.array([np.linalg.norm(first), np.linalg.norm(second)])
        axes = first / lengths[0], second / lengths[1]
        self.corner = corner
        self.frame = np.array([*axes, np.cross(*axes)])
        self.box = BoxSampler(np.zeros(3), np.array([*lengths, depth]))
        self.volume = self.box.volume
        self.radius_max = self.box.radius_max

    def sample(self, radius: np.ndarray, random: np.random.Generator) -> np.ndarray:
        return np.asarray(self.corner + self.box.sample(radius, random) @ self.frame)

    def reaches(self, points: np.ndarray, reach: np.ndarray) -> np.ndarray:
        return self.box.reaches((points - self.corner) @ self.frame.T, reach)


def frame_along(axis: np.ndarray) -> np.ndarray:
    """Right-handed orthonormal frame (3, 3) as rows; the last row is the given axis, a unit vector (3,).

    `frame @ v` gives the components of a vector v in the frame.
    """
    first = np.cross(np.eye(3)[np.argmin(np.abs(axis))], axis)
    first /= np.linalg.norm(first)
    return np.array([first, np.cross(axis, first), axis])


def sampler_of(region: BoxRegion | CylinderRegion) -> BoxSampler | CylinderSampler:
    """The sampler of a region in the scene, in SI units."""
    if isinstance(region, BoxRegion):
        return BoxSampler(np.array(region.box.min), np.array(region.box.max))
    tube = region.cylinder
    return CylinderSampler(np.array(tube.from_), np.array(tube.to), tube.radius)


MAX_PACKING_FRACTION = 0.57
"""Largest solid fraction of a random packing: the number of sweeps diverges toward 0.6."""
SWELLING = 0.02
"""Relative increase of the radii during separation, so that no overlap remains."""
MAX_SWEEPS = 2000
"""Number of sweeps after which overlapping spheres are reported as not fitting."""
STALLED_SWEEPS = 300
"""Number of sweeps without a smaller largest overlap after which they are reported: a sphere is inside an
obstacle."""
OVERSHOOT = 1.4
"""Separation of overlapping pairs per sweep, over their overlap: halves the number of sweeps (tested: 1, 1.2,
1.4)."""
Sites = Callable[[float], tuple[np.ndarray, np.ndarray]]
"""Function of the spacing [m] that returns the sites (n, 3) [m] of a lattice and displacement vectors (3, 3)
[m]."""


class RegionFullError(Exception):
    """Fewer particles fit than requested: `shortfall` is the number ("only 12 fit"), `remedy` the advice."""

    def __init__(self, shortfall: str, remedy: str) -> None:
        super().__init__(f"{shortfall}: {remedy}")
        self.shortfall = shortfall
        self.remedy = remedy


@dataclass(frozen=True)
class Spheres:
    """A set of n spheres: position (n, 3) [m], radius (n,) [m]."""

    position: np.ndarray
    radius: np.ndarray

    @classmethod
    def none(cls) -> "Spheres":
        """No spheres."""
        return cls(np.empty((0, 3)), np.empty(0))

    def near(self, region: RegionSampler) -> "Spheres":
        """The spheres that may intersect the region, in the same order."""
        inside = region.reaches(self.position, self.radius)
        return Spheres(self.position[inside], self.radius[inside])

    def joined(self, other: "Spheres") -> "Spheres":
        """Both sets of spheres, `other` last: n + m spheres."""
        return Spheres(
            np.concatenate([self.position, other.position]), np.concatenate([self.radius, other.radius])
        )


def fill_lattice(
    region: BoxSampler | CylinderSampler,
    radius: np.ndarray,
    jitter: float,
    existing: Spheres,
    random: np.random.Generator,
) -> np.ndarray:
    """Centers (n, 3) [m] on the widest square lattice with a site for each sphere, filled in layers from the
    bottom.

    `radius` (n,) [m]. `jitter`: largest random displacement along each axis, as a fraction of the gap around
    the largest sphere in its cell. Sites that overlap spheres in `existing` are skipped. The order of
    `radius` is kept:
    sizes are not sorted.

    Raises RegionFullError with the number of sites if there are fewer than spheres.
    """
    margin = radius.max()
    check_width(region, margin)
    obstacles = existing.near(region)

    def free_sites(spacing: float) -> tuple[np.ndarray, np.ndarray]:
        sites, shift = region.sites(spacing, margin, jitter)
        reach = np.full(len(sites), margin + np.linalg.norm(shift))
        return sites[~overlaps_any(sites, reach, obstacles.position, obstacles.radius)], shift

    spacing = widest_spacing(free_sites, len(radius), 2 * margin, (region.volume / len(radius)) ** (1 / 3))
    sites, shift = free_sites(spacing)
    if len(sites) < len(radius):
        raise RegionFullError(only_fit(len(sites)), "Lower it, enlarge the region, or pack them at random.")
    return sites[: len(radius)] + random.uniform(-1, 1, (len(radius), 3)) @ shift


def widest_spacing(free_sites: Sites, count: int, least: float, guess: float) -> float:
    """The widest spacing [m] with at least `count` sites, to about 0.1 %; `least` if no spacing has enough
    sites.

    `free_sites`: spacing [m] -> (sites (k, 3) [m], displacements); `least`, `guess` [m]. The number of sites
    is assumed to decrease with the spacing; bisection between a sufficient and an insufficient spacing.
    """
    spacing = max(guess, least)
    while spacing > least and len(free_sites(spacing)[0]) < count:
        spacing = max(0.9 * spacing, least)
    low, high = spacing, spacing / 0.9
    for _ in range(7):
        middle = (low + high) / 2
        if len(free_sites(middle)[0]) >= count:
            low = middle
        else:
            high = middle
    return low


def pack_at_random(
    region: BoxSampler | CylinderSampler, radius: np.ndarray, existing: Spheres, random: np.random.Generator
) -> np.ndarray:
    """Centers (n, 3) [m] of a random packing: random initial positions, then separation until no overlap
    remains.

    `radius` (n,) [m]; `existing`: spheres that do not move. Reaches a solid fraction of about 0.55 (0.5 or
    less in regions only a few diameters wide).

    Raises RegionFullError if the solid fraction would exceed MAX_PACKING_FRACTION, or if overlaps remain
    after MAX_SWEEPS sweeps.
    """
    check_width(region, radius.max())
    obstacles = existing.near(region)
    solid_fraction = np.sum(sphere_volume(radius)) / region.volume
    if solid_fraction > MAX_PACKING_FRACTION:
        estimate = len(radius) * MAX_PACKING_FRACTION / solid_fraction
        raise RegionFullError(f"about {float(f'{estimate:.2g}'):.0f} fit", packing_remedy(solid_fraction))
    start = region.sample(radius, random)
    spheres = Spheres(start, radius).joined(obstacles)
    swelling = 1 + min(SWELLING, (MAX_PACKING_FRACTION / solid_fraction) ** (1 / 3) - 1)
    position = separate_overlapping(spheres, len(radius), region, swelling)
    overlapping = overlapping_pairs(Spheres(position, spheres.radius), len(radius))
    if len(overlapping):
        left_out = greedy_cover(overlapping, len(radius))
        raise RegionFullError(only_fit(len(radius) - left_out), packing_remedy(solid_fraction))
    return position[: len(radius)]


def only_fit(count: int) -> str:
    """Statement that only `count` particles fit."""
    return {0: "none fits", 1: "only 1 fits"}.get(count, f"only {count} fit")


def packing_remedy(solid_fraction: float) -> str:
    """Advice for a packing that is too dense; `solid_fraction`: requested."""
    return (
        f"The requested number would fill {solid_fraction:.0%} of it, and a random packing reaches about "
        "50%. Lower it or enlarge the region."
    )


def check_width(region: RegionSampler, radius: float) -> None:
    """Raise RegionFullError if a single sphere of the largest radius [m] does not fit."""
    if radius > region.radius_max * (1 + 1e-9):
        raise RegionFullError(
            only_fit(0),
            f"The largest, {2 * radius:g} m, is wider than the region, {2 * region.radius_max:g} m.",
        )


def separate_overlapping(
    spheres: Spheres, mobile_count: int, region: BoxSampler | CylinderSampler, swelling: float
) -> np.ndarray:
    """Positions (n, 3) [m] after sweeps that separate the first `mobile_count` spheres from all others.

    The sweeps end if no overlap remains, if the largest overlap has not decreased in STALLED_SWEEPS, or after
    MAX_SWEEPS. Each sweep separates every overlapping pair by its overlap, with displacements proportional to
    the inverse square of the radii; the remaining spheres are fixed. The list of close pairs is rebuilt when
    a displacement exceeds half the skin. `swelling`: factor of the radii during the sweeps, above 1, so that
    the result has gaps.
    """
    position = spheres.position.copy()
    radius = spheres.radius * swelling
    mobility = np.where(np.arange(len(radius)) < mobile_count, radius**-2.0, 0.0)
    skin = 0.6 * float(np.median(radius))
    listed_position = position
    pairs = mobile_pairs(position, radius, skin, mobile_count)
    smallest = np.inf
    smallest_at = 0
    for sweep in range(MAX_SWEEPS):
        shift, worst = separation(position, radius, mobility, pairs)
        if worst < smallest:
            smallest = worst
            smallest_at = sweep
        if worst < 1 - 1 / swelling or sweep - smallest_at >= STALLED_SWEEPS:
            break
        position = position + OVERSHOOT * shift
        position[:mobile_count] = region.confine(position[:mobile_count], spheres.radius[:mobile_count])
        if 2 * np.linalg.norm(position - listed_position, axis=1).max() > skin:
            listed_position = position
            pairs = mobile_pairs(position, radius, skin, mobile_count)
    return position


def mobile_pairs(
    position: np.ndarray, radius: np.ndarray, reach: float, mobile_count: int
) -> tuple[np.ndarray, np.ndarray]:
    """Pairs (p,), (p,) with a gap below `reach` [m] and at least one sphere among the first `mobile_count`.

    `position` (n, 3), `radius` (n,) [m].
    """
    first, second = near_pairs(position, radius, reach)
    matters = np.minimum(first, second) < mobile_count
    return first[matters], second[matters]


def separation(
    position: np.ndarray, radius: np.ndarray, mobility: np.ndarray, pairs: tuple[np.ndarray, np.ndarray]
) -> tuple[np.ndarray, float]:
    """Displacements (n, 3) [m] that separate each overlapping pair by its overlap, and the largest relative
    overlap.

        d_i = b_i (R_i + R_j - |r|) / (b_i + b_j) r / |r|,      r = x_i - x_j

    `mobility` b (n,), 0 for fixed spheres; `pairs` (p,), (p,): indices of candidate pairs, of which at least
    one sphere is mobile. The relative overlap is over the sum of the radii; 0 without overlapping pairs.
    """
    first, second = pairs
    branch = [row[first] - row[second] for row in np.ascontiguousarray(position.T)]
    contact_distance = radius[first] + radius[second]
    x, y, z = branch
    squared = x * x + z * z + y * y
    overlapping = np.flatnonzero(squared < contact_distance * contact_distance)
    first = first[overlapping]
    second = second[overlapping]
    contact_distance = contact_distance[overlapping]
    distance = np.maximum(np.sqrt(squared[overlapping]), 1e-12 * contact_distance)
    factor = (contact_distance - distance) / distance / (mobility[first] + mobility[second])
    shift = np.empty_like(position)
    for axis in range(3):
        displacement = branch[axis][overlapping] * factor
        shift[:, axis] = np.bincount(first, displacement, len(position))
        shift[:, axis] -= np.bincount(second, displacement, len(position))
    worst = float((1 - distance / contact_distance).max()) if len(first) else 0.0
    return shift * mobility[:, None], worst


def overlapping_pairs(spheres: Spheres, mobile_count: int) -> np.ndarray:
    """Overlapping pairs (p, 2) with at least one sphere among the first `mobile_count`."""
    first, second = mobile_pairs(spheres.position, spheres.radius, 0.0, mobile_count)
    return np.stack([first, second], axis=1)


def greedy_cover(pairs: np.ndarray, mobile_count: int) -> int:
    """Number of mobile spheres to remove, those with most overlaps first, until no overlapping pair remains.

    `pairs` (p, 2): indices, at least one of each pair below `mobile_count`. An upper bound of the necessary
    number.
    """
    removed = 0
    while len(pairs):
        worst = np.bincount(pairs.ravel())[:mobile_count].argmax()
        pairs = pairs[np.all(pairs != worst, axis=1)]
        removed += 1
    return removed
