"""Color scale of a picture: the array that it shows, its name and unit, and its range.

One scale applies to all frames of a run, so that colors are comparable.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from granflow.errors import GranflowError
from granflow.fields import CONTACT_QUANTITIES, PARTICLE_QUANTITIES
from granflow.scene.suggest import nearest
from granflow.studies.figures import COLORS

CATEGORIES = ("material", "group")
"""Arrays with one color per number instead of a continuous scale."""
SIGNED = "RdBu_r"
UNSIGNED = "viridis"
OF_CONTACTS = "YlOrRd"
"""Color maps of matplotlib: for values of both signs, for other values of particles, for contacts."""


@dataclass(frozen=True)
class Scale:
    """Color scale: array, title of one or two lines, `limits` [SI], displayed unit and its value in SI.

    `names` by number: materials or groups, with one color each; empty for a continuous scale.
    """

    color: str
    title: str
    unit: str
    factor: float
    limits: tuple[float, float]
    names: Mapping[int, str] | None = None
    out_of_range: tuple[bool, bool] = (False, False)

    @property
    def map_name(self) -> str:
        """Color map: blue to white to red for values of both signs, pale to red for contacts."""
        if self.color in CONTACT_QUANTITIES and self.color not in PARTICLE_QUANTITIES:
            return OF_CONTACTS
        return SIGNED if self.limits[0] < 0.0 < self.limits[1] else UNSIGNED


PERCENTILES = (1.0, 99.0)
"""Percentiles of all values in all frames that limit the range; values beyond have the color of the limit."""
FROM_ZERO = 0.5
"""A range begins at 0 if its lower limit is below this fraction of the upper one."""


def scale_for(
    color: str,
    values: Iterable[np.ndarray],
    is_vector: bool = False,
    names: Mapping[str, Sequence[str]] | None = None,
    limits: tuple[float, float] | None = None,
) -> Scale:
    """Color scale of an array from all shown values, or from given `limits` [SI].

    `values`: arrays (n,) of the frames; values that are not finite are ignored. `names`: names of the
    materials and groups of the scene, by array name.
    """
    finite = np.concatenate([np.zeros(0), *values])
    finite = finite[np.isfinite(finite)]
    name, _, axis = color.partition(".")
    if name in CATEGORIES:
        return Scale(color, name, "", 1.0, (0.0, 1.0), _categories(name, finite, names or {}))
    low, high = limits or _range(finite, signed=bool(axis))
    quantity = PARTICLE_QUANTITIES.get(name) or CONTACT_QUANTITIES.get(name)
    factor, unit = prefixed(
        "" if quantity is None or quantity.unit == "1" else quantity.unit, max(abs(low), abs(high))
    )
    title = name.replace("_", " ") + (f", {axis}" if axis else "\nmagnitude" if is_vector else "")
    out_of_range = (bool(np.any(finite < low)), bool(np.any(finite > high)))
    return Scale(color, title, unit, factor, (low, high), out_of_range=out_of_range)


def _categories(name: str, values: np.ndarray, names: Mapping[str, Sequence[str]]) -> dict[int, str]:
    """Names of the materials or groups that occur in the values, by number."""
    known = names.get(name, ())
    numbers = sorted({int(value) for value in values})
    return {number: known[number] if number < len(known) else f"{name} {number}" for number in numbers}


def _range(values: np.ndarray, signed: bool) -> tuple[float, float]:
    """Range that contains most values (PERCENTILES).

    It is symmetric for components, and begins at 0 if the lower limit is near 0. `values` (n,) [SI], all
    finite; (0, 1) without values.
    """
    if not len(values):
        return 0.0, 1.0
    low, high = (float(end) for end in np.percentile(values, PERCENTILES))
    if signed:
        high = max(abs(low), abs(high)) or 1.0
        return -high, high
    if 0.0 <= low < FROM_ZERO * high:
        low = 0.0
    if low == high:
        return min(2.0 * high, 0.0), max(2.0 * high, 0.0) if high else 1.0
    return low, high


PREFIXES = {-9: "n", -6: "\N{MICRO SIGN}", -3: "m", 0: "", 3: "k", 6: "M", 9: "G"}
"""Prefixes of units by power of ten."""


def prefixed(unit: str, largest: float) -> tuple[float, str]:
    """Value in SI of the unit with the prefix that suits the largest number, and that unit.

    Units with powers get no prefix. For example, 1e-3 and "mN" for "N" and 0.02.
    """
    if not largest > 0.0 or not unit or any(sign in unit for sign in "^0123456789"):
        return 1.0, unit
    grams = unit.startswith("kg")
    power = int(np.floor(np.log10(largest * (1000.0 if grams else 1.0)) / 3.0 + 1e-9)) * 3
    power = min(max(power, min(PREFIXES)), max(PREFIXES))
    if grams:
        return 10.0 ** (power - 3), f"{PREFIXES[power]}{unit[1:]}"
    return 10.0**power, f"{PREFIXES[power]}{unit}"


AXES = ("x", "y", "z")


def values_of(arrays: Mapping[str, np.ndarray], color: str) -> np.ndarray:
    """Values (n,) of an array, magnitude of a vector, or one component such as velocity.z.

    Raises GranflowError with the available names for an unknown one.
    """
    name, _, axis = color.partition(".")
    if name not in arrays or (axis and (axis not in AXES or arrays[name].ndim != 2)):
        near = nearest(name, list(arrays))
        hint = f" Did you mean {near}?" if near and near != name else ""
        raise GranflowError(f"--color {color}: no such array; the arrays are {', '.join(arrays)}.{hint}")
    values = np.asarray(arrays[name], dtype=np.float64)
    if values.ndim == 2:
        return values[:, AXES.index(axis)] if axis else np.linalg.norm(values, axis=1)
    return values


NO_VALUE = (0.6, 0.6, 0.6)
"""Color of nan (red, green, blue; 0 to 1)."""


def colors_of(values: np.ndarray, scale: Scale) -> np.ndarray:
    """Colors (n, 3) uint8 of values (n,) [SI]; gray for nan.

    Values outside the limits get the color of the limit.
    """
    from matplotlib import colormaps, colors

    if scale.names is not None:
        wheel = np.array([colors.to_rgb(color) for color in COLORS])
        shown = wheel[values.astype(np.int64) % len(wheel)]
    else:
        low, high = scale.limits
        shown = colormaps[scale.map_name](np.clip((values - low) / (high - low), 0.0, 1.0))[:, :3]
        shown[~np.isfinite(values)] = NO_VALUE
    return np.round(255.0 * shown).astype(np.uint8)
