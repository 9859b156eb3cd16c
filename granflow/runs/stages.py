"""Progress of a run through its stages: how each of them ends, and warnings at its end.

`StageProgress` is the subject. A stage ends at its duration, at rest, or on a quantity: its conditions are
evaluated at each row of the time series (`StageConditions`).
"""

import logging
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from math import inf
from typing import Any

import numpy as np

from granflow.engine.deformation import box_pressures, target_pressures
from granflow.engine.engine import Engine, RestState
from granflow.engine.wall_dynamics import controlled_forces, target_forces
from granflow.errors import GranflowError
from granflow.geometry.periodic_box import AXES
from granflow.load import Scene
from granflow.observers.timeseries import Row
from granflow.plan.plan import Plan
from granflow.plan.wall_control import ControlledMotion
from granflow.plan.walls import wall_change_times, wall_motions
from granflow.scene.blocks.output import unit_of
from granflow.scene.blocks.run import Stage, StageCondition

# Warnings of servo walls and deforming boxes that are off their target when a stage ends.

SAMPLES_PER_STAGE = 100
"""Number of samples over the maximum duration of a stage."""
KEPT = 20
"""Number of last samples in the mean: the last fifth of a stage without an earlier end."""
STANDARD_ERRORS = 3.0
"""Scatter of a mean that is tolerated, in its standard errors: 0.3 % of normally distributed means exceed
it."""
TOLERANCE = 0.05
"""Deviation over the target tolerated without scatter: Hertz overlaps are then 1 - 0.95^(2/3) = 3.4 % too
small."""


@dataclass
class ControlSamples:
    """Forces of the controlled motions and pressures of a deforming box in the current stage, for the check
    of servos and target pressures at its end.

    next_sample:  time [s] of the next sample; infinite without servos and target pressures
    samples:      the last KEPT samples, each with the force [N] of every controlled motion on the particles,
                  and in a deforming box the pressure [Pa] along each axis
    """

    next_sample: float = inf
    samples: list[list[float]] = field(default_factory=list)

    def begin(self, engine: Engine, longest: float) -> None:
        """Begin a stage that lasts up to `longest` [s]."""
        has_target = any(motion.spec.follows_force for motion in engine.plan.controlled_motions)
        has_target = has_target or bool(target_pressures(engine.state))
        self.samples = []
        self.next_sample = engine.time + longest / SAMPLES_PER_STAGE if has_target else inf

    def sample_if_due(self, engine: Engine, longest: float) -> None:
        """Add a sample if its time is reached."""
        if engine.reached(self.next_sample):
            self.next_sample += longest / SAMPLES_PER_STAGE
            sample = [*controlled_forces(engine.state).tolist(), *box_pressures(engine.state).tolist()]
            self.samples = [*self.samples, sample][-KEPT:]

    def warn_at_end(self, engine: Engine, stage: str) -> None:
        """Log a warning for each servo that is active and off its target at the end of the stage, and one for
        a box that is off its target pressures."""
        if self.next_sample < inf:
            for sentence in (
                *off_target(engine, stage, self.samples),
                *box_off_target(engine, stage, self.samples),
            ):
                logging.getLogger("granflow").warning("%s", sentence)

    def state_dict(self) -> dict[str, Any]:
        """Return the state for a checkpoint."""
        return {"next_sample": self.next_sample, "samples": self.samples}

    def load_state_dict(self, saved: dict[str, Any]) -> None:
        """Restore the state of `state_dict`."""
        self.next_sample = saved["next_sample"]
        self.samples = [list(sample) for sample in saved["samples"]]


def is_off_target(target: float, reached: float, series: np.ndarray) -> bool:
    """Whether a controlled force or pressure is off its target F.

        |f - F| > tolerance  and  |<f> - F| > tolerance,     tolerance = max(0.05 |F|, 3 s / sqrt(n))

    reached:  f, at the end
    series:   last samples (n,), with the mean <f> and the standard deviation s; without one, f counts

    The second condition ignores what fluctuates about the target, the first one what reached it late in the
    stage.
    """
    values = series if len(series) else np.array([reached])
    scatter = float(values.std(ddof=1)) / np.sqrt(len(values)) if len(values) > 1 else 0.0
    tolerance = max(TOLERANCE * abs(target), STANDARD_ERRORS * scatter)
    return bool(min(abs(reached - target), abs(values.mean() - target)) > tolerance)


def off_target(engine: Engine, stage: str, samples: Sequence[Sequence[float]]) -> Iterator[str]:
    """A sentence for each servo that is active in the last step and off its target force."""
    present = engine.state.walls.present
    forces, targets = controlled_forces(engine.state), target_forces(engine.state)
    middle = np.array([engine.time - 0.5 * engine.time_step])
    for index, motion in enumerate(engine.plan.controlled_motions):
        running = engine.state.wall_motions[motion.wall][motion.motion].is_running(middle)[0]
        if not motion.spec.follows_force or not (running and present[motion.wall]):
            continue
        series = np.array([sample[index] for sample in samples])
        target = targets[index]
        if is_off_target(target, forces[index], series):
            area = motion.area_at(engine.plan.walls)
            present_area = area and area * target / motion.force
            yield _sentence(
                motion, stage, engine.time, (float(forces[index]), target), not series.any(), present_area
            )


def box_off_target(engine: Engine, stage: str, samples: Sequence[Sequence[float]]) -> Iterator[str]:
    """A sentence on the axes of a deforming box whose pressure is off the target at the end of a stage."""
    targets = target_pressures(engine.state)
    if not targets:
        return  # samples of a box without targets may have no pressures
    pressures = box_pressures(engine.state)
    series = np.array([sample[-len(AXES) :] for sample in samples]).reshape(len(samples), len(AXES))
    off = [k for k, target in targets.items() if is_off_target(target, pressures[k], series[:, k])]
    if not off:
        return
    scene = engine.plan.scene
    acting = scene.deformation_in(stage)
    assert acting is not None
    path, control = acting
    gain = engine.plan.gain_of(control)
    reached = ", ".join(f"{AXES[k]}: {pressures[k]:.3g} Pa instead of {targets[k]:.3g} Pa" for k in off)
    rate = max(gain * abs(pressures[k] - targets[k]) for k in off)
    largest = control.max_rate or 0.0
    if rate > largest:
        state, remedy = f"it deforms at max_rate, {largest:.3g} 1/s", "a higher max_rate"
    else:
        state, remedy = f"it deforms at up to {rate:.3g} 1/s, gain times the deviation", "a higher gain"
    yield (
        f"{'.'.join(map(str, path))} ({scene.where(*path)}): at the end of stage {stage} "
        f"({engine.time:.6g} s), the pressure of the box is off its target along {reached}; {state}. Give it "
        f"more time or {remedy}, or approach the target by a strain_rate in a stage before."
    )


def _sentence(
    motion: ControlledMotion,
    stage: str,
    time: float,
    forces: tuple[float, float],
    is_untouched: bool,
    area: float | None,
) -> str:
    """The warning on a servo that is off its target.

    forces:        at the end, and prescribed [N]
    is_untouched:  no force in all samples
    area:          [m2] to which a pressure refers
    """
    force, prescribed = forces
    reached, target = (
        f"{value:.3g} N ({value / area:.3g} Pa)" if area else f"{value:.3g} N" for value in forces
    )
    is_away = is_untouched and force == 0.0
    state = "does not touch the particles" if is_away else "is off its target"
    error = prescribed - force
    velocity, limit = motion.spec.approach(motion.numbers, error)
    remedy = motion.spec.remedy_off_target(motion.numbers, error, is_away)
    return (
        f"walls.{motion.name}.motion ({motion.source}): at the end of stage {stage} ({time:.6g} s), the "
        f"{motion.spec.kind} {state}: {reached} instead of {target}. It moves at {velocity:.3g} m/s, "
        f"{limit}. Give it {remedy}"
        + (", start it closer to the bed, or approach by a translation." if is_away else ".")
    )


# Ends of stages on a quantity

ROUNDING = 1e-9
"""Relative tolerance for the rounding of times."""


@dataclass
class StageConditions:
    """Progress of the conditions of the current stage.

    since:     time [s] of the first row from which each condition is satisfied in all rows; infinite if it is
               not
    last_row:  time [s] of the last row, or of the start of the stage
    met:       index of the condition that ends the stage, None while it continues
    values:    last value of the quantity of each condition; NaN before the first row
    """

    since: list[float] = field(default_factory=list)
    last_row: float = 0.0
    met: int | None = None
    values: list[float] = field(default_factory=list)

    def begin(self, stage: Stage, time: float) -> None:
        """Begin a stage at `time` [s]."""
        self.since = [inf] * len(stage.until)
        self.values = [float("nan")] * len(stage.until)
        self.last_row = time
        self.met = None

    def add_row(self, scene: Scene, stage: Stage, began: float, row: Row, time_step: float) -> None:
        """Evaluate the conditions with a row of the time series; `began` [s]: start of the stage.

        A row whose predecessor is before `began` contains means over a part of the previous stage and does
        not count. A row is up to one `time_step` [s] later than it is due; the time between the due times of
        two rows counts. Raises GranflowError for a quantity that the row lacks.
        """
        if self.met is not None or not stage.until or row.time_before < began * (1.0 - ROUNDING):
            return
        time = self.last_row = row.time
        delay = (1.0 - ROUNDING) * time_step
        for index, condition in enumerate(stage.until):
            if condition.quantity not in row.numbers:
                raise GranflowError(
                    f"{scene.end_of_stage(stage.name)[1]}: stages.{stage.name}.until: there is no column "
                    f"{condition.quantity}; the columns are {', '.join(row.numbers)}."
                )
            value = row.numbers[condition.quantity]
            holds = condition.is_met(value) and time >= began + stage.min_duration - delay
            self.values[index] = value
            self.since[index] = min(self.since[index], time) if holds else inf
            if holds and time - self.since[index] >= condition.hold - delay and self.met is None:
                self.met = index

    def log_end(self, scene: Scene, stage: Stage, time: float) -> None:
        """Log why the stage ends at `time` [s]; a warning if none of its conditions is satisfied."""
        if self.met is not None:
            sentence = (
                f"stage {stage.name} ends at {time:.6g} s: "
                f"{_statement(stage.until[self.met], self.values[self.met])}"
            )
            logging.getLogger("granflow").info("%s", sentence)
        elif stage.until:
            values = zip(stage.until, self.values, strict=True)
            logging.getLogger("granflow").warning(
                "stage %s (%s): its longest duration of %.6g s is over, but %s.",
                stage.name,
                scene.end_of_stage(stage.name)[1],
                stage.longest,
                "; ".join(_statement(*each) for each in values),
            )

    def state_dict(self) -> dict[str, Any]:
        """Return the state for a checkpoint."""
        return {name: getattr(self, name) for name in STATE}

    def load_state_dict(self, saved: Mapping[str, Any], stage: Stage, same_course: bool) -> None:
        """Restore the state; after a change of events or conditions they begin again."""
        for name in STATE:
            setattr(self, name, saved[name])
        self.since = list(self.since)
        self.values = list(self.values)
        if not same_course:
            self.begin(stage, self.last_row)


STATE = ("since", "last_row", "met", "values")
"""Attributes that checkpoints contain."""


def _statement(condition: StageCondition, value: float) -> str:
    unit = f" {unit_of(condition.quantity)}".rstrip()
    bounds = {"above": condition.above, "below": condition.below}
    bound = next(f"{word} {limit:.6g}{unit}" for word, limit in bounds.items() if limit is not None)
    held = f" for {condition.hold:g} s" if condition.hold else ""
    return (
        f"{condition.quantity} is {value:.6g}{unit}, {'' if condition.is_met(value) else 'not '}{bound}{held}"
    )


# Ends of stages at rest: low kinetic energy of particles whose weight is supported.

REST_CHECKS = 200
"""Number of checks for rest over the maximum duration of a stage with `kinetic_energy_below`."""
LARGEST_UNBALANCED = 0.2
"""Largest net force on all particles over their weight at rest. It is 1 in free fall, also at the start from
rest and at the top of a bounce, and 1 - cundall with damping. Internal forces cancel, so that vibrations of
stiff contacts, with accelerations of single particles above gravity, do not delay the end."""


def warn_without_rest(stage: Stage, engine: Engine, insertion_is_done: bool) -> None:
    """Warn that a stage that requires rest ended at its longest duration without it."""
    if stage.kinetic_energy_below is None:
        return
    state = engine.rest_state()
    pending = "" if insertion_is_done else "insertion continues; "
    if pending or not _is_rest(stage, state):
        logging.getLogger("granflow").warning(
            "stage %s (%s): its longest duration of %.6g s is over, but %s%s.",
            stage.name,
            engine.plan.scene.end_of_stage(stage.name)[1],
            stage.longest,
            pending,
            _rest_statement(stage, state),
        )


def _is_rest(stage: Stage, state: RestState) -> bool:
    """Whether the kinetic energy is below the limit, and the walls carry the weight."""
    limit = stage.kinetic_energy_below
    return limit is not None and state.kinetic_energy < limit and state.unbalanced < LARGEST_UNBALANCED


def _rest_statement(stage: Stage, state: RestState) -> str:
    limit = stage.kinetic_energy_below
    assert limit is not None
    below = "below" if state.kinetic_energy < limit else "not below"
    return (
        f"the mean kinetic energy is {state.kinetic_energy:.3g} J, {below} {limit:.3g} J, and the net force "
        f"on the particles is {state.unbalanced:.2g} of their weight (at most {LARGEST_UNBALANCED:g})"
    )


# Progress of a run through its stages.


@dataclass
class StageProgress:
    """Started and completed stages, and pending events of the current stage.

    stage:        name of the current stage
    changes:      future times [s] at which walls appear or vanish
    stage_times:  start and end [s] of the stages that have begun; the end is infinite during a stage
    next_check:   time [s] of the next check for rest; infinite without checks
    target:       time [s] to which the current steps lead, None between targets
    arrived:      whether insertion and wall changes at the target are done, so that only observers are
                  pending
    controls:     samples of servos and target pressures, checked at the end of the stage
    conditions:   conditions that end the stage
    """

    stage: str
    changes: tuple[float, ...]
    stage_times: dict[str, tuple[float, float]] = field(default_factory=dict)
    next_check: float = inf
    target: float | None = None
    arrived: bool = False
    controls: ControlSamples = field(default_factory=ControlSamples)
    conditions: StageConditions = field(default_factory=StageConditions)

    @classmethod
    def of(cls, plan: Plan) -> "StageProgress":
        """Return the progress before the first step."""
        return cls(plan.stages[0].name, wall_change_times(plan.walls))

    def begin(self, stage: Stage, time: float) -> None:
        """Begin a stage at `time` [s]."""
        self.stage = stage.name
        self.next_check = time + stage.longest / REST_CHECKS
        self.stage_times[stage.name] = (time, inf)

    def end(self, time: float) -> None:
        """End the current stage at `time` [s]."""
        self.stage_times[self.stage] = (self.stage_times[self.stage][0], time)

    def end_of(self, stage: Stage) -> float:
        """Time [s] at which a stage that has begun ends at the latest."""
        return self.stage_times[stage.name][0] + stage.longest

    def ends_at_rest(self, stage: Stage, engine: Engine, insertion_is_done: bool) -> bool:
        """Whether a check for rest is due at which the stage ends, which is logged.

        REST_CHECKS checks are distributed evenly over the longest duration. The particles must be at rest
        after the shortest duration, and all of them inserted.
        """
        if stage.kinetic_energy_below is None or not engine.reached(self.next_check):
            return False
        self.next_check += stage.longest / REST_CHECKS
        began = self.stage_times[stage.name][0]
        if not insertion_is_done or not engine.reached(began + stage.min_duration):
            return False
        state = engine.rest_state()
        if not _is_rest(stage, state):
            return False
        logging.getLogger("granflow").info(
            "stage %s ends at %.6g s: %s", stage.name, engine.time, _rest_statement(stage, state)
        )
        return True

    def has_ended(self, stage: str) -> bool:
        """Return whether the stage has ended."""
        return self.stage_times.get(stage, (0.0, inf))[1] < inf

    def set_target(self, time: float) -> None:
        """Set the target time [s] of the next steps."""
        self.target = time
        self.arrived = False

    def remove_past_changes(self, engine: Engine) -> bool:
        """Remove wall changes that are due; return whether any were removed."""
        remaining = tuple(change for change in self.changes if not engine.reached(change))
        changed = len(remaining) < len(self.changes)
        self.changes = remaining
        return changed

    def set_walls(self, engine: Engine) -> None:
        """Copy presence and motions of the walls to the device.

        Presence is that of the middle of the next step, so that a change due at the present time is included.
        """
        walls = engine.plan.walls
        middle = engine.time + 0.5 * engine.time_step
        presence = [wall.spec.is_present(self.stage, middle) for wall in walls]
        engine.set_walls(presence, wall_motions([wall.motions for wall in walls], self.stage_times))

    def state_dict(self) -> dict[str, Any]:
        """Return the state for a checkpoint."""
        return {
            "stage": self.stage,
            "stage_times": {name: list(times) for name, times in self.stage_times.items()},
            "next_check": self.next_check,
            "target": self.target,
            "arrived": self.arrived,
            "changes": list(self.changes),
            "controls": self.controls.state_dict(),
            "conditions": self.conditions.state_dict(),
        }

    def load_state_dict(
        self, saved: dict[str, Any], stages: Sequence[Stage], reopened: bool, same_course: bool
    ) -> None:
        """Restore the state.

        stages:      of the plan
        reopened:    the last stage continues even if it had ended
        same_course: False if events or conditions changed; the target is then determined again
        """
        self.stage = saved["stage"]
        self.next_check = saved["next_check"]
        self.changes = tuple(saved["changes"])
        self.controls.load_state_dict(saved["controls"])
        present = next(stage for stage in stages if stage.name == self.stage)
        self.conditions.load_state_dict(saved["conditions"], present, same_course)
        self.stage_times = {name: (start, end) for name, (start, end) in saved["stage_times"].items()}
        if reopened:
            self.stage_times[self.stage] = (self.stage_times[self.stage][0], inf)
        if same_course:
            self.target = saved["target"]
            self.arrived = saved["arrived"]
