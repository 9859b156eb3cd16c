"""Forecasts of clumps with a sphere that occurs twice, and of clumps with a gap between their spheres."""

from collections.abc import Iterator

import numpy as np

from granflow.load import Scene
from granflow.scene.schema.clumps import Clump

SAME = 1e-6
"""Distance and difference of radii, over the radius, below which spheres are equal, or a gap below which they touch."""

COMMON_OVERLAP = 0.1
"""Overlap over the smaller radius of the position that closes a gap."""


def clump_warnings(scene: Scene) -> Iterator[str]:
    """A sentence for each clump with a sphere that occurs twice, and for each whose spheres are not connected.

    The forces on a sphere that occurs twice count twice, and volume and inertia once.
    """
    for name, group in scene.particles.items():
        if group.clump is not None:
            yield from _repeated(scene, name, group.clump)
            yield from _gaps(scene, name, group.clump)


def _repeated(scene: Scene, name: str, clump: Clump) -> Iterator[str]:
    """A sentence on the first sphere that equals an earlier one, with the number of further ones."""
    centers, radii, distance = _spheres(clump)
    scale = SAME * np.minimum.outer(radii, radii)
    equal = (distance <= scale) & (np.abs(np.subtract.outer(radii, radii)) <= scale)
    repeated = [k for k in range(len(radii)) if equal[k, :k].any()]
    if repeated:
        index = repeated[0]
        first = int(equal[index].argmax())
        more = f" ({len(repeated) - 1} more of its spheres are repeated)" if len(repeated) > 1 else ""
        yield (
            f"{_key(scene, name, index)} is {_vector(centers[index])} m with the radius {radii[index]:.4g} m, the "
            f"same sphere as spheres.{first}{more}: its contacts count twice. Remove it, or give it another position "
            f"such as {_vector(centers[index] + [radii[index], 0.0, 0.0])} m."
        )


def _gaps(scene: Scene, name: str, clump: Clump) -> Iterator[str]:
    """A sentence on the narrowest gap between the spheres that are connected with the first one and the others."""
    from scipy.sparse.csgraph import connected_components  # imported here: most scenes have no clump

    centers, radii, distance = _spheres(clump)
    gap = distance - np.add.outer(radii, radii)
    count, part = connected_components(gap <= SAME * np.minimum.outer(radii, radii))
    if count == 1:
        return
    of_first = part == part[0]
    gap[~np.outer(of_first, ~of_first)] = np.inf
    near, far = (int(each) for each in np.unravel_index(gap.argmin(), gap.shape))
    reach = radii[near] + radii[far] - COMMON_OVERLAP * min(radii[near], radii[far])
    closed = centers[near] + (centers[far] - centers[near]) * (reach / distance[near, far])
    others = ", with the spheres connected with it," if (part == part[far]).sum() > 1 else ""
    yield (
        f"{_key(scene, name, far)} is {_vector(centers[far])} m, {gap[near, far]:.3g} m away from the surface of "
        f"spheres.{near}, which is the nearest one of the others: the spheres of this clump form {count} separate "
        f"bodies that move as one. Move it{others} to a position such as {_vector(closed)} m, which closes the gap, or "
        "give the bodies groups of their own."
    )


def _spheres(clump: Clump) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Centers (k, 3) [m], radii (k,) [m], and distances (k, k) [m] of the centers."""
    centers, radii = np.array([each.position for each in clump.spheres]), np.array([s.radius for s in clump.spheres])
    return centers, radii, np.linalg.norm(centers[:, None] - centers[None], axis=2)


def _key(scene: Scene, name: str, index: int) -> str:
    """Key and place of the position of a sphere."""
    path = ("particles", name, "clump", "spheres", index, "position")
    return f"{'.'.join(map(str, path))} ({scene.where(*path)})"


def _vector(values: np.ndarray) -> str:
    """Coordinates in the form of the scene."""
    return "[" + ", ".join(f"{each + 0.0:.4g}" for each in values) + "]"
