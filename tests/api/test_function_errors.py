"""Errors in the functions of forces and contact models: one sentence with function, file, line and reason."""

from dataclasses import dataclass
from inspect import getsourcelines
from pathlib import Path
from types import ModuleType

import pytest
from api.scenes import flying

import granflow as gf
from granflow.contact.law import CohesionLaw, ContactModel
from granflow.device_functions import ti
from granflow.kernel_language import KERNELS
from granflow.scene.registration import unregister_contact_model


def undefined(position, velocity, radius, mass, time, parameters):
    factor = 2.0
    return factor * velocity * viscosity  # noqa: F821


def nothing(position, velocity, radius, mass, time, parameters):
    force = mass * velocity  # noqa: F841


def position_of(function, line):
    """File and line of the source, as in messages."""
    return f"{Path(__file__)}:{getsourcelines(function)[1] + line}"


def scene(**more):
    """Two particles that overlap."""
    return flying([[0.0] * 3, [0.0, 0.0099, 0.0]], [0.0] * 3, **more)


OTHER = "taichi" if KERNELS == "quadrants" else "quadrants"
other_ti = ModuleType(OTHER)
"""A kernel language that a program imports, but that does not compile its functions."""


def foreign(position, velocity, radius, mass, time, parameters):
    return mass * other_ti.sqrt(velocity)


@pytest.mark.parametrize(("function", "line", "reason"), [
    (undefined, 2, 'Name "viscosity" is not defined; give numbers of the program in `parameters`'),
    (nothing, 0, "the function must return a vector of three components [N]"),
    (
        foreign, 1, f"other_ti is {OTHER}, but granflow runs with {KERNELS}: write import {KERNELS} as other_ti, "
        f"or set GRANFLOW_KERNELS={OTHER}",
    ),
])  # fmt: skip
def test_force_that_cannot_be_compiled(taichi_f64, function, line, reason):
    force = gf.ParticleForce(function, {"viscosity": 1.0})
    where = position_of(function, line)
    with gf.Simulation(scene()) as simulation:
        with pytest.raises(gf.FunctionError) as error:
            simulation.forces.append(force)
        assert (
            str(error.value) == f"The force {function.__name__} at 0 s cannot be compiled: {where}: {reason}."
        )
        simulation.step(2)


class Faulty(CohesionLaw):
    """Texts of all models of this test."""

    source = "this test"
    limits = "cannot be compiled"

    def reference(self, contact):
        return 0.0, {}


@ti.func
def helper(overlap):
    return overlap * stiffness  # noqa: F821


@dataclass(frozen=True)
class Undefined(Faulty):
    name = "undefined_name"

    @ti.func
    def force(self, constants, contact, history):
        return helper(contact.overlap), history


def test_contact_model_that_cannot_be_compiled(taichi_f64):
    """Lines are those of the function with its decorator."""
    model = ContactModel(Undefined, "cannot be compiled")
    gf.register_contact_model(model)
    contact = {"normal": "hertz", "tangential": "none", "rolling": "none", "cohesion": Undefined.name}
    try:
        with pytest.raises(gf.FunctionError) as error, gf.Simulation(scene(contact=contact)) as simulation:
            simulation.step()
    finally:
        unregister_contact_model(model)
    assert str(error.value) == (
        "The function force of the contact model undefined_name cannot be compiled: "
        f'{position_of(helper, 2)}: Name "stiffness" is not defined; give numbers of the program in `parameters`.'
    )
    with gf.Simulation(scene()) as simulation:
        simulation.step(2)


@ti.func
def limited(value):
    result = value
    if value > 1.0:
        result = 1.0
    return result


class Branching(Faulty):
    """Conditions that are known when the kernel is compiled, and one that is not."""

    name = "branching"
    doubled = True

    @ti.func
    def force(self, constants, contact, history):
        result = contact.overlap
        if self.doubled and ti.static(len(history.keys) == 0):
            result = 2.0 * result
        return limited(result), history


def test_a_branch_in_a_vectorized_function_is_refused_at_registration():
    """Without the refusal the process ends with a segmentation fault when the first scene is compiled."""
    with pytest.raises(gf.GranflowError) as error:
        gf.register_contact_model(ContactModel(Branching, "has a branch"))
    assert f"{position_of(limited, 3)}: force has a branch that depends on the contact" in str(error.value)


def test_functions_with_other_arguments_and_lambdas_are_refused():
    with pytest.raises(gf.GranflowError, match=r"takes \(position, velocity\), but must take \(position, "):
        gf.ParticleForce(lambda position, velocity: velocity)
    with pytest.raises(gf.GranflowError, match="cannot compile a lambda: define the function with def"):
        gf.ParticleForce(lambda position, velocity, radius, mass, time, parameters: velocity)
