"""Contact models that are defined outside the package: everything that a scene offers works with them."""

import shutil
from dataclasses import dataclass
from typing import Annotated

import meshio
import numpy as np
import pytest
from pydantic import Field
from resume.runs import files_of, states_of

from granflow import GranflowError, load_scene, read_run, register_contact_model
from granflow.cli.main import main
from granflow.contact.law import (
    CohesionLaw,
    ContactModel,
    HistoryField,
    ModelRequest,
    NormalLaw,
    Options,
    PairProperties,
    RollingLaw,
)
from granflow.contact.normal.hertz import Hertz
from granflow.contact.normal.zhou import Zhou
from granflow.device_functions import ti
from granflow.io.checkpoint import read_checkpoint
from granflow.plan.build import plan_for
from granflow.scene.registration import unregister_contact_model
from granflow.schema.quantities import NotNegative, Number
from granflow.simulation import Simulation


@dataclass(frozen=True)
class Sticky(CohesionLaw):
    """An attraction that increases to a constant: F = f d / (d + s)."""

    saturation: float

    name = "sticky"
    source = "this test, 2026"
    limits = "a model without physical basis"
    constant_names = ("attraction",)

    @classmethod
    def from_scene(cls, request: ModelRequest) -> "Sticky":
        return cls(request.options.saturation)

    @property
    def parameters(self):
        return {"saturation": self.saturation}

    @property
    def history(self):
        return (HistoryField("largest", "largest overlap", "m", in_output=True),)

    @ti.func
    def force(self, constants, contact, history):
        history_new = history
        history_new.largest = ti.max(history.largest, contact.overlap)
        return constants.attraction * contact.overlap / (contact.overlap + constants.saturation), history_new

    @ti.func
    def stored_energy(self, constants, contact, history):
        return -constants.attraction * (
            contact.overlap - constants.saturation * ti.log(1.0 + contact.overlap / constants.saturation)
        )

    def reference(self, contact):
        attraction = contact.constants.attraction / (1.0 + self.saturation / contact.overlap)
        return attraction, {"largest": max(contact.overlap, getattr(contact.history, "largest", 0.0))}


@dataclass(frozen=True)
class Viscous(RollingLaw):
    """A torque proportional to the rolling rate."""

    name = "syrupy"
    source = "this test, 2026"
    limits = "a model without physical basis"
    constant_names = ("rolling_viscosity",)

    @property
    def history(self):
        return (
            HistoryField("torque", "torque of the previous step", "N m", size=3, in_output=True),
            HistoryField("duration", "duration of the contact", "s", in_output=True),
        )

    @ti.func
    def torque(self, constants, contact, history):
        rate = contact.rolling_rate
        history_new = history
        torque = -constants.rolling_viscosity * (rate - rate.dot(contact.normal) * contact.normal)
        lost = -0.5 * contact.time_step * (history.torque + torque).dot(rate)
        history_new.torque = torque
        history_new.duration = history.duration + contact.time_step
        return torque, history_new, lost


class StickyOptions(Options):
    saturation: Annotated[float, Number("length", noun="an overlap", above=0)] = Field(
        description="overlap [m] at half the attraction", examples=["1 um"]
    )


class StickyPair(PairProperties):
    attraction: Annotated[float, Number("force", at_least=0)] = Field(
        description="largest attraction [N]", examples=["1 mN"]
    )


class ViscousPair(PairProperties):
    rolling_viscosity: NotNegative = Field(description="torque over rolling rate [N m s]", examples=["1e-6"])


STICKY = ContactModel(Sticky, "attraction that increases to a constant", StickyOptions, StickyPair)
VISCOUS = ContactModel(Viscous, "syrupy rolling torque", pair_properties=ViscousPair)
SCENE = """\
title: External models
gravity: [0, 0, -9.81]
materials: {glass: {young_modulus: 100 MPa, poisson_ratio: 0.25, density: 2500, yield_strength: 3 MPa}}
pairs:
  glass-glass: {restitution: 0.8, friction: 0.3, attraction: 20 mN, rolling_viscosity: 1e-6}
contact:
  normal: zhou
  tangential: mindlin
  rolling: syrupy
  cohesion: {law: sticky, saturation: 10 um}
walls:
  floor: {shape: plane, point: [0, 0, 0], normal: [0, 0, 1], material: glass}
particles:
  balls:
    material: glass
    diameter: 10 mm
    count: 36
    velocity: [0.3, 0.1, -0.2]
    angular_velocity: [0, 20, 5]
    insert: {kind: lattice, region: {box: {min: [0, 0, 0.0], max: [0.035, 0.035, 0.045]}}}
domain: {min: [-0.1, -0.1, -0.1], max: [0.1, 0.1, 0.1], on_exit: error}
run: {duration: 10 ms, time_step: 2 us, velocity_max: 1}
numerics: {chunk_size: 16}
output:
  interval: 2 ms
  timeseries_interval: 1 ms
  contacts: true
  energy_budget: true
  checkpoint: {interval: 2 ms, keep: 10}
"""


@pytest.fixture(scope="module", autouse=True)
def registered():
    """The two models are registered during all tests: each registration builds the schema again."""
    for model in (STICKY, VISCOUS):
        register_contact_model(model)
    yield
    for model in (STICKY, VISCOUS):
        unregister_contact_model(model)


def scene_of(tmp_path, old="", new=""):
    """The scene from a file, with a part of its text replaced."""
    assert old in SCENE
    path = tmp_path / "scene.yaml"
    path.write_text(SCENE.replace(old, new) if old else SCENE)
    return load_scene(path)


def test_scene_runs_with_energy_budget_contact_output_and_identical_restart(tmp_path, taichi_f64):
    scene = scene_of(tmp_path)
    whole = tmp_path / "whole"
    again = tmp_path / "again"
    simulation = Simulation(scene, out=whole, threads=2)
    simulation.run()
    last = simulation.snapshot(contacts=True)
    simulation.free()
    shutil.copytree(whole, again)
    checkpoint = sorted(again.glob("checkpoint_*.npz"))[1]
    resumed = Simulation(scene, out=again, threads=2, resume=read_checkpoint(checkpoint))
    resumed.run()
    resumed.free()
    assert files_of(again) == files_of(whole) and states_of(again) == states_of(whole)

    assert last.totals["rolling_dissipation"] > 1e-3 * last.totals["kinetic_energy"]
    assert abs(last.totals["energy_error"]) < 1e-3
    frame = meshio.read(sorted(whole.glob("contacts_*.vtu"))[-1])
    arrays = {name: value[0] for name, value in frame.cell_data.items()}
    largest, overlap = arrays["cohesion_largest"], arrays["overlap"]
    assert len(overlap) > 5 and overlap.min() > 0.0 and np.all(largest >= overlap * (1.0 - 1e-6))
    torque, duration = arrays["rolling_torque"], arrays["rolling_duration"]
    assert torque.shape == (len(overlap), 3) and np.abs(torque).max() > 0.0
    assert 0.0 < duration.min() and duration.max() <= 0.01
    for model in (STICKY, VISCOUS):  # frames are read without the models, for pictures
        unregister_contact_model(model)
    run = read_run(whole)
    assert "contact.rolling is syrupy" in run.scene_problem and len(run.frames[-1].particles["radius"]) == 36
    for model in (STICKY, VISCOUS):
        register_contact_model(model)


def test_the_schema_contains_the_models(capsys):
    assert main(["schema", "contact.cohesion.sticky"]) == 0
    assert "saturation number [m]; required" in " ".join(capsys.readouterr().out.split())


def test_a_model_that_no_pair_needs_is_not_active(tmp_path):
    plan = plan_for(scene_of(tmp_path, "attraction: 20 mN", "attraction: 0"))
    assert plan.laws.cohesion is None and not plan.laws.attracts
    assert plan.laws.names["rolling"] == "syrupy"


def test_laws_share_kernels_unless_they_differ_in_more_than_parameters():
    """The device functions of a law from outside may contain its numbers as literals."""

    @dataclass(frozen=True)
    class Outside(Zhou):
        pass

    assert Outside("constant", 0.5).structure != Outside("constant", 0.4).structure
    assert Zhou("constant", 0.5).structure == Zhou("constant", 0.4).structure
    assert Zhou("constant", 0.5, 0.0).structure != Zhou("constant", 0.5, 0.1).structure
    assert Zhou("constant", 0.5).structure != Zhou("impact", 0.5).structure


class Incomplete(NormalLaw):
    name = "incomplete"
    source = "this test, 2026"
    limits = "a model without physical basis"


class WithoutExample(Options):
    size: float = Field(description="x")


class OtherFriction(PairProperties):
    friction: float = Field(description="x")


class WithDefault(PairProperties):
    stickiness: float = Field(0.0, description="x")


OTHER = type("Other", (Sticky,), {"name": "other"})
WITHOUT_MODULI = type("WithoutModuli", (Hertz,), {"name": "other", "constant_names": ("k",)})


@pytest.mark.parametrize(
    ("law", "keys", "message"),
    [
        (Incomplete, {}, "must define force, reference, stored_energy"),
        (WITHOUT_MODULI, {}, "begins with modulus_e"),
        (OTHER, {"options": {"size": 1.0}}, "is not a subclass of granflow.contact.law.Options"),
        (OTHER, {"options": WithoutExample}, "option size has neither a default nor an example"),
        (OTHER, {"pair_properties": OtherFriction}, "key friction of pairs exists with another meaning"),
        (OTHER, {"pair_properties": WithDefault}, "key stickiness of pairs has a default"),
        (Sticky, {"options": StickyOptions}, "a cohesion model of this name exists"),
    ],
)
def test_incomplete_models_are_refused_at_registration(law, keys, message):
    """Without the refusal, the first scene fails with a traceback from the time step or the kernels."""
    with pytest.raises(GranflowError, match=message):
        register_contact_model(ContactModel(law, "x", **keys))


def test_a_model_without_source_is_refused_at_registration():
    """As in the interactive interpreter: the kernel language compiles the text of the functions."""
    names: dict = {"ti": ti, "Sticky": Sticky}
    function = (
        "class Typed(Sticky):\n    @ti.func\n    def force(self, *values):\n        return 0.0, values[2]"
    )
    exec(function, names)
    with pytest.raises(GranflowError, match="the source of force is not available"):
        register_contact_model(ContactModel(names["Typed"], "x"))
