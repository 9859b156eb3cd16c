"""Oblique impacts against closed forms for sliding contacts and measurements.

Chung & Ooi 2011, Granular Matter 13:643, tests 4, 5, 6 and 8; Kharaz, Gorham & Salman 2001, Powder Technol.
120:281.
"""

import numpy as np
import pytest

from granflow.contact import theory
from granflow.studies.paper import oblique
from granflow.studies.paper.oblique import oblique_figure


@pytest.fixture(scope="module")
def run(taichi_f64):
    """The results of all sweeps by name."""
    return oblique.oblique_run(angles=24, ratios=9)


@pytest.mark.parametrize("name", ["glass_zhou", "test4_zhou", "test5_zhou", "test6_zhou", "test8_zhou"])
def test_sliding_contacts_follow_coulombs_law(run, name):
    """v_n' = e v_n, v_t' = v_t - mu (1 + e) v_n, R w' = R w + 2.5 mu (1 + e) v_n (1 - overlap/(2 R)), within
    0.1 %.

    The mean of the overlap over the impulse of a Hertz contact is int F d dt / int F dt = dmax int_0^1 sqrt(1 -
    u^2.5) du = dmax eta1 / 1.8; that of Zhou's model differs by a few percent, and the overlap is below 1 % of R.
    """
    setup, before, after = run[name].setup, run[name].before, run[name].after
    speed = -before.normal
    impulse = setup.friction * (1.0 + setup.restitution) * speed
    sliding = before.along - setup.radius * before.spin > 1.05 * 3.5 * impulse
    assert sliding.sum() >= 3
    arm = 1.0 - 0.5 * theory.LOADING_DURATION / 1.8 * theory.overlap_max(*setup.reduced, speed) / setup.radius
    spin_change = setup.radius * (after.spin - before.spin)
    np.testing.assert_allclose(after.normal[sliding], (setup.restitution * speed)[sliding], rtol=1e-3)
    np.testing.assert_allclose((before.along - after.along)[sliding], impulse[sliding], rtol=1e-3)
    np.testing.assert_allclose(spin_change[sliding], (2.5 * impulse * arm)[sliding], rtol=1e-3)


@pytest.mark.parametrize("law", ["hertz", "zhou"])
@pytest.mark.parametrize(
    ("data", "quantity", "tolerance"),
    [
        ("kharaz_2001", "tangential_restitution", 0.025),
        ("kharaz_2001", "spin", 50.0),
        ("kharaz_2001", "rebound_angle", 2.0),
        ("chung_ooi_2011", "tangential_restitution", 0.025),
        ("chung_ooi_2011", "spin", 15.0),
        ("chung_ooi_2011", "rebound_angle", 1.5),
    ],
)
def test_rebounds_agree_with_measurements_and_published_curves(run, law, data, quantity, tolerance):
    """Kharaz' glass plate, and test 4 of Chung & Ooi within the reading error of the figures, above 10 degrees.

    At smaller angles Hertz-Mindlin contacts are known to return too much tangential velocity.
    """
    is_measured = data == "kharaz_2001"
    sweep = run[f"glass_{law}" if is_measured else f"test4_{law}"]
    angle, published = oblique.published(data)[quantity if is_measured else f"test4_{quantity}"].T
    found = np.interp(angle, sweep.x, oblique.plotted_quantities(sweep, "test4")[quantity])
    compared = angle > (10.0 if is_measured else 9.0)
    np.testing.assert_allclose(found[compared], published[compared], rtol=0.0, atol=tolerance)
    if is_measured and quantity == "tangential_restitution":
        assert np.all((found - published)[angle < 5.0] > 0.05)


def test_deviations_of_the_figure_are_within_their_targets(run, tmp_path):
    figure_data = oblique_figure(run)
    assert len(figure_data.deviations) == 10
    assert all(each.is_within_target and each.target == 1e-3 for each in figure_data.deviations)
    pytest.importorskip("matplotlib")
    from granflow.studies.figures import draw_to

    path = tmp_path / "figure.png"
    draw_to(path, lambda figure: figure_data.draw(figure, figure_data.columns), figure_data.height)
    assert path.stat().st_size > 10000
