"""Particles of a scene: sizes, regions, packings, particle files, insertion, and the counts that follow from
them."""
