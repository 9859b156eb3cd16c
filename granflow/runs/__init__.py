"""Output directories: checkpoints and their checks, resume, previous runs, results, stages, timings."""
