"""What a case of the comparison consists of, and the law and scene that all cases share."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from granflow import Scene, Simulation
from granflow.contact.theory import damping_ratio_for
from validation.peers.state import DENSITY, GRAVITY, Frames, Particles

YOUNG_MODULUS, POISSON_RATIO, RESTITUTION, FRICTION = 5e6, 0.25, 0.8, 0.5
"""Material of the cases with equal laws: modulus [Pa], restitution and friction."""
LAW = {
    "normal": "hertz",
    "tangential": {"law": "mindlin", "increments": "displacement", "unloading": "kept", "damping": 0.9258},
}
"""Law of LIGGGHTS and of `mindlin` in LAMMPS: damping over that of the normal force sqrt(4 G*/E*)."""
TSUJI = (1.2728, -4.2783, 11.087, -22.348, 27.467, -18.022, 4.8218)
"""Coefficients of LAMMPS' polynomial alpha(e), by power of e."""


@dataclass(frozen=True)
class PeerCase:
    """One case that granflow, LIGGGHTS and LAMMPS simulate from the same initial states.

    name:           name of the case
    initial_state:  makes the state from which all codes start, by number of the repeat
    scene:          granflow's scene for a state
    box:            region of LIGGGHTS and LAMMPS [m], low and high corner
    time_step:      time step [s]
    times:          times [s] of the compared states
    figures:        numbers of a run in SI units by name, from its states; lists if the run has several
                    intervals
    deck:           name of the inputs, if another case has them, too
    variables:      variables of the inputs and their values, besides the restitution
    meshes:         triangles (n, 3, 3) [m] of walls by file name, for LIGGGHTS
    equal_law:      False if the codes end a contact differently; their difference may then be `MODEL_ERROR`
    restitution:    what LIGGGHTS and LAMMPS are given, by name of the code
    repeats:        number of runs
    remark:         what else differs between the codes, or empty
    """

    name: str
    initial_state: Callable[[int], Particles]
    scene: Callable[[Particles], Scene]
    box: tuple[tuple[float, float, float], tuple[float, float, float]]
    time_step: float
    times: Sequence[float] | np.ndarray
    figures: Callable[[Frames], Mapping[str, Any]]
    deck: str = ""
    variables: Mapping[str, float] = field(default_factory=dict)
    meshes: Callable[[], Mapping[str, np.ndarray]] = dict
    equal_law: bool = True
    restitution: Mapping[str, float] = field(default_factory=lambda: entered_restitutions(RESTITUTION))
    repeats: int = 4
    remark: str = ""

    def samples(self, frames: Frames) -> dict[str, list[float]]:
        """Figures of a run, each as a list with one number per interval."""
        return {name: np.atleast_1d(found).tolist() for name, found in self.figures(frames).items()}


def entered_restitutions(restitution: float) -> dict[str, float]:
    """What LIGGGHTS (`limitForce on`) and LAMMPS (`tsuji`, `limit_damping`) must be given for a restitution.

    Both have the viscous force of granflow, sqrt(5) zeta sqrt(M k) d^(1/4) v, and no tension, but compute
    zeta for a contact that ends at zero overlap (LIGGGHTS) or from a polynomial, alpha = sqrt(5) zeta
    (LAMMPS).

        LIGGGHTS: zeta = -ln e / sqrt(pi^2 + ln^2 e)        LAMMPS: alpha(e) = 1.2728 - 4.2783 e + ...
    """
    from scipy.optimize import brentq

    zeta = damping_ratio_for(restitution)
    alpha = np.polynomial.Polynomial(TSUJI)
    entered = brentq(lambda e: alpha(e) - math.sqrt(5.0) * zeta, 0.0, 1.0)
    return {"LIGGGHTS": math.exp(-math.pi * zeta / math.sqrt(1.0 - zeta**2)), "LAMMPS": float(entered)}


def scene_of(
    case: str, start: Particles, walls: Mapping[str, Any], domain: Mapping[str, Any], **more: Any
) -> Scene:
    """Scene of a case with the material `m` of all cases with equal laws.

    more:  further blocks of the scene, which replace the default ones
    """
    group = {
        "material": "m",
        "diameter": start.diameter.tolist(),
        "velocity": start.velocity.tolist(),
        "insert": {"kind": "positions", "positions": start.position.tolist()},
    }
    blocks = {
        "title": case,
        "gravity": [0, 0, -GRAVITY],
        "materials": {
            "m": {"young_modulus": YOUNG_MODULUS, "poisson_ratio": POISSON_RATIO, "density": DENSITY}
        },
        "pairs": {"m-m": {"restitution": RESTITUTION, "friction": FRICTION}},
        "contact": LAW | {"rolling": "none"},
        "walls": {name: {"material": "m"} | wall for name, wall in walls.items()},
        "particles": {"beads": group},
        "domain": {"on_exit": "delete"} | dict(domain),
        "numerics": {"max_overlap": 0.4},
        "output": {"interval": 10.0},
    }
    return Scene.from_dict(blocks | more)


def plane(point: Sequence[float], normal: Sequence[float], **more: Any) -> dict[str, Any]:
    """A plane wall; the normal points to the particles."""
    return {"shape": "plane", "point": list(point), "normal": list(normal)} | more


def our_frames(case: PeerCase, repeat: int) -> dict[float, Particles]:
    """States of a run of granflow at the times of the case."""
    simulation = Simulation(case.scene(case.initial_state(repeat)))
    frames = {}
    done = 0
    for time in case.times:
        step = round(time / case.time_step)
        simulation.step(step - done)
        done = step
        found = simulation.snapshot().particles
        frames[round(time, 6)] = Particles(found["position"], found["velocity"], 2.0 * found["radius"])
    simulation.free()
    return frames
