"""Sweeps: runs of one scene at many points of its parameters, restartable, on this machine or on a cluster."""
