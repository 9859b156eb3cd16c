"""Normal contact models, one file per model."""
