"""A large particle rises through vibrated small particles with the convection that the rough side wall
drives.

Rosato, Strandburg, Prinz & Swendsen, Phys. Rev. Lett. 58 (1987) 1038: the large particle rises to the top.
Knight, Jaeger & Nagel, Phys. Rev. Lett. 70 (1993) 3728: the small particles rise at the center and sink in a
thin layer at the side wall, and the large particle rises as fast as the particles around it.
"""

import numpy as np
import pytest
from scene_runner import run_shipped_scene

PERIOD = 1 / 12  # [s]
SIDE_LAYER = 6.5e-3  # thickness of the sinking layer at the side wall [m]
CUP_RADIUS = 26e-3  # [m]


@pytest.mark.slow
@pytest.mark.timeout(1500)
def test_brazil_nut_rises_with_the_surrounding_particles(tmp_path, taichi_f64):
    frames, unsatisfied = run_shipped_scene("brazil_nut", tmp_path, PERIOD)
    assert unsatisfied == []
    # The flight of the bed takes more than one period, so it lies on the floor at the end of every second
    # period.
    frames = [frame for frame in frames if frame.time > 0.4][::2]
    nut = np.array([frame.particles["position"][0, 2] for frame in frames])
    above = [
        np.mean(frame.particles["position"][1:, 2] > height)
        for frame, height in zip(frames, nut, strict=True)
    ]
    assert above[0] > 0.6 and above[-1] < 0.1
    core, side = convection(frames[:10])
    assert core > 0 > side
    assert 0.5 < (nut[9] - nut[0]) / 9 / core < 2


def convection(frames):
    """Mean vertical displacement [m] between frames at the center and at the side wall, at half height."""
    displacements = []
    distances = []
    for before, after in zip(frames, frames[1:], strict=False):
        x, y = before.particles["position"][1:], after.particles["position"][1:]
        counted = (x[:, 2] > 8e-3) & (x[:, 2] < 32e-3)
        displacements.append((y - x)[counted, 2])
        distances.append(np.hypot(x[counted, 0], x[counted, 1]))
    rise = np.concatenate(displacements)
    radius = np.concatenate(distances)
    return rise[radius < CUP_RADIUS / 2].mean(), rise[radius > CUP_RADIUS - SIDE_LAYER].mean()
