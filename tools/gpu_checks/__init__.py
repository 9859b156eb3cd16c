"""Modules of tools/gpu_check.py: device, beds of any size, correctness checks, speed."""
