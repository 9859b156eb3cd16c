"""Wall forces: mean values between the rows of the time series, from accumulated impulses."""

from typing import Any

import numpy as np

from granflow.snapshot import Snapshot

NO_IMPULSE: np.ndarray = np.zeros(7)
"""Impulse (3,) [N s], angular impulse (3,) [N m s] and normal impulse [N s] before the first step."""


class WallForceMeter:
    """Force, torque and pressure of the particles on one wall, each a mean over the time between two samples.

        mean force = (J(t2) - J(t1)) / (t2 - t1),      J: accumulated impulse

    `wall`: its name; `area` [m2], None for an infinite wall, which has no pressure. Force [N] and torque [N m] are
    those of the particles on the wall; the pressure [Pa] is the normal force over the area.
    """

    def __init__(self, wall: str, area: float | None) -> None:
        self.wall, self.area = wall, area
        self._time, self._impulse = 0.0, NO_IMPULSE
        self._stage, self._stage_time, self._stage_impulse = "", 0.0, NO_IMPULSE
        self._mean = NO_IMPULSE
        self._max_force, self._max_normal_force = 0.0, 0.0
        self._time_before, self._impulse_before = 0.0, NO_IMPULSE
        self._max_force_before, self._max_normal_force_before = 0.0, 0.0

    def update(self, snapshot: Snapshot, replaces_last: bool = False) -> None:
        """Compute the means since the last sample, or since the start; reads `impulses` of the snapshot.

        `replaces_last`: since the sample before the last one, as if that had not been taken; it is of the same stage.
        """
        if replaces_last:
            self._time, self._impulse = self._time_before, self._impulse_before
            self._max_force, self._max_normal_force = self._max_force_before, self._max_normal_force_before
        self._time_before, self._impulse_before = self._time, self._impulse
        self._max_force_before, self._max_normal_force_before = self._max_force, self._max_normal_force
        time, impulse = snapshot.time, snapshot.impulses[self.wall]
        if snapshot.stage != self._stage:
            self._stage, self._stage_time, self._stage_impulse = snapshot.stage, self._time, self._impulse
        if time > self._time:
            self._mean = (impulse - self._impulse) / (time - self._time)
            self._max_force = max(self._max_force, _length(self._mean[:3]))
            self._max_normal_force = max(self._max_normal_force, float(self._mean[6]))
        self._time, self._impulse = time, impulse

    def readings(self) -> dict[str, float]:
        """Return means between the last two samples: force [N], torque [N m] and, with an area, pressure [Pa]."""
        return self._named(self._mean)

    def result(self) -> dict[str, float]:
        """Return means over the last stage, those between the last two samples, and the largest readings of the run.

        The stage begins at the last sample before it. `wall_force` [N] and `wall_torque` [N m] are magnitudes of the
        mean vectors; `wall_force_largest` [N] and `wall_pressure_largest` [Pa] are the largest means between two
        samples. Names of the values between the last two samples end with `_last`.
        """
        duration = self._time - self._stage_time
        mean = (self._impulse - self._stage_impulse) / duration if duration > 0.0 else NO_IMPULSE
        found = self._named(mean) | {"wall_force": _length(mean[:3]), "wall_torque": _length(mean[3:6])}
        found |= {f"{name}_last": value for name, value in self.readings().items()}
        found["wall_force_largest"] = self._max_force
        if self.area is not None:
            found["wall_pressure_largest"] = self._max_normal_force / self.area
        return found

    def state_dict(self) -> dict[str, Any]:
        """Return all private attributes."""
        return {name: value for name, value in vars(self).items() if name.startswith("_")}

    def load_state_dict(self, saved: dict[str, Any]) -> None:
        """Restore the state of `state_dict`."""
        vars(self).update(saved)

    def _named(self, mean: np.ndarray) -> dict[str, float]:
        """Return the components of a mean (7,) by name: force [N], torque [N m] and, with an area, pressure [Pa]."""
        quantities = ("force", "torque")
        names = [f"wall_{quantity}_{axis}" for quantity in quantities for axis in "xyz"]
        pressure = {} if self.area is None else {"wall_pressure": float(mean[6]) / self.area}
        return dict(zip(names, mean[:6].tolist(), strict=True)) | pressure


def _length(vector: np.ndarray) -> float:
    return float(np.sqrt(vector @ vector))
