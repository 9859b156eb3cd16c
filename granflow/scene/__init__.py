"""Scene files: reading, validation, messages, and the scene as written, `SceneInput`."""
