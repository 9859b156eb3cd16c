"""Runs the command line of granflow in a process that is killed at its n-th write, or whose clock jumps.

    python fault_injection.py kill N VERB ...      SIGKILL before write number N, a row of the time series
                                                   half written
    python fault_injection.py count - VERB ...     print the number of writes to stderr
    python fault_injection.py clock - VERB ...     the system time jumps by hours at every query

Writes are fsync, rename, truncation and deletion of files, and each part of the time series or of a PVD file.
"""

import itertools
import os
import pathlib
import signal
import sys
import time

from granflow.io import frames, tables

write_count = 0


def counted(function, fatal_write):
    def write(*arguments, **options):
        global write_count
        write_count += 1
        if write_count == fatal_write:
            os.kill(os.getpid(), signal.SIGKILL)
        return function(*arguments, **options)

    return write


def count_writes(fatal_write):
    for name in ("replace", "fsync", "truncate"):
        setattr(os, name, counted(getattr(os, name), fatal_write))
    pathlib.Path.unlink = counted(pathlib.Path.unlink, fatal_write)

    class PartialWrites(tables.FileIO):
        """Writes half of the data, as after a signal or on a full disk; the caller must write the rest."""

        def write(self, data):
            return counted(super().write, fatal_write)(data[: max(len(data) // 2, 1)])

    tables.FileIO = frames.FileIO = PartialWrites


if __name__ == "__main__":
    from granflow.cli.main import main

    fault, number, *arguments = sys.argv[1:]
    if fault == "clock":
        jumps = itertools.cycle([3600.0, -7200.0, 86400.0, -1.7e9])
        system_time = time.time
        time.time = lambda: system_time() + next(jumps)
    else:
        count_writes(int(number) if fault == "kill" else 0)
    code = main(arguments)
    if fault == "count":
        print(f"writes: {write_count}", file=sys.stderr)
    sys.exit(code)
