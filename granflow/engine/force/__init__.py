"""Pair and wall forces, and output of contacts."""
