"""Comparison of granflow with published numbers, closed forms and other codes: one module per subject."""
