"""The large ball rises through the shaken beads with the convection that the rough side drives.

Rosato, Strandburg, Prinz & Swendsen, Phys. Rev. Lett. 58 (1987) 1038: the large one ends on top. Knight, Jaeger &
Nagel, Phys. Rev. Lett. 70 (1993) 3728: beads go up in the middle and down in a thin layer along the side, and a large
ball rises as fast as the beads about it.
"""

import numpy as np
import pytest
from scene_runner import run_shipped_scene

CYCLE = 1 / 12  # [s]
SIDE = 6.5e-3  # beads within this of the side go down [m]
CUP = 26e-3  # radius [m]


@pytest.mark.slow
def test_small_form(tmp_path, taichi_f64):
    small = (
        "particles.nut.diameter=12 mm",
        "particles.nut.insert.region.box={min: [-6 mm, -6 mm, 0], max: [6 mm, 6 mm, 12 mm]}",
        "particles.beads.count=300",
        "particles.beads.insert.region.cylinder={from: [0, 0, 0], to: [0, 0, 50 mm], radius: 18 mm}",
        "walls.floor.radius=18 mm",
        "walls.side.radius=18 mm",
        "materials.glass.young_modulus=10 MPa",
        "materials.cup.young_modulus=10 MPa",
        "stages.0.duration=0.15 s",
        "stages.1.duration=0.25 s",
        "expect=[{quantity: particle_count, equals: 301, tolerance: 0}, "
        "{quantity: energy_error, between: [-2e-3, 2e-3]}]",
    )
    frames, unmet = run_shipped_scene("brazil_nut", tmp_path, overrides=small)
    assert unmet == []
    assert frames[-1].particles["position"][0, 2] > frames[0].particles["position"][0, 2] + 2e-3


@pytest.mark.slow
@pytest.mark.timeout(1500)
def test_the_ball_rises_with_the_beads_about_it(tmp_path, taichi_f64):
    frames, unmet = run_shipped_scene("brazil_nut", tmp_path, CYCLE)
    assert unmet == []
    # The bed is thrown for more than a cycle, so it lies on the floor at the end of every other one.
    frames = [frame for frame in frames if frame.time > 0.4][::2]
    nut = np.array([frame.particles["position"][0, 2] for frame in frames])
    above = [np.mean(frame.particles["position"][1:, 2] > height) for frame, height in zip(frames, nut, strict=True)]
    assert above[0] > 0.6 and above[-1] < 0.1
    core, side = convection(frames[:10])
    assert core > 0 > side
    assert 0.5 < (nut[9] - nut[0]) / 9 / core < 2


def convection(frames):
    """Mean rise [m] of a bead from frame to frame in the middle and along the side, half way up."""
    rise, inner = [], []
    for before, after in zip(frames, frames[1:], strict=False):
        x, y = before.particles["position"][1:], after.particles["position"][1:]
        here = (x[:, 2] > 8e-3) & (x[:, 2] < 32e-3)
        rise.append((y - x)[here, 2])
        inner.append(np.hypot(x[here, 0], x[here, 1]))
    moves, radius = np.concatenate(rise), np.concatenate(inner)
    return moves[radius < CUP / 2].mean(), moves[radius > CUP - SIDE].mean()
