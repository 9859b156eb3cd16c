"""Coarse graining: continuous fields on a grid from particles and contacts. Formulas and sources: docs/fields.md."""

from granflow.observe.coarse.frames import FieldFrames
from granflow.observe.coarse.grid import Grid, grid_in
from granflow.observe.coarse.kernel import Kernel
from granflow.observe.coarse.sums import Sums, fields_of, sums_of

__all__ = ["FieldFrames", "Grid", "Kernel", "Sums", "fields_of", "grid_in", "sums_of"]
