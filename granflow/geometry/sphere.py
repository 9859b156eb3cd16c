"""Volume, mass and moment of inertia of spheres."""

from math import pi
from typing import Any, TypeVar

import numpy as np

from granflow.device_functions import at_compile_time

Number = TypeVar("Number", float, np.ndarray)


def sphere_volume(radius: Number) -> Number:
    """Volume 4/3 pi R^3 [m3] of spheres with radii [m]."""
    return 4.0 / 3.0 * pi * radius**3


def sphere_mass(radius: Number, density: Number | float) -> Number:
    """Mass [kg] of spheres with radii [m] and density [kg/m3]."""
    return sphere_volume(radius) * density


@at_compile_time
def sphere_inertia(mass: Any, radius: Any) -> Any:
    """Moment of inertia 2/5 m R^2 [kg m2] of a solid sphere, also in device functions.

    mass:    [kg], number, array or expression
    radius:  [m], of the same kind
    """
    return 0.4 * mass * radius * radius
