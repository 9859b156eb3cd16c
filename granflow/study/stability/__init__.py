"""Stiff and extreme cases, each run to an end and given a verdict, and the real bound of the time step."""
