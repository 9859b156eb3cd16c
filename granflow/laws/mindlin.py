"""Tangential slot: Mindlin's no-slip spring with history, capped by Coulomb friction.

The spring remembers its elastic displacement. While the contact grows the force is kept and the displacement
shrinks with the stiffer contact; while it shrinks the displacement is kept and the force falls with the contact
radius (Thornton, Cummins & Cleary 2013): so the spring never makes energy.
"""

import numpy as np
import taichi as ti


@ti.func
def mindlin_stiffness(constants, radius_eff, overlap, history):
    """No-slip stiffness of a Hertz contact, 8 G sqrt(R d) [N/m] (Mindlin 1949); constants[1] is G."""
    return 8.0 * constants[1] * ti.sqrt(radius_eff * overlap)


@ti.func
def carried_displacement(displacement, normal_middle, twist_step):
    """Tangential displacement turned with the contact plane over one step.

        s' = s - (s . n) (n + n_before) / 2 + (twist of the pair about n) x s

    The middle of the old and the new normal keeps the length of s to fourth order in the angle turned.
    """
    turned = displacement - displacement.dot(normal_middle) * normal_middle
    return turned + twist_step * normal_middle.cross(turned)


@ti.func
def coulomb(stiffness, friction, normal_force, displacement):
    """Spring force -k s, held at friction times the normal force; returns (force, displacement, slipped)."""
    force = -stiffness * displacement
    kept = displacement
    slipped = 0
    cap = friction * normal_force
    square = force.dot(force)
    if square > cap * cap:
        share = cap / ti.sqrt(square)
        force = share * force
        kept = share * displacement
        slipped = 1
    return force, kept, slipped


def reference_coulomb(
    stiffness: float, friction: float, normal_force: float, displacement: np.ndarray
) -> tuple[np.ndarray, np.ndarray, bool]:
    """Numpy twin of `coulomb`."""
    force = -stiffness * displacement
    size, cap = float(np.sqrt(force @ force)), friction * normal_force
    if size <= cap:
        return force, displacement, False
    return force * (cap / size), displacement * (cap / size), True
