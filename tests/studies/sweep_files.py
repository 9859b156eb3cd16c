"""Small sweeps for tests: two spheres that collide, some milliseconds of simulated time."""

SCENE = """\
title: Two spheres
gravity: [0, 0, 0]
materials: {steel: {young_modulus: 1 GPa, poisson_ratio: 0.3, density: 8000}}
pairs: {steel-steel: {restitution: 0.8, friction: 0.1}}
contact: {normal: zhou, tangential: mindlin, rolling: none}
particles:
  spheres:
    material: steel
    diameter: 20 mm
    velocity: [[0.25, 0, 0], [-0.25, 0, 0]]
    insert: {kind: positions, positions: [[-10.1 mm, 0, 0], [10.1 mm, 1 mm, 0]]}
domain: {min: [-50 mm, -50 mm, -50 mm], max: [50 mm, 50 mm, 50 mm], on_exit: error}
run: {duration: 2 ms}
output: {interval: 1 ms, particles: false, walls: false, energy_budget: true}
expect:
  - {quantity: kinetic_energy, below: 1.5e-3}
"""

SWEEP = """\
scene: spheres.yaml
vary:
  pairs.steel-steel.restitution: [0.5, 0.9, 1.2]
  pairs.steel-steel.friction: [0.1, 0.4]
read: [kinetic_energy, rotational_energy]
"""
"""Six points; a restitution of 1.2 is refused."""


def write_sweep(folder, text=SWEEP, scene=SCENE):
    """Write a scene and a sweep into the folder; return the path of the sweep."""
    (folder / "spheres.yaml").write_text(scene)
    path = folder / "sweep.yaml"
    path.write_text(text)
    return path
