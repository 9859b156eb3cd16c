"""Everything that runs on the device; Taichi begins here."""
