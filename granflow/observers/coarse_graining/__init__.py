"""Coarse graining: continuous fields on a grid from particles and contacts.

Formulas: docs/pages/guides/coarse_graining.md.
"""
