"""Stability study: stiff and extreme cases with a verdict each, and the measured stability limit of the time step."""
