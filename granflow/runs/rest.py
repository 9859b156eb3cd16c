"""Ends of stages at rest: low kinetic energy of particles whose weight is supported."""

import logging
from collections.abc import Mapping

from granflow.engine.engine import Engine
from granflow.engine.readings import RestState
from granflow.plan.scene_parts import PlannedStage

REST_CHECKS = 200
"""Number of checks for rest over the maximum duration of a stage with `kinetic_energy_below`."""

LARGEST_UNBALANCED = 0.2
"""Largest net force on all particles over their weight at rest. It is 1 in free fall, also at the start from rest and
at the top of a bounce, and 1 - cundall with damping. Internal forces cancel, so that vibrations of stiff contacts, with
accelerations of single particles above gravity, do not delay the end."""


def ends_at_rest(stage: PlannedStage, stage_times: Mapping[str, tuple[float, float]], engine: Engine) -> bool:
    """Whether a stage ends because its particles are at rest after its shortest duration; the end is logged.

    stage_times:  start and end [s] of the stages
    """
    if stage.kinetic_energy_below is None or not engine.reached(stage_times[stage.name][0] + stage.shortest):
        return False
    state = engine.rest_state()
    if not _is_rest(stage, state):
        return False
    logging.getLogger("granflow").info("stage %s ends at %.6g s: %s", stage.name, engine.time, _statement(stage, state))
    return True


def warn_without_rest(stage: PlannedStage, engine: Engine, insertion_is_done: bool) -> None:
    """Warn that the particles are not at rest at the end of the longest duration of a stage that requires it."""
    if stage.kinetic_energy_below is None:
        return
    state = engine.rest_state()
    pending = "" if insertion_is_done else "insertion continues; "
    if pending or not _is_rest(stage, state):
        logging.getLogger("granflow").warning(
            "stage %s (%s): its longest duration of %.6g s is over, but %s%s.",
            stage.name, stage.source, stage.longest, pending, _statement(stage, state),
        )  # fmt: skip


def _is_rest(stage: PlannedStage, state: RestState) -> bool:
    """Whether the kinetic energy is below the limit, and the walls carry the weight."""
    limit = stage.kinetic_energy_below
    return limit is not None and state.kinetic_energy < limit and state.unbalanced < LARGEST_UNBALANCED


def _statement(stage: PlannedStage, state: RestState) -> str:
    limit = stage.kinetic_energy_below
    assert limit is not None
    below = "below" if state.kinetic_energy < limit else "not below"
    return (
        f"the mean kinetic energy is {state.kinetic_energy:.3g} J, {below} {limit:.3g} J, and the net force on the "
        f"particles is {state.unbalanced:.2g} of their weight (at most {LARGEST_UNBALANCED:g})"
    )
