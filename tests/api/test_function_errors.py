"""Errors in the functions of forces and contact models: one sentence with function, file, line and reason."""

from dataclasses import dataclass
from inspect import getsourcelines
from pathlib import Path

import pytest
from api.scenes import flying

import granflow as gf
from granflow.contact.law import CohesionLaw, ContactModel, HistoryField
from granflow.device_functions import ti
from granflow.scene.registration import unregister_contact_model


def undefined(position, velocity, radius, mass, time, parameters):
    factor = 2.0
    return factor * velocity * viscosity  # noqa: F821


def member(position, velocity, radius, mass, time, parameters):
    return parameters.viscosiy * velocity


def early(position, velocity, radius, mass, time, parameters):
    if radius > 0.0:
        return velocity
    return -velocity


def nothing(position, velocity, radius, mass, time, parameters):
    force = mass * velocity  # noqa: F841


_DEFINED: dict = {}
exec("def generated(value):\n    return 2.0 * value\n", _DEFINED)
generated = ti.func(_DEFINED["generated"])


def without_source(position, velocity, radius, mass, time, parameters):
    return generated(velocity)


FORCES = {
    undefined: (2, 'Name "viscosity" is not defined; give numbers of the program in `parameters`'),
    member: (1, "AttributeError: the struct has no attribute 'viscosiy'; its members are viscosity"),
    without_source: (
        1,
        "OSError: could not get source code: define all functions in a file or a notebook cell",
    ),
    early: (2, "Return inside non-static if/for is not supported"),
    nothing: (0, "the function must return a vector of three components [N]"),
}
"""Functions with an error: number of the line in the function, and reason."""


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


@dataclass(frozen=True)
class Member(Faulty):
    name = "missing_member"

    @ti.func
    def force(self, constants, contact, history):
        return contact.overlapp, history


@dataclass(frozen=True)
class OneValue(Faulty):
    name = "one_value"

    @ti.func
    def force(self, constants, contact, history):
        return contact.overlap


@dataclass(frozen=True)
class OtherHistory(Faulty):
    name = "other_history"

    @property
    def history(self):
        return (HistoryField("largest", "largest overlap", "m"),)

    @ti.func
    def force(self, constants, contact, history):
        return contact.overlap, ti.Struct(smallest=contact.overlap)


MODELS = {
    Undefined: (helper, 2, 'Name "stiffness" is not defined; give numbers of the program in `parameters`'),
    Member: (
        Member.force,
        2,
        "AttributeError: the struct has no attribute 'overlapp'; its members are mass_eff, overlap, "
        "overlap_rate, radius_eff, time_step",
    ),
    OneValue: (OneValue.force, 0, "force must return (number, history), not (number)"),
    OtherHistory: (OtherHistory.force, 0, "force must return the history with its fields (largest)"),
}
"""Models with an error: function, number of the line in the function with its decorator, and reason."""


def position_of(function, line):
    """File and line of the source, as in messages."""
    return f"{Path(__file__)}:{getsourcelines(function)[1] + line}"


def scene(**more):
    """Two particles that overlap."""
    return flying([[0.0] * 3, [0.0, 0.0099, 0.0]], [0.0] * 3, **more)


@pytest.mark.parametrize("function", FORCES)
def test_force_that_cannot_be_compiled(taichi_f64, function):
    line, reason = FORCES[function]
    force = gf.ParticleForce(function, {"viscosity": 1.0})
    expected = (
        f"The force {function.__name__} at 0 s cannot be compiled: {position_of(function, line)}: {reason}."
    )
    with pytest.raises(gf.FunctionError) as error:
        gf.Simulation(scene(), forces=[force])
    assert str(error.value) == expected
    with gf.Simulation(scene()) as simulation:
        with pytest.raises(gf.FunctionError) as error:
            simulation.forces.append(force)
        assert str(error.value) == expected
        simulation.step(2)


@pytest.mark.parametrize("law", MODELS)
def test_contact_model_that_cannot_be_compiled(taichi_f64, tmp_path, law):
    function, line, reason = MODELS[law]
    model = ContactModel(law, "cannot be compiled")
    gf.register_contact_model(model)
    try:
        contact = {"normal": "hertz", "tangential": "none", "rolling": "none", "cohesion": law.name}
        with (
            pytest.raises(gf.FunctionError) as error,
            gf.Simulation(scene(contact=contact), out=tmp_path / "run") as simulation,
        ):
            simulation.step()
    finally:
        unregister_contact_model(model)
    where = position_of(function, line)
    sentence = f"The function force of the contact model {law.name} cannot be compiled: {where}: {reason}."
    assert str(error.value) == sentence
    with gf.Simulation(scene()) as simulation:
        simulation.step(2)


class Branching(Faulty):
    """Conditions of numbers that are known when the kernel is compiled, and one that is not."""

    name = "branching"
    doubled = True

    @ti.func
    def force(self, constants, contact, history):
        result = contact.overlap
        if self.doubled and ti.static(len(history.keys) == 0):
            result = 2.0 * result
        for k in ti.static(range(2)):
            if k == 1:
                result = 3.0 * result
        if result > 1.0:
            result = 1.0
        return result, history


@ti.func
def limited(value):
    result = value
    if value > 1.0:
        result = 1.0
    return result


class Calling(Faulty):
    name = "calling"

    @ti.func
    def force(self, constants, contact, history):
        return limited(contact.overlap), history


@pytest.mark.parametrize(
    ("law", "function", "line"),
    [(Branching, Branching.force, 8), (Calling, limited, 3)],
)
def test_a_branch_in_a_vectorized_function_is_refused_at_registration(law, function, line):
    """Without the refusal the process ends with a segmentation fault when the first scene is compiled."""
    with pytest.raises(gf.GranflowError) as error:
        gf.register_contact_model(ContactModel(law, "has a branch"))
    assert str(error.value) == (
        f"contact model {law.__name__}: {position_of(function, line)}: force has a branch that depends on "
        "the contact, in a loop that must be vectorized; use ti.select"
    )


class CallingGenerated(Faulty):
    name = "calling_generated"

    @ti.func
    def force(self, constants, contact, history):
        return generated(contact.overlap), history


def test_a_function_without_source_is_refused_at_once():
    with pytest.raises(gf.GranflowError, match="cannot compile a lambda: define the function with def"):
        gf.ParticleForce(lambda position, velocity, radius, mass, time, parameters: velocity)
    with pytest.raises(gf.GranflowError) as error:
        gf.register_contact_model(ContactModel(CallingGenerated, "calls a function of exec"))
    assert str(error.value) == (
        "contact model CallingGenerated: the source of generated is not available, which is compiled from "
        "it; define it in a file or a notebook cell"
    )


@pytest.mark.parametrize("slot", ["normal", "cohesion"])
def test_a_contact_model_that_is_not_registered_has_a_remedy(slot):
    contact = {"normal": "hertz", "tangential": "none", "rolling": "none", slot: {"law": "xyz"}}
    with pytest.raises(
        gf.SceneError, match="Register a model of your own before: granflow.register_contact_model."
    ):
        gf.Scene.from_dict(scene().to_dict() | {"contact": contact})
