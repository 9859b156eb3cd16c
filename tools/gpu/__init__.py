"""What stands behind tools/gpu_check.py: the device, beds of any size, checks of correctness, speed."""
