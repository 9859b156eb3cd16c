"""Normal force of a contact model in one device function, for code that evaluates single contacts."""

from typing import Any

import taichi as ti

from granflow.contact.model import NormalLaw


def complete_force(law: NormalLaw) -> Any:
    """Device function that evaluates `prepare`, then `force` of a contact model.

    Returns:  ti.func (constants, radius_eff, mass_eff, time_step, overlap, overlap_rate, history) -> (normal force [N],
              its viscous part [N], history)
    """
    prepare = law.prepare or _unchanged

    @ti.func
    def complete_force_of(constants, radius_eff, mass_eff, time_step, overlap, overlap_rate, history):
        history_new = prepare(constants, radius_eff, mass_eff, time_step, overlap, overlap_rate, history)
        return law.force(constants, radius_eff, mass_eff, time_step, overlap, overlap_rate, history_new)

    return complete_force_of


@ti.func
def _unchanged(constants, radius_eff, mass_eff, time_step, overlap, overlap_rate, history):
    return history
