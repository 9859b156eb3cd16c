"""Coarse-grained fields on a grid: sums over particles and contacts, and the fields that follow from them.

`accumulate` distributes the particles and contacts of a snapshot to the cells of a `CoarseGrid` with a
`GaussianKernel`. The sums are additive over snapshots; `fields_from` computes the fields from them.

Goldhirsch, Granular Matter 12 (2010) 239; Weinhart et al., Granular Matter 14 (2012) 289 for walls. m, x, v:
mass, center and velocity of a particle; f: force on particle i of a contact; b: branch vector from i to its
partner, or to the contact point on a wall; W: kernel; L: its mean along the branch vector.

    density rho = sum m W         momentum rho V = sum m v W         contact stress = sum f b L
    kinetic stress = -sum m (v - V)(v - V) W = rho V V - sum m v v W

    thermal = rho T of one snapshot, whose mean over time excludes the motion of V in time

A clump is one body: x and v are those of its center of mass, and its branch vectors begin there
(`of_bodies`). Its spheres have shares of its mass and volume.

Stresses are positive in tension. All formulas: docs/pages/guides/coarse_graining.md.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from granflow.geometry.clump import matrices
from granflow.geometry.coarse_grid import CoarseGrid, GaussianKernel
from granflow.geometry.sphere import sphere_volume
from granflow.scene.blocks.particle_shapes.shape import ParticleShape
from granflow.snapshot import mobile_particles

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


def of_bodies(
    particles: Mapping[str, np.ndarray], shapes: Sequence[ParticleShape]
) -> Mapping[str, np.ndarray]:
    """The particles of a snapshot with the motion of their rigid bodies; unchanged without clumps.

    shapes:   of the particles of each group
    Returns:  with `position` and `velocity` of the center of mass of the clump for each of its spheres,
              `arm` (n, 3) [m] from there to the sphere, and `volume` (n,) [m3], the share of the sphere

        x = x_s - a,   v = v_s - w x a,      a = R(q) offset
    """
    if all(shape.body is None for shape in shapes):
        return particles
    arm = np.zeros((len(particles["id"]), 3))
    volume = sphere_volume(particles["radius"].astype(float))
    for number, shape in enumerate(shapes):
        rows = np.flatnonzero(particles["group"] == number)
        if shape.body is not None and len(rows):
            member = particles["id"][rows] - particles["clump"][rows]
            rotation = matrices(particles["orientation"][rows].astype(float))
            arm[rows] = np.einsum("nij,nj->ni", rotation, shape.body.offset[member])
            volume[rows] = shape.body.sphere_volumes[member]
    turning = np.cross(particles["angular_velocity"].astype(float), arm)
    position = particles["position"].astype(float) - arm
    velocity = particles["velocity"].astype(float) - turning
    return {**particles, "position": position, "velocity": velocity, "arm": arm, "volume": volume}


def accumulate(
    particles: Mapping[str, np.ndarray],
    contacts: Mapping[str, np.ndarray] | None,
    grid: CoarseGrid,
    kernel: GaussianKernel,
) -> AccumulatedFields:
    """Return the sums over the particles of a snapshot, and over its contacts unless None.

    `particles`: arrays `mass` [kg], `radius` [m], `coordination_number` (n,), `position` [m], `velocity`
    [m/s] (n, 3), and `fixed` (n,) if the scene has fixed particles, which are excluded, and
    `temperature` (n,) [K] if particles have one; with clumps as `of_bodies` returns them. `contacts`: arrays
    `position_i`, `position_j` [m], `force` [N] on particle i, each (k, 3), `overlap` [m] and `wall` (k,),
    with clumps also `id_i` and `id_j` (k,). Sums are in double precision.
    """
    found = _accumulate_particles(particles, grid, kernel)
    if "temperature" in particles:
        mobile = mobile_particles(particles)
        weighted = mobile["mass"].astype(float) * mobile["temperature"]
        total = grid.deposit(kernel, mobile["position"].astype(float), weighted[:, None])
        found["mass_temperature"] = total / grid.cell_volume
    found["thermal"] = -_trace(_kinetic_stress(found))[:, None] / 3.0
    if contacts is not None:
        found |= _accumulate_contacts(_between_bodies(contacts, particles), grid, kernel)
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
    if "mass_temperature" in s:
        found["temperature"] = _ratio(s["mass_temperature"], density)[:, 0]
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
    is_sphere = "volume" not in particles
    volume = sphere_volume(particles["radius"].astype(float)) if is_sphere else particles["volume"]
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


def _between_bodies(
    contacts: Mapping[str, np.ndarray], particles: Mapping[str, np.ndarray]
) -> Mapping[str, np.ndarray]:
    """The contacts with branch vectors that begin and end at the centers of mass of clumps; unchanged without
    `arm`."""
    if "arm" not in particles:
        return contacts
    found = dict(contacts)
    for end in "ij":
        ids = contacts[f"id_{end}"]
        arm = particles["arm"][np.searchsorted(particles["id"], np.maximum(ids, 0))]
        position = contacts[f"position_{end}"].astype(float)
        found[f"position_{end}"] = position - np.where(ids[:, None] >= 0, arm, 0.0)  # -1: a wall
    return found


def _accumulate_contacts(
    contacts: Mapping[str, np.ndarray], grid: CoarseGrid, kernel: GaussianKernel
) -> dict[str, np.ndarray]:
    """Return the sums of CONTACT_ACCUMULATED over the contacts, per cell volume: name -> (cells, components).

    The mean of the kernel along the branch vector, L, is a quadrature (Goldhirsch 2010). For a contact with a
    wall, the branch vector ends at the contact point (Weinhart et al. 2012). Number and fabric are those of
    the contacts between particles, without separated pairs.
    """
    start = contacts["position_i"].astype(float)
    branch = contacts["position_j"].astype(float) - start
    force = contacts["force"].astype(float)
    length = np.linalg.norm(branch, axis=1)
    normal = branch / length[:, None]
    counts = ((contacts["wall"] < 0) & (contacts["overlap"] > 0.0)).astype(float)
    fabric = counts[:, None] * _dyads(normal, normal)
    values = np.column_stack([_dyads(force, branch), counts, fabric])
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
