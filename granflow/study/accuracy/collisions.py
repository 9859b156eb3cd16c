"""Collisions of one law side by side, run again with one time step after another, watched and timed."""

from dataclasses import dataclass, replace
from math import ceil
from time import perf_counter

import numpy as np

from granflow.device.backend import Backend
from granflow.device.engine import Engine
from granflow.plan import Plan, plan_for
from granflow.scene import Scene
from granflow.scene.generate import initial_particles
from granflow.study.accuracy.axes import (
    DISTANCE,
    PHASES,
    VELOCITIES,
    Integrator,
    StudiedLaw,
    collisions_of,
    common_duration,
    first_contact_times,
    kinds_of,
)
from granflow.study.accuracy.exact import end_overlap_ratio
from granflow.study.paper.head_on_collisions import FORCES_TO_END, sample, share_to_end, side_by_side

SAMPLED_COMPLETELY = 200
"""Up to so many steps every one is looked at; beyond, only those around the largest overlap and the end."""
SAMPLES_AROUND = 12
"""Steps before and after these that are looked at: an error of first order moves them by a step or so."""
MAX_DURATIONS = 1.6
"""Collisions not over after this many of their durations are given up."""
SKIN = 1.0
"""Over the smallest diameter: no search falls into a collision; the same at every time step, as the kernels are."""
FINEST = 5000
"""Steps a collision with which the scene is made; every law is stable then."""
REPEATS = 5
"""Timings of the same work."""


@dataclass(frozen=True)
class Reached:
    """What collisions with `steps` a duration reached, each (kinds, phases); nan where it was not seen.

    `seconds` (repeats,): wall time [s] of one collision, timings of all side by side shared out.
    """

    steps: float
    time_step: float
    restitution: np.ndarray
    duration: np.ndarray
    overlap_max: np.ndarray
    seconds: np.ndarray


class CollisionBench:
    """All collisions of one law with one integrator in one scene; compiled once, run with any time step."""

    def __init__(self, studied_law: StudiedLaw, integrator: Integrator, backend: Backend) -> None:
        self.studied_law, self.integrator, self.backend = studied_law, integrator, backend
        self.kinds = kinds_of(studied_law)
        self.velocity = np.repeat([kind.velocity for kind in self.kinds], PHASES)
        _, self.plan, self.pair_ids = self._planned(FINEST)
        self.engine = Engine(self.plan, backend)
        self.engine.set_walls([], [])

    def run(self, steps: float, repeats: int = REPEATS) -> Reached:
        """Collisions of so many steps. Raises SceneError where that step is not stable."""
        scene, plan, _ = self._planned(steps)
        self._use_time_step(plan)
        numbers, course = self._sample_course(scene, steps)
        seconds = np.array([self._timed(scene, steps) for _ in range(repeats)])
        found = [self._measured(numbers, course[:, :, pair], pair) for pair in range(len(self.velocity))]
        restitution, duration, overlap = np.array(found).T.reshape(3, len(self.kinds), PHASES)
        return Reached(steps, plan.time_step, restitution, duration, overlap, seconds)

    def free(self) -> None:
        """Give the device's memory back."""
        self.engine.free()

    def _planned(self, steps: float) -> tuple[Scene, Plan, np.ndarray]:
        """The scene with a time step, its plan, and where the spheres of each pair stand in it.

        Every kind of sphere meets its own kind only, at its own speed, and all collisions last equally long: the plan,
        which reckons with the largest speed for all, is told the smallest.
        """
        time_step = common_duration() / steps
        skin = SKIN * min(kind.diameter for kind in self.kinds)
        scene, pair_ids = side_by_side(
            self.studied_law.normal, collisions_of(self.kinds), first_contact_times(self.kinds, time_step), time_step,
            self.backend.precision, middle=DISTANCE, velocity_max=min(VELOCITIES),
            numerics={"skin": skin},
        )  # fmt: skip
        return scene, plan_for(scene, on_gpu=not self.backend.on_cpu), pair_ids

    def _use_time_step(self, plan: Plan) -> None:
        """Go on with another time step, which the kernels get as an argument: nothing is compiled again."""
        self.plan = replace(self.plan, step=plan.step)
        self.engine.state.clock.change(plan.time_step)

    def _start(self, scene: Scene) -> None:
        """All spheres back to where the scene has them."""
        self.engine.state.count = 0
        self.engine.insert(initial_particles(scene))
        self.engine.refresh()

    def _sample_course(self, scene: Scene, steps: float) -> tuple[np.ndarray, np.ndarray]:
        """Numbers of the steps looked at (looks,), and overlap [m], rate [m/s], force [N] then (looks, 3, pairs)."""
        self._start(scene)
        numbers, course, now = self._sampled_steps(steps), [], 0
        for number in numbers:
            if number > now:
                self.engine.advance(number - now)
            now = number
            course.append(sample(self.engine, self.pair_ids))
        return np.array(numbers), np.array(course)

    def _sampled_steps(self, steps: float) -> list[int]:
        """After which steps to look."""
        last = ceil(MAX_DURATIONS * steps) + SAMPLES_AROUND
        if steps <= SAMPLED_COMPLETELY:
            return list(range(last + 1))
        duration = common_duration()
        events = {round(steps * kind.exact.peak_time / duration) for kind in self.kinds} | {round(steps)}
        near = {event + k for event in events for k in range(-SAMPLES_AROUND, SAMPLES_AROUND + 1)}
        return sorted({0, *near, last})

    def _timed(self, scene: Scene, steps: float) -> float:
        """Wall time [s] of one collision."""
        self._start(scene)
        whole = ceil(steps) + 1
        began = perf_counter()
        self.engine.advance(whole)
        return (perf_counter() - began) * steps / whole / len(self.velocity)

    def _measured(self, numbers: np.ndarray, course: np.ndarray, pair: int) -> tuple[float, float, float]:
        """Restitution, duration [s] and largest overlap [m] of one pair; a pair that has not parted has e = 0."""
        overlap, rate, force = course.T
        parted = force[-1] == 0.0 and rate[-1] < 0.0
        restitution = float(-rate[-1] / self.velocity[pair]) if parted else 0.0
        largest = _parabola_max(overlap)
        acting = np.flatnonzero(force)
        last = int(acting[-1]) if len(acting) else 0
        if not parted or last < 3 or numbers[last + 1] - numbers[last - 3] != FORCES_TO_END:
            return restitution, np.nan, largest
        end_ratio = end_overlap_ratio(self.studied_law.law_name, self.kinds[pair // PHASES].restitution)
        if end_ratio is None:
            end = numbers[last] + share_to_end(force[last - 3 : last + 1], overlap[last : last + 2])
        else:  # from there on it flew freely
            missed = (end_ratio * largest - overlap[last + 1]) / -rate[last + 1]
            end = numbers[last + 1] - missed / self.plan.time_step
        first_contact = (pair % PHASES + 0.5) / PHASES
        return restitution, float(end - first_contact) * self.plan.time_step, largest


def _parabola_max(overlap: np.ndarray) -> float:
    """Largest overlap [m]: the top of the parabola through the largest seen and its neighbors."""
    index = int(np.argmax(overlap))
    if not 0 < index < len(overlap) - 1:
        return float(overlap[index])
    before, top, after = overlap[index - 1 : index + 2]
    bend = 2.0 * top - before - after
    return float(top + (after - before) ** 2 / (8.0 * bend)) if bend > 0.0 else float(top)
