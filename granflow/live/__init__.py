"""Live access from Python to particles, walls and forces of a simulation while it runs."""
