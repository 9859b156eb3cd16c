"""Coarse graining: continuous fields on a grid from particles and contacts (formulas: docs/coarse_graining.md)."""
