"""The table of restitutions in the guide for users of other codes, against the collision that each code
integrates."""

import re
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

PAGE = Path(__file__).resolve().parents[2] / "docs" / "pages" / "guides" / "other_codes.md"
TSUJI = (1.2728, -4.2783, 11.087, -22.348, 27.467, -18.022, 4.8218)
"""Damping over the entered restitution in LAMMPS."""
ROWS = [
    [float(cell) for cell in row.split("|")]
    for row in re.findall(r"^\| ((?:0\.\d+ ?\|? ?){6})\|$", PAGE.read_text(), re.M)
]


def restitution(damping, cuts_tension):
    """x'' = -x^(3/2) - a x^(1/4) x', from x = 0 and x' = 1 to overlap 0, or to force 0 if the tension is
    cut."""

    def force(x, v):
        return max(x, 0.0) ** 1.5 + damping * max(x, 0.0) ** 0.25 * v

    def end(_, state):
        return force(*state) if cuts_tension else state[0]

    end.terminal = True
    end.direction = -1
    run = solve_ivp(
        lambda _, s: (s[1], -force(*s)), (0.0, 50.0), (1e-9, 1.0), events=end, rtol=1e-9, atol=1e-12
    )
    return -run.y_events[0][0][1]


def test_entered_numbers_give_the_same_restitution():
    assert [row[0] for row in ROWS] == [0.3, 0.5, 0.7, 0.8, 0.9, 0.95]
    for e, _, liggghts, limited, *lammps in ROWS:
        damping = np.sqrt(5.0) * -np.log(liggghts) / np.hypot(np.log(liggghts), np.pi)
        assert restitution(damping, False) == pytest.approx(e, abs=1e-5)
        assert restitution(damping, True) == pytest.approx(limited, abs=6e-4)
        for entered, cuts_tension in zip(lammps, (False, True), strict=True):
            tsuji = sum(c * entered**power for power, c in enumerate(TSUJI))
            assert restitution(tsuji, cuts_tension) == pytest.approx(e, abs=1e-4)
