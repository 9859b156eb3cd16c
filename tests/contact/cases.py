"""Normal models of the catalog with their settings, and the evaluation of contacts along given overlap
paths."""

from dataclasses import dataclass, field, replace
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

    def of(self, key) -> float:
        """Value of the SI unit of an option, 1 for options that are not numbers with a unit."""
        if key in ("value", "work_of_adhesion"):
            return self.newton / self.meter
        units = {"reference_velocity": self.velocity, "pull_off_force": self.newton}
        return units.get(key, 1.0)


def in_units(options, units):
    """Options of a model or pair, with their numbers in other units."""

    def scaled(key, value):
        if isinstance(value, dict):
            return in_units(value, units)
        return value * units.of(key) if isinstance(value, float) else value

    return {key: scaled(key, value) for key, value in options.items()}


SI = Units()
MODULUS, SHEAR_MODULUS = 4e7, 1.2e7
RADIUS, MASS, TIME_STEP = 0.01, 0.01, 1e-5
"""A soft particle of radius 1 cm; its maximum overlap at 1 m/s is 0.35 mm, reached after 51 steps."""
YIELD_STRENGTH = 1e6
"""With this maximum contact pressure [Pa], a Hertz contact yields at an overlap of 15 micrometers."""
COHESION = 5e4
"""Cohesion energy density [J/m3]: an attraction of 3.1 kN/m times the overlap, below a sixth of the 20 kN/m
spring."""
ANGLE = 0.5
FIT = VelocityRestitution(1.2, 0.54, 2.0)
"""A restitution that decreases with the impact velocity."""


@dataclass(frozen=True, eq=False)
class Case:
    """One normal model with its settings, in SI units; without restitution it follows from the yield strength."""

    name: str
    model: str
    restitution: float | VelocityRestitution | None
    settings: dict = field(default_factory=dict)
    properties: dict[str, float] = field(default_factory=dict)
    """Properties of pairs other than those of all cases."""
    plastic: bool = False
    """Whether unloading differs from loading."""
    adhesive: bool = False
    """Whether the sjkr cohesion is added, which the closed forms of the normal model do not include."""
    pulls_off: bool = False
    """Whether the force at zero overlap is a constant attraction, whose energy is negative."""

    def __str__(self) -> str:
        return self.name

    def pair(self, units=SI):
        """The pair material in the given units."""
        restitution = self.restitution
        if isinstance(restitution, VelocityRestitution):
            restitution = replace(restitution, limit_velocity=restitution.limit_velocity * units.velocity)
        return PairMaterial(
            MODULUS * units.pascal,
            SHEAR_MODULUS * units.pascal,
            restitution,
            yield_strength=YIELD_STRENGTH * units.pascal if restitution is None else None,
            properties={"cohesion_energy_density": COHESION * units.pascal}
            | in_units(self.properties, units),
        )

    @cache  # noqa: B019
    def laws(self, units=SI):
        model = models("normal")[self.model]
        given = model.options(**in_units(self.settings, units))
        asked = ModelRequest(given, (self.pair(units),), units.velocity, ANGLE, energy_budget=True)
        law = model.law.from_scene(asked)
        return ContactLaws((law, Sjkr()) if self.adhesive else (law,))

    def law(self, units=SI):
        return self.laws(units).normal


def zhou(restitution_at, damping_ratio=0.0):
    """Settings of zhou."""
    return {"restitution_at": restitution_at, "damping_ratio": damping_ratio}


def bilinear(stiffness, unloading="constant"):
    """Settings of walton_braun."""
    return {"stiffness": stiffness, "unloading": unloading}


def plastic_to(depth, tension=0.0):
    """Settings of luding: the maximum plastic overlap is 2 R depth / (1 - e^2)."""
    return {"stiffness": SPRING, "plasticity_depth": depth, "tension": tension}


def eepa(chi, stiffness="hertz"):
    """Settings of eepa: exponent of the adhesion branch, stiffness."""
    return {"stiffness": stiffness, "adhesion_exponent": chi}


def adhesion(plasticity, work_of_adhesion, pull_off_force=0.0):
    """Properties of pairs of eepa: work of adhesion [J/m2], pull-off force [N]."""
    return {"plasticity": plasticity, "work_of_adhesion": work_of_adhesion, "pull_off_force": pull_off_force}


SPRING = {"value": 2e4}
"""Stiffness [N/m] of a linear spring."""
SLOW = {"reference_velocity": 0.7}
"""Reference velocity [m/s] of a stiffness or of a restitution that decreases with the impact velocity."""
PLAIN = (
    Case("zhou_impact", "zhou", FIT, zhou("impact"), plastic=True),
    Case("zhou_max_overlap", "zhou", FIT, zhou("max_overlap"), plastic=True),
    Case("zhou_constant", "zhou", 0.6, plastic=True),
    Case("zhou_small", "zhou", 0.05, plastic=True),
    Case("zhou_without_rebound", "zhou", 0.0, plastic=True),
    Case("zhou_elastic", "zhou", 1.0),
    Case("zhou_damped", "zhou", FIT, zhou("impact", 0.2), plastic=True),
    Case("hertz_elastic", "hertz", 1.0),
    Case("hertz_damped", "hertz", 0.6),
    Case("linear_onset", "linear", 0.6, {"stiffness": "onset"}),
    Case("linear_reference", "linear", 0.6, {"stiffness": SLOW}),
    Case("linear_number", "linear", 0.6, {"stiffness": SPRING}),
    Case("linear_elastic", "linear", 1.0, {"stiffness": SPRING}),
    Case("thornton", "thornton", None, {"yield_ratio": 1.0}, plastic=True),
    Case("thornton_elastic", "thornton", None, {"yield_ratio": 10.0}),
    Case("walton_braun_onset", "walton_braun", 0.6, bilinear("onset"), plastic=True),
    Case("walton_braun_reference", "walton_braun", 0.6, bilinear(SLOW), plastic=True),
    Case("walton_braun_number", "walton_braun", 0.6, bilinear(SPRING), plastic=True),
    Case("walton_braun_falling", "walton_braun", 0.6, bilinear("onset", SLOW), plastic=True),
    Case("walton_braun_elastic", "walton_braun", 1.0, bilinear(SPRING)),
    Case("luding_growing", "luding", 0.6, plastic_to(0.05), plastic=True),
    Case("luding_limit", "luding", 0.6, plastic_to(0.0064), plastic=True),
    Case("luding_tension", "luding", 0.6, plastic_to(0.0128, 0.5), plastic=True),
    Case("luding_elastic", "luding", 1.0, plastic_to(0.05)),
    Case("eepa", "eepa", 1.0, eepa(1.5), adhesion(0.4, 60.0), plastic=True),
    Case("eepa_damped", "eepa", 0.8, eepa(3.0), adhesion(0.3, 60.0), plastic=True),
    Case("eepa_linear", "eepa", 1.0, eepa(1.0, SPRING), adhesion(0.5, 60.0), plastic=True),
    Case("eepa_pull_off", "eepa", 1.0, eepa(1.5), adhesion(0.4, 0.0, 0.3), plastic=True, pulls_off=True),
    Case("eepa_without_adhesion", "eepa", 1.0, eepa(1.5), adhesion(0.4, 0.0), plastic=True),
    Case("eepa_elastic", "eepa", 1.0, eepa(1.5), adhesion(0.0, 0.0)),
    Case("kuwabara_kono", "kuwabara_kono", 0.6, SLOW),
    Case("kuwabara_kono_elastic", "kuwabara_kono", 1.0, SLOW),
)
COHESIVE = ("zhou_impact", "walton_braun_number", "luding_tension", "kuwabara_kono")
CASES = (
    *PLAIN,
    *(replace(each, name=f"sjkr_{each.name}", adhesive=True) for each in PLAIN if each.name in COHESIVE),
)
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
