"""States of particles that all codes start from, and quantities of the states that they write."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from granflow.geometry.sphere import sphere_mass

SMALLEST, LARGEST, DENSITY = 3.6e-3, 4.4e-3, 2500.0
"""Diameters [m] and density [kg/m3] of the particles of all cases."""
SPACING = 4.45e-3
"""Spacing [m] of the initial lattices."""
SPEED, GRAVITY = 0.3, 9.81
"""Largest initial velocity component [m/s], and gravitational acceleration [m/s2]."""
PERTURBATION = 1e-6
"""Relative change of the initial velocities by `perturbed`."""


@dataclass(frozen=True)
class Particles:
    """Positions and velocities (n, 3) [m, m/s], and diameters (n,) [m]."""

    position: np.ndarray
    velocity: np.ndarray
    diameter: np.ndarray

    @property
    def mass(self) -> np.ndarray:
        """Masses (n,) [kg]."""
        return sphere_mass(0.5 * self.diameter, DENSITY)


Frames = Mapping[float, Particles]
"""State by time [s], rounded to 1 us."""


def random_particles(position: np.ndarray, repeat: int = 0) -> Particles:
    """Particles at these positions with random diameters and velocities, which differ between repeats."""
    random = np.random.default_rng(12345 + repeat)
    diameter = random.uniform(SMALLEST, LARGEST, len(position))
    return Particles(position, random.uniform(-SPEED, SPEED, position.shape), diameter)


def perturbed(state: Particles, repeat: int) -> Particles:
    """The state with slightly different velocities; repeat 0 is the state itself."""
    change = PERTURBATION * np.random.default_rng(repeat).standard_normal(state.velocity.shape)
    return replace(state, velocity=state.velocity * (1.0 + change)) if repeat else state


def box_lattice(count: int, low: tuple[float, float], sides: tuple[float, float]) -> np.ndarray:
    """Positions (n, 3) [m] of a cubic lattice in a box with its floor at z = 0, from below.

    low, sides:  corner of the box and its horizontal sides [m]
    """
    first, second = (int((side - 1.01 * LARGEST) / SPACING) + 1 for side in sides)
    number = np.arange(count)
    x, y, z = number % first, number // first % second, number // (first * second)
    offset = [
        0.5 * (side - (across - 1) * SPACING) for side, across in zip(sides, (first, second), strict=True)
    ]
    columns = (
        low[0] + offset[0] + SPACING * x,
        low[1] + offset[1] + SPACING * y,
        0.6 * LARGEST + SPACING * z,
    )
    return np.stack(columns, axis=1)


def center(state: Particles) -> np.ndarray:
    """Center of mass (3,) [m]."""
    return np.asarray(state.mass @ state.position / state.mass.sum())


def mass_above(state: Particles, height: float) -> float:
    """Mass [kg] of the particles with centers above a height [m]."""
    return float(state.mass[state.position[:, 2] > height].sum())


def discharge_figures(opening: float, begin: float, end: float) -> Callable[[Frames], dict[str, float]]:
    """Function of the frames of a silo with its floor at z = 0: mass flow rate, and height of the filled bed.

    `opening`: time [s] of the opening; `begin`, `end`: times [s] between which the flow is measured.
    """

    def figures(frames: Frames) -> dict[str, float]:
        first, last = (mass_above(frames[time], 0.0) for time in (begin, end))
        return {
            "mass flow rate [kg/s]": (first - last) / (end - begin),
            "height of the center of mass at the opening [m]": float(center(frames[opening])[2]),
        }

    return figures


def coordination(state: Particles) -> float:
    """Mean number of overlapping particles per particle."""
    from scipy.spatial import cKDTree

    first, second = cKDTree(state.position).query_pairs(LARGEST, output_type="ndarray").T
    distance = np.linalg.norm(state.position[first] - state.position[second], axis=1)
    touches = distance < 0.5 * (state.diameter[first] + state.diameter[second])
    return 2.0 * float(touches.sum()) / len(state.diameter)
