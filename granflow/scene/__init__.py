"""Scene files: reading, validation, messages, and the immutable `SceneInput`."""
