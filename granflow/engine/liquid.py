"""Liquid of wet particles: transfer between their films and the bridges of their contacts.

Only scenes with a cohesion model that transfers liquid compile these functions. Each step saves the films
(`LiquidFilms.save`); a contact that begins forms a bridge from them (`form_bridge`), and a bridge that
ruptures returns its liquid (`return_liquid`).

A bridge takes from the films as they are before the forces of the step (`liquid_film_before`), so that the
order of the contacts does not matter. All volumes are whole units, `plan.liquid_unit`: sums are exact. A pair
in two neighbor lists is evaluated in both; each changes the film of its owner only.
"""

from granflow.engine.codes import ABORT_LIQUID
from granflow.engine.history import IN_CONTACT, NO_CONTACT
from granflow.engine.state import State
from granflow.engine.walls import Faces
from granflow.kernel_language import ti


class LiquidFilms:
    """Films of the particles, and the bridges that contacts form from them.

    Reads:   radius, liquid_film_before, history, present of walls, neighbor lists, in_contact
    Writes:  liquid_film, liquid_film_before, history, in_contact, abort, abort_particle
    """

    def __init__(self, state: State) -> None:
        self.particles = state.particles
        self.neighbors = state.neighbors
        self.walls = state.walls
        self.control = state.control
        self.law = state.plan.laws.cohesion
        self.has_walls = state.plan.features.walls
        self.names = list(state.neighbors.history)
        self.wall_of = state.built(Faces).wall_of
        self.chunk_size = state.parameter("chunk_size")
        self.liquid_unit = state.parameter("liquid_unit")

    @ti.func
    def save(self, i):
        """Take the film of particle i as that before the forces of this step; abort if it is below 0."""
        self.particles.liquid_film_before[i] = self.particles.liquid_film[i]
        if self.particles.liquid_film[i] < 0.0:
            ti.atomic_max(self.control.abort[0], ABORT_LIQUID)
            ti.atomic_min(self.control.abort_particle[0], self.particles.id[i])

    @ti.func
    def form_bridge(self, chunk, i, j, constants, bodies, overlap, history):
        """The cohesion history of an overlapping pair: with a bridge, if one of the films has liquid.

        A wall has no film; the particle gives the share for a partner of the same radius, its mirror image.
        `constants`: of all slots.
        """
        history_new = history
        if history.bridge_volume == 0.0:
            from_first, from_partner = self._taken(i, j, constants.cohesion.max_bridge_volume)
            if from_first + from_partner > 0.0:
                self._add(chunk, i, j, -from_first, -from_partner)
                contact = ti.Struct(radius_eff=bodies.radius_eff, overlap=overlap)
                history_new = self.law.form(constants.cohesion, contact, history, from_first + from_partner)
        return history_new

    @ti.func
    def _taken(self, i, j, largest):
        """Volumes [m3] that a bridge takes from the films of i and j; `largest` [m3]: of their sum."""
        unit = self.liquid_unit()
        from_first = 0.0 * unit
        from_partner = 0.0 * unit
        if j >= 0:
            from_first = self._taken_from(i, self.particles.radius[j], unit)
            from_partner = self._taken_from(j, self.particles.radius[i], unit)
        else:
            from_first = self._taken_from(i, self.particles.radius[i], unit)
        total = from_first + from_partner
        if total > largest:
            from_first = whole_units(from_first * (largest / total), unit)
            from_partner = whole_units(from_partner * (largest / total), unit)
        return from_first, from_partner

    @ti.func
    def _taken_from(self, i, radius_partner, unit):
        share = cap_share(self.particles.radius[i], radius_partner)
        return whole_units(share * self.particles.liquid_film_before[i], unit)

    @ti.func
    def return_liquid(self, chunk, i, j, list_index):
        """Return the liquid of a bridge that ruptures; does not clear it.

        Half to each particle, all to the particle at a wall.
        """
        volume = self.neighbors.history["cohesion"][list_index][0]
        if volume > 0.0:
            if j >= 0:
                volume *= 0.5
            self._add(chunk, i, j, volume, volume)

    @ti.func
    def _add(self, chunk, i, j, volume, volume_partner):
        """Change the films of i, and of j if it is in this chunk, by volumes [m3]."""
        first = chunk * self.chunk_size()
        self.particles.liquid_film[i] = self.particles.liquid_film[i] + volume
        if j >= first and j < first + self.chunk_size():
            self.particles.liquid_film[j] = self.particles.liquid_film[j] + volume_partner

    @ti.func
    def prepare(self, chunk, i):
        """What a rebuild needs before the sort, as `save` in each step.

        Bridges to walls that are no longer present return their liquid; these contacts end.
        """
        if ti.static(self.has_walls):
            for list_index in range(self.neighbors.list_begin[i], self.neighbors.list_end[i]):
                self._end_if_removed(chunk, i, self.neighbors.partner[list_index], list_index)
        self.particles.liquid_film_before[i] = self.particles.liquid_film[i]

    @ti.func
    def _end_if_removed(self, chunk, i, j, list_index):
        if j < 0 and self.neighbors.in_contact[list_index] == IN_CONTACT:
            if self.walls.present[self.wall_of(j)] == 0:
                self.return_liquid(chunk, i, j, list_index)
                for name in ti.static(self.names):
                    self.neighbors.history[name][list_index] = 0.0 * self.neighbors.history[name][list_index]
                self.neighbors.in_contact[list_index] = NO_CONTACT


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
