"""How long granflow takes to its first step: with an empty cache, with a filled one, and where the time goes.

    python tools/start_time.py                 two spheres and a bed of 50 000, each cold and three times warm
    python tools/start_time.py --out FILE.json

Each start is a process of its own with a cache folder of its own (GRANFLOW_CACHE). A run to its first step is
`Simulation.run` to the end of one step with all files written: what `granflow run` does until then, and the closing.
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
  grains:
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
    """Run a scene to its first step, and print when each stage was done [s since 1970]."""
    moments = [time.time()]
    from granflow.scene import load
    from granflow.simulation import Simulation

    moments.append(time.time())
    described = load(scene)
    moments.append(time.time())
    simulation = Simulation(described, out=out)
    moments.append(time.time())
    simulation.run(until=simulation.plan.time_step)
    moments.append(time.time())
    used = resource.getrusage(resource.RUSAGE_SELF)
    answer = {"moments": moments, "compile": simulation.engine.timing.compile, "cpu": used.ru_utime + used.ru_stime}
    print(json.dumps(answer))


def start(scene: Path, cache: Path) -> dict[str, Any]:
    """Seconds of one start by stage, from before the process was made, and kernels compiled in it."""
    before = kernel_count(cache)
    with tempfile.TemporaryDirectory() as out:
        began = time.time()
        command = [sys.executable, __file__, "--child", str(scene), out]
        environment = os.environ | {"GRANFLOW_CACHE": str(cache)}
        done = subprocess.run(command, env=environment, stdout=subprocess.PIPE, text=True, check=True)
    answer = json.loads(done.stdout.splitlines()[-1])
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
    """Kernels in a cache folder; Taichi writes them when a process ends."""
    return len(list(cache.glob("*.tic")))


def import_seconds() -> dict[str, float]:
    """Seconds of importing granflow.simulation by package, without what a package imports from others."""
    command = [sys.executable, "-X", "importtime", "-c", "import granflow.simulation"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    found = dict.fromkeys((*PACKAGES, "others"), 0.0)
    for own, name in re.findall(r"import time:\s+(\d+) \|\s+\d+ \| +(\S+)", done.stderr):
        package = name.split(".")[0].split("_core")[0]
        found[package if package in PACKAGES else "others"] += 1e-6 * int(own)
    return found


def measure(folder: Path) -> dict[str, Any]:
    """Everything; each scene cold once, then warm."""
    bed = folder / "bed.yaml"
    bed.write_text(BED)
    result: dict[str, Any] = {"kind": "start", "machine": machine(), "imports": import_seconds(), "starts": []}
    for name, scene in (("two spheres", SMALL), ("50 000 spheres", bed)):
        cache = folder / f"cache of {name}"
        for number in range(1 + WARM_STARTS):
            state = "warm" if number else "cold"
            result["starts"].append({"scene": name, "state": state, **start(scene, cache)})
            print(line(result["starts"][-1]), flush=True)
    return result


def line(found: dict[str, Any]) -> str:
    """One start in one line."""
    stages = ", ".join(f"{stage} {found[stage]:.2f}" for stage in STAGES)
    kernels = f"{found['kernels_compiled']} kernels compiled, {found['kernels_in_cache']} in the cache"
    return (
        f"{found['scene']:>14} {found['state']}: {found['total']:.2f} s ({stages}; cpu {found['cpu']:.2f}); {kernels}"
    )


def main() -> None:
    """Measure, show, and write JSON where asked."""
    if sys.argv[1:2] == ["--child"]:
        child(*sys.argv[2:4])
        return
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", metavar="FILE", type=Path, help="where the numbers go as JSON")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        result = measure(Path(folder))
    print("imports: " + ", ".join(f"{name} {seconds:.2f} s" for name, seconds in result["imports"].items()))
    if options.out:
        options.out.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
