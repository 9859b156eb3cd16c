"""Contact models: registry, one file per model, closed forms. Only the files of models import Taichi."""
