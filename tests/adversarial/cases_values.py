"""Extreme values in a scene: rejected with a reason, or computed correctly."""

from adversarial.beads import beads
from adversarial.case import Case
from adversarial.cases_physics import abort_files, frames, last


def rejected(name: str, text: str, pairs, *patterns: str, verb: str = "check beads.yaml", **more) -> Case:
    """Case of the scene of ten particles with replaced passages, which `granflow check` rejects."""
    return Case(
        "extreme values",
        f"value_{name}",
        text,
        (verb,),
        patterns=patterns,
        **({"prepare": beads(*pairs)} | more),
    )


def rests_or_refused(sandbox, finished):
    """If the run is not rejected, it ends with all particles at finite positions above the floor."""
    if finished.code == 0:
        assert last(frames(sandbox.path("out")))[:, 2].min() > 0.0015


def values() -> list[Case]:
    """Extreme values in a scene."""
    step = ("run: {duration: 50 ms}", "run: {duration: 50 ms, time_step: 1e-30}")
    return [
        rejected(
            "step_large",
            "a time step of 1 ms",
            [("50 ms}", "50 ms, time_step: 1 ms}")],
            "above the stability limit",
        ),
        rejected("step_small", "a time step of 1e-30 s", [step], "time_step|steps|years|long"),
        rejected("duration", "a duration of 1e30 s", [("50 ms", "1e30")], "duration|steps|years|long"),
        rejected(
            "density_run",
            "a density of 1e30 kg/m3, in a run",
            [("density: 2500", "density: 1e30")],
            "check the units of densities",
            verb="run beads.yaml --out out",
            code=3,
        ),
        rejected(
            "density_small",
            "a density of 1e-30 kg/m3",
            [("density: 2500", "density: 1e-30")],
            "density|step|long|mass|1e-",
        ),
        rejected("modulus", "Young's modulus of 1e30 Pa", [("10 MPa", "1e30")], "step|long|young_modulus"),
        rejected(
            "diameter",
            "a diameter of 1e-30 m",
            [("diameter: 4 mm", "diameter: 1e-30")],
            "diameter|small|cells|step|long|positions",
        ),
        rejected(
            "diameter_large",
            "a diameter of 1e30 m",
            [("diameter: 4 mm", "diameter: 1e30")],
            "duration is 0.05 s, shorter than one time step",
        ),
        rejected(
            "gravity",
            "gravity of 1e30 m/s2",
            [("-9.81", "-1e30")],
            "gravity|step|velocity|long|limit|outside",
            verb="run beads.yaml --out out",
            code=(2, 3),
            verify=abort_files,
        ),
        rejected(
            "domain",
            "a domain of 1e30 m",
            [("max: [3 cm, 3 cm, 3 cm]", "max: [1e30, 1e30, 1e30]")],
            verb="run beads.yaml --out out",
            code=(0, 2),
            verify=rests_or_refused,
        ),
        rejected(
            "velocity",
            "a velocity of 1e30 m/s",
            [("    count: 10\n", "    count: 10\n    velocity: [1e30, 0, 0]\n")],
            "velocity|step|fast|long|limit|outside",
            verb="run beads.yaml --out out",
            code=(2, 3),
            verify=abort_files,
        ),
        rejected(
            "count", "2 147 483 647 particles", [("count: 10", "count: 2147483647")], "maximum for 32-bit"
        ),
        rejected(
            "chunk",
            "a chunk size of 2 147 483 647",
            [("run:", "numerics: {chunk_size: 2147483647}\nrun:")],
            "chunk_size",
        ),
        rejected("skin", "a skin of 1e30 m", [("run:", "numerics: {skin: 1e30}\nrun:")], "skin"),
        rejected("skin_small", "a skin of 1e-30 m", [("run:", "numerics: {skin: 1e-30}\nrun:")], code=(0, 2)),
        rejected(
            "f32_far",
            "f32 at 1e6 m from the origin",
            [
                ("[0, 0, 0], max: [2 cm, 2 cm, 1 cm]", "[1000000, 0, 0], max: [1000000.02, 2 cm, 1 cm]"),
                ("min: [-1 cm, -1 cm, -1 cm], max: [3 cm", "min: [999999, -1 cm, -1 cm], max: [1000001"),
                ("50 ms}", "50 ms, precision: f32}"),
            ],
            "f32|precision",
            "mixed|f64",
        ),
        rejected(
            "stage_zero",
            "a stage of zero length",
            [("run: {duration: 50 ms}", "stages: [{name: a, duration: 0}, {name: b, duration: 10 ms}]")],
            "duration",
            "above 0",
        ),
        rejected(
            "interval_zero",
            "an output interval of 0",
            [("interval: 10 ms", "interval: 0")],
            "interval",
            "above 0",
        ),
        rejected(
            "interval_tiny",
            "an output interval of 1e-30 s",
            [("interval: 10 ms", "interval: 1e-30")],
            code=(0, 2),
        ),
        rejected(
            "amplitude",
            "a vibration of 1e30 m",
            [
                (
                    "material: glass}",
                    "material: glass, motion: {kind: vibration, direction: [0, 0, 1], amplitude: 1e30, "
                    "frequency: 50}}",
                )
            ],
            "amplitude|step|velocity|speed|long|fast|limit",
            verb="run beads.yaml --out out",
            code=(2, 3),
            verify=abort_files,
        ),
        Case(
            "extreme values",
            "value_duration_short",
            "a duration of 1e-30 s",
            ("run beads.yaml --out out",),
            patterns=("shorter than one time step",),
            prepare=beads(("50 ms", "1e-30")),
        ),
        Case(
            "extreme values",
            "value_interval_long",
            "an output interval longer than the run",
            ("run beads.yaml --out out",),
            0,
            prepare=beads(("interval: 10 ms", "interval: 1e6")),
        ),
        Case(
            "extreme values",
            "value_friction",
            "a friction coefficient of 1e30",
            ("run beads.yaml --out out",),
            (0, 2),
            prepare=beads(("friction: 0.4", "friction: 1e30")),
        ),
        Case(
            "extreme values",
            "value_restitution_zero",
            "a restitution of 0",
            ("run beads.yaml --out out",),
            0,
            prepare=beads(("restitution: 0.8", "restitution: 0")),
            verify=lambda s, d: at_rest(s),
            verified="no particle bounces",
        ),
    ]


def at_rest(sandbox):
    """Particles with zero restitution rest on the floor."""
    heights = last(frames(sandbox.path("out")))[:, 2]
    assert heights.max() < 0.01 and heights.min() > 0.0015, heights


CASES = values()
