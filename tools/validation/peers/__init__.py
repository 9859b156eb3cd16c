"""Comparison with LIGGGHTS and LAMMPS from the same initial states; their inputs are in `inputs`."""
