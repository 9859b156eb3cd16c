"""Copies of the moving state of particles between the device and message buffers of MPI ranks."""

from typing import Any

from granflow.engine.host_fields import components
from granflow.engine.state import State
from granflow.kernel_language import ti

REBUILD, ABORT, PARTICLE, STOP, FLAGS = range(5)
"""Flags of a rank: rebuild requested, abort code, minus the id of the abort, stop requested; and their number."""


class GhostKernels:
    """Kernels that pack owned particles and unpack ghosts.

    width:   number of values of one particle: position, velocity, angular velocity and synchronized velocity, as far as
             the scene has them
    pack:    (k, entries int32, buffer (, width) float64, flags (FLAGS,) int32): copy k particles, and the flags
    unpack:  (k, first, buffer (, width)): copy to k particles from index `first`

    Arrays have at least one row, because Taichi refuses none. The values are exact in float64 for all precisions. One
    serial loop: waking the threads takes longer.
    """

    def __init__(self, state: State) -> None:
        particles, control = state.particles, state.control
        vectors = (
            particles.position,
            particles.velocity,
            particles.angular_velocity,
            particles.velocity_synchronized,
        )
        fields = [component for field in vectors if field is not None for component in components(field)]
        self.width = len(fields)
        external: Any = ti.types.ndarray()

        @ti.kernel
        def pack(count: ti.i32, entries: external, buffer: external, flags: external):
            ti.loop_config(serialize=True)
            for k in range(count):
                for c in ti.static(range(len(fields))):
                    buffer[k, c] = ti.cast(fields[c][entries[k]], ti.f64)
            flags[REBUILD], flags[ABORT] = control.rebuild_requested[0], control.abort[0]
            flags[PARTICLE] = -control.abort_particle[0]

        @ti.kernel
        def unpack(count: ti.i32, first: ti.i32, buffer: external):
            ti.loop_config(serialize=True)
            for k in range(count):
                for c in ti.static(range(len(fields))):
                    fields[c][first + k] = ti.cast(buffer[k, c], fields[c].dtype)

        self.pack, self.unpack = pack, unpack
