"""Many independent head-on collisions in one scene, recorded at each step; pairs are far apart."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np

from granflow.engine.backend import Backend
from granflow.engine.engine import Engine
from granflow.errors import GranflowError
from granflow.particles.generate import initial_particles
from granflow.plan.pair_cases import pair_cases_of
from granflow.plan.plan import Plan, plan_for
from granflow.scene.schema.scene import LARGEST_OVERLAP, Scene

LONGEST = 40.0
"""Maximum length of a collision in units of its expected duration."""

SPACING = 4.0
"""Spacing of neighboring pairs over the largest diameter."""

GOLDEN = 0.5 * (np.sqrt(5.0) - 1.0)
"""Golden ratio; its multiples modulo 1 are evenly distributed in the unit interval."""


@dataclass(frozen=True)
class HeadOnCollision:
    """Head-on collision of two equal spheres.

    `material`, `restitution` as in a scene; `diameter` [m]; `velocity` [m/s]: approach velocity, half of it for each
    sphere.
    """

    material: Mapping[str, Any]
    restitution: Any
    diameter: float
    velocity: float

    @property
    def group(self) -> str:
        """Key that is equal for collisions that can share one group of particles."""
        return json.dumps([dict(self.material), self.restitution], sort_keys=True)


@dataclass(frozen=True)
class Outcomes:
    """Results of n collisions (n,), and their time series (steps, n), in the order of the collisions.

    A collision begins at first touch and ends when the force vanishes; both times are interpolated within a step.
    Spheres that do not separate have restitution 0 and duration nan.
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


FORCES_TO_END = 4
"""Number of final forces of a contact that determine its end."""


def collide_all(normal: Any, collisions: Sequence[HeadOnCollision], time_step: float, backend: Backend) -> Outcomes:
    """Simulate all collisions in one scene with the many-particle kernels.

    `normal` is the entry `contact.normal` of the scene. First touches are evenly distributed over the phases of a step.
    There is neither gravity nor friction.

    Raises SceneError if the contact model or the time step [s] is not suitable, GranflowError if pairs never touch.
    """
    first_contact_times = time_step * (GOLDEN * np.arange(len(collisions)) % 1.0)
    scene, pair_ids = side_by_side(normal, collisions, first_contact_times, time_step, backend.precision)
    plan = plan_for(scene, on_gpu=not backend.on_cpu)
    overlap, rate, force = _run_until_parted(Engine(plan, backend), plan, pair_ids)
    velocity = np.array([each.velocity for each in collisions])
    histories = zip(overlap.T, rate.T, force.T, velocity, first_contact_times, strict=True)
    columns = np.array([_measured(*history, time_step) for history in histories]).T
    names = ("restitution", "duration", "overlap_max", "overlap_residual", "force_max", "stored_energy")
    results = dict(zip(names, columns, strict=True))
    return Outcomes(**results, time_step=time_step, overlap=overlap, force=force)


def side_by_side(
    normal: Any,
    collisions: Sequence[HeadOnCollision],
    first_contact_times: np.ndarray,
    time_step: float,
    precision: str,
    *,
    middle: float = 0.0,
    velocity_max: float | None = None,
    numerics: Mapping[str, Any] = MappingProxyType({}),
) -> tuple[Scene, np.ndarray]:
    """Scene of all collisions, and ids of the left and right sphere of each (n, 2).

    `first_contact_times` (n,): time of first touch of each pair [s]. Contacts are at x = `middle` [m]. The plan assumes
    `velocity_max` [m/s], by default the largest velocity. `numerics` is added to that of the scene.
    """
    spacing = SPACING * max(each.diameter for each in collisions)
    side = int(np.ceil(np.sqrt(len(collisions))))
    groups: dict[str, list[int]] = {}
    for index, each in enumerate(collisions):
        groups.setdefault(each.group, []).append(index)
    materials, pairs, particles, first_ids = {}, {}, {}, np.zeros(len(collisions), dtype=int)
    placed = 0
    for number, members in enumerate(groups.values()):
        name = f"m{number}"
        materials[name] = dict(collisions[members[0]].material)
        pairs[f"{name}-{name}"] = {"restitution": collisions[members[0]].restitution, "friction": 0}
        particles[name] = {
            "material": name,
            **_spheres(members, collisions, first_contact_times, spacing, side, middle),
        }
        first_ids[members] = placed + 2 * np.arange(len(members))
        placed += 2 * len(members)
    reach = spacing * (side + 1) + abs(middle)
    scene = Scene.model_validate({
        "title": "Independent head-on collisions",
        "gravity": [0, 0, 0],
        "materials": materials,
        "pairs": pairs,
        "contact": {"normal": normal, "tangential": "none", "rolling": "none"},
        "particles": particles,
        "domain": {"min": [-reach, -spacing, -spacing], "max": [reach] * 3, "on_exit": "error"},
        "run": {
            "duration": 1.0, "time_step": time_step, "precision": precision,
            "velocity_max": velocity_max or max(each.velocity for each in collisions),
        },
        "numerics": {"max_overlap": LARGEST_OVERLAP, **numerics},
        "output": {"interval": 1.0},
    })  # fmt: skip
    return scene, np.stack([first_ids, first_ids + 1], axis=1)


def _spheres(
    members: Sequence[int],
    collisions: Sequence[HeadOnCollision],
    first_contact_times: np.ndarray,
    spacing: float,
    side: int,
    middle: float,
) -> dict[str, Any]:
    """Diameters [m], velocities [m/s] and positions [m] of the spheres of one group, alternating left and right.

    `members`: indices of the collisions; `spacing` [m] and `side`: of the square grid of pairs; `middle` [m]: contact
    point.
    """
    diameters, velocities, positions = [], [], []
    for index in members:
        each = collisions[index]
        half = 0.5 * (each.diameter + each.velocity * first_contact_times[index])
        row, column = divmod(index, side)
        for sign in (-1.0, 1.0):
            diameters.append(each.diameter)
            velocities.append([-0.5 * sign * each.velocity, 0.0, 0.0])
            positions.append([middle + sign * half, spacing * row, spacing * column])
    return {
        "diameter": diameters, "velocity": velocities, "insert": {"kind": "positions", "positions": positions}
    }  # fmt: skip


def _run_until_parted(engine: Engine, plan: Plan, pair_ids: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Run until all pairs have separated: overlap [m], overlap rate [m/s] and repulsion [N], each (steps, n).

    Pairs that have not separated after the maximum number of steps remain in the result. Raises GranflowError if pairs
    never touch.
    """
    engine.insert(initial_particles(plan.scene))
    engine.set_walls([], [])
    engine.refresh()
    histories = [sample(engine, pair_ids)]
    has_touched = np.zeros(len(pair_ids), dtype=bool)
    limit = _most_steps(plan)
    while len(histories) < limit:
        engine.advance(1)
        histories.append(sample(engine, pair_ids))
        current = histories[-1]
        has_touched |= current[2] != 0.0
        if np.all(has_touched & (current[2] == 0.0) & (current[1] < 0.0)):
            break
    engine.free()
    if not has_touched.all():
        raise GranflowError(
            f"{np.sum(~has_touched)} of {len(has_touched)} pairs have not touched within {limit} steps."
        )
    overlap, rate, force = np.moveaxis(np.array(histories), 1, 0)
    return overlap, rate, force


def _most_steps(plan: Plan) -> int:
    """Upper bound of the number of steps of the slowest possible collision: LONGEST times its duration."""
    slowest = min(float(np.abs(group.velocity).max(axis=1).min()) for group in plan.scene.particles.values())
    largest = max(plan.radius_max / pair_case.radius for pair_case in pair_cases_of(plan.scene))
    longest = max(
        sum(plan.law.phase_durations(pair_case.pair, pair_case.radius_eff, pair_case.mass_eff, 2.0 * slowest))
        for pair_case in pair_cases_of(plan.scene)
    )
    return int(LONGEST * largest * longest / plan.time_step)


def sample(engine: Engine, pair_ids: np.ndarray) -> np.ndarray:
    """Present overlap [m], overlap rate [m/s] and repulsion [N] of each pair, (3, n); negative overlaps are gaps.

    `pair_ids` (n, 2): ids of the left and right sphere. The velocities are synchronized with the positions.
    """
    arrays = engine.synchronized(("id", "position", "velocity", "force", "mass", "radius"))
    where = np.argsort(arrays["id"])
    left, right = where[pair_ids[:, 0]], where[pair_ids[:, 1]]
    position, velocity, force = (arrays[name][:, 0].astype(float) for name in ("position", "velocity", "force"))
    radius = arrays["radius"].astype(float)
    overlap = radius[left] + radius[right] - (position[right] - position[left])
    return np.array([overlap, velocity[left] - velocity[right], force[right]])


def _measured(
    overlap: np.ndarray, rate: np.ndarray, force: np.ndarray, velocity: float, first_contact: float, time_step: float
) -> tuple[float, ...]:
    """Values of `Outcomes` for one pair, from its time series.

    `overlap` [m], `rate` [m/s], `force` [N] (steps,); `velocity` [m/s]; `first_contact`, `time_step` [s].
    """
    peak = int(np.argmax(overlap))
    work = 0.5 * float((force[1 : peak + 1] + force[:peak]) @ np.diff(overlap[: peak + 1]))
    shared = (float(overlap[peak]), float(force.max()), work)
    acting = np.flatnonzero(force)
    last = int(acting[-1])
    if last + 1 == len(force):
        return 0.0, np.nan, shared[0], float(overlap[last]), *shared[1:]
    share = share_to_end(force[last - 3 : last + 1], overlap[last : last + 2])
    duration = (last + share) * time_step - first_contact
    residual = overlap[last] + share * (overlap[last + 1] - overlap[last])
    return float(-rate[last + 1] / velocity), duration, shared[0], residual, *shared[1:]


def share_to_end(force: np.ndarray, overlap: np.ndarray) -> float:
    """Fraction s of a step from the last force to the time at which the force vanishes; may be negative.

    Extrapolates the three forces before the last with F = a t + b t^1.5 at the times t = s + 1, s + 2, s + 3 before
    the end: exact for a linear spring, a Hertz contact, and their sum. The last force may be a mean over a step that
    extends beyond the end. A contact under tension ends at zero overlap.

    `force` (FORCES_TO_END,) [N]: last forces; `overlap` (2,) [m]: at the last force and one step later.
    """
    if force[-1] < 0.0:
        return float(np.clip(overlap[0] / (overlap[0] - overlap[1]), 0.0, 1.0))
    if not (len(force) == FORCES_TO_END and force[0] > force[1] > force[2]):
        return 0.0

    def mismatch(share: float) -> float:
        times = share + np.array([3.0, 2.0, 1.0])
        return float(np.linalg.det(np.stack([force[:3], times, times**1.5])))

    low, high = -0.5, 1.0
    before = np.sign(mismatch(low))
    for _ in range(40):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if np.sign(mismatch(middle)) == before else (low, middle)
    return 0.5 * (low + high)
