"""Simultaneous collisions under one contact model, repeated with several time steps, sampled and timed."""

from dataclasses import dataclass, replace
from math import ceil
from time import process_time

import numpy as np

from granflow import Plan, plan_for
from granflow.studies.accuracy.axes import (
    DISTANCE,
    PHASES,
    VELOCITIES,
    StudiedLaw,
    collisions_of,
    common_duration,
    first_contact_times,
    kinds_of,
)
from granflow.studies.collision_bench import FORCES_TO_END, Collision
from granflow.studies.head_on import head_on_bench, share_to_end

MAX_FULLY_SAMPLED_STEPS = 200
"""Largest number of steps per collision at which every step is sampled.

Beyond it, sampling covers the steps around the maximum overlap and the end only.
"""
SAMPLES_AROUND = 12
"""Sampled steps before and after these events: a first-order error shifts them by about one step."""
MAX_DURATIONS = 1.6
"""Largest simulated time, over the duration of a collision; a collision that lasts longer counts as unfinished."""
SKIN = 1.0
"""Skin over the smallest diameter.

No neighbor-list rebuild occurs during a collision. The skin is equal for all time steps, so that the kernels are, too.
"""
FINEST = 5000
"""Steps per collision of the initial scene; every contact model is stable at this resolution."""
REPEATS = 5
"""Number of repeated timings."""


@dataclass(frozen=True)
class CollisionResults:
    """Results of collisions with `steps` time steps per duration; arrays (kinds, phases), nan where not observed.

    `time_step` [s]; `duration` [s]; `overlap_max` [m]. `seconds` (repeats,): processor time of one collision [s], the
    total of all simultaneous collisions divided by their number.
    """

    steps: float
    time_step: float
    restitution: np.ndarray
    duration: np.ndarray
    overlap_max: np.ndarray
    seconds: np.ndarray


class AccuracyBench:
    """All collisions of one contact model in one scene; compiled once for all time steps.

    `velocity` (pairs,): approach velocities [m/s]. Call `free` after use.

    The plan assumes the largest velocity for all pairs. Here particles collide with their own kind only, each kind at
    its own velocity, and all collisions have the same duration; the plan therefore gets the smallest velocity.
    """

    def __init__(self, studied_law: StudiedLaw, precision: str = "f64", threads: int | None = None) -> None:
        self.studied_law, self.precision = studied_law, precision
        self.kinds = kinds_of(studied_law)
        self.velocity = np.repeat([kind.velocity for kind in self.kinds], PHASES)
        time_step = common_duration() / FINEST
        self.bench = head_on_bench(
            studied_law.normal, collisions_of(self.kinds), first_contact_times(self.kinds, time_step), time_step,
            precision=precision, threads=threads, contact_x=DISTANCE, velocity_max=min(VELOCITIES),
            numerics={"skin": SKIN * min(kind.diameter for kind in self.kinds)},
        )  # fmt: skip

    @property
    def plan(self) -> Plan:
        """Plan of the initial scene."""
        return self.bench.plan

    def run(self, steps: float, repeats: int = REPEATS) -> CollisionResults:
        """Run the collisions with `steps` time steps per duration, then time them `repeats` times.

        Raises SceneError if that time step is unstable.
        """
        time_step, scene = common_duration() / steps, self.bench.scene
        plan_for(scene.model_copy(update={"run": scene.run.model_copy(update={"time_step": time_step})}))
        times = first_contact_times(self.kinds, time_step)
        collisions = [
            replace(each, first_contact=float(time))
            for each, time in zip(self.bench.collisions, times, strict=True)
        ]  # fmt: skip
        numbers, samples = self._sample_contacts(collisions, time_step, steps)
        seconds = np.array([self._timed(collisions, steps) for _ in range(repeats)])
        found = [self._measured(numbers, samples[:, :, pair], pair, time_step) for pair in range(len(self.velocity))]
        restitution, duration, overlap = np.array(found).T.reshape(3, len(self.kinds), PHASES)
        return CollisionResults(steps, time_step, restitution, duration, overlap, seconds)

    def free(self) -> None:
        """Free the device memory."""
        self.bench.free()

    def _sample_contacts(
        self, collisions: list[Collision], time_step: float, steps: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Sampled steps (samples,), and overlap [m], overlap rate [m/s] and force [N] (samples, 3, pairs)."""
        self.bench.restart(collisions, time_step)
        numbers, samples, now = self._sampled_steps(steps), [], 0
        for number in numbers:
            self.bench.simulation.step(number - now)
            now = number
            samples.append(self.bench.sample())
        return np.array(numbers), np.array(samples)

    def _sampled_steps(self, steps: float) -> list[int]:
        """Numbers of steps after which the state is sampled, in ascending order.

        All steps up to MAX_FULLY_SAMPLED_STEPS per collision; else those around the maximum overlap and the end.
        """
        last = ceil(MAX_DURATIONS * steps) + SAMPLES_AROUND
        if steps <= MAX_FULLY_SAMPLED_STEPS:
            return list(range(last + 1))
        duration = common_duration()
        events = {round(steps * kind.exact.peak_time / duration) for kind in self.kinds} | {round(steps)}
        near = {event + k for event in events for k in range(-SAMPLES_AROUND, SAMPLES_AROUND + 1)}
        return sorted({0, *near, last})

    def _timed(self, collisions: list[Collision], steps: float) -> float:
        """Processor time of one collision [s]: that of all simultaneous collisions, divided by their number."""
        self.bench.restart(collisions)
        whole = ceil(steps) + 1
        began = process_time()
        self.bench.simulation.step(whole)
        return (process_time() - began) * steps / whole / len(self.velocity)

    def _measured(
        self, numbers: np.ndarray, samples: np.ndarray, pair: int, time_step: float
    ) -> tuple[float, float, float]:
        """Restitution, duration [s] and maximum overlap [m] of one pair; e = 0 for a pair that has not separated.

        `numbers` (samples,): step numbers; `samples` (samples, 3): overlap [m], overlap rate [m/s], force [N]. The
        duration is nan if the steps at the end were not sampled.
        """
        overlap, rate, force = samples.T
        parted = force[-1] == 0.0 and rate[-1] < 0.0
        restitution = float(-rate[-1] / self.velocity[pair]) if parted else 0.0
        largest = _parabola_max(overlap)
        acting = np.flatnonzero(force)
        last = int(acting[-1]) if len(acting) else 0
        if not parted or last < 3 or numbers[last + 1] - numbers[last - 3] != FORCES_TO_END:
            return restitution, np.nan, largest
        end_ratio = self.kinds[pair // PHASES].exact.end_ratio
        if end_ratio is None:
            end = numbers[last] + share_to_end(force[last - 3 : last + 1], overlap[last : last + 2])
        else:  # free flight from this step on
            missed = (end_ratio * largest - overlap[last + 1]) / -rate[last + 1]
            end = numbers[last + 1] - missed / time_step
        first_contact = (pair % PHASES + 0.5) / PHASES
        return restitution, float(end - first_contact) * time_step, largest


def _parabola_max(overlap: np.ndarray) -> float:
    """Maximum overlap [m]: vertex of the parabola through the largest sample and its two neighbors.

    `overlap` (samples,) [m], equally spaced around the maximum; the largest sample itself at an end.
    """
    index = int(np.argmax(overlap))
    if not 0 < index < len(overlap) - 1:
        return float(overlap[index])
    before, top, after = overlap[index - 1 : index + 2]
    bend = 2.0 * top - before - after
    return float(top + (after - before) ** 2 / (8.0 * bend)) if bend > 0.0 else float(top)
