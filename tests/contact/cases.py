"""Normal models of the catalog with their settings, and the evaluation of contacts along given overlap paths."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import taichi as ti

from granflow.contact.cohesion.cohesion import with_sjkr
from granflow.contact.complete_force import complete_force
from granflow.contact.material import PairMaterial, VelocityRestitution
from granflow.contact.model import ModelRequest, NormalLaw
from granflow.contact.registry import NORMAL_LAWS


@dataclass(frozen=True)
class Units:
    """A system of units: the values of 1 m, 1 kg and 1 s in it."""

    meter: float = 1.0
    kilogram: float = 1.0
    second: float = 1.0

    @property
    def pascal(self) -> float:
        return self.kilogram / (self.meter * self.second**2)

    @property
    def newton(self) -> float:
        return self.kilogram * self.meter / self.second**2

    @property
    def velocity(self) -> float:
        return self.meter / self.second


SI = Units()
MODULUS, SHEAR_MODULUS = 4e7, 1.2e7
RADIUS, MASS, VELOCITY, TIME_STEP = 0.01, 0.01, 1.0, 1e-5
"""A soft particle of radius 1 cm; its maximum overlap at 1 m/s is 0.35 mm, reached after 51 steps."""
YIELD_STRENGTH = 1e6
"""With this maximum contact pressure [Pa], a Hertz contact yields at an overlap of 15 micrometers."""
COHESION = 5e4
"""Cohesion energy density [J/m3]: an attraction of 3.1 kN/m times the overlap, below a sixth of the 20 kN/m spring."""
ANGLE = 0.5


def fit(units):
    """A restitution that decreases with the impact velocity."""
    return VelocityRestitution(1.2, 0.54, 2.0 * units.velocity)


def number(e):
    """A constant restitution."""
    return lambda units: e


def no_restitution(units):
    """No restitution: it follows from the yield strength of the material."""


def pair_of(restitution, units):
    """The pair material of a case in the given units."""
    yield_strength = YIELD_STRENGTH * units.pascal if restitution is no_restitution else None
    elastic = (MODULUS * units.pascal, SHEAR_MODULUS * units.pascal)
    cohesion = COHESION * units.pascal
    return PairMaterial(
        *elastic, restitution(units), 0.0, yield_strength=yield_strength, cohesion_energy_density=cohesion
    )


@dataclass(frozen=True)
class Case:
    """One normal model with its settings, in any units."""

    name: str
    build: Callable[[Units], NormalLaw]
    restitution: Callable[[Units], float | VelocityRestitution | None]
    plastic: bool = False
    """Whether unloading differs from loading."""
    adhesive: bool = False
    """Whether the sjkr cohesion is added, which the closed forms of the normal model do not include."""

    def __str__(self) -> str:
        return self.name

    def pair(self, units=SI):
        return pair_of(self.restitution, units)

    def law(self, units=SI):
        return law_of(self, units)


@cache
def law_of(case, units):
    """The model of a case, built once per system of units."""
    return case.build(units)


def request(name, restitution, settings=lambda units: {}):
    """A function that builds the model of that name with the settings of a scene."""

    def build(units):
        given = {key: each.default for key, each in NORMAL_LAWS[name].settings.items()} | settings(units)
        pair = pair_of(restitution, units)
        return NORMAL_LAWS[name].build(ModelRequest(given, (pair,), units.velocity, ANGLE))

    return build


def spring(number=None, velocity=None):
    """Settings of a linear spring: a stiffness [N/m], a reference velocity [m/s], or per contact."""
    if number is not None:
        return lambda units: {"stiffness": {"value": number * units.newton / units.meter}}
    if velocity is not None:
        return lambda units: {"stiffness": {"reference_velocity": velocity * units.velocity}}
    return lambda units: {"stiffness": "onset"}


def bilinear(stiffness, velocity=None):
    """Settings of walton_braun; with a reference velocity [m/s] the restitution decreases with the impact velocity."""

    def settings(units):
        unloading = "constant" if velocity is None else {"reference_velocity": velocity * units.velocity}
        return stiffness(units) | {"unloading": unloading}

    return settings


def plastic_to(depth, tension=0.0):
    """Settings of luding: the maximum plastic overlap is 2 R depth / (1 - e^2)."""
    return lambda units: spring(2e4)(units) | {"plasticity_depth": depth, "tension": tension}


def reference_velocity(velocity):
    """Settings of kuwabara_kono with a reference velocity [m/s]."""
    return lambda units: {"reference_velocity": velocity * units.velocity}


def case(name, law, restitution, settings=lambda units: {}, **marks):
    """A case of the normal model `law`."""
    return Case(name, request(law, restitution, settings), restitution, **marks)


def adhesive(plain):
    """The same normal model with sjkr cohesion."""
    return replace(plain, name=f"sjkr_{plain.name}", build=lambda units: with_sjkr(plain.build(units)), adhesive=True)


def zhou(restitution_at, damping_ratio=0.0):
    """Settings of zhou."""
    return lambda units: {"restitution_at": restitution_at, "damping_ratio": damping_ratio}


PLAIN = (
    case("zhou_impact", "zhou", fit, zhou("impact"), plastic=True),
    case("zhou_max_overlap", "zhou", fit, zhou("max_overlap"), plastic=True),
    case("zhou_constant", "zhou", number(0.6), plastic=True),
    case("zhou_small", "zhou", number(0.05), plastic=True),
    case("zhou_without_rebound", "zhou", number(0.0), plastic=True),
    case("zhou_elastic", "zhou", number(1.0)),
    case("zhou_damped", "zhou", fit, zhou("impact", 0.2), plastic=True),
    case("hertz_elastic", "hertz", number(1.0)),
    case("hertz_damped", "hertz", number(0.6)),
    case("linear_onset", "linear", number(0.6), spring()),
    case("linear_reference", "linear", number(0.6), spring(velocity=0.7)),
    case("linear_number", "linear", number(0.6), spring(2e4)),
    case("linear_elastic", "linear", number(1.0), spring(2e4)),
    case("thornton", "thornton", no_restitution, lambda units: {"yield_ratio": 1.0}, plastic=True),
    case("thornton_elastic", "thornton", no_restitution, lambda units: {"yield_ratio": 10.0}),
    case("walton_braun_onset", "walton_braun", number(0.6), bilinear(spring()), plastic=True),
    case("walton_braun_reference", "walton_braun", number(0.6), bilinear(spring(velocity=0.7)), plastic=True),
    case("walton_braun_number", "walton_braun", number(0.6), bilinear(spring(2e4)), plastic=True),
    case("walton_braun_falling", "walton_braun", number(0.6), bilinear(spring(), 0.7), plastic=True),
    case("walton_braun_elastic", "walton_braun", number(1.0), bilinear(spring(2e4))),
    case("luding_growing", "luding", number(0.6), plastic_to(0.05), plastic=True),
    case("luding_limit", "luding", number(0.6), plastic_to(0.0064), plastic=True),
    case("luding_tension", "luding", number(0.6), plastic_to(0.0128, 0.5), plastic=True),
    case("luding_elastic", "luding", number(1.0), plastic_to(0.05)),
    case("kuwabara_kono", "kuwabara_kono", number(0.6), reference_velocity(0.7)),
    case("kuwabara_kono_elastic", "kuwabara_kono", number(1.0), reference_velocity(0.7)),
)
COHESIVE = ("zhou_impact", "hertz_elastic", "linear_number", "thornton", "walton_braun_number", "luding_tension")
CASES = (*PLAIN, *(adhesive(each) for each in PLAIN if each.name in (*COHESIVE, "kuwabara_kono")))


CONTINUOUS = tuple(each for each in CASES if each.name != "zhou_without_rebound")
"""Cases that are defined without a time step; at restitution 0 the time step limits the unloading stiffness."""


@dataclass(frozen=True)
class PathResult:
    """Forces [N] and energies [J] of contacts along paths: (contacts, steps); history: (contacts, steps, numbers)."""

    force: np.ndarray
    viscous: np.ndarray
    repulsion: np.ndarray
    """Normal force without the attraction; it limits the friction."""
    stored: np.ndarray
    lost: np.ndarray
    history: np.ndarray

    @property
    def elastic(self) -> np.ndarray:
        return self.force - self.viscous


def evaluate_path(case, overlap, rate, units=SI, radius=RADIUS, mass=MASS, time_step=TIME_STEP):
    """Evaluate contacts on the device along overlaps and rates (contacts, steps); separation resets the history.

    With a time step of 0 [s] the model does not average over a step and equals the formulas of its source.
    """
    law = case.law(units)
    shape = overlap.shape
    found = [np.zeros(shape) for _ in range(5)]
    history = np.zeros((*shape, max(law.history_count, 1)))
    constants = np.array(law.pair_constants(case.pair(units)))
    pair_arguments = (radius * units.meter, mass * units.kilogram, time_step * units.second)
    given = (overlap * units.meter, rate * units.velocity)
    kernel_for(law, len(constants))(
        constants, *pair_arguments, *(np.ascontiguousarray(g) for g in given), *found, history
    )
    return PathResult(*found, history)


@cache
def kernel_for(law, constant_count):
    """A kernel that evaluates contacts along their overlaps."""
    history_size, force_of = max(law.history_count, 1), complete_force(law)
    table, cube = ti.types.ndarray(ti.f64, 2), ti.types.ndarray(ti.f64, 3)

    @ti.kernel
    def evaluate(
        numbers: ti.types.ndarray(ti.f64, 1), radius: ti.f64, mass: ti.f64, dt: ti.f64, overlap: table, rate: table,
        force: table, viscous: table, repulsion: table, stored: table, lost: table, history: cube
    ):  # fmt: skip
        for i in range(overlap.shape[0]):
            constants = ti.Vector([numbers[k] for k in ti.static(range(constant_count))])
            history_now = ti.Vector.zero(ti.f64, history_size)
            for s in range(overlap.shape[1]):
                d = overlap[i, s]
                if d > 0.0:
                    f, v, history_now = force_of(constants, radius, mass, dt, d, rate[i, s], history_now)
                    force[i, s], viscous[i, s], repulsion[i, s] = f, v, f
                    if ti.static(law.attracts):
                        repulsion[i, s] = f + law.attraction(constants, radius, d, history_now)
                    stored[i, s] = law.stored_energy(constants, radius, mass, dt, d, history_now)
                    lost[i, s] = law.lost_energy(constants, radius, mass, dt, d, history_now)
                else:
                    history_now = 0.0 * history_now
                for k in ti.static(range(history_size)):
                    history[i, s, k] = history_now[k]

    return evaluate


def evaluate_reference(case, overlap, rate):
    """Force, force at an overlap larger by a relative `PERTURBATION`, and history of the numpy reference."""
    law = case.law()
    constants = np.array(law.pair_constants(case.pair()))
    size = max(law.history_count, 1)
    force, perturbed, history = np.zeros(overlap.shape), np.zeros(overlap.shape), np.zeros((*overlap.shape, size))
    for i in range(len(overlap)):
        history_new = np.zeros(size)
        for s, (d, v) in enumerate(zip(overlap[i], rate[i], strict=True)):
            if d > 0.0:
                pair_arguments = (constants, RADIUS, MASS, TIME_STEP)
                force[i, s], history_new = law.reference_force(*pair_arguments, d, v, history_new)
                perturbed[i, s], _ = law.reference_force(*pair_arguments, d * (1.0 + PERTURBATION), v, history_new)
            else:
                history_new = np.zeros(size)
            history[i, s] = history_new
    return force, perturbed, history


PERTURBATION = 1e-7
"""Relative change of the overlap for the tangent stiffness."""


def random_paths(contacts, steps, seed=1):
    """Overlaps [m] that increase and decrease by random amounts, with some separations, and overlap rates [m/s]."""
    rng = np.random.default_rng(seed)
    turning_points = rng.uniform(-1e-4, 4e-4, (contacts, steps // 4 + 2))
    x = np.arange(steps) / 4.0
    overlap = np.array([np.interp(x, np.arange(turning_points.shape[1]), row) for row in turning_points])
    direction = np.sign(np.diff(overlap, axis=1, prepend=-1.0))
    rate = direction * rng.uniform(0.01, 1.9, overlap.shape)
    rate[::7] *= -1.0
    return overlap, rate
