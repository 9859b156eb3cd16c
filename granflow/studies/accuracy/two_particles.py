"""Two particles that collide head-on, with every contact model, precision and time step: errors and cost.

A study line is one contact model with one precision. `measured_line` simulates it on the collision bench: all
kinds of collision (restitutions and velocities) simultaneously, once for each number of steps per collision.
The diameters make all collisions last equally long, so that one time step has the same number of steps in
every collision. The points of a line are the errors relative to the exact solutions, and the processor time.
`granflow.studies.accuracy.report` derives orders and recommendations from them, and writes the files.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from math import ceil
from time import process_time
from typing import Any

import numpy as np

from granflow import Plan, SceneError, plan_for
from granflow.contact import theory
from granflow.scene.blocks.materials import Material
from granflow.studies.bench import FORCES_TO_END, Collision, HeadOnCollision, head_on_bench, share_to_end
from granflow.studies.figures import attribute_columns
from granflow.studies.paper.figures import PaperCase

# ---------------------------------------------------------------- what is varied

PRECISIONS = ("f64", "mixed", "f32")
"""Precisions of the study, the most accurate first."""
STEPS = (5, 7, 10, 14, 20, 28, 40, 56, 80, 112, 160, 320, 640, 1250, 2500, 5000)
"""Steps per collision: duration of the collision over the time step."""
FULL_STEPS = tuple(float(f"{steps:.3g}") for steps in np.geomspace(5.0, 5000.0, 31))
"""Steps per collision of the full study, ten per decade."""
VELOCITIES = (0.1, 1.0, 5.0)
"""Approach velocities [m/s]."""
RESTITUTIONS = (0.2, 0.5, 0.9)
"""Target restitutions of the contact models with dissipation."""
PHASES = 32
"""Collisions of each kind; their times of first contact are evenly spaced over one step."""
DIAMETER = 5e-3
"""Diameter [m] of the reference particle; its elastic collision at 1 m/s sets the duration of all
collisions."""
YOUNG_MODULUS = 50e6
"""Young's modulus of the particles [Pa]: glass, softened as in the example scenes.

Stiffer particles overlap less, so that single precision resolves fewer digits of the overlap.
"""
DISTANCE = 60e-3
"""Distance of the collisions from the origin [m].

Representative of a hopper: single precision resolves fewer digits of the overlap at this distance.
"""


@dataclass(frozen=True)
class StudiedLaw:
    """A contact model of the study: its label, its `contact.normal` in a scene, and the restitutions to
    reproduce.

    `normal`: name of the contact model, or a mapping with `law` and its parameters.
    """

    name: str
    normal: Any
    restitutions: tuple[float, ...]

    @property
    def law_name(self) -> str:
        """Name of the contact model in the catalog."""
        return str(self.normal if isinstance(self.normal, str) else self.normal["law"])


STUDIED_LAWS = (
    StudiedLaw("zhou", "zhou", RESTITUTIONS),
    StudiedLaw("hertz", "hertz", RESTITUTIONS),
    StudiedLaw("linear", {"law": "linear", "stiffness": "onset"}, RESTITUTIONS),
    StudiedLaw("hertz, elastic", "hertz", (1.0,)),
)
"""Contact models of the study; an elastic contact separates errors of the integration from those of
damping."""


def reference_case() -> PaperCase:
    """Two particles of softened glass, with the diameter DIAMETER [m] and Young's modulus YOUNG_MODULUS [Pa].

    Density and Poisson ratio are those of the preset glass.
    """
    solid = Material.model_validate({"preset": "glass", "young_modulus": YOUNG_MODULUS})
    return PaperCase(
        "glass", "glass", solid, {"preset": "glass", "young_modulus": YOUNG_MODULUS}, diameter=DIAMETER
    )


def common_duration() -> float:
    """Duration of every collision of the study [s]: that of an elastic collision of the reference case at 1
    m/s.

    It is Zhou's duration (2011, Eq. 13) with e = 1.
    """
    return reference_case().duration(1.0, 1.0)


# ---------------------------------------------------------------- exact solutions


@dataclass(frozen=True)
class Exact:
    """Exact solution of a collision.

    Restitution, duration [s], time of the maximum overlap after first contact [s], maximum overlap [m];
    overlap at which the force vanishes during unloading over the maximum, None where it depends on a dashpot.
    """

    restitution: float
    duration: float
    peak_time: float
    overlap_max: float
    end_ratio: float | None


def zhou(e: float, k: float, mass: float, velocity: float) -> Exact:
    """Zhou's model (Zhou 2011, Eqs. 5 and 13-15); `k` Hertz stiffness [N/m^1.5], `mass` effective [kg].

    A contact ends at x = 1 - y of the maximum overlap, with y the root of Eq. 8.
    """
    scale = float(theory.time_scale(k, mass, velocity))
    duration = float(theory.duration(e, k, mass, velocity))
    largest = float(theory.overlap_max(k, mass, velocity))
    end_ratio = 1.0 - float(theory.recovery(e))
    return Exact(e, duration, theory.LOADING_DURATION * scale, largest, end_ratio)


def linear(e: float, k: float, mass: float, velocity: float) -> Exact:
    """Spring of Eq. 19 with dashpot: an oscillator until its force vanishes (Schwager & Poeschel 2007).

    `e`: restitution, `k`: Hertz stiffness [N/m^1.5], `mass`: effective [kg], `velocity` [m/s].
    """
    oscillator = _Oscillator(float(theory.equivalent_spring(k, mass, velocity)), mass, velocity, e)
    return Exact(
        e, oscillator.end, oscillator.peak, float(oscillator.at(oscillator.peak)), 0.0 if e == 1.0 else None
    )


def hertz(e: float, k: float, mass: float, velocity: float) -> Exact:
    """Hertz's spring with Tsuji's damping, as an oscillator z = d^(5/4) in the time ds = (5/4) d^(1/4) dt.

    In these variables both models satisfy M v dv/dz = -(4/5) (k z + c v) (Antypov & Elliott 2011), so that

        t = (4/5) int z(s)^(-1/5) ds

    Arguments as in `linear`; for e = 1 the contact is elastic, and the duration is twice the time of loading.
    """
    oscillator = _Oscillator(0.8 * k, mass, velocity, e)
    rise = _contact_time(oscillator, 0.0, oscillator.peak)
    fall = rise if e == 1.0 else _contact_time(oscillator, oscillator.peak, oscillator.end)
    return Exact(
        e, rise + fall, rise, float(oscillator.at(oscillator.peak)) ** 0.8, 0.0 if e == 1.0 else None
    )


EXACT: Mapping[str, Callable[[float, float, float, float], Exact]] = {
    "zhou": zhou,
    "hertz": hertz,
    "linear": linear,
}
"""Exact solution by name of the contact model; arguments as in `zhou`."""


class _Oscillator:
    """M z'' = -K z - 2 zeta sqrt(K M) z' from z = 0 with a velocity, until its force vanishes; e sets zeta <
    1.

    `peak`, `end`: times of the maximum of z and of zero force.
    """

    def __init__(self, stiffness: float, mass: float, velocity: float, e: float) -> None:
        zeta = theory.damping_ratio_for(e)
        root = float(np.sqrt(1.0 - zeta**2))
        natural = float(np.sqrt(stiffness / mass))
        self.decay = zeta * natural
        self.frequency = root * natural
        self.velocity = velocity
        self.peak = float(np.arctan2(root, zeta)) / self.frequency
        self.end = (np.pi - float(np.arctan2(2.0 * zeta * root, 1.0 - 2.0 * zeta**2))) / self.frequency

    def at(self, time: float | np.ndarray) -> np.ndarray:
        """z at a time, a number or an array of any shape."""
        displacement = np.exp(-self.decay * np.asarray(time)) * np.sin(self.frequency * np.asarray(time))
        return np.asarray(self.velocity / self.frequency * displacement)


def _contact_time(oscillator: _Oscillator, begin: float, end: float) -> float:
    """Contact time [s] for the oscillator time from `begin` to `end`, s = begin + (end - begin) q^5.

        t = (4/5) int z(s)^(-1/5) ds

    At first contact z ~ s, and z^(-1/5) ds = (q^5)^(-1/5) 5 q^4 dq is smooth.
    """
    from scipy.integrate import quad

    def integrand(q: float) -> float:
        return 5.0 * q**4 * float(oscillator.at(begin + (end - begin) * q**5)) ** -0.2

    return 0.8 * (end - begin) * float(quad(integrand, 0.0, 1.0, epsabs=0.0, epsrel=1e-13)[0])


# ---------------------------------------------------------------- kinds of collision


@dataclass(frozen=True)
class CollisionKind:
    """One kind of collision: target restitution, approach velocity [m/s], diameter [m], and the exact
    solution."""

    restitution: float
    velocity: float
    diameter: float
    exact: Exact

    @property
    def text(self) -> str:
        """Text for reports."""
        return f"e = {self.restitution:g} at {self.velocity:g} m/s"


def kinds_of(law: StudiedLaw) -> tuple[CollisionKind, ...]:
    """All kinds of collision of one contact model: each restitution at each velocity.

    The diameters make all durations equal: at given restitution and velocity, the duration is proportional to
    the diameter.
    """
    case = reference_case()
    found = []
    for e in law.restitutions:
        for velocity in VELOCITIES:
            matching = exact_of(law.law_name, case, e, velocity, DIAMETER)
            diameter = DIAMETER * common_duration() / matching.duration
            found.append(
                CollisionKind(e, velocity, diameter, exact_of(law.law_name, case, e, velocity, diameter))
            )
    return tuple(found)


def exact_of(law: str, case: PaperCase, e: float, velocity: float, diameter: float) -> Exact:
    """Exact solution for two particles of a diameter [m] that collide at a velocity [m/s].

    `law`: key of EXACT; `e`: restitution. Raises KeyError for a contact model without an exact solution.
    """
    return EXACT[law](e, case.stiffness(diameter), case.mass_eff(diameter), velocity)


def collisions_of(kinds: tuple[CollisionKind, ...]) -> list[HeadOnCollision]:
    """Every kind of collision, repeated `PHASES` times: (kinds * PHASES,) in the order of the kinds."""
    case = reference_case()
    return [
        case.head_on(kind.restitution, kind.velocity, kind.diameter) for kind in kinds for _ in range(PHASES)
    ]


def first_contact_times(kinds: tuple[CollisionKind, ...], time_step: float) -> np.ndarray:
    """Times of first contact [s], (kinds * PHASES,): within the first step, evenly spaced for every kind."""
    return np.tile(time_step * (np.arange(PHASES) + 0.5) / PHASES, len(kinds))


# ---------------------------------------------------------------- simulation and timing

MAX_FULLY_SAMPLED_STEPS = 200
"""Largest number of steps per collision at which every step is sampled.

Beyond it, sampling covers the steps around the maximum overlap and the end only.
"""
SAMPLES_AROUND = 12
"""Sampled steps before and after these events: a first-order error shifts them by about one step."""
MAX_DURATIONS = 1.6
"""Largest simulated time, over the duration of a collision; a collision that lasts longer counts as
unfinished."""
SKIN = 1.0
"""Skin over the smallest diameter.

No neighbor-list rebuild occurs during a collision. The skin is equal for all time steps, so that the kernels
are, too.
"""
FINEST = 5000
"""Steps per collision of the initial scene; every contact model is stable at this resolution."""
REPEATS = 5
"""Number of repeated timings."""


@dataclass(frozen=True)
class CollisionResults:
    """Results of collisions with `steps` time steps per duration; arrays (kinds, phases), nan where not
    observed.

    `time_step` [s]; `duration` [s]; `overlap_max` [m]. `seconds` (repeats,): processor time of one collision
    [s], the total of all simultaneous collisions divided by their number.
    """

    steps: float
    time_step: float
    restitution: np.ndarray
    duration: np.ndarray
    overlap_max: np.ndarray
    seconds: np.ndarray


class AccuracyBench:
    """All collisions of one contact model in one scene; compiled once for all time steps.

    `velocity` (pairs,): approach velocities [m/s]. The device memory is free after the `with` block.

    The plan assumes the largest velocity for all pairs. Here particles collide with their own kind only, each
    kind at its own velocity, and all collisions have the same duration; the plan therefore gets the smallest
    velocity.
    """

    def __init__(self, studied_law: StudiedLaw, precision: str = "f64", threads: int | None = None) -> None:
        self.studied_law = studied_law
        self.precision = precision
        self.kinds = kinds_of(studied_law)
        self.velocity = np.repeat([kind.velocity for kind in self.kinds], PHASES)
        time_step = common_duration() / FINEST
        self.bench = head_on_bench(
            collisions_of(self.kinds),
            studied_law.normal,
            time_step,
            first_contact_times(self.kinds, time_step),
            precision=precision,
            threads=threads,
            contact_x=DISTANCE,
            velocity_max=min(VELOCITIES),
            numerics={"skin": SKIN * min(kind.diameter for kind in self.kinds)},
        )

    def __enter__(self) -> "AccuracyBench":
        return self

    def __exit__(self, *_: object) -> None:
        self.bench.free()

    @property
    def plan(self) -> Plan:
        """Plan of the initial scene."""
        return self.bench.plan

    def run(self, steps: float, repeats: int = REPEATS) -> CollisionResults:
        """Run the collisions with `steps` time steps per duration, then time them `repeats` times.

        Raises SceneError if that time step is unstable.
        """
        time_step = common_duration() / steps
        scene = self.bench.scene
        plan_for(scene.model_copy(update={"run": scene.run.model_copy(update={"time_step": time_step})}))
        times = first_contact_times(self.kinds, time_step)
        collisions = [
            replace(each, first_contact=float(time))
            for each, time in zip(self.bench.collisions, times, strict=True)
        ]
        numbers, samples = self._sample_contacts(collisions, time_step, steps)
        seconds = np.array([self._timed(collisions, steps) for _ in range(repeats)])
        found = [
            self._measured(numbers, samples[:, :, pair], pair, time_step)
            for pair in range(len(self.velocity))
        ]
        restitution, duration, overlap = np.array(found).T.reshape(3, len(self.kinds), PHASES)
        return CollisionResults(steps, time_step, restitution, duration, overlap, seconds)

    def _sample_contacts(
        self, collisions: list[Collision], time_step: float, steps: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Sampled steps (samples,), and overlap [m], overlap rate [m/s] and force [N] (samples, 3, pairs)."""
        self.bench.restart(collisions, time_step)
        numbers = self._sampled_steps(steps)
        samples = []
        now = 0
        for number in numbers:
            self.bench.simulation.step(number - now)
            now = number
            samples.append(self.bench.sample())
        return np.array(numbers), np.array(samples)

    def _sampled_steps(self, steps: float) -> list[int]:
        """Numbers of steps after which the state is sampled, in ascending order.

        All steps up to MAX_FULLY_SAMPLED_STEPS per collision; else those around the maximum overlap and the
        end.
        """
        last = ceil(MAX_DURATIONS * steps) + SAMPLES_AROUND
        if steps <= MAX_FULLY_SAMPLED_STEPS:
            return list(range(last + 1))
        duration = common_duration()
        events = {round(steps * kind.exact.peak_time / duration) for kind in self.kinds} | {round(steps)}
        near = {event + k for event in events for k in range(-SAMPLES_AROUND, SAMPLES_AROUND + 1)}
        return sorted({0, *near, last})

    def _timed(self, collisions: list[Collision], steps: float) -> float:
        """Processor time of one collision [s]: that of all simultaneous collisions, divided by their
        number."""
        self.bench.restart(collisions)
        whole = ceil(steps) + 1
        began = process_time()
        self.bench.simulation.step(whole)
        return (process_time() - began) * steps / whole / len(self.velocity)

    def _measured(
        self, numbers: np.ndarray, samples: np.ndarray, pair: int, time_step: float
    ) -> tuple[float, float, float]:
        """Restitution, duration [s] and maximum overlap [m] of one pair; e = 0 for a pair that has not
        separated.

        `numbers` (samples,): step numbers; `samples` (samples, 3): overlap [m], overlap rate [m/s], force
        [N]. The duration is nan if the steps at the end were not sampled.
        """
        overlap, rate, force = samples.T
        parted = force[-1] == 0.0 and rate[-1] < 0.0
        restitution = float(-rate[-1] / self.velocity[pair]) if parted else 0.0
        largest = _parabola_max(overlap)
        acting = np.flatnonzero(force)
        last = int(acting[-1]) if len(acting) else 0
        if not parted or last < 3 or numbers[last + 1] - numbers[last - 3] != FORCES_TO_END:
            return restitution, np.nan, largest
        end_ratio = self.kinds[pair // PHASES].exact.end_ratio
        if end_ratio is None:
            end = numbers[last] + share_to_end(force[last - 3 : last + 1], overlap[last : last + 2])
        else:  # free flight from this step on
            missed = (end_ratio * largest - overlap[last + 1]) / -rate[last + 1]
            end = numbers[last + 1] - missed / time_step
        first_contact = (pair % PHASES + 0.5) / PHASES
        return restitution, float(end - first_contact) * time_step, largest


def _parabola_max(overlap: np.ndarray) -> float:
    """Maximum overlap [m]: vertex of the parabola through the largest sample and its two neighbors.

    `overlap` (samples,) [m], equally spaced around the maximum; the largest sample itself at an end.
    """
    index = int(np.argmax(overlap))
    if not 0 < index < len(overlap) - 1:
        return float(overlap[index])
    before, top, after = overlap[index - 1 : index + 2]
    bend = 2.0 * top - before - after
    return float(top + (after - before) ** 2 / (8.0 * bend)) if bend > 0.0 else float(top)


# ---------------------------------------------------------------- points and lines of the study

QUANTITIES = ("restitution", "duration", "overlap_max", "energy")
"""Quantities with an error relative to the exact solution."""
QUANTITY_LABELS = {
    "restitution": "restitution",
    "duration": "duration",
    "overlap_max": "maximum overlap",
    "energy": "energy",
}
"""Titles of the quantities in figures and tables."""


@dataclass(frozen=True)
class StudyPoint:
    """One row of the CSV, in SI units.

    `steps`: duration of the collision over the time step. `share`: time step over the shorter of loading and
    unloading, as `numerics.time_step_fraction` of a scene. Errors are relative to the exact value; the energy
    error is the error of the final kinetic energy over the initial one. `*_error`: root mean square over the
    phases of first contact; `*_error_worst`: maximum. `seconds_*`: processor time of one collision [s].
    """

    law: str
    precision: str
    steps: float
    time_step: float
    restitution: float
    velocity: float
    share: float
    restitution_error: float
    duration_error: float
    overlap_max_error: float
    energy_error: float
    restitution_error_worst: float
    duration_error_worst: float
    overlap_max_error_worst: float
    energy_error_worst: float
    seconds_median: float
    seconds_min: float
    seconds_max: float
    repeats: int


@dataclass(frozen=True)
class StudyLine:
    """All points of one contact model and precision: each number of steps for each kind of collision."""

    law: str
    precision: str
    points: tuple[StudyPoint, ...]

    @cached_property
    def steps(self) -> np.ndarray:
        """Steps per collision in ascending order (n,)."""
        return np.array(sorted({point.steps for point in self.points}))

    def error(self, quantity: str) -> np.ndarray:
        """Largest error of all kinds of collision (n,); nan where the end of a collision was not observed.

        `quantity`: one of QUANTITIES. The order is that of `steps`.
        """
        return self._over_kinds(f"{quantity}_error")

    def seconds(self, which: str = "median") -> np.ndarray:
        """Processor time per collision [s] (n,); `which`: median, min or max over the repeats."""
        return self._over_kinds(f"seconds_{which}")

    def kinds(self) -> list[list[StudyPoint]]:
        """Points of each kind of collision, in ascending order of steps."""
        names = dict.fromkeys((point.restitution, point.velocity) for point in self.points)
        matching = [[p for p in self.points if (p.restitution, p.velocity) == name] for name in names]
        return [sorted(points, key=lambda point: point.steps) for points in matching]

    def _over_kinds(self, name: str) -> np.ndarray:
        """Maximum of a field over the kinds of collision for each number of steps (n,)."""
        return np.array(
            [max_or_nan(getattr(p, name) for p in self.points if p.steps == n) for n in self.steps]
        )


def max_or_nan(values: Iterable[float]) -> float:
    """Maximum of the values; nan if any value is nan."""
    return float(np.max(np.array(list(values))))


def columns(points: Sequence[StudyPoint]) -> dict[str, np.ndarray]:
    """Columns of the CSV, one array (points,) per field of StudyPoint."""
    return attribute_columns(points, (each.name for each in fields(StudyPoint)))


def measured_line(
    studied_law: StudiedLaw,
    precision: str = "f64",
    steps: Sequence[float] = STEPS,
    repeats: int = REPEATS,
    threads: int | None = None,
) -> tuple[StudyLine, list[str]]:
    """Measure all points of one line; the second result describes the steps rejected as unstable.

    `steps`: numbers of steps per collision; `repeats`: number of timings of each; `threads`: as for
    Simulation.
    """
    points: list[StudyPoint] = []
    refused: list[float] = []
    with AccuracyBench(studied_law, precision, threads) as bench:
        for count in steps:
            try:
                points += _points(bench, bench.run(count, repeats))
            except SceneError:
                refused.append(count)
    line = StudyLine(studied_law.name, precision, tuple(points))
    if not refused:
        return line, []
    return line, [f"{studied_law.name} with {', '.join(f'{n:g}' for n in refused)} steps per collision"]


def _points(bench: AccuracyBench, results: CollisionResults) -> list[StudyPoint]:
    """One point per kind of collision, with errors over the phases (PHASES,) and processor times.

    Processor times are equal for all kinds, because all collisions run simultaneously.
    """
    seconds = results.seconds
    shared = {
        "law": bench.studied_law.name,
        "precision": bench.precision,
        "steps": float(results.steps),
        "time_step": results.time_step,
        "repeats": len(seconds),
        "seconds_median": float(np.median(seconds)),
        "seconds_min": float(seconds.min()),
        "seconds_max": float(seconds.max()),
    }
    found = []
    for index, kind in enumerate(bench.kinds):
        errors = _errors(results, kind, index)
        rms = {f"{name}_error": float(np.sqrt(np.mean(error**2))) for name, error in errors.items()}
        worst = {f"{name}_error_worst": float(np.max(np.abs(error))) for name, error in errors.items()}
        given = {
            "restitution": kind.restitution,
            "velocity": kind.velocity,
            "share": results.time_step / _phase(bench, index),
        }
        found.append(StudyPoint(**shared, **given, **rms, **worst))  # type: ignore[arg-type]
    return found


def _errors(results: CollisionResults, kind: CollisionKind, index: int) -> dict[str, np.ndarray]:
    """Errors (phases,) of one kind of collision by quantity: relative, except the energy.

    energy error = e^2 - e_exact^2, over the initial kinetic energy
    """
    exact = kind.exact
    e = results.restitution[index]
    return {
        "restitution": e / exact.restitution - 1.0,
        "duration": results.duration[index] / exact.duration - 1.0,
        "overlap_max": results.overlap_max[index] / exact.overlap_max - 1.0,
        "energy": e**2 - exact.restitution**2,
    }


def _phase(bench: AccuracyBench, index: int) -> float:
    """Shorter of loading and unloading time of a kind of collision [s], by the formula of the plan.

    The time of the pair case is scaled with the diameter, to which it is proportional.
    """
    kind = bench.kinds[index]
    group = bench.bench.collisions[index * PHASES].first
    pair_case = next(each for each in bench.plan.pair_cases if each.name == f"{group}-{group}")
    phase = pair_case.shortest_phase(bench.plan.laws.normal, kind.velocity)
    return phase / (2.0 * pair_case.radius) * kind.diameter
