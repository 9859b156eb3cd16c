"""Distance and contact of a point with one triangle of a mesh, in numpy: the twin of what `device/mesh.py` computes."""

import numpy as np

from granflow.walls.mesh_links import OPEN, SHARED, SILENT, Links
from granflow.walls.shape import FAR_AWAY

ROUNDING = 16.0
"""Units in the last place of the lengths about a corner within which a centre counts as straight above it."""


def bare_distance(vertex: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Distance (n,) [m] of points (n, 3) from triangles (n, 3, 3): to the face if the foot is on it, or an edge."""
    sides = np.roll(vertex, -1, axis=1) - vertex
    away = points[:, None, :] - vertex
    share = np.clip(_dot(away, sides) / _dot(sides, sides), 0.0, 1.0)
    to_edges = np.linalg.norm(away - share[:, :, None] * sides, axis=2).min(axis=1)
    normal = np.cross(sides[:, 0], -sides[:, 2])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    over = np.all(_dot(np.cross(normal[:, None, :], sides), away) > 0.0, axis=1)
    return np.where(over, np.abs(_dot(away[:, 0], normal)), to_edges)


def reference_contact(links: Links, triangles: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Gap (n,) [m] and normal (n, 3) of the contact of points (n, 3) with triangles (n,) by number.

    FAR_AWAY where another triangle answers, or where the nearest point of the triangle is none of the mesh.
    """
    gap, normal = reference_own_contact(links, triangles, points)
    height = _dot(points - links.vertex[triangles, 0], links.normal[triangles])
    key = 2 * triangles + (height < 0.0)
    asked, place = rows(links.rival_start, key)
    rival = links.rival[place]
    nearer, _ = reference_own_contact(links, rival, points[asked])
    outdone = (nearer < gap[asked]) | ((nearer == gap[asked]) & (rival < triangles[asked]))
    yields = np.zeros(len(points), bool)
    yields[asked[outdone]] = True
    return np.where(yields, FAR_AWAY, gap), normal


def rows(start: np.ndarray, wanted: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """All entries (r,) of the wanted rows (n,), which begin at `start`, and which of the wanted (r,) each is from."""
    counts = start[wanted + 1] - start[wanted]
    asked = np.repeat(np.arange(len(wanted)), counts)
    within = np.arange(len(asked)) - np.repeat(np.cumsum(counts) - counts, counts)
    return asked, start[wanted][asked] + within


def reference_own_contact(links: Links, triangles: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """As `reference_contact`, before rivals are asked."""
    gap, normal = np.full(len(points), FAR_AWAY), links.normal[triangles].copy()
    away = points[:, None, :] - links.vertex[triangles]
    height = _dot(away[:, 0], normal)
    normal[height < 0.0] *= -1.0
    above = _above_corner(links, triangles, points)
    lost = above.any(axis=1)
    s, s_beyond = _over(links, triangles, away)
    over = (s > 0.0) | ((s == 0.0) & links.tie[triangles])
    on_face = ~lost & over.all(axis=1)
    gap[on_face] = np.abs(height[on_face])
    for k in range(3):
        own = above[:, k] & (links.owner[links.point[triangles, k]] == triangles)
        _enter(gap, normal, own & ~on_face, away[:, k])
        t, role = _dot(away[:, k], links.along[triangles, k]), links.role[triangles, k]
        counts = ~lost & ~over[:, k] & (role != SILENT) & (t > 0.0) & (t < links.length[triangles, k])
        counts &= (role == OPEN) | ((role == SHARED) & (s_beyond[:, k] <= 0.0))
        _enter(gap, normal, counts & ~on_face, away[:, k] - t[:, None] * links.along[triangles, k])
    return gap, normal


def _over(links: Links, triangles: np.ndarray, away: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distance (n, 3) over the own face at every edge, and over that of the other triangle."""
    from_base = np.take_along_axis(away, links.base[triangles][:, :, None], axis=1)
    return _dot(from_base, links.inward[triangles]), _dot(from_base, links.beyond[triangles])


def _above_corner(links: Links, triangles: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Whether (n, 3) no edge that leaves a corner comes nearer to the point."""
    found = np.zeros((len(points), 3), bool)
    eps = np.finfo(points.dtype).eps
    for k in range(3):
        corner = links.point[triangles, k]
        away = points - links.vertex[triangles, k]
        slack = ROUNDING * eps * (links.longest[corner] + np.linalg.norm(away, axis=1))
        point, spoke = rows(links.spoke_start, corner)
        rises = np.full(len(points), -np.inf)
        np.maximum.at(rises, point, _dot(links.spoke[spoke], away[point]))
        found[:, k] = rises <= slack
    return found


def _enter(gap: np.ndarray, normal: np.ndarray, where: np.ndarray, away: np.ndarray) -> None:
    """Contacts with an edge or a corner: `away` (n, 3) from its nearest point to the centre."""
    distance = np.linalg.norm(away, axis=1)
    gap[where] = distance[where]
    some = where & (distance > 0.0)
    normal[some] = away[some] / distance[some, None]


def _dot(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    return np.sum(one * other, axis=-1)
