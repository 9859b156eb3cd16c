"""A short start: without work of Python that a start does not need."""

import gc
import os
from collections.abc import Iterator
from contextlib import contextmanager
from threading import Timer

PAUSE = 5.0
"""Time [s] without garbage collection after a start: the first collections examine all objects of the start."""


@contextmanager
def quick_start() -> Iterator[None]:
    """In the block, no garbage collection, and no search for pydantic plugins in all installed packages.

    Nearly all objects of a start remain in use, so that some 400 collections, a tenth of its time, find little. The
    collection begins PAUSE after the block.
    """
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "1")
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_enabled:
            timer = Timer(PAUSE, gc.enable)
            timer.daemon = True
            timer.start()
