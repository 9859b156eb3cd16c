"""The runs of a comparison: one scene with several contact models, each run with all compared quantities.

`variants_of` gives the scene with each contact model and matched parameters; linear springs have the
stiffness of Eq. 19 (Zhou 2011), per contact or at the reference velocity. `run_all` runs the variants, each
with the output of `granflow run` in a directory of its own. A record in the same directory keeps what the
comparison observed besides (`granflow.studies.compare.bed`), so that a comparison that was stopped continues
with the missing runs.
"""

import hashlib
import json
import zipfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from granflow import (
    GranflowError,
    Plan,
    RunError,
    Scene,
    SceneError,
    Simulation,
    on_interval,
    plan_for,
    read_run,
    steady_flow,
    steady_flow_error,
)
from granflow.contact import theory
from granflow.contact.registry import models
from granflow.io.files import file_digest, replacing
from granflow.load import copied_scene
from granflow.schema.messages import suggestion_or_list
from granflow.studies.checked_run import run_identity
from granflow.studies.compare.bed import (
    FORCE_EDGES,
    BedHeights,
    ContactBursts,
    FollowedContacts,
    ForceHistogram,
    bursts,
    median_of,
    survival,
)

# ---------------------------------------------------------------- variants of the scene

LINEAR_KEYS = ("linear_onset", "linear_reference")
"""Directories of the two variants of the linear contact model: spring per contact, and from the reference
velocity."""
TYPICAL_SHARE = 0.1
"""Default reference velocity over the largest expected impact velocity."""


@dataclass(frozen=True)
class LawVariant:
    """The scene with one contact model; `key` names its directory, `normal` is its `contact.normal`.

    If the contact model cannot run the scene, `scene` is None and `refused` gives the reason. `repeats`: key
    of the variant of which this one is a repetition with another seed; empty for the seed of the scene.
    """

    key: str
    title: str
    normal: Mapping[str, Any]
    scene: Scene | None
    refused: str = ""
    repeats: str = ""


def law_names(given: str) -> tuple[str, ...]:
    """Contact models of a comma-separated list.

    Raises GranflowError for an unknown contact model, a repeated one, or an empty list.
    """
    names = tuple(part.strip() for part in given.split(",") if part.strip())
    if not names:
        raise GranflowError(
            "--laws is empty: give at least one contact model, such as --laws zhou,linear,hertz."
        )
    for number, name in enumerate(names):
        if name not in models("normal"):
            remedy = suggestion_or_list(name, models("normal"), "contact models")
            raise GranflowError(
                f"Unknown contact model {name}. {remedy if remedy.endswith('?') else remedy + '.'}"
            )
        if name in names[:number]:
            raise GranflowError(f"The contact model {name} is repeated: give each once.")
    return names


def reference_velocity_of(scene: Scene) -> float:
    """Typical impact velocity [m/s]: TYPICAL_SHARE of the largest that the plan assumes."""
    return TYPICAL_SHARE * automatic_plan(scene).impact_velocity.value


def automatic_plan(scene: Scene) -> Plan:
    """Plan of a scene with the automatic time step. Raises SceneError if its contact model cannot run it."""
    return plan_for(scene.model_copy(update={"run": scene.run.model_copy(update={"time_step": "auto"})}))


def variants_of(
    scene: Scene, laws: Sequence[str], reference_velocity: float, most_particles: int | None = None
) -> list[LawVariant]:
    """The scene with each contact model, `linear` twice: per contact and from the reference velocity [m/s].

    Every variant has its automatic time step and computes the energy budget. `most_particles` reduces the
    groups without explicit positions in proportion.
    """
    found = []
    for key, title, normal in _normals(scene, laws, reference_velocity):
        described = _described(scene, normal, reference_velocity, most_particles)
        try:
            found.append(LawVariant(key, title, normal, Scene.from_dict(described, scene.folder)))
        except SceneError as error:
            found.append(LawVariant(key, title, normal, None, "; ".join(error.problems)))
    return found


def repetitions_of(variants: Sequence[LawVariant], seeds: int) -> list[LawVariant]:
    """The variants that can run, with each of the `seeds` - 1 seeds after that of the scene; seed by seed."""
    found = []
    for offset in range(1, seeds):
        for variant in variants:
            if variant.scene is None:
                continue
            seed = variant.scene.seed + offset
            found.append(
                replace(
                    variant,
                    key=f"{variant.key}_seed_{seed}",
                    title=f"{variant.title}, seed {seed}",
                    scene=variant.scene.with_values({"seed": seed}),
                    repeats=variant.key,
                )
            )
    return found


def _normals(scene: Scene, laws: Sequence[str], velocity: float) -> Iterator[tuple[str, str, dict[str, Any]]]:
    """Directory, title and `contact.normal` of every variant.

    The contact model of the scene keeps its settings; other models get those of their example in the catalog.
    """
    for name in laws:
        if name == "linear":
            at = {"reference_velocity": velocity}
            yield LINEAR_KEYS[0], "linear per contact", {"law": name, "stiffness": "onset"}
            yield LINEAR_KEYS[1], f"linear of {velocity:.3g} m/s", {"law": name, "stiffness": at}
        elif name == scene.contact.normal.law:
            yield name, name, scene.contact.normal.model_dump()
        else:
            example = models("normal")[name].example
            if "reference_velocity" in example:
                example["reference_velocity"] = velocity
            yield name, name, {"law": name, **example}


def _described(scene: Scene, normal: Mapping[str, Any], velocity: float, most: int | None) -> dict[str, Any]:
    """Scene description with the contact model, in the structure of a scene file.

    With an automatic time step, the energy budget and without expectations; `most`: largest number of
    particles or None.
    """
    described = scene.model_dump(by_alias=True, exclude_none=True)
    described["contact"]["normal"] = dict(normal)
    described["run"]["time_step"] = "auto"
    described["output"] |= {"energy_budget": True, "particles": True}
    described["expect"] = []
    for key, pair in described["pairs"].items():
        pair["restitution"] = restitution_for(scene, key, str(normal["law"]), velocity)
        if pair["restitution"] is None:
            del pair["restitution"]
    reduced = reduced_counts(scene, most)
    for name, count in reduced.items():
        described["particles"][name]["count"] = count
    return described


def restitution_for(scene: Scene, pair: str, law: str, velocity: float) -> Any:
    """Restitution of a pair for a contact model: that of the scene, or the value of Eq. 12 at the velocity
    [m/s].

    `pair`: key in `pairs`. The result is a number or a mapping as in a scene; None if the contact model
    derives it from the materials, or if the scene does not define it.
    """
    kind = models("normal")[law].restitution
    given = scene.pairs[pair].restitution
    if kind == "nothing" or given is None or isinstance(given, float):
        return None if kind == "nothing" else given
    if kind == "positive number":
        return automatic_plan(scene).pair(*pair.split("-")).restitution_at(velocity)
    return given.model_dump(exclude_none=True)


def reduced_counts(scene: Scene, most: int | None) -> dict[str, int]:
    """Reduced counts of the groups without explicit positions, for at most `most` particles if possible.

    In proportion, at least 1 per group. Empty without a limit, or if the scene is below it.
    """
    scalable = {name: group.count for name, group in scene.particles.items() if not group.insert.has_rows}
    explicit_count = sum(group.count for group in scene.particles.values()) - sum(scalable.values())
    if most is None or explicit_count + sum(scalable.values()) <= most:
        return {}
    share = max(most - explicit_count, 0) / sum(scalable.values()) if scalable else 1.0
    return {name: max(int(share * count), 1) for name, count in scalable.items()}


# ---------------------------------------------------------------- one run

BURSTS = 8
"""Number of bursts of contact samples in a run."""
SAMPLES = 48
"""Samples of each burst."""
SAMPLES_PER_CONTACT = 8
"""Samples per duration of an elastic Hertz contact at the reference velocity."""


@dataclass(frozen=True)
class VariantRun:
    """Result of one variant.

    `columns`: columns of timeseries.csv by name without unit, (rows,) each; `time`: simulated time [s];
    `time_step` [s] and `step_limit`: time step of the plan, and what limits it.
    """

    variant: LawVariant
    time_step: float
    step_limit: str
    step_count: int
    time: float
    seconds: float
    """Wall time of neighbor-list rebuilds and steps [s], without compilation and output."""
    compile_seconds: float
    stopped: str
    """Message of the abort; empty for a complete run."""
    columns: dict[str, np.ndarray]
    heights: np.ndarray
    """(rows, 3): time [s], height of the center of mass and of the surface [m]."""
    typical_speed: float
    """Upper end of the color scale [m/s]."""
    forces: ForceHistogram
    followed: FollowedContacts
    repetitions: "tuple[VariantRun, ...]" = ()
    """Runs of the same contact model with other seeds."""

    @property
    def of_all_seeds(self) -> "tuple[VariantRun, ...]":
        """This run and its repetitions that are complete; only this run if none is."""
        return tuple(run for run in (self, *self.repetitions) if not run.stopped) or (self,)

    def mean(self, number: "Callable[[VariantRun], float]") -> float:
        """Mean of a number over all seeds whose runs have it; nan without."""
        values = [value for run in self.of_all_seeds if np.isfinite(value := number(run))]
        return float(np.mean(values)) if values else float("nan")

    @property
    def meters(self) -> list[str]:
        """Names of the flow meters."""
        return [name.partition(".")[2] for name in self.columns if name.startswith("flow_mass.")]

    def mass_flow(self, meter: str) -> float:
        """Steady mass flow rate [kg/s] through a meter, as reported by `granflow run`
        (`flow_meters.steady_flow`)."""
        return steady_flow(self._passed_mass(meter))

    def mass_flow_error(self, meter: str) -> float:
        """Standard error [kg/s] of `mass_flow` from the fluctuation of the flow in time."""
        return steady_flow_error(self._passed_mass(meter))

    def _passed_mass(self, meter: str) -> list[tuple[float, str, float]]:
        """Time [s], stage, and mass [kg] that has passed a meter, in each row."""
        names = ("time", "stage", f"flow_mass.{meter}")
        return list(zip(*(self.columns[name].tolist() for name in names), strict=True))

    @cached_property
    def duration_survival(self) -> tuple[np.ndarray, np.ndarray]:
        """Times [s] and share of contacts that last longer, (n,) each."""
        return survival(*self.followed.arrays())

    @property
    def median_duration(self) -> float:
        """Median contact duration [s]."""
        return median_of(*self.duration_survival)

    def at_end_of(self, stage: str) -> int | None:
        """Last row of a stage; None if the run did not complete the stage."""
        rows = np.flatnonzero(self.columns["stage"] == stage)
        if not len(rows) or (self.stopped and rows[-1] + 1 == len(self.columns["stage"])):
            return None
        return int(rows[-1])


def run_variant(
    variant: LawVariant, out: Path, arch: str, reference_velocity: float, until: float | None
) -> VariantRun | str:
    """Run a variant with output into `out`; returns the reason if its contact model cannot run the scene.

    `arch`: backend; `reference_velocity` [m/s] determines the interval of contact samples; `until` [s]: end
    of the run, or None. An aborted run is returned with the message in `stopped`.
    """
    assert variant.scene is not None
    scene = variant.scene
    heights = BedHeights.of(scene)
    forces = ForceHistogram()
    end = min(scene.longest_duration, until or np.inf)
    output = scene.output
    try:
        spacing = hertz_duration(scene, reference_velocity) / SAMPLES_PER_CONTACT
        bursts_observer = ContactBursts(list(bursts(end, BURSTS, SAMPLES, spacing)), spacing)
        observers = [
            on_interval(output.timeseries_interval, heights.update),
            on_interval(output.interval, forces.update, ("contacts",)),
            bursts_observer,
        ]
        simulation = Simulation(scene, arch=arch, out=out, observers=observers, overwrite=True)  # type: ignore[arg-type]
    except SceneError as error:
        return "; ".join(error.problems)
    stopped = ""
    try:
        simulation.run(until, within_stages=True)
    except RunError as error:
        stopped = str(error)
    finally:
        simulation.free()
    timing = simulation.engine.timing
    return VariantRun(
        variant,
        simulation.plan.time_step,
        simulation.plan.step.limited_by,
        simulation.engine.step_count,
        simulation.time,
        timing.neighbor_list + timing.advance,
        timing.compile,
        stopped,
        dict(read_run(out).timeseries_arrays),
        np.array(heights.rows),
        heights.typical_speed,
        forces,
        bursts_observer.followed,
    )


def hertz_duration(scene: Scene, velocity: float) -> float:
    """Duration [s] of the shortest elastic collision in the scene at an approach velocity [m/s] (Eq. 13, e =
    1)."""
    durations = []
    for pair_case in automatic_plan(scene).pair_cases:
        k = theory.hertz_stiffness(pair_case.pair.modulus_eff, pair_case.radius_eff)
        durations.append(float(theory.duration(1.0, k, pair_case.mass_eff, velocity)))
    return min(durations)


# ---------------------------------------------------------------- all runs


def run_all(
    variants: Sequence[LawVariant],
    directories: Sequence[Path],
    arch: str,
    reference_velocity: float,
    until: float | None,
    report: Callable[[str], None],
    prepare: Callable[[Path], None],
    repeat: bool,
) -> tuple[list[VariantRun], dict[str, str]]:
    """Run every variant, each into the directory at the same position; runs of an earlier call are kept.

    `prepare`: called before the first run with each directory that does not contain the run of its variant,
    which may be a stopped one; it raises an error for other results. `repeat`: no run is kept.
    Returns the runs with the seed of the scene, each with its repetitions, and the reasons of rejected
    variants by title. Raises GranflowError if no variant can
    run.
    """
    ran = []
    refused = {each.title: each.refused for each in variants if each.scene is None}
    planned = []
    for variant, out in zip(variants, directories, strict=True):
        if variant.scene is None:
            continue
        identity = identity_of_run(variant, arch, reference_velocity, until)
        kept = None if repeat else kept_run(variant, out, identity)
        if kept is None and (repeat or not has_begun(variant, out, identity)):
            prepare(out)
        planned.append((variant, out, identity, kept))
    for number, (variant, out, identity, kept) in enumerate(planned, 1):
        report(f"run {number} of {len(planned)}: {variant.title}{'' if kept is None else ', kept'}")
        if kept is not None:
            ran.append(kept)
            continue
        record_start(out, identity)
        done = run_variant(variant, out, arch, reference_velocity, until)
        if isinstance(done, VariantRun):
            record_run(out, identity, done)
            ran.append(done)
        else:
            refused[variant.title] = done
    if not ran:
        raise GranflowError(
            "No contact model can run this scene: " + " ".join(f"{n}: {why}" for n, why in refused.items())
        )
    repetitions = [run for run in ran if run.variant.repeats]
    return [
        replace(
            run, repetitions=tuple(each for each in repetitions if each.variant.repeats == run.variant.key)
        )
        for run in ran
        if not run.variant.repeats
    ], refused


# ---------------------------------------------------------------- records of runs that have ended

SERIES = "timeseries.csv"
RECORD = "compare_run.npz"
"""File in the directory of a run with what the comparison needs of it, apart from timeseries.csv."""
RECORDED = (
    "time_step",
    "step_limit",
    "step_count",
    "time",
    "seconds",
    "compile_seconds",
    "stopped",
    "typical_speed",
)
"""Fields of VariantRun in the record."""


def identity_of_run(variant: LawVariant, arch: str, reference_velocity: float, until: float | None) -> str:
    """Hash of all that determines a run of a variant and its samples; arguments as for `run_variant`."""
    assert variant.scene is not None
    samples = (reference_velocity, until, BURSTS, SAMPLES, SAMPLES_PER_CONTACT, FORCE_EDGES.tolist())
    return hashlib.sha256(f"{run_identity(variant.scene, arch)} {samples}".encode()).hexdigest()


def record_start(out: Path, identity: str) -> None:
    """Record that the run with this identity begins in a directory, which is created."""
    out.mkdir(parents=True, exist_ok=True)
    _write_record(out, {"identity": identity})


def record_run(out: Path, identity: str, run: VariantRun) -> None:
    """Record a run that has ended."""
    numbers = {
        "identity": identity,
        "series": file_digest(out / SERIES),
        **{name: getattr(run, name) for name in RECORDED},
        "stages": list(run.forces.counts),
    }
    observed, has_ended = run.followed.arrays()
    counts = {f"force_counts_{k}": each for k, each in enumerate(run.forces.counts.values())}
    _write_record(out, numbers, heights=run.heights, observed=observed, has_ended=has_ended, **counts)


def _write_record(out: Path, numbers: dict[str, Any], **arrays: np.ndarray) -> None:
    """Write numbers and arrays atomically."""
    content: dict[str, Any] = {"numbers": np.array(json.dumps(numbers)), **arrays}
    with replacing(out / RECORD) as temporary, temporary.open("wb") as file:
        np.savez(file, **content)


def has_begun(variant: LawVariant, out: Path, identity: str) -> bool:
    """Whether the results in a directory are those of a run with this identity that was stopped."""
    assert variant.scene is not None
    found = _record(out)
    try:
        scene = (out / "scene_as_run.yaml").read_text(encoding="utf-8")
    except OSError:
        scene = ""
    return (
        found is not None
        and found[0] == {"identity": identity}
        and scene in ("", copied_scene(variant.scene).to_yaml())
    )


def kept_run(variant: LawVariant, out: Path, identity: str) -> VariantRun | None:
    """The run with this identity that has ended in a directory; None without, or if its files have
    changed."""
    found = _record(out)
    if (
        found is None
        or found[0].get("identity") != identity
        or found[0].get("series") != file_digest(out / SERIES)
    ):
        return None
    numbers, arrays = found
    counts = {stage: arrays[f"force_counts_{k}"] for k, stage in enumerate(numbers["stages"])}
    return VariantRun(
        variant,
        **{name: numbers[name] for name in RECORDED},
        columns=dict(read_run(out).timeseries_arrays),
        heights=arrays["heights"],
        forces=ForceHistogram(counts),
        followed=FollowedContacts([arrays["observed"]], [arrays["has_ended"]]),
    )


def _record(out: Path) -> tuple[dict[str, Any], dict[str, np.ndarray]] | None:
    """Numbers and arrays of the record in a directory; None without one, or if it is damaged."""
    try:
        with np.load(out / RECORD, allow_pickle=False) as content:
            arrays = {name: content[name] for name in content.files}
        numbers = json.loads(str(arrays.pop("numbers")))
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
        return None
    return (numbers, arrays) if isinstance(numbers, dict) else None


# ---------------------------------------------------------------- values at the end


def densest_stage(runs: Sequence[VariantRun]) -> str:
    """Stage at the end of which the first complete run has the most contacts.

    Only stages with rows in all complete runs qualify: a stage that waits for rest may end before its first
    row.
    """
    finished = [run for run in runs if not run.stopped] or list(runs[:1])
    columns = finished[0].columns
    ends = {
        stage: count for stage, count in zip(columns["stage"].tolist(), columns["contact_count"], strict=True)
    }
    shared = [stage for stage in ends if all(stage in run.columns["stage"] for run in finished)]
    return max(shared or list(ends), key=lambda stage: ends[stage])


def at_end(stage: str, name: str) -> Callable[[VariantRun], float]:
    """Function that returns the value of a column at the end of a stage; nan if a run did not complete the
    stage."""

    def number(run: VariantRun) -> float:
        row = run.at_end_of(stage)
        return float("nan") if row is None else float(run.columns[name][row])

    return number
