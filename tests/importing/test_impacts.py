"""Oblique impacts of imported scripts against LIGGGHTS 3.8.0 and LAMMPS themselves.

LAMMPS 29 Sep 2021; the last row 22 Jul 2025.
"""

import numpy as np
import pytest
from importing.decks import imported, lammps, liggghts, loaded, pairwise

from tests.scene_builders import run_to_end

SPHERES = """create_atoms 1 single 0.05 0.02 0.0051
create_atoms 1 single 0.05 0.06 0.15
create_atoms 1 single 0.0598 0.06 0.1532
set group all diameter 0.01
set group all density 2500
group a id 1
group b id 2
group c id 3
velocity a set 0.2 0 -1.0
velocity b set 0.5 0 -0.3
velocity c set -0.5 0 0.2
set atom 3 """
RUN = "unfix g\ntimestep 2e-7\nrun 10000"
FRICTION = "coefficientFriction peratomtypepair 2 0.4 0.4 0.4 0.4"


def deck(model, **numbers):
    """A script of LIGGGHTS with models of stiffness."""
    properties = f"fix m4 all property/global {FRICTION}\n{pairwise(**numbers)}"
    model = f"model {model}/stiffness tangential history"
    return liggghts(properties=properties, model=model, insertion=f"{SPHERES}omegay 30", end=RUN)


def in_cgs(text):
    """The script of the Hertz model in cm and g."""
    lines = []
    for line in text.splitlines():
        words = line.split()
        if words[:1] in (["create_atoms"], ["velocity"]) or words[:4] == ["set", "group", "all", "diameter"]:
            line = " ".join(
                [
                    *words[:3],
                    *(each if each == "diameter" else f"{100 * float(each):g}" for each in words[3:]),
                ]
            )
        lines.append(
            line.replace("0 0.1 0 0.1 0 0.2", "0 10 0 10 0 20").replace("density 2500", "density 2.5")
        )
    return "\n".join(lines).replace("units si", "units cgs")


VISCOUS = "granular hooke 1e6 1e6 tangential linear_history 2.857e5 0.5 0.4"
SLIDING = "hooke 1000000 NULL 1000 NULL 0.4 1"
IMPACTS = [
    (deck("hertz", kn=8e7, kt=2.4e7, gamman=4e5, gammat=2e5),
     [[0.0880016, 0.947725, 55.3107], [-0.297985, -0.308031, -135.874], [0.297985, 0.208031, -105.874]]),
    (deck("hooke", kn=1e6, kt=2.857e5, gamman=1000, gammat=500),
     [[0.0907025, 0.944817, 54.4979], [-0.299379, -0.307477, -133.071], [0.299379, 0.207477, -103.071]]),
    (lammps(f"pair_style gran/{SLIDING}\npair_coeff * *", atoms=f"{SPHERES}omega 0 30 0", end=f"fix w all wall/gran {SLIDING} zplane 0 NULL\n{RUN}"),
     [[0.189721, 0.944817, 5.13974], [-0.213463, -0.541334, -8.89254], [0.213463, 0.441334, 21.1075]]),
    (in_cgs(deck("hertz", kn=8e8, kt=2.4e8, gamman=4e3, gammat=2e3)),
     [[0.0879652, 0.947725, 55.3287], [-0.297985, -0.308031, -135.874], [0.297985, 0.208031, -105.874]]),
    (lammps(f"pair_style granular\npair_coeff * * {VISCOUS.removeprefix('granular')}", atoms=f"{SPHERES}omega 0 30 0",
            end=f"fix w all wall/gran {VISCOUS} zplane 0 NULL\n{RUN}"),
     [[0.0871648, 0.985415, 56.4176], [-0.314025, -0.305302, -136.61], [0.314025, 0.205302, -106.61]]),
]  # fmt: skip
"""Scripts; vx, vz [m/s] and omegay [rad/s] of the code after the impacts: of a sphere on the wall, and of two spheres."""


@pytest.mark.parametrize(
    ("script", "expected"), IMPACTS, ids=["hertz", "hooke", "no history", "cgs", "viscoelastic"]
)
def test_impacts(tmp_path, script, expected):
    """The lever arms differ by a part of the overlap, here 0.3 %; LIGGGHTS continues the friction while the dashpot pulls."""
    found, _ = imported(tmp_path, script)
    last, _ = run_to_end(loaded(tmp_path, found))
    particles = last.particles
    spin = 0.005 * particles["angular_velocity"][:, 1]
    motion = np.stack([particles["velocity"][:, 0], particles["velocity"][:, 2], spin], axis=1)
    assert motion == pytest.approx(np.array(expected) * [1.0, 1.0, 0.005], rel=0, abs=2e-3)
