"""Schema of the blocks `run` and `numerics`; the only numbers of a scene with defaults are here."""

from typing import Annotated, Literal

from pydantic import Field

from granflow.scene.schema import quantities as q
from granflow.scene.schema.fields import Model
from granflow.scene.schema.numbers import Number

LARGEST_OVERLAP = 0.8
"""Largest overlap limit: with larger overlaps a center could cross a thin wall in one step (`granflow.plan.travel`)."""

LARGEST_CHUNK = 1_000_000
"""Largest chunk size: larger chunks leave threads idle, and particle counts rounded up to chunks have 32 bits."""

LARGEST_ANGLE = 0.9
"""Largest unloading angle; stability of a dense bed requires 4 theta^2 < 4 (`granflow.plan.time_step.stable_step`)."""

TIME_STEP_FRACTION = 0.05
"""Default of `time_step_fraction`: 40 steps per collision of an elastic contact. The restitution is then within 0.3 %
of the given one for every contact model and every restitution from 0.5 up, with dashpots within 1.4 % at 0.05. Large
scenes use up to 0.3 where a few tenths of a percent are enough: table in the documentation, Accuracy."""

Fraction = Annotated[float, Number(noun="a fraction", above=0, at_most=1)]
OverlapLimit = Annotated[float, Number(noun="an overlap limit", above=0, at_most=LARGEST_OVERLAP)]
UnloadingAngle = Annotated[float, Number(noun="an angle", above=0, at_most=LARGEST_ANGLE)]
TimeStep = Annotated[float | Literal["auto", "adaptive"], Number("time", above=0, words=("auto", "adaptive"))]
ChunkSize = Annotated[
    int | Literal["auto"],
    Number(noun="a chunk size", at_least=1, at_most=LARGEST_CHUNK, whole=True, words=("auto",)),
]

Precision = Literal["f64", "f32", "mixed"]
"""Floating-point precision of a run."""


class RunSettings(Model):
    """Duration, time step and precision of a run.

    An automatic time step follows from the stiffest contact at `velocity_max`, with the fractions in `numerics`.

    >>> gf.RunSettings(duration="50 ms", precision="mixed")
    RunSettings(duration=0.05, precision='mixed')
    """

    duration: q.PositiveTime | None = Field(None, description="simulated time [s]; only without stages")
    time_step: TimeStep = Field(
        "auto",
        description="time step [s]; auto: for the stiffest possible contact; adaptive: for the stiffest current one",
    )
    velocity_max: q.Speed | None = Field(
        None, description="largest expected impact velocity [m/s]; default: estimate from drop heights and speeds"
    )
    precision: Precision = Field(
        "f64", description="floating-point precision: f64, f32, or mixed (positions in f64, all else in f32)"
    )


class Numerics(Model):
    """Numerical parameters, all with defaults.

    They limit numerical errors and do not represent physical properties.

    >>> gf.Numerics(time_step_fraction=0.1)
    Numerics(time_step_fraction=0.1)
    """

    time_step_fraction: Fraction = Field(
        TIME_STEP_FRACTION,
        description="largest time step over the shortest loading or unloading time; with the default the restitution "
        "is within 0.02 % for zhou, for viscous models within 0.3 % from 0.5 on and 1.4 % at 0.05; 0.2 is within "
        "0.3 % for zhou, 0.1 within 1 % for viscous models from 0.5 on",
    )
    rayleigh_fraction: Fraction = Field(0.2, description="largest time step over the Rayleigh time")
    skin: q.AutoLength = Field("auto", description="skin of the neighbor list [m], or auto")
    chunk_size: ChunkSize = Field("auto", description="particles per chunk of the neighbor list, or auto")
    max_overlap: OverlapLimit = Field(0.1, description="overlap over radius above which the run is aborted")
    unloading_angle: UnloadingAngle = Field(
        0.5, description="theta in the bound theta^2 M/dt^2 on the unloading tangent (restitution near 0)"
    )
