"""Coarse-grained fields integrate to the totals and agree with theory for simple beds and flows."""

import meshio
import numpy as np
import pytest
from observers.snapshots import particles_of, snapshot_of
from scipy.special import erf
from scipy.stats import truncnorm

from granflow.fields import FIELD_QUANTITIES
from granflow.geometry.coarse_grid import CoarseGrid, GaussianKernel
from granflow.observers.coarse_graining import accumulate, fields_from
from granflow.observers.frames import FieldFrames

GRAVITY = 9.81


def cloud(count=300, seed=0):
    """Particles of many sizes in the unit cube and one contact per particle, with random branch vectors and
    forces."""
    random = np.random.default_rng(seed)
    position = random.uniform(0.0, 1.0, (count, 3))
    particles = particles_of(
        count, position=position, velocity=random.normal([3.0, 0.0, -1.0], 1.0, (count, 3)),
        radius=random.uniform(0.01, 0.05, count), coordination_number=random.integers(0, 9, count),
        fixed=np.zeros(count, np.uint8),
    )  # fmt: skip
    contacts = {
        "position_i": position,
        "position_j": position + random.normal(0.0, 0.03, position.shape),
        "force": random.normal(0.0, 1.0, position.shape),
    }
    return particles, contacts


def cube(count, low=-0.5, high=1.5, **more):
    return CoarseGrid((low,) * 3, (high,) * 3, (count,) * 3, **more)


@pytest.mark.parametrize("count", [1, 7, 30])
def test_the_grid_integrates_to_the_totals(count):
    """Mass, volume, momentum, kinetic energy (of the mean flow and of the fluctuations) and virial, to
    rounding."""
    particles, contacts = cloud()
    grid = cube(count)
    fields = fields_from(accumulate(particles, contacts, grid, GaussianKernel(0.05, 3.0)))
    mass = particles["mass"]
    velocity = particles["velocity"]
    branch = contacts["position_j"] - contacts["position_i"]
    mean_flow = 0.5 * fields["density"] * (fields["velocity"] ** 2).sum(axis=1)
    fluctuation = 1.5 * fields["density"] * fields["granular_temperature"]
    expected = {
        "density": (fields["density"], mass.sum()),
        "solid_fraction": (fields["solid_fraction"], (4.0 / 3.0 * np.pi * particles["radius"] ** 3).sum()),
        "momentum": (fields["momentum"], (mass[:, None] * velocity).sum(axis=0)),
        "energy": (np.nan_to_num(mean_flow + fluctuation), 0.5 * (mass * (velocity**2).sum(axis=1)).sum()),
        "contact_stress": (fields["contact_stress"], (contacts["force"].T @ branch).ravel()),
    }
    for name, (field, total) in expected.items():
        np.testing.assert_allclose(
            grid.cell_volume * field.sum(axis=0), total, rtol=1e-12, atol=1e-12 * np.abs(total).max(),
            err_msg=name
        )  # fmt: skip
    assert np.nanmax(np.abs(fields["fabric"][:, [0, 4, 8]].sum(axis=1) - 1.0)) < 1e-9


def test_contact_stress_is_distributed_along_the_branch_vector():
    """The stress of one contact is f b times the mean of the Gaussian along the branch vector, an error
    function."""
    width = 0.1
    force = np.array([1.0, 2.0, 3.0])
    branch = np.array([0.0, 0.0, 0.35])
    contacts = {"position_i": np.zeros((1, 3)), "position_j": branch[None], "force": force[None]}
    grid = CoarseGrid((-0.6, -0.6, -0.6), (0.6, 0.6, 1.0), (24, 24, 32))
    stress = accumulate(cloud(1)[0], contacts, grid, GaussianKernel(width, 6.0)).arrays["contact_stress"]
    edges = [
        np.linspace(low, high, n + 1) for low, high, n in zip(grid.low, grid.high, grid.counts, strict=True)
    ]

    def cumulative(s):
        return 0.5 + 0.5 * erf(s / (np.sqrt(2.0) * width))

    def mean_cumulative(z):
        """Mean over s in [0, L] of cumulative(z - s), by the integral of the error function."""

        def integral(u):
            return u * cumulative(u) + width / np.sqrt(2.0 * np.pi) * np.exp(-0.5 * u**2 / width**2)

        return (integral(z) - integral(z - branch[2])) / branch[2]

    along = np.diff(mean_cumulative(edges[2]))
    x, y = (np.diff(cumulative(edges[axis])) for axis in (0, 1))
    share = np.einsum("k,j,i->kji", along, y, x).ravel() / grid.cell_volume
    expected = share[:, None] * np.outer(force, branch).ravel()
    np.testing.assert_allclose(stress, expected, rtol=0.0, atol=1e-3 * np.abs(expected).max())


def test_stress_of_a_column_at_rest_is_the_weight_above():
    """Twenty particles stacked in a shaft: -stress_zz is the weight above over the cross section."""
    count = 20
    radius = 0.01
    section = 0.1**2
    particles = particles_of(count)
    height = radius * (1.0 + 2.0 * np.arange(count))
    mass = np.linspace(1.0, 2.0, count)
    position = np.column_stack([np.zeros(count), np.zeros(count), height])
    particles |= {
        "position": position, "mass": mass, "velocity": 0.0 * position, "radius": np.full(count, radius)
    }  # fmt: skip
    particles["fixed"] = np.zeros(count)
    load = GRAVITY * np.cumsum(mass[::-1])[::-1]
    partner_height = np.append(0.0, height[:-1])
    contacts = {
        "position_i": position,
        "position_j": np.column_stack([np.zeros(count), np.zeros(count), partner_height]),
        "force": np.column_stack([np.zeros(count), np.zeros(count), load]),
    }
    grid = CoarseGrid((-0.05, -0.05, -0.1), (0.05, 0.05, 0.5), (1, 1, 600))
    kernel = GaussianKernel(radius, 3.0)
    fields = fields_from(accumulate(particles, contacts, grid, kernel))
    weight = GRAVITY * fields["density"] * grid.cell_size[2] * section
    above = np.cumsum(weight[::-1])[::-1] - 0.5 * weight
    z = grid.centers()[:, 2]
    inside = z > kernel.reach
    expected = above / section
    np.testing.assert_allclose(
        -fields["contact_stress"][inside, 8], expected[inside], rtol=0.0, atol=1e-3 * expected.max()
    )
    assert expected[inside].max() > 0.8 * GRAVITY * mass.sum() / section
    np.testing.assert_allclose(fields["pressure"], -fields["contact_stress"][:, 8] / 3.0, atol=1e-9)


def test_velocity_and_temperature_of_uniform_shear():
    """v = rate y: the field is equal; the spread of y over kernel and cell appears as a granular temperature.

        T = rate^2 (s^2 + h^2 / 12) / 3

    s^2 is the variance of the kernel, a normal distribution within 3 widths, and h the edge length of a cell.
    """
    rate = 5.0
    side = 24
    y = (np.arange(side) + 0.5) / side
    position = np.stack(np.meshgrid(y, y, y), axis=-1).reshape(-1, 3)
    velocity = np.zeros_like(position)
    velocity[:, 0] = rate * position[:, 1]
    ones = np.ones(len(position))
    particles = particles_of(len(position), position=position, velocity=velocity, mass=ones, fixed=0.0 * ones)
    grid = CoarseGrid((0.35,) * 3, (0.65,) * 3, (6, 6, 6))
    kernel = GaussianKernel(0.1, 3.0)
    fields = fields_from(accumulate(particles, None, grid, kernel))
    # A lattice of spacing a differs from a continuum by exp(-2 pi^2 w^2 / a^2) and by the step at the cutoff:
    # 0.2 %.
    np.testing.assert_allclose(fields["velocity"][:, 0], rate * grid.centers()[:, 1], rtol=2e-3)
    variance = 0.1**2 * truncnorm(-3.0, 3.0).var()
    expected = rate**2 * (variance + grid.cell_size[1] ** 2 / 12.0) / 3.0
    np.testing.assert_allclose(fields["granular_temperature"], expected, rtol=1e-2)
    assert "contact_stress" not in fields


def test_temperature_and_kinetic_stress_of_a_maxwellian_gas():
    """Velocities N(V, sigma) per component: T = sigma^2, kinetic stress = -rho sigma^2 on the diagonal."""
    random = np.random.default_rng(2)
    count = 40_000
    sigma = 0.7
    particles = particles_of(
        count, position=random.uniform(0.0, 1.0, (count, 3)), mass=np.full(count, 2.0), fixed=np.zeros(count),
        velocity=random.normal([100.0, 0.0, 0.0], sigma, (count, 3)),
    )  # fmt: skip
    fields = fields_from(
        accumulate(particles, None, CoarseGrid((0.3,) * 3, (0.7,) * 3, (2, 2, 2)), GaussianKernel(0.1, 3.0))
    )
    sample_count = count * 0.4**3  # lower bound of the number of particles that contribute to a cell: 2560
    np.testing.assert_allclose(
        fields["granular_temperature"], sigma**2, rtol=5.0 * np.sqrt(2.0 / (3.0 * sample_count))
    )
    stress = fields["kinetic_stress"] / fields["density"][:, None]
    np.testing.assert_allclose(stress[:, [0, 4, 8]], -(sigma**2), rtol=5.0 * np.sqrt(2.0 / sample_count))
    np.testing.assert_allclose(stress[:, [1, 2, 5]], 0.0, atol=5.0 * sigma**2 / np.sqrt(sample_count))


def test_fields_wrap_around_a_periodic_axis():
    """The mass is conserved, and a shift of all particles by one cell shifts the field by one cell."""
    particles, contacts = cloud()
    grid = CoarseGrid((0.0, 0.0, -0.5), (1.0, 1.0, 1.5), (5, 4, 3), (True, True, False))
    kernel = GaussianKernel(0.15, 3.0)
    first = fields_from(accumulate(particles, contacts, grid, kernel))["density"].reshape(3, 4, 5)
    assert grid.cell_volume * first.sum() == pytest.approx(particles["mass"].sum(), rel=1e-12)
    moved = particles["position"] + [grid.cell_size[0], 0.0, 0.0]
    second = fields_from(accumulate(particles | {"position": moved}, contacts, grid, kernel))[
        "density"
    ].reshape(3, 4, 5)
    np.testing.assert_allclose(second, np.roll(first, 1, axis=2), rtol=1e-9)


def test_fixed_particles_have_no_mass():
    """Fixed particles contribute contacts, but no mass."""
    particles, contacts = cloud()
    fixed = np.arange(300) < 100
    some = fields_from(
        accumulate(
            particles | {"fixed": fixed.astype(np.uint8)}, contacts, cube(5), GaussianKernel(0.05, 3.0)
        )
    )
    assert cube(5).cell_volume * some["density"].sum() == pytest.approx(
        particles["mass"][100:].sum(), rel=1e-12
    )


def test_frames_and_their_mean_contain_the_fields(tmp_path):
    """Selected stages only; the mean is taken over the sums, so that momentum over density is the
    velocity."""
    (particles, contacts), (later_particles, _) = cloud(), cloud(seed=1)
    grid = cube(4)
    kernel = GaussianKernel(0.1, 3.0)
    frames = FieldFrames(tmp_path, "bed", 0.1, grid, kernel, stages=["run"])
    assert frames.wants == {"particles", "contacts"}
    frames.observe(snapshot_of(0.0, stage="fill", particles=particles, contacts=contacts))
    frames.observe(snapshot_of(0.1, particles=particles, contacts=contacts))
    frames.observe(snapshot_of(0.2, particles=later_particles, contacts=contacts))
    frames.finish()
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "fields_bed.pvd", "fields_bed_0000.vtu", "fields_bed_0001.vtu", "fields_bed_mean.vtu",
    ]  # fmt: skip
    one, other, mean = (meshio.read(tmp_path / f"fields_bed_{name}.vtu") for name in ("0000", "0001", "mean"))
    assert set(one.cell_data) == set(FIELD_QUANTITIES)
    corners = one.points[one.cells_dict["hexahedron"]]
    np.testing.assert_allclose(corners.mean(axis=1), grid.centers(), atol=1e-12)
    np.testing.assert_allclose(np.ptp(corners, axis=1), np.tile(grid.cell_size, (grid.cell_count, 1)))
    first, second = (data.cell_data["momentum"][0] for data in (one, other))
    np.testing.assert_allclose(mean.cell_data["momentum"][0], 0.5 * (first + second), rtol=1e-5)
    density, velocity = (mean.cell_data[name][0] for name in ("density", "velocity"))
    np.testing.assert_allclose(density[:, None] * velocity, mean.cell_data["momentum"][0], rtol=1e-4)


def test_the_field_of_the_temperature_is_the_mean_by_mass():
    """One cell that contains all particles, in the periodic kernel of the usual width."""
    particles, _ = cloud(200)
    particles["temperature"] = np.linspace(280.0, 400.0, 200)
    fields = fields_from(accumulate(particles, None, cube(1), GaussianKernel(0.05, 3.0)))
    mean = np.average(particles["temperature"], weights=particles["mass"])
    assert fields["temperature"].tolist() == pytest.approx([mean], rel=1e-9)


def test_mean_temperature_of_frames_excludes_the_bounce_of_the_bed():
    """A gas with the temperature 0.09 m2/s2 that moves up at 1 m/s and down at 2 m/s, with half of the mass
    each.

    The mean velocity is -0.5 m/s; the mean of both sums adds the square mean of 1.5 m/s to one component. A
    third frame has twice the mass and half the temperature: the mean is weighted by mass.
    """
    random = np.random.default_rng(4)
    grid = cube(1)
    kernel = GaussianKernel(0.2, 3.0)
    particles, _ = cloud(4000)
    count = len(particles["mass"])

    def sums(speed, temperature, mass):
        velocity = random.normal(0.0, np.sqrt(temperature), (count, 3)) + [0.0, 0.0, speed]
        return accumulate(
            particles | {"velocity": velocity, "mass": mass * np.ones(count)}, None, grid, kernel
        )

    up = sums(1.0, 0.09, 1.0)
    down = sums(-2.0, 0.09, 1.0)
    heavy = sums(0.0, 0.045, 2.0)
    relative = 5.0 * np.sqrt(2.0 / (3.0 * count))
    fields = fields_from((up + down) / 2)
    assert fields["granular_temperature"][0] == pytest.approx(0.09 + 1.5**2 / 3.0, rel=relative)
    assert fields["granular_temperature_of_frames"][0] == pytest.approx(0.09, rel=relative)
    assert fields_from((up + down + heavy) / 3)["granular_temperature_of_frames"][0] == pytest.approx(
        (0.09 + 0.09 + 2.0 * 0.045) / 4.0, rel=relative
    )
    assert fields_from(up)["granular_temperature_of_frames"] == pytest.approx(
        fields_from(up)["granular_temperature"]
    )


def test_intensive_fields_of_empty_cells_are_nan():
    particles, contacts = cloud(1)
    fields = fields_from(accumulate(particles, contacts, cube(3, 10.0, 11.0), GaussianKernel(0.1, 3.0)))
    temperatures = {"temperature", "granular_temperature", "granular_temperature_of_frames"}
    quotients = {"velocity", "coordination_number", "fabric"} | temperatures
    for name, values in fields.items():
        assert np.all(np.isnan(values) if name in quotients else values == 0.0), name
