"""Wall shapes (device function and reference implementation), wall motion, and the periodic box."""
