"""Head-on collisions of equal spheres, recorded at each step: restitution, duration, overlap, force and energy."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from granflow import GranflowError
from granflow.studies.collision_bench import (
    EARLIEST_END,
    FORCES_TO_END,
    GOLDEN,
    LATEST_END,
    Collision,
    CollisionBench,
    duration_given,
)


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
    def key(self) -> str:
        """Equal for collisions of the same materials."""
        return json.dumps([dict(self.material), self.restitution], sort_keys=True)


@dataclass(frozen=True)
class Outcomes:
    """Results of n collisions (n,), and their time series (steps, n), in the order of the collisions.

    A collision begins at first contact and ends when the force vanishes; both times are interpolated within a step.
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


def collide_all(
    normal: Any, collisions: Sequence[HeadOnCollision], time_step: float, arch: str = "cpu", precision: str = "f64"
) -> Outcomes:
    """Simulate all collisions in one scene with the many-particle kernels.

    `normal` is the entry `contact.normal` of the scene. First contacts are evenly distributed over the phases of a
    step. There is no friction.

    Raises SceneError if the contact model or the time step [s] is not suitable, GranflowError if pairs never touch.
    """
    first_contact = time_step * (GOLDEN * np.arange(len(collisions)) % 1.0)
    bench = head_on_bench(normal, collisions, first_contact, time_step, arch=arch, precision=precision)
    overlap, rate, force = np.moveaxis(bench.run(), 1, 0)
    bench.free()
    if missing := int(np.sum(~np.any(force != 0.0, axis=0))):
        raise GranflowError(f"{missing} of {len(collisions)} pairs have not touched within {len(force)} steps.")
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

    `time_step` [s] or "auto". The plan assumes `velocity_max` [m/s], by default the largest velocity. Other arguments
    as for CollisionBench.
    """
    names = {key: f"m{number}" for number, key in enumerate(dict.fromkeys(each.key for each in collisions))}
    by_name = {names[each.key]: each for each in collisions}
    return CollisionBench(
        materials={name: each.material for name, each in by_name.items()},
        pairs={f"{name}-{name}": _pair(each.restitution) for name, each in by_name.items()},
        contact={"normal": normal},
        collisions=[
            Collision(name := names[each.key], name, 0.5 * each.diameter, 0.5 * each.diameter, each.velocity,
                      first_contact=float(time))
            for each, time in zip(collisions, first_contact, strict=True)
        ],
        run={
            "duration": min(duration_given(each.diameter, each.velocity) for each in collisions),
            "time_step": time_step, "precision": precision,
            "velocity_max": velocity_max or max(each.velocity for each in collisions),
        },
        numerics=numerics or {}, contact_x=contact_x, arch=arch, threads=threads,
    )  # fmt: skip


def _pair(restitution: Any) -> dict[str, Any]:
    """Entry of `pairs`; without restitution if the contact model derives it from the materials."""
    return {"friction": 0} | ({} if restitution is None else {"restitution": restitution})


def _measured(
    overlap: np.ndarray, rate: np.ndarray, force: np.ndarray, velocity: float, first_contact: float, time_step: float
) -> tuple[float, ...]:
    """Results of `Outcomes` for one pair, in their order, from its time series.

    `overlap` [m], `rate` [m/s], `force` [N] (steps,); `velocity` [m/s]; `first_contact`, `time_step` [s].
    """
    peak, last = int(np.argmax(overlap)), int(np.flatnonzero(force)[-1])
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

    Extrapolates the three forces before the last with F = a t + b t^1.5 at the times t = s + 1, s + 2, s + 3 before
    the end: exact for a linear spring, a Hertz contact, and their sum. The last force may be a mean over a step that
    extends beyond the end. A contact under tension ends at zero overlap.

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
