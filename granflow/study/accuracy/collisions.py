"""Collisions of one law side by side, run again with one time step after another, watched and timed."""

from dataclasses import dataclass, replace
from math import ceil
from time import perf_counter

import numpy as np

from granflow.device.backend import Backend
from granflow.device.engine import Engine
from granflow.plan import Plan, plan_for
from granflow.scene import Scene
from granflow.scene.generate import initial_grains
from granflow.study.accuracy.axes import (
    DISTANCE,
    PHASES,
    VELOCITIES,
    Contender,
    Integrator,
    common_duration,
    encounters_of,
    kinds_of,
    touches_of,
)
from granflow.study.accuracy.exact import freed_at
from granflow.study.paper.encounters import FORCES_TO_END, look, share_to_end, side_by_side

WATCHED_WHOLE = 200
"""Up to so many steps every one is looked at; beyond, only those around the largest overlap and the end."""
AROUND = 12
"""Steps before and after these that are looked at: an error of first order moves them by a step or so."""
OVERTIME = 1.6
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


class Bench:
    """All collisions of one law with one integrator in one scene; compiled once, run with any time step."""

    def __init__(self, contender: Contender, integrator: Integrator, backend: Backend) -> None:
        self.contender, self.integrator, self.backend = contender, integrator, backend
        self.kinds = kinds_of(contender)
        self.velocity = np.repeat([kind.velocity for kind in self.kinds], PHASES)
        _, self.plan, self.place = self._planned(FINEST)
        self.engine = Engine(self.plan, backend)
        self.engine.set_walls([], [])

    def run(self, steps: float, repeats: int = REPEATS) -> Reached:
        """Collisions of so many steps. Raises SceneError where that step is not stable."""
        scene, plan, _ = self._planned(steps)
        self._take(plan)
        numbers, course = self._watch(scene, steps)
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
        scene, place = side_by_side(
            self.contender.normal, encounters_of(self.kinds), touches_of(self.kinds, time_step), time_step,
            self.backend.precision, middle=DISTANCE, velocity_max=min(VELOCITIES),
            numerics={"skin": skin},
        )  # fmt: skip
        return scene, plan_for(scene, on_gpu=not self.backend.on_cpu), place

    def _take(self, plan: Plan) -> None:
        """Go on with another time step, which the kernels get as an argument: nothing is compiled again."""
        self.plan = replace(self.plan, step=plan.step)
        self.engine.state.clock.change(plan.time_step)

    def _start(self, scene: Scene) -> None:
        """All spheres back to where the scene has them."""
        self.engine.state.count = 0
        self.engine.insert(initial_grains(scene))
        self.engine.refresh()

    def _watch(self, scene: Scene, steps: float) -> tuple[np.ndarray, np.ndarray]:
        """Numbers of the steps looked at (looks,), and overlap [m], rate [m/s], force [N] then (looks, 3, pairs)."""
        self._start(scene)
        numbers, course, now = self._looks(steps), [], 0
        for number in numbers:
            if number > now:
                self.engine.advance(number - now)
            now = number
            course.append(look(self.engine, self.place))
        return np.array(numbers), np.array(course)

    def _looks(self, steps: float) -> list[int]:
        """After which steps to look."""
        last = ceil(OVERTIME * steps) + AROUND
        if steps <= WATCHED_WHOLE:
            return list(range(last + 1))
        duration = common_duration()
        events = {round(steps * kind.exact.peak_time / duration) for kind in self.kinds} | {round(steps)}
        near = {event + k for event in events for k in range(-AROUND, AROUND + 1)}
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
        largest = _top(overlap)
        acting = np.flatnonzero(force)
        last = int(acting[-1]) if len(acting) else 0
        if not parted or last < 3 or numbers[last + 1] - numbers[last - 3] != FORCES_TO_END:
            return restitution, np.nan, largest
        freed = freed_at(self.contender.law, self.kinds[pair // PHASES].restitution)
        if freed is None:
            end = numbers[last] + share_to_end(force[last - 3 : last + 1], overlap[last : last + 2])
        else:  # from there on it flew freely
            missed = (freed * largest - overlap[last + 1]) / -rate[last + 1]
            end = numbers[last + 1] - missed / self.plan.time_step
        touch = (pair % PHASES + 0.5) / PHASES
        return restitution, float(end - touch) * self.plan.time_step, largest


def _top(overlap: np.ndarray) -> float:
    """Largest overlap [m]: the top of the parabola through the largest seen and its neighbours."""
    index = int(np.argmax(overlap))
    if not 0 < index < len(overlap) - 1:
        return float(overlap[index])
    before, top, after = overlap[index - 1 : index + 2]
    bend = 2.0 * top - before - after
    return float(top + (after - before) ** 2 / (8.0 * bend)) if bend > 0.0 else float(top)
