"""Exact sums: terms are rounded to multiples of a unit before they are added, so that their order does not
matter.

Therefore the bits of a run do not depend on threads, chunks, neighbor lists or ranks. `plan/sum_units.py`
gives the units. Forces and torques are summed in f64 after rounding to a grid (`build_to_grid`). Energies and
impulses are integers, converted with the parameter `per_unit`; they are summed over a whole run and have two
words each: the low one in units, the high one in 2^CARRY_BITS units. The host adds up the chunks.

The last section keeps the remainders of float32 velocities, which is another kind of sum over many steps.
"""

from typing import Any

import numpy as np

from granflow.engine.state import ALONE, Gathering, State
from granflow.kernel_language import ti
from granflow.plan.sum_units import CARRY_BITS

# Forces and torques


def build_to_grid(real: Any) -> Any:
    """Device function (force or torque, shift): the nearest multiple of a unit; opposite for opposite
    arguments.

        (f + s) - s,   s = 3/2 unit / eps        with the rounding eps of the type

    f + s and f - s have the same spacing as long as |f| < s / 3. In f64, forces are below s / 3 (see
    `step.LARGEST_SUM_SQUARED`). In f32, a larger force is a multiple of half a unit anyway and remains as it
    is; sums are in f64 there, too.

    real:  type of the argument
    """

    @ti.func
    def to_grid(value, shift):
        rounded = (value + shift) - shift
        if ti.static(real == ti.f32):
            rounded = ti.select(3.0 * ti.abs(value) < shift, rounded, value)
        return rounded

    return to_grid


def holds_sums(state: State) -> bool:
    """Whether the fields of forces and torques represent their exact sums, with the rounded weight: in
    f64."""
    return state.backend.real == ti.f64


# Energies and impulses, by chunk


@ti.func
def to_units(value):
    """A number in units, rounded toward zero, as a 64-bit integer: exactly opposite for opposite values."""
    return ti.cast(value, ti.i64)


@ti.func
def energy_words(value):
    """Low and high word of an energy, each rounded toward zero.

    value:  energy in units of the high word, i.e. in 2^CARRY_BITS units of an energy
    """
    high = to_units(value)
    return to_units((value - high) * 2.0**CARRY_BITS), high


SHARES = 2
"""Number of times that a sum contains each energy: its value is the number of units over SHARES.

A pair of two particles of one chunk is in one neighbor list: its energy is added once, times 2. A pair across
two chunks is in the lists of both: each adds the energy times 1. A contact with a wall is in one list.
"""


def build_list_shares(state: State) -> Any:
    """Device function (chunk, j): SHARES for a pair in one neighbor list, SHARES / 2 for a pair in two.

    Sums over list entries of the chunk with this factor count each contact SHARES times; j is the partner.
    """
    chunk_size = state.parameter("chunk_size")

    @ti.func
    def list_shares(chunk, j):
        shares = SHARES
        size = chunk_size()
        if (j >= 0) & ((j < chunk * size) | (j >= (chunk + 1) * size)):
            shares = SHARES // 2
        return shares

    return list_shares


@ti.func
def add_energy(sums: ti.template(), chunk, term: ti.template(), terms: ti.template(), shares, value):
    """Add `shares` times an energy to one of the two-word sums of a chunk.

    sums:   field of vectors of `terms` low words and `terms` high words
    value:  as in `energy_words`

    Writes:  sums
    """
    low, high = energy_words(value)
    high_word = ti.static(term + terms)  # an index that is not static crashes the kernel compiler
    sums[chunk][term] = sums[chunk][term] + shares * low
    sums[chunk][high_word] = sums[chunk][high_word] + shares * high


@ti.func
def carried(sums, count: ti.template()):
    """Two-word sums with the carries moved from the low words to the high words.

    sums:  vector of `count` low words and `count` high words
    """
    result = sums
    for k in ti.static(range(count)):
        carry = sums[k] >> CARRY_BITS
        result[k] = sums[k] - (carry << CARRY_BITS)
        result[count + k] = sums[count + k] + carry
    return result


def shares_rows(state: State) -> bool:
    """Whether chunks of one particle share the rows of the sums of wall forces, by atomic additions."""
    return state.plan.chunk_size == 1


# Totals on the host

REDUCED_ROWS = 1024
"""Rows to which a GPU adds up the sums over chunks before the host reads them."""


def chunk_words(state: State, field: Any) -> np.ndarray:
    """Words (k, 2 terms) int64 of a sum over chunks; on a GPU added up on the device to REDUCED_ROWS rows.

    field:  two-word sums by chunk
    """
    if state.backend.on_cpu:
        return np.asarray(field.to_numpy())
    rows = np.zeros((REDUCED_ROWS, field.n), np.int64)
    state.built(_build_reduce, field)(rows)
    return rows


def _build_reduce(state: State, field: Any) -> Any:
    """Kernel (rows (REDUCED_ROWS, words)): two-word sums of every REDUCED_ROWS-th chunk.

    Reads:  field
    """
    words = field.n
    length = field.shape[0]
    external: Any = ti.types.ndarray()

    @ti.kernel
    def reduce_chunks(rows: external):
        for row in range(REDUCED_ROWS):
            sums = ti.Vector.zero(ti.i64, words)
            for k in range((length - row + REDUCED_ROWS - 1) // REDUCED_ROWS):
                sums = carried(sums + field[row + k * REDUCED_ROWS], words // 2)
            for word in ti.static(range(words)):
                rows[row, word] = sums[word]

    return reduce_chunks


def canonical(sums: np.ndarray) -> np.ndarray:
    """Two-word sums (..., 2 terms), int64, with the same totals and low words in [0, 2^CARRY_BITS)."""
    low, high = np.split(sums, 2, axis=-1)
    carry = low >> CARRY_BITS
    return np.concatenate([low - (carry << CARRY_BITS), high + carry], axis=-1)


def exact_totals(sums: np.ndarray, unit: float | np.ndarray) -> np.ndarray:
    """Totals of two-word sums over all axes but the last.

    sums:     (..., 2 terms) int64, low words and high words
    unit:     value of 1, a power of two, or one for each term
    Returns:  (terms,) float64, each the exact sum rounded once
    """
    words = sums.reshape(-1, sums.shape[-1]).sum(axis=0).tolist()
    terms = len(words) // 2
    totals = (low + (high << CARRY_BITS) for low, high in zip(words[:terms], words[terms:], strict=True))
    return unit * np.array([float(total) for total in totals])


def exact_total(values: np.ndarray) -> float:
    """Sum of int64 numbers, also if it exceeds their range, rounded once."""
    high = values >> CARRY_BITS
    return float((int(high.sum()) << CARRY_BITS) + int((values - (high << CARRY_BITS)).sum()))


def exact_sum(values: np.ndarray, ranks: Gathering = ALONE) -> float:
    """Sum of numbers (n,) of all ranks, the same for any order.

    Each is rounded to 2^-62 of their number times the largest magnitude.
    """
    magnitude = float(np.abs(values).max(initial=0.0))
    largest = ranks.largest(magnitude if np.isfinite(magnitude) else np.inf)
    if not np.isfinite(largest) or largest == 0.0:
        return float(ranks.total(np.array([values.sum()], float))[0])
    exponent = scale_exponent(largest, int(ranks.total(np.array([len(values)]))[0]))
    units = np.rint(np.ldexp(values.astype(float), exponent)).astype(np.int64).sum()
    return float(np.ldexp(float(ranks.total(np.array([units]))[0]), -exponent))


def scale_exponent(largest: float, count: int) -> int:
    """Exponent of the power of two by which `exact_sum` scales numbers before it rounds them to integers.

    largest:  largest magnitude of the numbers
    count:    number of numbers
    """
    if not np.isfinite(largest) or largest == 0.0:
        return 0
    return 62 - int(np.frexp(largest * count)[1])


@ti.func
def to_nearest(value):
    """The nearest integer of an f64 number as i64, the even one of two, as `numpy.rint`."""
    lower = ti.floor(value)
    rest = value - lower
    integer = ti.cast(lower, ti.i64)
    if rest > 0.5 or (rest == 0.5 and integer % 2 != 0):
        integer += 1
    return integer


# Velocities in float32, which would otherwise lose small changes of large velocities
#
# The change of a velocity in one step, such as g dt, can be smaller than half the spacing of float32 at the
# velocity (5e-7 m/s at 8 m/s). Each particle therefore keeps the remainder of the sum for the next step
# (Kahan, Commun. ACM 8 (1965) 40). Clumps sum their velocities in the precision of positions instead.


class VelocitySum:
    """The sum of the changes of a velocity.

    name:  "velocity" or "angular_velocity"

    Reads:   the velocity, its remainder
    Writes:  the remainder
    """

    def __init__(self, state: State, name: str) -> None:
        self.velocity = getattr(state.particles, name)
        self.remainder = getattr(state.particles, f"{name}_remainder")
        self.keeps_remainder = state.plan.features.velocity_remainders

    @ti.func
    def changed(self, i, change):
        """The velocity of particle i after a change in this step; does not write the velocity."""
        before = self.velocity[i]
        after = before + change
        if ti.static(self.keeps_remainder):
            whole = change + self.remainder[i]
            after = before + whole
            self.remainder[i] = whole - (after - before)
        return after
