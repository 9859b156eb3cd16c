"""A layer vibrated at three times gravity has surface waves of twice the vibration period; at twice gravity
it is flat.

Melo, Umbanhowar & Swinney, Phys. Rev. Lett. 72 (1994) 172 and Physica A 249 (1998) 1: waves of half the
frequency above 2.5 times gravity. Bizon, Shattuck, Swift, McCormick & Swinney, Phys. Rev. Lett. 80 (1998) 57:
wavelength.
"""

import numpy as np
import pytest
from scene_runner import run_shipped_scene

PERIOD = 1 / 8  # [s]
WIDTH = 0.44  # of the box [m]
BIN_COUNT = 44
PERIOD_COUNT = 6  # number of evaluated periods at the end


@pytest.mark.slow
@pytest.mark.timeout(1500)
def test_waves_at_three_times_gravity_have_the_expected_length(tmp_path, taichi_f64):
    frames, unsatisfied = run_shipped_scene("surface_waves", tmp_path, PERIOD)
    assert unsatisfied == []
    waves = alternating(frames)
    count = int(waves.argmax())  # number of waves in the box
    assert waves[count] > 0.2
    depth = layer_depth(frames[0])
    length = depth * (1.0 + 1.1 * (np.sqrt(depth / 9.81) / PERIOD) ** -1.32)
    # The number of waves in the box is an integer; a change by one is 20 %.
    assert abs(WIDTH / count - length) < 0.25 * length


@pytest.mark.slow
@pytest.mark.timeout(1500)
def test_no_waves_at_twice_gravity(tmp_path, taichi_f64):
    frames, _ = run_shipped_scene(
        "surface_waves", tmp_path, PERIOD, ["walls.floor.motion.gamma=2", "stages.1.duration=1.25 s"]
    )
    assert alternating(frames).max() < 0.05


def alternating(frames):
    """Relative amplitude of the mass distribution that alternates between periods, by number of waves in the
    box."""
    profiles = []
    for frame in frames[-1 - PERIOD_COUNT : -1]:
        x = frame.particles["position"][:, 0]
        mass, _ = np.histogram(
            (x / WIDTH + 0.5) % 1.0, BIN_COUNT, (0.0, 1.0), weights=frame.particles["mass"]
        )
        profiles.append(mass / mass.mean())
    signs = (-1.0) ** np.arange(PERIOD_COUNT)
    return 2 * np.abs(np.fft.rfft(signs @ profiles / PERIOD_COUNT))[: BIN_COUNT // 3] / BIN_COUNT


def layer_depth(frame):
    """Depth [m] of the layer at rest, for a solid fraction of 0.58."""
    volume = np.sum(4 / 3 * np.pi * frame.particles["radius"] ** 3)
    return volume / 0.58 / (WIDTH * 16e-3)
