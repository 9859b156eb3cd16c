"""Metrics of synthetic beds with known values."""

from types import SimpleNamespace

import numpy as np
import pytest
from observers.snapshots import contacts_of, snapshot_of, spheres_of
from scene_builders import build_scene, particle_group, plane

from granflow.errors import SceneError
from granflow.geometry.coarse_grid import CoarseGrid
from granflow.observers.metrics import MetricMeter, metric_meters
from granflow.plan.build import plan_for
from granflow.scene.blocks import metrics as metric
from granflow.scene.blocks.primitives import Box
from granflow.snapshot import WallPose

CUBE = CoarseGrid((0.0,) * 3, (1.0,) * 3, (5, 5, 5))


def random_points(count, seed=0):
    return np.random.default_rng(seed).uniform(0.0, 1.0, (count, 3))


def test_lacey_index_of_segregated_and_of_random_beds():
    """The boundary between two kinds coincides with a face between cells. K cells of n random particles: S^2 / SR^2
    has the variance 2 / K, so the index scatters by sqrt(2 / K) / (n - 1). Cells with few particles are left out."""
    points = np.vstack([random_points(5000), [[0.5, 0.5, 1.5]]])
    left = np.append(points[:5000, 0] < 0.4, True)
    assert metric.lacey_index(points[:5000], left[:5000], CUBE, 10) == pytest.approx(0.0, abs=1e-12)
    tall = CoarseGrid((0.0,) * 3, (1.0, 1.0, 2.0), (5, 5, 10))
    assert metric.lacey_index(points, left, tall, 2) == metric.lacey_index(
        points[:5000], left[:5000], tall, 2
    )
    assert np.isnan(metric.lacey_index(points, left, tall, 1000))
    assert np.isnan(metric.lacey_index(points, np.ones(5001, bool), tall, 2)), "undefined for a single kind"
    big = np.vstack([0.5 * random_points(1000), np.full((8, 3), 0.75)])
    grid = CoarseGrid((0.0,) * 3, (1.0,) * 3, (2, 2, 2))
    assert [metric.dropped_share(big, np.arange(1008) < 1000, grid, least) for least in (8, 10)] == [0.0, 1.0]
    tenth = np.random.default_rng(1).random(5000) < 0.1
    found = metric.lacey_index(points[:5000], tenth, CUBE, 10)
    assert found == pytest.approx(1.0, abs=4.0 * np.sqrt(2.0 / 125.0) / 39.0)


def test_segregation_intensity_in_closed_form():
    """Two cells with the volumes 4 and 2: c = 1/2, c_k = 1/4 and 1; I = (4 (1/4)^2 + 2 (1/2)^2) / (6 / 4) =
    1/2.

    Six particles: one of volume 1 of the first kind and one of volume 3 of the other kind, then four of 1/2.
    """
    points = np.array([[0.2, 0.5, 0.5]] * 2 + [[0.8, 0.5, 0.5]] * 4)
    volume = np.array([1.0, 3.0, 0.5, 0.5, 0.5, 0.5])
    is_first = np.array([1, 0, 1, 1, 1, 1], bool)
    grid = CoarseGrid((0.0,) * 3, (1.0,) * 3, (2, 1, 1))
    assert metric.segregation_intensity(points, volume, is_first, grid) == pytest.approx(0.5)
    # v_a = (1 + 4/4) / 3 = 2/3 and v_b = 3: I_R = 2 (3/2 + 1/3) / 6.
    assert metric.random_intensity(points, volume, is_first, grid) == pytest.approx(
        2.0 * (1.5 + 1.0 / 3.0) / 6.0
    )
    # The first particle alone: c = 1/6, v_a = 1 and v_b = (3^2 + 4/4) / 5 = 2: I_R = 2 (2/6 + 5/6) / 6.
    assert metric.random_intensity(points, volume, np.arange(6) == 0, grid) == pytest.approx(7.0 / 18.0)
    assert np.isnan(metric.segregation_intensity(points, volume, np.ones(6, bool), grid))
    assert np.isnan(metric.random_intensity(points, volume, np.ones(6, bool), grid))


def bed(angle, shape, length=0.1, spacing=0.0026):
    """Particles of 2 mm to 3 mm at displaced lattice points, below a cone about (0.3, -0.2) or a wedge rising
    in x."""
    random = np.random.default_rng(0)
    sides = [np.arange(-length, length, spacing)] * 2 + [np.arange(0.0, length * np.tan(angle), spacing)]
    points = np.stack(np.meshgrid(*sides), axis=-1).reshape(-1, 3)
    points = points + random.uniform(0.0, spacing, points.shape)
    distance = np.linalg.norm(points[:, :2], axis=1) if shape == "cone" else -points[:, 0]
    points = points[points[:, 2] < (length - distance) * np.tan(angle)]
    return points + [0.3, -0.2, 0.5], random.uniform(0.001, 0.0015, len(points))


def test_slope_of_a_cone_of_known_angle():
    """Within half a degree and three standard errors of the fit."""
    points, radius = bed(np.radians(24.0), "cone")
    slope = metric.slope_of_cone(points, radius, 0.006, np.array([0.3, -0.2]))
    assert 0.0 < slope.error < np.radians(0.5)
    assert slope.angle == pytest.approx(np.radians(24.0), abs=np.radians(0.5) + 3.0 * slope.error)
    about_the_mean = metric.slope_of_cone(points, radius, 0.006)
    assert about_the_mean.angle == pytest.approx(slope.angle, abs=np.radians(0.5))
    assert np.isnan(metric.slope_of_plane(np.zeros((0, 3)), np.zeros(0), 0.01).angle), "without a heap"
    assert np.isnan(metric.slope_of_cone(np.zeros((1, 3)), np.ones(1), 0.01).angle)


def test_a_crest_in_the_region_is_a_curved_surface():
    """A flank of 30 degrees with tops that scatter by a tenth of a column, alone and with a level crest as
    long as the flank: the plane through both has about half of the gradient."""
    x, y = (each.ravel() for each in np.meshgrid(np.arange(20) + 0.5, np.arange(6) + 0.5))
    for seed in range(20):
        scatter = np.random.default_rng(seed).normal(0.0, 0.1, len(x))
        for begin in (0.0, 10.0):
            height = 20.0 - np.tan(np.radians(30.0)) * np.maximum(x - begin, 0.0) + scatter
            slope = metric.slope_of_plane(np.column_stack([x, y, height]), np.full(len(x), 0.5), 1.0)
            assert ("the surface is curved: the plane has 1" in slope.remark) is (begin > 0.0)


@pytest.mark.parametrize(
    ("added", "limit", "reason"),
    [(0, 0.0025, "reach as much by chance"), (3, 0.2, "standard error of 25% of it, above 25%")],
)
def test_slope_needs_a_significant_gradient_with_a_small_relative_error(added, limit, reason):
    """Limits of 1 - R^2 for heights x / 2 and scatter, at the corners of a square and up to three points
    between.

    Four points have the chance sqrt(1 - R^2) < 0.05. With seven, the error sqrt(S / 4 / 4) is 1/4 of 1/2 for
    the residual S = 1/4, that is 1 - R^2 = S / (1 + S) = 0.2; the chance of it is 0.2^2 = 0.04.
    """
    x = np.array([-1.0, 1.0, -1.0, 1.0, 0.0, 0.0, 0.0])[: 4 + added]
    y = np.array([-1.0, -1.0, 1.0, 1.0, -1.0, 1.0, 0.0])[: 4 + added]
    scatter = np.array([0.0, 0.0, 0.0, 0.0, 1.0, 1.0, -2.0]) if added else x * y  # without a gradient, mean 0
    scatter /= np.linalg.norm(scatter)
    for share, is_slope in ((0.98 * limit, True), (1.02 * limit, False)):
        height = 0.5 * x + scatter * np.sqrt(share / (1.0 - share))  # the square sum of x / 2 is 1
        slope = metric.slope_of_plane(np.column_stack([x, y, height]), np.full(len(x), 0.5), 0.5)
        assert not slope.reason if is_slope else reason in slope.reason
        assert slope.angle == pytest.approx(np.arctan(0.5)) if is_slope else np.isnan(slope.angle)
        if is_slope:  # of the gradient sqrt(S / (n - 3) / sum of x^2); d arctan(g) = dg / (1 + g^2)
            error = np.sqrt(share / (1.0 - share) / (len(x) - 3) / 4.0)
            assert slope.error == pytest.approx(error / 1.25, rel=1e-9)


def test_fabric_of_known_directions():
    """Parallel contacts: n n, anisotropy 1; walls are excluded. Isotropic in a plane (Thornton): F = diag(1/2, 1/2, 0),
    D:D = 1/6."""
    directions = np.array([[0.0, 0.0, 2.0], [0.0, 0.0, -0.1], [1.0, 0.0, 0.0]])
    for wall, diagonal, expected in (
        ([-1, -1, 0], [0.0, 0.0, 1.0], 1.0),
        ([0, -1, -1], [0.5, 0.0, 0.5], 0.5),
    ):
        contacts = {"position_i": 0.0 * directions, "position_j": directions, "wall": np.array(wall)}
        np.testing.assert_allclose(metric.fabric_tensor(contacts), np.diag(diagonal), atol=1e-15)
        assert metric.anisotropy(np.diag(diagonal)) == pytest.approx(expected)
    assert metric.anisotropy(np.eye(3) / 3.0) == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize(("region", "expected"), [({}, [0.5, 0.5, 0.0, 0.5]), (
    {"region": {"min": [0.9, -1.0, -1.0], "max": [1.0, 1.0, 1.0]}}, [1.0, 1.0, 0.0, 0.0]
)])  # fmt: skip
def test_fabric_of_contacts_across_a_face_and_without_separated_pairs(region, expected):
    """A contact along x with the middle at -0.05, which is 0.95 in the periodic box; one along z at 0.5; along y a
    pair at a distance at 0.95."""
    begin = np.array([[0.05, 0.0, 0.0], [0.5, 0.0, 0.0], [0.95, 0.0, 0.0]])
    branch = np.array([[-0.2, 0.0, 0.0], [0.0, 0.0, 0.2], [0.0, 0.2, 0.0]])
    contacts = {"position_i": begin, "position_j": begin + branch}
    domain = {"min": [0.0, -1.0, -1.0], "max": [1.0, 1.0, 1.0], "periodic": "x", "on_exit": "error"}
    contacts |= {"wall": np.full(3, -1), "overlap": np.array([1e-3, 1e-3, -1e-3])}
    meter = measured(snapshot_of(contacts=contacts), domain, kind="fabric", **region)
    assert list(meter.readings().values()) == pytest.approx(expected)


def lattice_contacts(spacing, count, forces):
    """Contacts between neighbors of a cubic lattice; repulsive forces (3,) [N] along x, y and z."""
    nodes = np.argwhere(np.ones((count,) * 3)).astype(float)
    start, branch, force = [], [], []
    for axis, step in enumerate(np.eye(3)):
        inner = nodes[nodes[:, axis] < count - 1]
        start.append(spacing * inner)
        branch.append(np.broadcast_to(spacing * step, inner.shape))
        force.append(np.broadcast_to(-forces[axis] * step, inner.shape))
    begin, along = np.concatenate(start), np.concatenate(branch)
    return {"position_i": begin, "position_j": begin + along, "force": np.concatenate(force)}


def test_stress_of_a_lattice_and_of_a_gas():
    """Each face of a cell of a lattice has one contact: s = -F / a^2 along each axis, in any box whose edges are
    multiples of the spacing a. Two particles with opposite velocities u: s = -2 m u u / V."""
    a = 0.01
    contacts = lattice_contacts(a, 5, [2.0, 2.0, 5.0])
    region = Box(min=[0.3 * a, 0.6 * a, 0.9 * a], max=[2.3 * a, 3.6 * a, 1.9 * a])
    none = np.zeros(0), np.zeros((0, 3))
    stress = metric.stress_tensor(contacts, *none, region)
    np.testing.assert_allclose(stress, -np.diag([2.0, 2.0, 5.0]) / a**2, rtol=1e-12, atol=1e-8)
    assert metric.deviatoric_stress(stress) == pytest.approx(3.0 / a**2)
    cube = Box(min=[0.0] * 3, max=[a] * 3)
    gas = metric.stress_tensor(
        {name: each[:0] for name, each in contacts.items()},
        np.full(2, 3.0),
        np.array([[1.0, 2.0, 0.0], [-1.0, -2.0, 0.0]]),
        cube,
    )
    np.testing.assert_allclose(gas, -6.0 * np.array([[1, 2, 0], [2, 4, 0], [0, 0, 0]]) / a**3, rtol=1e-12)


def test_shear_is_no_fluctuation_in_a_sheared_box():
    """Particles that follow the profile of the shear exactly have no kinetic stress."""
    shear = {"lees_edwards": {"flow": "x", "gradient": "z", "rate": 3.0}}
    domain = {"min": [0.0] * 3, "max": [1.0] * 3, "periodic": ["x", "y", "z"], "on_exit": "error"} | shear
    position = random_points(50)
    velocity = np.array([1.0, 2.0, 3.0]) + np.outer(3.0 * position[:, 2], [1.0, 0.0, 0.0])
    snapshot = snapshot_of(particles=spheres_of(position, velocity=velocity), contacts=contacts_of(0))
    meter = measured(snapshot, domain=domain, gravity=[0.0] * 3, kind="stress")
    assert meter.readings()["pressure"] == pytest.approx(0.0, abs=1e-10) and not meter.remark
    open_above = {"min": [0.0] * 3, "max": [1.0, 1.0, 16.0], "periodic": ["x", "y"], "on_exit": "error"}
    height = np.ptp(position[:, 2]) + 2.0 * snapshot.particles["radius"].max()
    meter = measured(snapshot, domain=open_above, kind="stress")
    assert f"the particles take {height / 16.0:.0%}: give a region" in meter.remark


def test_granular_temperature_is_that_of_the_fluctuations_without_their_mean():
    """Two cells with the mean velocities 0 and 10 m/s: fluctuations of 1 and 2 m/s along x, 3 m/s along y.

    About the common mean, 2 kg move with -1, 1 and 4 kg with 8, 12 (mean 20/3): m (v - V)^2 over 6 kg (1 - 1/4).
    """
    velocity = np.array([[-1.0, 0, 0], [1, 0, 0], [8, 3, 0], [12, -3, 0]])
    mass = np.array([1.0, 1.0, 2.0, 2.0])
    found = metric.granular_temperature(velocity, mass, np.array([5, 5, 7, 7]))
    np.testing.assert_allclose(found, [(2 * 1 + 4 * 4) / 3, 4 * 9 / 3, 0.0], rtol=1e-14)
    mean = 40.0 / 6.0
    common = ((1 + mean) ** 2 + (1 - mean) ** 2 + 2 * (8 - mean) ** 2 + 2 * (12 - mean) ** 2) / 4.5
    np.testing.assert_allclose(
        metric.granular_temperature(velocity, mass, np.zeros(4, int))[0], common, rtol=1e-14
    )
    assert np.isnan(metric.granular_temperature(velocity, mass, np.arange(4))).all()


@pytest.mark.parametrize(
    ("limits", "level"),
    [({}, 1.0), ({"smaller_than": 3e-3}, 0.5), ({"at_least": 2e-3}, 1.5), ({"at_least": 2e-3, "smaller_than": 2.5e-3}, 1.0)],
)  # fmt: skip
def test_center_of_mass_of_sizes(limits, level):
    """Diameters 1, 2, 3 mm at heights 0, 1, 2 m with equal masses: below 3 mm 0.5 m, from 2 mm 1.5 m."""
    height = np.outer(np.arange(3.0), [0.0, 0.0, 1.0])
    particles = spheres_of(height, radius=np.array([0.5e-3, 1e-3, 1.5e-3]))
    found = metric.CenterOfMassMetric(**limits).measure(snapshot_of(particles=particles), None)
    assert found.numbers["center_of_mass_z"] == pytest.approx(level)


def test_sliding_share_of_particles_and_of_walls():
    contacts = {"wall": np.array([-1, -1, -1, 0, 0, 1]), "sliding": np.array([1, 0, 0, 1, 0, 1], np.uint8)}
    assert metric.sliding_share(contacts, None) == {"sliding_share": pytest.approx(1 / 3)}
    assert metric.sliding_share(contacts, [0]) == {"sliding_share": 0.5}
    assert metric.sliding_share(contacts, [0, 1]) == {"sliding_share": pytest.approx(2 / 3)}
    assert np.isnan(metric.sliding_share(contacts, [2])["sliding_share"])


GROUPS = {
    "red": particle_group([[0.5, 0.5, 0.1]], 0.01),
    "blue": particle_group([[0.5, 0.5, 0.7]], 0.02, "steel"),
}


def scene_with(metrics, **parts):
    parts = {"gravity": [0.0, -9.81, 0.0]} | parts
    return build_scene(GROUPS, output={"interval": 1.0, "metrics": metrics}, **parts)


def measured(snapshot, domain=None, gravity=(0.0, -9.81, 0.0), walls=None, **keys):
    """The meter of a metric with the keys, after a snapshot."""
    parts = {"gravity": list(gravity), "walls": walls} | ({"domain": domain} if domain else {})
    meter = metric_meters(plan_for(scene_with({"own": keys}, **parts)))["own"]
    meter.update(snapshot)
    return meter


def test_scene_metrics_are_reported_by_name():
    """Each metric returns its documented numbers; here, group, material and size select the same
    particles."""
    region = {"min": [0.0] * 3, "max": [1.0] * 3}
    selections = {"groups": ["red"], "materials": ["glass"], "smaller_than": 0.015}
    metrics = {
        name: {"kind": "lacey", "cell": 0.2, "region": region, name: of} for name, of in selections.items()
    }
    metrics |= {
        "stress": {"kind": "stress"}, "heap": {"kind": "repose", "surface": "plane"}, "contacts": {"kind": "fabric"},
        "particles": {"kind": "coordination"}, "sliding": {"kind": "sliding"}, "tracer": {"kind": "probe", "id": 1},
        "half": {"kind": "content", "region": {"min": [0.0] * 3, "max": [0.5, 1.0, 1.0]}},
        "center": {"kind": "center_of_mass"}, "red": {"kind": "center_of_mass", "groups": ["red"]},
        "segregation": {"kind": "segregation", "cell": 0.2, "region": region, "groups": ["red"]},
        "heat": {"kind": "granular_temperature", "groups": ["red"], "cell": 0.5, "region": region},
    }  # fmt: skip
    scene = scene_with(metrics)
    kind = np.arange(5000) % 2
    radius = np.where(kind, 0.01, 0.005)
    mass = 2500.0 * 4.0 / 3.0 * np.pi * radius**3
    particles = spheres_of(random_points(5000), group=kind, material=kind, radius=radius, mass=mass)
    snapshot = snapshot_of(particles=particles, contacts=contacts_of(10))
    meters = metric_meters(plan_for(scene))
    of_contacts = {"contacts": {"contacts"}, "sliding": {"contacts"}, "stress": {"particles", "contacts"}}
    for name, meter in meters.items():
        meter.update(snapshot)
        assert list(meter.readings()) == [each.name for each in scene.output.metrics[name].quantities]
        assert set(meter.result()) <= set(metric.METRIC_QUANTITIES)
        assert meter.wants == of_contacts.get(name, {"particles"})
    values = [meters[name].readings()["lacey_index"] for name in selections]
    assert values[0] == values[1] == values[2] == pytest.approx(1.0, abs=0.02)
    assert meters["particles"].readings()["coordination_number"] == 3.0
    red = metric.center_of_mass(particles["position"][kind == 0], particles["mass"][kind == 0])
    assert meters["red"].readings() == red != meters["center"].readings()
    octant = (particles["position"][kind == 0] // 0.5) @ [1, 2, 4]
    heat = metric.granular_temperature(particles["velocity"][kind == 0], particles["mass"][kind == 0], octant)
    assert list(meters["heat"].readings().values()) == pytest.approx([heat.mean(), *heat])
    inside = particles["position"][:, 0] <= 0.5
    volume = 4.0 / 3.0 * np.pi * (particles["radius"][inside] ** 3).sum()
    expected = [inside.sum(), particles["mass"][inside].sum(), volume]
    assert list(meters["half"].readings().values()) == pytest.approx(expected)


def test_upward_direction_is_opposite_to_gravity():
    """A wedge that rises in x, with gravity along -y instead of -z."""
    points, radius = bed(np.radians(24.0), "wedge")
    here = points[:, 0] < 0.3
    turned = points[here][:, [0, 2, 1]] * [1.0, 1.0, -1.0]
    meter = measured(
        snapshot_of(particles=spheres_of(turned, radius=radius[here])), kind="repose", surface="plane"
    )
    assert meter.readings()["angle_of_repose"] == pytest.approx(np.radians(24.0), abs=np.radians(1.5))


def test_mean_covers_the_last_stage_and_skips_nan():
    readings = iter([metric.Reading({"x": number}) for number in (9.0, 1.0, float("nan"), 2.0)])
    meter = MetricMeter(lambda _: next(readings), frozenset())
    meter.update(snapshot_of(0.0, stage="fill"))
    for time in (1.0, 2.0):
        meter.update(snapshot_of(time, stage="run"))
    other = MetricMeter(lambda _: next(readings), frozenset())
    other.load_state_dict(meter.state_dict())
    other.update(snapshot_of(3.0, stage="run"))
    assert other.result() == {"x": 2.0, "x_mean": 1.5}


def test_probe_follows_one_particle_by_its_id():
    """Its row in the snapshot changes; a particle that does not exist has no motion."""
    place = np.arange(30.0).reshape(10, 3)
    for ids, own in ((np.arange(10)[::-1], place[8]), (np.arange(10) + 5, 3 * [np.nan])):
        particles = spheres_of(place, velocity=2.0 * place, angular_velocity=3.0 * place, id=ids)
        found = measured(snapshot_of(particles=particles), kind="probe", id=1).readings()
        np.testing.assert_allclose(list(found.values()), np.outer([1.0, 2.0, 3.0], own).ravel())


def test_height_of_a_level_bed_and_of_its_volume():
    """Layers of equal spheres at z = (2 k + 1) r, and one sphere that falls above them.

    Below the level z, a full layer and the cap pi h^2 (r - h / 3) of the next one lie. The share 0.9 of 41
    spheres is 36.9, 4.9 of the fifth layer with 8 spheres: the cap has 0.6125 of the volume of a sphere. If
    those 8 are spheres of clumps with half of their mass, the share is 33.3 of 37, 1.3 of 4.
    """
    radius = 0.01
    x, y, layer = np.meshgrid(np.arange(4), np.arange(2), np.arange(5), indexing="ij")
    center = radius * np.column_stack([2 * x.ravel(), 2 * layer.ravel() + 1, 2 * y.ravel()])
    place = np.vstack([center, [0.0, 1.0, 0.0]])
    contacts = np.append(np.full(40, 3), 0)
    particles = spheres_of(place, radius=np.full(41, radius), coordination_number=contacts)
    meter = measured(snapshot_of(particles=particles), kind="height", base=-0.5, share=0.9)
    found = meter.readings()
    assert found["bed_height"] == found["heap_height"] == pytest.approx(0.5 + 10 * radius)
    h = (found["height_of_volume"] - 0.5) / radius - 8.0
    assert h**2 * (3.0 - h) / 4.0 == pytest.approx(0.6125)
    particles["mass"][:40][layer.ravel() == 4] = 0.5
    particles["coordination_number"][:20] = 0
    meter.update(snapshot_of(particles=particles))
    h = (meter.readings()["height_of_volume"] - 0.5) / radius - 8.0
    assert h**2 * (3.0 - h) / 4.0 == pytest.approx(0.325)
    assert np.isnan(meter.readings()["bed_height"]) and np.isnan(meter.readings()["heap_height"])
    assert "20 of 41 particles in the region have two contacts" in meter.remark
    particles["coordination_number"][19] = 2
    meter.update(snapshot_of(particles=particles))
    assert meter.readings()["bed_height"] == pytest.approx(0.5 + 10 * radius)


def rods_and_a_sphere():
    """Ids 0, 1: a rod with one contact of each sphere. Id 2: a sphere with one contact. Ids 3, 4: a rod with two
    contacts with particles and one with a wall, across the periodic face at 1.

    The centers of mass are at x = 0.25, 0.6 and 0.95, the masses are 2, 1 and 3 kg. The rods spin.
    """
    along = [1.0, 0.0, 0.0]
    rows = np.array([0, 0, 1, 2, 2])
    mass = np.array([2.0, 1.0, 3.0])
    center = np.outer([0.25, 0.6, 0.95], along)
    return spheres_of(
        np.outer([0.1, 0.3, 0.6, 0.9, 0.05], along), clump=np.array([0, 0, -1, 3, 3]), radius=np.full(5, 0.1),
        coordination_number=np.array([1, 1, 1, 0, 2]), wall_contact_count=np.array([0, 0, 0, 1, 0]),
        mass=(mass / [2.0, 1.0, 2.0])[rows], clump_mass=mass[rows], clump_position=center[rows],
        velocity=np.outer([9.0, -7.0, -1.0, 9.0, -9.0], along), clump_velocity=np.outer([1.0, -1.0, 0.0], along)[rows],
        group=np.array([0, 0, 1, 1, 1]),
    )  # fmt: skip


HALF = {"min": [0.0, -1.0, -1.0], "max": [0.7, 1.0, 1.0]}


@pytest.mark.parametrize(("keys", "expected"), [
    ({"kind": "coordination"}, [5.0 / 3.0, 2.0, 1.0 / 3.0, 1.0 / 3.0]),
    ({"kind": "coordination", "region": HALF}, [1.5, 2.0, 0.0, 0.5]),
    ({"kind": "content", "region": HALF}, [2.0, 3.0, 3.0 / 2500.0]),
    ({"kind": "center_of_mass"}, [(2 * 0.25 + 0.6 + 3 * 0.95) / 6.0, 0.0, 0.0]),
    # V = 1/6: (2 (5/6)^2 + (7/6)^2 + 3 (1/6)^2) / (6 (1 - 1/3)) = 17/24
    ({"kind": "granular_temperature"}, [17.0 / 72.0, 17.0 / 24.0, 0.0, 0.0]),
    # Cells of the masses 2 and 4 kg, c = 1/3. I_R = 2 (1/3 (1 + 9)/4 + 2/3 2) / 6
    ({"kind": "segregation", "groups": ["red"], "cells": [2, 1, 1]}, [1.0, 13.0 / 18.0]),
    # Cells of 1 and 2 particles, p = 1/3: separated.
    ({"kind": "lacey", "groups": ["red"], "cells": [2, 1, 1], "at_least": 1}, [0.0]),
])  # fmt: skip
def test_a_clump_is_one_particle_at_its_center_of_mass(keys, expected):
    domain = {"min": [0.0, -1.0, -1.0], "max": [1.0, 1.0, 1.0], "periodic": "x", "on_exit": "error"}
    meter = measured(snapshot_of(particles=rods_and_a_sphere()), domain, **keys)
    assert list(meter.readings().values()) == pytest.approx(expected, abs=1e-12)


def test_rattlers_have_fewer_than_two_contacts_of_either_kind():
    # Six particles with 0, 1, 4, 4, 5 and 6 contacts: Zm = (20 - 1) / 4.
    single = metric.coordination(np.array([0, 1, 4, 4, 5, 6]), np.zeros(6, int))
    assert single["mechanical_coordination_number"] == 19 / 4
    assert np.isnan(metric.coordination(np.array([0, 1]), np.zeros(2, int))["mechanical_coordination_number"])
    # A particle with one neighbor that rests on a wall carries a load; Zm counts its neighbor only.
    assert (
        metric.coordination(np.array([1, 2, 0]), np.array([1, 0, 1]))["mechanical_coordination_number"] == 1.5
    )


def test_height_of_a_rough_bed_is_that_of_columns_of_two_diameters():
    """Equal spheres on a square lattice, whose piles are shifted at random by up to a radius: the mean over blocks of
    two by two piles of the highest top, computed from the piles themselves."""
    radius = 1e-3
    x, y, k = (
        each.ravel() for each in np.meshgrid(np.arange(21), np.arange(21), np.arange(10), indexing="ij")
    )
    top = 0.02 + np.random.default_rng(3).uniform(-radius, radius, (21, 21))
    points = np.column_stack([(2 * x + 1) * radius, top[x, y] - (2 * k + 1) * radius, (2 * y + 1) * radius])
    particles = spheres_of(points, radius=np.full(len(points), radius))
    meter = measured(snapshot_of(particles=particles), kind="height", base=0.0)
    column = np.minimum(np.arange(21) // 2, 9)  # 40 mm between the outer centers: ten columns
    highest = np.full((10, 10), -np.inf)
    np.maximum.at(highest, (column[:, None], column[None, :]), top)
    assert meter.readings()["bed_height"] == pytest.approx(highest.mean(), rel=1e-12)


def test_width_of_columns_is_two_sauter_diameters():
    """Equal volumes of diameters 1 and 3: d32 is the harmonic mean 1.5; one ball of ten diameters among 10 000
    spheres widens the columns by (1 + 0.1) / (1 + 0.01)."""
    assert metric.column_edge(np.full(7, 0.3)) == 2.0 * 0.6
    assert metric.column_edge(np.array([0.5] * 27 + [1.5])) == pytest.approx(2.0 * 1.5)
    assert metric.column_edge(np.append(np.full(10_000, 0.5), 5.0)) == pytest.approx(2.0 * 1.1 / 1.01)


@pytest.mark.parametrize("kind", ["lacey", "segregation"])
@pytest.mark.parametrize(
    ("second", "scale", "shift", "smaller_than", "remark"),
    [
        (0.01, 1.0, 0.0, 0.03, "all 400 particles in the grid belong to the first component"),
        (0.03, 0.4, 0.0, 0.04, "all particles are in one cell"),
        (0.03, 1.0, 2.0, 0.04, "no particles in the grid"),
        (0.0105, 1.0, 0.0, 0.0205, "differ by 0.05 of the smaller one"),
    ],
)
def test_mixtures_without_meaning_give_the_reason(kind, second, scale, shift, smaller_than, remark):
    radius = np.where(np.arange(400) < 200, 0.01, second)
    particles = spheres_of(scale * random_points(400) + shift, radius=radius, mass=radius**3)
    region = {"min": [0.0] * 3, "max": [1.0] * 3}
    snapshot = snapshot_of(particles=particles)
    meter = measured(snapshot, kind=kind, cell=0.5, region=region, smaller_than=smaller_than)
    assert remark in meter.remark
    assert np.isnan(next(iter(meter.readings().values()))) == (second != 0.0105)


def rods(axes, spheres=3, spacing=0.01):
    """Particle arrays of rods with unit vectors (k, 3), three spheres each, at random places."""
    count = len(axes)
    middle = np.random.default_rng(2).uniform(0.0, 1.0, (count, 3))
    along = spacing * (np.arange(spheres) - 0.5 * (spheres - 1))
    position = (middle[:, None, :] + along[None, :, None] * axes[:, None, :]).reshape(-1, 3)
    return spheres_of(position, clump=np.repeat(spheres * np.arange(count), spheres))


def test_orientation_of_parallel_and_of_random_rods():
    """Parallel rods have S = 1; random ones <u u> = 1/3 and the mean inclination pi/2 - 1.

    The inclination b has the density cos b on [0, pi/2]: mean pi/2 - 1, mean square pi^2/4 - 2.
    """
    scene = SimpleNamespace(gravity=(0.0, 0.0, -9.81), groups=("rods",), domain=SimpleNamespace(periodic=()))

    def found(axes):
        return metric.OrientationMetric().measure(snapshot_of(particles=rods(axes)), scene).numbers

    tilted = np.array([0.6, 0.0, 0.8])
    parallel = found(np.tile(tilted, (50, 1)) * np.where(np.arange(50) % 2, 1.0, -1.0)[:, None])
    assert parallel["order_parameter"] == pytest.approx(1.0)
    assert parallel["inclination"] == pytest.approx(np.arcsin(0.8))
    assert [parallel[f"alignment_{k}"] for k in "xyz"] == pytest.approx([0.36, 0.0, 0.64])
    count = 4000
    random = np.random.default_rng(5).normal(size=(count, 3))
    numbers = found(random / np.linalg.norm(random, axis=1, keepdims=True))
    deviation = np.sqrt(np.pi**2 / 4.0 - 2.0 - (np.pi / 2.0 - 1.0) ** 2)
    assert numbers["inclination"] == pytest.approx(np.pi / 2.0 - 1.0, abs=4.0 * deviation / np.sqrt(count))
    square = 4.0 * np.sqrt(4.0 / 45.0 / count)  # of cos^2 of a random direction: 1/5 - 1/9
    assert all(numbers[f"alignment_{k}"] == pytest.approx(1.0 / 3.0, abs=square) for k in "xyz")
    assert 0.0 < numbers["order_parameter"] < 1.5 * 3.0 * square


def test_orientation_across_a_periodic_boundary_and_of_bodies_without_an_axis():
    domain = SimpleNamespace(periodic=("x",), min=(0.0, 0.0, 0.0), max=(1.0, 1.0, 1.0))
    scene = SimpleNamespace(gravity=(0.0, 0.0, -9.81), groups=("rods",), domain=domain)
    particles = rods(np.array([[1.0, 0.0, 0.0]]))
    particles["position"] = np.array([[0.99, 0.5, 0.5], [0.0, 0.5, 0.5], [0.01, 0.5, 0.5]])
    numbers = metric.OrientationMetric().measure(snapshot_of(particles=particles), scene).numbers
    assert numbers["alignment_x"] == pytest.approx(1.0) and numbers["inclination"] == pytest.approx(0.0)
    corner = 0.5 + 0.01 * np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    flat = metric.OrientationMetric().measure(snapshot_of(particles=particles | {"position": corner}), scene)
    assert np.isnan(flat.numbers["order_parameter"]) and "no clumps with a longest axis" in flat.remark


def sample(walls, domain=None, **keys):
    """The meter of a metric solid_fraction between `walls` {name: (point, normal, offset)}, of spheres of radius 5 mm
    at x = 0, 10, ..., 90 mm."""
    position = np.outer(0.01 * np.arange(10), [1.0, 0.0, 0.0])
    particles = spheres_of(position, radius=np.full(10, 5e-3), mass=np.full(10, 2500.0 * SPHERE))
    poses = {
        name: WallPose(offset is not None, np.array(offset or [0.0] * 3), np.eye(3), np.zeros(3))
        for name, (_, _, offset) in walls.items()
    }
    planes = {name: plane(point, normal) for name, (point, normal, _) in walls.items()}
    return measured(
        snapshot_of(particles=particles, walls=poses), domain, walls=planes, kind="solid_fraction", **keys
    )


ENDS = {
    "left": ([-0.005, 0, 0], [1, 0, 0], [0.0] * 3),
    "right": ([0.095, 0, 0], [-1, 0, 0], [-0.03, 0.0, 0.0]),
}
SPHERE = 4.0 / 3.0 * np.pi * 0.005**3


def test_solid_fraction_between_walls_follows_their_displacement():
    """The right wall has moved from x = 95 to 65 mm: seven spheres (centers up to 60 mm) in 70 mm of a cylinder
    of radius 20 mm; with a box of 0.1 m x 0.2 m around them, the same volume of particles in another one."""
    meter = sample(ENDS, between=["left", "right"], radius=0.02)
    volume = np.pi * 0.02**2 * 0.07
    expected = {
        "enclosed_volume": volume,
        "solid_fraction": 7 * SPHERE / volume,
        "void_ratio": volume / 7 / SPHERE - 1,
    }
    assert {name: meter.readings()[name] for name in expected} == pytest.approx(expected) and not meter.remark
    box = {
        "front": ([0, -0.05, 0], [0, 1, 0], [0.0] * 3), "back": ([0, 0.05, 0], [0, -1, 0], [0.0] * 3),
        "floor": ([0, 0, -0.1], [0, 0, 1], [0.0] * 3), "lid": ([0, 0, 0.1], [0, 0, -1], [0.0] * 3),
    }  # fmt: skip
    found = sample(ENDS | box, between=["left", "right", "front", "back", "floor", "lid"]).readings()
    assert found["solid_fraction"] == pytest.approx(7 * SPHERE / (0.1 * 0.2 * 0.07))
    periodic = {"min": [-1.0, -0.1, -0.3], "max": [1.0, 0.1, 0.3], "periodic": ["y", "z"], "on_exit": "error"}
    found = sample(ENDS, periodic, between=["right", "left"]).readings()
    assert found["solid_fraction"] == pytest.approx(7 * SPHERE / (0.2 * 0.6 * 0.07))


def test_solid_fraction_of_walls_that_enclose_no_volume():
    meter = sample(ENDS | {"right": (*ENDS["right"][:2], None)}, between=["left", "right"], radius=0.02)
    assert np.isnan(list(meter.readings().values())).all() and meter.remark == "right is absent"
    with pytest.raises(SceneError, match="leaves the volume open along y and z"):
        sample(ENDS, between=["left", "right"])
    with pytest.raises(SceneError, match="has left and floor as a pair, which are not opposite"):
        sample(ENDS | {"floor": ([0, 0, -0.1], [0, 0, 1], [0.0] * 3)}, between=["left", "floor"], radius=0.1)
