"""`granflow render`: pictures and films from the frames of a run."""
