"""Coarse graining: continuous fields on a grid from particles and contacts.

Formulas and sources: docs/coarse_graining.md.
"""

from granflow.observers.coarse_graining.accumulation import AccumulatedFields, accumulate, fields_from
from granflow.observers.coarse_graining.field_frames import FieldFrames
from granflow.observers.coarse_graining.field_grid import CoarseGrid, grid_for
from granflow.observers.coarse_graining.kernel import GaussianKernel

__all__ = ["FieldFrames", "CoarseGrid", "GaussianKernel", "AccumulatedFields", "fields_from", "grid_for", "accumulate"]
