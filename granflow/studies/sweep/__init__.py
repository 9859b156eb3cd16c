"""Sweeps: runs of one scene for many parameter values, restartable, on this machine or on a cluster."""
