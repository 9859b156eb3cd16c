"""Shapes of particles: one record per shape, in one file each."""
