"""The memory limit of the process (`ulimit -v`), below which libraries do not end."""

from granflow.errors import GranflowError

LEAST = 512 * 2**20
"""Smallest limit [bytes]. OpenBLAS, which numpy calls, repeats a failed allocation forever; a run needs 2 GB."""


def refuse_low_memory_limit() -> None:
    """Raise GranflowError if the address space of this process is limited to less than LEAST."""
    try:
        import resource
    except ImportError:  # not on Windows
        return
    limit = resource.getrlimit(resource.RLIMIT_AS)[0]
    if limit != resource.RLIM_INFINITY and limit < LEAST:
        raise GranflowError(
            f"the memory limit of the process (ulimit -v) is {limit // 2**20} MiB, but granflow needs at least "
            f"{LEAST // 2**20} MiB to start, and a run at least 2 GB: raise or remove the limit."
        )
