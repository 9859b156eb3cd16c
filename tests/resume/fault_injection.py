"""granflow's command line in a process that is killed at its n-th write, or whose clock is set while it runs.

    python fault_injection.py kill N VERB ...      SIGKILL before write number N, a row of the time series half written
    python fault_injection.py count - VERB ...     print to stderr how many writes there are
    python fault_injection.py clock - VERB ...     the computer's time jumps to and fro by hours at every look

Writes are: a file brought to the disk, a file given its name, a file removed or cut, a piece of the time series or of a
PVD file.
"""

import itertools
import os
import pathlib
import signal
import sys
import time

from granflow.observe import frames, timeseries

count = itertools.count(1)
done = 0


def counted(function, last):
    def write(*arguments, **options):
        global done
        done = next(count)
        if done == last:
            os.kill(os.getpid(), signal.SIGKILL)
        return function(*arguments, **options)

    return write


def watch_writes(last):
    for name in ("replace", "fsync", "truncate"):
        setattr(os, name, counted(getattr(os, name), last))
    pathlib.Path.unlink = counted(pathlib.Path.unlink, last)

    class Halves(timeseries.FileIO):
        """Writes half of what it is given, as a full disk or a signal may make it do; the writer must ask again."""

        def write(self, data):
            return counted(super().write, last)(data[: max(len(data) // 2, 1)])

    timeseries.FileIO = frames.FileIO = Halves


def set_clock():
    jumps = itertools.cycle([3600.0, -7200.0, 86400.0, -1.7e9])
    real = time.time
    time.time = lambda: real() + next(jumps)


if __name__ == "__main__":
    from granflow.cli import main

    fault, number, *arguments = sys.argv[1:]
    if fault == "clock":
        set_clock()
    else:
        watch_writes(int(number) if fault == "kill" else 0)
    code = main(arguments)
    if fault == "count":
        print(f"writes: {done}", file=sys.stderr)
    sys.exit(code)
