"""Metrics of a bed: mixing, angle of repose, fabric, coordination (formulas: docs/pages/guides/coarse_graining.md)."""
