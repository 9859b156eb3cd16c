"""tools/dosta_tables.py: scenes of Dosta et al. from synthetic tables, and from the published ones if
available."""

import importlib
from pathlib import Path

import numpy as np
import pytest

from granflow import load_scene
from granflow.particles.insertion import initial_particles

TOOLS = Path(__file__).resolve().parents[2] / "tools"
HEAD = "Radius[m] PosX[m] PosY[m] PosZ[m]\n"


@pytest.fixture
def tables():
    return importlib.import_module("dosta_tables")


def written_scenes(tables, folder, out, monkeypatch):
    monkeypatch.setattr("sys.argv", ["dosta_tables.py", str(folder), "--out", str(out)])
    tables.main()
    return {name: load_scene(out / f"{name}.yaml") for name in ("drum", "penetration")}


def test_particles_have_the_positions_of_the_tables(tables, tmp_path, monkeypatch):
    drum = "0.002 0.01 -0.02 -0.08\n 0.001 0.03 0 -0.02\n0.002 -0.01 0.02 -0.08\n"
    (tmp_path / "Drum_PartCoordinates.txt").write_text(HEAD + drum)
    ball = (
        " 5 0.01 0.01 0 0 0.06\n\n"  # last line of the published file: speed, radius and position of the ball
    )
    (tmp_path / "Penetration_25KParticles.txt").write_text(HEAD + "0.001 0 0.01 -0.08\n" + ball)
    scenes = written_scenes(tables, tmp_path, tmp_path, monkeypatch)
    particles = {name: initial_particles(scene) for name, scene in scenes.items()}
    np.testing.assert_allclose(particles["drum"].radius, [0.002, 0.002, 0.001])
    np.testing.assert_allclose(particles["drum"].position[2], [0.03, 0.0, -0.02])
    np.testing.assert_allclose(particles["penetration"].position, [[0.0, 0.01, -0.08]])
    # The published drum has twice the size of the shipped scene: radius 0.1 m, length 0.06 m.
    shell = scenes["drum"].walls["shell"]
    assert shell.radius == pytest.approx(0.1) and shell.to[1] - shell.from_[1] == pytest.approx(0.06)
