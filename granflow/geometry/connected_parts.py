"""Parts of things that are connected in pairs: triangles of a mesh, spheres of a clump.

scipy has this function too, but the import of its sparse matrices takes longer than the check of a scene.
"""

import numpy as np


def connected_parts(pairs: np.ndarray, count: int) -> np.ndarray:
    """Number of the part (count,) of each thing, from 0 in the order of the first thing of each part.

    `pairs` (p, 2): numbers of things that are connected; a thing without pairs is a part of its own.
    """
    lowest = np.arange(count)
    first, second = np.asarray(pairs, dtype=np.int64).reshape(-1, 2).T
    while True:
        ends = lowest[first], lowest[second]
        if np.array_equal(*ends):
            return np.unique(lowest, return_inverse=True)[1]
        for end in ends:
            np.minimum.at(lowest, end, np.minimum(*ends))
        lowest = lowest[lowest]
