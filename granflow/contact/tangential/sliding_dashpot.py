"""Tangential model: a dashpot without a spring, limited by Coulomb friction."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

import numpy as np
from pydantic import Field

from granflow.contact.law import (
    ContactModel,
    HistoryField,
    ModelRequest,
    Options,
    SlidingFriction,
    SurfaceState,
    TangentialLaw,
)
from granflow.contact.tangential.spring import limit_ratio
from granflow.device_functions import ti
from granflow.schema.quantities import Number


@dataclass(frozen=True)
class SlidingDashpot(TangentialLaw):
    """A force against the slip velocity, below the Coulomb limit in proportion to it.

    damping:  ratio of the tangential to the normal dashpot
    """

    damping: float = 1.0

    name = "sliding_dashpot"
    source = "Haff & Werner 1986, Powder Technol. 48:239"
    sticks: ClassVar[bool] = False
    limits = "surfaces creep under any tangential load: heaps and inclined beds do not come to rest"
    constant_names: ClassVar[tuple[str, ...]] = ("friction",)
    history: ClassVar[tuple[HistoryField, ...]] = (
        HistoryField("dashpot", "force of the tangential dashpot", "N", size=3),
    )

    @classmethod
    def from_scene(cls, request: ModelRequest) -> "SlidingDashpot":
        """The law that a scene requests."""
        return cls(request.options.damping)

    @property
    def damped(self) -> bool:
        """The law reads the dashpot of the normal model."""
        return True

    @property
    def parameters(self) -> Mapping[str, float]:
        """The ratio of the dashpots."""
        return {"damping": self.damping}

    @ti.func
    def limit(self, constants, contact):
        """Coulomb limit [N]."""
        return constants.friction * contact.normal_load

    @ti.func
    def force(self, constants, contact, history):
        """Force of the dashpot [N], F = -eta_t v_t, limited to mu F_n; its work in this step is lost.

        The history is the force of the step, for contact output.
        """
        trial = -constants.damping * contact.normal_damping * contact.slip_rate
        force = limit_ratio(trial, self.limit(constants, contact)) * trial
        history_new = history
        history_new.dashpot = force
        return force, history_new, -0.5 * (history.dashpot + force).dot(contact.slip)

    def reference(self, contact: SurfaceState) -> tuple[np.ndarray, Mapping[str, Any]]:
        """Reference implementation of `force` in numpy."""
        force = -self.damping * contact.normal_damping * contact.slip_rate
        size = float(np.sqrt(force @ force))
        limit = contact.constants.friction * contact.normal_load
        force = force * (limit / size) if size > limit else force
        return force, {"dashpot": force}

    @ti.func
    def present_force(self, constants, contact, history):
        """Force of the dashpot [N] and its size [N]."""
        force = history.dashpot
        return force, ti.sqrt(force.dot(force))


class SlidingDashpotOptions(Options):
    """Options of the model."""

    damping: Annotated[float, Number(noun="a damping factor", above=0)] = Field(
        description="tangential dashpot over the dashpot of the normal model", examples=["1"]
    )


MODEL = ContactModel(
    SlidingDashpot,
    "dashpot without a spring, Coulomb limit",
    options=SlidingDashpotOptions,
    pair_properties=SlidingFriction,
)
