"""Worker threads of a CPU: cores, barrier, affinity, tuning of their number."""
