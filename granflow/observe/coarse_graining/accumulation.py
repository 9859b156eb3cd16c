"""From particles and contacts to fields on a grid: first sums that add up over cells and moments, then what they mean.

Goldhirsch, Granular Matter 12 (2010) 239; Weinhart et al., Granular Matter 14 (2012) 289 for walls. m, x, v: mass,
center and velocity of a particle; f: force on particle i of a contact; b: branch from i to its partner, or to the foot
point on a wall; W: kernel, and L its mean along the branch.

    density rho = sum m W         momentum rho V = sum m v W         contact stress = sum f b L
    kinetic stress = -sum m (v - V)(v - V) W = rho V V - sum m v v W

Stresses are positive in tension. See docs/coarse_graining.md for all of them.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from granflow.observe.coarse_graining.field_grid import CoarseGrid
from granflow.observe.coarse_graining.kernel import GaussianKernel
from granflow.observe.particle_selection import mobile_particles

PARTICLE_FIELDS = {"mass": 1, "volume": 1, "number": 1, "touching": 1, "momentum": 3, "momentum_flux": 9}
CONTACT_ACCUMULATED = {"contact_stress": 9, "contact_number": 1, "fabric": 9}
"""What is added up, and how many numbers each is."""

CONTACT_FIELDS = ("contact_stress", "pressure", "fabric")
"""Fields for which contacts are needed."""


@dataclass(frozen=True)
class AccumulatedFields:
    """Sums over each cell, per volume of a cell: name -> (cells, numbers)."""

    arrays: dict[str, np.ndarray]

    def __add__(self, other: "AccumulatedFields") -> "AccumulatedFields":
        """Cell by cell."""
        return AccumulatedFields({name: array + other.arrays[name] for name, array in self.arrays.items()})

    def __truediv__(self, number: float) -> "AccumulatedFields":
        """Each sum over a number: the mean of so many moments."""
        return AccumulatedFields({name: array / number for name, array in self.arrays.items()})


def accumulate(
    particles: Mapping[str, np.ndarray],
    contacts: Mapping[str, np.ndarray] | None,
    grid: CoarseGrid,
    kernel: GaussianKernel,
) -> AccumulatedFields:
    """The sums of a snapshot's particles, and of its contacts unless they are None."""
    found = _accumulate_particles(particles, grid, kernel)
    if contacts is not None:
        found |= _accumulate_contacts(contacts, grid, kernel)
    return AccumulatedFields(found)


def fields_from(accumulated: AccumulatedFields) -> dict[str, np.ndarray]:
    """Every field that the sums tell, by its name in FIELD_QUANTITIES; not a number where nothing is.

    Of mean sums the fluctuations are those about the mean velocity, in space and in time.
    """
    s = accumulated.arrays
    density = s["mass"]
    velocity = _ratio(s["momentum"], density)
    mean_flux = np.where(density > 0.0, _dyads(velocity, s["momentum"]), 0.0)
    kinetic_stress = mean_flux - s["momentum_flux"]
    found = {
        "density": density[:, 0],
        "solid_fraction": s["volume"][:, 0],
        "momentum": s["momentum"],
        "velocity": velocity,
        "granular_temperature": _ratio(np.maximum(-_trace(kinetic_stress)[:, None], 0.0) / 3.0, density)[:, 0],
        "kinetic_stress": kinetic_stress,
        "coordination_number": _ratio(s["touching"], s["number"])[:, 0],
    }
    if "contact_stress" in s:
        found["contact_stress"] = s["contact_stress"]
        found["pressure"] = -_trace(kinetic_stress + s["contact_stress"]) / 3.0
        found["fabric"] = _ratio(s["fabric"], s["contact_number"])
    return found


def _accumulate_particles(
    particles: Mapping[str, np.ndarray], grid: CoarseGrid, kernel: GaussianKernel
) -> dict[str, np.ndarray]:
    particles = mobile_particles(particles)
    mass, velocity = (particles[name].astype(float) for name in ("mass", "velocity"))
    momentum = mass[:, None] * velocity
    volume = 4.0 / 3.0 * np.pi * particles["radius"].astype(float) ** 3
    each = [mass, volume, np.ones_like(mass), particles["coordination_number"], momentum, _dyads(momentum, velocity)]
    values = np.column_stack(each)
    return _split(PARTICLE_FIELDS, grid.deposit(kernel, particles["position"].astype(float), values) / grid.cell_volume)


def _accumulate_contacts(
    contacts: Mapping[str, np.ndarray], grid: CoarseGrid, kernel: GaussianKernel
) -> dict[str, np.ndarray]:
    start, end, force = (contacts[name].astype(float) for name in ("position_i", "position_j", "force"))
    branch = end - start
    length = np.linalg.norm(branch, axis=1)
    normal = branch / length[:, None]
    values = np.column_stack([_dyads(force, branch), np.ones_like(length), _dyads(normal, normal)])
    total = np.zeros((grid.cell_count, values.shape[1]))
    for position, weight in _quadrature_points(length.max(initial=0.0) / kernel.width):
        total += grid.deposit(kernel, start + position * branch, weight * values)
    return _split(CONTACT_ACCUMULATED, total / grid.cell_volume)


def _quadrature_points(widths: float) -> list[tuple[float, float]]:
    """Places in [0, 1] and weights of a Gauss-Legendre quadrature of the kernel along a branch of so many widths.

    So many that the error is below 1e-3 of the largest value for branches up to ten widths.
    """
    places, weights = np.polynomial.legendre.leggauss(2 + int(np.ceil(widths)))
    return list(zip(0.5 * (places + 1.0), 0.5 * weights, strict=True))


def _dyads(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Products of two vectors each, (n, 9): xx, xy, xz, yx, ..."""
    return np.einsum("na,nb->nab", first, second).reshape(-1, 9)


def _trace(tensor: np.ndarray) -> np.ndarray:
    return tensor[:, 0] + tensor[:, 4] + tensor[:, 8]


def _ratio(number: np.ndarray, total: np.ndarray) -> np.ndarray:
    """Quotient; not a number where the total is 0."""
    return np.divide(number, total, out=np.full_like(number, np.nan), where=total > 0.0)


def _split(sizes: Mapping[str, int], values: np.ndarray) -> dict[str, np.ndarray]:
    ends = np.cumsum(list(sizes.values()))
    return dict(zip(sizes, np.split(values, ends[:-1], axis=1), strict=True))
