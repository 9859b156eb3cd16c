"""Normal models of the catalog with their settings, and the evaluation of contacts along given overlap
paths."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from types import SimpleNamespace

import numpy as np

from granflow.contact.cohesion.sjkr import Sjkr
from granflow.contact.law import ContactState, ModelRequest
from granflow.contact.material import PairMaterial, VelocityRestitution
from granflow.contact.registry import ContactLaws, models
from granflow.engine.pair import ModelStructs, PairForce
from granflow.kernel_language import ti


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
"""Cohesion energy density [J/m3]: an attraction of 3.1 kN/m times the overlap, below a sixth of the 20 kN/m
spring."""
ANGLE = 0.5


def fit(units):
    """A restitution that decreases with the impact velocity."""
    return VelocityRestitution(1.2, 0.54, 2.0 * units.velocity)


def number(e):
    """A constant restitution."""
    return lambda units: e


def no_restitution(units):
    """No restitution: it follows from the yield strength of the material."""


def no_properties(units):
    """No properties of pairs other than those of all cases."""
    return {}


def adhesion(plasticity, work_of_adhesion, pull_off_force=0.0):
    """Properties of pairs of eepa: work of adhesion [J/m2], pull-off force [N]."""
    return lambda units: {
        "plasticity": plasticity,
        "work_of_adhesion": work_of_adhesion * units.newton / units.meter,
        "pull_off_force": pull_off_force * units.newton,
    }


def pair_of(restitution, units, properties=no_properties):
    """The pair material of a case in the given units."""
    yield_strength = YIELD_STRENGTH * units.pascal if restitution is no_restitution else None
    elastic = (MODULUS * units.pascal, SHEAR_MODULUS * units.pascal)
    options = {"cohesion_energy_density": COHESION * units.pascal} | properties(units)
    return PairMaterial(*elastic, restitution(units), yield_strength=yield_strength, properties=options)


@dataclass(frozen=True)
class Case:
    """One normal model with its settings, in any units."""

    name: str
    build: Callable[[Units], ContactLaws]
    restitution: Callable[[Units], float | VelocityRestitution | None]
    plastic: bool = False
    """Whether unloading differs from loading."""
    adhesive: bool = False
    """Whether the sjkr cohesion is added, which the closed forms of the normal model do not include."""
    pulls_off: bool = False
    """Whether the force at zero overlap is a constant attraction, whose energy is negative."""
    properties: Callable[[Units], dict[str, float]] = no_properties

    def __str__(self) -> str:
        return self.name

    def pair(self, units=SI):
        return pair_of(self.restitution, units, self.properties)

    def laws(self, units=SI):
        return laws_of(self, units)

    def law(self, units=SI):
        return self.laws(units).normal


@cache
def laws_of(case, units):
    """The models of a case, built once per system of units."""
    return case.build(units)


def request(name, restitution, settings=lambda units: {}, properties=no_properties):
    """A function that builds the model of that name with the settings of a scene."""

    def build(units):
        model = models("normal")[name]
        pair = pair_of(restitution, units, properties)
        given = model.options(**settings(units))
        asked = ModelRequest(given, (pair,), units.velocity, ANGLE, energy_budget=True)
        return ContactLaws((model.law.from_scene(asked),))

    return build


def spring(number=None, velocity=None):
    """Settings of a linear spring: a stiffness [N/m], a reference velocity [m/s], or per contact."""
    if number is not None:
        return lambda units: {"stiffness": {"value": number * units.newton / units.meter}}
    if velocity is not None:
        return lambda units: {"stiffness": {"reference_velocity": velocity * units.velocity}}
    return lambda units: {"stiffness": "onset"}


def bilinear(stiffness, velocity=None):
    """Settings of walton_braun; with a reference velocity [m/s] the restitution decreases with the impact
    velocity."""

    def settings(units):
        unloading = "constant" if velocity is None else {"reference_velocity": velocity * units.velocity}
        return stiffness(units) | {"unloading": unloading}

    return settings


def plastic_to(depth, tension=0.0):
    """Settings of luding: the maximum plastic overlap is 2 R depth / (1 - e^2)."""
    return lambda units: spring(2e4)(units) | {"plasticity_depth": depth, "tension": tension}


def eepa(chi, number=None):
    """Settings of eepa: exponent of the adhesion branch, stiffness [N/m] for the exponent 1 of the overlap."""
    spring_of = (lambda units: {"stiffness": "hertz"}) if number is None else spring(number)
    return lambda units: spring_of(units) | {"adhesion_exponent": chi}


def reference_velocity(velocity):
    """Settings of kuwabara_kono with a reference velocity [m/s]."""
    return lambda units: {"reference_velocity": velocity * units.velocity}


def case(name, law, restitution, settings=lambda units: {}, properties=no_properties, **marks):
    """A case of the normal model `law`."""
    build = request(law, restitution, settings, properties)
    return Case(name, build, restitution, properties=properties, **marks)


def adhesive(plain):
    """The same normal model with sjkr cohesion."""
    return replace(
        plain,
        name=f"sjkr_{plain.name}",
        build=lambda units: ContactLaws((*plain.build(units).laws, Sjkr())),
        adhesive=True,
    )


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
    case("eepa", "eepa", number(1.0), eepa(1.5), adhesion(0.4, 60.0), plastic=True),
    case("eepa_damped", "eepa", number(0.8), eepa(3.0), adhesion(0.3, 60.0), plastic=True),
    case("eepa_linear", "eepa", number(1.0), eepa(1.0, 2e4), adhesion(0.5, 60.0), plastic=True),
    case(
        "eepa_pull_off", "eepa", number(1.0), eepa(1.5), adhesion(0.4, 0.0, 0.3), plastic=True, pulls_off=True
    ),
    case("eepa_without_adhesion", "eepa", number(1.0), eepa(1.5), adhesion(0.4, 0.0), plastic=True),
    case("eepa_elastic", "eepa", number(1.0), eepa(1.5), adhesion(0.0, 0.0)),
    case("kuwabara_kono", "kuwabara_kono", number(0.6), reference_velocity(0.7)),
    case("kuwabara_kono_elastic", "kuwabara_kono", number(1.0), reference_velocity(0.7)),
)
COHESIVE = ("zhou_impact", "walton_braun_number", "luding_tension", "kuwabara_kono")
CASES = (*PLAIN, *(adhesive(each) for each in PLAIN if each.name in COHESIVE))
CONTINUOUS = tuple(each for each in CASES if each.name != "zhou_without_rebound")
"""Cases that are defined without a time step; at restitution 0 the time step limits the unloading
stiffness."""


@dataclass(frozen=True)
class PathResult:
    """Forces [N] and energies [J] of contacts along paths: (contacts, steps); history: (contacts, steps,
    numbers)."""

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
    """Evaluate contacts on the device along overlaps and rates (contacts, steps); separation resets the
    history.

    With a time step of 0 [s] the model does not average over a step and equals the formulas of its source.
    """
    laws = case.laws(units)
    shape = overlap.shape
    found = [np.zeros(shape) for _ in range(5)]
    history = np.zeros((*shape, max(laws.normal.history_count, 1)))
    constants = (np.array(laws.pair_constants(case.pair(units))), law_parameters(laws))
    pair_arguments = (radius * units.meter, mass * units.kilogram, time_step * units.second)
    given = (overlap * units.meter, rate * units.velocity)
    kernel_for(laws)(*constants, *pair_arguments, *(np.ascontiguousarray(g) for g in given), *found, history)
    return PathResult(*found, history)


def law_parameters(laws):
    """Row of the law parameters; one 0 without parameters, because arrays of kernels are not empty."""
    return np.array([value for own in laws.parameters.values() for value in own.values()] or [0.0])


def single_contact(laws):
    """Device functions for one contact in a test kernel: constants, contact, history, force, energies of the
    laws."""
    structs = ModelStructs(laws)
    pair_force = PairForce(laws, rotation=False, is_prepared=False)
    size = max(laws.normal.history_count, 1)
    pair_count = sum(map(len, laws.constant_names.values()))
    parameter_count = len(law_parameters(laws))
    counts = {slot: law.history_count for slot, law in laws.by_slot.items() if law.history_count}

    @ti.func
    def zeros(slot: ti.template(), first, second):
        return ti.Vector.zero(ti.f64, ti.static(counts[slot]))

    @ti.func
    def vector_of(numbers: ti.template(), count: ti.template()):
        return ti.Vector([numbers[k] for k in ti.static(range(count))])

    @ti.func
    def read_constants(pair: ti.template(), parameters: ti.template()):
        return structs.constants(vector_of(pair, pair_count), vector_of(parameters, parameter_count))

    @ti.func
    def new_history():
        return structs.histories(zeros, 0, 0)

    @ti.func
    def contact_of(radius, mass, dt, overlap, rate):
        return ti.Struct(radius_eff=radius, mass_eff=mass, time_step=dt, overlap=overlap, overlap_rate=rate)

    @ti.func
    def energies(constants, contact, history):
        stored = laws.normal.stored_energy(constants.normal, contact, history.normal)
        lost = laws.normal.lost_energy(constants.normal, contact, history.normal)
        if ti.static(laws.has_cohesion):
            stored += laws.cohesion.stored_energy(constants.cohesion, contact, history.cohesion)
            lost += laws.cohesion.lost_energy(constants.cohesion, contact, history.cohesion)
        return stored, lost

    @ti.func
    def history_vector(history):
        vector = ti.Vector.zero(ti.f64, size)
        if ti.static("normal" in counts):
            vector = structs.vector("normal", history.normal)
        return vector

    return read_constants, new_history, contact_of, pair_force.normal_force, energies, history_vector


@cache
def kernel_for(laws):
    """A kernel that evaluates contacts along their overlaps."""
    read_constants, new_history, contact_of, force_of, energies, history_vector = single_contact(laws)
    history_size = max(laws.normal.history_count, 1)
    row, table, cube = (ti.types.ndarray(ti.f64, dimensions) for dimensions in (1, 2, 3))

    @ti.kernel
    def evaluate(
        pair: row, parameters: row, radius: ti.f64, mass: ti.f64, dt: ti.f64, overlap: table, rate: table,
        force: table, viscous: table, repulsion: table, stored: table, lost: table, history: cube
    ):  # fmt: skip
        for i in range(overlap.shape[0]):
            constants = read_constants(pair, parameters)
            history_now = new_history()
            for s in range(overlap.shape[1]):
                contact = contact_of(radius, mass, dt, overlap[i, s], rate[i, s])
                if contact.overlap > 0.0:
                    f, load, v, history_new = force_of(constants, contact, history_now)
                    history_now = history_new
                    force[i, s], viscous[i, s], repulsion[i, s] = f, v, load
                    stored[i, s], lost[i, s] = energies(constants, contact, history_now)
                else:
                    history_now = new_history()
                vector = history_vector(history_now)
                for k in ti.static(range(history_size)):
                    history[i, s, k] = vector[k]

    return evaluate


def evaluate_reference(case, overlap, rate):
    """Force, force at an overlap larger by a relative `PERTURBATION`, and history of the numpy reference."""
    law = case.law()
    cohesion = case.laws().cohesion
    pair = case.pair()
    constants = np.array(law.pair_constants(pair))
    size = max(law.history_count, 1)

    def attraction(d):
        """Attraction [N] of the cohesion model."""
        if cohesion is None:
            return 0.0
        named = SimpleNamespace(
            **dict(zip(cohesion.constant_names, cohesion.pair_constants(pair), strict=True))
        )
        return cohesion.reference(ContactState(named, RADIUS, MASS, TIME_STEP, d, 0.0, SimpleNamespace()))[0]

    force = np.zeros(overlap.shape)
    perturbed = np.zeros(overlap.shape)
    history = np.zeros((*overlap.shape, size))
    for i in range(len(overlap)):
        history_new = np.zeros(size)
        for s, (d, v) in enumerate(zip(overlap[i], rate[i], strict=True)):
            if d > 0.0:
                pair_arguments = (constants, RADIUS, MASS, TIME_STEP)
                force[i, s], history_new = law.reference_force(*pair_arguments, d, v, history_new)
                perturbed[i, s], _ = law.reference_force(
                    *pair_arguments, d * (1.0 + PERTURBATION), v, history_new
                )
                force[i, s] -= attraction(d)
                perturbed[i, s] -= attraction(d * (1.0 + PERTURBATION))
            else:
                history_new = np.zeros(size)
            history[i, s] = history_new
    return force, perturbed, history


PERTURBATION = 1e-7
"""Relative change of the overlap for the tangent stiffness."""


def random_paths(contacts, steps, seed=1):
    """Overlaps [m] that increase and decrease by random amounts, with some separations, and overlap rates
    [m/s]."""
    rng = np.random.default_rng(seed)
    turning_points = rng.uniform(-1e-4, 4e-4, (contacts, steps // 4 + 2))
    x = np.arange(steps) / 4.0
    overlap = np.array([np.interp(x, np.arange(turning_points.shape[1]), row) for row in turning_points])
    direction = np.sign(np.diff(overlap, axis=1, prepend=-1.0))
    rate = direction * rng.uniform(0.01, 1.9, overlap.shape)
    rate[::7] *= -1.0
    return overlap, rate
