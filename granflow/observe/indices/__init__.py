"""Numbers that sum up a bed: mixing, angle of repose, fabric, coordination. Formulas and sources: docs/fields.md."""

from granflow.observe.indices.meter import IndexMeter
from granflow.observe.indices.mixing import lacey_index
from granflow.observe.indices.repose import Slope, slope_of_cone, slope_of_plane
from granflow.observe.indices.structure import anisotropy, coordination, fabric_tensor

__all__ = [
    "IndexMeter",
    "Slope",
    "anisotropy",
    "coordination",
    "fabric_tensor",
    "lacey_index",
    "slope_of_cone",
    "slope_of_plane",
]
