"""Liquid of wet particles: transfer between their films and the bridges of their contacts.

Only scenes with a cohesion model that transfers liquid compile these functions. Each step saves the films
(`build_save_film`); a contact that begins forms a bridge from them (`build_form_bridge`), and a bridge that
ruptures returns its liquid (`build_return_liquid`).

A bridge takes from the films as they are before the forces of the step (`liquid_film_before`), so that the
order of the contacts does not matter. All volumes are whole units, `plan.liquid_unit`: sums are exact. A pair
in two neighbor lists is evaluated in both; each changes the film of its owner only.
"""

from typing import Any

from granflow.engine.codes import ABORT_LIQUID
from granflow.engine.history import (
    IN_CONTACT,
    NO_CONTACT,
)
from granflow.engine.state import State
from granflow.engine.walls import Faces
from granflow.kernel_language import ti


def build_save_film(state: State) -> Any:
    """Device function (i): take the film of particle i as that before the forces of this step; abort if it is
    below 0.

    Writes:  liquid_film_before, abort, abort_particle
    """
    particles = state.particles
    control = state.control

    @ti.func
    def save_film(i):
        particles.liquid_film_before[i] = particles.liquid_film[i]
        if particles.liquid_film[i] < 0.0:
            ti.atomic_max(control.abort[0], ABORT_LIQUID)
            ti.atomic_min(control.abort_particle[0], particles.id[i])

    return save_film


def build_form_bridge(state: State) -> Any:
    """Device function (chunk, i, j, constants, bodies, overlap, cohesion history): that history of an
    overlapping pair.

    If the pair has no bridge and one of the films has liquid, a bridge forms. A wall has no film; the
    particle gives the share for a partner of the same radius, its mirror image. `constants`: of all slots.

    Reads:   radius, liquid_film_before
    Writes:  liquid_film
    """
    law = state.plan.laws.cohesion
    add_liquid = _build_add_liquid(state)
    taken = _build_taken(state)

    @ti.func
    def form_bridge(chunk, i, j, constants, bodies, overlap, history):
        history_new = history
        if history.bridge_volume == 0.0:
            from_first, from_partner = taken(i, j, constants.cohesion.max_bridge_volume)
            if from_first + from_partner > 0.0:
                add_liquid(chunk, i, j, -from_first, -from_partner)
                contact = ti.Struct(radius_eff=bodies.radius_eff, overlap=overlap)
                history_new = law.form(constants.cohesion, contact, history, from_first + from_partner)
        return history_new

    return form_bridge


def _build_taken(state: State) -> Any:
    """Device function (i, j, largest sum [m3]): volumes [m3] that a bridge takes from the films of i and j.

    Reads:  radius, liquid_film_before
    """
    particles = state.particles
    liquid_unit = state.parameter("liquid_unit")

    @ti.func
    def taken_from(i, radius_partner, unit):
        return whole_units(
            cap_share(particles.radius[i], radius_partner) * particles.liquid_film_before[i], unit
        )

    @ti.func
    def taken(i, j, largest):
        unit = liquid_unit()
        from_first = 0.0 * unit
        from_partner = 0.0 * unit
        if j >= 0:
            from_first = taken_from(i, particles.radius[j], unit)
            from_partner = taken_from(j, particles.radius[i], unit)
        else:
            from_first = taken_from(i, particles.radius[i], unit)
        total = from_first + from_partner
        if total > largest:
            from_first = whole_units(from_first * (largest / total), unit)
            from_partner = whole_units(from_partner * (largest / total), unit)
        return from_first, from_partner

    return taken


@ti.func
def cap_share(radius, radius_partner):
    """Share of a film in the cap of a sphere that faces its partner, 1/15 for equal spheres (Shi & McCarthy
    2008).

    [1 - sqrt(1 - R_j^2 / (R_i + R_j)^2)] / 2

    The caps of spheres that touch one sphere, and do not overlap each other, are disjoint: the sum is at most
    1.
    """
    ratio = radius_partner / (radius + radius_partner)
    return 0.5 * (1.0 - ti.sqrt(1.0 - ratio * ratio))


@ti.func
def whole_units(volume, unit):
    """A volume rounded down to units [m3]."""
    return unit * ti.floor(volume / unit)


def build_return_liquid(state: State) -> Any:
    """Device function (chunk, i, j, list index): return the liquid of a bridge that ruptures; does not clear
    it.

    Half to each particle, all to the particle at a wall.

    Reads:   history
    Writes:  liquid_film
    """
    history = state.neighbors.history
    add_liquid = _build_add_liquid(state)

    @ti.func
    def return_liquid(chunk, i, j, list_index):
        volume = history["cohesion"][list_index][0]
        if volume > 0.0:
            if j >= 0:
                volume *= 0.5
            add_liquid(chunk, i, j, volume, volume)

    return return_liquid


def _build_add_liquid(state: State) -> Any:
    """Device function (chunk, i, j, volume for i, volume for j [m3]): change the films of i, and of j in this
    chunk.

    Writes:  liquid_film
    """
    particles = state.particles
    chunk_size = state.parameter("chunk_size")

    @ti.func
    def add_liquid(chunk, i, j, volume, volume_partner):
        first = chunk * chunk_size()
        particles.liquid_film[i] = particles.liquid_film[i] + volume
        if j >= first and j < first + chunk_size():
            particles.liquid_film[j] = particles.liquid_film[j] + volume_partner

    return add_liquid


def build_prepare_films(state: State) -> Any:
    """Device function (chunk, i): what a rebuild needs before the sort, as each step in `build_save_film`.

    Bridges to walls that are no longer present return their liquid; these contacts end.

    Reads:   present of walls, neighbor lists
    Writes:  liquid_film, liquid_film_before, history, in_contact
    """
    particles = state.particles
    neighbors = state.neighbors
    walls = state.walls
    wall_of = state.built(Faces).wall_of
    names = list(state.neighbors.history)
    return_liquid = build_return_liquid(state)
    has_walls = state.plan.features.walls

    @ti.func
    def end_if_removed(chunk, i, j, list_index):
        if j < 0 and neighbors.in_contact[list_index] == IN_CONTACT:
            if walls.present[wall_of(j)] == 0:
                return_liquid(chunk, i, j, list_index)
                for name in ti.static(names):
                    neighbors.history[name][list_index] = 0.0 * neighbors.history[name][list_index]
                neighbors.in_contact[list_index] = NO_CONTACT

    @ti.func
    def prepare_films(chunk, i):
        if ti.static(has_walls):
            for list_index in range(neighbors.list_begin[i], neighbors.list_end[i]):
                end_if_removed(chunk, i, neighbors.partner[list_index], list_index)
        particles.liquid_film_before[i] = particles.liquid_film[i]

    return prepare_films
