"""Output directories: checkpoints and their validation, resume, previous runs, results, stages and
timings."""
