"""Angle of repose: the slope of the free surface of a heap, or of a bed in a drum.

The surface consists of the highest particle of each square column; the tops of these spheres are fitted.
"""

from dataclasses import dataclass

import numpy as np

FLANK = (0.8, 0.2)
"""Upper and lower end of the fitted flank, over the height of the cone: excludes the rounded top and the foot."""

FEWEST = 4
"""Smallest number of surface points for a fit."""

SIGNIFICANCE = 0.05
"""Largest share of rough level surfaces, with independent heights of the points, that a fit takes for a slope."""

RELATIVE_ERROR = 0.25
"""Largest standard error of a gradient over its magnitude."""


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


def slope_of_cone(points: np.ndarray, radius: np.ndarray, edge: float, axis: np.ndarray | None = None) -> Slope:
    """Return the slope of the flank of a conical heap of spheres with centers (n, 3), z upward, and radii (n,) [m].

    `edge` [m]: of the columns, about two diameters; `axis` (2,) [m]: of the cone, the mean of all centers if None. The
    flank is where the mean height of a ring around the axis is between 0.8 and 0.2 of the largest; a straight line is
    fitted to the height over the distance from the axis by least squares. The angle is not negative. NaN without
    particles, with fewer than FEWEST surface points on the flank, or if the fit is not significant, see `_slope`.
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
    """Return the slope of the plane fitted to the surface of spheres with centers (n, 3), z upward, and radii (n,) [m].

    `edge` [m]: of the columns. For one side of a wedge, or for the middle of a drum. NaN without particles, with fewer
    than FEWEST surface points, if these lie on a line, or if the fit is not significant, see `_slope`.
    """
    if not len(points):
        return no_slope("there are no particles with enough contacts in the region")
    surface = surface_points(points, radius, edge)
    return _slope(surface[:, :2], surface[:, 2])


def surface_points(points: np.ndarray, radius: np.ndarray, edge: float) -> np.ndarray:
    """Return the tops (m, 3) [m] of the highest spheres, one for each column that contains spheres.

    The columns are about `edge` [m] wide and divide the extent of the points evenly: in a narrow column at the border,
    the highest sphere would be deep inside the heap.
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
    """Return the angle of the line or plane fitted to heights (n,) [m] over horizontal positions (n, d = 1 or 2) [m].

        angle = arctan |g|,      error = sqrt(d C d) / (1 + |g|^2)

    g: gradient, d = g / |g|, C: covariance of g from the residuals of the least-squares fit. The fit is a slope if a
    level surface with independent, normally distributed heights has the same coefficient of determination R^2 with a
    probability below SIGNIFICANCE (F-test of the regression), and if sqrt(d C d) is at most RELATIVE_ERROR |g|. The
    second condition is the stricter one for few points, or if the points extend little along g.
    """
    if len(height) < FEWEST:
        return no_slope(f"the surface has {len(height)} points, but a fit needs at least {FEWEST}")
    offsets = position - position.mean(axis=0)
    matrix = np.column_stack([np.ones(len(height)), offsets])
    found, _, rank, _ = np.linalg.lstsq(matrix, height, rcond=None)
    if rank < matrix.shape[1]:
        return no_slope("the points of the surface lie on a line")
    gradient, freedom = found[1:], len(height) - matrix.shape[1]
    steepness = float(np.linalg.norm(gradient))
    residual = height - matrix @ found
    total = float(((height - height.mean()) ** 2).sum())
    unexplained = float(residual @ residual) / total if total > 0.0 else 1.0
    spread = np.linalg.inv(matrix.T @ matrix)[1:, 1:] * (residual @ residual) / freedom
    along = gradient / steepness if steepness > 0.0 else gradient
    error = float(np.sqrt(along @ spread @ along))
    if not _chance(unexplained, len(gradient), freedom) < SIGNIFICANCE:
        return no_slope(
            f"the fit to {len(height)} points of the surface explains {1.0 - unexplained:.0%} of the variance of their "
            "heights, and rough level surfaces reach as much by chance: the surface is not a slope, or the region is "
            "too small"
        )
    if error > RELATIVE_ERROR * steepness:
        return no_slope(
            f"the gradient of the fit to {len(height)} points of the surface has a standard error of "
            f"{error / steepness:.0%} of it, above {RELATIVE_ERROR:.0%}: the region is too small or too narrow"
        )
    return Slope(float(np.arctan(steepness)), error / (1.0 + steepness**2))


def _chance(unexplained: float, slopes: int, freedom: int) -> float:
    """Probability that a fit of `slopes` coefficients to independent heights leaves at most this share unexplained.

    The share 1 - R^2 has the beta distribution with the parameters freedom / 2 and slopes / 2.
    """
    from scipy.special import betainc

    return float(betainc(0.5 * freedom, 0.5 * slopes, min(unexplained, 1.0)))
