"""Reads the frames of a run: PVD files with times, and VTU files."""

import math
import re
from collections.abc import Sequence
from pathlib import Path
from xml.parsers.expat import ExpatError

from granflow.errors import GranflowError
from granflow.io.pvtu import SUFFIX, pieces_in, read_pvtu
from granflow.io.regular_files import FormatError, open_regular, read_regular
from granflow.io.vtu import VtuMesh, read_vtu, xml_of

SAME_TIME = 1e-9
"""Relative tolerance of times for frames of particles, walls and contacts that belong together."""

HEADER_SIZE, EMPTY = 1000, b'NumberOfPoints="0"'
"""Text near the beginning of an empty VTU file."""


LARGEST_FRAME = 2**32
"""Maximum size of all arrays of one frame in bytes."""


def require_directory(directory: Path) -> None:
    """Raise GranflowError if the directory of a run does not exist."""
    if not directory.is_dir():
        raise GranflowError(
            f"{directory}: there is no such directory; give the directory of a run, such as out/hopper."
        )


def listed_frames(directory: Path, stem: str) -> list[tuple[float, Path]]:
    """Times [s] and existing files of a PVD file; empty if it does not exist.

    Raises GranflowError if it is damaged, or lists files other than the frames of its series in its directory.
    """
    listing = directory / f"{stem}.pvd"
    if not listing.exists():
        return []
    try:
        rows = xml_of(read_regular(listing)).iter("DataSet")
        found = [(float(row.attrib["timestep"]), row.attrib["file"]) for row in rows]
    except KeyError as error:
        raise _damaged_listing(listing, f"it has an entry without {error}") from None
    except OSError as error:
        raise _damaged_listing(listing, str(error.strerror or error)) from None
    except (FormatError, ExpatError, ValueError) as error:
        raise _damaged_listing(listing, str(error)) from None
    for time, name in found:
        if not re.fullmatch(rf"{re.escape(stem)}_\d{{4,9}}\.p?vtu", name):
            raise _damaged_listing(listing, f"it lists {name[:80]!r}, but a frame is named like {stem}_0000.vtu")
        if not math.isfinite(time):
            raise _damaged_listing(listing, f"the time of {name} is {time}")
    return [(time, directory / name) for time, name in found if (directory / name).exists()]


def _damaged_listing(listing: Path, reason: str) -> GranflowError:
    return GranflowError(f"{listing} cannot be read ({reason}); write it again with granflow run or resume.")


def frame_at(series: Sequence[tuple[float, Path]], time: float) -> tuple[float, Path] | None:
    """Time [s] and file of the frame nearest to a time [s]; None if no frame is at that time."""
    near = min(series, key=lambda each: abs(each[0] - time), default=None)
    return near if near and abs(near[0] - time) <= SAME_TIME * max(abs(time), 1.0) else None


def frame_near(series: Sequence[tuple[float, Path]], time: float) -> tuple[float, Path] | None:
    """Time [s] and file of the frame nearest to a time [s], at most half of the distance to its next frame away.

    The distance is that to the neighbor on the side of `time`, of the other side for the first and last frame; a single
    frame must be at that time. None if there is none.
    """
    near = min(range(len(series)), key=lambda index: abs(series[index][0] - time), default=None)
    if near is None or len(series) == 1:
        return frame_at(series, time)
    side = near + 1 if time > series[near][0] else near - 1
    other = side if 0 <= side < len(series) else 2 * near - side
    interval = abs(series[other][0] - series[near][0])
    return series[near] if abs(series[near][0] - time) <= 0.5 * interval * (1.0 + SAME_TIME) else None


def file_at(series: Sequence[tuple[float, Path]], time: float) -> Path | None:
    """File of the given time [s] in another series of the same run."""
    found = frame_at(series, time)
    return found[1] if found else None


def is_empty(path: Path) -> bool:
    """Whether a VTU file is empty, or all pieces of a PVTU file."""
    if path.suffix == SUFFIX:
        return all(map(is_empty, filter(Path.exists, _pieces(path))))
    with open_regular(path) as file:
        return EMPTY in file.read(HEADER_SIZE)


def _pieces(path: Path) -> list[Path]:
    """Files of a PVTU file. Raises GranflowError if it cannot be read."""
    try:
        return pieces_in(path)
    except (FormatError, OSError) as error:
        raise _unreadable(path, error) from None


def _unreadable(path: Path, error: Exception) -> GranflowError:
    return GranflowError(f"{path} cannot be read ({error}); remove this frame, or run again.")


def read_mesh(path: Path) -> VtuMesh:
    """Mesh of a VTU or PVTU file, empty for an empty file. Raises GranflowError if it cannot be read."""
    try:
        return (read_pvtu if path.suffix == SUFFIX else read_vtu)(path, LARGEST_FRAME)
    except (FormatError, OSError) as error:
        raise _unreadable(path, error) from None
