"""The two scenes of most tests of the Python interface; all variations of each have one compiled structure.

Friction is left out, because a scene with it takes twice as long to compile.
"""

from scene_builders import build_scene, particle_group, plane


def beads(positions=((0.0, 0.0, 0.0052), (0.02, 0.0, 0.006)), velocity=(0.0, 0.0, 0.0), groups=None, **parts):
    """Particles of 10 mm above a floor, far from a side wall, in gravity, for 4 ms.

    groups:  in place of those particles
    """
    groups = groups or {"beads": particle_group(positions, velocity=velocity)}
    walls = {"floor": plane([0.0] * 3, [0.0, 0.0, 1.0]), "side": plane([0.5, 0.0, 0.0], [-1.0, 0.0, 0.0])}
    usual = {
        "normal": "hertz", "gravity": [0.0, 0.0, -9.81], "run": {"duration": 0.004, "velocity_max": 1.0},
        "output": {"interval": 1e-3, "timeseries_interval": 5e-4, "energy_budget": True},
    }  # fmt: skip
    return build_scene(groups, **({"walls": walls} | usual | parts))


def flying(positions=((0.0, 0.0, 0.0), (0.0, 0.1, 0.0)), velocity=(1.0, 0.0, 0.0), **parts):
    """Particles that fly freely without gravity and walls."""
    usual = {
        "normal": "hertz", "run": {"duration": 0.01, "velocity_max": 1.0},
        "output": {"interval": 1e-3, "energy_budget": True},
    }  # fmt: skip
    return build_scene({"beads": particle_group(positions, velocity=velocity)}, **(usual | parts))
