"""Warning at the end of a run about particles that left the domain where none is expected to leave it."""

import logging

import numpy as np

from granflow.engine.accounting import EXIT_FACES
from granflow.engine.engine import Engine
from granflow.plan.plan import Plan
from granflow.runs.result import Result

LARGE_SHARE = 0.05
"""Fraction of the inserted particles that can leave a domain without outlets, except downward and through meters."""


def log_exits(engine: Engine, result: Result) -> None:
    """Log a warning about particles that left the domain outside the outlets; `result`: numbers of the run."""
    meters = sum(each.get("flow_count", 0.0) for each in result.flow_meters.values())
    sentence = exit_warning(engine.plan, engine.accounting.exits, engine.accounting.inserted_count, meters)
    if sentence is not None:
        logging.getLogger("granflow").warning("%s", sentence)


def exit_warning(plan: Plan, exits: dict[str, int], inserted: int, through_meters: float) -> str | None:
    """Sentence on the particles that left the domain, with the face through which most of them did; None if expected.

    With outlets, no other exit is expected. Without, particles can leave downward, as from a hopper, and as many as
    pass flow meters can leave anywhere.

    exits:           number of particles by face of the domain, outside the outlets
    inserted:        number of inserted particles
    through_meters:  number of particles that passed flow meters
    """
    total = sum(exits.values())
    sideward = total - sum(exits[face] for face in _lower_faces(plan))
    expected = 0 if plan.outlets else max(LARGE_SHARE * inserted, through_meters)
    if (total if plan.outlets else sideward) <= expected:
        return None
    most = max(exits, key=lambda face: exits[face])
    axis, end = most.split("_")
    bound = getattr(plan.domain, end)["xyz".index(axis)]
    outside = " outside the outlets" if plan.outlets else ""
    return (
        f"{total} of {inserted} particles left the domain{outside}, {exits[most]} of them through its face at "
        f"{axis} = {bound:.4g} m: they are deleted. If this is not intended, check the walls and domain.{end}; "
        "otherwise give this region an outlet."
    )


def _lower_faces(plan: Plan) -> set[str]:
    """Faces of the domain toward which gravity points."""
    signs = np.concatenate([-np.array(plan.gravity), np.array(plan.gravity)])
    return {face for face, sign in zip(EXIT_FACES, signs, strict=True) if sign > 0.0}
