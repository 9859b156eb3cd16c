"""Oblique impacts of imported scripts against LIGGGHTS 3.8.0 and LAMMPS 29 Sep 2021 themselves."""

import numpy as np
import pytest
import yaml

import granflow as gf
from granflow.importing.convert import convert
from tests.scene_builders import run_to_end

DECK = """
atom_style granular
atom_modify map array
boundary f f f
newton off
communicate single vel yes
units si
region box block 0 0.2 0 0.1 -0.01 0.2 units box
create_box 1 box
neighbor 0.002 bin
fix m1 all property/global kn peratomtypepair 1 {kn}
fix m2 all property/global kt peratomtypepair 1 {kt}
fix m3 all property/global gamman peratomtypepair 1 {gamman}
fix m4 all property/global gammat peratomtypepair 1 {gammat}
fix m5 all property/global coefficientFriction peratomtypepair 1 0.4
pair_style gran model {model} tangential history
pair_coeff * *
create_atoms 1 single 0.1 0.02 0.0051 units box
create_atoms 1 single 0.1 0.06 0.15 units box
create_atoms 1 single 0.1098 0.06 0.1532 units box
set group all diameter 0.01
set group all density 2500
set atom 3 omegay 30
group a id 1
group b id 2
group c id 3
velocity a set 0.2 0 -1.0 units box
velocity b set 0.5 0 -0.3 units box
velocity c set -0.5 0 0.2 units box
fix w all wall/gran model {model} tangential history primitive type 1 zplane 0.0
fix i all nve/sphere
timestep 2e-7
run 10000
"""
LAMMPS = """
units si
atom_style sphere
boundary f f f
newton off
comm_modify vel yes
region box block 0 0.2 0 0.1 -0.01 0.2
create_box 1 box
neighbor 0.002 bin
create_atoms 1 single 0.1 0.02 0.0051
create_atoms 1 single 0.1 0.06 0.15
create_atoms 1 single 0.1098 0.06 0.1532
set group all diameter 0.01
set group all density 2500
set atom 3 omega 0 30 0
group a id 1
group b id 2
group c id 3
velocity a set 0.2 0 -1.0
velocity b set 0.5 0 -0.3
velocity c set -0.5 0 0.2
pair_style gran/hooke 1e6 NULL 1000 NULL 0.4 1
pair_coeff * *
fix w all wall/gran hooke 1e6 NULL 1000 NULL 0.4 1 zplane 0 NULL
fix i all nve/sphere
timestep 2e-7
run 10000
"""
HERTZ = {"model": "hertz/stiffness", "kn": 8e7, "kt": 2.4e7, "gamman": 4e5, "gammat": 2e5}
HOOKE = {"model": "hooke/stiffness", "kn": 1e6, "kt": 2.857e5, "gamman": 1000, "gammat": 500}
IMPACTS = [
    (DECK.format(**HERTZ), [[0.0880016, 0.947725, 55.3107], [-0.297985, -0.308031, -135.874], [0.297985, 0.208031, -105.874]]),
    (DECK.format(**HOOKE), [[0.0907025, 0.944817, 54.4979], [-0.299379, -0.307477, -133.071], [0.299379, 0.207477, -103.071]]),
    (LAMMPS, [[0.189721, 0.944817, 5.13974], [-0.213463, -0.541334, -8.89254], [0.213463, 0.441334, 21.1075]]),
]  # fmt: skip
"""Scripts; vx, vz [m/s] and omegay [rad/s] of the code after the impacts: of a sphere on the wall, and of two spheres."""


@pytest.mark.parametrize(("script", "expected"), IMPACTS, ids=["hertz", "hooke", "no history"])
def test_impacts(tmp_path, script, expected):
    """The lever arms differ by a part of the overlap, here 0.3 %; LIGGGHTS continues the friction while the dashpot pulls."""
    (tmp_path / "in.deck").write_text(script)
    found = convert(tmp_path / "in.deck")
    for name, content in found.files.items():
        (tmp_path / name).write_bytes(content)
    (tmp_path / "scene.yaml").write_text(yaml.safe_dump(yaml.safe_load(found.text)))
    last, _ = run_to_end(gf.load_scene(tmp_path / "scene.yaml"))
    particles = last.particles
    spin = 0.005 * particles["angular_velocity"][:, 1]
    motion = np.stack([particles["velocity"][:, 0], particles["velocity"][:, 2], spin], axis=1)
    assert motion == pytest.approx(np.array(expected) * [1.0, 1.0, 0.005], rel=0, abs=2e-3)
