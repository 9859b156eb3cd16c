"""Coarse-grained fields integrate to the totals and agree with theory for simple beds and flows."""

import meshio
import numpy as np
import pytest
from observers.snapshots import particles_of, snapshot_of
from scipy.special import erf

from granflow.fields import FIELD_QUANTITIES
from granflow.geometry.coarse_grid import CoarseGrid, GaussianKernel
from granflow.observers.coarse_graining import accumulate, fields_from
from granflow.observers.frames import FieldFrames


def cloud(count=300, seed=0):
    """Particles of many sizes in the unit cube, the first third fixed, and one contact per particle."""
    random = np.random.default_rng(seed)
    position = random.uniform(0.0, 1.0, (count, 3))
    particles = particles_of(
        count, position=position, velocity=random.normal([3.0, 0.0, -1.0], 1.0, (count, 3)),
        radius=random.uniform(0.01, 0.05, count), coordination_number=random.integers(0, 9, count),
        fixed=(np.arange(count) < count // 3).astype(np.uint8),
    )  # fmt: skip
    contacts = {
        "position_i": position,
        "position_j": position + random.normal(0.0, 0.03, position.shape),
        "force": random.normal(0.0, 1.0, position.shape),
        "wall": np.full(count, -1),
        "overlap": np.full(count, 1e-3),
    }
    return particles, contacts


def cube(count, low=-0.5, high=1.5, **more):
    return CoarseGrid((low,) * 3, (high,) * 3, (count,) * 3, **more)


@pytest.mark.parametrize("count", [1, 7])
def test_the_grid_integrates_to_the_totals(count):
    """Mass, volume, momentum, heat and momentum flux (of the mean flow and of the fluctuations) of the particles
    that are not fixed, and the virial of all, to rounding."""
    particles, contacts = cloud()
    grid = cube(count)
    fields = fields_from(accumulate(particles, contacts, grid, GaussianKernel(0.05, 3.0)))
    mass, velocity, radius, temperature = (
        particles[name][100:] for name in ("mass", "velocity", "radius", "temperature")
    )
    branch = contacts["position_j"] - contacts["position_i"]
    mean_flow = (fields["momentum"][:, :, None] * fields["velocity"][:, None, :]).reshape(-1, 9)
    flux = np.nan_to_num(mean_flow) - fields["kinetic_stress"]
    expected = {
        "density": (fields["density"], mass.sum()),
        "solid_fraction": (fields["solid_fraction"], (4.0 / 3.0 * np.pi * radius**3).sum()),
        "momentum": (fields["momentum"], (mass[:, None] * velocity).sum(axis=0)),
        "heat": (np.nan_to_num(fields["temperature"] * fields["density"]), (mass * temperature).sum()),
        "momentum_flux": (flux, np.einsum("k,ki,kj->ij", mass, velocity, velocity).ravel()),
        "contact_stress": (fields["contact_stress"], (contacts["force"].T @ branch).ravel()),
    }
    for name, (field, total) in expected.items():
        np.testing.assert_allclose(
            grid.cell_volume * field.sum(axis=0), total, rtol=1e-12, atol=1e-12 * np.abs(total).max(),
            err_msg=name
        )  # fmt: skip
    assert np.nanmax(np.abs(fields["fabric"][:, [0, 4, 8]].sum(axis=1) - 1.0)) < 1e-9
    stress = fields["kinetic_stress"] + fields["contact_stress"]
    np.testing.assert_allclose(fields["pressure"], -stress[:, [0, 4, 8]].sum(axis=1) / 3.0, atol=1e-9)


def test_contact_stress_is_distributed_along_the_branch_vector():
    """The stress of one contact is f b times the mean of the Gaussian along the branch vector, an error
    function."""
    width = 0.1
    force = np.array([1.0, 2.0, 3.0])
    branch = np.array([0.0, 0.0, 0.35])
    contacts = {"position_i": np.zeros((1, 3)), "position_j": branch[None], "force": force[None]}
    contacts |= {"wall": np.array([-1]), "overlap": np.array([1e-3])}
    grid = CoarseGrid((-0.6, -0.6, -0.6), (0.6, 0.6, 1.0), (24, 24, 32))
    stress = accumulate(cloud(1)[0], contacts, grid, GaussianKernel(width, 6.0)).arrays["contact_stress"]

    def cumulative(s):
        return 0.5 + 0.5 * erf(s / (np.sqrt(2.0) * width))

    def integral(u):
        return u * cumulative(u) + width / np.sqrt(2.0 * np.pi) * np.exp(-0.5 * u**2 / width**2)

    x, z = np.linspace(-0.6, 0.6, 25), np.linspace(-0.6, 1.0, 33)
    along = np.diff((integral(z) - integral(z - branch[2])) / branch[2])
    across = np.diff(cumulative(x))
    share = np.einsum("k,j,i->kji", along, across, across).ravel() / grid.cell_volume
    expected = share[:, None] * np.outer(force, branch).ravel()
    np.testing.assert_allclose(stress, expected, rtol=0.0, atol=1e-3 * np.abs(expected).max())


def test_fields_wrap_around_a_periodic_axis():
    """The mass is conserved, and a shift of all particles by one cell shifts the field by one cell."""
    particles, contacts = cloud()
    grid = CoarseGrid((0.0, 0.0, -0.5), (1.0, 1.0, 1.5), (5, 4, 3), (True, True, False))
    np.testing.assert_array_equal(grid.cells_of(grid.centers())[0], np.arange(grid.cell_count))
    moved = particles | {"position": particles["position"] + [grid.cell_size[0], 0.0, 0.0]}
    first, second = (
        fields_from(accumulate(each, contacts, grid, GaussianKernel(0.15, 3.0)))["density"].reshape(3, 4, 5)
        for each in (particles, moved)
    )
    assert grid.cell_volume * first.sum() == pytest.approx(particles["mass"][100:].sum(), rel=1e-12)
    np.testing.assert_allclose(second, np.roll(first, 1, axis=2), rtol=1e-9)


def test_frames_and_their_mean_contain_the_fields(tmp_path):
    """Selected stages only; the mean is taken over the sums, so that momentum over density is the
    velocity."""
    (particles, contacts), (later_particles, _) = cloud(), cloud(seed=1)
    grid = cube(4)
    frames = FieldFrames(tmp_path, "bed", 0.1, grid, GaussianKernel(0.1, 3.0), stages=["run"])
    assert frames.wants == {"particles", "contacts"}
    frames.observe(snapshot_of(0.0, stage="fill", particles=particles, contacts=contacts))
    frames.observe(snapshot_of(0.1, particles=particles, contacts=contacts))
    frames.observe(snapshot_of(0.2, particles=later_particles, contacts=contacts))
    frames.finish()
    assert len(list(tmp_path.iterdir())) == 4, "with a list of frames"
    one, other, mean = (meshio.read(tmp_path / f"fields_bed_{name}.vtu") for name in ("0000", "0001", "mean"))
    assert set(one.cell_data) == set(FIELD_QUANTITIES)
    corners = one.points[one.cells_dict["hexahedron"]]
    np.testing.assert_allclose(corners.mean(axis=1), grid.centers(), atol=1e-12)
    np.testing.assert_allclose(np.ptp(corners, axis=1), np.tile(grid.cell_size, (grid.cell_count, 1)))
    first, second = (data.cell_data["momentum"][0] for data in (one, other))
    np.testing.assert_allclose(mean.cell_data["momentum"][0], 0.5 * (first + second), rtol=1e-5)
    density, velocity = (mean.cell_data[name][0] for name in ("density", "velocity"))
    np.testing.assert_allclose(density[:, None] * velocity, mean.cell_data["momentum"][0], rtol=1e-4)


def test_mean_temperature_of_frames_excludes_the_bounce_of_the_bed():
    """A gas with the temperature 0.09 m2/s2 that moves up at 1 m/s and down at 2 m/s, with half of the mass
    each.

    The mean velocity is -0.5 m/s; the mean of both sums adds the square mean of 1.5 m/s to one component. A
    third frame has twice the mass and half the temperature: the mean is weighted by mass.
    """
    random = np.random.default_rng(4)
    particles, _ = cloud(4000)

    def sums(speed, temperature, mass):
        velocity = random.normal(0.0, np.sqrt(temperature), (4000, 3)) + [0.0, 0.0, speed]
        gas = particles | {"velocity": velocity, "mass": mass * np.ones(4000), "fixed": np.zeros(4000)}
        return accumulate(gas, None, cube(1), GaussianKernel(0.2, 3.0))

    up, down, heavy = sums(1.0, 0.09, 1.0), sums(-2.0, 0.09, 1.0), sums(0.0, 0.045, 2.0)
    fields, weighted = fields_from((up + down) / 2), fields_from((up + down + heavy) / 3)
    found = [fields["granular_temperature"], fields["granular_temperature_of_frames"],
             weighted["granular_temperature_of_frames"]]  # fmt: skip
    expected = [0.09 + 1.5**2 / 3.0, 0.09, (0.09 + 0.09 + 2.0 * 0.045) / 4.0]
    np.testing.assert_allclose(np.ravel(found), expected, rtol=5.0 * np.sqrt(2.0 / (3.0 * 4000)))


def test_intensive_fields_of_empty_cells_are_nan():
    particles, contacts = cloud(1)
    fields = fields_from(accumulate(particles, contacts, cube(3, 10.0, 11.0), GaussianKernel(0.1, 3.0)))
    temperatures = {"temperature", "granular_temperature", "granular_temperature_of_frames"}
    quotients = {"velocity", "coordination_number", "fabric"} | temperatures
    for name, values in fields.items():
        assert np.all(np.isnan(values) if name in quotients else values == 0.0), name
