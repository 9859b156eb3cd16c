"""Wear of walls on the device: worn volume, normal and tangential work of the contacts of each worn face.

Only scenes with `wear` of a wall compile these functions. A row per triangle of a worn mesh, and one for a
worn wall of another shape, has three sums over the run:

    V += (k / H) P dt        P: power of the law, see `scene.blocks.wear`
    W_n += |F_n v_n| dt      W_t += |F_t . v_t| dt

with the force at the end of each step and the velocities of its middle. The slip rate v_t of surfaces that
stick is 0: their relative motion is elastic, and a particle that vibrates on its contact wears nothing. The
sums are integers that all chunks share, so that no result depends on threads, chunks or ranks. Each addition
moves its own carry: what low and high word represent together is the same in any order.
"""

from typing import Any

import numpy as np

from granflow.contact.law import in_contact_plane
from granflow.engine.state import NOT_WORN, State
from granflow.engine.sums import canonical, energy_words
from granflow.engine.walls import Faces
from granflow.kernel_language import ti
from granflow.plan.sum_units import CARRY_BITS, WEAR_SIZE


class FaceWear:
    """The sums of the worn faces.

    Reads:   material of particles; wear_law, wear_row, wear_coefficient of walls
    Writes:  wear
    """

    def __init__(self, state: State) -> None:
        plan = state.plan
        self.particles = state.particles
        self.walls = state.walls
        self.wear: Any = state.control.wear
        self.one_material = plan.features.one_material
        self.wall_of = state.built(Faces).wall_of
        self.wall_count = state.parameter("wall_count")
        self.per_unit = state.parameter("per_unit.wear")
        self.powers = [(code, law.build_power()) for code, law in enumerate(plan.wear_laws)]
        self.high_word = WEAR_SIZE

    @ti.func
    def add(self, i, j, kinematics, angular_velocities, contact_force, slides, dt):
        """Add one contact of particle i with the wall of partner j in one step.

        kinematics, angular_velocities:  as of the pair force
        contact_force:                   on the particle [N]
        slides:                          1, or 0 if the surfaces stick
        """
        w = self.wall_of(j)
        law = self.walls.wear_law[w]
        if law != NOT_WORN:
            normal = ti.cast(kinematics.normal, ti.f64)
            normal_half = ti.cast(kinematics.normal_half, ti.f64)
            velocity = ti.cast(kinematics.velocity_rel_half, ti.f64)
            spin = ti.cast(kinematics.arm_half * angular_velocities.first, ti.f64)
            force = ti.cast(contact_force, ti.f64)
            slip_rate = slides * in_contact_plane(velocity - spin.cross(normal_half), normal, normal_half)
            normal_force = force.dot(normal)
            approach = -velocity.dot(normal_half)
            load = ti.Struct(
                force=force.norm(),
                normal_force=ti.max(normal_force, 0.0),
                slip_speed=slip_rate.norm(),
                approach=approach,
                passing_speed=(velocity + approach * normal_half).norm(),
            )
            power = 0.0 * approach
            for code, power_of in ti.static(self.powers):
                if law == code:
                    power = power_of(load)
            material = 0
            if ti.static(not self.one_material):
                material = self.particles.material[i]
            row = self.walls.wear_row[w]
            face = -1 - j
            if face >= self.wall_count():
                row += face - self.wall_count()
            time = ti.cast(dt, ti.f64)
            units = self.per_unit()
            tangential_power = ti.abs((force - normal_force * normal).dot(slip_rate))
            self._add(row, 0, units[0] * time * self.walls.wear_coefficient[w, material] * power)
            self._add(row, 1, units[1] * time * ti.abs(normal_force * approach))
            self._add(row, 2, units[1] * time * tangential_power)

    @ti.func
    def _add(self, row, term: ti.template(), value):
        """Add to a sum; `value`: in units of the high word."""
        low, high = energy_words(value)
        before = ti.atomic_add(self.wear[0, row][term], low)
        carry = (before + low) >> CARRY_BITS
        if carry != 0:
            ti.atomic_sub(self.wear[0, row][term], carry << CARRY_BITS)
            high += carry
        if high != 0:
            ti.atomic_add(self.wear[0, row][ti.static(self.high_word + term)], high)


def wall_wear(state: State) -> dict[str, np.ndarray]:
    """Wear since the start of each worn wall by name.

    Returns:  arrays (k, 3) float64: worn volume [m3], normal and tangential work [J] of each triangle of a
              mesh, and in one row of a wall of another shape; empty without wear
    """
    plan = state.plan
    if not plan.features.wear:
        return {}
    sums = canonical(state.ranks.total(state.control.wear.to_numpy()).sum(axis=0))
    low, high = np.split(sums, 2, axis=-1)
    units = np.array([plan.sum_units.wear_volume, plan.sum_units.energy, plan.sum_units.energy])
    values = units * (np.ldexp(high.astype(float), CARRY_BITS) + low)
    return {
        plan.walls[index].name: values[first : first + count]
        for index, (first, count) in plan.wear_rows.items()
    }


def wear_totals(state: State, wear: dict[str, np.ndarray]) -> dict[str, float]:
    """Totals of each worn wall, QUANTITY.WALL: volume [m3], largest depth [m], works [J].

    wear:  of `wall_wear`

    Laws without a volume have works only, infinite walls no depth.
    """
    found = {}
    for wall in state.plan.walls:
        if wall.name not in wear:
            continue
        rows = wear[wall.name]
        volume, normal_work, tangential_work = (float(each) for each in rows.sum(axis=0))
        if wall.spec.wear is not None and wall.spec.wear.has_volume:
            found[f"wear_volume.{wall.name}"] = volume
            areas = state.plan.wear_areas[wall.name]
            if areas is not None:
                found[f"wear_depth_largest.{wall.name}"] = float((rows[:, 0] / areas).max())
        found[f"wear_normal_work.{wall.name}"] = normal_work
        found[f"wear_tangential_work.{wall.name}"] = tangential_work
    return found
