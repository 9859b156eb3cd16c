"""Motions of walls: fix move/mesh, and regions that variables move.

A `Move` is a fix move/mesh; `mesh_motions` writes the moves of one mesh, `region_motions` those of a region.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from math import cos, degrees, hypot, pi, radians, sin
from typing import Any

import numpy as np

from granflow.importing.deck import Deck, Fix, Run, Translation, Vector, Words
from granflow.importing.language import DeckError
from granflow.importing.meshes import rotation
from granflow.importing.regions import RegionMotion, Track, track_variables
from granflow.importing.scene_text import Draft, number, quantities, quantity
from granflow.importing.schedule import STAGED, stages_of

ROWS_PER_PERIOD = 100
"""Rows of a table of an oscillating rotation in its shortest period."""
MOST_TABLE_ROWS = 8000
"""Largest number of rows of a table that is written."""
MOST_SEGMENTS = 8
"""Number of pieces of constant velocity above which a motion becomes a table."""
SAME_RATE = 1e-6
"""Difference of two rates over the largest at which they are equal."""


@dataclass
class Move:
    """One fix move/mesh.

    mesh:          name of the mesh
    parts:         motions along lines, without stages
    displacement:  displacement [m] after a time [s] since the fix
    point, axis:   of a rotation
    angle:         angle [rad] of a rotation after a time [s]; None for a translation
    rate:          constant angular velocity [rad/s]; None if the angle is no linear function
    period:        shortest period [s] of an oscillating rotation
    track:         variables of a velocity or an angular velocity
    """

    mesh: str
    parts: list[dict[str, Any]]
    displacement: Callable[[float], np.ndarray]
    point: Vector = (0.0, 0.0, 0.0)
    axis: Vector | None = None
    angle: Callable[[float], float] | None = None
    rate: float | None = None
    period: float = 0.0
    track: Track | None = None


def _nowhere(time: float) -> np.ndarray:
    return np.zeros(3)


def move_mesh(deck: Deck, fix: Fix) -> None:
    """fix ID group move/mesh mesh NAME STYLE ..."""
    words = Words(deck, fix.entry.command, fix.words)
    if words.word("the keyword mesh") != "mesh":
        raise DeckError(fix.entry.command, "the mesh is missing: move/mesh mesh NAME STYLE ...")
    name = words.mesh().name
    style = words.word("the style of the motion")
    if style not in STYLES:
        fix.entry.impossible(f"the motion {style}", f"one of {', '.join(STYLES)}; or a table")
        return
    fix.data = STYLES[style](deck, fix, words, name)
    if words:
        fix.entry.impossible(f"the keyword {words.next} of move/mesh {style}")


def _expect(words: Words, *keywords: str) -> None:
    """Read keywords that must follow. Raises DeckError."""
    for each in keywords:
        if words.word(each) != each:
            raise DeckError(words.command, f"{each} is expected in place of {words.words[words.at - 1]}.")


def _period(words: Words) -> float:
    period = words.number("the period", "time")
    if period <= 0.0:
        raise DeckError(words.command, f"the period is {period:g} s; give a time above 0.")
    return period


def _axis(words: Words) -> Vector:
    axis = words.vector("the axis")
    if not any(axis):
        raise DeckError(words.command, "the axis is zero; give a direction, such as 0 0 1.")
    return axis


def _origin_and_axis(words: Words) -> tuple[Vector, Vector]:
    """The point [m] and the unit vector of the axis of a rotation: `origin x y z axis x y z`."""
    _expect(words, "origin")
    point = words.vector("the origin", "length")
    _expect(words, "axis")
    return point, _axis(words)


def _linear(deck: Deck, fix: Fix, words: Words, mesh: str) -> Move:
    velocity = words.vector("the velocity", "velocity")
    part = {"kind": "translation", "velocity": quantities(velocity, "velocity")}
    return Move(mesh, [part] if any(velocity) else [], lambda t: t * np.array(velocity))


def _linear_variable(deck: Deck, fix: Fix, words: Words, mesh: str) -> Move:
    names = tuple(words.word("the variable of a velocity").removeprefix("v_") for _ in range(3))
    track = Track(names, fix.entry)
    track_variables(deck, track, lambda: fix.end is None)
    return Move(mesh, [], _nowhere, track=track)


def _wiggle(deck: Deck, fix: Fix, words: Words, mesh: str) -> Move:
    _expect(words, "amplitude")
    amplitude = np.array(words.vector("the amplitude", "length"))
    _expect(words, "period")
    omega = 2.0 * pi / _period(words)
    parts = [vibration(amplitude, omega, 0.0)] if amplitude.any() else []
    return Move(mesh, parts, lambda t: amplitude * sin(omega * t))


def vibration(amplitude: np.ndarray, omega: float, phase: float) -> dict[str, Any]:
    """The motion A (sin(w t + phase) - sin(phase)) with a vector A [m]."""
    length = float(np.linalg.norm(amplitude))
    keys: dict[str, Any] = {
        "kind": "vibration",
        "direction": [float(f"{each:.12g}") + 0.0 for each in amplitude / length],
        "amplitude": quantity(length, "length"),
        "frequency": f"{number(omega / (2.0 * pi))} Hz",
    }
    if phase:
        keys["phase"] = f"{number(degrees(phase))} deg"
    return keys


def _rotate(deck: Deck, fix: Fix, words: Words, mesh: str) -> Move:
    point, axis = _origin_and_axis(words)
    _expect(words, "period")
    period = words.number("the period", "time")
    if period == 0.0:
        raise DeckError(words.command, "the period is 0; give a time, negative to turn the other way.")
    rate = 2.0 * pi / period
    return Move(mesh, [], _nowhere, point, axis, lambda t: rate * t, rate)


def _rotate_variable(deck: Deck, fix: Fix, words: Words, mesh: str) -> Move:
    point, axis = _origin_and_axis(words)
    _expect(words, "omega")
    track = Track((words.word("the variable of the angular velocity").removeprefix("v_"),), fix.entry)
    track_variables(deck, track, lambda: fix.end is None)
    return Move(mesh, [], _nowhere, point, axis, track=track)


def _riggle(deck: Deck, fix: Fix, words: Words, mesh: str) -> Move:
    point, axis = _origin_and_axis(words)
    _expect(words, "period")
    period = _period(words)
    _expect(words, "amplitude")
    amplitude = radians(words.number("the amplitude"))
    return Move(
        mesh, [], _nowhere, point, axis, lambda t: amplitude * sin(2.0 * pi * t / period), period=period
    )


def _series(words: Words, dimension: str) -> list[tuple[float, float, float]]:
    """Amplitude, angular frequency and phase of each term of a trigonometric series."""
    _expect(words, "order")
    order = words.whole("the order")
    _expect(words, "amplitude")
    amplitudes = [words.number("an amplitude", dimension) for _ in range(order)]
    _expect(words, "phase")
    phases = [words.number("a phase") for _ in range(order)]
    _expect(words, "period")
    periods = [_period(words) for _ in range(order)]
    return [(a, 2.0 * pi / t, p) for a, t, p in zip(amplitudes, periods, phases, strict=True)]


def _sum_of(terms: list[tuple[float, float, float]], time: float) -> float:
    return sum(a * (cos(w * time + p) - cos(p)) for a, w, p in terms)


def _viblin(deck: Deck, fix: Fix, words: Words, mesh: str) -> Move:
    _expect(words, "axis")
    axis = np.array(_axis(words))
    axis = axis / np.linalg.norm(axis)
    terms = _series(words, "length")
    # cos(w t + p) = sin(w t + p + pi/2)
    parts = [vibration(a * axis, w, p + 0.5 * pi) for a, w, p in terms if a]
    return Move(mesh, parts, lambda t: axis * _sum_of(terms, t))


def _vibrot(deck: Deck, fix: Fix, words: Words, mesh: str) -> Move:
    point, axis = _origin_and_axis(words)
    terms = _series(words, "number")
    period = min(2.0 * pi / w for _, w, _ in terms)
    return Move(mesh, [], _nowhere, point, axis, partial(_sum_of, terms), period=period)


STYLES: dict[str, Callable[[Deck, Fix, Words, str], Move]] = {
    "linear": _linear,
    "linear/variable": _linear_variable,
    "wiggle": _wiggle,
    "rotate": _rotate,
    "rotate/variable": _rotate_variable,
    "riggle": _riggle,
    "viblin": _viblin,
    "vibrot": _vibrot,
}
"""Reader of each style of move/mesh."""


# Motions of particles


def move_particles(deck: Deck, fix: Fix) -> None:
    """fix ID group move linear VX VY VZ | wiggle AX AY AZ T | rotate PX PY PZ RX RY RZ T [units box]"""
    words = Words(deck, fix.entry.command, fix.words)
    style = words.word("the style of the motion")
    if style not in ("linear", "wiggle", "rotate") or "NULL" in fix.words:
        words.skip()
        fix.entry.impossible(f"the motion {style} of particles", "linear, wiggle or rotate, or a table")
        return
    if style == "linear":
        fix.data = _linear(deck, fix, words, "")
    elif style == "wiggle":
        amplitude = np.array(words.vector("the amplitude", "length"))
        omega = 2.0 * pi / _period(words)
        parts = [vibration(amplitude, omega, 0.0)] if amplitude.any() else []
        fix.data = Move("", parts, lambda t: amplitude * sin(omega * t))
    else:
        point = words.vector("the point", "length")
        axis = _axis(words)
        rate = 2.0 * pi / _period(words)
        fix.data = Move("", [], _nowhere, point, axis, lambda t: rate * t, rate)
    if words and [words.word("a keyword"), words.word("box or lattice")] != ["units", "box"]:
        fix.entry.impossible("lengths of a motion in units of a lattice", "units box")


def carry(deck: Deck, draft: Draft) -> None:
    """A wall for each fix move of particles, which they follow.

    It is a small disc in the center of one of them, so that no other particle touches it.
    """
    particles = draft.get("particles") or {}
    for wall, (fix, center, radius) in deck.own("carriers", dict).items():
        names = [name for name, group in particles.items() if group.get("fixed") == {"to": wall}]
        if not names:
            continue
        move: Move = fix.data
        parts = move.parts
        if move.axis is not None and move.rate is not None:
            place = {"point": quantities(move.point, "length"), "axis": [*move.axis]}
            parts = [
                {"kind": "rotation", **place, "angular_velocity": quantity(move.rate, "angular_velocity")}
            ]
        keys = {
            "shape": "disc",
            "center": quantities(center.tolist(), "length"),
            "normal": [0, 0, 1],
            "radius": quantity(CARRIER_SHARE * radius, "length"),
            "material": particles[names[0]]["material"],
        }
        motion = [{**part, **_when(deck, fix)} for part in parts]
        draft.put(("walls", wall), {**keys, **({"motion": motion} if motion else {})}, fix.entry)
        draft.remark(("walls", wall), remark="moves particles, and lies inside one of them")


CARRIER_SHARE = 0.1
"""Radius of the disc that moves particles over that of the particle in which it lies: other particles, which
overlap with this one by at most 0.8 of the radius, do not touch it."""


# Motions of a mesh


def mesh_motions(deck: Deck, draft: Draft, mesh: Fix, wall: str) -> list[dict[str, Any]]:
    """The key motion of a mesh, from all fixes move/mesh that move it.

    A later mesh of the same name, such as that of the next script, has its own moves.
    """
    moves = [
        each
        for each in deck.fixes_of("move/mesh")
        if isinstance(each.data, Move) and each.data.mesh == mesh.name and deck.acting(each)
    ]
    moves = [
        each
        for each in moves
        if each.start >= mesh.start - 1e-12 and (mesh.end is None or each.start < mesh.end - 1e-12)
    ]
    motions: list[dict[str, Any]] = []
    turns: list[Fix] = []
    for fix in moves:
        move: Move = fix.data
        when = _when(deck, fix)
        if move.axis is not None:
            turns.append(fix)
            continue
        if move.track is not None:
            motions += _velocities(deck, draft, fix, move.track, when, wall)
        motions += [{**part, **when} for part in move.parts]
        fix.entry.translated(f"walls.{wall}.motion")
    return motions + _turns(deck, draft, turns, moves, wall)


def _when(deck: Deck, fix: Fix) -> dict[str, Any]:
    stages = stages_of(deck, fix)
    return {} if stages is None else {"stages": stages}


def _length(deck: Deck, fix: Fix) -> float:
    """Time [s] during which a fix acts."""
    return sum(run.end - run.start for run in deck.acting(fix))


def _velocities(
    deck: Deck, draft: Draft, fix: Fix, track: Track, when: dict[str, Any], wall: str
) -> list[dict[str, Any]]:
    """Motions along x, y and z with velocities of variables."""
    times, values = track.over(deck.acting(fix))
    found = []
    for k, axis in enumerate(np.eye(3, dtype=int).tolist()):
        if not len(times) or not values[:, k].any():
            continue
        velocities = values[:, k] * deck.si(1.0, "velocity")
        if np.ptp(velocities) <= SAME_RATE * np.abs(velocities).max():
            velocity = [float(velocities[0]) * each for each in axis]
            found.append({"kind": "translation", "velocity": quantities(velocity, "velocity"), **when})
            continue
        file = table(draft, f"{wall}_{'xyz'[k]}", "velocity [m/s]", times, velocities)
        found.append({"kind": "table", "file": file, "direction": axis, **when})
    return found


def _turns(deck: Deck, draft: Draft, turns: list[Fix], moves: list[Fix], wall: str) -> list[dict[str, Any]]:
    """The rotations of a wall, each in the frame of those before it.

    In LIGGGHTS the axis of a rotation is carried along by the fixes before it, but keeps its direction in
    space, as that of a chain does if the axes are parallel or the earlier rotation has ended.
    """
    found: list[dict[str, Any]] = []
    chain: list[tuple[Fix, np.ndarray, np.ndarray]] = []
    for fix in turns:
        point, axis = np.array(_at_rest(deck, fix, moves)), _unit(fix.data.axis)
        for before, center, direction in chain:
            inverse = rotation(tuple(direction), -_angle(deck, before, fix.start))
            point, axis = inverse @ (point - center) + center, inverse @ axis
        across = [each for each, _, _ in chain if not _is_parallel(each, fix) and _overlap(each, fix)]
        if across:
            fix.entry.impossible(
                f"a rotation during that of fix {across[0].name}, about an axis that is not parallel to it",
                "rotations one after the other, or about parallel axes",
            )
            continue
        chain.append((fix, point, axis))
        fix.entry.translated(f"walls.{wall}.motion")
        _remark_on_later_moves(deck, fix, moves)
        place = {
            "point": quantities([float(round(each, 12)) + 0.0 for each in point], "length"),
            "axis": [float(f"{round(each, 14):.12g}") + 0.0 for each in axis.tolist()],
        }
        if fix.data.rate is not None:
            rate = quantity(fix.data.rate, "angular_velocity")
            found.append({"kind": "rotation", **place, "angular_velocity": rate, **_when(deck, fix)})
            continue
        times, rates = _rates(deck, fix)
        name = f"{wall}_rotation" if len(turns) == 1 else f"{wall}_rotation_{len(chain)}"
        file = table(draft, name, "angular_velocity [rad/s]", times, rates)
        start = {"start": quantity(times[0], "time")} if times[0] else {}
        found.append({"kind": "table", "file": file, **place, **start})
    return found


def _unit(axis: Vector) -> np.ndarray:
    return np.array(axis) / hypot(*axis)


def _is_parallel(first: Fix, second: Fix) -> bool:
    return bool(abs(abs(_unit(first.data.axis) @ _unit(second.data.axis)) - 1.0) < 1e-9)


def _overlap(first: Fix, second: Fix) -> bool:
    """Whether two fixes act at the same time."""
    return (first.end is None or first.end > second.start) and (
        second.end is None or second.end > first.start
    )


def _angle(deck: Deck, turn: Fix, time: float) -> float:
    """Angle [rad] by which a rotation has turned until a time [s]."""
    move: Move = turn.data
    end = time if turn.end is None else min(turn.end, time)
    if move.track is not None:
        return float(_integral(deck, turn, end)[0] * deck.si(1.0, "angular_velocity"))
    assert move.angle is not None
    return move.angle(end - turn.start)


def _at_rest(deck: Deck, turn: Fix, moves: list[Fix]) -> Vector:
    """The point of a rotation in the frame of the mesh at rest: without the translations before."""
    shift = np.zeros(3)
    for fix in moves:
        if fix.data.axis is None and fix.start < turn.start:
            end = turn.start if fix.end is None else min(fix.end, turn.start)
            shift += fix.data.displacement(end - fix.start)
            if fix.data.track is not None:
                shift += _integral(deck, fix, end) * deck.si(1.0, "velocity")
    x, y, z = (float(round(each, 12)) + 0.0 for each in np.array(turn.data.point) - shift)
    return x, y, z


def _integral(deck: Deck, fix: Fix, end: float) -> np.ndarray:
    """Integral over time [s] of the variables of a motion until a time [s], in the units of the script."""
    times, values = fix.data.track.over([run for run in deck.acting(fix) if run.start < end - run.slack])
    middle = 0.5 * (values[1:] + values[:-1])
    return np.asarray((middle * np.diff(times)[:, None]).sum(axis=0))


def _remark_on_later_moves(deck: Deck, turn: Fix, moves: list[Fix]) -> None:
    """Remark on translations during a rotation, across its axis and given after it: here they move it."""
    index = deck.all_fixes.index(turn)
    axis = _unit(turn.data.axis)
    for fix in moves:
        is_later = fix.data.axis is None and deck.all_fixes.index(fix) > index and _overlap(fix, turn)
        ways = [fix.data.displacement(share * _length(deck, fix)) for share in (0.23, 0.51, 1.0)]
        if is_later and (
            fix.data.track is not None
            or any(np.linalg.norm(np.cross(each, axis)) > 1e-9 * np.linalg.norm(each) for each in ways)
        ):
            turn.entry.approximated(
                f"the axis moves with the translation of fix {fix.name}; in the script it is at rest"
            )


def _rates(deck: Deck, fix: Fix) -> tuple[np.ndarray, np.ndarray]:
    """Times [s] and angular velocities [rad/s] of a rotation that is not uniform."""
    move: Move = fix.data
    runs = deck.acting(fix)
    start, end = runs[0].start, runs[-1].end
    if move.track is not None:
        times, values = move.track.over(runs)
        return times, values[:, 0] * deck.si(1.0, "angular_velocity")
    assert move.angle is not None
    count = int(ROWS_PER_PERIOD * (end - start) / move.period) + 2
    if count > MOST_TABLE_ROWS:
        count = MOST_TABLE_ROWS
        per_period = count * move.period / (end - start)
        fix.entry.approximated(
            f"the table of the motion has {per_period:.3g} rows per period; its velocities differ by up "
            f"to {100 * (2.0 * pi / per_period) ** 2 / 8:.2g} %"
        )
    times = np.linspace(start, end, count)
    step = 0.01 * (times[1] - times[0])
    rates = [(move.angle(t - start + step) - move.angle(t - start - step)) / (2 * step) for t in times]
    return times, np.array(rates)


def table(draft: Draft, name: str, column: str, times: np.ndarray, values: np.ndarray) -> str:
    """Write a table of a motion beside the scene, with times from 0, and return its name."""
    stride = -(-len(times) // MOST_TABLE_ROWS)
    kept = sorted({*range(0, len(times), stride), len(times) - 1})
    lines = [f"time [s], {column}"]
    last = -1.0
    for k in kept:
        time = float(times[k] - times[0])
        if time > last:
            lines.append(f"{time:.12g}, {float(values[k]):.12g}")
            last = time
    return draft.add_file(f"{name}.csv", ("\n".join(lines) + "\n").encode())


# Motions of a region


@dataclass
class Pose:
    """Where a region is when an episode begins: turned by `angle` [rad] about its axis, then moved."""

    angle: float
    shift: np.ndarray


def region_motions(
    deck: Deck, draft: Draft, motion: RegionMotion, runs: Sequence[Run], when: dict[str, Any], wall: str
) -> tuple[Pose, list[dict[str, Any]]]:
    """The pose of a region at the start of some runs, and the key motion of its walls from then on."""
    times, values = motion.over(list(runs))
    if not len(times):
        return Pose(0.0, np.zeros(3)), []
    length = deck.si(1.0, "length")
    shift = values[0, :3] * length
    motions: list[dict[str, Any]] = []
    for k, axis in enumerate(np.eye(3, dtype=int).tolist()):
        for start, end, rate in _segments(times, values[:, k] * length):
            velocity = [rate * each for each in axis]
            part = {"kind": "translation", "velocity": quantities(velocity, "velocity")}
            motions.append({**part, **_between(start, end, times, when)})
        if _is_curved(times, values[:, k]):
            file = table(draft, f"{wall}_{'xyz'[k]}", "displacement [m]", times, values[:, k] * length)
            motions.append({"kind": "table", "file": file, "direction": axis, **when})
    angles = values[:, 3]
    axis = np.array(motion.axis) / hypot(*motion.axis)
    point = [float(each) for each in np.array(motion.point) + shift]
    place = {"point": quantities(point, "length"), "axis": [float(f"{each:.12g}") + 0.0 for each in axis]}
    segments = _segments(times, angles)
    if len(segments) == 1:
        start, end, rate = segments[0]
        keys = {"kind": "rotation", **place, "angular_velocity": quantity(rate, "angular_velocity")}
        motions.append({**keys, **_between(start, end, times, when)})
    elif segments or _is_curved(times, angles):
        file = table(draft, f"{wall}_rotation", "angle [rad]", times, angles)
        motions.append({"kind": "table", "file": file, **place, **when})
    return Pose(float(angles[0]), shift), motions


def _between(start: float, end: float, times: np.ndarray, when: dict[str, Any]) -> dict[str, Any]:
    """The keys of the time of a motion: those of the wall if it moves all the time."""
    slack = 1e-6 * (times[-1] - times[0])
    if start <= times[0] + slack and end >= times[-1] - slack:
        return when
    keys: dict[str, Any] = {"start": quantity(start, "time")} if start > 0.0 else {}
    return {**keys, "end": quantity(end, "time")}


def _pieces(times: np.ndarray, values: np.ndarray) -> list[tuple[float, float, float]]:
    """Begin, end and rate of pieces of constant rate."""
    later = np.diff(times) > 0.0
    starts, ends = times[:-1][later], times[1:][later]
    rates = np.diff(values)[later] / (ends - starts)
    largest = np.abs(rates).max(initial=0.0)
    found: list[tuple[float, float, float]] = []
    for start, end, rate in zip(starts.tolist(), ends.tolist(), rates.tolist(), strict=True):
        if found and abs(found[-1][2] - rate) <= SAME_RATE * largest:
            found[-1] = (found[-1][0], end, found[-1][2])
        else:
            found.append((start, end, rate))
    return [each for each in found if abs(each[2]) > SAME_RATE * largest]


def _is_curved(times: np.ndarray, values: np.ndarray) -> bool:
    return len(_pieces(times, values)) > MOST_SEGMENTS


def _segments(times: np.ndarray, values: np.ndarray) -> list[tuple[float, float, float]]:
    """Pieces of constant rate; none for a curved course."""
    return [] if _is_curved(times, values) else _pieces(times, values)


# Tables

FIXES: dict[str, Translation] = {
    "move/mesh": Translation(move_mesh, "walls.NAME.motion", f"{', '.join(STYLES)}; several form a chain"),
    "move": Translation(
        move_particles, "particles.NAME.fixed: {to: WALL}", "linear, wiggle and rotate of given positions"
    ),
}
COMMANDS: dict[str, Translation] = {}
STAGED.update(("move", "move/mesh"))
