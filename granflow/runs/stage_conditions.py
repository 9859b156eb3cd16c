"""Ends of stages on a quantity: the conditions of a stage, evaluated at each row of the time series."""

import logging
from collections.abc import Mapping
from dataclasses import dataclass, field
from math import inf
from typing import Any

from granflow.errors import GranflowError
from granflow.fields import unit_of
from granflow.observers.timeseries import Row
from granflow.plan.scene_parts import PlannedStage, StageCondition

ROUNDING = 1e-9
"""Relative tolerance for the rounding of times."""


@dataclass
class StageConditions:
    """Progress of the conditions of the current stage.

    since:     time [s] of the first row from which each condition is satisfied in all rows; infinite if it is not
    last_row:  time [s] of the last row, or of the start of the stage
    met:       index of the condition that ends the stage, None while it continues
    values:    last value of the quantity of each condition; NaN before the first row
    """

    since: list[float] = field(default_factory=list)
    last_row: float = 0.0
    met: int | None = None
    values: list[float] = field(default_factory=list)

    def begin(self, stage: PlannedStage, time: float) -> None:
        """Begin a stage at `time` [s]."""
        self.since, self.values = [inf] * len(stage.until), [float("nan")] * len(stage.until)
        self.last_row, self.met = time, None

    def add_row(self, stage: PlannedStage, began: float, row: Row) -> None:
        """Evaluate the conditions with a row of the time series; `began` [s]: start of the stage.

        A row whose predecessor is before `began` contains means over a part of the previous stage and does not count.
        Raises GranflowError for a quantity that the row lacks.
        """
        if self.met is not None or not stage.until or row.time_before < began * (1.0 - ROUNDING):
            return
        time = self.last_row = row.time
        for index, condition in enumerate(stage.until):
            if condition.quantity not in row.numbers:
                raise GranflowError(
                    f"{stage.source}: stages.{stage.name}.until: there is no column {condition.quantity}; the columns "
                    f"are {', '.join(row.numbers)}."
                )
            value = row.numbers[condition.quantity]
            holds = condition.is_met(value) and time >= (began + stage.shortest) * (1.0 - ROUNDING)
            self.values[index] = value
            self.since[index] = min(self.since[index], time) if holds else inf
            if holds and time - self.since[index] >= condition.hold * (1.0 - ROUNDING) and self.met is None:
                self.met = index

    def log_end(self, stage: PlannedStage, time: float) -> None:
        """Log why the stage ends at `time` [s]; a warning if none of its conditions is satisfied."""
        if self.met is not None:
            sentence = (
                f"stage {stage.name} ends at {time:.6g} s: {_statement(stage.until[self.met], self.values[self.met])}"
            )
            logging.getLogger("granflow").info("%s", sentence)
        elif stage.until:
            values = zip(stage.until, self.values, strict=True)
            logging.getLogger("granflow").warning(
                "stage %s (%s): its longest duration of %.6g s is over, but %s.",
                stage.name, stage.source, stage.longest, "; ".join(_statement(*each) for each in values),
            )  # fmt: skip

    def state_dict(self) -> dict[str, Any]:
        """Return the state for a checkpoint."""
        return {name: getattr(self, name) for name in STATE}

    def load_state_dict(self, saved: Mapping[str, Any], stage: PlannedStage, same_course: bool) -> None:
        """Restore the state; after a change of events or conditions they begin again."""
        for name in STATE:
            setattr(self, name, saved[name])
        self.since, self.values = list(self.since), list(self.values)
        if not same_course:
            self.begin(stage, self.last_row)


STATE = ("since", "last_row", "met", "values")
"""Attributes that checkpoints contain."""


def _statement(condition: StageCondition, value: float) -> str:
    unit = f" {unit_of(condition.quantity)}".rstrip()
    bounds = {"above": condition.above, "below": condition.below}
    bound = next(f"{word} {limit:.6g}{unit}" for word, limit in bounds.items() if limit is not None)
    held = f" for {condition.hold:g} s" if condition.hold else ""
    return f"{condition.quantity} is {value:.6g}{unit}, {'' if condition.is_met(value) else 'not '}{bound}{held}"
