"""A layer shaken at three times gravity is wavy, every other cycle alike; at twice gravity it stays flat.

Melo, Umbanhowar & Swinney, Phys. Rev. Lett. 72 (1994) 172 and Physica A 249 (1998) 1: waves of half the frequency from
2.5 times gravity on. Bizon, Shattuck, Swift, McCormick & Swinney, Phys. Rev. Lett. 80 (1998) 57: their length.
"""

import numpy as np
import pytest
from scene_runner import run_shipped_scene

CYCLE = 1 / 8  # [s]
WIDTH = 0.44  # of the box [m]
BINS = 44
LAST = 6  # cycles that are looked at


def test_small_form(tmp_path, taichi_f64):
    small = (
        "materials.glass.young_modulus=5 MPa",
        "particles.beads.count=330",
        "particles.beads.insert.region.box={min: [-44 mm, -5 mm, 0], max: [44 mm, 5 mm, 45 mm]}",
        "domain.min=[-44 mm, -5 mm, -30 mm]",
        "domain.max=[44 mm, 5 mm, 200 mm]",
        "stages.1.duration=0.3 s",
        "expect=[{quantity: particle_count, equals: 330, tolerance: 0}, "
        "{quantity: energy_error, between: [-2e-3, 2e-3]}]",
    )
    assert run_shipped_scene("surface_waves", tmp_path, overrides=small)[1] == []


@pytest.mark.slow
@pytest.mark.timeout(1500)
def test_waves_at_three_times_gravity(tmp_path, taichi_f64):
    frames, unmet = run_shipped_scene("surface_waves", tmp_path, CYCLE)
    assert unmet == []
    waves = alternating(frames)
    count = int(waves.argmax())  # of waves in the box
    assert waves[count] > 0.2
    depth = layer_depth(frames[0])
    length = depth * (1.0 + 1.1 * (np.sqrt(depth / 9.81) / CYCLE) ** -1.32)
    # A whole number of waves fits into the box: one more or less is 20 %.
    assert abs(WIDTH / count - length) < 0.25 * length


@pytest.mark.slow
@pytest.mark.timeout(1500)
def test_no_waves_at_twice_gravity(tmp_path, taichi_f64):
    frames, _ = run_shipped_scene(
        "surface_waves", tmp_path, CYCLE, ["walls.floor.motion.gamma=2", "stages.1.duration=1.25 s"]
    )
    assert alternating(frames).max() < 0.05


def alternating(frames):
    """Amplitude over the mean of what alternates from cycle to cycle in the mass at a place; by waves in the box."""
    profiles = []
    for frame in frames[-1 - LAST : -1]:
        x = frame.particles["position"][:, 0]
        mass, _ = np.histogram((x / WIDTH + 0.5) % 1.0, BINS, (0.0, 1.0), weights=frame.particles["mass"])
        profiles.append(mass / mass.mean())
    signs = (-1.0) ** np.arange(LAST)
    return 2 * np.abs(np.fft.rfft(signs @ profiles / LAST))[: BINS // 3] / BINS


def layer_depth(frame):
    """Depth [m] of the layer at rest, a solid fraction of 0.58."""
    volume = np.sum(4 / 3 * np.pi * frame.particles["radius"] ** 3)
    return volume / 0.58 / (WIDTH * 16e-3)
