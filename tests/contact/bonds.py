"""Evaluation of cohesion models along given distances of one contact, without a normal model."""

from dataclasses import dataclass
from functools import cache
from types import SimpleNamespace

import numpy as np
from contact.surface_paths import SurfaceLaws

from granflow.contact.law import ContactState, ModelRequest
from granflow.contact.material import PairMaterial
from granflow.contact.registry import models
from granflow.engine.pair import ModelStructs
from granflow.kernel_language import ti

RADIUS, MODULUS = 1e-4, 1e7
"""Effective radius [m] and modulus [Pa] of a soft particle, to which JKR applies."""
OPTIONS = {
    "work_of_adhesion": 0.05, "surface_tension": 0.072, "contact_angle": 0.3, "liquid_volume": 1e-16,
    "cohesion_energy_density": 1e4, "hamaker_constant": 1e-19, "separation": 1e-8,
}  # fmt: skip


def pair_with(**options):
    """An elastic pair with the values of OPTIONS, or others."""
    return PairMaterial(MODULUS, 0.3 * MODULUS, 1.0, properties=OPTIONS | options)


def law_of(name, pair):
    """The cohesion model of this name for a pair, with its example options and the energy budget."""
    model = models("cohesion")[name]
    given = {"max_bridge_volume": 1e-15} if name == "capillary_transfer" else {}
    return model.law.from_scene(
        ModelRequest(model.options(**given), (pair,), 1.0, 0.5, energy_budget=True, radius_eff_max=RADIUS)
    )


@dataclass(frozen=True)
class BondResult:
    """Attraction [N], stored and lost energy [J] (contacts, steps), and history (contacts, steps,
    numbers)."""

    attraction: np.ndarray
    stored: np.ndarray
    lost: np.ndarray
    history: np.ndarray


def evaluate_bonds(law, pair, overlap, first=0.0):
    """Attraction along overlaps (contacts, steps) [m], which may be negative; `first`: first history field
    before."""
    found = [np.zeros(overlap.shape) for _ in range(3)]
    history = np.zeros((*overlap.shape, max(law.history_count, 1)))
    history[:, 0, 0] = first
    row = np.array(law.pair_constants(pair)), np.array(list(law.parameters.values()) or [0.0])
    bond_kernel(law)(*row, np.ascontiguousarray(overlap), *found, history)
    return BondResult(*found, history)


@cache
def bond_kernel(law):
    """A kernel that evaluates a cohesion model along overlaps."""
    laws = SurfaceLaws(law)
    size = max(law.history_count, 1)
    structs = ModelStructs(laws)
    counts = (len(law.constant_names), max(len(law.parameters), 1))
    has_history = law.history_count > 0
    row, square, cube = (ti.types.ndarray(ti.f64, dimensions) for dimensions in (1, 2, 3))

    @ti.func
    def vector(numbers: ti.template(), count: ti.template()):
        return ti.Vector([numbers[k] for k in ti.static(range(count))])

    @ti.kernel
    def evaluate(pair: row, parameters: row, overlap: square, attraction: square, stored: square, lost: square,
                 history: cube):  # fmt: skip
        for i in range(overlap.shape[0]):
            state = ti.Vector.zero(ti.f64, size)
            state[0] = history[i, 0, 0]
            constants = structs.constants(vector(pair, counts[0]), vector(parameters, counts[1])).surface
            for s in range(overlap.shape[1]):
                contact = ti.Struct(
                    radius_eff=RADIUS, mass_eff=1.0, time_step=1.0, overlap=overlap[i, s], overlap_rate=0.0
                )
                force, history_new = law.force(constants, contact, structs.history("surface", state))
                if ti.static(has_history):
                    state = structs.vector("surface", history_new)
                attraction[i, s], stored[i, s] = force, law.stored_energy(constants, contact, history_new)
                lost[i, s] = law.lost_energy(constants, contact, history_new)
                for k in ti.static(range(size)):
                    history[i, s, k] = state[k]

    return evaluate


def evaluate_reference_bonds(law, pair, overlap, **first):
    """Attraction [N] along overlaps by the reference implementation; `first`: history before."""
    constants = SimpleNamespace(**dict(zip(law.constant_names, law.pair_constants(pair), strict=True)))
    attraction = np.zeros(overlap.shape)
    for i, path in enumerate(overlap):
        history = first
        for s, d in enumerate(path):
            state = ContactState(constants, RADIUS, 1.0, 1.0, float(d), 0.0, SimpleNamespace(**history))
            attraction[i, s], history = law.reference(state)
    return attraction
