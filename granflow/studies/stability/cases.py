"""The cases of the stability study: stiff and extreme situations, each with a reference for its result.

`all_cases` lists them in families, each a grid of rows and columns. `run_case` runs one case and assesses it:
accurate, stable with an error, refused with a message, or a defect. Three kinds of case exist: two particles
that collide on the collision bench, columns and beds of many particles, and the measured stability limit of
the time step (`granflow.studies.stability.time_step_bounds`).
"""

import math
import time as clock
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, partial
from typing import Any, Literal

import numpy as np

from granflow import GranflowError, Plan, Scene, Simulation, plan_for
from granflow.contact.material import VelocityRestitution
from granflow.geometry.sphere import sphere_mass, sphere_volume
from granflow.scene.blocks.run import LARGEST_OVERLAP
from granflow.studies.bench import Collision, CollisionBench
from granflow.studies.figures import percent
from granflow.studies.stability.time_step_bounds import LATTICES, RESOLUTION, real_bounds
from granflow.studies.stability.time_step_bounds import LAWS as BOUND_LAWS

# ---------------------------------------------------------------- a case and its assessment

ACCURATE = 0.01
"""Largest error of an accurate case."""
SILENT_LIMIT = 0.1
"""Largest error without a warning; a larger silent error is a defect."""
Kind = Literal["accurate", "error", "refused", "defect"]
"""Assessment of a case: accurate, stable with an error, refused with a message, or a defect."""


@dataclass(frozen=True)
class CaseResult:
    """Result of a case: quantity, expected and reached value, relative error, and time step [s]."""

    quantity: str
    expected: float
    reached: float
    error: float
    time_step: float
    warnings: tuple[str, ...] = ()
    """Warnings that announce the error: those of the plan, and known limitations of the check."""


@dataclass(frozen=True)
class StabilityCase:
    """One stiff or extreme case: row and column in the grid of its family, reference, and function to run.

    `reference`: noun phrase for the expected value. The function must be importable in another process.
    """

    family: str
    row: str
    column: str
    reference: str
    run: Callable[[], CaseResult]
    precision: str = "f64"

    @property
    def name(self) -> str:
        """Family, row and column."""
        return f"{self.family}: {self.row}, {self.column}"


@dataclass(frozen=True)
class CaseOutcome:
    """A case with its assessment; numbers are nan for refused cases.

    `error` is relative; `time_step` and wall time `seconds` [s].
    """

    family: str
    row: str
    column: str
    precision: str
    reference: str
    quantity: str
    expected: float
    reached: float
    error: float
    time_step: float
    seconds: float
    kind: Kind
    assessment: str


def run_case(case: StabilityCase) -> CaseOutcome:
    """Run a case and return its outcome with the wall time.

    No exception is raised: GranflowError means refused, every other exception a defect.
    """
    began = clock.perf_counter()
    case_result = CaseResult("", math.nan, math.nan, math.nan, math.nan)
    try:
        case_result = case.run()
        kind, assessment = assess(case_result)
    except GranflowError as refusal:
        kind = "refused"
        assessment = f"refused: {' '.join(str(refusal).split())}"
    except Exception as failure:  # any failure is a defect of the case and must not end the study
        kind = "defect"
        assessment = f"defect: {type(failure).__name__}: {failure}"
    return case_outcome(case, case_result, clock.perf_counter() - began, kind, assessment)


def case_outcome(
    case: StabilityCase, case_result: CaseResult, seconds: float, kind: Kind, assessment: str
) -> CaseOutcome:
    """Combine a case, its result and its assessment."""
    return CaseOutcome(
        case.family,
        case.row,
        case.column,
        case.precision,
        case.reference,
        case_result.quantity,
        case_result.expected,
        case_result.reached,
        case_result.error,
        case_result.time_step,
        seconds,
        kind,
        assessment,
    )


def assess(case_result: CaseResult) -> tuple[Kind, str]:
    """Kind of assessment and its text for a result.

    Accurate up to ACCURATE; a larger error needs a warning above SILENT_LIMIT, otherwise it is a defect.
    """
    if not (math.isfinite(case_result.reached) and math.isfinite(case_result.error)):
        return "defect", f"defect: {case_result.quantity} is not finite, and the run did not abort"
    if case_result.error <= ACCURATE:
        return "accurate", "stable and accurate"
    statement = f" ({case_result.quantity} {case_result.reached:.4g} for {case_result.expected:.4g})"
    if case_result.warnings:
        return (
            "error",
            f"stable, error {percent(case_result.error)}{statement}, warning: {case_result.warnings[0]}",
        )
    if case_result.error > SILENT_LIMIT:
        return "defect", f"defect: silent error {percent(case_result.error)}{statement}"
    return "error", f"stable, error {percent(case_result.error)}{statement}"


# ---------------------------------------------------------------- all cases

STEPS = "time step against restitution"
STIFFNESS = "stiffness against velocity"
SIZES = "size against precision"
UNEQUAL = "unequal partners"
MANY = "many particles"
BOUNDS = "stability limit of the time step"
"""Names of the families."""
RESTITUTIONS = (0.0, 0.001, 0.01, 0.1, 0.3, 0.5, 0.7, 0.9, 1.0)
"""Target restitutions of the family STEPS."""
SHARES = (0.01, 0.03, 0.1, 0.3, 0.99, 2.0, 5.0)
"""Time steps over the largest permitted one; those above 1 must be refused."""
MODULI = tuple(10.0**n for n in range(5, 13))
"""Young's moduli [Pa]."""
VELOCITIES = (1e-6, 1e-3, 0.1, 10.0, 100.0, 400.0)
"""Impact velocities [m/s]."""
STEEL = (3.0432, 0.540, 340.3)
"""sigma, psi and limit velocity [m/s] of stainless steel 316 (Zhou 2011)."""
RADII: tuple[float, ...] = tuple(10.0**n for n in range(-6, 1))
"""Particle radii [m]."""
PRECISIONS = ("f64", "mixed", "f32")
RATIOS: tuple[float, ...] = (1.0, 3.0, 10.0, 30.0, 100.0)
"""Ratios of the radii of two particles."""
DENSITY_RATIOS = (1.0, 1e3, 1e6)
"""Ratios of the densities of two particles."""
SPREAD = 0.1
"""Initial gap between falling particles, over their diameter."""
WITH_FRICTION = ", friction"
"""Suffix of the columns of lattices with friction."""
CONSERVATIVE_WARNING = "the check assumes up to 12 contacts per particle, more than in this lattice"
"""Known reason for a limit of the check that is too conservative."""


def all_cases(full: bool = False) -> list[StabilityCase]:
    """All cases; `full` includes all moduli, sizes and ratios instead of every other one."""
    stride = 1 if full else 2
    moduli = MODULI if full else (1e5, 1e7, 1e9, 1e12)
    return [
        *_bound_cases(),
        *_many_cases(),
        *_step_cases(),
        *_stiffness_cases(moduli),
        *_size_cases(RADII[::stride]),
        *_unequal_cases(RATIOS[::stride]),
    ]


def _step_cases() -> Iterator[StabilityCase]:
    """Restitution at time steps relative to the largest permitted one."""
    pairs = tuple(ParticlePair(restitution=e) for e in RESTITUTIONS)
    for share in SHARES:
        for index, e in enumerate(RESTITUTIONS):
            run = partial(rebound_result, pairs, index, "f64", share)
            yield StabilityCase(STEPS, f"e = {e:g}", f"{share:g}", "the target restitution", run)


def _stiffness_cases(moduli: tuple[float, ...]) -> Iterator[StabilityCase]:
    """Young's modulus and impact velocity at the automatic time step."""
    for modulus in moduli:
        for velocity in VELOCITIES:
            pair = ParticlePair(young_modulus=modulus, restitution=STEEL, velocity=velocity)
            run = partial(rebound_result, (pair,), 0)
            yield StabilityCase(STIFFNESS, f"{modulus:.0e} Pa", f"{velocity:g} m/s", "e(v) of Eq. 12", run)


def _size_cases(radii: tuple[float, ...]) -> Iterator[StabilityCase]:
    """Particle radius and precision."""
    for precision in PRECISIONS:
        for radius in radii:
            run = partial(rebound_result, (ParticlePair(radius=radius),), 0, precision)
            yield StabilityCase(
                SIZES, precision, f"R = {radius:g} m", "the target restitution", run, precision
            )


def _unequal_cases(ratios: tuple[float, ...]) -> Iterator[StabilityCase]:
    """Ratios of radius and density of the two particles."""
    for density in DENSITY_RATIOS:
        for ratio in ratios:
            pair = ParticlePair(radius_ratio=ratio, density_ratio=density)
            run = partial(rebound_result, (pair,), 0)
            reference = "the target restitution and conservation of momentum"
            yield StabilityCase(UNEQUAL, f"density 1 : {density:g}", f"radius 1 : {ratio:g}", reference, run)


def _many_cases() -> Iterator[StabilityCase]:
    """Columns and beds of many particles."""
    for law in LAWS:
        yield StabilityCase(
            MANY,
            law,
            "heavy on light",
            "the weight on the floor",
            partial(column_at_rest, law, (2.5e3, 2.5e9), 1e11),
        )
        yield StabilityCase(
            MANY,
            law,
            "column of 100",
            "the weight on the floor",
            partial(column_at_rest, law, (2.5e3,) * 100, 5e7),
        )
        for column, (particles, duration, changes) in _beds().items():
            run = partial(energy_budget_result_of, law, particles, duration, changes)
            yield StabilityCase(MANY, law, column, "the energy budget", run)


def _beds() -> dict[str, tuple[dict[str, Any], float, dict[str, Any]]]:
    """Particles, duration [s] and changed settings for each case assessed by the energy budget."""
    resting_bed = {"bed": particles_at(bed_positions())}
    falling = {"bed": particles_at(bed_positions(spread=SPREAD))}
    half = {"bed": particles_at([[-0.75 * RADIUS, 0, 1e-2], [0.75 * RADIUS, 0, 1e-2]])}
    bullet = [0.3 * RADIUS, 0.2 * RADIUS, SIDE + 2.0 * DIAMETER]
    shot = {**resting_bed, "projectile": particles_at([bullet], [0.0, 0.0, -1000.0])}
    opposed = {
        "left": particles_at(bed_positions(0.0) + [-0.6 * SIDE, 0, 0], [1.0, 0, 0]),
        "right": particles_at(bed_positions(0.3 * RADIUS) + [0.6 * SIDE, 0, 0], [-1.0, 0, 0]),
    }
    speed = 0.05
    depth = 5 * 0.05 * RADIUS
    piston = {"kind": "translation", "velocity": [0, 0, -speed], "end": depth / speed}
    lid = {
        "shape": "plane",
        "point": [0, 0, SIDE],
        "normal": [0, 0, -1],
        "material": "light",
        "motion": [piston],
    }
    vibration = {"kind": "vibration", "direction": [0, 0, 1], "frequency": 50.0, "gamma": 100.0}
    no_limit = {"numerics": {"max_overlap": LARGEST_OVERLAP}}
    wide = box_walls(spread=SPREAD)
    weightless = {"gravity": 0.0, "walls": {}}
    return {
        "squeezed": (resting_bed, 1.5 * depth / speed, {"walls": {**box_walls(), "lid": lid}}),
        "initial overlap 50 %": (half, 1e-3, weightless),
        "overlap 50 %, limit off": (half, 1e-3, {**weightless, **no_limit}),
        "1 km/s, soft": (shot, 1e-4, {"walls": box_walls()}),
        "1 km/s, 70 GPa, limit off": (shot, 3e-5, {"walls": box_walls(), "young_modulus": 7e10, **no_limit}),
        "friction 0": (falling, 0.02, {"walls": wide, "friction": 0.0}),
        "friction 10": (falling, 0.02, {"walls": wide, "friction": 10.0}),
        "no gravity": (opposed, 0.01, weightless),
        "shaken, Γ = 100": (
            falling,
            0.04,
            {"walls": box_walls([vibration], SPREAD), "young_modulus": 1e9, "reach": 1.0},
        ),
    }


def _bound_cases() -> Iterator[StabilityCase]:
    """Measured stability limits of all contact models and lattices."""
    for law in BOUND_LAWS:
        for friction in (False, True):
            for lattice in LATTICES:
                column = lattice + (WITH_FRICTION if friction else "")
                reference = "1 to 2 times the limit of the check"
                yield StabilityCase(
                    BOUNDS, law, column, reference, partial(bound_result, law, friction, lattice)
                )


# ---------------------------------------------------------------- two particles
#
# The pairs of a case collide head-on in one scene, far apart, and share the time step of the stiffest one.
# The total momentum of each pair is 0.

PAIR_POISSON = 0.25
"""Poisson ratio of all particles."""
GAP = 1e-3
"""Initial gap over the smaller radius."""
MAX_OVERLAP = 0.1
"""Overlap over radius above which a run is aborted, the default of scenes."""
SKIN = 0.3
"""Skin over the smallest radius; equal for all cases, so that the kernels compile once."""


@dataclass(frozen=True)
class ParticlePair:
    """Two particles of equal elasticity that collide head-on, in SI units.

    `radius_ratio`, `density_ratio`: second particle over the first.
    """

    young_modulus: float = 1e8
    restitution: float | tuple[float, float, float] = 0.7
    """A number, or sigma, psi and limit velocity [m/s] of Eq. 12."""
    velocity: float = 1.0
    radius: float = 1e-3
    density: float = 2500.0
    radius_ratio: float = 1.0
    density_ratio: float = 1.0

    @property
    def masses(self) -> np.ndarray:
        """Masses of both particles (2,) [kg]."""
        return sphere_mass(self.radius, self.density) * np.array(
            [1.0, self.radius_ratio**3 * self.density_ratio]
        )

    @property
    def requested(self) -> float:
        """Target restitution."""
        if isinstance(self.restitution, float):
            return self.restitution
        return float(VelocityRestitution(*self.restitution)(self.velocity))


@dataclass(frozen=True)
class Rebound:
    """Results of the pairs (n,): restitution, and momentum error over m v with the smaller mass m.

    `time_step` [s]; `warnings`: of the plan.
    """

    restitution: np.ndarray
    momentum: np.ndarray
    time_step: float
    warnings: tuple[str, ...]


def rebound_result(
    pairs: tuple[ParticlePair, ...], index: int, precision: str = "f64", share: float | None = None
) -> CaseResult:
    """Larger error of restitution and momentum of one pair, relative to the approach velocity.

    `index`: of the pair; warnings about other pairs are omitted. Raises the errors of `rebound`.
    """
    found = rebound(pairs, precision, share)
    requested = pairs[index].requested
    reached = float(found.restitution[index])
    momentum_error = float(found.momentum[index])
    others = [f"a{other}-b{other}:" for other in range(len(pairs)) if other != index]
    warnings = tuple(text for text in found.warnings if not text.startswith(tuple(others)))
    if momentum_error > abs(reached - requested):
        return CaseResult("momentum error", 0.0, momentum_error, momentum_error, found.time_step, warnings)
    return CaseResult("restitution", requested, reached, abs(reached - requested), found.time_step, warnings)


@cache
def rebound(pairs: tuple[ParticlePair, ...], precision: str = "f64", share: float | None = None) -> Rebound:
    """Collide the pairs with Zhou's model, at `share` of the largest permitted time step, or at the default
    one.

    Cached: cases with the same pairs share one run. Raises SceneError if the time step is refused, RunError
    if the run aborts.
    """
    step = None if share is None else share * _largest_step(pairs)
    with _bench(pairs, precision, step) as bench:
        bench.rebound()
        velocity = bench.motions()[0][:, :, 0]
        chosen = bench.plan.step
    masses = np.array([pair.masses for pair in pairs])
    speeds = np.array([pair.velocity for pair in pairs])
    momentum_error = np.abs(np.sum(masses * velocity, axis=1)) / (masses.min(axis=1) * speeds)
    restitution = (velocity[:, 1] - velocity[:, 0]) / speeds
    return Rebound(restitution, momentum_error, chosen.value, chosen.warnings)


@cache
def _largest_step(pairs: tuple[ParticlePair, ...]) -> float:
    """Largest permitted time step [s]."""
    return _bench(pairs, "f64").plan.step.stable_below


def _bench(pairs: Sequence[ParticlePair], precision: str, time_step: float | None = None) -> CollisionBench:
    """Bench with all pairs; `time_step` [s]: automatic if None. The materials of pair 0 are a0 and b0, and so
    on."""
    materials = {}
    pairs_of_materials = {}
    collisions = []
    for index, pair in enumerate(pairs):
        names = (f"a{index}", f"b{index}")
        masses = pair.masses
        for name, ratio in zip(names, (1.0, pair.density_ratio), strict=True):
            density = pair.density * ratio
            materials[name] = {
                "young_modulus": pair.young_modulus,
                "poisson_ratio": PAIR_POISSON,
                "density": density,
            }
        pairs_of_materials["-".join(names)] = {"restitution": _restitution_setting(pair), "friction": 0}
        gap = GAP * pair.radius * min(pair.radius_ratio, 1.0)
        collisions.append(
            Collision(
                *names,
                pair.radius,
                pair.radius * pair.radius_ratio,
                pair.velocity,
                share=masses[1] / masses.sum(),
                first_contact=gap / pair.velocity,
            )
        )
    smallest = min(pair.radius * min(pair.radius_ratio, 1.0) for pair in pairs)
    return CollisionBench(
        materials,
        pairs_of_materials,
        {"normal": "zhou"},
        collisions,
        run={
            "precision": precision,
            "velocity_max": max(pair.velocity for pair in pairs),
            "duration": 1.0 + 10.0 * max(each.first_contact for each in collisions),
            "time_step": time_step or "auto",
        },
        numerics={"skin": SKIN * smallest, "max_overlap": MAX_OVERLAP},
    )


def _restitution_setting(pair: ParticlePair) -> Any:
    """`restitution` of the pair in the structure of a scene file."""
    if isinstance(pair.restitution, float):
        return pair.restitution
    sigma, psi, limit = pair.restitution
    return {"sigma": sigma, "psi": psi, "limit_velocity": limit}


# ---------------------------------------------------------------- many particles

RADIUS, DENSITY, YOUNG, POISSON, GRAVITY = 1e-3, 2500.0, 5e7, 0.25, 9.81
"""Radius [m], density [kg/m3], Young's modulus [Pa], Poisson ratio, gravity [m/s2]."""
DIAMETER = 2.0 * RADIUS
"""Diameter of the particles [m]."""
LAWS: Mapping[str, Any] = {
    "zhou": "zhou",
    "hertz": "hertz",
    "linear": {"law": "linear", "stiffness": "onset"},
}
"""Settings of `contact.normal` by name; every pair has restitution 0.5."""
ROW = 4
"""Particles along each edge of a bed."""
SIDE = ROW * DIAMETER
"""Edge of a bed [m]."""
REST_STEPS = 20_000
"""Number of steps of a static case."""


def energy_budget_result_of(
    law: str, particles: Mapping[str, Any], duration: float, changes: Mapping[str, Any]
) -> CaseResult:
    """`energy_budget_result` of `scene_with`."""
    return energy_budget_result(scene_with(law, particles, duration, **changes))


def energy_budget_result(scene: Scene) -> CaseResult:
    """Run the scene; the error is the magnitude of `energy_error` at the end of the run.

    Raises RunError after an abort.
    """
    simulation = Simulation(scene)
    try:
        result = simulation.run()
    finally:
        simulation.free()
    error = float(result.totals["energy_error"])
    step = simulation.plan.step
    return CaseResult("energy error", 0.0, error, abs(error), step.value, step.warnings)


def column_at_rest(law: str, densities: tuple[float, ...], young_modulus: float) -> CaseResult:
    """Column of particles at rest, lowest first: the floor force must remain equal to the weight.

    `densities` [kg/m3] from bottom to top; `young_modulus` [Pa]. The initial overlaps are those of the
    equilibrium; the error is that of the force on the floor after REST_STEPS steps, relative to the weight.
    """
    weights = GRAVITY * sphere_volume(RADIUS) * np.array(densities)
    heavy = max(densities)
    names = ["heavy" if density == heavy and heavy != DENSITY else "light" for density in densities]

    def scene(heights: np.ndarray) -> Scene:
        centers = np.stack([0.0 * heights, 0.0 * heights, heights], axis=1)
        groups = {
            name: particles_at(centers[[each == name for each in names]], material=name)
            for name in dict.fromkeys(names)
        }
        reach = max(10.0 * SIDE, 2.5 * RADIUS * len(densities))
        return scene_with(law, groups, 1.0, density=heavy, young_modulus=young_modulus, reach=reach)

    touching = RADIUS * (1.0 + 2.0 * np.arange(len(densities)))
    plan = plan_for(scene(touching))
    supported_weights = np.cumsum(weights[::-1])[::-1]
    masses = np.append(np.inf, weights / GRAVITY)
    overlaps = [
        _overlap_for_load(plan, index, supported_weights[index], masses) for index in range(len(densities))
    ]
    simulation = Simulation(scene(touching - np.cumsum(overlaps)))
    simulation.run(until=REST_STEPS * simulation.plan.time_step)
    contacts = simulation.snapshot(contacts=True).contacts
    assert contacts is not None
    floor = float(contacts["normal_force"][contacts["wall"] >= 0].sum())
    step = simulation.plan.step
    simulation.free()
    weight = float(weights.sum())
    return CaseResult(
        "force on the floor [N]", weight, floor, abs(floor / weight - 1.0), step.value, step.warnings
    )


def _overlap_for_load(plan: Plan, index: int, load: float, masses: np.ndarray) -> float:
    """Overlap [m] at which contact `index` of a column carries a load [N]; contact 0 is at the floor.

    `masses` (n + 1,) [kg]: floor (infinite) and particles. The force is that of the reference implementation.
    """
    from scipy.optimize import brentq

    radius_eff = RADIUS if index == 0 else 0.5 * RADIUS
    lower, upper = masses[index], masses[index + 1]
    mass_eff = upper if index == 0 else lower * upper / (lower + upper)
    constants = plan.pair_constants[0]
    history = np.zeros(plan.laws.normal.history_count)

    def excess(overlap: float) -> float:
        arguments = (constants, radius_eff, mass_eff, plan.time_step, overlap, 0.0, history)
        return plan.laws.normal.reference_force(*arguments)[0] - load

    least = 1e-15 * RADIUS  # without an overlap the particles are not in contact and have no force
    return float(brentq(excess, least, RADIUS, xtol=least, rtol=1e-15))


def scene_with(law: str, particles: Mapping[str, Any], duration: float, **changes: Any) -> Scene:
    """Scene with particles of the materials `light` and `heavy`, and walls of `light`.

    `law`: key of LAWS; `particles`: groups by name; `duration` [s]. `changes` replace defaults: friction,
    gravity [m/s2], walls, numerics, run, young_modulus [Pa], density of `heavy` [kg/m3], reach [m].
    """
    solid = {"young_modulus": changes.get("young_modulus", YOUNG), "poisson_ratio": POISSON}
    pair = {"restitution": 0.5, "friction": changes.get("friction", 0.3)}
    reach = changes.get("reach", 10.0 * SIDE)
    return Scene.from_dict(
        {
            "title": "Many particles in an extreme case",
            "gravity": [0, 0, -changes.get("gravity", GRAVITY)],
            "materials": {
                "light": {**solid, "density": DENSITY},
                "heavy": {**solid, "density": changes.get("density", DENSITY)},
            },
            "pairs": {"light-light": pair, "light-heavy": pair, "heavy-heavy": pair},
            "contact": {"normal": LAWS[law], "tangential": "mindlin", "rolling": "none"},
            "walls": changes.get("walls", {"floor": _plane([0, 0, 0], [0, 0, 1])}),
            "particles": particles,
            "domain": {"min": [-reach, -reach, -0.1 * reach], "max": [reach] * 3, "on_exit": "error"},
            "run": {"duration": duration, **changes.get("run", {})},
            "numerics": changes.get("numerics", {}),
            "output": {"interval": 1e9, "energy_budget": True},
        }
    )


def _plane(point: list[float], normal: list[float], motion: Any = ()) -> dict[str, Any]:
    """Plane wall through a point [m] with a normal."""
    return {"shape": "plane", "point": point, "normal": normal, "material": "light", "motion": list(motion)}


def box_walls(motion: Any = (), spread: float = 0.0) -> dict[str, Any]:
    """A floor, optionally moving, and four walls around a bed with this relative spacing."""
    low, high = -0.5 * SIDE * (1.0 + spread), 0.5 * SIDE * (1.0 + spread)
    return {
        "floor": _plane([0, 0, 0], [0, 0, 1], motion),
        "west": _plane([low, 0, 0], [1, 0, 0]),
        "east": _plane([high, 0, 0], [-1, 0, 0]),
        "south": _plane([0, low, 0], [0, 1, 0]),
        "north": _plane([0, high, 0], [0, -1, 0]),
    }


def particles_at(positions: Any, velocity: Any = (0.0, 0.0, 0.0), material: str = "light") -> dict[str, Any]:
    """A group of particles at positions (n, 3) [m]."""
    return {
        "material": material,
        "diameter": DIAMETER,
        "velocity": np.asarray(velocity, float).tolist(),
        "insert": {"kind": "positions", "positions": np.asarray(positions, float).tolist()},
    }


def bed_positions(height: float = 0.0, spread: float = 0.0) -> np.ndarray:
    """Positions (n, 3) [m] of a cube of touching particles, `height` [m] above the floor.

    `spread` increases the spacing by this fraction and adds random shifts, the same in each call.
    """
    points = np.stack(np.meshgrid(*[np.arange(ROW)] * 3, indexing="ij"), axis=-1).reshape(-1, 3).astype(float)
    points = (points + 0.5) * DIAMETER - np.array([0.5 * SIDE, 0.5 * SIDE, 0.0])
    points *= 1.0 + spread
    shift = np.random.default_rng(1).uniform(-1.0, 1.0, points.shape) * 0.25 * spread * RADIUS
    return points + shift + np.array([0.0, 0.0, height])


# ---------------------------------------------------------------- stability limit of the time step


def bound_result(law: str, friction: bool, lattice: str) -> CaseResult:
    """Measured stability limit over that of the check, required to be 1 to 2.

    Below 1 the check accepts unstable time steps, which counts as an error of 100 %. `law`: key of
    `time_step_bounds.LAWS`; `lattice`: key of LATTICES.
    """
    bound = _bounds_by_lattice(law, friction)[lattice]
    ratio = bound.ratio
    inside = float(np.clip(bound.ratio, 1.0, 2.0))
    too_large = ratio * RESOLUTION < 1.0
    too_small = ratio > 2.0 * RESOLUTION
    if too_large:
        error = 1.0
    elif too_small:
        error = ratio / 2.0 - 1.0
    else:
        error = 0.0
    warnings = (CONSERVATIVE_WARNING,) if too_small else ()
    return CaseResult("measured limit over that of the check", inside, ratio, error, bound.allowed, warnings)


@cache
def _bounds_by_lattice(law: str, friction: bool) -> dict[str, Any]:
    """Measured stability limits of one contact model; cached, since they share one engine."""
    return {bound.lattice: bound for bound in real_bounds(law, friction)}
