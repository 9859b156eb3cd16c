"""Numbers of contact models are no literals of kernels: models that differ in numbers share compiled
kernels."""

import os
from dataclasses import dataclass
from typing import Annotated, Literal, get_args, get_origin

import numpy as np
import pytest
from contact.cases import kernel_for
from contact.surface_paths import surface_kernel
from contact.test_registry import RECORDS
from subprocess_runner import in_subprocess

from granflow.contact.law import ModelRequest, NormalLaw, RollingLaw, TangentialLaw, TwistingLaw
from granflow.contact.material import PairMaterial, VelocityRestitution
from granflow.contact.normal.hertz import Hertz
from granflow.contact.normal.zhou import Zhou
from granflow.contact.registry import ContactLaws
from granflow.engine import backend
from granflow.engine.kernel_cache import CACHED_KERNELS as KERNELS


def choices(annotation, number):
    """Values of an option by its type: the number, each word, or a mapping with each key."""
    if get_origin(annotation) is Literal:
        return list(get_args(annotation))
    if get_origin(annotation) is Annotated:
        return choices(get_args(annotation)[0], number)
    if members := get_args(annotation):
        return [value for member in members for value in choices(member, number)]
    if annotation in (bool, type(None)):
        return [False, True] if annotation is bool else [None]
    if annotation is float:
        return [number]
    return [{key: number for key, each in annotation.model_fields.items() if each.annotation is not bool}]


def variants(model, number):
    """Laws of a record for each word and key of its choices, with every number `number` above its limit or 0."""
    values = {
        key: choices(
            each.annotation, number + sum(getattr(m, "at_least", None) or 0.0 for m in each.metadata)
        )
        for key, each in model.options.model_fields.items()
    }
    first = {key: each[0] for key, each in values.items()}
    settings = [first, *({**first, key: value} for key, each in values.items() for value in each[1:])]
    fit = model.restitution == "number or fit"
    restitution = VelocityRestitution(number, 0.9 * number, 1.0 + number) if fit else number
    options = dict.fromkeys(model.pair_properties.model_fields, number)
    pair = PairMaterial(4e7 * number, 1e7, restitution, yield_strength=1e6 * number, properties=options)
    return [
        model.law.from_scene(ModelRequest(model.options(**given), (pair,), number, 0.9 * number, True))
        for given in settings
    ]


def compile_models(number, folder):
    """Compile one kernel for each variant of each registered model."""
    os.environ["GRANFLOW_CACHE"] = folder
    backend.start("cpu", "f64", 1)
    for law in (law for model in RECORDS for law in variants(model, number)):
        evaluate(law)


def evaluate(law):
    """Compile and launch a kernel that contains the device functions of a law, on no contacts."""
    flat = np.zeros((0, 0))
    cube = np.zeros((0, 0, 0))
    row = np.zeros(9)
    if isinstance(law, TangentialLaw | RollingLaw | TwistingLaw):
        surface_kernel(law)(row, row, cube, np.zeros((0, 0, 0, 0)), cube, flat, flat, cube)
    else:
        laws = ContactLaws((law,) if isinstance(law, NormalLaw) else (Hertz(False), law))
        kernel_for(laws)(row, row, 0.1, 0.1, 1e-5, *(flat for _ in range(7)), cube)


def test_laws_that_differ_in_numbers_have_one_structure():
    for model in RECORDS:
        low, high = ([law.structure for law in variants(model, number)] for number in (0.3, 0.4))
        assert low == high
    assert Zhou("constant", 0.5, 0.0).structure != Zhou("constant", 0.5, 0.1).structure
    assert Zhou("constant", 0.5).structure != Zhou("impact", 0.5).structure


def test_the_numbers_of_a_law_from_outside_are_part_of_its_structure():
    @dataclass(frozen=True)
    class Outside(Zhou):
        """A law of a program, whose device functions may contain its numbers as literals."""

    assert Outside("constant", 0.5).structure != Outside("constant", 0.4).structure


@pytest.mark.slow
def test_models_with_other_numbers_add_no_compiled_kernel(tmp_path):
    in_subprocess(compile_models, 0.3, str(tmp_path))
    compiled = {path.name for path in tmp_path.glob(KERNELS)}
    assert len(compiled) >= len(RECORDS)
    in_subprocess(compile_models, 0.4, str(tmp_path))
    assert {path.name for path in tmp_path.glob(KERNELS)} == compiled
