"""The decisions of a plan: what follows from the scene before any array is allocated."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from granflow.contact.laws import ContactLaws
from granflow.contact.material import PairMaterial, Solid
from granflow.geometry.periodic_box import PeriodicBox
from granflow.plan.adaptive_time_step import AdaptiveTimeStep
from granflow.plan.damping import PlannedDamping
from granflow.plan.external_forces import ExternalForce
from granflow.plan.feature_reasons import Reason
from granflow.plan.features import Features
from granflow.plan.forecast.forecast import Forecast
from granflow.plan.max_impact_velocity import ImpactVelocity
from granflow.plan.meshes import MeshNote
from granflow.plan.outlets import PlannedOutlet
from granflow.plan.scene_parts import PlannedGroup, PlannedStage
from granflow.plan.settings import OptionalSetting
from granflow.plan.sum_units import SumUnits
from granflow.plan.time_step import PairCase, TimeStep
from granflow.plan.wall_control import ControlledMotion
from granflow.plan.walls import PlannedWall
from granflow.scene.schema.domain import Domain
from granflow.scene.schema.expect import Expectation
from granflow.scene.schema.output import Output
from granflow.scene.schema.run import Precision


@dataclass(frozen=True, eq=False)
class Decisions:
    """All decisions for one scene, in SI units; the functions that compute them document the reasons.

    Lengths [m]: `radius_min`, `radius_max`, `skin`. `wall_speed` [m/s]: of prescribed motions. `chunk_size`: particles
    per unit of work of a thread.
    """

    title: str
    path: str
    """Path of the scene file; empty for a scene from Python."""
    remarks: tuple[str, ...]
    """Sentences on changes to the scene as written."""
    settings: tuple[OptionalSetting, ...]
    sources: Mapping[str, str]
    """Positions in the scene file for messages, by key: steps, domain.on_exit, given numerics."""
    precision: Precision
    domain: Domain
    periodic_box: PeriodicBox
    output: Output
    flow_meter_parts: Mapping[str, tuple[str, ...]]
    """Names of the materials or groups with separate counts, by name of the flow meter."""
    expectations: tuple[Expectation, ...]
    gravity: tuple[float, float, float]
    """Gravity [m/s2]."""
    max_overlap: float
    """Overlap over radius above which the run aborts."""
    features: Features
    reasons: tuple[Reason, ...]
    stages: tuple[PlannedStage, ...]
    damping: PlannedDamping | None
    """Damping of all motion, for settling."""
    groups: tuple[PlannedGroup, ...]
    size_classes: tuple[float, ...]
    """Largest radius [m] of each size class, in ascending order."""
    solids: Mapping[str, Solid]
    """Constants of all materials of the scene by name, in its order, to which `ParticleData.material` refers."""
    laws: ContactLaws
    materials: tuple[str, ...]
    """Names of the materials in plan order, those of particles first."""
    pair_materials: Mapping[tuple[str, str], PairMaterial]
    """Constants of each two materials that can come into contact, by their names in either order."""
    pair_constants: np.ndarray
    """(materials^2, constants): constants of the contact laws, in the order of `laws.constant_names`."""
    pair_cases: tuple[PairCase, ...]
    """The possible contacts."""
    particle_capacity: int
    radius_min: float
    radius_max: float
    chunk_size: int
    skin: float
    step: TimeStep
    impact_velocity: ImpactVelocity
    walls: tuple[PlannedWall, ...]
    wall_joints: tuple[int, ...]
    """For each wall, whether it touches others or itself; see `joined_walls.joints_of`."""
    measured_walls: tuple[str, ...]
    """Names of the walls with measured forces."""
    mesh_notes: tuple[MeshNote, ...]
    wall_speed: float
    controlled_motions: tuple[ControlledMotion, ...]
    """Motions of walls that respond to the forces of the particles."""
    outlets: tuple[PlannedOutlet, ...]
    adaptive_time_step: AdaptiveTimeStep | None
    """Time steps by impact velocity if the time step is adaptive."""
    forecasts: tuple[Forecast, ...] = ()
    """Overlaps to expect, and probable mistakes that end a run or make it pointless."""
    external_forces: tuple[ExternalForce, ...] = ()
    """Forces that a program has added; none follow from the scene."""
    saved_sum_units: SumUnits | None = None
    """Units of the sums of the run that a checkpoint continues, in which it has saved them; None for a new run."""
    has_ghosts: bool = False
    """Whether the run is one of several MPI ranks: its neighbor lists contain ghosts, see `plan.ranks`."""
