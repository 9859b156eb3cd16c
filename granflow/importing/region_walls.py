"""Walls on the surfaces of regions (fix wall/gran/region of LAMMPS).

Each face of a region becomes a wall: a block a box, a cylinder or cone its lateral surface and discs at its
ends. Faces of unions that lie inside of another part are left out. A region that is defined again or jumps
between runs begins an episode with walls of its own.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import pi
from typing import Any

import numpy as np

from granflow.importing.deck import Deck, Fix, Region, Run
from granflow.importing.materials import WallContact
from granflow.importing.meshes import clean, rotation
from granflow.importing.motion import Pose, region_motions
from granflow.importing.regions import UNBOUNDED, in_region, region_at
from granflow.importing.report import Entry
from granflow.importing.scene_text import Draft, plain_name, quantities, quantity
from granflow.importing.schedule import stages_of_runs

BLOCK_FACES = ("left", "right", "front", "back", "bottom", "top")
"""Faces of a block in the order of LAMMPS (open 1 to 6), named as those of the wall `box`."""
AXIAL_FACES = ("bottom", "top", "side")
"""Faces of a cylinder and a cone in the order of LAMMPS."""
SAMPLES = 12
"""Points along each direction of a face that decide whether it is inside of another region."""
OFFSET = 1e-6
"""Distance of these points from the face over the size of the region."""


@dataclass
class RegionWall:
    """One fix wall/gran/region."""

    region: str
    contact: WallContact


@dataclass
class Face:
    """One wall: points (positions), vectors (directions and sides) and lengths, named as in the scene."""

    shape: str
    points: dict[str, np.ndarray]
    vectors: dict[str, np.ndarray]
    lengths: dict[str, float]

    def keys(self) -> dict[str, Any]:
        """The keys of the wall, without material."""
        keys: dict[str, Any] = {"shape": self.shape}
        keys |= {name: quantities(clean(point), "length") for name, point in self.points.items()}
        for name, vector in self.vectors.items():
            if vector.ndim == 2:
                keys[name] = [quantities(clean(each), "length") for each in vector]
            else:
                keys[name] = clean(vector)
        return keys | {name: quantity(length, "length") for name, length in self.lengths.items()}

    def moved(self, turn: np.ndarray, center: np.ndarray, shift: np.ndarray) -> "Face":
        """The face turned by a matrix about a center, then shifted."""
        return Face(
            self.shape,
            {name: turn @ (point - center) + center + shift for name, point in self.points.items()},
            {name: vector @ turn.T for name, vector in self.vectors.items()},
            self.lengths,
        )


# Faces of a region


def faces_of(deck: Deck, region: Region) -> dict[str, Face]:
    """The closed faces of a region by name."""
    build = {"block": _block, "cylinder": _axial, "cone": _axial, "sphere": _sphere, "plane": _plane}
    faces, numbered = build[region.kind](deck, region)
    opened = {numbered[k - 1] for k in region.open if 1 <= k <= len(numbered)}
    return {name: face for name, face in faces.items() if name not in opened}


def _finite(deck: Deck, region: Region) -> list[float]:
    """Numbers of a block with the box, enlarged by its size, in place of INF and with the box for EDGE."""
    assert deck.box is not None
    found = []
    for k, each in enumerate(region.numbers):
        size = deck.box[k // 2 * 2 + 1] - deck.box[k // 2 * 2]
        far = deck.box[k] + (size if k % 2 else -size)
        found.append(deck.box[k] if each != each else far if abs(each) == np.inf else each)
    return found


def _block(deck: Deck, region: Region) -> tuple[dict[str, Face], tuple[str, ...]]:
    n = _finite(deck, region)
    low, high = np.array(n[::2]), np.array(n[1::2])
    faces = {}
    for k, name in enumerate(BLOCK_FACES):
        if not np.isfinite(region.numbers[k]):
            continue
        axis, is_high = divmod(k, 2)
        corner = low.copy()
        corner[axis] = high[axis] if is_high else low[axis]
        sides = np.delete(np.diag(high - low), axis, axis=0)
        faces[name] = Face("rectangle", {"corner": corner}, {"sides": sides}, {})
    return faces, BLOCK_FACES


def _axial(deck: Deck, region: Region) -> tuple[dict[str, Face], tuple[str, ...]]:
    """A cylinder or a cone: its lateral surface and its ends."""
    assert deck.box is not None
    c1, c2, *radii, low, high = region.numbers
    axis = "xyz".index(region.axis)
    extents = [low, high]
    size = deck.box[2 * axis + 1] - deck.box[2 * axis]
    for k, each in enumerate(extents):
        far = deck.box[2 * axis + k] + (size if k else -size)
        extents[k] = deck.box[2 * axis + k] if each != each else far if abs(each) == np.inf else each
    ends = []
    for along in extents:
        end = np.zeros(3)
        end[axis] = along
        end[[k for k in range(3) if k != axis]] = c1, c2
        ends.append(end)
    places = {"from": ends[0], "to": ends[1]}
    if region.kind == "cylinder":
        side = Face("cylinder", places, {}, {"radius": radii[0]})
        radii = [radii[0], radii[0]]
    else:
        side = Face("cone", places, {}, {"radius_from": radii[0], "radius_to": radii[1]})
    faces = {}
    for name, end, radius, given in zip(("bottom", "top"), ends, radii, (low, high), strict=True):
        if radius > 0.0 and np.isfinite(given):
            faces[name] = Face("disc", {"center": end}, {"normal": np.eye(3)[axis]}, {"radius": radius})
    return {**faces, "side": side}, AXIAL_FACES


def _plane(deck: Deck, region: Region) -> tuple[dict[str, Face], tuple[str, ...]]:
    point, normal = np.array(region.numbers[:3]), np.array(region.numbers[3:])
    sign = 1.0 if region.inside else -1.0
    return {"plane": Face("plane", {"point": point}, {"normal": sign * normal}, {})}, ("plane",)


def _sphere(deck: Deck, region: Region) -> tuple[dict[str, Face], tuple[str, ...]]:
    *center, radius = region.numbers
    return {"sphere": Face("sphere", {"center": np.array(center)}, {}, {"radius": radius})}, ("sphere",)


# Which points are inside a region, on both sides of a face


def samples(face: Face, region: Region) -> tuple[np.ndarray, np.ndarray]:
    """Points (n, 3) on a face, and unit normals (n, 3) that point out of the shape of the region."""
    share = (np.arange(SAMPLES) + 0.5) / SAMPLES
    u, v = (each.ravel() for each in np.meshgrid(share, share))
    if face.shape == "rectangle":
        first, second = face.vectors["sides"]
        points = face.points["corner"] + np.outer(u, first) + np.outer(v, second)
        normal = np.cross(first, second)
        n = np.array(region.numbers)
        middle = 0.5 * (n[::2] + n[1::2])
        middle = np.where(np.isfinite(middle), middle, points.mean(axis=0))
        normal = normal * np.sign(normal @ (points.mean(axis=0) - middle))
        return points, np.tile(normal / np.linalg.norm(normal), (len(points), 1))
    if face.shape in ("disc", "cylinder", "cone"):
        axis = "xyz".index(region.axis)
        first, second = np.delete(np.eye(3), axis, axis=0)
        around = np.outer(np.cos(2 * pi * u), first) + np.outer(np.sin(2 * pi * u), second)
        if face.shape == "disc":
            radius = face.lengths["radius"] * np.sqrt(v)
            is_low = abs(face.points["center"][axis] - region.numbers[-2]) < abs(
                face.points["center"][axis] - region.numbers[-1]
            )
            normals = np.tile(np.eye(3)[axis] * (-1.0 if is_low else 1.0), (len(u), 1))
            return face.points["center"] + radius[:, None] * around, normals
        start, end = face.points["from"], face.points["to"]
        low = face.lengths.get("radius", face.lengths.get("radius_from", 0.0))
        high = face.lengths.get("radius", face.lengths.get("radius_to", 0.0))
        wide = np.asarray(low + (high - low) * v)
        points = start + np.outer(v, end - start) + wide[:, None] * around
        return points, around
    if face.shape == "sphere":
        along, across = 1.0 - 2.0 * v, 2.0 * np.sqrt(v * (1.0 - v))
        away = np.stack([across * np.cos(2 * pi * u), across * np.sin(2 * pi * u), along], axis=1)
        return face.points["center"] + face.lengths["radius"] * away, away
    return np.zeros((0, 3)), np.zeros((0, 3))


# Walls of a region


@dataclass
class Part:
    """A region without parts and the faces of it that are walls."""

    region: Region
    faces: dict[str, Face]
    is_finite: bool
    """Whether particles can be beyond the edges of a face."""


def parts_of(deck: Deck, region: Region, time: float, entry: Entry) -> list[Part]:
    """The regions of which a region consists, with the faces that border it."""
    leaves = _leaves(deck, region, time)
    regions = {each.name: each for each in (region, *leaves)}
    for each in _all_parts(deck, region, time):
        regions[each.name] = each
    found = []
    for leaf in leaves:
        faces = faces_of(deck, leaf)
        if len(leaves) > 1:
            for name, face in list(faces.items()):
                points, normals = samples(face, leaf)
                if not len(points):
                    continue
                size = np.ptp(points, axis=0).max()
                borders = _borders(_hiding(region, leaf, regions), regions, points, OFFSET * size * normals)
                if not borders.any():
                    del faces[name]
                elif not borders.all() and region.kind == "union" and region.inside:
                    entry.impossible(
                        f"the face {name} of region {leaf.name} has an opening where other regions meet it",
                        "a mesh with the opening (shape: mesh), or regions whose faces meet completely",
                    )
        found.append(Part(leaf, faces, not leaf.inside or len(leaves) > 1))
    return found


def _hiding(region: Region, leaf: Region, regions: dict[str, Region]) -> Region:
    """A union without the other parts that have open faces: LAMMPS hides no face behind these."""
    if region.kind != "union" or not region.inside:
        return region
    parts = (each for each in region.parts if each == leaf.name or not regions[each].open)
    return replace(region, parts=tuple(parts))


def _borders(region: Region, regions: dict[str, Region], points: np.ndarray, shift: np.ndarray) -> np.ndarray:
    """Whether a region has particles on one side of each point, and none on the other."""
    one = in_region(region, points + shift, regions, UNBOUNDED)
    other = in_region(region, points - shift, regions, UNBOUNDED)
    return np.asarray(one != other)


def _leaves(deck: Deck, region: Region, time: float) -> list[Region]:
    return [each for each in _all_parts(deck, region, time) if not each.parts]


def _all_parts(deck: Deck, region: Region, time: float) -> list[Region]:
    """A region and all its parts, as they are at a time [s]."""
    found = [region]
    for name in region.parts:
        part = region_at(deck, name, time)
        if part is not None:
            found += _all_parts(deck, part, time)
    return found


@dataclass
class Episode:
    """Consecutive runs in which a wall has the same region, which does not jump."""

    region: Region
    runs: list[Run]


def episodes(deck: Deck, fix: Fix, name: str) -> list[Episode]:
    """The episodes of the region of a wall."""
    found: list[Episode] = []
    for run in deck.acting(fix):
        region = region_at(deck, name, run.start)
        if region is None:
            continue
        parts = _all_parts(deck, region, run.start)
        if (
            found
            and found[-1].region is region
            and not any(_jumps(each, found[-1].runs[-1], run) for each in parts)
        ):
            found[-1].runs.append(run)
        else:
            found.append(Episode(region, [run]))
    return found


def _jumps(region: Region, before: Run, after: Run) -> bool:
    """Whether a moving region is elsewhere at the beginning of a run than at the end of the one before."""
    if region.motion is None:
        return False
    track = region.motion.track
    last, first = track.over([before])[1][-1:], track.over([after])[1][:1]
    kept = 3 if region.motion.is_symmetric else 4  # the angle of a surface of revolution may jump
    return len(last) == len(first) == 1 and bool(np.abs(first - last)[:, :kept].max() > 1e-6)


def note_jumps(deck: Deck) -> None:
    """Begin a stage where the region of a wall jumps between two runs."""
    for fix in deck.fixes_of("wall/gran/region"):
        if not isinstance(fix.data, RegionWall):
            continue
        for region in deck.own("all_regions", list):
            if region.motion is not None:
                region.motion.is_symmetric = _is_symmetric(region)
        for episode in episodes(deck, fix, fix.data.region)[1:]:
            deck.own("changes", set).add(episode.runs[0].start)


def _is_symmetric(region: Region) -> bool:
    """Whether the rotation of a region does not change its surface."""
    n = np.array(region.numbers)
    center = np.array(region.motion.point)
    if region.kind in ("cylinder", "cone"):
        k = "xyz".index(region.axis)
        own = np.eye(3)[k]
        center[[i for i in range(3) if i != k]] = n[:2]
    elif region.kind == "plane":
        own = n[3:6] / np.linalg.norm(n[3:6])
    elif region.kind == "sphere":
        own, center = np.array(region.motion.axis), n[:3]
    else:
        return False
    away = np.cross(center - np.array(region.motion.point), region.motion.axis)
    tilt = np.cross(own, region.motion.axis)
    return bool(np.abs(tilt).max() < 1e-9 and np.abs(away).max() < 1e-9)


def build(deck: Deck, draft: Draft, fix: Fix, wall: RegionWall) -> None:
    """Write the walls of one fix."""
    for episode in episodes(deck, fix, wall.region):
        time = episode.runs[0].start
        parts = parts_of(deck, episode.region, time, fix.entry)
        for part in parts:
            name = fix.name if len(parts) == 1 else f"{fix.name}_{part.region.name}"
            _write(deck, draft, fix, wall, episode, part, name)


def _write(
    deck: Deck, draft: Draft, fix: Fix, wall: RegionWall, episode: Episode, part: Part, name: str
) -> None:
    """The walls of one part of a region in an episode."""
    stages = stages_of_runs(deck, episode.runs)
    when: dict[str, Any] = {} if stages is None else {"stages": stages}
    name = wall_name(draft, name)
    region = part.region
    pose = Pose(0.0, np.zeros(3))
    motions: list[dict[str, Any]] = []
    if region.motion is not None:
        pose, motions = region_motions(deck, draft, region.motion, episode.runs, when, name)
    motion: dict[str, Any] = {"motion": motions[0] if len(motions) == 1 else motions} if motions else {}
    common = {"material": wall.contact.material, **when, **motion}
    faces = _reachable(deck, part, fix)
    if region.kind == "block" and pose.angle == 0.0 and faces:
        low, high = (np.array(_finite(deck, region)[k::2]) + pose.shift for k in (0, 1))
        keys: dict[str, Any] = {
            "shape": "box",
            "min": quantities(low, "length"),
            "max": quantities(high, "length"),
        }
        if len(faces) < len(BLOCK_FACES):
            keys["open"] = [each for each in BLOCK_FACES if each not in faces]
        if part.is_finite or motions or "open" in keys:
            keys["finite"] = True
        draft.put(("walls", name), {**keys, **common}, fix.entry, region.entry)
        return
    turn = np.eye(3)
    center = np.zeros(3)
    if region.motion is not None and pose.angle:
        turn, center = rotation(region.motion.axis, pose.angle), np.array(region.motion.point)
    for face_name, face in faces.items():
        keys = face.moved(turn, center, pose.shift).keys()
        free = name if len(faces) == 1 else wall_name(draft, f"{name}_{face_name}")
        draft.put(("walls", free), {**keys, **common}, fix.entry, region.entry)


def _reachable(deck: Deck, part: Part, fix: Fix) -> dict[str, Face]:
    """The faces without the ends of a container that particles pass while they are inserted.

    LAMMPS evaluates a wall only for particles inside of its region; those that are inserted outside come in
    through a face.
    """
    if not part.region.inside or part.region.kind not in ("cylinder", "cone", "block"):
        return part.faces
    kept = dict(part.faces)
    for other in deck.all_fixes:
        inserted = getattr(other.data, "region", None)
        if (
            not isinstance(inserted, Region)
            or inserted.kind not in ("cylinder", "block")
            or not deck.acting(other)
        ):
            continue
        axis = "xyz".index(part.region.axis) if part.region.axis else 2
        container, source = _interval(part.region, axis), _interval(inserted, axis)
        for name, beyond in (
            (
                ("bottom", "top")[source[0] >= container[1]],
                source[0] >= container[1] or source[1] <= container[0],
            ),
        ):
            if beyond and name in kept:
                del kept[name]
                fix.entry.approximated(
                    f"the face {name} of region {part.region.name} is open, since particles are inserted "
                    "behind it"
                )
    return kept


def _interval(region: Region, axis: int) -> tuple[float, float]:
    """Low and high of a block, cylinder or cone along an axis."""
    n = region.numbers
    if region.kind == "block":
        return n[2 * axis], n[2 * axis + 1]
    if region.kind == "sphere":
        return n[axis] - n[3], n[axis] + n[3]
    if "xyz".index(region.axis) == axis:
        return n[-2], n[-1]
    others = [k for k in range(3) if k != "xyz".index(region.axis)]
    radius = max(n[2:-2])
    center = n[others.index(axis)]
    return center - radius, center + radius


def release_periodic_axes(deck: Deck) -> None:
    """Make axes that no particle can cross not periodic: a wall around the particles reaches their faces.

    granflow refuses walls that end at periodic faces; a container that acts in all runs hides these faces.
    """
    if deck.box is None or deck.boundary_entry is None:
        return
    for fix in deck.fixes_of("wall/gran/region"):
        if not isinstance(fix.data, RegionWall) or len(deck.acting(fix)) == 0:
            continue
        region = region_at(deck, fix.data.region, fix.start)
        if region is None:
            continue
        for part in _leaves(deck, region, fix.start):
            if part.inside and part.kind in ("cylinder", "cone", "block"):
                _release(deck, part)


def _release(deck: Deck, part: Region) -> None:
    """Make the axes across which a container is closed not periodic, and let the box contain it."""
    assert deck.box is not None and deck.boundary_entry is not None
    axis = "xyz".index(part.axis) if part.axis else -1
    letters, box = list(deck.boundary), list(deck.box)
    for k in range(3):
        is_open = part.kind == "block" and (2 * k + 1 in part.open or 2 * k + 2 in part.open)
        if k == axis or letters[2 * k] != "p" or is_open:
            continue
        low, high = _interval(part, k)
        if not np.isfinite([low, high]).all() or low > box[2 * k] and high < box[2 * k + 1]:
            continue
        letters[2 * k] = letters[2 * k + 1] = "f"
        margin = 0.01 * (high - low)
        box[2 * k] = min(box[2 * k], low - margin)
        box[2 * k + 1] = max(box[2 * k + 1], high + margin)
        deck.boundary_entry.translated(
            f"domain (not periodic along {'xyz'[k]}: region {part.name} is around it)"
        )
    first, second, third, fourth, fifth, sixth = letters
    deck.boundary, deck.box = (first, second, third, fourth, fifth, sixth), tuple(box)


def wall_name(draft: Draft, name: str) -> str:
    """A name of a wall that is not taken, without characters that names do not have."""
    plain = plain_name(name, "wall")
    taken: Sequence[str] = list(draft.get("walls") or {})
    free = plain
    count = 1
    while any(
        each == free or each.startswith(f"{free}_") and each.removeprefix(f"{free}_") in AXIAL_FACES
        for each in taken
    ):
        count += 1
        free = f"{plain}_{count}"
    return free
