"""Taichi code: fields, kernels and everything that runs on the device."""
