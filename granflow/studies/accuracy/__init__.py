"""Error against run time: collisions of two particles, and complete scenes."""
