"""Sentence on a spring from one velocity that is softer than the contacts of the scene require."""

from collections.abc import Sequence

import numpy as np

from granflow.studies.compare.collisions import CollisionSubject
from granflow.studies.compare.runs import VariantRun
from granflow.studies.compare.spring_assessment import ONE_SPRING
from granflow.studies.tables import percent

MARGIN = 1.5
"""Velocity over the reference velocity above which the spring counts as too soft: at a wall of the same material, the
overlap of an impact is that of two particles at 1.2 times the velocity."""


def soft_spring_note(runs: Sequence[VariantRun], subject: CollisionSubject | None) -> str:
    """The sentence, if the largest overlap is that of an impact above the reference velocity; otherwise "".

    The overlap is that of the first complete run without this spring. It determines a velocity by Eq. 5 of Zhou (2011):

        d / d0 = (v / v0)^(4/5)        K / K0 = (v / v0)^(2/5)        (Eq. 19)
    """
    spring = next((run for run in runs if run.variant.key == ONE_SPRING), None)
    others = [run for run in runs if run is not spring and not run.stopped]
    if spring is None or subject is None or not others:
        return ""
    overlap = float(np.nanmax(others[0].columns["overlap_largest"], initial=0.0))
    reference = subject.reference_velocity
    ratio = (overlap / (2.0 * subject.overlap_max(reference) / subject.diameter)) ** 1.25
    if ratio < MARGIN:
        return ""
    return (
        f"{spring.variant.title} is softer than the impacts of this scene require: the largest overlap with "
        f"{others[0].variant.title}, {percent(overlap)} of the radius, is that of an impact at {ratio * reference:.2g} "
        f"m/s, for which Eq. 19 gives a spring {ratio**0.4:.2g} times as stiff. Its velocity is --reference-velocity, "
        "by default a tenth of the largest expected impact velocity (run.velocity_max); in a scene it is "
        "contact.normal.stiffness.reference_velocity."
    )
