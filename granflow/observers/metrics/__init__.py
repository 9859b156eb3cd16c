"""Metrics of a bed: mixing, angle of repose, fabric, coordination.

Formulas and sources: docs/coarse_graining.md.
"""

from granflow.observers.metrics.meter import MetricMeter
from granflow.observers.metrics.mixing import lacey_index
from granflow.observers.metrics.repose import Slope, slope_of_cone, slope_of_plane
from granflow.observers.metrics.structure import anisotropy, coordination, fabric_tensor

__all__ = [
    "MetricMeter",
    "Slope",
    "anisotropy",
    "coordination",
    "fabric_tensor",
    "lacey_index",
    "slope_of_cone",
    "slope_of_plane",
]
