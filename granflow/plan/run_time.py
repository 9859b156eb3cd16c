"""Run time: refuses runs with a stage shorter than a step, and runs that cannot end in a reasonable time.

The run time is a lower bound from rates that no machine exceeds, so that only probable mistakes of units
are refused. `explain` shows an estimate from typical rates.
"""

from math import ceil

from granflow.errors import SceneError
from granflow.plan.plan import Plan

MAX_STEPS_PER_SECOND = 1e6
"""Upper bound of steps per second of wall-clock time for few particles (measured on a CPU: 3e5)."""
MAX_PARTICLE_STEPS_PER_SECOND = 1e9
"""Upper bound of particle-steps per second of wall-clock time (measured on two CPU cores: 2e7)."""
WRITES_PER_SECOND = 1e4
"""Upper bound of frames, time-series rows and checkpoints per second of wall-clock time (measured: 1e3)."""
YEAR = 365.25 * 86400.0
"""Seconds per year."""
LONGEST = YEAR
"""Lower bound of the run time [s] above which a scene is refused: probably a wrong unit or exponent."""
CLOCK_STEPS = 2.0**52
"""Number of steps above which single steps no longer advance the time in double precision."""
ROUNDING = 1e-6
"""Tolerance, as a fraction of the time step, for a stage shorter than one step."""


def refuse_run_time(plan: Plan, allow_long: bool = False) -> None:
    """Raise SceneError if a stage is shorter than a step, steps do not advance the time, or the run time is
    excessive.

    `allow_long` allows an excessive run time.
    """
    _refuse_no_step(plan)
    steps = duration_of(plan) / plan.time_step
    if steps > CLOCK_STEPS:
        raise SceneError(
            f"{_steps_text(plan, steps)}, more than the {CLOCK_STEPS:.2g} that time in f64 resolves."
        )
    seconds = least_run_time(plan)
    if seconds > LONGEST and not allow_long:
        steps = duration_of(plan) / plan.longest_time_step
        years = f"{seconds / YEAR:.3g}"
        raise SceneError(
            f"{_steps_text(plan, steps)}. With a particle count of {plan.particle_capacity} and "
            f"{_writes(plan):.3g} frames, rows and checkpoints, the run would take at least {years} "
            f"{'year' if years == '1' else 'years'}. Check the units of durations, intervals, sizes, "
            "densities and moduli, or allow it with --allow-long."
        )


def _refuse_no_step(plan: Plan) -> None:
    """Raise SceneError for the first stage that is shorter than one time step."""
    step = plan.time_step
    for stage in plan.stages:
        if stage.longest < step * (1.0 - ROUNDING):
            enough = float(f"{1.05 * step:.2g}")  # two digits, and not below the step
            raise SceneError(
                f"{stage.source}: {stage.key} is {stage.longest:.3g} s, shorter than one time step of "
                f"{step:.3g} s ({plan.step.limited_by}). Set it to at least {enough:.3g} s, or lower "
                "run.time_step."
            )


def least_run_time(plan: Plan) -> float:
    """Lower bound of the wall-clock time [s] of a run, from upper bounds of all rates.

        t = max(N / MAX_STEPS_PER_SECOND, N P / MAX_PARTICLE_STEPS_PER_SECOND) + W / WRITES_PER_SECOND

    N: steps of the longest possible duration, P: particles, W: frames, rows and checkpoints.
    """
    steps = duration_of(plan) / plan.longest_time_step
    of_steps = steps / MAX_STEPS_PER_SECOND
    of_particles = steps * plan.particle_capacity / MAX_PARTICLE_STEPS_PER_SECOND
    return max(of_steps, of_particles) + _writes(plan) / WRITES_PER_SECOND


def duration_of(plan: Plan) -> float:
    """Longest simulated time [s] of all stages."""
    return sum(stage.longest for stage in plan.stages)


def _writes(plan: Plan) -> float:
    """Number of frames, rows and checkpoints at intervals of simulated time: at most one of each per step."""
    output = plan.output
    duration = duration_of(plan)
    intervals = (output.interval, output.timeseries_interval, output.checkpoint.interval)
    steps = duration / plan.longest_time_step
    return sum(min(duration / interval, steps) for interval in intervals if interval is not None)


def _steps_text(plan: Plan, steps: float) -> str:
    """Location and number of the steps, and the reason for their length."""
    return (
        f"{plan.sources['steps']}: {duration_of(plan):.3g} s in time steps of {plan.time_step:.3g} s "
        f"({plan.step.limited_by}) are {float(ceil(steps)):.3g} steps"
    )
