"""Twisting friction of the contact area: stiffness and limit from the tangential contact (Marshall 2009)."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from granflow.contact.law import ContactModel, ModelRequest, Options, SlidingFriction, SurfaceState
from granflow.contact.tangential.mindlin import DampingFactor
from granflow.contact.twisting.torsion_spring import TorsionLaw
from granflow.device_functions import ti


@dataclass(frozen=True)
class Marshall(TorsionLaw):
    """Contact area of radius a = sqrt(R d), with the tangential spring and friction per area.

        k = K_t a^2 / 2,   c = eta_t a^2 / 2,   T_max = 2/3 mu a F_n

    damping:  eta_t over the dashpot coefficient of the normal model
    """

    damping: float

    name = "marshall"
    source = "Marshall 2009, J. Comput. Phys. 228:1541, doi 10.1016/j.jcp.2008.10.020"
    limits = "uniform pressure on the contact area; the area of a soft material grows with the overlap"
    constant_names: ClassVar[tuple[str, ...]] = ("friction",)

    @classmethod
    def from_scene(cls, request: ModelRequest) -> "Marshall":
        """The law that a scene requests."""
        damping = request.options.damping
        return cls(damping > 0.0, request.energy_budget, damping)

    @property
    def damped(self) -> bool:
        """Whether `torque` reads `normal_damping`."""
        return self.dashpot

    @property
    def parameters(self) -> Mapping[str, float]:
        """The ratio of the dashpots."""
        return {"damping": self.damping} if self.dashpot else {}

    @ti.func
    def torsion(self, constants, contact):
        """Stiffness [N m/rad], dashpot coefficient [N m s] and limit [N m]."""
        square = contact.radius_eff * contact.overlap
        coefficient = 0.0 * square
        if ti.static(self.dashpot):
            coefficient = 0.5 * constants.damping * contact.normal_damping * square
        limit = 2.0 / 3.0 * constants.friction * ti.sqrt(square) * contact.normal_load
        return 0.5 * contact.stiffness * square, coefficient, limit

    def reference_torsion(self, contact: SurfaceState) -> tuple[float, float, float]:
        """Reference implementation of `torsion`."""
        contact_radius = float((contact.radius_eff * contact.overlap) ** 0.5)
        stiffness = 0.5 * contact.stiffness * contact_radius**2
        coefficient = 0.5 * (self.damping * contact.normal_damping) * contact_radius**2
        limit = contact.constants.friction * contact.normal_load * 2 / 3 * contact_radius
        return stiffness, coefficient, limit


class MarshallOptions(Options):
    """Options of the model."""

    damping: DampingFactor = 0.0


MODEL = ContactModel(
    Marshall,
    "twisting friction of the contact area (Marshall 2009)",
    options=MarshallOptions,
    pair_properties=SlidingFriction,
)
