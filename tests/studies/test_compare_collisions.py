"""Collisions over three decades of velocity with both linear springs: closed forms and assessment."""

import numpy as np
import pytest
from studies.test_compare import MASS_EFF, SPEED, duration, head_on, overlap_max, spring

from granflow.studies.compare.collisions import assess_collisions, subject_of, sweep_columns, sweeps_of
from granflow.studies.compare.runs import variants_of

REFERENCE = 0.1 * SPEED
FLOOR = 0.01 * SPEED
"""Eq. 19 per contact uses at least the spring of a hundredth of the largest impact velocity."""


@pytest.fixture(scope="module")
def columns(taichi_f64):
    """Collisions of the spring per contact."""
    scene = head_on()
    subject = subject_of(scene, REFERENCE)
    variants = [each for each in variants_of(scene, ["linear"], REFERENCE) if each.key == "linear_onset"]
    return sweep_columns(subject, sweeps_of(scene, subject, variants, steps=["fine"]))


def test_springs_collide_as_harmonic_oscillators(columns):
    """Half a period pi sqrt(M/alpha) and a maximum overlap v sqrt(M/alpha), at least 100 steps each."""
    velocity = columns["velocity"]
    alpha = spring(np.maximum(velocity, FLOOR))
    np.testing.assert_allclose(columns["duration"], np.pi * np.sqrt(MASS_EFF / alpha), rtol=1e-3)
    np.testing.assert_allclose(columns["overlap_max"], velocity * np.sqrt(MASS_EFF / alpha), rtol=1e-3)
    np.testing.assert_allclose(columns["restitution"], 1.0, atol=1e-3)
    np.testing.assert_allclose(columns["duration_exact"], duration(velocity), rtol=1e-9)
    np.testing.assert_allclose(columns["overlap_max_exact"], overlap_max(velocity), rtol=1e-9)


def test_the_assessment_follows_from_the_columns(columns):
    """The one spring deviates by 10^0.2 at ten times its velocity; Eq. 19 per contact does not."""
    velocity = columns["velocity"]
    root = np.sqrt(MASS_EFF / spring(REFERENCE))
    one_spring = columns | {
        "law": np.full(len(velocity), "linear_reference"), "duration": np.pi * root + 0.0 * velocity,
        "overlap_max": velocity * root,
    }  # fmt: skip
    both = {name: np.concatenate([columns[name], one_spring[name]]) for name in columns}
    wrong, corrected, unstable = assess_collisions(both)
    assert wrong.holds and f"+{100.0 * (10.0**0.2 - 1.0):.1f} %" in wrong.why
    assert corrected.holds and f"+{100.0 * (np.pi / 2.9432751838 - 1.0):.1f} %" in corrected.why
    assert unstable.holds is None


def test_collisions_are_drawn(columns, tmp_path):
    pytest.importorskip("matplotlib")
    from granflow.studies.compare.report import draw_collisions
    from granflow.studies.figures import draw_to

    subject = subject_of(head_on(), REFERENCE)
    draw_to(tmp_path / "a.png", lambda figure: draw_collisions(figure, subject, columns, []), 5.0)
    assert (tmp_path / "a.png").stat().st_size > 20_000


def synthetic_columns(restitution):
    """Columns of one spring at ten times its velocity: `restitution` by step, target 0.8."""
    rows = [{"law": "linear_reference", "step": step, "velocity_over_reference": 10.0, "restitution": reached}
            for step, reached in restitution.items()]  # fmt: skip
    found = {name: np.array([row[name] for row in rows]) for name in rows[0]}
    ones = {
        name: np.ones(len(rows))
        for name in ("duration", "duration_exact", "overlap_max", "overlap_max_exact")
    }
    return found | ones | {"restitution_exact": np.full(len(rows), 0.8)}


def test_stability_is_assessed_against_the_fine_step():
    """A wrong restitution with the fine step is not an instability; a gain with the coarse step is."""
    assert assess_collisions(synthetic_columns({"fine": 1.0, "coarse": 1.05}))[2].holds is False
    gained = assess_collisions(synthetic_columns({"fine": 0.8, "coarse": 1.0}))[2]
    assert gained.holds and "+25.0 %" in gained.why
