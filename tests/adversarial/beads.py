"""The scene of most cases, and functions that write variations of it."""

from scene_builders import plane

BEADS = """\
title: Ten beads fall
gravity: [0, 0, -9.81]
materials: {glass: {young_modulus: 10 MPa, poisson_ratio: 0.23, density: 2500}}
pairs: {glass-glass: {restitution: 0.8, friction: 0.4}}
contact: {normal: zhou, tangential: mindlin, rolling: none}
walls:
  floor: {shape: plane, point: [0, 0, 0], normal: [0, 0, 1], material: glass}
particles:
  beads:
    material: glass
    count: 10
    diameter: 4 mm
    insert: {kind: lattice, region: {box: {min: [0, 0, 0], max: [2 cm, 2 cm, 1 cm]}}}
domain: {min: [-1 cm, -1 cm, -1 cm], max: [3 cm, 3 cm, 3 cm], on_exit: error}
run: {duration: 50 ms}
output: {interval: 10 ms}
"""


def changed(text: str, *pairs: tuple[str, str]) -> str:
    """Text with replaced passages; each passage must occur."""
    for old, new in pairs:
        assert old in text, old
        text = text.replace(old, new, 1)
    return text


def beads(*pairs: tuple[str, str]):
    """A `prepare` that writes beads.yaml with passages replaced."""
    return lambda sandbox: sandbox.write("beads.yaml", changed(BEADS, *pairs))


def scene(text: str, **files: str | bytes):
    """A `prepare` that writes beads.yaml with this text, and other files by name (`__` replaces a dot)."""

    def prepare(sandbox):
        sandbox.write("beads.yaml", text)
        for name, content in files.items():
            sandbox.write(name.replace("__", "."), content)

    return prepare


def built(build, **files: str | bytes):
    """A `prepare` that writes a scene built by `scene_builders.build_scene`; `build` is the function that
    builds it."""
    return lambda sandbox: scene(build().to_yaml(), **files)(sandbox)


def solid(point, normal):
    """A plane of the material glass."""
    return plane(point, normal)
