"""Volume and mass of spheres."""

from math import pi
from typing import TypeVar

import numpy as np

Number = TypeVar("Number", float, np.ndarray)


def sphere_volume(radius: Number) -> Number:
    """Volume 4/3 pi R^3 [m3] of spheres with radii [m]."""
    return 4.0 / 3.0 * pi * radius**3


def sphere_mass(radius: Number, density: Number | float) -> Number:
    """Mass [kg] of spheres with radii [m] and density [kg/m3]."""
    return sphere_volume(radius) * density
