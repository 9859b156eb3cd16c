"""Stability study: stiff and extreme cases with an assessment each, and the measured stability limit.

The limit is that of the time step, for particles with 2 to 12 contacts on lattices.
"""
