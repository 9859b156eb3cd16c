"""Oblique impacts against closed forms for sliding contacts, an ordinary differential equation, and
measurements.

Chung & Ooi 2011, Granular Matter 13:643, tests 4, 5, 6 and 8; Kharaz, Gorham & Salman 2001, Powder Technol.
120:281.
"""

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq

from granflow.studies.paper import oblique
from granflow.studies.paper.oblique import oblique_figure


@pytest.fixture(scope="module")
def run(taichi_f64):
    """The results of all sweeps by name."""
    return oblique.oblique_run(angles=24, ratios=15)


def mean_overlap(setup, speed):
    """Impulse-weighted mean overlap, int F d dt / int F dt, of Zhou's model; by quadrature in units of dmax
    and v."""
    e, (k, mass) = setup.restitution, setup.reduced
    overlap_max = (1.25 * mass * speed**2 / k) ** 0.4
    y = brentq(lambda y: y - 0.8 * e**2 - 0.2 * e**3 * y**2.5, 0.0, 1.0 + 1e-9, xtol=1e-15)
    slope = (1.0 - e**3 * y**1.5) / y

    def energy(s):
        """Work returned by the unloading branch at s above the residual overlap, over M v^2 / 2."""
        return max(e**2 - 1.25 * slope * s**2 - e**3 * s**2.5, 0.0)

    # F dt = F dd / rate, with F = (5/4) u^1.5 and (5/4) (Lambda s + e^3 s^1.5) in units of M v^2 / dmax
    loading = quad(lambda u: 1.25 * u**2.5 / np.sqrt(1.0 - u**2.5), 0.0, 1.0)[0]
    unloading = quad(
        lambda s: (
            1.25 * (slope * s + e**3 * s**1.5) * (s + 1.0 - y) / np.sqrt(energy(s)) if energy(s) else 0.0
        ),
        0.0,
        y,
    )[0]
    return overlap_max * (loading + unloading) / (1.0 + e)


@pytest.mark.parametrize("name", ["glass_zhou", "test4_zhou", "test5_zhou", "test6_zhou", "test8_zhou"])
def test_sliding_contacts_follow_coulombs_law(run, name):
    """v_n' = e v_n, v_t' = v_t - mu (1 + e) v_n, R w' = R w + 2.5 mu (1 + e) v_n (1 - overlap/(2 R)), within
    0.1 %."""
    sweep = run[name]
    setup = sweep.setup
    before = sweep.before
    after = sweep.after
    speed = -before.normal
    slip = before.along - setup.radius * before.spin
    impulse = setup.friction * (1.0 + setup.restitution) * speed
    sliding = slip > 1.05 * 3.5 * impulse
    assert sliding.sum() >= 3
    arm = 1.0 - 0.5 * np.array([mean_overlap(setup, each) for each in speed]) / setup.radius
    spin_change = setup.radius * (after.spin - before.spin)
    np.testing.assert_allclose(after.normal[sliding], (setup.restitution * speed)[sliding], rtol=1e-3)
    np.testing.assert_allclose((before.along - after.along)[sliding], impulse[sliding], rtol=1e-3)
    np.testing.assert_allclose(spin_change[sliding], (2.5 * impulse * arm)[sliding], rtol=1e-3)
    # textbooks use the radius as the lever arm
    np.testing.assert_allclose(spin_change[sliding], 2.5 * impulse[sliding], rtol=1e-2)


def no_slip_spring(setup, ratio, damping=0.0, steps=20000):
    """Slip velocity after the impact over mu v_n, for the ratio `ratio` before it; one contact in small time
    steps.

    Normal force: Hertz with Tsuji's damping. Tangential force: Mindlin's spring dF_t = k_t ds with
    k_t / (k sqrt(d)) = 6 G*/E*, reduced in proportion to the contact radius during unloading and limited to
    mu F. The slip velocity changes by 3.5 F_t / M. Units: M, k and the normal impact velocity are 1.
    """
    nu = setup.sphere["poisson_ratio"]
    friction = setup.friction
    stiffness = 6.0 * (1.0 - nu**2) / (2.0 * (1.0 + nu) * (2.0 - nu))
    step = 2.9433 * 1.25**0.4 / steps
    overlap = 0.0
    rate = 1.0
    slip = ratio * friction
    tangential = 0.0
    before = 0.0
    while True:
        overlap += rate * step
        if overlap <= 0.0:
            return slip / friction
        force = overlap**1.5 + damping * overlap**0.25 * rate
        if force <= 0.0:
            return slip / friction
        rate -= force * step
        tangential *= min(np.sqrt(overlap / before), 1.0) if before else 1.0
        tangential += stiffness * np.sqrt(overlap) * slip * step
        tangential = float(np.clip(tangential, -friction * force, friction * force))
        slip -= 3.5 * tangential * step
        before = overlap


def test_contacts_with_stick_and_slip_follow_mindlins_spring(run):
    """Test 5 where the contact also sticks; the lever arm differs from the radius by 0.25 %."""
    sweep = run["test5_zhou"]
    part = slice(0, 5)
    found = oblique.plotted_quantities(sweep, "test5")["slip"][part]
    np.testing.assert_allclose(found, [no_slip_spring(oblique.TEST_5, x) for x in sweep.x[part]], atol=0.04)


def test_sticking_contacts_with_damping_follow_mindlins_spring(run):
    """Test 6 with the hertz model: damping sqrt(5) zeta after Antypov & Elliott 2011 for e = 0.5."""
    sweep = run["test6_hertz"]
    e = oblique.TEST_6.restitution

    def rebound(zeta):
        """Schwager & Poeschel 2007: the contact ends when the force of spring and dashpot is zero."""
        root = np.sqrt(1.0 - zeta**2)
        return np.exp(-zeta / root * (np.pi - np.arctan2(2.0 * zeta * root, 1.0 - 2.0 * zeta**2)))

    damping = np.sqrt(5.0) * brentq(lambda zeta: rebound(zeta) - e, 1e-6, 0.999)
    ratio = 3.5 * (1.0 + e) / sweep.x
    expected = [-no_slip_spring(oblique.TEST_6, each, damping) / each for each in ratio]
    np.testing.assert_allclose(oblique.plotted_quantities(sweep, "test6")["slip"], expected, atol=0.02)


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


def test_no_impact_increases_the_energy(run):
    for name, sweep in run.items():
        before, after = (
            each.normal**2 + each.along**2 + 0.4 * (sweep.setup.radius * each.spin) ** 2
            for each in (sweep.before, sweep.after)
        )
        assert np.all(after < before * (1.0 + 1e-9)), name


def test_large_heavy_sphere_acts_as_a_rigid_plate(run):
    """Test 8 reproduces the curve of test 6."""
    plate, sphere = (
        oblique.plotted_quantities(run[name], "test6")["slip"] for name in ("test6_zhou", "test8_zhou")
    )
    np.testing.assert_allclose(plate, sphere, atol=3e-3)


def test_deviations_of_the_figure_are_within_their_targets(run, tmp_path):
    figure_data = oblique_figure(run)
    assert len(figure_data.deviations) == 10
    assert all(each.is_within_target and each.target == 1e-3 for each in figure_data.deviations)
    pytest.importorskip("matplotlib")
    from granflow.studies.figures import draw_to

    draw_to(
        tmp_path / "figure.png",
        lambda figure: figure_data.draw(figure, figure_data.columns),
        figure_data.height,
    )
    assert (tmp_path / "figure.png").stat().st_size > 10000
