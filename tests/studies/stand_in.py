"""Replaces `granflow run` and `granflow resume` in tests: known results after a short time.

The kinetic energy is restitution + friction, the elastic energy is their product, the gravitational energy
is friction + 0.1 seed with the seed 1 of the scene. A friction of 0.4 is
aborted. While there is a file `wait` in the directory of the sweep, and as many runs have results as it
states (0 without a number), the run lasts until it is stopped, and then has a checkpoint, from which it is
resumed. Each start is a line of `starts.txt`.
"""

import json
import signal
import sys
import time
from pathlib import Path

EXPECTED = 1.0


def settings(arguments):
    """Values of the overrides by the last key."""
    given = [text.partition("=")[2].partition("=") for text in arguments if text.startswith("--set=")]
    return {key.rpartition(".")[2]: json.loads(value) for key, _, value in given}


def run(arguments):
    verb = arguments[0]
    directory = Path(arguments[1] if verb == "resume" else arguments[arguments.index("--out") + 1])
    checkpoint = directory / "checkpoint_1.npz"
    stopped = []
    signal.signal(signal.SIGTERM, lambda *_: stopped.append(True))  # before the test can know of the start
    with (directory.parent.parent / "starts.txt").open("a") as file:
        file.write(f"{verb} {directory.name}\n")
    values = json.loads(checkpoint.read_text()) if verb == "resume" else settings(arguments)
    if values["friction"] == 0.4:
        print(f"granflow: Stopped: overlap above the limit. State in {directory}.", file=sys.stderr)
        return 3
    while has_to_wait(directory.parent):
        if stopped:
            checkpoint.write_text(json.dumps(values))
            return 143
        time.sleep(0.02)
    energy = values["restitution"] + values["friction"]
    sentence = f"kinetic_energy is {energy:g}, but should be below {EXPECTED:g}."
    totals = {
        "kinetic_energy": energy, "rotational_energy": None,
        "elastic_energy": values["restitution"] * values["friction"],
        "gravitational_energy": values["friction"] + 0.1 * values.get("seed", 1),
    }  # fmt: skip
    result = {
        "run": {"wall_clock": time.perf_counter()}, "totals": totals,
        "expect": [{"sentence": sentence, "met": energy < EXPECTED}], "warnings": ["A wall has moved away."],
    }  # fmt: skip
    (directory / "result.json").write_text(json.dumps(result))
    return 0 if energy < EXPECTED else 1


def has_to_wait(runs):
    """Whether the file `wait` exists and its number of results is reached."""
    try:
        count = int((runs.parent / "wait").read_text() or 0)
    except FileNotFoundError:
        return False
    return len(list(runs.glob("*/result.json"))) >= count


if __name__ == "__main__":
    sys.exit(run(sys.argv[1:]))
