"""Tables of passages through flow meters, and the distribution of residence times.

`PassageTable` writes `passages_NAME.csv` of one flow meter, `ResidenceTimes` writes `residence_time.csv`. The
time series, which updates the flow meters, passes their passages to both.
"""

from collections.abc import Mapping, Sequence
from math import fsum, inf, nan, sqrt
from pathlib import Path
from typing import Any

import numpy as np

from granflow.fields import HOLD_UP
from granflow.io.tables import RESIDENCE_FILE, RowFile
from granflow.observers.meters import FlowCounter, Passages, StageRows, bodies_of
from granflow.scene.blocks.output import ResidenceTime
from granflow.snapshot import Snapshot

_PARTICLE = ("id", "group", "material", "diameter [m]", "mass [kg]")
_PASSAGE = ("time [s]", "direction", "residence_time [s]", *_PARTICLE)
_RESIDENCE = ("time [s]", "time_entered [s]", "residence_time [s]", *_PARTICLE)


def _rows(passages: Passages, begun: np.ndarray, names: Mapping[str, Sequence[str]]) -> list[list[Any]]:
    """Rows of passages: time [s], `begun` (k,), time since `begun` [s], and the columns of the particle.

    `begun`: [s]. `names`: of the groups and materials of the scene.
    """
    columns = (
        passages.time.tolist(),
        begun.tolist(),
        (passages.time - begun).tolist(),
        passages.id.tolist(),
        [names["group"][k] for k in passages.group.tolist()],
        [names["material"][k] for k in passages.material.tolist()],
        (2.0 * passages.radius.astype(np.float64)).tolist(),
        passages.mass.tolist(),
    )
    return [list(row) for row in zip(*columns, strict=True)]


class PassageTable:
    """Writes a row for each passage of a flow meter: time, direction (1 or -1), time since the insertion,
    particle."""

    def __init__(self, directory: Path, name: str, names: Mapping[str, Sequence[str]]) -> None:
        self.rows = RowFile(directory / f"passages_{name}.csv")
        self._names = names

    def record(self, passages: Passages | None) -> None:
        """Write the passages since the last sample; the first sample has none."""
        if self.rows.is_empty:
            self.rows.write(_PASSAGE)
        if passages is not None:
            for row, direction in zip(
                _rows(passages, passages.insertion_time, self._names),
                passages.direction.tolist(),
                strict=True,
            ):
                self.rows.write([row[0], direction, *row[2:]])


class ResidenceTimes:
    """Times from the insertion or the first passage of a flow meter to the first passage of another one.

    Each particle counts once. A particle that passes `from` backward has not entered; one that passes it
    again after `to` enters again.

    given:     key `output.residence_time`
    names:     of the groups and materials of the scene
    begins_at: name of the flow meter `from`; None if the insertion begins the time
    directory: of `residence_time.csv`; None: no file
    """

    def __init__(
        self,
        given: ResidenceTime,
        names: Mapping[str, Sequence[str]],
        begins_at: str | None,
        directory: Path | None,
    ) -> None:
        self.to = given.to
        self.begins_at = begins_at
        self.rows = None if directory is None else RowFile(directory / RESIDENCE_FILE)
        self._names = names
        groups = given.groups if begins_at is not None or given.from_ is None else (given.from_,)
        self._groups = [k for k, name in enumerate(names["group"]) if groups is None or name in groups]
        self._between = given.entered_between or (-inf, inf)
        self._entered: dict[int, float] = {}
        self._left: set[int] = set()
        self._mass: list[float] = []
        self._time: list[float] = []
        self._residing = [0, 0.0]
        self._stage = ""
        self._before_stage = 0
        self._stage_rows = StageRows()

    def record(
        self, snapshot: Snapshot, meters: Mapping[str, FlowCounter], replaces_last: bool = False
    ) -> None:
        """Count the particles that entered and left since the last sample, and write those that left.

        `replaces_last`: the last sample, of the same stage, does not enter the means any more.
        """
        if self.rows is not None and self.rows.is_empty:
            self.rows.write(_RESIDENCE)
        if snapshot.stage != self._stage:
            self._stage, self._before_stage = snapshot.stage, len(self._time)
        out = meters[self.to].passages
        entering = out if self.begins_at is None else meters[self.begins_at].passages
        if out is not None and entering is not None:
            if self.begins_at is None:
                left, begun = self._inserted_and_left(out)
            else:
                left, begun = self._entered_and_left(entering, out)
            self._mass += left.mass.tolist()
            self._time += (left.time - begun).tolist()
            if self.rows is not None:
                for row in _rows(left, begun, self._names):
                    self.rows.write(row)
        self._residing = self._count_residing(snapshot)
        self._stage_rows.update(self._stage, self.readings(), replaces_last)

    def _counts(self, group: np.ndarray, begun: np.ndarray) -> np.ndarray:
        """Whether particles (k,) of these groups that enter at `begun` [s] count."""
        first, last = self._between
        return np.asarray(np.isin(group, self._groups) & (begun >= first) & (begun <= last))

    def _inserted_and_left(self, out: Passages) -> tuple[Passages, np.ndarray]:
        """The first forward passages of the particles that count, and their times of insertion (k,) [s]."""
        forward = out.select((out.direction > 0) & self._counts(out.group, out.insertion_time))
        first = [k for k, number in enumerate(forward.id.tolist()) if self._is_new(number)]
        left = forward.select(np.array(first, dtype=int))
        return left, left.insertion_time

    def _is_new(self, number: int) -> bool:
        """Whether a particle leaves for the first time; it counts as having left from now on."""
        is_new = number not in self._left
        self._left.add(number)
        return is_new

    def _entered_and_left(self, entering: Passages, out: Passages) -> tuple[Passages, np.ndarray]:
        """The passages of `to` that end a residence, and the times (k,) [s] of the passages of `from`."""
        events = sorted(
            (time, leaves, k)
            for leaves, passages in ((False, entering), (True, out))
            for k, time in enumerate(passages.time.tolist())
        )
        may_enter = self._counts(entering.group, entering.time)
        ended = []
        begun = []
        for time, leaves, k in events:
            passages = out if leaves else entering
            number = int(passages.id[k])
            forward = passages.direction[k] > 0
            if leaves:
                if forward and number in self._entered:
                    ended.append(k)
                    begun.append(self._entered.pop(number))
            elif not forward:
                self._entered.pop(number, None)
            elif may_enter[k]:
                self._entered.setdefault(number, time)
        return out.select(np.array(ended, dtype=int)), np.array(begun)

    def _count_residing(self, snapshot: Snapshot) -> list[float]:
        """Number and mass [kg] of particles present that have entered and not left; forgets those that were
        deleted."""
        particles = bodies_of(snapshot.particles)
        present = set(particles["id"].tolist())
        if self.begins_at is not None:
            self._entered = {number: time for number, time in self._entered.items() if number in present}
            resides = np.isin(particles["id"], list(self._entered))
        else:
            self._left &= present
            resides = self._counts(particles["group"], particles["insertion_time"])
            resides &= ~np.isin(particles["id"], list(self._left))
        return [int(resides.sum()), fsum(particles["mass"][resides].tolist())]

    def readings(self) -> dict[str, float]:
        """Return the numbers of HOLD_UP at the last row."""
        return dict(zip(HOLD_UP, map(float, self._residing), strict=True))

    def result(self) -> dict[str, float]:
        """Return the numbers of `RESIDENCE_QUANTITIES`; NaN for a mean or deviation without particles."""
        numbers = _numbers(np.array(self._time), np.array(self._mass))
        means = self._stage_rows.means(self._stage)
        times, masses = (np.array(each[self._before_stage :]) for each in (self._time, self._mass))
        numbers["residence_stage_mean"] = _numbers(times, masses)["residence_mean"]
        numbers |= dict(zip(HOLD_UP, self._residing, strict=True))
        return numbers | {f"{name}_mean": means.get(name, nan) for name in HOLD_UP}

    def state_dict(self) -> dict[str, Any]:
        """Return the particles that are inside, those that have left and exist, and the known times."""
        return {
            "entered_id": np.array(list(self._entered), dtype=np.int64),
            "entered_time": np.array(list(self._entered.values()), dtype=np.float64),
            "left": np.array(sorted(self._left), dtype=np.int64),
            "mass": np.array(self._mass, dtype=np.float64),
            "time": np.array(self._time, dtype=np.float64),
            "residing": self._residing,
            "stage": self._stage,
            "before_stage": self._before_stage,
            "stage_rows": self._stage_rows.state_dict(),
        }

    def load_state_dict(self, saved: dict[str, Any]) -> None:
        """Restore the state of `state_dict`."""
        entered = (saved["entered_id"].tolist(), saved["entered_time"].tolist())
        self._entered = dict(zip(*entered, strict=True))
        self._left = set(saved["left"].tolist())
        self._mass = saved["mass"].tolist()
        self._time = saved["time"].tolist()
        self._residing = saved["residing"]
        self._stage = saved["stage"]
        self._before_stage = int(saved["before_stage"])
        self._stage_rows.load_state_dict(saved["stage_rows"])


def _numbers(times: np.ndarray, masses: np.ndarray) -> dict[str, float]:
    """Number of particles, mean, deviation and tanks in series of residence times (k,) [s].

        mean = sum(m t) / sum(m),   variance = sum(m (t - mean)^2) / sum(m),   tanks = mean^2 / variance

    `masses` (k,) [kg]: weights, because E(t) dt is the fraction of the stream that needs a time between t
    and t + dt (Danckwerts 1953, Chem. Eng. Sci. 2, 1-13). NaN without particles; the number of tanks is NaN
    if the deviation is one of rounding.
    """
    if not len(times):
        return {
            "residence_count": 0,
            "residence_mean": nan,
            "residence_deviation": nan,
            "tanks_in_series": nan,
        }
    mean = float(np.average(times, weights=masses))
    variance = float(np.average((times - mean) ** 2, weights=masses))
    return {
        "residence_count": len(times),
        "residence_mean": mean,
        "residence_deviation": sqrt(variance),
        "tanks_in_series": mean**2 / variance if sqrt(variance) > 1e-9 * mean else nan,
    }
