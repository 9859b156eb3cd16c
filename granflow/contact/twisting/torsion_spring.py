"""Torsion spring, dashpot and limit with given numbers; `twisting sds` of LAMMPS."""

from collections.abc import Mapping
from dataclasses import dataclass

from granflow.contact.law import Amount, ContactModel, ModelRequest, PairOption, SurfaceState
from granflow.contact.twisting.torsion import TorsionLaw
from granflow.device_functions import ti


@dataclass(frozen=True)
class TorsionSpring(TorsionLaw):
    """Spring k [N m/rad] and dashpot c [N m s] of the scene; limit mu_t F_n, mu_t [m] of the pair."""

    torsion_stiffness: float
    torsion_damping: float

    name = "torsion_spring"
    source = "Luding 2008, Granular Matter 10:235"
    limits = "stiffness and dashpot are the same for all pairs and particle sizes"
    constant_names = ("twisting_friction",)

    @classmethod
    def from_scene(cls, request: ModelRequest) -> "TorsionSpring":
        """The law that a scene requests."""
        stiffness = request.options["stiffness"]
        damping = request.options["damping"]
        return cls(damping > 0.0, request.energy_budget, stiffness, damping)

    @property
    def parameters(self) -> Mapping[str, float]:
        """Stiffness and dashpot coefficient."""
        damping = {"torsion_damping": self.torsion_damping} if self.dashpot else {}
        return {"torsion_stiffness": self.torsion_stiffness} | damping

    @ti.func
    def torsion(self, constants, contact):
        """Stiffness [N m/rad], dashpot coefficient [N m s] and limit [N m]."""
        coefficient = 0.0 * contact.overlap
        if ti.static(self.dashpot):
            coefficient += constants.torsion_damping
        return constants.torsion_stiffness, coefficient, constants.twisting_friction * contact.normal_load

    def reference_torsion(self, contact: SurfaceState) -> tuple[float, float, float]:
        """Reference implementation of `torsion`."""
        limit = contact.constants.twisting_friction * contact.normal_load
        return self.torsion_stiffness, self.torsion_damping, limit


MODEL = ContactModel(
    TorsionSpring,
    "torsion spring and dashpot with a limit",
    options={
        "stiffness": Amount(
            "twisting stiffness [Nm/rad]", "1 mNm/rad", "torsion_stiffness", "a twisting stiffness", above=0
        ),
        "damping": Amount(
            "twisting dashpot [Nms]",
            "1 uNms",
            "torsion_damping",
            "a twisting dashpot",
            at_least=0,
            default=0.0,
        ),
    },
    pair_options=(
        PairOption(
            "twisting_friction",
            Amount(
                "largest twisting torque over the normal force [m]", "10 um", "length", "a length", at_least=0
            ),
            "give the length, or 0 to disable twisting friction",
        ),
    ),
    example={"stiffness": 1e-3},
)
