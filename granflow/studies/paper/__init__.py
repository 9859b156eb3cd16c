"""Reproduction of Zhou (2011): figures and tables from simulated collisions, and a comparison of all contact
models."""
