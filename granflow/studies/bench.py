"""Binary collisions: many separate pairs of particles, or particles and walls, in one simulation.

All contacts are normal to x, at the same x; the collisions are far apart in y and z. There is no gravity.
"""

import json
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations_with_replacement
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from granflow import GranflowError, ParticleData, Plan, Scene, plan_for
from granflow.contact.material import PairMaterial
from granflow.contact.registry import models
from granflow.geometry.shape import sphere_mass
from granflow.scene.blocks.run import LARGEST_OVERLAP

if TYPE_CHECKING:
    from granflow import Simulation

LONGEST = 20.0
"""Maximum length of a collision in units of its expected duration; longer collisions count as sticking."""
SPACING = 4.0
"""Spacing of neighboring collisions over the largest diameter."""
GOLDEN = 0.5 * (np.sqrt(5.0) - 1.0)
"""Golden ratio; its multiples modulo 1 are evenly distributed in the unit interval."""
FORCES_TO_END = 4
"""Number of final forces of a contact that determine its end."""
EARLIEST_END, LATEST_END = -0.5, 1.0
"""Range of the end of a contact after its last force, in steps."""
Settings = Mapping[str, Any]
"""Entries of a block of a scene."""


def duration_given(diameter: float, velocity: float) -> float:
    """Value of run.duration [s]: LONGEST times the travel by a diameter [m] at up to 1 m/s, at most 1 s.

    The bench ends with the last collision; a longer duration of small particles is refused for its number of
    steps.
    """
    return min(1.0, LONGEST * diameter / min(velocity, 1.0))


@dataclass(frozen=True)
class Collision:
    """One collision of a particle with another particle or with a wall, in SI units.

    first, second:   names of the materials
    radius:          of the first particle
    other_radius:    of the second particle; None for a wall
    velocity:        approach velocity; `share` of it is that of the first particle, 1 toward a wall
    along, spin:     velocity of the first particle along y, and angular velocity about -z; the surface of the
                     particle slides at the velocity along - radius * spin
    first_contact:   time of first contact
    """

    first: str
    second: str
    radius: float
    other_radius: float | None
    velocity: float
    share: float = 0.5
    along: float = 0.0
    spin: float = 0.0
    first_contact: float = 0.0

    def reduced(self, scene: Scene) -> tuple[float, float]:
        """Effective radius [m] and mass [kg]; a wall has infinite radius and mass."""
        mass = sphere_mass(self.radius, scene.materials[self.first].density)
        if self.other_radius is None:
            return self.radius, mass
        other = sphere_mass(self.other_radius, scene.materials[self.second].density)
        radius_eff = self.radius * self.other_radius / (self.radius + self.other_radius)
        return radius_eff, mass * other / (mass + other)


class CollisionBench:
    """Collisions in one simulation; call `free` after use.

    materials, pairs:  blocks of a scene; missing pairs are elastic, because their materials do not touch
    contact, run:      blocks of a scene
    numerics:          additions to this block
    contact_x:         coordinate of all contacts [m]
    arch, threads:     as for Simulation
    Raises:            SceneError if the contact model or the time step is not suitable
    """

    def __init__(
        self,
        materials: Settings,
        pairs: Settings,
        contact: Settings,
        collisions: Sequence[Collision],
        run: Settings,
        numerics: Settings = MappingProxyType({}),
        contact_x: float = 0.0,
        arch: str = "cpu",
        threads: int | None = None,
    ) -> None:
        self.collisions = collisions
        self._contact_x = contact_x
        self._arch = arch
        self._threads = threads
        self.scene = Scene.from_dict(self._described(materials, pairs, contact, run, numerics))

    @cached_property
    def simulation(self) -> "Simulation":
        """Simulation of the scene."""
        from granflow import Simulation  # imports Taichi, which `granflow check` does not need

        return Simulation(self.scene, arch=self._arch, threads=self._threads)  # type: ignore[arg-type]

    @cached_property
    def plan(self) -> Plan:
        """Plan of the scene."""
        return plan_for(self.scene)

    def pair_of(self, collision: Collision) -> tuple[PairMaterial, float, float, float]:
        """Pair of materials, effective radius [m] and mass [kg], velocity [m/s]: arguments of contact
        models."""
        pair = self.plan.pair(collision.first, collision.second)
        return pair, *collision.reduced(self.scene), collision.velocity

    @property
    def most_steps(self) -> int:
        """Upper bound of the number of steps until the slowest collision has ended."""
        cases = {(c.first, c.second, c.radius, c.other_radius, c.velocity): c for c in self.collisions}
        longest = max(sum(self.plan.law.phase_durations(*self.pair_of(each))) for each in cases.values())
        approach = max(each.first_contact for each in self.collisions)
        return int((approach + LONGEST * longest) / self.simulation.time_step) + 10

    def restart(self, collisions: Sequence[Collision], time_step: float | None = None) -> None:
        """Replace the collisions by others of the same partners and materials; optionally another time step
        [s]."""
        self.collisions = collisions
        self.simulation.restart(self._particles()[0], time_step)

    def sample(self) -> np.ndarray:
        """Present overlap [m], overlap rate [m/s] and repulsion [N] (3, n); negative overlaps are gaps."""
        particles = self.simulation.snapshot().particles
        x, rate, force = (particles[name][:, 0].astype(float) for name in ("position", "velocity", "force"))
        radius = particles["radius"].astype(float)
        left, right = self._ids.T
        is_pair = right >= 0
        wall_x = np.where(is_pair, 0.0, self._contact_x)
        overlap = (
            radius[left]
            + np.where(is_pair, radius[right], 0.0)
            - (np.where(is_pair, x[right], wall_x) - x[left])
        )
        return np.array([overlap, rate[left] - np.where(is_pair, rate[right], 0.0), -force[left]])

    def run(self, every: int = 1) -> np.ndarray:
        """Samples (samples, 3, n) after every `every` steps, until all partners have separated.

        Collisions that have not ended after the maximum number of steps remain in the result.
        """
        samples = [self.sample()]
        done = 0
        limit = self.most_steps
        has_touched = np.zeros(len(self.collisions), dtype=bool)
        while done < limit:
            self.simulation.step(every)
            done += every
            samples.append(self.sample())
            _, rate, force = samples[-1]
            has_touched |= (force != 0.0) | (rate < 0.0)
            if np.all(has_touched & (force == 0.0) & (rate < 0.0)):
                break
        return np.array(samples)

    def rebound(self) -> np.ndarray:
        """Run until all partners have separated; velocities of separation (n,) [m/s], 0 for partners that
        stick."""
        _, rate, force = self.run(every=max(self.most_steps // 200, 1))[-1]
        return np.where((force == 0.0) & (rate < 0.0), -rate, 0.0)

    def motions(self) -> tuple[np.ndarray, np.ndarray]:
        """Present velocities [m/s] and angular velocities [rad/s] (n, 2, 3) of both partners; those of walls
        are 0."""
        particles = self.simulation.snapshot().particles
        both = (particles[name][self._ids].astype(float) for name in ("velocity", "angular_velocity"))
        velocity, spin = (np.where((self._ids >= 0)[:, :, None], each, 0.0) for each in both)
        return velocity, spin

    def free(self) -> None:
        """Free the device memory."""
        self.simulation.free()

    def _described(
        self, materials: Settings, pairs: Settings, contact: Settings, run: Settings, numerics: Settings
    ) -> dict[str, Any]:
        """Scene of all collisions: one group of particles per material, one rectangle per material of
        walls."""
        used = dict.fromkeys(name for each in self.collisions for name in (each.first, each.second))
        counts = _particle_counts(self.collisions)
        self._names = [name for name in used if counts[name]]
        data, self._ids = self._particles()
        groups = {}
        for number, name in enumerate(self._names):
            mine = data.group == number
            groups[name] = {
                "material": name,
                "diameter": 2.0 * data.radius[mine],
                "velocity": data.velocity[mine],
                "angular_velocity": data.angular_velocity[mine],
                "insert": {"kind": "positions", "positions": data.position[mine]},
            }
            if not data.angular_velocity.any():
                del groups[name]["angular_velocity"]
        travel = max(abs(each.along) for each in self.collisions) * run["duration"]
        high = np.full(3, np.abs(data.position).max() + travel + self._spacing)
        return {
            "title": "Separate collisions",
            "gravity": [0, 0, 0],
            "materials": {name: materials[name] for name in used},
            "pairs": _all_pairs(self.collisions, pairs, contact),
            "contact": {"tangential": "none", "rolling": "none", **contact},
            "particles": groups,
            "walls": self._walls(),
            "domain": {"min": -high, "max": high, "on_exit": "error"},
            "run": run,
            "numerics": {"max_overlap": LARGEST_OVERLAP, **numerics},
            "output": {"interval": run["duration"]},
        }

    def _particles(self) -> tuple[ParticleData, np.ndarray]:
        """All particles, sorted by material, and the ids (n, 2) of the partners of each collision; -1 for a
        wall."""
        rows = []
        for index, (each, place) in enumerate(zip(self.collisions, self._places(), strict=True)):
            radii = (each.radius, each.other_radius)
            shares = (each.share, each.share - 1.0)
            for side, (name, radius, share) in enumerate(
                zip((each.first, each.second), radii, shares, strict=True)
            ):
                if radius is not None:
                    speed = share * each.velocity
                    x = self._contact_x + (radius if side else -radius) - speed * each.first_contact
                    motion = (0.0, 0.0) if side else (each.along, -each.spin)
                    rows.append((self._names.index(name), index, side, radius, x, *place, speed, *motion))
        table = np.array(sorted(rows, key=lambda row: row[0]))
        ids = np.full((len(self.collisions), 2), -1)
        ids[table[:, 1].astype(int), table[:, 2].astype(int)] = np.arange(len(table))
        group = table[:, 0].astype(np.int32)
        zeros = np.zeros(len(table))
        velocity = np.stack([table[:, 7], table[:, 8], zeros], axis=1)
        spin = np.stack([zeros, zeros, table[:, 9]], axis=1)
        return ParticleData(table[:, 4:7], velocity, spin, table[:, 3], group, group), ids

    @property
    def _spacing(self) -> float:
        """Distance of neighboring collisions [m]."""
        return SPACING * 2.0 * max(max(each.radius, each.other_radius or 0.0) for each in self.collisions)

    def _blocks(self) -> Iterable[tuple[str | None, np.ndarray, int, int, int]]:
        """Collisions in blocks: material of the wall or None, indices, first row (z), columns (y) and rows.

        Particles that move along y have one column.
        """
        partners = [each.second if each.other_radius is None else None for each in self.collisions]
        row = 0
        moves = any(each.along for each in self.collisions)
        for partner in dict.fromkeys(partners):
            indices = np.array([index for index, each in enumerate(partners) if each == partner])
            columns = 1 if moves else int(np.ceil(np.sqrt(len(indices))))
            rows = -(-len(indices) // columns)
            yield partner, indices, row, columns, rows
            row += rows

    def _places(self) -> np.ndarray:
        """Coordinates y and z (n, 2) [m] of the collisions."""
        places = np.zeros((len(self.collisions), 2))
        for _, indices, row, columns, _ in self._blocks():
            z, y = np.divmod(np.arange(len(indices)), columns)
            places[indices] = self._spacing * np.stack([y, row + z], axis=1)
        return places

    def _walls(self) -> dict[str, Any]:
        """Walls: a rectangle at each block of collisions with a wall, or a plane if there are no other
        collisions."""
        blocks = list(self._blocks())
        spacing = self._spacing
        if len(blocks) == 1 and blocks[0][0] is not None:
            plane = {"shape": "plane", "point": [self._contact_x, 0, 0], "normal": [-1, 0, 0]}
            return {"wall": plane | {"material": blocks[0][0]}}
        return {
            f"wall_{material}": {
                "shape": "rectangle",
                "material": material,
                "corner": [self._contact_x, -0.5 * spacing, (row - 0.5) * spacing],
                "sides": [[0.0, columns * spacing, 0.0], [0.0, 0.0, rows * spacing]],
            }
            for material, _, row, columns, rows in blocks
            if material is not None
        }


def _particle_counts(collisions: Sequence[Collision]) -> Counter[str]:
    """Number of particles of each material."""
    seconds = (each.second for each in collisions if each.other_radius is not None)
    return Counter([*(each.first for each in collisions), *seconds])


def _all_pairs(collisions: Sequence[Collision], pairs: Settings, contact: Settings) -> dict[str, Any]:
    """Given entries, and those of other materials, which a scene requires although their particles do not
    touch."""
    elastic: dict[str, Any] = {"friction": 0.0, "restitution": 1.0}
    normal = contact["normal"]
    if models("normal")[normal if isinstance(normal, str) else normal["law"]].restitution == "nothing":
        del elastic["restitution"]
    found = {}
    counts = _particle_counts(collisions)
    used = dict.fromkeys(name for each in collisions for name in (each.first, each.second))
    for first, second in combinations_with_replacement(used, 2):
        key = f"{second}-{first}" if f"{second}-{first}" in pairs else f"{first}-{second}"
        if key in pairs or first != second or counts[first] > 1:
            found[key] = pairs.get(key, elastic)
    return found


# Head-on collisions of equal spheres, recorded at each step: restitution, duration, overlap, force and
# energy.


@dataclass(frozen=True)
class HeadOnCollision:
    """Head-on collision of two equal spheres.

    `material`, `restitution` as in a scene; `diameter` [m]; `velocity` [m/s]: approach velocity, half of it
    for each sphere.
    """

    material: Mapping[str, Any]
    restitution: Any
    diameter: float
    velocity: float

    @property
    def key(self) -> str:
        """Equal for collisions of the same materials."""
        return json.dumps([dict(self.material), self.restitution], sort_keys=True)


@dataclass(frozen=True)
class Outcomes:
    """Results of n collisions (n,), and their time series (steps, n), in the order of the collisions.

    A collision begins at first contact and ends when the force vanishes; both times are interpolated within a
    step. Spheres that do not separate have restitution 0 and duration nan.
    """

    restitution: np.ndarray
    duration: np.ndarray
    overlap_max: np.ndarray
    overlap_residual: np.ndarray
    """Overlap at which the force vanishes [m]."""
    force_max: np.ndarray
    stored_energy: np.ndarray
    """Work done on the contact up to the maximum overlap [J]."""
    time_step: float
    overlap: np.ndarray
    force: np.ndarray


def collide_all(
    normal: Any,
    collisions: Sequence[HeadOnCollision],
    time_step: float,
    arch: str = "cpu",
    precision: str = "f64",
) -> Outcomes:
    """Simulate all collisions in one scene with the many-particle kernels.

    `normal` is the entry `contact.normal` of the scene. First contacts are evenly distributed over the phases
    of a step. There is no friction.

    Raises SceneError if the contact model or the time step [s] is not suitable, GranflowError if pairs never
    touch.
    """
    first_contact = time_step * (GOLDEN * np.arange(len(collisions)) % 1.0)
    bench = head_on_bench(normal, collisions, first_contact, time_step, arch=arch, precision=precision)
    overlap, rate, force = np.moveaxis(bench.run(), 1, 0)
    bench.free()
    if missing := int(np.sum(~np.any(force != 0.0, axis=0))):
        raise GranflowError(
            f"{missing} of {len(collisions)} pairs have not touched within {len(force)} steps."
        )
    velocity = np.array([each.velocity for each in collisions])
    series = zip(overlap.T, rate.T, force.T, velocity, first_contact, strict=True)
    results = np.array([_measured(*each, time_step) for each in series]).T
    return Outcomes(*results, time_step, overlap, force)  # type: ignore[call-arg]


def head_on_bench(
    normal: Any,
    collisions: Sequence[HeadOnCollision],
    first_contact: np.ndarray,
    time_step: Any,
    *,
    arch: str = "cpu",
    precision: str = "f64",
    threads: int | None = None,
    contact_x: float = 0.0,
    velocity_max: float | None = None,
    numerics: Mapping[str, Any] | None = None,
) -> CollisionBench:
    """Bench with all collisions; `first_contact` (n,): times of first contact [s].

    `time_step` [s] or "auto". The plan assumes `velocity_max` [m/s], by default the largest velocity. Other
    arguments as for CollisionBench.
    """
    names = {key: f"m{number}" for number, key in enumerate(dict.fromkeys(each.key for each in collisions))}
    by_name = {names[each.key]: each for each in collisions}
    return CollisionBench(
        materials={name: each.material for name, each in by_name.items()},
        pairs={f"{name}-{name}": _pair(each.restitution) for name, each in by_name.items()},
        contact={"normal": normal},
        collisions=[
            Collision(
                name := names[each.key],
                name,
                0.5 * each.diameter,
                0.5 * each.diameter,
                each.velocity,
                first_contact=float(time),
            )
            for each, time in zip(collisions, first_contact, strict=True)
        ],
        run={
            "duration": min(duration_given(each.diameter, each.velocity) for each in collisions),
            "time_step": time_step,
            "precision": precision,
            "velocity_max": velocity_max or max(each.velocity for each in collisions),
        },
        numerics=numerics or {},
        contact_x=contact_x,
        arch=arch,
        threads=threads,
    )


def _pair(restitution: Any) -> dict[str, Any]:
    """Entry of `pairs`; without restitution if the contact model derives it from the materials."""
    return {"friction": 0} | ({} if restitution is None else {"restitution": restitution})


def _measured(
    overlap: np.ndarray,
    rate: np.ndarray,
    force: np.ndarray,
    velocity: float,
    first_contact: float,
    time_step: float,
) -> tuple[float, ...]:
    """Results of `Outcomes` for one pair, in their order, from its time series.

    `overlap` [m], `rate` [m/s], `force` [N] (steps,); `velocity` [m/s]; `first_contact`, `time_step` [s].
    """
    peak = int(np.argmax(overlap))
    last = int(np.flatnonzero(force)[-1])
    work = 0.5 * float((force[1 : peak + 1] + force[:peak]) @ np.diff(overlap[: peak + 1]))
    extremes = (float(force.max()), work)
    if last + 1 == len(force):
        return 0.0, np.nan, float(overlap[peak]), float(overlap[last]), *extremes
    share = share_to_end(force[last - 3 : last + 1], overlap[last : last + 2])
    duration = (last + share) * time_step - first_contact
    residual = overlap[last] + share * (overlap[last + 1] - overlap[last])
    return float(-rate[last + 1] / velocity), duration, float(overlap[peak]), residual, *extremes


def share_to_end(force: np.ndarray, overlap: np.ndarray) -> float:
    """Fraction s of a step from the last force to the time at which the force vanishes; may be negative.

    Extrapolates the three forces before the last with F = a t + b t^1.5 at the times t = s + 1, s + 2, s + 3
    before the end: exact for a linear spring, a Hertz contact, and their sum. The last force may be a mean
    over a step that extends beyond the end. A contact under tension ends at zero overlap.

    `force` (FORCES_TO_END,) [N]: last forces; `overlap` (2,) [m]: at the last force and one step later.
    """
    from scipy.optimize import brentq

    if force[-1] < 0.0:
        return float(np.clip(overlap[0] / (overlap[0] - overlap[1]), 0.0, 1.0))
    if not (len(force) == FORCES_TO_END and force[0] > force[1] > force[2]):
        return 0.0

    def mismatch(share: float) -> float:
        times = share + np.array([3.0, 2.0, 1.0])
        return float(np.linalg.det(np.stack([force[:3], times, times**1.5])))

    if mismatch(EARLIEST_END) * mismatch(LATEST_END) > 0.0:
        return LATEST_END
    return float(brentq(mismatch, EARLIEST_END, LATEST_END, xtol=1e-15))


# Path of one head-on collision by the reference implementation of its contact model.

SHORT = 1e-6
"""Time step of the reference integration relative to the duration; sub-step corrections are then
negligible."""
FORCE_SAMPLES = 2001
"""Points of each phase of the reference integration at which the force is evaluated."""
Impact = tuple[PairMaterial, float, float, float]
"""Arguments of contact models: pair of materials, effective radius [m] and mass [kg], approach velocity
[m/s]."""
LOADING_STEPS = 4000
"""Trapezoids of the loading work."""


def loading_path(plan: Plan, impact: Impact) -> dict[str, float]:
    """Duration from the contact model; maximum overlap and force where the loading work equals the kinetic
    energy.

        int_0^dmax F dd = M v^2 / 2

    The integral is a sum of trapezoids, LOADING_STEPS of them in the loading time at the approach velocity;
    the last one is interpolated.
    """
    (pair, radius_eff, mass_eff, velocity), law = impact, plan.law
    loading, unloading = law.phase_durations(*impact)
    constants = np.array(law.pair_constants(pair))
    history = np.zeros(max(law.history_count, 1))
    moment = loading / LOADING_STEPS
    step = velocity * moment
    overlap = 0.0
    force = 0.0
    force_before = 0.0
    energy = 0.5 * mass_eff * velocity**2
    while energy > 0.0:
        force_before = force
        overlap = overlap + step
        force, history = law.reference_force(
            constants, radius_eff, mass_eff, moment, overlap, velocity, history
        )
        energy -= 0.5 * (force_before + force) * step
    # -energy is the excess work of the last step
    overlap_max = overlap + energy / force
    force_max = force + (force - force_before) * energy / force / step
    return {
        "duration_theory": loading + unloading,
        "overlap_max_theory": overlap_max,
        "overlap_residual_theory": end_overlap(plan, impact, moment, overlap_max, history),
        "force_max_theory": force_max,
    }


def end_overlap(plan: Plan, impact: Impact, time_step: float, overlap: float, history: np.ndarray) -> float:
    """Overlap [m] at which the elastic force of a contact with this history vanishes; 0 if attractive.

    `overlap` [m]: upper end of the search; `history`: fields of the contact model.
    """
    from scipy.optimize import brentq

    constants = np.array(plan.law.pair_constants(impact[0]))

    def is_repulsive(at: float) -> float:
        force, _ = plan.law.reference_force(constants, *impact[1:3], time_step, at, 0.0, history)
        return 1.0 if force > 0.0 else -1.0

    smallest = 1e-15 * overlap
    if plan.law.attracts or is_repulsive(smallest) > 0.0:
        return 0.0
    if is_repulsive(overlap) < 0.0:
        return overlap
    return float(brentq(is_repulsive, smallest, overlap, xtol=smallest, rtol=1e-15))


def damped_path(plan: Plan, impact: Impact) -> dict[str, float]:
    """Duration [s], maximum overlap [m] and force [N] of M d'' = -F(d, d'), by the method DOP853 of scipy."""
    from scipy.integrate import solve_ivp

    pair, radius_eff, mass_eff, velocity = impact
    law = plan.law
    constants = np.array(plan.law.pair_constants(pair))
    longest = sum(law.phase_durations(*impact))

    def contact(overlap: float, rate: float, history: np.ndarray) -> tuple[float, np.ndarray]:
        return law.reference_force(constants, radius_eff, mass_eff, SHORT * longest, overlap, rate, history)

    _, history = contact(0.0, velocity, np.zeros(max(law.history_count, 1)))

    def force(overlap: float, rate: float) -> float:
        return contact(overlap, rate, history)[0] if overlap > 0.0 else 0.0

    def slope(_: float, state: np.ndarray) -> list[float]:
        return [state[1], -force(*state) / mass_eff]

    def stopped(_: float, state: np.ndarray) -> float:
        return float(state[1])

    def released(_: float, state: np.ndarray) -> float:
        return 1.0 if force(*state) > 0.0 else -1.0

    stopped.terminal = released.terminal = True  # type: ignore[attr-defined]
    released.direction = -1.0  # type: ignore[attr-defined]
    state = np.array([0.0, velocity])
    time = 0.0
    force_max = 0.0
    overlap_max = 0.0
    for event in (stopped, released):
        tolerance = {"rtol": 1e-11, "atol": 1e-14 * np.array([velocity * longest, velocity])}
        course = solve_ivp(
            slope, (time, LONGEST * longest), state, "DOP853", events=event, dense_output=True, **tolerance
        )
        path = course.sol(np.linspace(time, course.t[-1], FORCE_SAMPLES))
        force_max = max(force_max, *(force(*point) for point in path.T))
        state = course.y[:, -1]
        time = float(course.t[-1])
        overlap_max = max(overlap_max, float(course.y[0, -1]))
        _, history = contact(float(state[0]), float(state[1]), history)
    return {"duration_theory": time, "overlap_max_theory": overlap_max, "force_max_theory": force_max}


def history_along(
    plan: Plan, impact: Impact, overlap: np.ndarray, rate: np.ndarray, force: np.ndarray
) -> np.ndarray:
    """Contact history at the last force, by the reference implementation along the recorded path.

    `overlap` [m], `rate` [m/s], `force` [N] (steps,). A model without viscosity reads the rate half a step
    back.
    """
    pair, radius_eff, mass_eff, _ = impact
    law = plan.law
    time_step = plan.time_step
    constants = np.array(law.pair_constants(pair))
    history = np.zeros(max(law.history_count, 1))
    rate_seen = rate if law.rate_dependent else rate + 0.5 * time_step * force / mass_eff
    for index in np.flatnonzero(force):
        point = (overlap[index], rate_seen[index])
        _, history = law.reference_force(constants, radius_eff, mass_eff, time_step, *point, history)
    return history
