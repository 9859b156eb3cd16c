"""Meshes of LIGGGHTS: fix mesh/surface with its modules, and the mass that passes a mesh."""

from dataclasses import dataclass, field, replace
from itertools import groupby
from math import pi, sqrt
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import ConvexHull, KDTree

from granflow.geometry.mesh_file import read_triangles
from granflow.importing.deck import Deck, Fix, Run, Translation, Vector, Words
from granflow.importing.heat import wall_temperature
from granflow.importing.language import Command, DeckError
from granflow.importing.materials import Property, material_of
from granflow.importing.report import Entry
from granflow.importing.scene_text import Draft, plain_name, quantities, quantity
from granflow.importing.schedule import stages_of, stages_of_runs
from granflow.io.files import FormatError

SAME_SPEED = 1e-3
"""Relative difference of speeds on the faces of a belt that is not reported."""
ROUND = 0.05
"""Largest share of a velocity across the faces, at which a mesh counts as a surface of revolution."""
FLAT = 1e-6
"""Smallest component of a unit vector that counts as one."""
ROUNDED = 1e-4
"""Error of the corners of a flat mesh over its size, from the few digits of text files."""


@dataclass
class Mesh:
    """One fix mesh/surface.

    unit:       length [m] of the unit of the script, which the file has as well
    steps:      scale, move and rotate in the order of the script: ("scale", s), ("move", v), ("rotate", axis,
                degrees)
    velocity:   of the surface [m/s]
    spin:       origin [m], axis and rate [rad/s] of a surface that turns along itself
    servo:      keywords of the module servo
    changes:    time [s] from which the servo has another target, in the unit of the script; None: at rest
    """

    path: Path
    type: int
    unit: float = 1.0
    steps: list[tuple[Any, ...]] = field(default_factory=list)
    velocity: Vector | None = None
    spin: tuple[Vector, Vector, float] | None = None
    servo: dict[str, Any] = field(default_factory=dict)
    changes: list[tuple[float, float | None]] = field(default_factory=list)
    measured: bool = False
    """Whether the forces on the mesh are computed."""
    worn: bool = False
    """Whether its wear is computed, by the model of Finnie."""

    def triangles(self) -> np.ndarray:
        """Triangles (n, 3, 3) [m] after the transformations of the script, in their order."""
        raw = read_triangles(self.path)
        triangles = raw.points[raw.corners] * self.unit
        for kind, *values in self.steps:
            if kind == "scale":
                triangles = triangles * values[0]
            elif kind == "move":
                triangles = triangles + np.array(values[0])
            else:
                triangles = triangles @ rotation(values[0], np.radians(values[1])).T
        return triangles


def wear_keys(deck: Deck, mesh: Mesh) -> dict[str, Any]:
    """Wear of a mesh by the formula of LIGGGHTS, whose k_finnie [1/Pa] is the coefficient over the hardness.

    Raises DeckError without k_finnie.
    """
    if not mesh.worn:
        return {}
    known: Property | None = deck.family.get("properties", {}).get("k_finnie")
    if known is None:
        fix = next(each for each in deck.all_fixes if each.data is mesh)
        raise DeckError(fix.entry.command, "wear finnie needs fix property/global k_finnie peratomtypepair.")
    found = {material_of(deck, each): known.of(mesh.type, each.type) for each in deck.particles}
    known.entry.translated("walls.NAME.wear.coefficient")
    coefficient = next(iter(found.values())) if len(set(found.values())) == 1 else found
    return {"wear": {"law": "finnie", "coefficient": coefficient, "hardness": "1 Pa"}}


def rotation(axis: Vector, angle: float) -> np.ndarray:
    """Matrix (3, 3) of a rotation by an angle [rad] about an axis through the origin."""
    x, y, z = np.array(axis) / np.linalg.norm(axis)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.asarray(np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross)


# The command fix mesh/surface

IGNORED = {
    "verbose": 1,
    "heal": 1,
    "curvature": 1,
    "curvature_tolerant": 1,
    "precision": 1,
    "min_feature_length": 1,
    "mass_temperature": 1,
    "stress": 1,
    "start_step_ave": 1,
}
"""Keywords of meshes without counterpart, because granflow does without, with the number of their words."""


def mesh_surface(deck: Deck, fix: Fix) -> None:
    """fix ID group mesh/surface[/stress[/servo]] file NAME type N [scale S] [move X Y Z] [rotate ...] ..."""
    words = Words(deck, fix.entry.command, fix.words)
    file, type = "", 0
    mesh = Mesh(Path(), 0, deck.si(1.0, "length"), measured="stress" in fix.style.split("/"))
    while words:
        key = words.word("a keyword")
        if key == "file":
            file = words.word("the file")
        elif key == "type":
            type = words.type()
        elif key == "scale":
            scale = words.number("the scale")
            if scale == 0.0:
                raise DeckError(words.command, "the scale is 0; give a number above 0, such as 0.001.")
            mesh.steps.append(("scale", scale))
        elif key == "move":
            mesh.steps.append(("move", words.vector("the displacement", "length")))
        elif key == "rotate":
            words.word("axis")
            axis = words.vector("the axis")
            if not any(axis):
                raise DeckError(words.command, "the axis is zero; give a direction, such as 0 0 1.")
            words.word("angle")
            mesh.steps.append(("rotate", axis, words.number("the angle")))
        elif key == "surface_vel":
            mesh.velocity = words.vector("the velocity of the surface", "velocity")
        elif key == "surface_ang_vel":
            mesh.spin = _spin(words)
        elif key == "reference_point":
            if any(words.vector("the reference point", "length")):
                fix.entry.approximated(
                    "torques of granflow are about the origin, or the point of the rotation of the wall"
                )
        elif key == "wear":
            model = words.word("the model of wear")
            mesh.worn = model == "finnie"
            if model not in ("finnie", "off"):
                fix.entry.impossible(f"the wear model {model}", "finnie, or walls.NAME.wear of the scene")
        elif key == "temperature":
            wall_temperature(deck, fix, words.plain("the temperature"))
        elif key == "element_exclusion_list":
            mode, name = words.word("read or write"), words.word("the file")
            if mode == "read":
                fix.entry.impossible(f"triangles left out by {name}", "a file without these triangles")
        elif key in IGNORED:
            for _ in range(IGNORED[key]):
                words.word(f"a value of {key}")
        elif key in SERVO:
            mesh.servo[key] = _servo_value(words, key)
        elif key == "fix":
            fix.entry.impossible("a mesh that another fix generates", "a file with the triangles")
            return
        elif key == "region":
            name = words.word("the name of a region")
            fix.entry.impossible(
                f"the triangles inside the region {name} only", "a file with these triangles"
            )
        else:
            fix.entry.impossible(f"the keyword {key} of a mesh")
            words.skip()
    if not file or not type:
        raise DeckError(words.command, "a mesh needs file NAME and type N.")
    mesh.path, mesh.type = deck.family["folder"] / file, type
    try:
        mesh.triangles()
    except FormatError as error:
        raise DeckError(words.command, f"{mesh.path} {error}.") from None
    for module in fix.style.split("/")[2:]:
        if module in MODULES:
            fix.entry.impossible(*MODULES[module])
    fix.data = mesh


MODULES = {
    "6dof": (
        "a rigid mesh that moves freely",
        "motion: {kind: free, direction: .., mass: ..} along one axis",
    ),
    "deform": ("a mesh that deforms", "a rigid mesh"),
    "liquidtransfer": ("liquid on walls", "a mesh without liquid"),
    "heattransfer": ("heat in walls", "a mesh without heat"),
}
"""Modules of meshes that are not possible, with the nearest alternative."""


def _spin(words: Words) -> tuple[Vector, Vector, float]:
    """origin X Y Z axis X Y Z omega W"""
    words.word("origin")
    origin = words.vector("the origin", "length")
    words.word("axis")
    axis = words.vector("the axis")
    words.word("omega")
    return origin, axis, words.number("omega", "angular_velocity")


SERVO = ("com", "ctrlPV", "axis", "target_val", "vel_max", "kp", "ki", "kd", "mode", "ratio")
"""Keywords of the module servo."""


def _servo_value(words: Words, key: str) -> Any:
    """The value of a keyword of the module servo."""
    if key in ("com", "axis"):
        return words.vector(key, "length" if key == "com" else "number")
    if key in ("ctrlPV", "mode"):
        return words.word(key)
    return words.number(key, "velocity" if key == "vel_max" else "number")


# Walls


def mesh_keys(draft: Draft, mesh: Mesh) -> dict[str, Any]:
    """The keys of a mesh wall without material: the file, scaled, rotated and moved as in the script.

    granflow scales, rotates and moves in this order; other orders are rewritten, as s (x + v) = s x + s v.
    """
    name = draft.add_file(mesh.path.name, mesh.path.read_bytes())
    scale = mesh.unit
    shift: np.ndarray = np.zeros(3)
    rotations: list[tuple[Vector, float]] = []
    for kind, *values in mesh.steps:
        if kind == "scale":
            scale *= values[0]
            shift = shift * values[0]
        elif kind == "move":
            shift = shift + np.array(values[0])
        else:
            rotations.append((values[0], values[1]))
            shift = rotation(values[0], np.radians(values[1])) @ shift
    if scale < 0.0:
        triangles = mesh.triangles()
        return {"shape": "mesh", "file": draft.add_file(f"{mesh.path.stem}.stl", stl(triangles))}
    keys: dict[str, Any] = {"shape": "mesh", "file": name}
    if scale != 1.0:
        keys["scale"] = float(f"{scale:.12g}")
    turns = [{"axis": [*axis], "angle": f"{angle:.12g} deg"} for axis, angle in rotations if angle]
    if turns:
        keys["rotate"] = turns[0] if len(turns) == 1 else turns
    if np.linalg.norm(shift) > 0.0:
        keys["translate"] = quantities([float(round(each, 12)) + 0.0 for each in shift], "length")
    return keys


def stl(triangles: np.ndarray) -> bytes:
    """Triangles (n, 3, 3) as text in the format STL."""
    rows = ["solid wall"]
    for corners in triangles:
        rows += ["facet normal 0 0 0", " outer loop"]
        rows += [f"  vertex {x:.9g} {y:.9g} {z:.9g}" for x, y, z in corners]
        rows += [" endloop", "endfacet"]
    return ("\n".join([*rows, "endsolid wall"]) + "\n").encode()


def surface_motions(deck: Deck, mesh: Fix, wall: str) -> list[dict[str, Any]]:
    """Motions of a mesh by its own keywords: a belt, a surface that turns, or a servo."""
    given: Mesh = mesh.data
    found: list[dict[str, Any]] = []
    if given.velocity is not None and any(given.velocity):
        _remark_on_belt(given, mesh)
        found.append({"kind": "surface_velocity", "velocity": quantities(given.velocity, "velocity")})
        mesh.entry.translated(f"walls.{wall}.motion")
    if given.spin is not None:
        found += _turning_surface(given, mesh, wall)
    if given.servo:
        found += _servo(deck, given, mesh, wall)
    return found


def _normals(triangles: np.ndarray) -> np.ndarray:
    edges = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    return np.asarray(edges / np.maximum(np.linalg.norm(edges, axis=1), 1e-300)[:, None])


def _remark_on_belt(given: Mesh, mesh: Fix) -> None:
    """LIGGGHTS gives each face that the belt is not across the full speed, granflow the component in it."""
    velocity = np.array(given.velocity)
    speed = np.linalg.norm(velocity)
    along = _normals(given.triangles()) @ velocity / speed
    share = np.sqrt(np.maximum(0.0, 1.0 - along**2))
    inclined = share[share > SAME_SPEED]
    difference = 1.0 - inclined.min(initial=1.0)
    if difference > SAME_SPEED:
        mesh.entry.approximated(
            f"on inclined faces the surface has the component of the velocity in the face, down to "
            f"{inclined.min():.3g} of {speed:.4g} m/s; LIGGGHTS gives all faces the whole speed"
        )


def _turning_surface(given: Mesh, mesh: Fix, wall: str) -> list[dict[str, Any]]:
    """A rotation, if the mesh is a surface of revolution about the axis."""
    assert given.spin is not None
    origin, axis, rate = given.spin
    triangles = given.triangles()
    velocity = np.cross(np.array(axis) / np.linalg.norm(axis), triangles.mean(axis=1) - np.array(origin))
    speed = np.linalg.norm(velocity, axis=1)
    across = np.abs((_normals(triangles) * velocity).sum(axis=1))
    if (across > ROUND * speed.max()).any():
        mesh.entry.impossible(
            "a mesh whose surface turns along itself and is no surface of revolution",
            "motion: {kind: rotation} of the mesh, or surface_velocity",
        )
        return []
    mesh.entry.translated(f"walls.{wall}.motion")
    mesh.entry.approximated("the facets turn with the surface; in the script they are at rest")
    point = quantities(origin, "length")
    rate_text = quantity(rate, "angular_velocity")
    return [{"kind": "rotation", "point": point, "axis": [*axis], "angular_velocity": rate_text}]


def _servo(deck: Deck, given: Mesh, mesh: Fix, wall: str) -> list[dict[str, Any]]:
    """The motion servo of a mesh with the module servo."""
    servo = given.servo
    if servo.get("ctrlPV") != "force":
        mesh.entry.impossible("a servo with a prescribed torque", "motion: {kind: rotation}, or a force")
        return []
    missing = [key for key in ("axis", "target_val", "vel_max") if key not in servo]
    if missing:
        raise DeckError(mesh.entry.command, f"a servo needs {' and '.join(missing)}.")
    found: list[dict[str, Any]] = []
    runs = deck.acting(mesh)
    for value, group in groupby(runs, lambda run: _target_in(given, run)):
        if value is None:
            continue
        target = deck.si(value, "force")
        if target == 0.0:
            mesh.entry.impossible("a servo with the force 0", "motion: {kind: free} with a small mass")
            return []
        sign = 1.0 if target > 0.0 else -1.0
        keys = {
            "kind": "servo",
            "direction": [sign * each for each in servo["axis"]],
            "force": quantity(abs(target), "force"),
            "velocity_max": quantity(servo["vel_max"], "velocity"),
        }
        stages = stages_of_runs(deck, list(group))
        found.append({**keys, **({} if stages is None else {"stages": stages})})
    if found:
        mesh.entry.translated(f"walls.{wall}.motion")
        mesh.entry.approximated(
            "the gain of the servo follows from the stiffness of the contacts, not from kp, ki and kd: the "
            "target force is equal, the way to it differs"
        )
    return found


def _target_in(given: Mesh, run: Run) -> float | None:
    """The target of a servo in a run, in the unit of the script; None if it is at rest."""
    target: float | None = given.servo["target_val"]
    for time, value in given.changes:
        if time <= run.start + run.slack:
            target = value
    return target


def fix_modify(deck: Deck, command: Command, entry: Entry) -> None:
    """fix_modify ID integrate start|stop | target_val F, of a servo; settings of output of other fixes."""
    words = Words(deck, command, command.words)
    fix = deck.fixes.get(words.word("the name of a fix"))
    if fix is None or not isinstance(fix.data, Mesh) or not fix.data.servo:
        words.skip()
        entry.not_needed("settings of printed energies")
        return
    target = _target_now(fix.data)
    while words:
        key = words.word("a keyword")
        if key == "integrate":
            is_on = words.word("start or stop") == "start"
            target = (_target_now(fix.data, at_rest=False)) if is_on else None
        elif key.endswith("target_val") and not words.next.startswith("v_"):
            target = words.plain("the target")
        else:
            entry.impossible(f"{key} {words.next} of a servo", "target_val with a number, or integrate start")
            words.skip()
            return
    fix.data.changes.append((deck.time, target))
    deck.own("changes", set).add(deck.time)
    entry.translated("walls.NAME.motion")


def _target_now(given: Mesh, at_rest: bool = True) -> float | None:
    """The target at the present line; with `at_rest` False the last one that is a number."""
    targets = [given.servo.get("target_val"), *(value for _, value in given.changes)]
    return targets[-1] if at_rest else next((each for each in reversed(targets) if each is not None), None)


def measure(draft: Draft, mesh: Fix, wall: str) -> None:
    """Measure the forces on a wall, for the module stress."""
    if mesh.data.measured:
        names = draft.get("output", "wall_forces") or []
        draft.put(("output", "wall_forces"), [*names, wall])
        mesh.entry.translated(f"output.wall_forces ({wall})")


# Mass that passes a mesh


@dataclass
class Massflow:
    """One fix massflow/mesh: the mesh, the direction of positive flow, whether particles are deleted."""

    mesh: Fix
    outside: Vector
    deletes: bool


def massflow(deck: Deck, fix: Fix) -> None:
    """fix ID group massflow/mesh mesh NAME vec_side X Y Z [count once|multiple] [delete_atoms yes|no] ..."""
    words = Words(deck, fix.entry.command, fix.words)
    words.word("the keyword mesh")
    mesh = words.mesh_with_triangles()
    outside: Vector | None = None
    point: Vector | None = None
    deletes, once, inside_out = False, False, False
    while words:
        key = words.word("a keyword")
        if key == "vec_side":
            outside = words.vector("the direction of the flow")
        elif key == "point_at_outlet":
            point = words.vector("the point at the outlet", "length")
        elif key == "count":
            once = words.word("once or multiple") == "once"
        elif key == "delete_atoms":
            deletes = words.flag("delete_atoms")
        elif key == "inside_out":
            inside_out = True
        elif key in ("file", "append", "screen"):
            words.word(f"a value of {key}")
        elif key.startswith("sieve"):
            fix.entry.impossible("a sieve with a probability of passage", "a mesh with holes")
            words.skip()
        elif key != "writeTime":
            fix.entry.impossible(f"the keyword {key} of massflow/mesh")
            words.skip()
    if outside is None and point is not None:
        center = mesh.data.triangles().reshape(-1, 3).mean(axis=0)
        x, y, z = (float(each) for each in (np.array(point) - center) * (-1.0 if inside_out else 1.0))
        outside = (x, y, z)
    if outside is None:
        raise DeckError(words.command, "the direction of the flow is missing: vec_side X Y Z.")
    if not any(outside):
        raise DeckError(
            words.command, "the direction of the flow is zero; give one, such as vec_side 0 0 -1."
        )
    if not deletes:
        fix.entry.approximated(
            "passages backward count negative"
            + ("; in the script each particle counts once" if once else "; in the script they do not count")
        )
    fix.data = Massflow(mesh, outside, deletes)


def build(deck: Deck, draft: Draft) -> None:
    """Write flow meters and outlets."""
    for fix in deck.fixes_of("massflow/mesh", "massflow/mesh/sieve"):
        if isinstance(fix.data, Massflow) and deck.acting(fix):
            _flow(deck, draft, fix, fix.data)
    for fix in deck.all_fixes:
        if isinstance(fix.data, Mesh) and not fix.entry.remarks:
            fix.entry.not_needed("no wall, insertion or flow uses the mesh")


def _flow(deck: Deck, draft: Draft, fix: Fix, given: Massflow) -> None:
    """The flow meter of a flat mesh, and the outlet behind it if particles are deleted."""
    face = flat_face(given.mesh.data, np.array(given.outside))
    if face is None:
        fix.entry.impossible(
            "the flow through a mesh that is not flat", "a flat mesh, or output.metrics of kind content"
        )
        return
    name = plain_name(fix.name, "flow")
    if face.difference:
        fix.entry.approximated(
            f"the face of the mesh is replaced by a disc of the same area: {face.difference}"
        )
    draft.put(("output", "flow_meters", name), face.meter(), fix.entry, given.mesh.entry)
    if stages_of(deck, fix) is not None:
        fix.entry.approximated("the flow meter counts all the time")
    if given.deletes:
        outlet, difference = face.outlet()
        draft.put(("outlets", name), outlet, fix.entry)
        fix.entry.approximated(difference)


@dataclass
class FlatFace:
    """A flat mesh: a rectangle with a corner and two sides, or a disc with a center and a radius."""

    point: np.ndarray
    normal: np.ndarray
    sides: np.ndarray | None
    radius: float
    size: float
    difference: str = ""

    def meter(self) -> dict[str, Any]:
        """The keys of a flow meter."""
        keys: dict[str, Any] = {
            "point": quantities(clean(self.point), "length"),
            "normal": clean(self.normal),
        }
        if self.sides is None:
            return {**keys, "radius": quantity(self.radius, "length")}
        return {**keys, "sides": [quantities(clean(each), "length") for each in self.sides]}

    def inlet(self) -> dict[str, Any]:
        """The keys of the face of an inlet."""
        if self.sides is not None:
            corner = quantities(clean(self.point), "length")
            sides = [quantities(clean(each), "length") for each in self.sides]
            return {"rectangle": {"corner": corner, "sides": sides}}
        disc = {"center": quantities(clean(self.point), "length"), "normal": clean(self.normal)}
        return {"disc": {**disc, "radius": quantity(float(f"{self.radius:.6g}"), "length")}}

    def extent(self) -> np.ndarray:
        """Smallest and largest coordinate [m] along each axis, (3, 2)."""
        if self.sides is None:
            across = self.radius * np.sqrt(np.maximum(0.0, 1.0 - self.normal**2))
            return np.stack([self.point - across, self.point + across], axis=1)
        first, second = self.sides
        corners = np.array([self.point + a * first + b * second for a in (0, 1) for b in (0, 1)])
        return np.stack([corners.min(axis=0), corners.max(axis=0)], axis=1)

    def room(self, direction: np.ndarray, box: np.ndarray) -> float:
        """Distance [m] by which the face can move along a unit vector within a box (3, 2); at least 0."""
        extent = self.extent()
        ways = [
            (box[k, 1] - extent[k, 1] if d > 0.0 else extent[k, 0] - box[k, 0]) / abs(d)
            for k, d in enumerate(direction)
            if abs(d) > FLAT
        ]
        return max(0.0, min(ways))

    def moved(self, distance: float) -> "FlatFace":
        """The face moved along its normal by a distance [m]."""
        return replace(self, point=self.point + distance * self.normal)

    def enlarged(self, margin: float, box: np.ndarray) -> "FlatFace":
        """The face with a margin [m] on all sides, as far as it remains in a box (3, 2)."""
        if self.sides is None:
            across = np.abs(self.normal) < 1.0 - FLAT
            room = min([margin, *np.abs(box - self.extent())[across].ravel()])
            return replace(self, radius=self.radius + max(0.0, room))
        point, sides = self.point.copy(), self.sides.copy()
        for k, side in enumerate(self.sides):
            unit = side / np.linalg.norm(side)
            before, after = (min(margin, self.room(d, box)) for d in (-unit, unit))
            point -= before * unit
            sides[k] = side + (before + after) * unit
        return replace(self, point=point, sides=sides)

    def within(self, box: np.ndarray) -> "FlatFace":
        """The face cut at a box (3, 2): a rectangle at its sides, a disc to a smaller one around its center.

        The face itself if its center is outside.
        """
        if self.sides is None:
            across = np.sqrt(np.maximum(0.0, 1.0 - self.normal**2))
            room = np.abs(box - self.point[:, None]).min(axis=1)
            inside = ((self.point > box[:, 0]) & (self.point < box[:, 1])).all()
            limits = room[across > FLAT] / across[across > FLAT]
            return replace(self, radius=min(self.radius, float(limits.min()))) if inside else self
        point, sides = self.point.copy(), self.sides.copy()
        for k, side in enumerate(self.sides):
            length = float(np.linalg.norm(side))
            axis = int(np.argmax(np.abs(side)))
            if abs(side[axis]) < (1.0 - FLAT) * length:
                continue  # not along an axis
            ends = np.clip([point[axis], point[axis] + side[axis]], *box[axis])
            if ends[0] == ends[1]:
                return self
            point[axis], sides[k] = ends[0], side / side[axis] * (ends[1] - ends[0])
        return replace(self, point=point, sides=sides)

    def outlet(self) -> tuple[dict[str, Any], str]:
        """The keys of an outlet behind the face, and how it differs."""
        axis = int(np.argmax(np.abs(self.normal)))
        level = abs(self.normal[axis]) > 1.0 - 1e-9
        sides = self.sides
        if (
            sides is not None
            and level
            and all(np.count_nonzero(np.abs(s) > 1e-9 * self.size) == 1 for s in sides)
        ):
            corners = np.array([self.point, self.point + sides[0] + sides[1]])
            low, high = corners.min(axis=0), corners.max(axis=0)
            depth = self.size
            if self.normal[axis] > 0.0:
                high[axis] += depth
            else:
                low[axis] -= depth
            box = {"min": quantities(clean(low), "length"), "max": quantities(clean(high), "length")}
            return {"box": box}, f"particles are deleted in a box of {depth:.3g} m behind the mesh"
        center = self.point if sides is None else self.point + 0.5 * (sides[0] + sides[1])
        radius = self.radius if sides is None else 0.5 * float(np.linalg.norm(sides[0] + sides[1]))
        disc = {"center": quantities(clean(center), "length"), "normal": clean(self.normal)}
        text = (
            "particles are deleted everywhere behind the disc around the mesh, in the direction of the flow"
        )
        return {"disc": {**disc, "radius": quantity(radius, "length")}}, text


def flat_face(mesh: Mesh, outside: np.ndarray) -> FlatFace | None:
    """The face of a flat mesh with the normal toward `outside`; None if it is not flat.

    A rectangle or a disc if the mesh is one, otherwise a disc of the same area.
    """
    triangles = mesh.triangles()
    edges = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    areas = 0.5 * np.linalg.norm(edges, axis=1)
    normal = edges[np.argmax(areas)] / np.linalg.norm(edges[np.argmax(areas)])
    normal = normal if normal @ outside >= 0.0 else -normal
    points = _distinct(triangles.reshape(-1, 3))
    center = points.mean(axis=0)
    distance = np.linalg.norm(points - center, axis=1)
    size = float(distance.max())
    if np.abs((points - center) @ normal).max() > ROUNDED * size:
        return None
    area = float(areas.sum())
    around = _rectangle_around(points, normal)
    if abs(np.linalg.norm(np.cross(*around[1])) / area - 1.0) < ROUNDED:
        return FlatFace(around[0], normal, around[1], 0.0, size)
    radius = sqrt(area / pi)
    weight = areas[:, None] / area
    center = (triangles.mean(axis=1) * weight).sum(axis=0)
    difference = ""
    if abs(size / radius - 1.0) > 0.05:
        difference = f"radius {radius:.3g} m, farthest corner of the mesh {size:.3g} m"
    return FlatFace(center, normal, None, radius, size, difference)


def _rectangle_around(points: np.ndarray, normal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A corner and two sides (2, 3) of the smallest rectangle around points (n, 3) of a plane.

    One of its sides is along an edge of the convex hull; the sides turn around the normal.
    """
    first = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
    plane = np.array([first, np.cross(normal, first)]) / np.linalg.norm(first)
    flat = points @ plane.T
    edges = np.diff(flat[ConvexHull(flat).simplices], axis=1)[:, 0]
    found = []
    for along in edges / np.linalg.norm(edges, axis=1)[:, None]:
        axes = np.array([along, [-along[1], along[0]]])
        low, high = (flat @ axes.T).min(axis=0), (flat @ axes.T).max(axis=0)
        found.append((float(np.prod(high - low)), low @ axes, (high - low)[:, None] * axes))
    _, corner, sides = min(found, key=lambda each: each[0])
    return corner @ plane + (points[0] @ normal) * normal, sides @ plane


def _distinct(points: np.ndarray) -> np.ndarray:
    """The points (n, 3) without those that differ from an earlier one by the rounding of text files only."""
    tree = KDTree(points)
    near = tree.query_ball_point(points, ROUNDED * float(np.ptp(points, axis=0).max()))
    return np.asarray(points[[k for k, each in enumerate(near) if min(each) == k]])


def clean(values: Any) -> list[float]:
    """Numbers without rounding errors of transformations."""
    return [float(round(each, 10)) + 0.0 for each in values]


# Tables

_MESH = Translation(
    mesh_surface,
    "walls.NAME (shape: mesh)",
    "scale, move, rotate, surface_vel; surface_ang_vel of surfaces of revolution",
)
_STRESS = Translation(
    mesh_surface, "walls.NAME (shape: mesh), walls.NAME.wear, output.wall_forces", "wear finnie"
)

COMMANDS: dict[str, Translation] = {
    "fix_modify": Translation(
        fix_modify,
        "walls.NAME.motion (stages of a servo)",
        "integrate, target_val; other settings not needed",
    ),
}
FIXES: dict[str, Translation] = {
    "mesh/surface": _MESH,
    "mesh/surface/planar": _MESH,
    "mesh/surface/stress": _STRESS,
    "mesh/surface/stress/servo": Translation(
        mesh_surface, "walls.NAME.motion (kind: servo)", "force; gain and velocity of approach differ"
    ),
    "mesh/surface/stress/contact": _STRESS,
    "mesh/surface/stress/6dof": Translation(mesh_surface, "not possible", "nearest: motion (kind: free)"),
    "mesh/surface/stress/deform": Translation(mesh_surface, "not possible", "a rigid mesh"),
    "mesh/surface/heattransfer": Translation(mesh_surface, "not possible", "a mesh without heat"),
    "massflow/mesh": Translation(
        massflow,
        "output.flow_meters, outlets (delete_atoms)",
        "flat meshes; passages backward count negative",
    ),
    "massflow/mesh/sieve": Translation(massflow, "not possible", "a mesh with holes"),
}
