"""Evaluation of cohesion models along given distances of one contact, without a normal model."""

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
from contact.surface_paths import NUMBERS, VECTORS, evaluate_surface

from granflow.contact.law import ContactState, ModelRequest
from granflow.contact.material import PairMaterial
from granflow.contact.registry import models

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
    numbers = dict.fromkeys(NUMBERS, 0.0) | {"radius_eff": RADIUS, "mass_eff": 1.0, "overlap": overlap}
    vectors = dict.fromkeys(VECTORS, np.zeros((*overlap.shape, 3)))
    found = evaluate_surface(law, pair, numbers | {"time_step": 1.0}, vectors, first)
    return BondResult(found.force[..., 0], found.stored, found.loss, found.history)


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
