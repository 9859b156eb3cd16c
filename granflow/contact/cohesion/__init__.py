"""Cohesion models, one file per model."""
