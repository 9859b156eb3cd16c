"""A law's force in one function, for those who look at one contact at a time."""

from typing import Any

import taichi as ti

from granflow.laws.law import NormalLaw


def whole_force(law: NormalLaw) -> Any:
    """Device function with the arguments of `force`: `prepare` and `force` of one contact."""
    prepare = law.prepare or _keep

    @ti.func
    def both(constants, radius_eff, mass_eff, time_step, overlap, overlap_rate, history):
        memory = prepare(constants, radius_eff, mass_eff, time_step, overlap, overlap_rate, history)
        return law.force(constants, radius_eff, mass_eff, time_step, overlap, overlap_rate, memory)

    return both


@ti.func
def _keep(constants, radius_eff, mass_eff, time_step, overlap, overlap_rate, history):
    return history
