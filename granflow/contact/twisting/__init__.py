"""Twisting friction models, one file per model."""
