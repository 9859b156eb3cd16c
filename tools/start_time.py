"""Time from the start of granflow to its first step, with an empty and with a filled kernel cache, by stage.

    python tools/start_time.py                 two particles and a bed of 50 000, each cold and three times
    warm python tools/start_time.py --out FILE.json

Each start is a separate process; each scene has a separate cache folder (GRANFLOW_CACHE). The measured run is
`Simulation.run` to the end of one step, with all files written and closed. Modules are compiled to bytecode
before, as pip does: where the environment prevents that (PYTHONDONTWRITEBYTECODE), each start takes 0.7 s
more.
"""

import argparse
import json
import os
import re
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from benchmark.machine import machine

ROOT = Path(__file__).resolve().parent.parent
SMALL = ROOT / "scenes" / "two_spheres.yaml"
BED = """
title: Bed of 50 000
gravity: [0, 0, -9.81]
materials: {m: {young_modulus: 1e7, poisson_ratio: 0.25, density: 2500}}
pairs: {m-m: {restitution: 0.9, friction: 0.5}}
contact: {normal: zhou, tangential: mindlin, rolling: none}
walls: {floor: {shape: plane, point: [0, 0, 0], normal: [0, 0, 1], material: m}}
particles:
  beads:
    material: m
    count: 50000
    diameter: 4 mm
    insert: {kind: lattice, region: {box: {min: [0, 0, 0], max: [0.2, 0.2, 0.2]}}}
domain: {min: [-1, -1, -1], max: [1, 1, 1], on_exit: delete}
run: {duration: 1 s}
output: {interval: 1 s}
"""
STAGES = ("imports", "reading", "setting up", "compiling", "first step and files")
PACKAGES = ("numpy", "taichi", "pydantic", "ruamel", "meshio", "rich", "granflow")
WARM_STARTS = 3


def child(scene: str, out: str) -> None:
    """Runs a scene to its first step and prints the times at the ends of the stages [s since 1970]."""
    times = [time.time()]
    from granflow.load import load_scene
    from granflow.simulation import Simulation

    times.append(time.time())
    loaded_scene = load_scene(scene)
    times.append(time.time())
    simulation = Simulation(loaded_scene, out=out)
    times.append(time.time())
    simulation.run(until=simulation.plan.time_step)
    times.append(time.time())
    used = resource.getrusage(resource.RUSAGE_SELF)
    answer = {
        "moments": times,
        "compile": simulation.engine.timing.compile,
        "cpu": used.ru_utime + used.ru_stime,
    }
    print(json.dumps(answer))


def start(scene: Path, cache: Path) -> dict[str, Any]:
    """Time [s] of each stage of one start, from the start of the process, and number of compiled kernels."""
    before = kernel_count(cache)
    with tempfile.TemporaryDirectory() as out:
        began = time.time()
        command = [sys.executable, __file__, "--child", str(scene), out]
        environment = os.environ | {"GRANFLOW_CACHE": str(cache)}
        process = subprocess.run(command, env=environment, stdout=subprocess.PIPE, text=True, check=True)
    answer = json.loads(process.stdout.splitlines()[-1])
    entered, imported, loaded, built, finished = answer["moments"]
    compiling = answer["compile"]
    seconds = (imported - began, loaded - imported, built - loaded - compiling, compiling, finished - built)
    return {
        "total": finished - began,
        "cpu": answer["cpu"],
        **dict(zip(STAGES, seconds, strict=True)),
        "kernels_compiled": kernel_count(cache) - before,
        "kernels_in_cache": before,
    }


def kernel_count(cache: Path) -> int:
    """Number of kernels in a cache folder; Taichi writes them at the end of a process."""
    return len(list(cache.glob("*.tic")))


def import_seconds() -> dict[str, float]:
    """Time [s] to import granflow.simulation by package, excluding nested imports of other packages."""
    command = [sys.executable, "-X", "importtime", "-c", "import granflow.simulation"]
    process = subprocess.run(command, capture_output=True, text=True, check=True)
    found = dict.fromkeys((*PACKAGES, "others"), 0.0)
    for microseconds, name in re.findall(r"import time:\s+(\d+) \|\s+\d+ \| +(\S+)", process.stderr):
        package = name.split(".")[0].split("_core")[0]
        found[package if package in PACKAGES else "others"] += 1e-6 * int(microseconds)
    return found


def measure(folder: Path) -> dict[str, Any]:
    """Measures all starts: each scene once cold, then WARM_STARTS times warm."""
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
    os.environ["PYTHONPYCACHEPREFIX"] = str(folder / "bytecode")
    import_seconds()  # writes the bytecode
    bed = folder / "bed.yaml"
    bed.write_text(BED)
    result: dict[str, Any] = {
        "kind": "start",
        "machine": machine(),
        "imports": import_seconds(),
        "starts": [],
    }
    for name, scene in (("two spheres", SMALL), ("50 000 spheres", bed)):
        cache = folder / f"cache of {name}"
        for number in range(1 + WARM_STARTS):
            state = "warm" if number else "cold"
            result["starts"].append({"scene": name, "state": state, **start(scene, cache)})
            print(line(result["starts"][-1]), flush=True)
    return result


def line(found: dict[str, Any]) -> str:
    """One start as a line of text."""
    stages = ", ".join(f"{stage} {found[stage]:.2f}" for stage in STAGES)
    kernels = f"{found['kernels_compiled']} kernels compiled, {found['kernels_in_cache']} in the cache"
    return (
        f"{found['scene']:>14} {found['state']}: {found['total']:.2f} s ({stages}; cpu {found['cpu']:.2f}); "
        f"{kernels}"
    )


def main() -> None:
    """Measures and prints all starts; writes them as JSON if requested."""
    if sys.argv[1:2] == ["--child"]:
        child(*sys.argv[2:4])
        return
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", metavar="FILE", type=Path, help="JSON file of the results")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        result = measure(Path(folder))
    print("imports: " + ", ".join(f"{name} {seconds:.2f} s" for name, seconds in result["imports"].items()))
    if options.out:
        options.out.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
