"""Totals of a snapshot, and the energy budget."""

from collections.abc import Mapping

from granflow.engine.accounting import Accounting, energy_input
from granflow.engine.exact_sums import SHARES, chunk_words, exact_totals
from granflow.engine.force.contact_statistics import LIQUID_SUMS
from granflow.engine.particle_sums import ParticleSums
from granflow.engine.state import State
from granflow.engine.wall_dynamics import controlled_totals, controlled_work
from granflow.plan.chunk_sums import LOSSES, PLASTIC

LARGEST_ERROR = 5e-3
"""Magnitude of the energy error above which a run warns."""

ROUNDING = {"f64": 1e-9, "mixed": 1e-6, "f32": 1e-5}
"""Rounding error of the energy budget, relative to its potential energies, by precision.

It results from the masses; in f32 also from the positions.
"""


def totals_of(
    state: State,
    accounting: Accounting,
    sums: ParticleSums,
    measured: Mapping[str, float],
) -> dict[str, float]:
    """Totals of the present state by name, SI units.

    sums:      sums over the particles
    measured:  totals of ContactStatistics
    """
    contacts, energies, plan = measured["contact_count"], sums.energies, state.plan
    totals = {
        "particle_count": float(sums.count),
        "inserted_count": float(accounting.inserted_count),
        "deleted_count": float(accounting.deleted_count),
        "deleted_mass": accounting.deleted_mass,
        "contact_count": contacts,
        "kinetic_energy": energies[0],
        "rotational_energy": energies[1],
        "overlap_mean": measured["overlap_sum"] / contacts if contacts else 0.0,
        "overlap_largest": measured["overlap_largest"],
        "coordination_number": sums.coordination_number,
    }
    if plan.features.liquid_transfer:
        totals |= {name: measured[name] for name in LIQUID_SUMS}
    if plan.features.walls:
        totals["wall_contact_count"] = sums.wall_contact_count
    if plan.features.lees_edwards:
        totals["shear_strain"] = plan.periodic_box.strain(state.clock.time)
    if accounting.queued_count is not None:
        totals["queued_count"] = float(accounting.queued_count)
    for name, (outlet_count, outlet_mass) in accounting.outlets.items():
        totals |= {f"outlet_count.{name}": outlet_count, f"outlet_mass.{name}": outlet_mass}
    if plan.features.energy_budget:
        totals |= energy_budget_totals(state, accounting, energies, measured)
    return totals | controlled_totals(state)


def ended_contacts_dissipation(state: State) -> float:
    """Plastic dissipation [J] of all ended contacts; 0 without the energy budget."""
    losses = state.control.losses
    if losses is None:
        return 0.0
    return float(
        exact_totals(state.ranks.total(chunk_words(state, losses)), state.plan.sum_units.energy / SHARES)[PLASTIC]
    )


def energy_budget_totals(
    state: State, accounting: Accounting, energies: tuple[float, float, float], measured: Mapping[str, float]
) -> dict[str, float]:
    """The energy budget [J], and its error: the residual over the largest energy input of all observations and now.

        residual = K + U + E_elastic + E_dissipated + E_deleted - E_inserted - W
        energy_error = residual / max(E_in so far and now, rounding / LARGEST_ERROR)

    energies:  kinetic, rotational and gravitational energy [J]
    measured:  totals of ContactStatistics
    Returns:   totals by the names of TOTAL_QUANTITIES

    The scale is the largest E_in, because the present E_in can be zero: a bouncing sphere at its highest point has
    returned all of it. If E_in is below the rounding error of the potential energies, the rounding error is the scale,
    so that rounding does not count as an energy error.
    """
    unit = state.plan.sum_units.energy / SHARES
    words = state.ranks.total(chunk_words(state, state.control.losses))
    losses = dict(zip(LOSSES, exact_totals(words, unit).tolist(), strict=True))
    losses["plastic_dissipation"] += measured["plastic_dissipation"]
    losses["wall_work"] += controlled_work(state)
    if state.control.wall_work_ahead is not None:
        ahead = state.ranks.total(chunk_words(state, state.control.wall_work_ahead))
        losses["wall_work"] -= float(exact_totals(ahead, unit)[0])
    sums = {"boundary_work": state.control.boundary_work, "external_work": state.control.external_work}
    other_works = {
        name: float(exact_totals(state.ranks.total(chunk_words(state, each)), unit)[0])
        for name, each in sums.items()
        if each is not None
    }
    works = (losses["wall_work"], *other_works.values())
    dissipated = sum(losses[name] for name in LOSSES if name != "wall_work")
    present_energy = sum(energies) + measured["elastic_energy"]
    removed = accounting.removed_energy - accounting.inserted_energy
    residual = present_energy + dissipated + removed - sum(works)
    rounding = ROUNDING[state.backend.precision] * (abs(energies[2]) + abs(removed))
    energy_put_in = max(accounting.energy_put_in, energy_input(accounting, energies[2], works))
    scale = max(energy_put_in, rounding / LARGEST_ERROR)
    return {
        "gravitational_energy": energies[2],
        "elastic_energy": measured["elastic_energy"],
        **losses,
        **other_works,
        "removed_energy": removed,
        "energy_error": residual / scale if scale > 0.0 else 0.0,
    }
