"""Coarse-grained fields on a grid: sums over particles and contacts, and the fields that follow from them.

`accumulate` distributes the particles and contacts of a snapshot to the cells of a `CoarseGrid` with a
`GaussianKernel`. The sums are additive over snapshots; `fields_from` computes the fields from them.

Goldhirsch, Granular Matter 12 (2010) 239; Weinhart et al., Granular Matter 14 (2012) 289 for walls. m, x, v:
mass, center and velocity of a particle; f: force on particle i of a contact; b: branch vector from i to its
partner, or to the contact point on a wall; W: kernel; L: its mean along the branch vector.

    density rho = sum m W         momentum rho V = sum m v W         contact stress = sum f b L
    kinetic stress = -sum m (v - V)(v - V) W = rho V V - sum m v v W

    thermal = rho T of one snapshot, whose mean over time excludes the motion of V in time

Stresses are positive in tension. All formulas: docs/pages/guides/coarse_graining.md.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache, cached_property
from math import erf, sqrt

import numpy as np

from granflow.fields import FIELD_QUANTITIES, units
from granflow.geometry.periodic_box import AXES
from granflow.geometry.shape import sphere_volume
from granflow.io.vtu import VtuMesh
from granflow.scene.blocks.domain import Domain
from granflow.scene.blocks.output import GridSpec

# Kernel: a truncated and normalized Gaussian along each axis

NODES = 2**14
"""Nodes in the table of the distribution function; linear interpolation has an error of 1e-8."""


class GaussianKernel:
    """The weight of a point at r [1/m3]: W(r) = g(x) g(y) g(z), which integrates to 1.

        g(s) = exp(-s^2 / 2 w^2) / (sqrt(2 pi) w erf(c / sqrt(2)))      |s| < c w, else 0

    `width`: w [m]; `cutoff`: c, in widths; `reach`: c w [m], half the edge of the cube outside which W is 0.
    Within the cutoff, W depends only on the distance, since the product of the three Gaussians does.
    """

    def __init__(self, width: float, cutoff: float) -> None:
        self.width = width
        self.cutoff = cutoff
        self.reach = cutoff * width
        self._table = _distribution(cutoff)

    def cumulative(self, distance: np.ndarray) -> np.ndarray:
        """Return the integral of g from minus infinity to `distance` [m], an array of any shape; from 0 to 1.

        A cell gets the share cumulative(upper edge) - cumulative(lower edge) along each axis.
        """
        nodes, shares = self._table
        return np.interp(distance / self.width, nodes, shares)


@cache
def _distribution(cutoff: float) -> tuple[np.ndarray, np.ndarray]:
    """Return nodes from -cutoff to cutoff, in widths, and the integral of the kernel up to each, from 0 to
    1."""
    nodes = np.linspace(-cutoff, cutoff, NODES)
    full = erf(cutoff / sqrt(2.0))
    return nodes, np.array([0.5 + 0.5 * erf(node / sqrt(2.0)) / full for node in nodes])


# Grid: a box of equal cells to which points are distributed with a kernel

CHUNK_POINTS = 2**17
"""Points processed at a time, which limits the temporary memory."""
LARGEST_PRODUCT = 2**18
"""Largest number of multiplications in a matrix product: above it, OpenBLAS starts threads that compete for
cores."""
BLOCK = 16
"""Cells along x whose points are processed in one matrix product."""
CORNERS = ((0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1))
"""Corners of a hexahedron in the order of VTK."""


@dataclass(frozen=True)
class CoarseGrid:
    """A box from `low` to `high` (3,) [m] with `counts` cells along x, y and z.

    Cell (i, j, k) has the index i + nx (j + ny k): x fastest, as in VTK. Along a `periodic` axis the box is
    one period.
    """

    low: tuple[float, float, float]
    high: tuple[float, float, float]
    counts: tuple[int, int, int]
    periodic: tuple[bool, bool, bool] = (False, False, False)

    @cached_property
    def cell_size(self) -> np.ndarray:
        """Edge lengths of a cell (3,) [m]."""
        return (np.array(self.high) - self.low) / self.counts

    @property
    def cell_volume(self) -> float:
        """Volume of a cell [m3]."""
        return float(np.prod(self.cell_size))

    @property
    def cell_count(self) -> int:
        """Number of cells."""
        return int(np.prod(self.counts))

    def centers(self) -> np.ndarray:
        """Return the centers of all cells (cells, 3) [m], in the order of the cell indices."""
        x, y, z = (
            low + (np.arange(n) + 0.5) * h
            for low, n, h in zip(self.low, self.counts, self.cell_size, strict=True)
        )
        grid = np.meshgrid(z, y, x, indexing="ij")
        return np.stack([axis.ravel() for axis in grid[::-1]], axis=1)

    def deposit(self, kernel: GaussianKernel, points: np.ndarray, values: np.ndarray) -> np.ndarray:
        """Return the integrals (cells, k) over each cell of the values (n, k) distributed around points (n,
        3) [m].

        Contributions outside the grid are omitted, or wrap around along periodic axes. The integrals are
        exact: if the grid contains the whole support of the kernels, the sum over the cells is the sum of the
        values. Division by `cell_volume` gives densities [1/m3]. The memory is bounded: CHUNK_POINTS points
        are processed at a time.
        """
        low = np.array(self.low)
        width = np.array(self.high) - self.low
        points = np.where(self.periodic, low + np.mod(points - low, width), points)
        first = np.floor((points - kernel.reach - self.low) / self.cell_size).astype(np.int64)
        reached_cells = np.ceil(2.0 * kernel.reach / self.cell_size).astype(np.int64) + 1
        near = np.flatnonzero(((first + reached_cells > 0) & (first < self.counts)).all(axis=1))
        padded_grid = _Padded(self, reached_cells, values.shape[1])
        for begin in range(0, len(near), CHUNK_POINTS):
            piece = near[begin : begin + CHUNK_POINTS]
            padded_grid.add(kernel, points[piece], values[piece], first[piece])
        return padded_grid.fold()

    def cells_of(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the cell index (n,) of points (n, 3) [m], and whether each point is inside the grid (n,).

        The index of a point outside the grid is meaningless. Points are not wrapped along periodic axes.
        """
        index = np.floor((points - np.array(self.low)) / self.cell_size).astype(np.int64)
        inside = ((index >= 0) & (index < self.counts)).all(axis=1)
        return index @ np.array([1, self.counts[0], self.counts[0] * self.counts[1]]), inside

    def mesh(self, arrays: dict[str, np.ndarray]) -> VtuMesh:
        """Return a mesh of hexahedra with cell arrays (cells,) or (cells, k), in the order of the cell
        indices."""
        nx, ny, nz = self.counts
        axes = [
            np.linspace(low, high, n + 1)
            for low, high, n in zip(self.low, self.high, self.counts, strict=True)
        ]
        z, y, x = np.meshgrid(*axes[::-1], indexing="ij")
        points = np.stack([x.ravel(), y.ravel(), z.ravel()], axis=1)
        k, j, i = (part.ravel() for part in np.meshgrid(*(np.arange(n) for n in (nz, ny, nx)), indexing="ij"))
        corners = [(i + a) + (nx + 1) * ((j + b) + (ny + 1) * (k + c)) for a, b, c in CORNERS]
        return VtuMesh.of_cells(
            "hexahedron", points, np.stack(corners, axis=1), arrays, units(FIELD_QUANTITIES)
        )


def grid_for(domain: Domain, spec: GridSpec) -> CoarseGrid:
    """Return the grid that the scene specifies; the default region is the domain.

    `spec`: entry of `output.fields` or of `output.metrics` with a grid. Axes that are periodic in the domain
    are periodic in the grid.
    """
    box = spec.region or domain
    x, y, z = (axis in domain.periodic for axis in AXES)
    return CoarseGrid(box.min, box.max, spec.cell_counts(domain), (x, y, z))


class _Padded:
    """The cells of a grid with a margin as wide as the kernels: array (z, y, x, k).

    Points whose kernels begin in the same cells along y and z, and in the same block of cells along x, are
    added with one matrix product.
    """

    def __init__(self, grid: CoarseGrid, reached_cells: np.ndarray, width: int) -> None:
        self.grid = grid
        self.reached_cells = reached_cells
        self.width = width
        self.window = reached_cells + np.array([BLOCK - 1, 0, 0])
        self.total = np.zeros((*(reached_cells + grid.counts + self.window)[::-1], width))

    def add(self, kernel: GaussianKernel, points: np.ndarray, values: np.ndarray, first: np.ndarray) -> None:
        """Add points (n, 3) [m] with values (n, k); `first` (n, 3): first cell within the kernel of each
        point."""
        base = first + self.reached_cells
        base[:, 0] -= base[:, 0] % BLOCK
        order = np.lexsort(base.T)
        base = base[order]
        points = points[order]
        values = values[order]
        x, y, z = (self._shares(kernel, points[:, axis], base[:, axis], axis) for axis in range(3))
        max_points = max(LARGEST_PRODUCT // (y.shape[1] * x.shape[1] * self.width), 1)
        changes = (np.diff(base, axis=0) != 0).any(axis=1)
        starts = np.flatnonzero(np.append(True, changes) | (np.arange(len(base)) % max_points == 0))
        for begin, end in zip(starts, [*starts[1:], len(base)], strict=True):
            along = (x[begin:end, :, None] * values[begin:end, None, :]).reshape(end - begin, -1)
            i, j, k = base[begin]
            for layer, weight in enumerate(z[begin:end].T):
                target = self.total[k + layer, j : j + y.shape[1], i : i + x.shape[1]]
                target += ((weight[:, None] * y[begin:end]).T @ along).reshape(target.shape)

    def _shares(
        self, kernel: GaussianKernel, position: np.ndarray, base: np.ndarray, axis: int
    ) -> np.ndarray:
        """Return the share (n, cells) of each point in the cells of its window along one axis."""
        edges = base[:, None] - self.reached_cells[axis] + np.arange(self.window[axis] + 1)
        distance = self.grid.low[axis] + self.grid.cell_size[axis] * edges - position[:, None]
        return np.diff(kernel.cumulative(distance), axis=1)

    def fold(self) -> np.ndarray:
        """Return the cells of the grid (cells, k); along periodic axes, the margin is added to them.

        Along other axes, the margin is dropped.
        """
        total = self.total
        for axis in range(3):  # z, y, x
            count = self.grid.counts[2 - axis]
            pad = self.reached_cells[2 - axis]
            total = np.moveaxis(total, axis, 0)
            inner = total[pad : pad + count].copy()
            if self.grid.periodic[2 - axis]:
                inner[:] = 0.0
                np.add.at(inner, (np.arange(len(total)) - pad) % count, total)
            total = np.moveaxis(inner, 0, axis)
        return np.ascontiguousarray(total).reshape(-1, self.width)


# Subsets of the arrays of a snapshot


def mobile_particles(particles: Mapping[str, np.ndarray]) -> Mapping[str, np.ndarray]:
    """Return the arrays without fixed particles, which count as walls; the same arrays if the scene has
    none."""
    return selected(particles, particles["fixed"] == 0) if "fixed" in particles else particles


def selected(arrays: Mapping[str, np.ndarray], mask: np.ndarray) -> dict[str, np.ndarray]:
    """Return the entries of all arrays (n, ...) for which `mask` (n,) is True."""
    return {name: values[mask] for name, values in arrays.items()}


# Sums and fields

PARTICLE_FIELDS = {"mass": 1, "volume": 1, "number": 1, "touching": 1, "momentum": 3, "momentum_flux": 9}
"""Quantities accumulated over particles, with their numbers of components."""
CONTACT_ACCUMULATED = {"contact_stress": 9, "contact_number": 1, "fabric": 9}
"""Quantities accumulated over contacts, with their numbers of components."""
CONTACT_FIELDS = ("contact_stress", "pressure", "fabric")
"""Fields that require contacts."""


@dataclass(frozen=True)
class AccumulatedFields:
    """Sums over each cell per cell volume: name -> (cells, components)."""

    arrays: dict[str, np.ndarray]

    def __add__(self, other: "AccumulatedFields") -> "AccumulatedFields":
        """Add the sums of each cell; both operands must have the same names and grid."""
        return AccumulatedFields({name: array + other.arrays[name] for name, array in self.arrays.items()})

    def __truediv__(self, number: float) -> "AccumulatedFields":
        """Divide each sum by a number: the mean over that number of snapshots."""
        return AccumulatedFields({name: array / number for name, array in self.arrays.items()})


def accumulate(
    particles: Mapping[str, np.ndarray],
    contacts: Mapping[str, np.ndarray] | None,
    grid: CoarseGrid,
    kernel: GaussianKernel,
) -> AccumulatedFields:
    """Return the sums over the particles of a snapshot, and over its contacts unless None.

    `particles`: arrays `mass` [kg], `radius` [m], `coordination_number` (n,), `position` [m], `velocity`
    [m/s] (n, 3), and `fixed` (n,) if the scene has fixed particles, which are excluded. `contacts`: arrays
    `position_i`, `position_j` [m], `force` [N] on particle i, each (k, 3). Sums are in double precision.
    """
    found = _accumulate_particles(particles, grid, kernel)
    found["thermal"] = -_trace(_kinetic_stress(found))[:, None] / 3.0
    if contacts is not None:
        found |= _accumulate_contacts(contacts, grid, kernel)
    return AccumulatedFields(found)


def fields_from(accumulated: AccumulatedFields) -> dict[str, np.ndarray]:
    """Return all fields that follow from the sums, by name in FIELD_QUANTITIES; NaN in cells without
    particles.

    Scalars (cells,), vectors (cells, 3), tensors (cells, 9) in the order xx, xy, xz, yx, ...; stresses [Pa].
    The granular temperature is a third of the mean square of v - V [m2/s2]; it is 0 where rounding makes it
    negative.

    For time-averaged sums, fluctuations are those about the mean velocity in space and time (Goldhirsch
    2010); `granular_temperature_of_frames` is the mean of the temperatures of the snapshots, weighted by
    their density. `contact_stress`, `pressure` and `fabric` are absent without contacts.
    """
    s = accumulated.arrays
    density = s["mass"]
    velocity = _ratio(s["momentum"], density)
    kinetic_stress = _kinetic_stress(s)
    fluctuation = np.maximum(-_trace(kinetic_stress)[:, None], 0.0) / 3.0
    found = {
        "density": density[:, 0],
        "solid_fraction": s["volume"][:, 0],
        "momentum": s["momentum"],
        "velocity": velocity,
        "granular_temperature": _ratio(fluctuation, density)[:, 0],
        "granular_temperature_of_frames": _ratio(np.maximum(s["thermal"], 0.0), density)[:, 0],
        "kinetic_stress": kinetic_stress,
        "coordination_number": _ratio(s["touching"], s["number"])[:, 0],
    }
    if "contact_stress" in s:
        found["contact_stress"] = s["contact_stress"]
        found["pressure"] = -_trace(kinetic_stress + s["contact_stress"]) / 3.0
        found["fabric"] = _ratio(s["fabric"], s["contact_number"])
    return found


def _kinetic_stress(sums: Mapping[str, np.ndarray]) -> np.ndarray:
    """Return the kinetic stress (cells, 9) [Pa]; 0 in cells without particles."""
    velocity = _ratio(sums["momentum"], sums["mass"])
    mean_flux = np.where(sums["mass"] > 0.0, _dyads(velocity, sums["momentum"]), 0.0)
    return np.asarray(mean_flux - sums["momentum_flux"])


def _accumulate_particles(
    particles: Mapping[str, np.ndarray], grid: CoarseGrid, kernel: GaussianKernel
) -> dict[str, np.ndarray]:
    """Return the sums of PARTICLE_FIELDS over the mobile particles, per cell volume: name -> (cells,
    components)."""
    particles = mobile_particles(particles)
    mass = particles["mass"].astype(float)
    velocity = particles["velocity"].astype(float)
    momentum = mass[:, None] * velocity
    volume = sphere_volume(particles["radius"].astype(float))
    values = np.column_stack(
        [
            mass,
            volume,
            np.ones_like(mass),
            particles["coordination_number"],
            momentum,
            _dyads(momentum, velocity),
        ]
    )
    total = grid.deposit(kernel, particles["position"].astype(float), values)
    return _split(PARTICLE_FIELDS, total / grid.cell_volume)


def _accumulate_contacts(
    contacts: Mapping[str, np.ndarray], grid: CoarseGrid, kernel: GaussianKernel
) -> dict[str, np.ndarray]:
    """Return the sums of CONTACT_ACCUMULATED over the contacts, per cell volume: name -> (cells, components).

    The mean of the kernel along the branch vector, L, is a quadrature (Goldhirsch 2010). For a contact with a
    wall, the branch vector ends at the contact point (Weinhart et al. 2012).
    """
    start = contacts["position_i"].astype(float)
    branch = contacts["position_j"].astype(float) - start
    force = contacts["force"].astype(float)
    length = np.linalg.norm(branch, axis=1)
    normal = branch / length[:, None]
    values = np.column_stack([_dyads(force, branch), np.ones_like(length), _dyads(normal, normal)])
    total = np.zeros((grid.cell_count, values.shape[1]))
    for position, weight in _quadrature_points(length.max(initial=0.0) / kernel.width):
        total += grid.deposit(kernel, start + position * branch, weight * values)
    return _split(CONTACT_ACCUMULATED, total / grid.cell_volume)


def _quadrature_points(widths: float) -> list[tuple[float, float]]:
    """Return positions in [0, 1] and weights of a Gauss-Legendre quadrature of the kernel along a branch
    vector.

    `widths`: length of the branch vector over the kernel width. The error is below 1e-3 of the largest value
    for up to ten widths.
    """
    positions, weights = np.polynomial.legendre.leggauss(2 + int(np.ceil(widths)))
    return list(zip(0.5 * (positions + 1.0), 0.5 * weights, strict=True))


def _dyads(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return the dyadic products (n, 9) of vectors (n, 3): xx, xy, xz, yx, ..."""
    return np.einsum("na,nb->nab", first, second).reshape(-1, 9)


def _trace(tensor: np.ndarray) -> np.ndarray:
    """Return the traces (n,) of tensors (n, 9)."""
    return tensor[:, 0] + tensor[:, 4] + tensor[:, 8]


def _ratio(number: np.ndarray, total: np.ndarray) -> np.ndarray:
    """Return the quotient of arrays that broadcast to the shape of `number`; NaN where `total` is 0."""
    return np.divide(number, total, out=np.full_like(number, np.nan), where=total > 0.0)


def _split(sizes: Mapping[str, int], values: np.ndarray) -> dict[str, np.ndarray]:
    """Return the columns of `values` (cells, components) by name; `sizes`: number of components of each
    name."""
    ends = np.cumsum(list(sizes.values()))
    return dict(zip(sizes, np.split(values, ends[:-1], axis=1), strict=True))
