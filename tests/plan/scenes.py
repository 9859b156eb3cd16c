"""A small scene file for plans: ten soft glass particles above a floor."""

from granflow.load import load_scene

TEXT = """\
title: Ten beads fall
gravity: [0, 0, -9.81]
materials:
  glass: {young_modulus: 10 MPa, poisson_ratio: 0.23, density: 2500}
  steel: {preset: stainless_316}
pairs:
  glass-glass: {restitution: 0.7, friction: 0, rolling_friction: 0}
  glass-steel: {restitution: 0.7, friction: 0, rolling_friction: 0}
contact:
  normal: zhou
  tangential: mindlin
  rolling: none
walls:
  floor: {shape: plane, point: [0, 0, 0], normal: [0, 0, 1], material: glass}
particles:
  beads:
    material: glass
    count: 10
    diameter: 4 mm
    insert: {kind: lattice, region: {box: {min: [0, 0, 0], max: [2 cm, 2 cm, 1 cm]}}}
domain: {min: [-1 cm, -1 cm, -1 cm], max: [3 cm, 3 cm, 3 cm], on_exit: delete}
run:
  duration: 50 ms
  velocity_max: 1 m/s
output:
  interval: 10 ms
"""


def line_of(words):
    """Number of the first line of TEXT that contains `words`."""
    return next(number for number, line in enumerate(TEXT.splitlines(), 1) if words in line)


def scene_of(directory, *overrides, text=TEXT):
    """Writes the text to beads.yaml in `directory` and loads it with overrides `key=value`."""
    path = directory / "beads.yaml"
    path.write_text(text)
    return load_scene(path, overrides)
