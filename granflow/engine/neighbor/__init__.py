"""Neighbor list, cell grid, contact history and deletion of particles."""
