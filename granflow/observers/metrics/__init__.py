"""Metrics of a bed: mixing, angle of repose, fabric, coordination (formulas: docs/coarse_graining.md)."""
