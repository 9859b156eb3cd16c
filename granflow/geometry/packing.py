"""Packing of spheres in a region: on a lattice, or at random without overlap.

Both avoid existing spheres. The results depend on the random number generator only, not on the number of
threads.
"""

from collections.abc import Callable
from copy import deepcopy
from dataclasses import dataclass

import numpy as np

from granflow.geometry.close_pairs import near_pairs, overlaps_any
from granflow.geometry.region import FilledRegion, RegionSampler
from granflow.geometry.sphere import sphere_volume


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


Sites = Callable[[float], tuple[np.ndarray, np.ndarray]]
"""Function of the spacing [m] that returns the sites (n, 3) [m] of a lattice and displacement vectors (3, 3)
[m]."""


def fill_lattice(
    region: FilledRegion,
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


MAX_PACKING_FRACTION = 0.57
"""Largest solid fraction of a random packing: the number of sweeps diverges toward 0.6."""
SWELLING = 0.02
"""Relative increase of the radii during separation, so that no overlap remains."""
MAX_SWEEPS = 2000
"""Number of sweeps after which overlapping spheres are reported as not fitting."""
STALLED_SWEEPS = 300
"""Number of sweeps without a smaller largest overlap after which they are reported: a sphere is inside an
obstacle."""
MAX_REDRAWS = 10
"""Number of times that spheres trapped between obstacles, which do not move, are drawn again elsewhere."""
MAX_REDRAWN = 0.1
"""Largest share of the spheres that is drawn again: with more of them the region is full."""
TRIED_FRACTIONS = (0.5, 0.45, 0.4, 0.35, 0.3, 0.25, 0.2, 0.15, 0.1, 0.05)
"""Solid fractions at which a smaller number of spheres is tried if the requested number does not fit."""
MAX_TRIED = 20_000
"""Largest number of spheres that is tried: takes some seconds."""
OVERSHOOT = 1.4
"""Separation of overlapping pairs per sweep, over their overlap: halves the number of sweeps (tested: 1, 1.2,
1.4)."""


def pack_at_random(
    region: FilledRegion, radius: np.ndarray, existing: Spheres, random: np.random.Generator
) -> np.ndarray:
    """Centers (n, 3) [m] of a random packing: random initial positions, then separation until no overlap
    remains.

    `radius` (n,) [m]; `existing`: spheres that do not move. Reaches a solid fraction of about 0.55 (0.5 or
    less in regions only a few diameters wide).

    Raises RegionFullError if the solid fraction would exceed MAX_PACKING_FRACTION, or if overlaps remain
    after MAX_SWEEPS sweeps, with a number of spheres that can be packed.
    """
    check_width(region, radius.max())
    obstacles = existing.near(region)
    solid_fraction = np.sum(sphere_volume(radius)) / region.volume
    trial = deepcopy(random)
    position = None
    if solid_fraction <= MAX_PACKING_FRACTION:
        position = _packed(region, radius, obstacles, random)
    if position is None:
        raise RegionFullError(
            _packable(region, radius, obstacles, trial, solid_fraction), packing_remedy(solid_fraction)
        )
    return position


def _packed(
    region: FilledRegion, radius: np.ndarray, obstacles: Spheres, random: np.random.Generator
) -> np.ndarray | None:
    """Centers (n, 3) [m] of a random packing of spheres of radii (n,) [m]; None if overlaps remain."""
    solid_fraction = np.sum(sphere_volume(radius)) / region.volume
    start = region.sample(radius, random)
    spheres = Spheres(start, radius).joined(obstacles)
    swelling = 1 + min(SWELLING, (MAX_PACKING_FRACTION / solid_fraction) ** (1 / 3) - 1)
    position = separate_overlapping(spheres, len(radius), region, swelling)
    for _ in range(MAX_REDRAWS):
        trapped = np.unique(overlapping_pairs(Spheres(position, spheres.radius), len(radius)))
        trapped = trapped[trapped < len(radius)]
        if not len(trapped):
            return position[: len(radius)]
        if not len(obstacles.radius) or len(trapped) > MAX_REDRAWN * len(radius):
            return None
        position[trapped] = region.sample(radius[trapped], random)
        position = separate_overlapping(Spheres(position, spheres.radius), len(radius), region, swelling)
    return None


def _packable(
    region: FilledRegion,
    radius: np.ndarray,
    obstacles: Spheres,
    random: np.random.Generator,
    solid_fraction: float,
) -> str:
    """Statement how many of the spheres fit: the largest number that was packed, of the first spheres.

    The numbers tried fill TRIED_FRACTIONS of the region, and are rounded to two digits. More than MAX_TRIED
    spheres are not packed for a message.
    """
    counts = [float(f"{len(radius) * each / solid_fraction:.2g}") for each in TRIED_FRACTIONS]
    for count in dict.fromkeys([*map(int, counts), 1]):
        if not 0 < count < len(radius):
            continue
        if count > MAX_TRIED or _packed(region, radius[:count], obstacles, deepcopy(random)) is not None:
            return f"about {count} fit" if count > 1 else only_fit(1)
    return only_fit(0)


def separate_overlapping(
    spheres: Spheres, mobile_count: int, region: FilledRegion, swelling: float
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


def check_width(region: RegionSampler, radius: float) -> None:
    """Raise RegionFullError if a single sphere of the largest radius [m] does not fit."""
    if radius > region.radius_max * (1 + 1e-9):
        raise RegionFullError(
            only_fit(0),
            f"The largest, {2 * radius:g} m, is wider than the region, {2 * region.radius_max:g} m.",
        )


def only_fit(count: int) -> str:
    """Statement that only `count` particles fit."""
    return {0: "none fits", 1: "only 1 fits"}.get(count, f"only {count} fit")


def packing_remedy(solid_fraction: float) -> str:
    """Advice for a packing that is too dense; `solid_fraction`: requested."""
    return (
        f"The requested number would fill {solid_fraction:.0%} of it. A random packing reaches about 50%, "
        "less in a region that is a few diameters wide. Lower it or enlarge the region."
    )
