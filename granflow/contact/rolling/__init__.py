"""Rolling friction models, one file per model."""
