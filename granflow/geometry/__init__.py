"""Wall shapes (device function and reference implementation), their shared edges, wall motion, and the
periodic box."""
