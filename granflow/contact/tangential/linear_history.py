"""Tangential model: linear spring of given stiffness with history, limited by Coulomb friction."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated

from pydantic import Field

from granflow.contact.law import ContactModel, ModelRequest, Options, SlidingFriction, SurfaceState
from granflow.contact.tangential.mindlin import DampingFactor, DashpotRule, Mindlin
from granflow.device_functions import ti
from granflow.schema.quantities import Number


@dataclass(frozen=True)
class LinearHistory(Mindlin):
    """Elastic-plastic spring of constant stiffness [N/m]; linear_history of LAMMPS."""

    spring_stiffness: float = 0.0

    name = "linear_history"
    source = "Cundall & Strack 1979; Luding 2008, Granular Matter 10:235"
    limits = "the stiffness is the same for all pairs and particle sizes and does not depend on the load"

    @classmethod
    def from_scene(cls, request: ModelRequest) -> "LinearHistory":
        """The law that a scene requests."""
        options = request.options
        return cls(
            damping=options.damping,
            dashpot_sticks=options.dashpot == "sticking",
            energy_budget=request.energy_budget,
            spring_stiffness=options.stiffness,
        )

    @property
    def parameters(self) -> Mapping[str, float]:
        """The stiffness, and the ratio of the dashpots."""
        return {**super().parameters, "spring_stiffness": self.spring_stiffness}

    @ti.func
    def stiffness(self, constants, contact):
        """Stiffness of the spring [N/m]."""
        return constants.spring_stiffness

    @ti.func
    def stiffness_ratio(self, contact):
        """Ratio of the previous to the present stiffness."""
        return 0.0 * contact.stiffness_ratio + 1.0

    def reference_stiffness(self, contact: SurfaceState) -> tuple[float, float]:
        """Reference implementation of `stiffness` and `stiffness_ratio`."""
        return self.spring_stiffness, 1.0


class LinearHistoryOptions(Options):
    """Options of the model."""

    stiffness: Annotated[float, Number("stiffness", above=0)] = Field(
        description="tangential stiffness [N/m], for all pairs and particle sizes", examples=["1e4 N/m"]
    )
    damping: DampingFactor = 0.0
    dashpot: DashpotRule = "limited"


MODEL = ContactModel(
    LinearHistory,
    "linear spring of given stiffness with history, Coulomb limit",
    options=LinearHistoryOptions,
    pair_properties=SlidingFriction,
)
