"""Heat: conduction between particles and with walls, compared with closed forms, and messages on its keys."""

import numpy as np
import pytest
from clumps import clump_group
from scene_builders import SOFT, build_scene, particle_group, plane

from granflow import Scene, Simulation
from granflow.engine.totals import ended_contacts_dissipation
from granflow.errors import GranflowError, SceneError
from granflow.plan.build import plan_for

RADIUS, DENSITY, YOUNG, POISSON = 0.005, 2500.0, 1e7, 0.25
MASS = DENSITY * 4.0 / 3.0 * np.pi * RADIUS**3
TIME_STEP, STEPS, FIRST_STEPS = 1e-5, 2000, 200
OVERLAP = 1e-5
"""Overlap of two spheres; a sphere and a wall with the same force have WALL_OVERLAP: F ~ sqrt(R*) d^1.5."""
WALL_OVERLAP = OVERLAP * 0.5 ** (1.0 / 3.0)
SPACING = 2.0 * RADIUS - OVERLAP
END = RADIUS - WALL_OVERLAP
CONTACT_RADIUS = np.sqrt(0.5 * RADIUS * OVERLAP)
WALL_RADIUS = np.sqrt(RADIUS * WALL_OVERLAP)
CONDUCTIVITY, OTHER_CONDUCTIVITY = 1.0, 3.0
CAPACITY, OTHER_CAPACITY = 8e-4 * MASS, 2e-3 * MASS
RATIO = WALL_RADIUS / CONTACT_RADIUS
PLATE_CONDUCTIVITY = CONDUCTIVITY / (RATIO - 1.0)
"""Conductivity k_p with which a contact with a plate conducts twice as well as one of two spheres: then the
plate is where the rod that a chain represents ends. With the radius ratio r, r 2 k k_p / (k + k_p) = 2 k."""
FLUX = 2e3
HOT, COLD = 400.0, 300.0
LENGTH = 10
"""Spheres in the chain."""


def material(conductivity, capacity):
    return {
        "young_modulus": YOUNG, "poisson_ratio": POISSON, "density": DENSITY,
        "thermal_conductivity": conductivity, "heat_capacity": capacity / MASS,
    }  # fmt: skip


def plate(corner, sides, **keys):
    return {"shape": "rectangle", "corner": corner, "sides": sides, "material": "plate"} | keys


def line(y, temperatures, left, right, materials=None):
    """Groups and walls of a line of spheres, squeezed between two plates with these keys.

    All contacts have the same force, so that the spheres stay where they are.
    """
    count = len(temperatures)
    materials = materials or ["sphere"] * count
    groups = {
        f"line_{y}_{k}": particle_group(
            [[END + k * SPACING, 0.03 * y, 0.0]],
            2.0 * RADIUS,
            materials[k],
            temperature=each,
            heat_source=0.0,
        )
        for k, each in enumerate(temperatures)
    }
    end = 2.0 * END + (count - 1) * SPACING
    sides = [[0, 2 * RADIUS, 0], [0, 0, 2 * RADIUS]]
    return groups, {
        f"plate_{y}_left": plate([0.0, 0.03 * y - RADIUS, -RADIUS], sides, **left),
        f"plate_{y}_right": plate([end, 0.03 * y - RADIUS, -RADIUS], sides, **right),
    }


def lines_scene(heat="conduction", **parts):
    """A chain between a hot and a cold plate, two spheres of different materials between insulated plates, a
    sphere at a hot plate, and one at a plate with a heat flux."""
    lines = [
        line(0, [COLD] * LENGTH, {"temperature": HOT}, {"temperature": COLD}),
        line(1, [HOT, COLD], {}, {}, ["sphere", "other"]),
        line(2, [COLD], {"temperature": HOT}, {}),
        line(3, [COLD], {}, {"heat_flux": FLUX}),
    ]
    materials = {
        "sphere": material(CONDUCTIVITY, CAPACITY),
        "other": material(OTHER_CONDUCTIVITY, OTHER_CAPACITY),
        "plate": material(PLATE_CONDUCTIVITY, 1.0),
    }
    given = {
        "groups": {name: group for groups, _ in lines for name, group in groups.items()},
        "walls": {name: wall for _, walls in lines for name, wall in walls.items()},
        "pair": {"restitution": 1.0}, "materials": materials,
        "contact": {"normal": "hertz", "tangential": "none", "rolling": "none", "heat": heat},
        "domain": {"min": [-0.1] * 3, "max": [0.2] * 3, "on_exit": "error"},
        "run": {"duration": 1.0, "time_step": TIME_STEP, "velocity_max": 0.1},
    }  # fmt: skip
    return build_scene(**(given | parts))


def rod_temperature(x, time, diffusivity):
    """Temperature at x (n,) in a rod of length 1 that is cold at first, with ends that are hot and cold.

    (T - T_c) / (T_h - T_c) = 1 - x - sum over n of 2 / (n pi) sin(n pi x) exp(-n^2 pi^2 D t)
    """
    n = np.arange(1, 200)[:, None]
    terms = 2.0 / (n * np.pi) * np.sin(n * np.pi * x) * np.exp(-(n**2) * np.pi**2 * diffusivity * time)
    return COLD + (HOT - COLD) * (1.0 - x - terms.sum(axis=0))


def test_lines_of_spheres_conduct_as_the_closed_forms_say():
    with Simulation(lines_scene(), threads=2) as simulation:
        start = simulation.snapshot().totals
        simulation.step(FIRST_STEPS)
        early = simulation.snapshot().particles["temperature"]
        simulation.step(STEPS - FIRST_STEPS)
        found = simulation.snapshot().particles["temperature"]
        time = simulation.time
        totals = simulation.snapshot().totals
        check_changes_from_python(simulation)
    chain, _, _, heated = np.split(found, np.cumsum([LENGTH, 2, 1]))
    _, (first, second), at_plate, _ = np.split(early, np.cumsum([LENGTH, 2, 1]))
    conductance = 2.0 * CONDUCTIVITY * CONTACT_RADIUS
    # A rod in finite volumes of the width 1/n has an error of pi^2 / (12 n^2) of the slowest rate.
    x = (np.arange(LENGTH) + 0.5) / LENGTH
    series = rod_temperature(x, time, conductance / (CAPACITY * LENGTH**2))
    assert series[LENGTH // 2] - COLD > 0.1 * (HOT - COLD)
    np.testing.assert_allclose(chain, series, atol=(HOT - COLD) * np.pi**2 / (12 * LENGTH**2))
    # Two spheres: the harmonic mean of both conductivities.
    mean = 2.0 * CONDUCTIVITY * OTHER_CONDUCTIVITY / (CONDUCTIVITY + OTHER_CONDUCTIVITY)
    rate = 2.0 * mean * CONTACT_RADIUS * (1.0 / CAPACITY + 1.0 / OTHER_CAPACITY)
    time_early = FIRST_STEPS * TIME_STEP
    decayed = (HOT - COLD) * np.exp(-rate * time_early)
    assert first - second == pytest.approx(decayed, rel=rate**2 * TIME_STEP * time_early)
    content = CAPACITY * HOT + OTHER_CAPACITY * COLD
    assert CAPACITY * first + OTHER_CAPACITY * second == pytest.approx(content, rel=1e-12)
    explicit = (HOT - COLD) * (1.0 - 2.0 * conductance / CAPACITY * TIME_STEP) ** FIRST_STEPS
    assert HOT - at_plate[0] == pytest.approx(explicit, rel=1e-9)
    power = FLUX * np.pi * RADIUS**2
    assert heated[0] == pytest.approx(COLD + power * time / CAPACITY, rel=1e-9)
    # The heat of the particles is that of the walls; the mean is weighted by the capacity.
    capacities = np.full(len(found), CAPACITY)
    capacities[LENGTH + 1] = OTHER_CAPACITY
    assert totals["heat_content"] == pytest.approx(capacities @ found, rel=1e-13)
    mean = np.average(found, weights=capacities)
    assert totals["temperature_mean"] == pytest.approx(mean, rel=1e-13)
    deviation = np.sqrt(np.average((found - mean) ** 2, weights=capacities))
    assert totals["temperature_deviation"] == pytest.approx(deviation, rel=1e-12)
    assert (totals["temperature_smallest"], totals["temperature_largest"]) == (found.min(), found.max())
    of_walls = {name: value for name, value in totals.items() if name.startswith("wall_heat.")}
    assert set(of_walls) == {f"wall_heat.plate_{line}" for line in ("0_left", "0_right", "2_left", "3_right")}
    assert totals["wall_heat_flow.plate_3_right"] == pytest.approx(power, rel=1e-9)
    into_sphere = 2.0 * conductance * (HOT - found[-2])
    assert totals["wall_heat_flow.plate_2_left"] == pytest.approx(into_sphere, rel=1e-9)
    gained = totals["heat_content"] - start["heat_content"]
    assert gained == pytest.approx(sum(of_walls.values()), rel=1e-9)
    assert of_walls["wall_heat.plate_3_right"] == pytest.approx(power * time, rel=1e-9)
    assert of_walls["wall_heat.plate_0_right"] < 0.0


def check_changes_from_python(simulation):
    """Temperatures are read and set; a temperature that is not above 0 K is refused."""
    particles = simulation.particles
    particles.temperature[:LENGTH] = 350.0
    assert particles.temperature.tolist()[:LENGTH] == [350.0] * LENGTH
    content = simulation.snapshot().totals["heat_content"]
    simulation.step(1)
    assert simulation.particles.temperature[0] != 350.0
    particles.temperature *= 2.0
    assert simulation.snapshot().totals["heat_content"] == pytest.approx(2.0 * content, rel=0.01)
    with pytest.raises(GranflowError, match="a temperature is above 0 K"):
        particles.temperature[0] = 0.0


EMISSIVITY, SURROUNDINGS, LAG = 0.8, 350.0, 20.0
"""`LAG`: factor of the heat capacities in the scene of radiating bodies."""
FUSED_SOURCE = 0.1


def radiating_scene(**parts):
    """Bodies between plates that they do not touch, and a sphere of a clump between insulated plates with a
    single sphere, both of a material without radiation.

    The fused ones are two spheres with a distance of one radius; the clump at the plates has two that touch,
    one outside of the plates.
    """
    materials = lines_scene().to_dict()["materials"]
    for name, each in materials.items():
        each["emissivity"] = EMISSIVITY if name == "sphere" else 0.0
        each["heat_capacity"] *= LAG
    fused = [[0.0, 0.0, 0.0], [RADIUS, 0.0, 0.0]]
    pair = [[0.0, 0.0, 0.0], [0.0, 2.0 * RADIUS, 0.0]]
    groups = {
        "hot": particle_group([[0.1, 0.1, 0.1]], 2.0 * RADIUS, "sphere", temperature=900.0),
        "other": particle_group([[0.1, 0.1, 0.0]], 2.0 * RADIUS, "other", temperature=300.0),
        "fused": clump_group([[0.1, 0.0, 0.1]], fused, RADIUS, material="sphere", temperature=900.0, heat_source=FUSED_SOURCE),
        "at_plate": clump_group([[END, 0.03 + RADIUS, 0.0]], pair, RADIUS, material="other", temperature=HOT),
        "line_1_1": particle_group([[END + SPACING, 0.03, 0.0]], 2.0 * RADIUS, "other", temperature=COLD),
    }  # fmt: skip
    return lines_scene(
        {"law": "conduction", "surroundings": SURROUNDINGS}, groups=groups, materials=materials, **parts
    )


def test_spheres_and_clumps_radiate_and_conduct_with_one_temperature(tmp_path):
    """Explicit steps of m c dT/dt = e s A (Ts^4 - T^4) + S, and of a clump and a sphere in contact.

    Of each fused sphere, a cap of the height h = R/2 and the area 2 pi R h lies in the other one; both have in common
    two caps of the volume pi h^2 (R - h/3).
    """
    cap_height = 0.5 * RADIUS
    area = 4.0 * np.pi * RADIUS**2
    fused_area = 2.0 * (area - 2.0 * np.pi * RADIUS * cap_height)
    common = 2.0 * np.pi * cap_height**2 * (RADIUS - cap_height / 3.0)
    fused_capacity = LAG * CAPACITY * (2.0 - common * DENSITY / MASS)
    with Simulation(radiating_scene(), threads=2, out=tmp_path / "first") as simulation:
        start = simulation.snapshot().totals
        simulation.step(FIRST_STEPS)
        found = simulation.snapshot()
        simulation.save()
    temperature = found.particles["temperature"]
    expected, fused = 900.0, 900.0
    clump, sphere = HOT, COLD
    conductance = 2.0 * OTHER_CONDUCTIVITY * CONTACT_RADIUS
    capacity = LAG * OTHER_CAPACITY
    for _ in range(FIRST_STEPS):
        expected += TIME_STEP * radiated(area, expected) / (LAG * CAPACITY)
        fused += TIME_STEP * (radiated(fused_area, fused) + FUSED_SOURCE) / fused_capacity
        flow = conductance * (clump - sphere)
        clump -= TIME_STEP * flow / (2.0 * capacity)
        sphere += TIME_STEP * flow / capacity
    assert expected < 700.0 and clump - sphere < 0.97 * (HOT - COLD)
    by_sphere = [expected, 300.0, fused, fused, clump, clump, sphere]
    assert temperature.tolist() == pytest.approx(by_sphere, rel=1e-10)
    totals = found.totals
    assert totals["heat_content"] - start["heat_content"] == pytest.approx(
        totals["surroundings_heat"] + totals["source_heat"], rel=1e-9
    )
    assert totals["source_heat"] == pytest.approx(FIRST_STEPS * TIME_STEP * FUSED_SOURCE, rel=1e-12)
    check_start_from(tmp_path / "first", temperature)


def radiated(area, temperature):
    """Heat flow [W] to a gray body from the surroundings."""
    return EMISSIVITY * 5.670374419e-8 * area * (SURROUNDINGS**4 - temperature**4)


def check_start_from(directory, temperature):
    """A run that starts from another one has its temperatures, of clumps, too; a program sets those of all
    spheres of a clump together, and so does a stage by the center of mass."""
    box = {"min": [0.1 - 1e-4, -1.0, 0.05], "max": [1, 0.05, 1]}
    setting = {"temperature": 500.0, "heat_source": 0.4, "region": {"box": box}}
    stages = [{"name": "wait", "duration": TIME_STEP}, {"name": "set", "duration": 1.0, "set": setting}]
    run = {"time_step": TIME_STEP, "velocity_max": 0.1}
    with Simulation(
        radiating_scene(start_from=str(directory), stages=stages, run=run), threads=2
    ) as simulation:
        particles = simulation.particles
        assert particles.temperature.tolist() == temperature.tolist()
        with pytest.raises(
            GranflowError, match="sphere 3 would have 310, and sphere 2 of the same clump 597"
        ):
            particles.temperature[3] = 310.0
        particles.temperature[2:4] = 310.0
        assert particles.temperature.tolist() == [*temperature[:2], 310.0, 310.0, *temperature[4:]]
        simulation.step(2)
        found = simulation.snapshot().particles
        assert found["temperature"][2:4].tolist() == pytest.approx([500.0] * 2, abs=0.5)
        assert found["temperature"][2] == found["temperature"][3]
        assert found["heat_source"].tolist() == pytest.approx([0.0, 0.0, 0.2, 0.2, 0.0, 0.0, 0.0])


def stages_scene(first_settings=()):
    """Two spheres of different materials between insulated plates, and a chain between two with temperatures.

    After a stage, one of the two and the left half of the chain take other temperatures, and the other one of
    the two, which had a source of heat before, another source.
    """
    middle = END + (LENGTH / 2 - 0.5) * SPACING
    settings = [
        {"heat_source": SECOND_SOURCE, "temperature": 500.0, "groups": ["line_1_0", "line_1_1"]},
        {"heat_source": 0.0, "region": {"sphere": {"center": [END, 0.03, 0], "radius": RADIUS}}},
        {"temperature": 700.0, "groups": ["line_1_1"]},
        {"temperature": 650.0, "region": {"box": {"min": [0, -0.01, -1], "max": [middle, 0.01, 1]}}},
    ]
    groups = lines_scene().to_dict()["particles"]
    groups["line_1_1"]["heat_source"] = FIRST_SOURCE
    duration = FIRST_STEPS * TIME_STEP
    first = {"name": "first", "duration": duration, "set": list(first_settings)}
    return lines_scene(
        groups=groups,
        run={"time_step": TIME_STEP, "velocity_max": 0.1},
        stages=[first, {"name": "second", "duration": duration, "set": settings}],
    )


FIRST_SOURCE, SECOND_SOURCE = 0.3, -0.2


def test_stages_set_temperatures_and_sources_of_heat():
    conductance = (
        2.0 * 2.0 * CONDUCTIVITY * OTHER_CONDUCTIVITY / (CONDUCTIVITY + OTHER_CONDUCTIVITY) * CONTACT_RADIUS
    )
    capacities = np.array([CAPACITY, OTHER_CAPACITY])

    def stepped(temperatures, sources):
        """After FIRST_STEPS explicit steps of m c dT/dt = h (T_j - T_i) + s."""
        for _ in range(FIRST_STEPS):
            flow = conductance * (temperatures[1] - temperatures[0])
            temperatures = temperatures + TIME_STEP * (np.array([flow, -flow]) + sources) / capacities
        return temperatures

    with Simulation(stages_scene(), threads=2) as simulation:
        start = simulation.snapshot().totals
        simulation.step(FIRST_STEPS)
        first = simulation.snapshot()
        simulation.step(FIRST_STEPS)
        second = simulation.snapshot()
        simulation.particles.temperature[0] += 10.0
        changed = simulation.snapshot().totals
    before = stepped(np.array([HOT, COLD]), np.array([0.0, FIRST_SOURCE]))
    np.testing.assert_allclose(first.particles["temperature"][LENGTH : LENGTH + 2], before, rtol=1e-9)
    after = stepped(np.array([500.0, 700.0]), np.array([0.0, SECOND_SOURCE]))
    np.testing.assert_allclose(second.particles["temperature"][LENGTH : LENGTH + 2], after, rtol=1e-9)
    assert second.particles["heat_source"][LENGTH:].tolist() == [0.0, SECOND_SOURCE, 0.0, 0.0]
    # The chain: five spheres are hotter than the plate at first, the sixth is not.
    hottest = first.particles["temperature"][:LENGTH].max()
    assert hottest < HOT < second.particles["temperature"][LENGTH // 2 - 1]
    # Heat: that which was set, by the temperatures before, of sources and walls is that of the particles.
    time = FIRST_STEPS * TIME_STEP
    chain = first.particles["temperature"][: LENGTH // 2]
    added = CAPACITY * (650.0 - chain).sum() + capacities @ (np.array([500.0, 700.0]) - before)
    totals = second.totals
    assert first.totals["heat_content_set"] == 0.0
    assert totals["heat_content_set"] == pytest.approx(added, rel=1e-9)
    assert totals["source_heat"] == pytest.approx(time * (FIRST_SOURCE + SECOND_SOURCE), rel=1e-9)
    walls = sum(value for name, value in totals.items() if name.startswith("wall_heat."))
    gained = totals["heat_content"] - start["heat_content"]
    assert gained == pytest.approx(walls + totals["source_heat"] + totals["heat_content_set"], rel=1e-10)
    assert changed["heat_content_set"] - added == pytest.approx(10.0 * CAPACITY, rel=1e-6)


def rough_plate_scene(**of_rough):
    """Warm spheres and a rod fall with bridges onto particles that are parts of a hot plate in motion.

    A wall vanishes while bridges are stretched, so that the forces are computed again.
    """
    rough = particle_group(0.005 * np.argwhere(np.ones((4, 4, 1))), 0.004, temperature=HOT)
    sites = [[0.0025, 0.0025, 0.0041], [0.0076, 0.0074, 0.0044], [0.0124, 0.0026, 0.0041]]
    balls = particle_group(sites, 0.006, velocity=[0.2, 0.0, -0.8], temperature=COLD)
    rod = clump_group([[0.0076, 0.0135, 0.0043]], velocity=[0.0, 0.0, -0.8], temperature=COLD)
    plate = {
        "shape": "rectangle", "corner": [-0.01, -0.01, 0.0], "sides": [[0.04, 0, 0], [0, 0.04, 0]], "material": "glass",
        "temperature": HOT, "motion": {"kind": "vibration", "direction": [0, 0, 1], "amplitude": 1e-4, "frequency": 300.0},
    }  # fmt: skip
    viscous = {"law": "capillary", "viscous_force": {"viscosity": 0.05, "min_separation_ratio": 0.02}}
    return build_scene(
        {"rough": rough | {"fixed": {"to": "plate"}} | of_rough, "balls": balls, "rod": rod},
        {"plate": plate, "lid": plane([0, 0, 0.03], [0, 0, -1], stages=["a"])},
        stages=[{"name": "a", "duration": 8e-4}, {"name": "b", "duration": 1.0}],
        materials={"glass": SOFT | {"thermal_conductivity": 5.0, "heat_capacity": 0.5}},
        contact={
            "normal": "hertz", "tangential": "mindlin", "rolling": "none", "cohesion": viscous,
            "heat": {"law": "conduction", "from_dissipation": True},
        },
        pair={"friction": 0.4, "restitution": 0.5, "surface_tension": 0.07, "contact_angle": 0.3, "liquid_volume": 1e-10},
        output={"interval": 1.0, "energy_budget": True}, run={"velocity_max": 2.0, "time_step": 2e-6},
    )  # fmt: skip


def test_particles_of_a_hot_wall_keep_its_temperature_and_their_heat_is_that_of_the_wall(taichi_f64):
    """The losses of a viscous force, too: of the present power, half belongs to the next step."""
    with Simulation(rough_plate_scene(heat_source=0.05), threads=2) as simulation:
        start = simulation.snapshot().totals
        for steps in (380, 21, 300):
            simulation.step(steps)
            found = simulation.snapshot()
            temperature, totals = found.particles["temperature"], found.totals
            lost = sum(totals[f"{name}_dissipation"] for name in ("friction", "rolling", "damping"))
            lost += ended_contacts_dissipation(simulation.engine.state)
            gained = totals["heat_content"] - start["heat_content"]
            assert gained == pytest.approx(lost + totals["wall_heat.plate"] + totals["source_heat"], rel=1e-8)
            for name in ("position", "velocity", "angular_velocity", "mass", "force"):  # of clumps, too
                np.testing.assert_array_equal(
                    getattr(simulation.particles, name)[:], found.particles[name], name
                )
        with pytest.raises(
            GranflowError, match="particle 3 is attached to a wall and has its temperature, 400"
        ):
            simulation.particles.temperature[3] = 350.0
    is_rough = found.particles["group"] == 0
    assert set(temperature[is_rough]) == {HOT} and temperature[~is_rough].min() > COLD + 0.1
    assert len(set(temperature[-4:])) == 1, "the spheres of the rod"
    assert totals["damping_dissipation"] > 1e-5
    flow = -found.particles["heat_flow"][is_rough].sum()
    assert flow != 0.0 and totals["wall_heat_flow.plate"] == pytest.approx(flow, rel=1e-9)


def test_particles_of_a_wall_have_its_temperature_and_no_part_in_its_heat_flux_and_wear():
    with pytest.raises(SceneError, match=r"rough.temperature is 300.* parts of plate, which has 400 K"):
        Scene.from_dict(rough_plate_scene(temperature=COLD).to_dict())
    scene = rough_plate_scene().to_dict()
    scene["walls"]["plate"]["wear"] = {"law": "relative"}
    assert "walls.plate.wear" in " ".join(plan_for(Scene.from_dict(scene)).warnings)
    scene["walls"]["plate"] |= {"heat_flux": 10.0, "temperature": None}
    with pytest.raises(SceneError, match="fixed.to is plate, but the wall has a heat_flux"):
        Scene.from_dict(scene)


def test_losses_become_heat_and_the_total_energy_with_inlet_and_outlet_is_closed(taichi_f64):
    """Hot particles enter through a face, slide on a floor with friction and leave in an outlet; a program removes
    two.

    The heat of the particles present, inserted and deleted and of the floor equals the losses; the plastic work of a
    contact becomes heat when the contact ends. The total energy has the error of the integration of the motion.
    """
    face = {"disc": {"center": [-0.005, 0.0, 0.006], "normal": [1, 0, 0], "radius": 0.006}}
    inlet = {
        "material": "glass", "diameter": 0.005, "velocity": [3.0, 0.0, -0.6], "temperature": 500.0,
        "insert": {"kind": "inlet", "rate": 1500.0, "face": face},
    }  # fmt: skip
    rod = [[-1.5e-3, 0.0, 0.0], [0.0, 0.0, 0.0], [1.5e-3, 0.0, 0.0]]
    rods = clump_group([[0.01, 0.0, 0.004]], rod, 1.4e-3, velocity=[2.0, 0.0, -0.3], temperature=HOT)
    heat_capacity = 0.05  # J/kg/K, with which the losses are a visible part of the heat
    scene = build_scene(
        {"inlet": inlet, "rods": rods}, {"floor": plane([0, 0, 0], [0, 0, 1], temperature=350.0)},
        materials={"glass": SOFT | {"thermal_conductivity": 50.0, "heat_capacity": heat_capacity}},
        contact={
            "normal": "zhou", "tangential": "mindlin", "rolling": "epsd",
            "heat": {"law": "conduction", "from_dissipation": True},
        },
        pair={"friction": 0.4, "rolling_friction": 0.1, "restitution": 0.6}, gravity=[0.0, 0.0, -9.81],
        domain={"min": [-0.02] * 3, "max": [0.03, 0.02, 0.02], "on_exit": "delete"},
        outlets={"end": {"half_space": {"point": [0.025, 0, 0], "normal": [1, 0, 0]}}},
        output={"interval": 1.0, "energy_budget": True}, numerics={"chunk_size": 16},
        run={"duration": 0.03, "velocity_max": 6.0, "time_step": 1e-6},
    )  # fmt: skip
    with Simulation(scene, threads=2) as simulation:
        start = simulation.snapshot().particles
        simulation.step(16000)
        simulation.particles.remove(np.argsort(simulation.particles.position[:, 2])[-2:])
        simulation.step(500)
        totals = simulation.snapshot().totals
        ended = ended_contacts_dissipation(simulation.engine.state)
        inserted_mass = totals["deleted_mass"] + simulation.particles.mass.sum()
    assert totals["outlet_count.end"] > 10 and totals["deleted_count"] == totals["outlet_count.end"] + 2.0
    losses = [ended, *(totals[f"{name}_dissipation"] for name in ("friction", "rolling", "damping"))]
    assert min(losses[:3]) > 0.0
    brought = totals["heat_content_inserted"] - totals["heat_content_deleted"]
    heat = totals["heat_content"] - brought - totals["wall_heat.floor"]
    assert heat == pytest.approx(sum(losses), rel=1e-9)
    rod_mass = start["mass"][start["group"] == 1].sum()
    expected = heat_capacity * (HOT * rod_mass + 500.0 * (inserted_mass - rod_mass))
    assert totals["heat_content_inserted"] == pytest.approx(expected, rel=1e-12)
    assert "loss_heat" not in start, "this number of the last step is no particle quantity"
    kinds = ("kinetic", "rotational", "gravitational", "elastic")
    mechanical = sum(totals[f"{kind}_energy"] for kind in kinds) + totals["plastic_dissipation"] - ended
    residual = mechanical + totals["removed_energy"] + heat - totals["wall_work"]
    assert abs(residual) < 1e-6 * totals["heat_content_inserted"]
    assert sum(losses) > 100.0 * abs(residual)


def test_a_setting_without_particles_is_a_warning(caplog):
    half = {"half_space": {"point": [1, 0, 0], "normal": [1, 0, 0]}}
    with Simulation(stages_scene([{"temperature": "20 K", "region": half}]), threads=2) as simulation:
        simulation.step(1)
    assert "none of the 14 particles is in the groups and the region" in caplog.text


GAS = {"conductivity": 0.95, "min_gap": 1e-6}


def stage(**setting):
    return [{"name": "a", "duration": 1.0, "set": setting}]


CASES = [
    ("materials.plate.thermal_conductivity", None, "materials.plate.thermal_conductivity is missing"),
    ("materials.other.heat_capacity", None, "materials.other.heat_capacity is missing"),
    ("particles.line_0_0.temperature", None, "particles.line_0_0.temperature is missing"),
    ("walls.plate_1_left.temperature", 0, "but a temperature must be above 0"),
    ("walls.plate_0_left.heat_flux", 1.0, "temperature is given too: keep one of them"),
    ("contact.heat", None, "walls.plate_3_right.heat_flux has no effect"),
    ("materials.sphere.heat_capacity", 1e-6, "is longer than"),
    (
        "expect",
        [{"quantity": "wall_heat.plate_1_left", "above": 0}],
        "there is no such wall with a temperature",
    ),
    ("contact.heat", {"law": "conduction", "surroundings": 300}, "other.emissivity is missing"),
    ("contact.heat", {"law": "conduction", "gas": GAS}, "but it must be at most 0.9 of materials.sphere."),
    ("contact.heat", {"law": "conduction", "from_dissipation": True}, "the losses of the energy budget"),
    ("stages", stage(groups=["line_0_0"]), "sets no property"),
    ("stages", stage(temperature=400, groups=["line"]), "there is no such group of particles"),
    ("stages", stage(temperature=400, region={"bx": 1}), "but it must be {box: {min: [..], max: [..]}}"),
    ("run.precision", "f32", "run.precision is f32, but the change of temperature"),
]


@pytest.mark.parametrize(("path", "value", "sentence"), CASES)
def test_invalid_heat_has_its_message(path, value, sentence):
    scene = lines_scene().to_dict()
    *parents, key = path.split(".")
    part = scene
    for name in parents:
        part = part[name]
    part[key] = value
    if value is None:
        del part[key]
    with pytest.raises(SceneError) as error:
        plan_for(Scene.from_dict(scene))
    assert any(sentence in each for each in error.value.problems), error.value.problems
