"""Tangential contact models, one file per model."""
