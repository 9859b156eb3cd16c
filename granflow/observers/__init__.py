"""Observers read snapshots and write files; they do not modify the state of a simulation.

Frames (VTU), time series (CSV), coarse-grained fields, metrics and the progress display. All quantities are
in SI units; `granflow.fields` defines their names.
"""
