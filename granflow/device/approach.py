"""The fastest approach now: what a time step that follows the scene is chosen by."""

from typing import Any

import numpy as np
import taichi as ti

from granflow.device.encounter import build_either_encounter, build_pair_number
from granflow.device.state import Block, State


class FastestApproach:
    """A look at every near pair and wall; a maximum, so that threads and order do not matter."""

    def __init__(self, state: State) -> None:
        self.state = state
        self.block = Block()
        self._squares = self.block.scalar(state.backend.real, state.plan.chunk_capacity)
        self.block.finish()
        self._look = _build_look(state, self._squares)

    def measure(self) -> float:
        """Largest approach velocity [m/s] that any near pair has now, or had before its overlap took it up."""
        state = self.state
        if not state.count:
            return 0.0
        self._look(state.chunk_count, state.count, state.clock.time_step)
        return float(np.sqrt(self._squares.to_numpy()[: state.chunk_count].max()))


def _build_look(state: State, squares: Any) -> Any:
    contacts, control, real, stride = state.contacts, state.control, state.backend.real, state.stride
    chunk_size = state.plan.chunk_size
    modulus = state.plan.law.constant_names.index("modulus_eff")
    encounter, pair_number = build_either_encounter(state), build_pair_number(state)

    @ti.func
    def square(i, j, dt):
        """Square of the approach velocity with the energy of the pair's motion and overlap (Zhou 2011, Eq. 5).

        v^2 = d'^2 + 4 k d^2.5 / (5 M)
        """
        overlap, rate, radius_eff, mass_eff = encounter(i, j, 0, dt)
        found = ti.max(rate, 0.0) ** 2
        if overlap > 0.0:
            k = 4.0 / 3.0 * control.pair_constants[pair_number(i, j)][modulus] * ti.sqrt(radius_eff)
            found = rate * rate + 0.8 * k * overlap * overlap * ti.sqrt(overlap) / mass_eff
        return found

    @ti.kernel
    def look(chunks: ti.i32, count: ti.i32, dt: real):
        for task in range(chunks * stride):
            if task % stride == 0:
                chunk = task // stride
                largest = ti.cast(0.0, real)
                for i in range(chunk * chunk_size, ti.min((chunk + 1) * chunk_size, count)):
                    for slot in range(contacts.row_begin[i], contacts.row_end[i]):
                        largest = ti.max(largest, square(i, contacts.partner[slot], dt))
                squares[chunk] = largest

    return look
