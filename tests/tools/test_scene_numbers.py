"""tools/beverloo.py, tools/scene_numbers.py and tools/scene_table.py: flows and beds with known results, and tables."""

import importlib
from pathlib import Path

import numpy as np
import pytest

TOOLS = Path(__file__).resolve().parents[2] / "tools"


@pytest.fixture(autouse=True)
def tools_on_path(monkeypatch):
    monkeypatch.syspath_prepend(str(TOOLS))


def module(name):
    return importlib.import_module(name)


def flow(hole, rate, error=1e-3):
    return module("beverloo").Flow(hole, rate, error * rate, (rate, rate))


@pytest.mark.parametrize("power", [1.5, 2.5, 3.0])
def test_fit_recovers_the_exponent(power):
    flows = [flow(hole, 3e-4 * (hole - 1.4 * 4) ** power) for hole in (18, 22, 27, 32)]
    found, error = module("beverloo").exponent(flows)
    assert found == pytest.approx(power, abs=1e-9)
    # Errors of 0.1 % each over a spread of ln(D - k d) of 0.30 (standard deviation): 0.001 / (0.30 sqrt(4)) = 0.0017.
    x = np.log([flow.hole - 5.6 for flow in flows])
    assert error == pytest.approx(1e-3 / (x.std() * 2), rel=1e-6)


def test_error_of_the_exponent_grows_with_scatter():
    rates = [(hole - 5.6) ** 2.5 * (1 + 0.05 * (-1) ** i) for i, hole in enumerate((18, 22, 27, 32))]
    flows = [flow(hole, rate) for hole, rate in zip((18, 22, 27, 32), rates, strict=True)]
    assert module("beverloo").exponent(flows)[1] > 0.03


def test_flow_is_the_mean_slope_in_total_and_in_each_half():
    times = np.linspace(0.5, 1.5, 101)
    steady = module("beverloo").flow_of(20, times, 0.08 * times)
    assert steady.rate == pytest.approx(0.08) and steady.halves == pytest.approx((0.08, 0.08))
    assert steady.error < 1e-12
    # m = t^2 / 2 has the flow t: means of 0.75 and 1.25 in the halves of the time, 1 in total.
    growing = module("beverloo").flow_of(20, times, times**2 / 2)
    assert growing.rate == pytest.approx(1.0) and growing.halves == pytest.approx((0.75, 1.25))


def test_overrides_set_all_orifice_diameters():
    from granflow import load_scene

    scene = load_scene(module("beverloo").SCENE, module("beverloo").overrides(28))
    assert scene.walls["floor"].hole_radius == scene.walls["plug"].radius == scene.output.flow_meters["outlet"].radius
    assert scene.walls["floor"].hole_radius == pytest.approx(0.014)


def test_edge_of_a_single_layer_disc():
    # A hexagonal layer of particles of 2 mm covers pi / (2 sqrt 3) = 0.907 of the area up to 30 mm.
    row, column = np.meshgrid(np.arange(-20, 21), np.arange(-20, 21), indexing="ij")
    position = np.stack([2e-3 * (column + row / 2), np.sqrt(3) * 1e-3 * row, 0 * row], axis=-1).reshape(-1, 3)
    position = position[np.hypot(position[:, 0], position[:, 1]) < 0.029]
    edge = module("scene_numbers").edge_of(position, np.full(len(position), 1e-3))
    assert edge == pytest.approx(0.030, abs=1.5e-3)


def test_distant_particles_do_not_change_the_edge():
    random = np.random.default_rng(1)
    bed = np.column_stack([random.uniform(-0.02, 0.02, (4000, 2)), np.zeros(4000)])
    distant = np.array([[0.07, 0.0, 0.0], [0.0, 0.08, 0.0]])
    numbers, radius = module("scene_numbers"), np.full(4002, 1e-3)
    assert numbers.edge_of(np.vstack([bed, distant]), radius) == numbers.edge_of(bed, radius[:-2]) < 0.03


def test_quadrants_are_counted_in_the_plane_of_rotation():
    position = np.array([[-1, 5, 1], [1, -5, 1], [1, 0, 2], [-1, 0, -1], [-2, 0, -1], [-3, 0, -1], [1, 0, -1.0]])
    assert module("scene_numbers").quadrants(position).tolist() == [1, 2, 3, 1]


# ---------------------------------------------------------------- tables of docs/pages/scenes.md


def test_tables_match_the_stored_numbers():
    """If this fails, run `python tools/scene_table.py` and commit docs/pages/scenes.md."""
    table = module("scene_table")
    page = table.PAGE.read_text(encoding="utf-8")
    assert page == table.written(page)


def test_each_expectation_of_a_shipped_scene_has_a_row():
    table = module("scene_table")
    rows = [line.split(" | ") for line in table.PAGE.read_text(encoding="utf-8").splitlines() if " | " in line]
    for name in table.names():
        for expectation in table.load(table.SCENES / f"{name}.yaml").expect:
            matching_rows = [
                each for each in rows if each[0] == f"| `{name}`" and each[1] == f"`{expectation.quantity}`"
            ]
            assert matching_rows, (name, expectation.quantity)
    stored = table.json.loads(table.RESULTS.read_text(encoding="utf-8"))
    assert set(stored) <= set(table.names())


def test_changed_number_changes_the_page(monkeypatch, tmp_path):
    table = module("scene_table")
    results = tmp_path / "results.json"
    results.write_text('{"mixer": {"date": "2030-01-01", "commit": "abc", "numbers": {"energy_error": 0.00123}}}')
    monkeypatch.setattr(table, "RESULTS", results)
    page = table.PAGE.read_text(encoding="utf-8")
    (row,) = [line for line in table.written(page).splitlines() if line.startswith("| `mixer` | `energy_error`")]
    assert row.endswith("| 0.00123 | 2030-01-01, abc |")


def test_page_without_markers_is_rejected():
    with pytest.raises(ValueError, match="lacks the markers of the table comparisons"):
        module("scene_table").written("# Scenes\n")
