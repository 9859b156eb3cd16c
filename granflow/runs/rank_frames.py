"""Frames of the particles in one file for each MPI rank: `output.frames_per_rank`."""

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import numpy as np

from granflow.engine.engine import Engine
from granflow.engine.state import OneProcess
from granflow.io.frames import Piece, WritePieces, piece_path
from granflow.io.vtu import write_vtu
from granflow.observers.frames import particle_mesh


def write_pieces(engine: Engine) -> Callable[[float | None], WritePieces] | None:
    """Function of the largest absolute coordinate [m] or None, see `ParticleFrames`; None without ranks.

    What it returns lets each rank write its particles, given the directory and the name of the frame without
    suffix; it returns the pieces, and raises OSError.
    """
    if isinstance(engine.state.ranks, OneProcess):
        return None

    def write(reach: float | None, directory: Path, frame: str) -> Sequence[Piece]:
        return engine.on_each_rank(
            partial(_write_piece, directory=directory.absolute(), frame=frame, reach=reach)
        )

    return lambda reach: partial(write, reach)


def _write_piece(engine: Engine, rank: int, directory: Path, frame: str, reach: float | None) -> Piece:
    """Write the particles of this rank."""
    particles = engine.own_particles()
    ranks = engine.state.ranks
    radius_min = -ranks.largest(-particles["radius"].min(initial=np.inf))
    if reach is None:
        reach = ranks.largest(np.abs(particles["position"]).max(initial=0.0))
    mesh = particle_mesh(particles, reach, radius_min)
    path = piece_path(directory, frame, rank)
    write_vtu(path, mesh, engine.plan.output.compression)
    return Piece.of(path.name, mesh)
