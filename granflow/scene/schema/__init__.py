"""Schema of scene files, one module per block."""
