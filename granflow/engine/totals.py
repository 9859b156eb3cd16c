"""Totals of a snapshot, and the energy budget."""

import logging
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, fields
from math import inf
from typing import Any

import numpy as np

from granflow.contact.particle_equation import ParticleEquation
from granflow.engine.clumps import CLUMP_MOTION, ROTATION_SHARE, body_positions, of_clumps
from granflow.engine.codes import ABORT_LEFT_DOMAIN, REMOVED_BELOW
from granflow.engine.deformation import deformation_totals, deformation_work
from granflow.engine.flows import wall_flow_totals
from granflow.engine.gravity import present_gravity
from granflow.engine.host import copy_to_host
from granflow.engine.state import ALONE, Gathering, State, mobility_mask
from granflow.engine.statistics import LIQUID_SUMS
from granflow.engine.sums import (
    REDUCED_ROWS,
    SHARES,
    chunk_words,
    exact_sum,
    exact_total,
    exact_totals,
    scale_exponent,
    to_nearest,
)
from granflow.engine.wall_dynamics import controlled_displacements, controlled_totals, controlled_work
from granflow.geometry.sphere import sphere_inertia
from granflow.kernel_language import ti
from granflow.plan.plan import Plan
from granflow.plan.sum_units import LOSS_PLASTIC, LOSSES, terms_ahead
from granflow.scene.blocks.insertions import TimedInsertion
from granflow.scene.blocks.motions import poses_at
from granflow.scene.blocks.outlets import outlet_of
from granflow.snapshot import WallPose

# Accounting on the host: inserted and deleted particles with their energies.

EXIT_FACES = ("x_min", "y_min", "z_min", "x_max", "y_max", "z_max")
"""Names of the faces of the domain at the smallest and the largest coordinates."""


@dataclass
class Accounting:
    """Counts and energies since the start, and BY_ID of every particle.

    BY_ID are material, group and insertion time, by the id.

    inserted_count:          number of inserted particles
    deleted_count:           number of deleted particles
    deleted_mass:            [kg]
    inserted_energy:         mechanical energy [J] of inserted particles, and of contacts of walls that
                             appeared
    removed_energy:          mechanical energy [J] of deleted particles
    removed_kinetic_energy:  translational and rotational part of it [J]
    material, group:         lists of integer arrays (k,), numbers of the scene, concatenated at first use
    insertion_time:          likewise, float64 [s]
    removed:                 `id` (k,) of the particles that stages or a program have removed, and their
                             `position` (k, 3) [m] then, of clumps that of the center of mass
    """

    inserted_count: int = 0
    deleted_count: int = 0
    deleted_mass: float = 0.0
    inserted_energy: float = 0.0
    removed_energy: float = 0.0
    removed_kinetic_energy: float = 0.0
    energy_put_in: float = 0.0
    """Largest energy input [J] at all observations so far; see `energy_input`."""
    contents: dict[str, float] = field(default_factory=dict)
    """Changes of the content of particle equations since the start, by the names of their totals, see
    `ParticleEquation.content_change`."""
    outlets: dict[str, list[float]] = field(default_factory=dict)
    """Count and mass [kg] of the particles deleted by each outlet."""
    exits: dict[str, int] = field(default_factory=lambda: dict.fromkeys(EXIT_FACES, 0))
    """Number of particles that left the domain outside all outlets, by the face of the domain."""
    queued_count: int | None = None
    """Particles queued for insertion; None without insertion."""
    material: list[np.ndarray] = field(default_factory=list)
    group: list[np.ndarray] = field(default_factory=list)
    insertion_time: list[np.ndarray] = field(default_factory=list)
    removed: dict[str, np.ndarray] = field(
        default_factory=lambda: {"id": np.empty(0, np.int64), "position": np.empty((0, 3))}
    )

    def insert(self, material: np.ndarray, group: np.ndarray, time: float, energy: float) -> None:
        """Record particles inserted at `time` [s]: materials and groups (k,), mechanical energy [J]."""
        self.inserted_count += len(group)
        self.inserted_energy += energy
        self.material.append(material)
        self.group.append(group)
        self.insertion_time.append(np.full(len(group), time))

    def delete(self, arrays: Mapping[str, np.ndarray], outlet_index: np.ndarray, gravity: np.ndarray) -> None:
        """Record deleted particles.

        arrays:        as for `mechanical_energy`
        outlet_index:  (n,) index of the outlet that deletes each particle, -1 for none
        gravity:       (3,) [m/s2]
        """
        kinetic, rotational, potential = mechanical_energy(arrays, gravity)
        self.deleted_count += len(arrays["mass"])
        self.deleted_mass += exact_sum(arrays["mass"])
        self.removed_energy += kinetic + rotational + potential
        self.removed_kinetic_energy += kinetic + rotational
        for index, sums in enumerate(self.outlets.values()):
            by_outlet = outlet_index == index
            sums[0] += float(by_outlet.sum())
            sums[1] += exact_sum(arrays["mass"][by_outlet])

    def count_exits(self, faces: np.ndarray) -> None:
        """Count particles that left the domain outside all outlets; `faces` (k,): indices in EXIT_FACES."""
        for index, name in enumerate(EXIT_FACES):
            self.exits[name] += int((faces == index).sum())

    def change_contents(self, plan: Plan, change: str, arrays: Mapping[str, np.ndarray]) -> None:
        """Add the contents of particles to one of CONTENT_CHANGES.

        arrays:  as for `contents_of`; of particles that are inserted without loss_heat
        """
        for equation in plan.scene.equations:
            if equation.content is not None:
                capacity = capacity_of(plan, equation, arrays)
                name = equation.content_change(change).name
                self.contents[name] += _content(plan, equation, capacity, arrays)

    def record_removed(self, ids: np.ndarray, position: np.ndarray) -> None:
        """Record the ids (k,) and positions (k, 3) [m] of removed particles, in the order of the ids."""
        order = np.argsort(ids)
        new = {"id": ids[order].astype(np.int64), "position": position[order].astype(np.float64)}
        self.removed = {name: np.concatenate([self.removed[name], new[name]]) for name in new}

    def count_removed(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Count particles that are removed from Python; arrays: as for `deleted_fields`.

        The change of `Engine.stored_energy` contains their energy.
        """
        mass = arrays["mass"]
        self.record_removed(arrays["id"], body_positions(arrays))
        self.deleted_count += len(mass)
        self.deleted_mass += exact_sum(mass)

    def set_group(self, ids: np.ndarray, group: np.ndarray) -> None:
        """Set the group numbers (n,) of particles with ids (n,)."""
        groups = self.by_id("group", np.arange(self.inserted_count)).copy()
        groups[ids] = group
        self.group[:] = [groups]

    def by_id(self, name: str, ids: np.ndarray) -> np.ndarray:
        """One of BY_ID (n,) for particle ids (n,)."""
        parts = getattr(self, name)
        if len(parts) > 1:
            parts[:] = [np.concatenate(parts)]
        return parts[0][ids] if parts else np.zeros(len(ids), BY_ID[name])

    def state_dict(self) -> dict[str, Any]:
        """Numbers, BY_NAME, the removed particles, and BY_ID (inserted_count,), for checkpoints."""
        ids = np.arange(self.inserted_count)
        by_id = {name: self.by_id(name, ids) for name in BY_ID}
        return {name: getattr(self, name) for name in (*SAVED_NUMBERS, *BY_NAME, "removed")} | by_id

    def load_state_dict(self, saved: dict[str, Any]) -> None:
        """Restore a state of `state_dict`."""
        for name in (*SAVED_NUMBERS, *BY_NAME, "removed"):
            setattr(self, name, saved[name])
        for name in BY_ID:
            setattr(self, name, [saved[name]])


BY_ID = {"material": np.int32, "group": np.int32, "insertion_time": np.float64}
"""Types of the arrays of Accounting that have an entry for every particle id."""
BY_NAME = ("outlets", "exits", "contents")
"""Attributes of Accounting that have an entry for each outlet, face of the domain, or total of a particle
equation."""
SAVED_NUMBERS = {each.name: each.type for each in fields(Accounting) if each.type in (int, float)}
"""Type of each count, mass and energy of Accounting by name."""


@dataclass(frozen=True)
class ParticleSums:
    """Sums over all particles at the time of the positions.

    count:                number of particles
    energies:             kinetic, rotational and gravitational energy [J]
    speed:                largest speed [m/s]
    coordination_number:  mean number of contacts with particles, of mobile particles
    wall_contact_count:   number of contacts with walls
    contents:             totals of particle equations by name
    """

    count: int
    energies: tuple[float, float, float]
    speed: float
    coordination_number: float
    wall_contact_count: float
    contents: Mapping[str, float] = field(default_factory=dict)


# The totals of a snapshot.


def totals_of(
    state: State,
    accounting: Accounting,
    sums: ParticleSums,
    measured: Mapping[str, float],
) -> dict[str, float]:
    """Totals of the present state by name, SI units.

    sums:      sums over the particles
    measured:  totals of ContactStatistics
    """
    contacts = measured["contact_count"]
    energies = sums.energies
    plan = state.plan
    totals = {
        "particle_count": float(sums.count),
        "inserted_count": float(accounting.inserted_count),
        "deleted_count": float(accounting.deleted_count),
        "deleted_mass": accounting.deleted_mass,
        "contact_count": contacts,
        "kinetic_energy": energies[0],
        "rotational_energy": energies[1],
        "overlap_mean": measured["overlap_sum"] / contacts if contacts else 0.0,
        "overlap_largest": measured["overlap_largest"],
        "coordination_number": sums.coordination_number,
    }
    if plan.features.liquid_transfer:
        totals |= {name: measured[name] for name in LIQUID_SUMS}
    if plan.features.walls:
        totals["wall_contact_count"] = sums.wall_contact_count
    if plan.features.changing_gravity:
        names = ("gravity_x", "gravity_y", "gravity_z")
        totals |= dict(zip(names, present_gravity(state).tolist(), strict=True))
    if plan.features.lees_edwards:
        totals["shear_strain"] = plan.periodic_box.strain(state.clock.time)
    totals |= deformation_totals(state)
    if accounting.queued_count is not None:
        totals["queued_count"] = float(accounting.queued_count)
    totals |= {**sums.contents, **accounting.contents, **wall_flow_totals(state)}
    for name, (outlet_count, outlet_mass) in accounting.outlets.items():
        totals |= {f"outlet_count.{name}": outlet_count, f"outlet_mass.{name}": outlet_mass}
    totals |= _inserted_counts(plan, accounting)
    if plan.features.energy_budget:
        totals |= energy_budget_totals(state, accounting, energies, measured)
    return totals | controlled_totals(state)


def _inserted_counts(plan: Plan, accounting: Accounting) -> dict[str, float]:
    """Number of particles so far of each group that enters during the run; a clump is one particle."""
    timed = [
        (number, group)
        for number, group in enumerate(plan.groups)
        if isinstance(group.spec.insert, TimedInsertion)
    ]
    if not timed:
        return {}
    spheres = np.bincount(
        accounting.by_id("group", np.arange(accounting.inserted_count)), minlength=len(plan.groups)
    )
    return {
        f"inserted_count.{group.name}": float(spheres[number] // group.spec.shape.sphere_count)
        for number, group in timed
    }


LARGEST_ERROR = 5e-3
"""Magnitude of the energy error above which a run warns."""
ROUNDING = {"f64": 1e-9, "mixed": 1e-6, "f32": 1e-5}
"""Rounding error of the energy budget, relative to its potential energies, by precision.

It results from the masses; in f32 also from the positions.
"""


def energy_budget_totals(
    state: State, accounting: Accounting, energies: tuple[float, float, float], measured: Mapping[str, float]
) -> dict[str, float]:
    """The energy budget [J], and its error.

    The error is the residual over the largest energy input of all observations and now.

        residual = K + U + E_elastic + E_dissipated + E_deleted - E_inserted - W
        energy_error = residual / max(E_in so far and now, rounding / LARGEST_ERROR)

    energies:  kinetic, rotational and gravitational energy [J]
    measured:  totals of ContactStatistics
    Returns:   totals by the names of TOTAL_QUANTITIES

    The scale is the largest E_in, because the present E_in can be zero: a bouncing sphere at its highest
    point has returned all of it. If E_in is below the rounding error of the potential energies, the rounding
    error is the scale, so that rounding does not count as an energy error.
    """
    unit = state.plan.sum_units.energy / SHARES
    words = state.ranks.total(chunk_words(state, state.control.losses))
    losses = dict(zip(LOSSES, exact_totals(words, unit).tolist(), strict=True))
    losses["plastic_dissipation"] += measured["plastic_dissipation"]
    losses["wall_work"] += controlled_work(state)
    if state.control.losses_ahead is not None:
        ahead = exact_totals(state.ranks.total(chunk_words(state, state.control.losses_ahead)), unit)
        for term, value in zip(terms_ahead(state.plan.features), ahead.tolist(), strict=True):
            losses[LOSSES[term]] -= value
    names = ("boundary_work", "external_work", "gravity_work")
    sums = {name: getattr(state.control, name) for name in names}
    other_works = {
        name: float(exact_totals(state.ranks.total(chunk_words(state, each)), unit)[0])
        for name, each in sums.items()
        if each is not None
    }
    if "boundary_work" in other_works:
        other_works["boundary_work"] += deformation_work(state)
    works = (losses["wall_work"], *other_works.values())
    dissipated = sum(losses[name] for name in LOSSES if name != "wall_work")
    present_energy = sum(energies) + measured["elastic_energy"]
    removed = accounting.removed_energy - accounting.inserted_energy
    residual = present_energy + dissipated + removed - sum(works)
    rounding = ROUNDING[state.backend.precision] * (abs(energies[2]) + abs(removed))
    potential = energies[2] + min(measured["elastic_energy"], 0.0)
    energy_put_in = max(accounting.energy_put_in, energy_input(accounting, potential, works))
    scale = max(energy_put_in, rounding / LARGEST_ERROR)
    return {
        "gravitational_energy": energies[2],
        "elastic_energy": measured["elastic_energy"],
        **losses,
        **other_works,
        "removed_energy": removed,
        "energy_error": residual / scale if scale > 0.0 else 0.0,
    }


def ended_contacts_dissipation(state: State) -> float:
    """Plastic dissipation [J] of all ended contacts; 0 without the energy budget."""
    losses = state.control.losses
    if losses is None:
        return 0.0
    return float(
        exact_totals(state.ranks.total(chunk_words(state, losses)), state.plan.sum_units.energy / SHARES)[
            LOSS_PLASTIC
        ]
    )


def mechanical_energy(
    arrays: Mapping[str, np.ndarray], gravity: np.ndarray, ranks: Gathering = ALONE
) -> tuple[float, float, float]:
    """Kinetic, rotational and gravitational energy [J] of the particles; a fixed particle contributes none.

        m v^2 / 2,   (2/5) m R^2 w^2 / 2,   -m g . x        the same for any order of the particles

    Each sphere of a clump contributes its share of the energies of the clump, see `of_clumps`.

    arrays:   mass (n,) [kg], radius (n,) [m], position (n, 3) [m], velocity (n, 3) [m/s] and, if particles
              rotate, angular_velocity (n, 3) [rad/s]; with clumps CLUMP_MOTION
    gravity:  (3,) [m/s2]
    ranks:    adds up the energies of all ranks, each of which has arrays of its own particles
    """
    mass = arrays["mass"].astype(float) * mobility_mask(arrays)
    arrays = of_clumps(arrays)
    kinetic = 0.5 * exact_sum(mass * _squares(arrays["velocity"]), ranks)
    rotational = 0.0
    if "angular_velocity" in arrays:
        inertia = sphere_inertia(mass, arrays["radius"].astype(float))
        doubled = inertia * _squares(arrays["angular_velocity"])
        if ROTATION_SHARE in arrays:
            doubled = np.where(arrays["clump"] >= 0, arrays[ROTATION_SHARE], doubled)
        rotational = 0.5 * exact_sum(doubled, ranks)
    x, y, z = arrays["position"].astype(float).T
    return kinetic, rotational, -exact_sum(mass * (x * gravity[0] + y * gravity[1] + z * gravity[2]), ranks)


def _squares(vectors: np.ndarray) -> np.ndarray:
    """Squared length (n,) of each of the vectors (n, 3)."""
    x, y, z = vectors.astype(float).T
    squares: np.ndarray = x * x + y * y + z * z
    return squares


def energy_input(accounting: Accounting, potential: float, works: Iterable[float] = ()) -> float:
    """Energy input [J] by gravity, attraction, initial motion, insertion, walls and periodic images.

        E_in = max(E_inserted - U - U_deleted, 0) + sum of max(W, 0)

    potential:  U [J], potential energy of the present particles, with the energy of attraction (the energy
                of contacts if it is negative), which particles can gain as that of gravity
    works:      W [J], work of the walls, of the images of a sheared box, and of external and changing forces

    E_inserted is the mechanical energy of inserted particles, U_deleted the potential energy of deleted
    particles. The result does not depend on the origin of the potential.
    """
    energy_supplied = (
        accounting.inserted_energy
        - potential
        - (accounting.removed_energy - accounting.removed_kinetic_energy)
    )
    return max(energy_supplied, 0.0) + sum(max(work, 0.0) for work in works)


# Arrays of snapshots.


def ordered_particles(arrays: dict[str, np.ndarray], accounting: Accounting) -> dict[str, np.ndarray]:
    """Arrays of Snapshot.particles, ordered by id, from arrays (n,) or (n, 3) in device order.

    Without rotation, angular velocity and torque are zero.
    """
    order = np.argsort(arrays["id"], kind="stable")
    found = {name: values[order] for name, values in arrays.items()}
    found["id"] = found["id"].astype(np.int64)
    for name in BY_ID:
        found[name] = accounting.by_id(name, found["id"])
    for name in ("angular_velocity", "torque"):
        found.setdefault(name, np.zeros_like(found["velocity"]))
    return found


def wall_poses(state: State) -> dict[str, WallPose]:
    """Present pose of every wall by name."""
    found = {}
    displacements = controlled_displacements(state)
    for index, wall in enumerate(state.plan.walls):
        poses = poses_at(state.wall_motions[index], np.array([state.clock.time]))
        present = bool(state.walls.present[index])
        found[wall.name] = WallPose(
            present,
            poses.offset[0] + displacements[index],
            poses.rotation[0],
            poses.pivot,
            poses.surface_velocity[0],
        )
    return found


# Sums over the particles for the totals of a snapshot: on the host from its arrays, or on a GPU without
# copying them.
#
# Both add the same terms, rounded to the same unit, so that the order of the particles does not matter, see
# `exact_sum`.

ENERGY_COUNT = 3
"""Kinetic, rotational and gravitational energy."""
PARTICLE_CONTACTS, MOBILE, WALL_CONTACTS = range(ENERGY_COUNT, ENERGY_COUNT + 3)
"""Columns of further sums: contacts of mobile particles with particles, mobile particles, contacts with
walls."""
LARGEST_SPEED_SQUARED = ENERGY_COUNT
"""Column of the largest values."""


def host_sums(
    arrays: Mapping[str, np.ndarray], gravity: np.ndarray, ranks: Gathering = ALONE
) -> ParticleSums:
    """Sums of particles on the host.

    arrays:   as for `mechanical_energy`, and coordination_number (n,), wall_contact_count (n,) with walls,
              fixed (n,) with fixed particles
    gravity:  (3,) [m/s2]
    ranks:    adds up the sums of all ranks
    """
    mobile = mobility_mask(arrays)
    walls = arrays.get("wall_contact_count", np.zeros(0))
    sums = [len(arrays["mass"]), mobile @ arrays["coordination_number"], mobile.sum(), walls.sum()]
    count, contacts, mobile_count, wall_contacts = ranks.total(np.array([sums], float))[0].tolist()
    return ParticleSums(
        count=int(count),
        energies=mechanical_energy(arrays, gravity, ranks),
        speed=ranks.largest(largest_speed(arrays["velocity"])),
        coordination_number=contacts / max(mobile_count, 1.0),
        wall_contact_count=wall_contacts,
    )


def contents_of(plan: Plan, arrays: Mapping[str, np.ndarray], ranks: Gathering) -> dict[str, float]:
    """Totals of the particle equations, see `ParticleEquation.totals`; a mean without particles is NaN.

    arrays:  mass (n,) [kg], the properties (n,), with several materials material (n,), in the plan, and
             with heat of losses loss_heat (n,)
    """
    found: dict[str, float] = {}
    for equation in plan.scene.equations:
        if equation.content is None:
            continue
        capacity = capacity_of(plan, equation, arrays)
        content = _content(plan, equation, capacity, arrays, ranks)
        total = exact_sum(capacity, ranks)
        mean, content_total, *_ = equation.totals
        found |= {mean.name: content / total if total else np.nan, content_total.name: content}
        names = [each.name for each in equation.spread]
        found |= dict(zip(names, _spread(arrays[equation.name], capacity, total, ranks), strict=True))
    return found


def _spread(
    values: np.ndarray, capacity: np.ndarray, total: float, ranks: Gathering
) -> tuple[float, float, float]:
    """Standard deviation of values (n,), weighted by their capacity (n,), smallest and largest; NaN without
    values.

    total:  of the capacity on all ranks
    """
    if not total:
        return np.nan, np.nan, np.nan
    values = values.astype(float)
    off = values - exact_sum(capacity * values, ranks) / total
    variance = exact_sum(capacity * off**2, ranks) / total
    smallest = -ranks.largest(float((-values).max(initial=-np.inf)))
    return float(np.sqrt(variance)), smallest, ranks.largest(float(values.max(initial=-np.inf)))


def _content(
    plan: Plan,
    equation: ParticleEquation,
    capacity: np.ndarray,
    arrays: Mapping[str, np.ndarray],
    ranks: Gathering = ALONE,
) -> float:
    """Content of the particles, such as their heat [J], with that of losses which the next step adds.

    capacity:  (n,), see `capacity_of`
    arrays:    as for `contents_of`; of particles that are inserted without loss_heat
    """
    content = exact_sum(capacity * arrays[equation.name], ranks)
    law = plan.laws.of_losses
    if law is not None and law.loss_flow in equation.flows and "loss_heat" in arrays:
        present = arrays["loss_heat"].astype(object).sum()
        if "loss_heat_ahead" in arrays:
            present -= arrays["loss_heat_ahead"].astype(object).sum()
        units = ranks.total(np.array([present], float))
        content += float(units[0]) * plan.loss_heat_unit
    return content


def capacity_of(plan: Plan, equation: ParticleEquation, arrays: Mapping[str, np.ndarray]) -> np.ndarray:
    """Ratio (n,) of the content of particles to the property of an equation.

    arrays:  mass (n,) [kg], with several materials material (n,), in the plan
    """
    mass = arrays["mass"].astype(float)
    material = arrays.get("material", np.zeros(len(mass), int))
    by_material = [plan.material_constants(equation, name) for name in plan.materials]
    constants = {
        key: np.array([each[key] for each in by_material])[material] for key in equation.material_keys
    }
    return equation.capacity(constants, mass)


def largest_speed(velocity: np.ndarray) -> float:
    """Largest speed [m/s] of velocities (n, 3)."""
    return float(np.sqrt(np.einsum("ij,ij->i", velocity, velocity).max(initial=0.0)))


def device_sums(state: State, half_step: float) -> ParticleSums:
    """Sums of the particles on a GPU: two kernels and two arrays of REDUCED_ROWS rows.

    half_step:  time [s] by which velocities are behind the positions; 0 before the first step
    """
    if not state.count:
        return ParticleSums(0, (0.0, 0.0, 0.0), 0.0, 0.0, 0.0)
    find_largest, add_up = state.built(_build_particle_sums)
    largest = np.zeros((REDUCED_ROWS, ENERGY_COUNT + 1))
    find_largest(state.count, half_step, largest)
    largest = largest.max(axis=0)
    exponents = [scale_exponent(value, state.count) for value in largest[:ENERGY_COUNT].tolist()]
    units = np.zeros((REDUCED_ROWS, WALL_CONTACTS + 1), np.int64)
    add_up(state.count, half_step, *(2.0**exponent for exponent in exponents), units)
    kinetic, rotational, potential = (
        exact_total(units[:, k]) * 2.0**-exponent if np.isfinite(largest[k]) else float(largest[k])
        for k, exponent in enumerate(exponents)
    )
    contacts, mobile, walls = units[:, ENERGY_COUNT:].sum(axis=0).tolist()
    energies = (0.5 * kinetic, 0.5 * rotational, -potential)
    speed = float(np.sqrt(largest[LARGEST_SPEED_SQUARED]))
    return ParticleSums(state.count, energies, speed, contacts / max(mobile, 1.0), float(walls))


def _build_particle_sums(state: State) -> tuple[Callable[..., None], Callable[..., None]]:
    """Kernels (count, half step, rows) and (count, half step, three scales, rows).

    The first finds the largest magnitude of the energies and the largest squared speed of every
    REDUCED_ROWS-th particle, the second their sums in units of 1 / scale, and the further sums.

    Reads:  position, velocity, angular_velocity, force, torque, mass, radius, fixed, contact counts
    """
    particles = state.particles
    features = state.plan.features
    terms_of = _build_energy_terms(state)
    external: Any = ti.types.ndarray()

    @ti.kernel
    def find_largest(count: ti.i32, half_step: ti.f64, rows: external):
        for row in range(REDUCED_ROWS):
            largest = ti.Vector.zero(ti.f64, ENERGY_COUNT)
            speed_squared = ti.cast(0.0, ti.f64)
            for k in range((count - row + REDUCED_ROWS - 1) // REDUCED_ROWS):
                terms, squared = terms_of(row + k * REDUCED_ROWS, half_step)
                largest = ti.max(largest, ti.abs(terms))
                speed_squared = ti.max(speed_squared, squared)
            for energy in ti.static(range(ENERGY_COUNT)):
                rows[row, energy] = largest[energy]
            rows[row, LARGEST_SPEED_SQUARED] = speed_squared

    @ti.kernel
    def add_up(
        count: ti.i32,
        half_step: ti.f64,
        kinetic: ti.f64,
        rotational: ti.f64,
        potential: ti.f64,
        rows: external,
    ):
        for row in range(REDUCED_ROWS):
            sums = ti.Vector.zero(ti.i64, WALL_CONTACTS + 1)
            scale = ti.Vector([kinetic, rotational, potential])
            for k in range((count - row + REDUCED_ROWS - 1) // REDUCED_ROWS):
                i = row + k * REDUCED_ROWS
                terms, _squared = terms_of(i, half_step)
                for energy in ti.static(range(ENERGY_COUNT)):
                    sums[energy] += to_nearest(terms[energy] * scale[energy])
                is_mobile = ti.cast(particles.mobility(i), ti.i64)
                sums[PARTICLE_CONTACTS] += is_mobile * particles.coordination_number[i]
                sums[MOBILE] += is_mobile
                if ti.static(features.walls):
                    sums[WALL_CONTACTS] += particles.wall_contact_count[i]
            for column in ti.static(range(WALL_CONTACTS + 1)):
                rows[row, column] = sums[column]

    return find_largest, add_up


def _build_energy_terms(state: State) -> Any:
    """Device function (i, half step): twice the kinetic and rotational energy, -U [J], squared speed.

    Operations are in the order of `Engine.synchronized` and `mechanical_energy`.

    Reads:  position, velocity, angular_velocity, force, torque, mass, radius, fixed
    """
    particles = state.particles
    rotation = state.plan.features.rotation
    gravity = state.parameter("gravity")

    @ti.func
    def to_f64(vector):
        return ti.cast(vector, ti.f64)

    @ti.func
    def terms_of(i, half_step):
        mass = to_f64(particles.mass[i])
        share = to_f64(particles.mobility(i))
        velocity = to_f64(particles.velocity[i]) + half_step * share * to_f64(particles.force[i]) / mass
        squared = velocity[0] * velocity[0] + velocity[1] * velocity[1] + velocity[2] * velocity[2]
        turning = ti.cast(0.0, ti.f64)
        if ti.static(rotation):
            radius = to_f64(particles.radius[i])
            inertia = sphere_inertia(mass, radius)
            spin = (
                to_f64(particles.angular_velocity[i])
                + half_step * share * to_f64(particles.torque[i]) / inertia
            )
            inertia_mobile = sphere_inertia(mass * share, radius)
            turning = inertia_mobile * (spin[0] * spin[0] + spin[1] * spin[1] + spin[2] * spin[2])
        x = to_f64(particles.position[i])
        g = gravity()
        height = x[0] * g[0] + x[1] * g[1] + x[2] * g[2]
        return ti.Vector([mass * share * squared, turning, mass * share * height]), squared

    return terms_of


# Deleted particles: their arrays, and their part of the accounting.

DELETED_FIELDS = tuple(
    dict.fromkeys(
        (
            "id",
            "mass",
            "radius",
            "position",
            "velocity",
            "angular_velocity",
            "fixed",
            "attached_to",
            *CLUMP_MOTION,
        )
    )
)
"""Fields of deleted particles that their accounting needs in each scene."""
CONTENT_FIELDS = ("mass", "material", "loss_heat", "loss_heat_ahead")
"""Fields from which the content of particles follows, with the properties of the equations."""


def content_fields(plan: Plan) -> tuple[str, ...]:
    """CONTENT_FIELDS and the properties of the equations; none without equations."""
    equations = tuple(each.name for each in plan.scene.equations)
    return (*CONTENT_FIELDS, *equations) if equations else ()


def deleted_fields(plan: Plan) -> tuple[str, ...]:
    """Fields of deleted particles that their accounting needs."""
    return tuple(dict.fromkeys((*DELETED_FIELDS, *content_fields(plan))))


def deleted_particles(state: State, first: int, last: int) -> dict[str, np.ndarray]:
    """`deleted_fields` of the particles `first` to `last`, exclusive, in the order of their ids."""
    arrays = copy_to_host(state, deleted_fields(state.plan), first, last)
    by_id = np.argsort(arrays["id"])
    return {name: values[by_id] for name, values in arrays.items()}


def account_deleted(
    state: State, accounting: Accounting, arrays: Mapping[str, np.ndarray], counts_removed: bool
) -> None:
    """Add deleted particles with their `deleted_fields` to the accounting.

    counts_removed:  whether particles that are marked by `remove_particles` count here; those that a program
                     removes are counted there

    Sets the abort code if one of them left the domain and `on_exit` is error, or a wall has moved it.
    """
    removed = arrays["radius"] <= REMOVED_BELOW
    if removed.any() and not counts_removed:
        arrays = {name: values[~removed] for name, values in arrays.items()}
        removed = removed[~removed]
    position = body_positions(arrays).astype(float)
    outlet_index = np.where(removed, -1, _outlets_of(state.plan, position))
    left_domain = (outlet_index < 0) & ~removed
    aborts = left_domain
    if state.plan.scene.domain.on_exit != "error":
        aborts = left_domain & (arrays.get("attached_to", np.full(len(position), -1)) >= 0)
    if aborts.any():
        state.control.abort[0] = ABORT_LEFT_DOMAIN
        state.control.abort_particle[0] = int(arrays["id"][aborts].min())
    accounting.record_removed(arrays["id"][removed], position[removed])
    accounting.delete(arrays, outlet_index, np.array(state.plan.scene.gravity_at_start))
    accounting.change_contents(state.plan, "deleted", arrays)
    accounting.count_exits(_exit_faces(state.plan, position[left_domain]))


def _exit_faces(plan: Plan, position: np.ndarray) -> np.ndarray:
    """Index in EXIT_FACES (n,) of the face of the domain that is farthest behind each position (n, 3) [m]."""
    beyond = np.concatenate([plan.domain_low - position, position - plan.domain_high], axis=1)
    return np.asarray(beyond.argmax(axis=1))


def _outlets_of(plan: Plan, position: np.ndarray) -> np.ndarray:
    """Index of the outlet (n,) that deletes each particle at a position (n, 3) [m], -1 for none."""
    checked_axes = [axis for axis in range(3) if plan.scene.domain.on_exit != "expand"]
    low, high = plan.domain_low[checked_axes], plan.domain_high[checked_axes]
    in_domain = np.all((position[:, checked_axes] >= low) & (position[:, checked_axes] <= high), axis=1)
    return outlet_of(plan.scene.outlets.values(), position, in_domain)


# Warnings during a run from values of the snapshots, without additional work in a step.

SPEED_INCREASE = 1.1
"""Factor by which the particle speed must exceed the previous maximum for another check."""


class StabilityMonitor:
    """Checks at each observation that the time step is stable and that the energy is conserved.

    With the energy budget, the magnitude of its error must be below LARGEST_ERROR. Without it, kinetic and
    potential energy must not exceed those at the start and of particles inserted since. The excess is
    relative to the same scale, the largest energy input so far. This check requires a start without contacts,
    walls at rest and no cohesion.

    `warnings`: logged warnings by kind ("energy", "speed"), each logged once.
    """

    def __init__(self, plan: Plan) -> None:
        self.plan = plan
        self.warnings: dict[str, str] = {}
        self._fastest = plan.impact_velocity.value
        self._rounding = ROUNDING[plan.scene.run.precision]
        self._initial_energy = 0.0
        self._above_since: float | None = None
        self._enabled = not plan.features.energy_budget and _conserves_energy(plan)
        self._started = False

    def check(
        self,
        time: float,
        energies: tuple[float, float, float],
        accounting: Accounting,
        totals: dict[str, float],
        speed: float,
    ) -> None:
        """Check one snapshot; warns if the energy error exceeds its limit in two consecutive snapshots.

        time:        simulated time [s]
        energies:    kinetic, rotational and gravitational energy [J]
        accounting:  counts and energies since the start; its `energy_put_in` is updated
        totals:      totals of the snapshot
        speed:       largest speed of a particle [m/s]
        """
        self._check_speed(time, speed)
        works = (
            totals[name]
            for name in ("wall_work", "boundary_work", "external_work", "gravity_work")
            if name in totals
        )
        potential = energies[2] + min(totals.get("elastic_energy", 0.0), 0.0)
        accounting.energy_put_in = max(accounting.energy_put_in, energy_input(accounting, potential, works))
        share = totals.get("energy_error", self._gained_share(energies, accounting, totals["contact_count"]))
        earlier = self._above_since
        self._above_since = None if not abs(share) > LARGEST_ERROR else time if earlier is None else earlier
        if earlier is not None and self._above_since is not None and time > earlier:
            self._enabled = False
            self._warn_once(
                "energy",
                f"At {time:.6g} s the energy error is {share:.2%} of the energy input, more than "
                f"{LARGEST_ERROR:.1%}: the time step is too long for the contacts. Lower run.time_step (now "
                f"{self.plan.time_step:.3g} s) or set run.velocity_max to the fastest impact; "
                "output.energy_budget shows the terms of the energy budget.",
            )

    def state_dict(self) -> dict[str, Any]:
        """Return the state for a checkpoint, so that a resumed run repeats no warning."""
        return {
            "warnings": dict(self.warnings),
            "fastest": self._fastest,
            "initial_energy": self._initial_energy,
            "above_since": self._above_since,
            "enabled": self._enabled,
            "started": self._started,
        }

    def load_state_dict(self, saved: dict[str, Any]) -> None:
        """Restore the state of `state_dict`.

        The plan may have changed so that the energy is not conserved any more.
        """
        self.warnings = dict(saved["warnings"])
        self._fastest = saved["fastest"]
        self._initial_energy = saved["initial_energy"]
        self._above_since = saved["above_since"]
        self._enabled = self._enabled and saved["enabled"]
        self._started = saved["started"]

    def _gained_share(
        self, energies: tuple[float, float, float], accounting: Accounting, contact_count: float
    ) -> float:
        """Excess energy over the largest energy input so far."""
        energy_gain = self._energy_gain(energies, accounting, contact_count)
        return energy_gain / accounting.energy_put_in if accounting.energy_put_in > 0.0 else 0.0

    def _energy_gain(
        self, energies: tuple[float, float, float], accounting: Accounting, contact_count: float
    ) -> float:
        """Energy above the conserved total [J]; 0 if the check does not apply."""
        if not self._enabled:
            return 0.0
        energy_inserted = accounting.inserted_energy - accounting.removed_energy
        present_energy = sum(energies) - energy_inserted
        if not self._started:
            self._started = True
            self._enabled = contact_count == 0
            self._initial_energy = present_energy
        return max(
            present_energy
            - self._initial_energy
            - self._rounding * (abs(energies[2]) + abs(energy_inserted)),
            0.0,
        )

    def _check_speed(self, time: float, speed: float) -> None:
        """Compare a fixed time step with the stable time step at the speed of the fastest particle."""
        if self.plan.adaptive_time_step is not None or not SPEED_INCREASE * self._fastest < speed < inf:
            return
        self._fastest = speed
        stable = min(
            pair_case.stable_step(self.plan.laws.normal, speed) for pair_case in self.plan.pair_cases
        )
        if self.plan.time_step > stable:
            self._warn_once(
                "speed",
                f"At {time:.6g} s the fastest particle moves at {speed:.3g} m/s, above the planned "
                f"{self.plan.impact_velocity.value:.3g} m/s: an impact at that speed requires a time step "
                f"below {stable:.3g} s, but it is {self.plan.time_step:.3g} s. Set run.velocity_max to "
                f"{speed:.3g} m/s.",
            )

    def _warn_once(self, kind: str, sentence: str) -> None:
        """Log the warning once per kind."""
        if kind not in self.warnings:
            self.warnings[kind] = sentence
            logging.getLogger("granflow").warning("%s", sentence)


def _conserves_energy(plan: Plan) -> bool:
    """True if only inserted particles can increase the energy."""
    walls_static = all(wall.spec.is_permanent for wall in plan.walls)
    # Gravity along a periodic axis accelerates particles without limit.
    has_other_work = any(plan.scene.gravity_at_start[axis] for axis in plan.periodic_box.axes)
    has_other_work = has_other_work or plan.features.moving_images
    has_other_work = has_other_work or plan.features.external_forces or plan.features.changing_gravity
    return walls_static and not has_other_work and not plan.features.moving_walls and not plan.laws.attracts
