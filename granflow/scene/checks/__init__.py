"""Consistency checks between the parts of a scene; `granflow.scene.validation` lists and runs them."""
