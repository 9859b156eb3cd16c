"""Cases of the benchmark: settled beds and a discharging hopper, with one material and one time step."""

import gzip
from dataclasses import dataclass
from math import log, pi, sqrt, tan
from pathlib import Path

import numpy as np

YOUNG_MODULUS = 1e7  # Pa
POISSON_RATIO = 0.25
DENSITY = 2500.0  # kg/m3
FRICTION = 0.5
RESTITUTION = 0.9
GRAVITY = 9.81  # m/s2
TIME_STEP = 1e-5  # s
LINEAR_STIFFNESS = 1000.0  # N/m, about the Hertz tangent at the mean overlap of these beds
RADIUS_MEAN = 2e-3  # m
OVERLAP_MEAN = 1.5e-5  # m, in these beds; LAMMPS' damping is set for it

ORIFICE_RADIUS, TUBE_RADIUS, TUBE_TOP = 0.02, 0.06, 0.33  # m
CONE_HEIGHT = (TUBE_RADIUS - ORIFICE_RADIUS) / tan(pi / 6)
HOPPER_FLOOR = -0.05  # m; particles below are deleted
HOPPER_REACH = 0.065  # m, half the box around it

SIZES = (1_000, 10_000, 50_000, 200_000, 1_000_000)
SEED_SIZES = (1_000, 10_000)
"""Particle counts of beds that granflow settles if no files are given; larger beds are tiled from them."""


@dataclass(frozen=True)
class Case:
    """Initial state: diameter (n,) [m] and position (n, 3) [m], sides (2,) [m] of the box around a bed."""

    name: str
    kind: str
    diameter: np.ndarray
    position: np.ndarray
    sides: tuple[float, float]

    @property
    def count(self) -> int:
        """Number of particles."""
        return len(self.diameter)

    def save(self, path: Path) -> None:
        """Writes the case to a file for `load`."""
        np.savez(
            path,
            name=self.name,
            kind=self.kind,
            diameter=self.diameter,
            position=self.position,
            sides=self.sides,
        )

    @classmethod
    def load(cls, path: Path) -> "Case":
        """Reads a case from a file of `save`."""
        with np.load(path) as arrays:
            sides = (float(arrays["sides"][0]), float(arrays["sides"][1]))
            return cls(
                str(arrays["name"]), str(arrays["kind"]), arrays["diameter"], arrays["position"], sides
            )


@dataclass(frozen=True)
class Steps:
    """Length of a measurement: warm-up steps and measured steps."""

    warm: int
    window: int


def steps_for(case: Case, slow: bool, scale: float) -> Steps:
    """Steps for a measurement of some seconds, independent of the particle count; a tenth of them for a slow
    code.

    The hopper has a fixed simulated time, so that the discharged mass can be compared.
    """
    if case.kind == "hopper":
        return Steps(80, 120) if slow else Steps(max(int(1500 * scale), 1), max(int(1500 * scale), 1))
    work = 1.5e7 * scale * (0.1 if slow else 1.0)
    window = min(max(int(work / case.count), 20), 10_000)
    return Steps(max(window // 2, 10), window)


def read_data(path: Path, kind: str = "bed") -> Case:
    """Reads a LAMMPS data file (columns id type diameter density x y z), gzipped or not, and its box."""
    opened = gzip.open(path, "rt") if path.suffix == ".gz" else path.open()
    with opened as lines:
        rows = [line.split() for line in lines]
    spheres = np.array([[row[2], *row[4:7]] for row in rows if len(row) == 7], float)
    spans = {
        row[2]: float(row[1]) - float(row[0]) for row in rows if len(row) == 4 and row[2] in ("xlo", "ylo")
    }
    name = "hopper" if kind == "hopper" else f"bed {len(spheres)}"
    return Case(name, kind, spheres[:, 0], spheres[:, 1:], (spans["xlo"], spans["ylo"]))


def tiled(bed: Case, count: int) -> Case:
    """A bed of about `count` particles from mirror images of a smaller one in x and y.

    The mirror plane is a wall of the smaller bed: the packing remains in equilibrium, and an overlap d with
    the wall becomes an overlap 2 d with the mirror image.
    """
    tiles = round(count / bed.count)
    across = next(n for n in range(int(sqrt(tiles)), 0, -1) if tiles % n == 0)
    position = bed.position
    for axis, number in ((0, tiles // across), (1, across)):
        position = np.concatenate([_image(position, axis, bed.sides[axis], k) for k in range(number)])
    sides = (bed.sides[0] * (tiles // across), bed.sides[1] * across)
    return Case(f"bed {tiles * bed.count}", "bed", np.tile(bed.diameter, tiles), position, sides)


def _image(position: np.ndarray, axis: int, side: float, number: int) -> np.ndarray:
    """Coordinate in tile `number`: shifted if the number is even, also mirrored if it is odd."""
    image = position.copy()
    own = side - position[:, axis] if number % 2 else position[:, axis]
    image[:, axis] = number * side + own
    return image


def find_beds(folder: Path) -> dict[int, Path]:
    """Data files of beds in a folder, by the number of particles in their third line."""
    found: dict[int, Path] = {}
    for path in sorted([*folder.glob("bed*.data"), *folder.glob("bed*.data.gz")]):
        with gzip.open(path, "rt") if path.suffix == ".gz" else path.open() as lines:
            words = [line.split() for _, line in zip(range(5), lines, strict=False)]
        counts = [int(row[0]) for row in words if len(row) == 2 and row[1] == "atoms"]
        found |= {count: path for count in counts}
    return found


def write_data(case: Case, path: Path) -> None:
    """Writes a LAMMPS data file; the box of a hopper is open, that of a bed extends above the bed."""
    top = max(float(case.position[:, 2].max()), TUBE_TOP if case.kind == "hopper" else 0.0) + 0.01
    (low, high) = (
        (-HOPPER_REACH, (HOPPER_REACH, HOPPER_REACH)) if case.kind == "hopper" else (0.0, case.sides)
    )
    bottom = HOPPER_FLOOR if case.kind == "hopper" else -0.001
    head = f"""{case.name}

{case.count} atoms
1 atom types

{low} {high[0]} xlo xhi
{low} {high[1]} ylo yhi
{bottom} {top} zlo zhi

Atoms

"""
    ids = np.arange(1, case.count + 1)
    columns = np.column_stack(
        [ids, np.ones_like(ids), case.diameter, np.full(case.count, DENSITY), case.position]
    )
    with path.open("w") as file:
        file.write(head)
        np.savetxt(file, columns, fmt="%d %d %.12g %g %.12g %.12g %.12g")


def write_hopper_mesh(path: Path, segments: int = 64) -> None:
    """Writes cone and tube as ASCII STL with vertices on the circles, for codes with triangulated walls."""
    cone = [(CONE_HEIGHT * k / 6, ORIFICE_RADIUS + (TUBE_RADIUS - ORIFICE_RADIUS) * k / 6) for k in range(7)]
    tube = [(CONE_HEIGHT + (TUBE_TOP - CONE_HEIGHT) * k / 10, TUBE_RADIUS) for k in range(1, 11)]
    angle = 2.0 * pi * np.arange(segments + 1) / segments
    rings = [
        np.column_stack([r * np.cos(angle), r * np.sin(angle), np.full_like(angle, z)])
        for z, r in cone + tube
    ]
    with path.open("w") as file:
        file.write("solid hopper\n")
        for low, high in zip(rings[:-1], rings[1:], strict=True):
            for i in range(segments):
                for corners in ((low[i], low[i + 1], high[i + 1]), (low[i], high[i + 1], high[i])):
                    file.write(_facet(np.array(corners)))
        file.write("endsolid hopper\n")


def _facet(corners: np.ndarray) -> str:
    normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    normal /= np.linalg.norm(normal)
    lines = "".join("vertex {:.9g} {:.9g} {:.9g}\n".format(*corner) for corner in corners)
    return "facet normal {:.9g} {:.9g} {:.9g}\nouter loop\n".format(*normal) + lines + "endloop\nendfacet\n"


def hertz_stiffnesses() -> tuple[float, float]:
    """4/3 E* and 8 G* [Pa] of two particles of the material."""
    modulus_eff = YOUNG_MODULUS / (2.0 * (1.0 - POISSON_RATIO**2))
    shear_modulus_eff = YOUNG_MODULUS / (4.0 * (1.0 + POISSON_RATIO) * (2.0 - POISSON_RATIO))
    return 4.0 / 3.0 * modulus_eff, 8.0 * shear_modulus_eff


def lammps_damping() -> float:
    """Normal damping gamma_n [1/(m s)] of LAMMPS' gran/hertz/history for the given restitution, at the mean
    overlap.

    sqrt(R d) M gamma_n = 2 sqrt(5/6) b sqrt(2 E* sqrt(R d) M),    b = |ln e| / sqrt(ln^2 e + pi^2)
    """
    radius_eff = 0.5 * RADIUS_MEAN
    mass_eff = 0.5 * DENSITY * 4.0 / 3.0 * pi * RADIUS_MEAN**3
    share = -log(RESTITUTION) / sqrt(log(RESTITUTION) ** 2 + pi**2)
    contact_radius = sqrt(radius_eff * OVERLAP_MEAN)
    tangent = 1.5 * hertz_stiffnesses()[0] * contact_radius
    return 2.0 * sqrt(5.0 / 6.0) * share * sqrt(tangent * mass_eff) / (contact_radius * mass_eff)
