"""Volume and mass of spheres, and that the formula occurs once."""

import re
from pathlib import Path

import numpy as np
import pytest

import granflow
from granflow.geometry.sphere import sphere_mass, sphere_volume

FORMULA = re.compile(r"pi\b[^#\n]*\*\* ?3\b[^#\n]*|\*\* ?3\b[^#\n]*[^\w.]pi\b")
"""A product of pi and a third power."""

OTHERS = {"contact/cohesion/jkr.py"}
"""Files with another formula of this form."""


def test_volume_and_mass():
    radius = np.array([0.5, 1.0, 2.0])
    assert sphere_volume(radius) == pytest.approx(np.pi / 6.0 * (2.0 * radius) ** 3, rel=1e-15)
    assert sphere_mass(0.5, 6.0) == pytest.approx(np.pi, rel=1e-15)
    assert sphere_mass(radius, np.array([6.0, 0.75, 0.0])) == pytest.approx([np.pi, np.pi, 0.0], rel=1e-15)


def test_the_formula_occurs_once():
    package = Path(granflow.__file__).parent
    code = {path: re.sub(r'""".*?"""', "", path.read_text(encoding="utf-8"), flags=re.DOTALL)
            for path in package.rglob("*.py")}  # fmt: skip
    found = {path.relative_to(package).as_posix() for path, text in code.items() if FORMULA.search(text)}
    assert found - OTHERS == {"geometry/sphere.py"}
