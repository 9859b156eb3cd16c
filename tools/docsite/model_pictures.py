"""Pictures of the contact models, from closed forms and reference implementations on the host; no
simulation."""

import io
import math
from collections.abc import Callable, Mapping, Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np

from docsite.example_laws import (
    ADHESION,
    LARGEST_VELOCITY,
    example_pair,
    fitted_pair,
    normal_law,
    pair,
    two_spheres,
)
from granflow.contact import registry, theory
from granflow.contact.law import ContactState, ModelRequest, NormalLaw
from granflow.contact.material import PairMaterial
from granflow.contact.rolling.bounded_torque import STOPPED_SHARE
from granflow.contact.rolling.sds import Sds
from granflow.contact.tangential.spring import reference_spring

GRAY = "#8a8a8a"
COLORS = ("#3b82c4", "#d97a26", "#4a9d5b")
"""Colors that are visible on light and dark pages."""
LOWEST_VELOCITY = 1e-3
RADIUS, MODULUS = 1e-4, 1e7
"""Effective radius [m] and modulus [Pa] of the cohesive sphere."""
STEPS_PER_CONTACT = 400
VARIANTS: dict[str, Sequence[tuple[str, dict[str, Any]]]] = {
    "linear": [("stiffness: onset", {}), ("stiffness: 1e7 N/m", {"stiffness": {"value": 1e7}})],
    "walton_braun": [
        ("unloading: constant", {}),
        ("reference 1 m/s", {"unloading": {"reference_velocity": 1.0}}),
    ],
    "luding": [
        (f"tension: {tension:g}", {"plasticity_depth": 1e-3, "tension": tension}) for tension in (0.0, 0.2)
    ],
    "thornton": [("yield_ratio: 1.6", {}), ("yield_ratio: 2.8", {"yield_ratio": 2.8})],
    "kuwabara_kono": [("reference 1 m/s", {}), ("reference 0.1 m/s", {"reference_velocity": 0.1})],
}
"""Label and options of the curves of a normal model; other models have one curve."""
BRIDGE_VOLUMES = (1e-17, 1e-16, 1e-15)
"""Volumes [m3] of the bridges in the picture of a model that transfers liquid."""
OPTIONS = {"capillary_transfer": {"max_bridge_volume": BRIDGE_VOLUMES[-1]}}
"""Options of the pictured cohesion models that require some."""


def picture(slot: str, name: str) -> str:
    """Picture of a model as SVG text. Raises KeyError for a slot without pictures."""
    draw: dict[str, Callable[[str], str]] = {
        "normal": _normal,
        "tangential": lambda name: _loop(
            "displacement / displacement at slip", "tangential force / Coulomb limit"
        ),
        "rolling": _rolling,
        "twisting": lambda name: _loop("twist angle / angle at the limit", "torque / limit"),
        "cohesion": lambda name: _sjkr() if name == "sjkr" else _cohesion(name),
        "heat": lambda name: _conductance(),
    }
    return draw[slot](name)


def collide(law: NormalLaw, materials: PairMaterial, velocity: float) -> tuple[float, float]:
    """Restitution and contact duration [s] by integration of the reference implementation.

    velocity:  approach velocity [m/s]
    """
    radius, mass = two_spheres()
    constants = np.array(law.pair_constants(materials))
    history = np.zeros(law.history_count)
    time_step = sum(law.phase_durations(materials, radius, mass, velocity)) / STEPS_PER_CONTACT
    overlap = 0.5 * velocity * time_step
    rate = velocity
    steps = 0.5
    while True:
        if overlap <= 0.0:
            return -rate / velocity, steps * time_step
        force, history = law.reference_force(constants, radius, mass, time_step, overlap, rate, history)
        ends = force == 0.0 and rate < 0.0
        if ends or steps > 5 * STEPS_PER_CONTACT:
            return max(-rate, 0.0) / velocity, steps * time_step
        rate -= force / mass * time_step
        overlap += rate * time_step
        steps += 1.0


def _normal(name: str) -> str:
    """Restitution and duration versus impact velocity."""
    figure, axes = _figure(2)
    variants = VARIANTS.get(name, [("", {})])
    cases = [(label, normal_law(name, **options), example_pair(name)) for label, options in variants]
    if registry.models("normal")[name].restitution == "number or fit":
        cases = [("stainless_316 (Eq. 12)", cases[0][1], fitted_pair()), ("e = 0.8", cases[0][1], pair())]
    radius, mass = two_spheres()
    line = np.geomspace(LOWEST_VELOCITY, LARGEST_VELOCITY, 60)
    dots = np.geomspace(LOWEST_VELOCITY, LARGEST_VELOCITY, 7)
    for color, (label, law, materials) in zip(COLORS, cases, strict=False):
        e = [law.restitution(materials, radius, mass, v) for v in line]
        duration = [sum(law.phase_durations(materials, radius, mass, v)) for v in line]
        simulated = np.array([collide(law, materials, v) for v in dots])
        for axis, closed, points in zip(axes, (e, duration), simulated.T, strict=True):
            scale = 1.0 if axis is axes[0] else 1e6
            axis.plot(line, scale * np.array(closed), color=color, label=label)
            axis.plot(dots, scale * points, "o", mfc="none", color=color, ms=5)
    _label(axes[0], "impact velocity [m/s]", "restitution coefficient")
    _label(axes[1], "impact velocity [m/s]", "contact duration [us]")
    for axis in axes:
        axis.set_xscale("log")
    axes[0].set_ylim(0.0, 1.05)
    axes[1].set_ylim(bottom=0.0)
    if cases[0][0]:
        axes[0].legend(frameon=False, labelcolor=GRAY, fontsize=9)
    return _svg(figure)


def _loop(x: str, y: str) -> str:
    """Force of the elastic-plastic spring over one cycle of displacement, in units of the limit."""
    figure, (axis,) = _figure(1)
    path = np.concatenate([np.linspace(0, 2, 100), np.linspace(2, -2, 200), np.linspace(-2, 2, 200)])
    displacement = np.zeros(3)
    forces = []
    for step in np.diff(path, prepend=0.0):
        force, displacement = reference_spring(1.0, 1.0, displacement, np.array([step, 0.0, 0.0]))
        forces.append(-force[0])
    axis.plot(path, forces, color=COLORS[0])
    _label(axis, x, y)
    return _svg(figure)


def _rolling(name: str) -> str:
    """Torque of a rolling model over its displacement (EPSD, SDS) or rate (CDT, viscous)."""
    if name == "epsd":
        return _loop("rolling angle / angle at the limit", "torque / limit")
    if name == "sds":
        return _damped_loop()
    figure, (axis,) = _figure(1)
    rate = np.linspace(-3.0, 3.0, 601)
    if name == "viscous":
        axis.plot(rate, rate, color=COLORS[0])
        _label(axis, "rolling rate [rad/s]", "torque against rolling / (A R F) [rad/s]")
        return _svg(figure)
    # rate in units of mu_r R F 8 dt / I, at which the viscous torque equals the limit
    axis.plot(rate, np.sign(rate) * np.minimum(1.0, np.abs(rate)), color=COLORS[0])
    _label(axis, f"rolling rate / (limit x dt / ({STOPPED_SHARE:g} I))", "torque against rolling / limit")
    return _svg(figure)


def _damped_loop() -> str:
    """Torque of SDS over two cycles of rolling with a period of twelve natural periods, in units of the
    limit."""
    figure, (axis,) = _figure(1)
    time, step = np.linspace(0.0, 24.0 * math.tau, 4001, retstep=True)
    angle = 2.0 * np.sin(time / 12.0)
    law = Sds(False)
    contact = SimpleNamespace(
        stiffness=1.0, stiffness_ratio=1.0, radius_eff=1.0, inertia_eff=1.0, normal_load=1.0, time_step=step,
        normal=np.array([0.0, 0.0, 1.0]), normal_half=np.array([0.0, 0.0, 1.0]), turn=0.0,
        constants=SimpleNamespace(rolling_friction=1.0, rolling_damping=0.3),
    )  # fmt: skip
    torques: list[float] = []
    history: Mapping[str, Any] = {"angle": np.zeros(3)}
    for rate in np.diff(angle, prepend=0.0) / step:
        contact.history = SimpleNamespace(**history)
        contact.rolling_rate = np.array([rate, 0.0, 0.0])
        torque, history = law.reference(contact)
        torques.append(-torque[0])
    axis.plot(angle, torques, color=COLORS[0])
    _label(axis, "rolling angle / angle at the limit", "torque / limit")
    return _svg(figure)


def _cohesion(name: str) -> str:
    """Hertz force minus attraction while a soft sphere is pulled from a wall."""
    figure, (axis,) = _figure(1)
    material = PairMaterial(MODULUS, 0.3 * MODULUS, 1.0, properties=ADHESION)
    model = registry.models("cohesion")[name]
    options = model.options(**OPTIONS.get(name, {}))
    law: Any = model.law.from_scene(ModelRequest(options, (material,), 1.0, 0.5, radius_eff_max=RADIUS))
    constants = SimpleNamespace(**dict(zip(law.constant_names, law.pair_constants(material), strict=True)))
    overlap = np.linspace(max(1e-6, 0.2 * law.range), -1.1 * law.range, 2000)
    starts: list[tuple[str, dict[str, float]]] = [("", {})]
    if law.transfers_liquid:
        starts = [(f"bridge of {volume * 1e15:g} pl", {"bridge_volume": volume}) for volume in BRIDGE_VOLUMES]
    for color, (label, start) in zip(COLORS, starts, strict=False):
        force = _pulled_force(law, constants, overlap, start)
        axis.plot(overlap * 1e6, force * 1e6, color=color, label=label)
    if law.transfers_liquid:
        axis.legend(frameon=False, labelcolor=GRAY, fontsize=9)
    axis.axhline(0.0, color=GRAY, lw=0.6)
    _label(axis, "overlap [um]", "repulsive force [uN]")
    return _svg(figure)


def _pulled_force(
    law: Any, constants: SimpleNamespace, overlap: np.ndarray, start: Mapping[str, Any]
) -> np.ndarray:
    """Hertz force minus attraction (n,) [N] along overlaps (n,) [m], from a history at the start."""
    force: list[float] = []
    history = start
    for distance in overlap:
        contact = ContactState(constants, RADIUS, 1.0, 1.0, float(distance), 0.0, SimpleNamespace(**history))
        attraction, history = law.reference(contact)
        force.append(theory.hertz_stiffness(MODULUS, RADIUS) * max(distance, 0.0) ** 1.5 - attraction)
    return np.array(force)


def _sjkr() -> str:
    """Hertz force minus the SJKR attraction versus overlap."""
    figure, (axis,) = _figure(1)
    radius = 0.5e-3
    modulus = 5e6 / (2.0 * (1.0 - 0.2**2))
    overlap = np.linspace(0.0, 20e-6, 200)
    hertz = theory.hertz_stiffness(modulus, radius) * overlap**1.5
    for color, density in zip(COLORS, (0.0, 5e4, 1e5), strict=True):
        attraction = 2.0 * math.pi * density * radius * overlap
        axis.plot(overlap * 1e6, (hertz - attraction) * 1e3, color=color, label=f"{density:g} J/m3")
    axis.axhline(0.0, color=GRAY, lw=0.6)
    axis.legend(frameon=False, labelcolor=GRAY, fontsize=9)
    _label(axis, "overlap [um]", "repulsive force [mN]")
    return _svg(figure)


def _conductance() -> str:
    """Conductance 2 k a of a Hertz contact versus force, for the true modulus and a softened one."""
    figure, (axis,) = _figure(1)
    radius, conductivity = 0.5 * 0.005, 50.0
    force = np.geomspace(1e-3, 1.0, 100)
    for color, modulus in zip(COLORS, (200e9, 200e6, 5e6), strict=True):
        effective = modulus / (2.0 * (1.0 - 0.3**2))
        contact_radius = (3.0 * force * radius / (4.0 * effective)) ** (1.0 / 3.0)
        label = f"E = {modulus / 1e6:g} MPa"
        axis.plot(force, 2.0 * conductivity * contact_radius, color=color, label=label)
    axis.set_xscale("log")
    axis.set_yscale("log")
    axis.legend(frameon=False, labelcolor=GRAY, fontsize=9)
    _label(axis, "normal force [N]", "conductance [W/K]")
    return _svg(figure)


def _figure(panels: int) -> tuple[Any, Any]:
    """Figure without background, with gray axes."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(4.4 * panels, 3.1), layout="constrained")
    axes = [figure.add_subplot(1, panels, index + 1) for index in range(panels)]
    for axis in axes:
        axis.patch.set_alpha(0.0)
        axis.tick_params(colors=GRAY)
        axis.grid(color=GRAY, alpha=0.25, lw=0.6)
        for spine in axis.spines.values():
            spine.set_color(GRAY)
    return figure, axes


def _label(axis: Any, x: str, y: str) -> None:
    axis.set_xlabel(x, color=GRAY)
    axis.set_ylabel(y, color=GRAY)


def _svg(figure: Any) -> str:
    """SVG text of a figure with a transparent background."""
    buffer = io.StringIO()
    figure.savefig(buffer, format="svg", transparent=True, metadata={"Date": None})
    return buffer.getvalue()
