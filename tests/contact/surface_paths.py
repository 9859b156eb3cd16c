"""Evaluation of tangential, rolling and cohesion models along given paths of one contact, on the device."""

from dataclasses import dataclass
from functools import cache
from types import SimpleNamespace

import numpy as np

from granflow.contact.law import TangentialLaw
from granflow.engine.pair import ModelStructs
from granflow.kernel_language import ti

NUMBERS = (
    *("radius_eff", "mass_eff", "inertia_eff", "time_step", "longest_time_step", "overlap", "overlap_rate"),
    *("normal_load", "stiffness", "stiffness_ratio", "normal_damping", "turn"),
)
VECTORS = ("normal", "normal_half", "slip", "slip_rate", "rolling_rate")
"""Members of the struct `contact` of tangential and rolling models."""


@dataclass(frozen=True)
class SurfaceLaws:
    """One tangential or rolling model as `ContactLaws`, without a normal model."""

    law: object

    @property
    def by_slot(self):
        return {"surface": self.law}

    @property
    def constant_names(self):
        return {"surface": self.law.constant_names}

    @property
    def parameters(self):
        return {"surface": self.law.parameters}

    @property
    def history(self):
        return {"surface": self.law.history}


@dataclass(frozen=True)
class SurfaceResult:
    """Forces [N] or torques [N m] (contacts, steps, 3), energies [J] (contacts, steps), history as a
    table."""

    force: np.ndarray
    loss: np.ndarray
    stored: np.ndarray
    history: np.ndarray


def evaluate_surface(law, pair, numbers, vectors, first=0.0):
    """Forces along paths; `numbers` (contacts, steps) and `vectors` (contacts, steps, 3) are by name.

    `first`: first history number before. The force of a cohesion model is the first component, its loss since the
    start.
    """
    shape = vectors["normal"].shape[:2]
    table = np.ascontiguousarray(
        np.stack([np.broadcast_to(numbers[name], shape) for name in NUMBERS], axis=2), float
    )
    cube = np.ascontiguousarray(np.stack([vectors[name] for name in VECTORS], axis=2), float)
    history = np.zeros((*shape, max(law.history_count, 1)))
    history[:, 0, 0] = first
    found = np.zeros((*shape, 3)), np.zeros(shape), np.zeros(shape), history
    row = np.array(law.pair_constants(pair)), np.array(list(law.parameters.values()) or [0.0])
    surface_kernel(law)(*row, table, cube, *found)
    return SurfaceResult(*found)


@cache
def surface_kernel(law):
    """A kernel that evaluates a tangential or rolling model along paths."""
    laws = SurfaceLaws(law)
    size = max(law.history_count, 1)
    structs = ModelStructs(laws)
    counts = (len(law.constant_names), max(len(law.parameters), 1))

    @ti.func
    def attraction(constants, contact, history):
        force, history_new = law.force(constants, contact, history)
        return ti.Vector([force, 0.0, 0.0]), history_new, law.lost_energy(constants, contact, history_new)

    model_force = law.force if isinstance(law, TangentialLaw) else getattr(law, "torque", attraction)
    has_history = law.history_count > 0
    row, square, cube, four = (ti.types.ndarray(ti.f64, dimensions) for dimensions in (1, 2, 3, 4))

    @ti.func
    def vector(numbers: ti.template(), count: ti.template()):
        return ti.Vector([numbers[k] for k in ti.static(range(count))])

    @ti.func
    def number_in(numbers: ti.template(), vectors: ti.template(), i, s, k: ti.template()):
        return numbers[i, s, k]

    @ti.func
    def vector_in(numbers: ti.template(), vectors: ti.template(), i, s, k: ti.template()):
        return ti.Vector([vectors[i, s, k, 0], vectors[i, s, k, 1], vectors[i, s, k, 2]])

    members = [
        (name, read, k)
        for names, read in ((NUMBERS, number_in), (VECTORS, vector_in))
        for k, name in enumerate(names)
    ]

    @ti.func
    def contact_of(numbers: ti.template(), vectors: ti.template(), i, s):
        return ti.Struct({name: read(numbers, vectors, i, s, k) for name, read, k in ti.static(members)})

    @ti.kernel
    def evaluate(pair: row, parameters: row, numbers: cube, vectors: four, force: cube, loss: square, stored: square,
                 history: cube):  # fmt: skip
        for i in range(loss.shape[0]):
            state = ti.Vector.zero(ti.f64, size)
            state[0] = history[i, 0, 0]
            constants = structs.constants(vector(pair, counts[0]), vector(parameters, counts[1])).surface
            for s in range(loss.shape[1]):
                contact = contact_of(numbers, vectors, i, s)
                found, history_new, lost = model_force(constants, contact, structs.history("surface", state))
                if ti.static(has_history):
                    state = structs.vector("surface", history_new)
                loss[i, s], stored[i, s] = lost, law.stored_energy(constants, contact, history_new)
                for k in ti.static(range(3)):
                    force[i, s, k] = found[k]
                for k in ti.static(range(size)):
                    history[i, s, k] = state[k]

    return evaluate


def evaluate_surface_reference(law, pair, numbers, vectors):
    """The same as `evaluate_surface` by the reference implementation: force and history."""
    shape = vectors["normal"].shape[:2]
    force = np.zeros((*shape, 3))
    history = np.zeros((*shape, max(law.history_count, 1)))
    constants = SimpleNamespace(**dict(zip(law.constant_names, law.pair_constants(pair), strict=True)))
    for i in range(shape[0]):
        state = {each.name: 0.0 if each.size == 1 else np.zeros(3) for each in law.history}
        for s in range(shape[1]):
            contact = {name: float(np.broadcast_to(numbers[name], shape)[i, s]) for name in NUMBERS}
            contact |= {name: vectors[name][i, s] for name in VECTORS}
            force[i, s], changed = law.reference(
                SimpleNamespace(constants=constants, history=SimpleNamespace(**state), **contact)
            )
            state |= dict(changed)
            if state:
                history[i, s] = np.concatenate([np.atleast_1d(value) for value in state.values()])
    return force, history
