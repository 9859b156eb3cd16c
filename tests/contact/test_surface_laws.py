"""Requirements on every tangential and rolling model of the catalog."""

from dataclasses import dataclass

import numpy as np
import pytest
from contact.surface_paths import evaluate_surface, evaluate_surface_reference

from granflow.contact.law import ContactModel, ModelRequest
from granflow.contact.material import PairMaterial
from granflow.contact.registry import models
from granflow.contact.rolling import epsd
from granflow.contact.rolling.bounded_torque import STOPPED_SHARE
from granflow.contact.tangential import linear_history, mindlin
from granflow.contact.twisting import marshall, torsion_spring
from granflow.schema.quantities import numbers_of


@dataclass(frozen=True)
class Variant:
    """A model with some of its options; by default those of its example."""

    model: ContactModel
    given: dict | None = None

    @property
    def options(self):
        return self.model.options(**(self.model.example if self.given is None else self.given))

    def __str__(self):
        given = self.model.example if self.given is None else self.given
        return "-".join([self.model.slot, self.model.name, *map(str, given.values())])


VARIANTS = [
    *(Variant(model) for slot in ("tangential", "rolling", "twisting") for model in models(slot).values()),
    Variant(mindlin.MODEL, {"increments": "displacement"}),
    Variant(mindlin.MODEL, {"increments": "displacement", "unloading": "kept", "damping": 0.7}),
    Variant(mindlin.MODEL, {"unloading": "kept"}),
    Variant(mindlin.MODEL, {"damping": 1.3}),
    Variant(mindlin.MODEL, {"increments": "displacement", "damping": 0.7, "dashpot": "sticking"}),
    Variant(marshall.MODEL, {"damping": 1.3}),
    Variant(torsion_spring.MODEL, {"stiffness": 1e-3, "damping": 5e-9}),
    Variant(linear_history.MODEL, {"stiffness": 3e4, "damping": 0.5}),
    Variant(linear_history.MODEL, {"stiffness": 3e4, "damping": 0.5, "dashpot": "sticking"}),
]
every_variant = pytest.mark.parametrize("variant", VARIANTS, ids=str)
COEFFICIENT = 0.3
"""Friction coefficient, and value of every other property of the pair in SI units; lengths are 1e-5 times this."""
RADIUS, MASS, TIME_STEP = 0.01, 0.01, 1e-5
STIFFNESS, LOAD, SLIP, RATE = 1e4, 2.0, 2e-5, 1e3
"""The spring reaches its limit COEFFICIENT * LOAD after three steps of SLIP [m]; largest RATE [rad/s]."""


def law_and_pair(variant, coefficient=COEFFICIENT):
    """The law of a variant, and a pair with the same value for all its properties."""
    options = {}
    for key, each in variant.model.pair_properties.model_fields.items():
        (number,) = numbers_of(each)
        options[key] = coefficient * (1e-5 if number.dimension == "length" else 1.0)
    pair = PairMaterial(4e7, 1.2e7, 0.5, properties=options)
    request = ModelRequest(variant.options, (pair,), 1.0, 0.5, energy_budget=True)
    return variant.model.law.from_scene(request), pair


def paths(contacts, steps, seed=1, steady=False):
    """Numbers and vectors of contacts that slip and roll in random directions, with rates of 1e-4 to 1 times
    RATE.

    The normal turns by up to 0.05 rad per step and stiffness and load vary, unless the path is `steady`.
    """
    rng = np.random.default_rng(seed)
    shape = (contacts, steps)
    turning, varying = (0.0, 0.0) if steady else (0.03, 0.5)
    start = 3.0 * rng.normal(0.0, 1.0, (contacts, 1, 3))
    turns = turning * rng.normal(0.0, 1.0, (contacts, steps, 3))
    normal = np.cumsum(np.concatenate([start, turns], axis=1), axis=1)
    normal /= np.linalg.norm(normal, axis=2, keepdims=True)
    now = normal[:, 1:]
    middle = normal[:, :-1] + normal[:, 1:]
    middle /= np.sum(middle * now, axis=2, keepdims=True)
    slip, rate = (size * rng.normal(0.0, 1.0, (*shape, 3)) for size in (SLIP, RATE))
    rate *= 10.0 ** rng.uniform(-4.0, 0.0, (contacts, 1, 1))
    slip -= np.sum(slip * now, axis=2, keepdims=True) * now
    stiffness = STIFFNESS * (1.0 + varying * rng.uniform(-1.0, 1.0, shape))
    before = np.concatenate([stiffness[:, :1], stiffness[:, :-1]], axis=1)
    numbers = {
        "radius_eff": RADIUS, "mass_eff": MASS, "inertia_eff": 0.4 * MASS * RADIUS**2, "time_step": TIME_STEP,
        "longest_time_step": TIME_STEP, "overlap": 2.5e-3, "overlap_rate": 0.0, "stiffness": stiffness,
        "normal_damping": 0.1 * STIFFNESS * TIME_STEP,
        "normal_load": LOAD * (1.0 + varying * rng.uniform(-1.0, 1.0, shape)), "stiffness_ratio": before / stiffness,
        "turn": turning * rng.normal(0.0, 1.0, shape),
    }  # fmt: skip
    return numbers, {
        "normal": now, "normal_half": middle, "slip": slip, "slip_rate": slip / TIME_STEP, "rolling_rate": rate,
    }  # fmt: skip


@every_variant
def test_device_equals_its_numpy_reference(taichi_f64, variant):
    """Within one rounding of the largest force for each of the 30 steps; slip and roll reach the limit on the way.

    The partners have forces and histories of exactly opposite signs. A contact at rest, without load or without a
    coefficient has no force.
    """
    law, pair = law_and_pair(variant)
    numbers, vectors = paths(contacts=50, steps=30)
    found = evaluate_surface(law, pair, numbers, vectors)
    force, history = evaluate_surface_reference(law, pair, numbers, vectors)
    assert np.all(np.abs(found.force).max(axis=(0, 1)) > 0.0)
    np.testing.assert_allclose(found.force, force, rtol=0.0, atol=30 * 2.0**-52 * np.abs(force).max())
    scale = np.abs(history).max(axis=(0, 1)) + np.finfo(float).tiny
    np.testing.assert_allclose(found.history / scale, history / scale, rtol=0.0, atol=30 * 2.0**-52)
    turned = numbers | {"turn": -numbers["turn"]}
    exchanged = evaluate_surface(law, pair, turned, {name: -value for name, value in vectors.items()})
    signs = [-1.0 if each.size == 3 else 1.0 for each in law.history for _ in range(each.size)] or [1.0]
    for name, sign in (("force", -1.0), ("loss", 1.0), ("stored", 1.0), ("history", signs)):
        np.testing.assert_array_equal(getattr(exchanged, name), getattr(found, name) * sign)
    still = vectors | {name: 0.0 * vectors[name] for name in ("slip", "slip_rate", "rolling_rate")}
    assert not evaluate_surface(law, pair, numbers, still).force.any()
    if variant.model.pair_properties.model_fields:
        assert not evaluate_surface(law, pair, numbers | {"normal_load": 0.0}, vectors).force.any()
        assert not evaluate_surface(*law_and_pair(variant, 0.0), numbers, vectors).force.any()


@every_variant
def test_evaluation_without_motion_changes_no_displacement(taichi_f64, variant):
    """After an insertion, the forces are evaluated again with a time step of 0 and the present rates."""
    law, pair = law_and_pair(variant)
    numbers, vectors = paths(contacts=20, steps=2, seed=6, steady=True)
    numbers = {name: np.broadcast_to(value, (20, 2)).copy() for name, value in numbers.items()}
    for name in ("slip", "slip_rate", "rolling_rate"):
        vectors[name][:] = 1e-3 * vectors[name][:, :1]  # below the limit
    numbers["time_step"][:, 1], vectors["slip"][:, 1] = 0.0, 0.0
    for name in ("stiffness", "normal_load"):
        numbers[name][:, 1] = numbers[name][:, 0]
    numbers["stiffness_ratio"][:, 1] = 1.0
    found = evaluate_surface(law, pair, numbers, vectors)
    assert np.isfinite(found.force).all()
    np.testing.assert_allclose(found.stored[:, 1], found.stored[:, 0], rtol=1e-14)
    np.testing.assert_allclose(found.loss[:, 1], 0.0, atol=1e-14 * found.stored.max())


@every_variant
def test_work_equals_stored_plus_lost_energy_and_no_path_gains_energy(taichi_f64, variant):
    """Work by the trapezoid rule on contacts of constant normal, stiffness and load that return to their
    start."""
    law, pair = law_and_pair(variant)
    numbers, vectors = paths(contacts=200, steps=24, seed=5, steady=True)
    there_and_back = {name: np.concatenate([value, -value], axis=1) for name, value in vectors.items()}
    there_and_back |= {
        name: np.concatenate([vectors[name]] * 2, axis=1) for name in ("normal", "normal_half")
    }
    numbers = numbers | {
        name: np.tile(numbers[name][:, :1], 48)
        for name in ("stiffness", "stiffness_ratio", "normal_load", "turn")
    }
    found = evaluate_surface(law, pair, numbers, there_and_back)
    before = np.concatenate([np.zeros_like(found.force[:, :1]), found.force[:, :-1]], axis=1)
    path = (
        there_and_back["slip"]
        if variant.model.slot == "tangential"
        else TIME_STEP * there_and_back["rolling_rate"]
    )
    work = -0.5 * np.sum((before + found.force) * path, axis=2).sum(axis=1)
    accounted = found.stored[:, -1] + found.loss.sum(axis=1)
    np.testing.assert_allclose(work, accounted, rtol=0.0, atol=1e-12 * np.abs(accounted).max())
    assert accounted.min() >= -1e-14 * accounted.max()
    assert np.count_nonzero(accounted > 1e-3 * accounted.max()) > 20
    assert found.stored.min() >= 0.0


@pytest.mark.parametrize("model", [mindlin.MODEL, epsd.MODEL], ids=lambda model: model.name)
def test_a_spring_turns_with_both_bodies(taichi_f64, model):
    """After a step below the limit, 1000 steps turn both bodies by a quarter turn, and the force with them."""
    law, pair = law_and_pair(Variant(model))
    numbers, vectors = paths(contacts=5, steps=1001, seed=2, steady=True)
    numbers = numbers | {
        name: numbers[name][:, :1] for name in ("stiffness", "stiffness_ratio", "normal_load")
    }
    for name in ("slip", "slip_rate", "rolling_rate"):
        vectors[name][:, 0] *= 1e-3
        vectors[name][:, 1:] = 0.0
    numbers["turn"][:, 1:] = 0.5 * np.pi / 1000
    found = evaluate_surface(law, pair, numbers, vectors)
    first, normal = found.force[:, 0], vectors["normal"][:, 0]
    quarter = np.cross(normal, first)
    np.testing.assert_allclose(found.force[:, -1], quarter, rtol=0.0, atol=1e-6 * np.abs(first).max())
    np.testing.assert_allclose(found.loss[:, 1:], 0.0, atol=1e-9 * found.stored.max())


def test_dashpot_of_a_spring_of_constant_stiffness(taichi_f64):
    """Spring 3e4 N/m, dashpot 0.5 * 2 kg/s from the second step on, limit 0.6 N, slip 8 um per step at 1 m/s:
    the spring has 0.24 N and 0.48 N, and reaches the limit in the third step.

    sticking: 0.48 N + 1 N in the second step, then the limit without dashpot. limited: at most 0.6 N.
    """
    for rule, second in (("sticking", -1.48), ("limited", -0.6)):
        law, pair = law_and_pair(
            Variant(linear_history.MODEL, {"stiffness": 3e4, "damping": 0.5, "dashpot": rule})
        )
        slip = np.zeros((1, 4, 3))
        slip[..., 0] = 8e-6
        up = np.broadcast_to([0.0, 0.0, 1.0], slip.shape)
        numbers = {
            "radius_eff": RADIUS, "mass_eff": MASS, "inertia_eff": 0.4 * MASS * RADIUS**2, "time_step": 8e-6,
            "longest_time_step": 8e-6, "overlap": 2.5e-3, "overlap_rate": 0.0, "stiffness": STIFFNESS,
            "normal_damping": 2.0, "normal_load": 0.6 / COEFFICIENT, "stiffness_ratio": 1.0, "turn": 0.0,
        }  # fmt: skip
        vectors = {"normal": up, "normal_half": up, "slip": slip, "slip_rate": slip / 8e-6}
        found = evaluate_surface(law, pair, numbers, vectors | {"rolling_rate": 0.0 * slip})
        assert found.force[0, :, 0] == pytest.approx([-0.24, second, -0.6, -0.6], rel=1e-12)


def test_no_set_of_neighbors_reverses_a_rotation_in_one_step():
    """Neighbor j removes the fraction I_j / (I_i + I_j) = 1 / (1 + x^-5), x = R_j / R_i, of `STOPPED_SHARE`.

    The branch vectors from particle i to n contacting particles without mutual contact form angles of at
    least t: x / (1 + x) = sin(t / 2). The largest t for n = 3 to 14 points on a sphere: Tammes problem (Musin &
    Tarasov 2015, Exp. Math. 24:460).
    """
    angles = [
        120.0, 109.4712, 90.0, 90.0, 77.8695, 74.8585, 70.5288, 66.1468, 63.4349, 63.4349, 57.1367, 55.6706,
    ]  # fmt: skip
    sine = np.sin(0.5 * np.radians(angles))
    total = np.arange(3, 15) / (1.0 + (sine / (1.0 - sine)) ** -5)
    assert total.max() == pytest.approx(7.51, abs=0.01)
    assert STOPPED_SHARE * total.max() < 1.0
