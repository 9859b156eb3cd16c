"""Meters of the time series: the flow through a plane, and the force on a wall.

A meter is updated with the snapshot of each row, gives its readings for the row, means since the row before,
and at the end its result for `result.json`. A row that follows the one before too early replaces it
(`replaces_last`): its means are then those since the row before that. Metrics are the third kind of meter,
see `observers.metrics`.
"""

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise, product
from math import inf, nan, sqrt
from numbers import Real
from typing import Any, NamedTuple

import numpy as np

from granflow.arguments import items_of, shown
from granflow.errors import GranflowError
from granflow.geometry.periodic_box import LinePiece, PeriodicBox
from granflow.scene.blocks.output import FLOW_BLOCKS, FlowMeter
from granflow.snapshot import Snapshot, bodies_of

# Means over stages


class StageRows:
    """Mean and largest value of each number over the rows of each stage; rows in which it is NaN do not
    count."""

    def __init__(self) -> None:
        self._stages: dict[str, dict[str, tuple[int, float, float]]] = {}
        self._before: dict[str, tuple[int, float, float]] = {}

    def update(self, stage: str, numbers: Mapping[str, float], replaces_last: bool) -> None:
        """Add a row. `replaces_last`: the row before, of the same stage, does not count."""
        if replaces_last:
            self._stages[stage] = self._before
        rows = self._stages.get(stage, {})
        self._before = rows
        added = {}
        for name, number in numbers.items():
            if number == number:
                count, total, largest = rows.get(name, (0, 0.0, -inf))
                added[name] = (count + 1, total + float(number), max(largest, float(number)))
        self._stages[stage] = rows | added

    def means(self, stage: str) -> dict[str, float]:
        """Return the means over a stage, of the numbers that have a value in one of its rows."""
        rows = self._stages.get(stage, {})
        return {name: total / count for name, (count, total, _) in rows.items()}

    def counts(self, stage: str) -> dict[str, int]:
        """Return the number of rows of a stage in which each number has a value."""
        return {name: count for name, (count, _, _) in self._stages.get(stage, {}).items()}

    def by_stage(self) -> dict[str, dict[str, float]]:
        """Return NAME_mean and NAME_largest by stage, in the order of the stages."""
        return {
            stage: {
                f"{name}_{end}": number
                for name, (count, total, largest) in rows.items()
                for end, number in (("mean", total / count), ("largest", largest))
            }
            for stage, rows in self._stages.items()
        }

    def state_dict(self) -> dict[str, Any]:
        """Return counts, sums and largest values, also without the last row."""
        return {"stages": self._stages, "before": self._before}

    def load_state_dict(self, saved: dict[str, Any]) -> None:
        """Restore the state of `state_dict`."""

        def rows(given: dict[str, Any]) -> dict[str, tuple[int, float, float]]:
            return {name: (int(count), total, largest) for name, (count, total, largest) in given.items()}

        self._stages = {stage: rows(each) for stage, each in saved["stages"].items()}
        self._before = rows(saved["before"])


# Flow through a plane


class FlowCount:
    """Net mass [kg] and number of particles so far, and the history of the mass: (time [s], stage, mass
    [kg]).

    One count per flow meter, and one more for each material or group if the meter has `group_by`. `passed`
    and `passed_before`: sums over the particles that passed forward, now and at the previous sample: their
    number, their residence times [s] and the squares of these [s2]. `crossings`: number of the passages in
    both directions, and the sum of their squared masses [kg2]. `begins`: for each stage (stages, 6) the index
    in the history of the last sample before it, and `crossings` and `passed` there.
    """

    def __init__(self) -> None:
        self.mass = 0.0
        self.count = 0
        self.history: list[tuple[float, str, float]] = []
        self.passed = np.zeros(3)
        self.passed_before = self.passed
        self.crossings: np.ndarray = np.zeros(2)
        self.begins: np.ndarray = np.zeros((0, 6))

    def add(self, passages: "Passages") -> None:
        """Count passages; the residence times are those of the forward ones."""
        self.mass += float((passages.mass * passages.direction).sum())
        self.count += int(passages.direction.sum())
        forward = (passages.time - passages.insertion_time)[passages.direction > 0]
        self.passed = self.passed + [len(forward), forward.sum(), (forward**2).sum()]
        self.crossings = self.crossings + [len(passages.mass), (passages.mass.astype(float) ** 2).sum()]

    def begin_sample(self, stage: str, replaces_last: bool) -> None:
        """Begin a sample after the last one, or in its place: residence times are those since the sample
        before."""
        if replaces_last:
            self.history.pop()
        else:
            self.passed_before = self.passed
            if not self.history or self.history[-1][1] != stage:
                begin = [max(len(self.history) - 1, 0), *self.crossings, *self.passed]
                self.begins = np.vstack([self.begins, begin])

    def end_sample(self, time: float, stage: str) -> None:
        """Add a sample of the mass, at `time` [s], to the history."""
        self.history.append((time, stage, self.mass))

    def mass_flow(self) -> float:
        """Return the mass flow rate [kg/s] between the last two samples; 0 after the first."""
        if len(self.history) < 2:
            return 0.0
        (time_before, _, mass_before), (time_now, _, mass_now) = self.history[-2:]
        return (mass_now - mass_before) / (time_now - time_before)

    def readings(self) -> dict[str, float]:
        """Return `flow_mass` [kg], `flow_count`; since the previous sample `mass_flow` [kg/s],
        `residence_time` [s]."""
        mean, _ = _mean_and_deviation(self.passed - self.passed_before)
        return self._amounts() | {"mass_flow": self.mass_flow(), "residence_time": mean}

    def result(self) -> dict[str, float]:
        """Return the final numbers: `flow_mass` [kg], `flow_count`, `mass_flow` [kg/s] from `steady_flow`,
        and its `mass_flow_error` [kg/s] from `steady_flow_error`, or from `_counting_error` if few particles
        or rows do not resolve the fluctuation.

        `mass_flow_mean`, `mass_flow_error_mean` [kg/s]: mean over the last stage, and its standard error in
        the same way. `residence_time` and `residence_time_deviation` [s]: of all particles that passed
        forward, `residence_time_mean` [s]: of those in the last stage; NaN without any.
        """
        mean, deviation = _mean_and_deviation(self.passed)
        of_stage, _ = _mean_and_deviation(self.passed - (self.begins[-1, 3:] if len(self.begins) else 0.0))
        flow, error = steady_flow(self.history), steady_flow_error(self.history)
        crossings, mass = self._steady_crossings()
        if crossings[0] < FEWEST_PASSAGES or error != error:
            error = abs(flow) * sqrt(2.0) * _counting_error(crossings, mass)
        return {
            **self._amounts(),
            "mass_flow": flow if crossings[0] >= FEWEST_OF_STEADY or not crossings[0] else nan,
            "mass_flow_error": error,
            **self._mean_flow(),
            "residence_time": mean,
            "residence_time_deviation": deviation,
            "residence_time_mean": of_stage,
        }

    def _mean_flow(self) -> dict[str, float]:
        """The mean mass flow [kg/s] over the last stage and its standard error; NaN if it has no duration."""
        found = {"mass_flow_mean": nan, "mass_flow_error_mean": nan}
        if not len(self.begins):
            return found
        rows = self.history[int(self.begins[-1, 0]) :]
        (begin, _, mass_before), (end, _, mass) = rows[0], rows[-1]
        if end <= begin:
            return found
        crossings = self.crossings - self.begins[-1, 1:3]
        flow = (mass - mass_before) / (end - begin)
        time, masses = (np.array([row[k] for row in rows]) for k in (0, 2))
        error = _block_error(begin, end, time, masses)
        if crossings[0] < FEWEST_PASSAGES or error != error:
            error = _counting_error(crossings, 1.0) / (end - begin)
        return {"mass_flow_mean": flow, "mass_flow_error_mean": error}

    def _steady_crossings(self) -> tuple[np.ndarray, float]:
        """`crossings` in the last stage with flow, and its net mass [kg]; zeros without flow."""
        now = [len(self.history) - 1, *self.crossings]
        edges = np.vstack([self.begins[:, :3], now])
        for begin, end in reversed(list(pairwise(edges))):
            mass = self.history[int(end[0])][2] - self.history[int(begin[0])][2]
            if mass != 0.0:
                return end[1:] - begin[1:], mass
        return np.zeros(2), 0.0

    def remarks(self) -> Iterator[str]:
        """Yield a sentence on a steady mean of few passages; none with more, or without any."""
        (count, squares), mass = self._steady_crossings()
        if not 0 < count < FEWEST_PASSAGES:
            return
        found = self.result()
        error = sqrt(2.0) * _counting_error(np.array([count, squares]), mass)
        passages = f"{count:.0f} passage{'s' if count > 1 else ''}"
        state = "NaN" if found["mass_flow"] != found["mass_flow"] else "uncertain"
        yield (
            f"mass_flow is {state}: the last stage with flow has {passages}, and the standard error of the "
            f"flow of its middle half, for independent passages, is {100.0 * error:.2g} % (below "
            f"{100.0 * sqrt(2.0 / FEWEST_PASSAGES):.2g} % from {FEWEST_PASSAGES} passages on). Simulate "
            "longer, or read mass_flow_mean, the mean over the last stage"
        )

    def _amounts(self) -> dict[str, float]:
        return {"flow_mass": self.mass, "flow_count": self.count}

    def state_dict(self) -> dict[str, Any]:
        """Return mass, number, history and sums of residence times."""
        return dict(vars(self))

    def load_state_dict(self, saved: dict[str, Any]) -> None:
        """Restore the state of `state_dict`."""
        self.mass = saved["mass"]
        self.count = saved["count"]
        self.passed = saved["passed"]
        self.passed_before = saved["passed_before"]
        self.crossings = saved["crossings"]
        self.begins = saved["begins"]
        self.history = [(time, stage, mass) for time, stage, mass in saved["history"]]


SAMPLED = ("id", "mass", "position", "velocity", "radius", "group", "material", "insertion_time")
"""Arrays of the particles that a flow meter reads, and of clumps those of `bodies_of`."""


@dataclass(frozen=True)
class _Sample:
    """Particles at `time` [s]: the arrays SAMPLED."""

    time: float
    particles: Mapping[str, np.ndarray]

    def passages(self, index: np.ndarray, direction: np.ndarray, time: np.ndarray) -> "Passages":
        """Passages (k,) of the particles `index` (k,) of this sample."""
        found = {name: self.particles[name][index] for name in PASSAGE_ARRAYS}
        return Passages(time=time, direction=direction, **found)


PASSAGE_ARRAYS = ("id", "mass", "radius", "group", "material", "insertion_time")
"""Arrays of the particles that a passage has."""


@dataclass(frozen=True)
class Passages:
    """Particles that passed a flow meter between two samples, in the order of time; arrays (k,).

    time, insertion_time:  [s]
    direction:             1 forward, -1 backward
    mass, radius:          [kg], [m]
    group, material:       indices in the scene
    """

    time: np.ndarray
    direction: np.ndarray
    id: np.ndarray
    mass: np.ndarray
    radius: np.ndarray
    group: np.ndarray
    material: np.ndarray
    insertion_time: np.ndarray

    def select(self, chosen: np.ndarray) -> "Passages":
        """The passages with the indices or the flags `chosen`."""
        return Passages(**{name: values[chosen] for name, values in vars(self).items()})


def joined(parts: Sequence[Passages]) -> Passages:
    """All passages in the order of time."""
    arrays = {name: np.concatenate([getattr(part, name) for part in parts]) for name in vars(parts[0])}
    return Passages(**arrays).select(np.argsort(arrays["time"], kind="stable"))


class FlowCounter:
    """Net mass and number of particles through the plane, disc or rectangle of a flow meter.

    `meter`: of the scene. `periodic_box`: None without periodic axes. `parts`: names of the materials or
    groups with separate counts, if the meter has `group_by`. `gravity`: magnitude [m/s2]. Particles are
    tracked by id between successive samples; a clump is one particle, see `bodies_of`:

    - A center that changes sides crosses where the straight line between its two positions intersects the
      plane. It counts if that point is within the disc or rectangle: forward as plus, backward as minus.
    - A particle deleted since the last sample counts as crossed if it was on the near side with its
      projection within the disc or rectangle, and could reach the plane: it was deleted before it could be
      sampled on the far side. It could if v T + g T^2 / 2 + R is at least its distance, with its velocity v
      toward the plane and the interval T of the samples. One that is deleted farther away has left otherwise.
    - The line of a particle that a stage or a program has removed since ends where it was then.
    - In a periodic box the line ends at an image, see `_crossed`, so that a wrapped particle does not count
      as backward; the images of the disc or rectangle in the box count, too.
    - A particle that is first sampled on the far side does not count.
    - The time of the passage is that at which the straight line reaches the plane; that of a deleted particle
      follows from its distance and velocity at the last sample.

    `passages`: of the last update. The interval between samples must be short enough that particles move in
    nearly straight lines.
    """

    def __init__(
        self,
        meter: FlowMeter,
        periodic_box: PeriodicBox | None = None,
        parts: Sequence[str] = (),
        gravity: float = 0.0,
    ) -> None:
        self.point = np.asarray(meter.point, dtype=np.float64)
        self.normal = np.asarray(meter.normal, dtype=np.float64) / np.linalg.norm(meter.normal)
        self.radius = np.inf if meter.radius is None else meter.radius
        self.sides = None if meter.sides is None else np.asarray(meter.sides, dtype=np.float64)
        self._periodic_box = periodic_box
        self._planes = self._images()
        self._group_by = meter.group_by
        self._gravity = gravity
        self.total = FlowCount()
        self.parts = {name: FlowCount() for name in parts}
        self.passages: Passages | None = None
        self._last: _Sample | None = None

    def flow_counts(self) -> dict[str, FlowCount]:
        """Return the total count under "", and the counts of the parts by name."""
        return {"": self.total, **self.parts}

    def update(self, snapshot: Snapshot, replaces_last: bool = False) -> None:
        """Count the particles that passed since the last sample.

        Reads the arrays SAMPLED. The first snapshot is the reference and counts nothing. `replaces_last`: the
        rates are those since the sample before the last one.
        """
        now = self._sample(snapshot)
        for flow_count in self.flow_counts().values():
            flow_count.begin_sample(snapshot.stage, replaces_last)
        self.passages = None
        if self._last is not None:
            until = self._with_removed(self._last, now, snapshot.removed)
            self.passages = joined([self._crossed(self._last, until), self._deleted(self._last, until)])
            self._count(self.passages)
        self._last = now
        for flow_count in self.flow_counts().values():
            flow_count.end_sample(snapshot.time, snapshot.stage)

    def state_dict(self) -> dict[str, Any]:
        """Return counts, histories and the last sample, with arrays (n,) and (n, 3) for the n particles
        present."""
        tallies = {name: flow_count.state_dict() for name, flow_count in self.flow_counts().items()}
        last = self._last
        sample = {} if last is None else {"time": last.time, "particles": dict(last.particles)}
        return {"tallies": tallies, "last": sample}

    def load_state_dict(self, saved: dict[str, Any]) -> None:
        """Restore the state of `state_dict`."""
        for name, flow_count in self.flow_counts().items():
            flow_count.load_state_dict(saved["tallies"][name])
        last = saved["last"]
        self._last = _Sample(last["time"], last["particles"]) if last else None

    def _sample(self, snapshot: Snapshot) -> _Sample:
        particles = bodies_of(snapshot.particles)
        return _Sample(snapshot.time, {name: particles[name] for name in SAMPLED})

    def _images(self) -> list[np.ndarray]:
        """Points (m, 3) [m] of the images of the area in the box, in one array for each plane.

        Of an infinite plane across a periodic axis that is the image in the box; any other has one.
        """
        box = self._periodic_box
        if box is None:
            return [self.point[None]]
        if self.sides is None:
            across = np.sqrt(np.maximum(1.0 - self.normal**2, 0.0))
            reach = np.where(across > 0.0, self.radius, 0.0) * np.where(across > 0.0, across, 1.0)
            low, high = self.point - reach, self.point + reach
        else:
            corners = self.point + np.array([[0, 0], [0, 1], [1, 0], [1, 1]]) @ self.sides
            low, high = corners.min(axis=0), corners.max(axis=0)
        places: list[np.ndarray] = list(self.point[:, None])
        for axis in box.axes:
            if np.isfinite(high[axis]):
                begin, width = box.low[axis], box.width[axis]
                rounding = 1e-9 * width
                numbers = np.arange(
                    np.floor((begin - high[axis]) / width), np.ceil((begin + width - low[axis]) / width) + 1.0
                )
                first, last = low[axis] + width * numbers, high[axis] + width * numbers
                inside = ((last > begin) | (first >= begin - rounding)) & (first < begin + width - rounding)
                place = (self.point[axis] + width * numbers)[inside]
                places[axis] = np.where(np.abs(place - begin) < rounding, begin, place)
        points = np.stack(np.meshgrid(*places, indexing="ij"), axis=-1).reshape(-1, 3)
        heights = np.round((points - self.point) @ self.normal / box.width.max(), 12)
        return [points[heights == height] for height in np.unique(heights)]

    def _crossed(self, last: _Sample, now: _Sample) -> Passages:
        """Passages of the particles that exist in both samples and crossed between them.

        In a periodic box, a line ends at the image nearest to where the mean of both velocities leads, and
        each of its pieces inside the box counts: it can pass the plane several times.
        """
        _, before, after = np.intersect1d(
            last.particles["id"], now.particles["id"], assume_unique=True, return_indices=True
        )
        start = last.particles["position"][before]
        end = now.particles["position"][after]
        interval = now.time - last.time
        box = self._periodic_box
        if box is None:
            pieces: Iterable[LinePiece] = [LinePiece(np.arange(len(start)), start, end, 0.0, 1.0)]
        else:
            mean_velocity = 0.5 * (last.particles["velocity"][before] + now.particles["velocity"][after])
            pieces = box.pieces(start, end, start + interval * mean_velocity)
        found = []
        for piece, images in product(pieces, self._planes):
            direction, share = self._crossing(images, piece.start, piece.end)
            fraction = piece.begin + share * (piece.until - piece.begin)
            crossed = direction != 0
            time = last.time + fraction[crossed] * interval
            found.append(now.passages(after[piece.rows[crossed]], direction[crossed], time))
        return joined(found)

    def _crossing(
        self, images: np.ndarray, start: np.ndarray, end: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Directions (n,) 1, -1 or 0 of lines from `start` to `end` (n, 3) [m] that cross a plane forward,
        backward or not, and the fraction (n,) of each line before it; `images`: of `_images`."""
        first = (start - images[0]) @ self.normal
        last = (end - images[0]) @ self.normal
        direction = (last > 0).astype(int) - (first > 0).astype(int)
        fraction = first / np.where(direction == 0, 1.0, first - last)
        point = start + fraction[:, None] * (end - start)
        return np.where(self._within(images, point), direction, 0), fraction

    def _within(self, images: np.ndarray, point: np.ndarray) -> np.ndarray:
        """Return whether points (n, 3) [m] of a plane lie in one of the images of the disc or rectangle."""
        offset = point[:, None] - images
        if self.sides is None:
            inside = np.linalg.norm(offset, axis=2) <= self.radius
        else:
            share = offset @ (self.sides / np.sum(self.sides**2, axis=1)[:, None]).T
            inside = np.logical_and(share >= 0.0, share <= 1.0).all(axis=2)
        return np.asarray(inside.any(axis=1))

    def _with_removed(self, last: _Sample, now: _Sample, removed: Mapping[str, np.ndarray]) -> _Sample:
        """The sample `now` with those particles of the last one that have been removed since, where they were
        then; `removed`: as in a snapshot."""
        if not len(removed.get("id", ())):
            return now
        _, row, found = np.intersect1d(last.particles["id"], removed["id"], return_indices=True)
        ended = {name: values[row] for name, values in last.particles.items()}
        ended["position"] = removed["position"][found]
        both = {name: np.concatenate([values, ended[name]]) for name, values in now.particles.items()}
        return _Sample(now.time, both)

    def _deleted(self, last: _Sample, now: _Sample) -> Passages:
        """Forward passages of particles in the last sample only, in front of the disc or rectangle.

        Each passed when it would have reached the plane with its velocity in the last sample; with a velocity
        away from the plane, or too low, in the middle between the samples.
        """
        particles = last.particles
        interval = now.time - last.time
        position = particles["position"]
        approach = particles["velocity"] @ self.normal
        reach = np.maximum(approach, 0.0) * interval + 0.5 * self._gravity * interval**2 + particles["radius"]
        passed: np.ndarray = np.full(len(position), np.inf)
        for images in self._planes:
            distance = (images[0] - position) @ self.normal
            foot = position + distance[:, None] * self.normal
            near = (distance >= 0) & (distance <= reach) & self._within(images, foot)
            passed = np.where(near, np.minimum(distance, passed), passed)
        deleted = ~np.isin(particles["id"], now.particles["id"], assume_unique=True)
        index = np.flatnonzero(np.isfinite(passed) & deleted)
        approach = approach[index]
        distance = passed[index]
        reaches = distance < approach * interval
        duration = np.where(reaches, distance / np.where(reaches, approach, 1.0), 0.5 * interval)
        return last.passages(index, np.ones(len(index), dtype=int), last.time + duration)

    def _count(self, passages: Passages) -> None:
        """Add passages to the counts of all particles and of the parts."""
        self.total.add(passages)
        if self._group_by is not None:
            part = getattr(passages, self._group_by)
            for number, flow_count in enumerate(self.parts.values()):
                flow_count.add(passages.select(part == number))


def _mean_and_deviation(sums: np.ndarray) -> tuple[float, float]:
    """Mean and standard deviation from the number of values, their sum and that of their squares; NaN without
    any."""
    count, total, squares = sums.tolist()
    if not count:
        return nan, nan
    mean = total / count
    return mean, sqrt(max(squares / count - mean**2, 0.0))


def steady_flow(history: Sequence[tuple[float, str, float]]) -> float:
    """Return the mass flow rate [kg/s] of the middle half of the mass in the last stage with flow.

        0.5 M / (t(3/4 M) - t(1/4 M))

    `history`: (time [s], stage, cumulative mass [kg]) in order of time. M is the mass that passed in the last
    stage whose final mass differs from its initial mass; a stage begins at the last sample of the previous
    one. t(m) is the first time at which the mass reaches m, interpolated linearly. The start and the end of
    the flow have no influence. Returns 0 without flow.

    >>> gf.steady_flow([(0.0, "run", 0.0), (1.0, "run", 0.5), (2.0, "run", 1.0)])
    0.5
    """
    window = _steady_window(history)
    return 0.0 if window is None else float(0.5 * window.passed / (window.end - window.begin))


ROWS_PER_BLOCK = 2
"""Least number of rows of the history in each part: fewer rows do not resolve the parts."""


def steady_flow_error(history: Sequence[tuple[float, str, float]]) -> float:
    """Return the standard error of `steady_flow` [kg/s] from the fluctuation of the flow in time.

        s / sqrt(n) sqrt((1 + r) / (1 - r))

    s: standard deviation of the means over n = FLOW_BLOCKS parts of equal duration of the window of
    `steady_flow`, r: correlation of neighboring parts, if it is positive (Flyvbjerg and Petersen, J.
    Chem. Phys. 91 (1989) 461, discuss block averages). It contains what fluctuates and drifts within one
    discharge, not how discharges of different packings scatter. `history`: as for `steady_flow`. NaN
    without flow, or if the window has fewer than ROWS_PER_BLOCK rows for each part.

    >>> uniform = [(0.01 * row, "run", 0.005 * row) for row in range(101)]
    >>> round(gf.steady_flow_error(uniform), 9)
    0.0
    """
    window = _steady_window(history)
    return nan if window is None else _block_error(window.begin, window.end, window.time, window.mass)


FEWEST_PASSAGES = 20
"""Passages of a stage from which the flow of its middle half has a standard error below sqrt(2 / 20) = 32 %,
and each of FLOW_BLOCKS parts of the window has one on average."""
FEWEST_OF_STEADY = 4
"""Passages of a stage below which its middle half has less than two: the time between them is no flow."""


def _counting_error(crossings: np.ndarray, mass: float) -> float:
    """Standard error of the mass of independent passages over a mass [kg]; NaN without passages.

        sqrt(sum m^2) / M

    The number of independent passages is a Poisson variable, so that the variance of their mass is the sum of
    the squared masses. That of half of the mass is half of it: sqrt(2) times this relative error. Flows that
    are more regular have a smaller error. `crossings`: number and sum of squared masses [kg2].
    """
    return sqrt(crossings[1]) / abs(mass) if crossings[0] and mass else nan


def _block_error(begin: float, end: float, time: np.ndarray, mass: np.ndarray) -> float:
    """Standard error [kg/s] of the mean flow from `begin` to `end` [s] from its fluctuation, see
    `steady_flow_error`; `time` [s], `mass` [kg] (rows,): samples."""
    if len(time) < FLOW_BLOCKS * ROWS_PER_BLOCK:
        return nan
    edges = np.linspace(begin, end, FLOW_BLOCKS + 1)
    flow = np.diff(np.interp(edges, time, mass)) / np.diff(edges)
    off = flow - flow.mean()
    variance = float(off @ off)
    if variance == 0.0:
        return 0.0
    correlation = max(float(off[1:] @ off[:-1]) / variance, 0.0)
    return float(flow.std(ddof=1) / sqrt(FLOW_BLOCKS) * sqrt((1.0 + correlation) / (1.0 - correlation)))


class _SteadyWindow(NamedTuple):
    """The middle half of the mass in the last stage with flow, from `begin` to `end` [s].

    `passed`: mass of the stage [kg]. `time` [s] and `mass` [kg]: samples (rows,) in the window, the first and
    the last interpolated at its ends.
    """

    passed: float
    begin: float
    end: float
    time: np.ndarray
    mass: np.ndarray


def _steady_window(history: Sequence[tuple[float, str, float]]) -> _SteadyWindow | None:
    """The window of `steady_flow`; None without flow. Raises GranflowError for an invalid history."""
    rows = items_of("history", history, "(time [s], stage, mass [kg])")
    for row in rows:
        if not (
            isinstance(row, tuple | list) and len(row) == 3 and all(isinstance(row[k], Real) for k in (0, 2))
        ):
            raise GranflowError(
                f"history contains {shown(row)}, but must have rows of time [s], stage, mass [kg]."
            )
    times = np.array([time for time, _, _ in rows])
    masses = np.array([mass for _, _, mass in rows])
    for first, last in reversed(_stages(rows)):
        passed = masses[last] - masses[first]
        if passed != 0:
            share = (masses[first : last + 1] - masses[first]) / passed
            begin = _first_reached(times[first : last + 1], share, 0.25)
            end = _first_reached(times[first : last + 1], share, 0.75)
            is_inside = (times > begin) & (times < end)
            ends = masses[first] + passed * np.array([0.25, 0.75])
            return _SteadyWindow(
                passed,
                begin,
                end,
                np.concatenate([[begin], times[is_inside], [end]]),
                np.concatenate([ends[:1], masses[is_inside], ends[1:]]),
            )
    return None


def _stages(history: Sequence[tuple[float, str, float]]) -> list[tuple[int, int]]:
    """Return the first and last index of each stage; the first one is the last index of the previous
    stage."""
    names = [stage for _, stage, _ in history]
    ends = [
        index for index in range(len(names)) if index + 1 == len(names) or names[index] != names[index + 1]
    ]
    return list(pairwise([0, *ends]))


def _first_reached(times: np.ndarray, share: np.ndarray, share_reached: float) -> float:
    """Return the first time [s] at which `share` reaches a value, interpolated linearly."""
    after = int(np.argmax(share >= share_reached))
    fraction = (share_reached - share[after - 1]) / (share[after] - share[after - 1])
    return float(times[after - 1] + fraction * (times[after] - times[after - 1]))


# Force on a wall

NO_IMPULSE: np.ndarray = np.zeros(8)
"""Impulse (3,) [N s], angular impulse (3,) [N m s], normal impulse [N s] and work [J] before the first
step."""


class WallForceMeter:
    """Force, torque, pressure and power of one wall, each a mean over the time between two samples.

        mean force = (J(t2) - J(t1)) / (t2 - t1),      J: accumulated impulse

    `wall`: its name; `area` [m2], None for an infinite wall, which has no pressure; `stages`: in which it is
    present, None for all. Force [N] and torque [N
    m] are those of the particles on the wall; the pressure [Pa] is the normal force over the area. The power
    [W] is that of the wall on the particles: positive if it drives them.
    """

    def __init__(self, wall: str, area: float | None, stages: Collection[str] | None = None) -> None:
        self.wall = wall
        self.area = area
        self.stages = stages
        self._time = 0.0
        self._impulse = NO_IMPULSE
        self._stage = ""
        self._stage_time = 0.0
        self._stage_impulse = NO_IMPULSE
        self._mean = NO_IMPULSE
        self._max_force = 0.0
        self._max_normal_force = 0.0
        self._max_power = 0.0
        self._time_before = 0.0
        self._impulse_before = NO_IMPULSE
        self._max_force_before = 0.0
        self._max_normal_force_before = 0.0
        self._max_power_before = 0.0

    def update(self, snapshot: Snapshot, replaces_last: bool = False) -> None:
        """Compute the means since the last sample, or since the start; reads `impulses` of the snapshot.

        `replaces_last`: since the sample before the last one, as if that had not been taken; it is of the
        same stage.
        """
        if replaces_last:
            self._time = self._time_before
            self._impulse = self._impulse_before
            self._max_force = self._max_force_before
            self._max_normal_force = self._max_normal_force_before
            self._max_power = self._max_power_before
        self._time_before = self._time
        self._impulse_before = self._impulse
        self._max_force_before = self._max_force
        self._max_normal_force_before = self._max_normal_force
        self._max_power_before = self._max_power
        time = snapshot.time
        impulse = snapshot.impulses[self.wall]
        if snapshot.stage != self._stage:
            self._stage = snapshot.stage
            self._stage_time = self._time
            self._stage_impulse = self._impulse
        if time > self._time:
            self._mean = (impulse - self._impulse) / (time - self._time)
            self._max_force = max(self._max_force, _length(self._mean[:3]))
            self._max_normal_force = max(self._max_normal_force, float(self._mean[6]))
            self._max_power = max(self._max_power, abs(float(self._mean[7])))
        self._time = time
        self._impulse = impulse

    def readings(self) -> dict[str, float]:
        """Return means between the last two samples: force [N], torque [N m], with an area pressure [Pa], and
        power [W]."""
        return self._named(self._mean)

    def result(self) -> dict[str, float]:
        """Return means over the last stage, those between the last two samples, and the largest readings of
        the run.

        The stage begins at the last sample before it; means over a stage without the wall are 0. `wall_force`
        [N] and `wall_torque` [N m] are magnitudes of the mean vectors; `wall_force_largest` [N],
        `wall_pressure_largest` [Pa] and `wall_power_largest` [W] are the largest magnitudes of means between
        two samples. Names of the values between the last two samples end with `_last`. All are NaN if no time
        is between the first and the last sample.
        """
        duration = self._time - self._stage_time
        has_wall = self.stages is None or self._stage in self.stages
        mean = (self._impulse - self._stage_impulse) / duration if has_wall and duration > 0.0 else NO_IMPULSE
        found = self._named(mean) | {"wall_force": _length(mean[:3]), "wall_torque": _length(mean[3:6])}
        found |= {f"{name}_last": value for name, value in self.readings().items()}
        found["wall_force_largest"] = self._max_force
        if self.area is not None:
            found["wall_pressure_largest"] = self._max_normal_force / self.area
        found["wall_power_largest"] = self._max_power
        return found if self._time else dict.fromkeys(found, nan)

    def state_dict(self) -> dict[str, Any]:
        """Return all private attributes."""
        return {name: value for name, value in vars(self).items() if name.startswith("_")}

    def load_state_dict(self, saved: dict[str, Any]) -> None:
        """Restore the state of `state_dict`."""
        vars(self).update(saved)

    def _named(self, mean: np.ndarray) -> dict[str, float]:
        """Return the components of a mean (8,) by name: force [N], torque [N m], with an area pressure [Pa],
        and power [W]."""
        names = [f"wall_{quantity}_{axis}" for quantity in ("force", "torque") for axis in "xyz"]
        found = dict(zip(names, mean[:6].tolist(), strict=True))
        if self.area is not None:
            found["wall_pressure"] = float(mean[6]) / self.area
        found["wall_power"] = float(mean[7])
        return found


def _length(vector: np.ndarray) -> float:
    return float(np.sqrt(vector @ vector))
