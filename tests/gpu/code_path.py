"""The code path of a GPU, on the CPU."""

from dataclasses import replace

from granflow.engine.backend import Backend
from granflow.engine.fields import FieldBlock

LARGEST_BUFFER = 2**18
"""Bytes; the fields of each scene are in several trees."""
_prepare = FieldBlock.__init__


def use_gpu_code_path():
    """Each chunk is a task of its own, the host reads flags by kernels, and a tree has at most
    LARGEST_BUFFER; for the rest of this process."""
    Backend.on_cpu = property(lambda self: False)

    def prepare_with_limit(block, started):
        _prepare(block, replace(started, largest_buffer=LARGEST_BUFFER))

    FieldBlock.__init__ = prepare_with_limit
