"""Decomposition of space among the ranks by recursive coordinate bisection (Berger and Bokhari 1987).

Which rank owns a particle has no influence on the bits of a run.
"""

from dataclasses import dataclass

import numpy as np

from granflow.parallel.communicator import Communicator

BISECTIONS = 40
"""Halvings of the range of a cut: its position is then exact to 1e-12 of the size of the bed."""

NO_CUT = -1
"""Axis of a node that belongs to one rank."""


@dataclass(frozen=True)
class Decomposition:
    """A binary tree of cuts.

    axis:    (nodes,) axis of the cut, or NO_CUT
    cut:     (nodes,) coordinate [m] of the cut
    child:   (nodes,) node below the cut; the node above it is the next one
    rank:    (nodes,) lowest rank of the node
    """

    axis: np.ndarray
    cut: np.ndarray
    child: np.ndarray
    rank: np.ndarray

    def owners(self, position: np.ndarray) -> np.ndarray:
        """Rank (n,) that owns particles at positions (n, 3) [m]."""
        node = np.zeros(len(position), np.int64)
        while True:
            is_cut = self.axis[node] != NO_CUT
            if not is_cut.any():
                return self.rank[node]
            rows, inner = np.flatnonzero(is_cut), node[is_cut]
            above = position[rows, self.axis[inner]] >= self.cut[inner]
            node[rows] = self.child[inner] + above


def bisected(communicator: Communicator, position: np.ndarray, weights: np.ndarray) -> Decomposition:
    """Decomposition into parts of equal weight; all ranks call this together.

    position:  (n, 3) [m] of the particles of this rank
    weights:   (n,) integers: their sums are exact, so that all ranks find the same cuts

    Each level of the tree cuts all its nodes at once, across their longest side, between the numbers of ranks of both
    parts. Only sums are communicated.
    """
    first, ranks = [0], [communicator.size]
    axis, cut, child = [NO_CUT], [0.0], [0]
    node, level = np.zeros(len(position), np.int64), [0]
    while level := [each for each in level if ranks[each] > 1]:
        row = np.full(len(ranks), -1)
        row[level] = np.arange(len(level))
        inside = row[node] >= 0
        part, points = row[node[inside]], position[inside]
        shares = np.array([(ranks[each] // 2) / ranks[each] for each in level])
        axes, cuts = _cuts(communicator, part, points, weights[inside], shares)
        below = []
        for number, each in enumerate(level):
            axis[each], cut[each], child[each] = int(axes[number]), float(cuts[number]), len(ranks)
            low = ranks[each] // 2
            below += [len(ranks), len(ranks) + 1]
            first += [first[each], first[each] + low]
            ranks += [low, ranks[each] - low]
            axis, cut, child = [*axis, NO_CUT, NO_CUT], [*cut, 0.0, 0.0], [*child, 0, 0]
        above = points[np.arange(len(points)), axes[part]] >= cuts[part]
        node[inside] = np.array(child)[node[inside]] + above
        level = below
    return Decomposition(np.array(axis), np.array(cut), np.array(child), np.array(first))


def _cuts(
    communicator: Communicator, part: np.ndarray, points: np.ndarray, weights: np.ndarray, shares: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Axis and coordinate [m] of the cut of each of k parts.

    part:    (n,) part of each particle
    points:  (n, 3) positions [m]
    weights: (n,) integers
    shares:  (k,) share of the weight below the cut
    """
    parts = len(shares)
    bounds = np.full((2, parts, 3), -np.inf)
    np.maximum.at(bounds[0], part, points)
    np.maximum.at(bounds[1], part, -points)
    largest = communicator.largest_of(bounds)
    largest[~np.isfinite(largest)] = 0.0  # without particles
    high, low = largest[0], -largest[1]
    axes = np.argmax(high - low, axis=1)
    rows = np.arange(parts)
    begin, end, along = low[rows, axes], high[rows, axes], points[np.arange(len(points)), axes[part]]

    def summed(selected: np.ndarray) -> np.ndarray:
        """Weight (k,) of the selected particles (n,) of each part."""
        own = np.bincount(part[selected], weights[selected], minlength=parts)
        return communicator.sums(own.astype(np.int64))

    wanted = shares * summed(np.ones(len(part), bool))
    for _ in range(BISECTIONS):
        middle = 0.5 * (begin + end)
        below = summed(along < middle[part])
        begin, end = np.where(below < wanted, middle, begin), np.where(below < wanted, end, middle)
    return axes, end
