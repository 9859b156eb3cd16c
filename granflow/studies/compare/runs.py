"""Run of one variant to its end or abort, with all compared quantities.

The output of each run is that of `granflow run`, in a separate directory, and a record with the other
quantities: a comparison that was stopped continues with the missing runs.
"""

import hashlib
import json
import zipfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from math import inf
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from granflow import (
    GranflowError,
    Plan,
    RunError,
    Scene,
    SceneError,
    Simulation,
    Snapshot,
    on_interval,
    plan_for,
    read_run,
    steady_flow,
)
from granflow.contact import theory
from granflow.contact.registry import models
from granflow.io.files import file_digest, replacing
from granflow.load import copied_scene
from granflow.scene.suggest import suggestion_or_list
from granflow.studies.run_process import run_identity

# Contact durations from samples of all contacts in short intervals.

KEY_BASE = 2**32
"""Exceeds every id, so that two ids combine into one integer key."""
FIRST_WALL_KEY = 2**31
"""Key of the first wall, above all ids."""


@dataclass
class FollowedContacts:
    """Contacts that began during a burst: observed duration of each, and whether its end was observed.

    `observed`: arrays of durations [s]; `has_ended`: bool arrays of the same lengths.
    """

    observed: list[np.ndarray] = field(default_factory=list)
    has_ended: list[np.ndarray] = field(default_factory=list)

    def add(self, observed: np.ndarray, has_ended: bool) -> None:
        """Add contacts that have all ended, or that all persist at the end of the burst (censored)."""
        self.observed.append(observed)
        self.has_ended.append(np.full(len(observed), has_ended))

    def arrays(self) -> tuple[np.ndarray, np.ndarray]:
        """Observed durations [s] (n,) and ended flags (n,) of all contacts."""
        if not self.observed:
            return np.empty(0), np.empty(0, dtype=bool)
        return np.concatenate(self.observed), np.concatenate(self.has_ended)


class ContactFollower:
    """Tracks contacts with a nonzero force through one burst of samples.

    A contact begins and ends midway between the two samples that bracket the change. Contacts in the first
    sample are ignored; contacts in the last sample are censored. Contacts shorter than the interval between
    samples can be missed.
    """

    def __init__(self, followed: FollowedContacts) -> None:
        self._followed = followed
        self._contacts = ActingContacts(np.empty(0, dtype=np.int64), np.empty((0, 3)))
        self._since = np.empty(0)
        self._time = np.nan

    def update(self, snapshot: Snapshot) -> None:
        """Add a sample; the snapshot must contain contacts."""
        contacts = acting_contacts(snapshot)
        if np.isnan(self._time):
            since = np.full(len(contacts.keys), -np.inf)
        else:
            middle = 0.5 * (self._time + snapshot.time)
            old, new = continued(self._contacts, contacts)
            has_ended = np.ones(len(self._contacts.keys), dtype=bool)
            has_ended[old] = False
            self._record(has_ended, middle, has_ended=True)
            since = np.full(len(contacts.keys), middle)
            since[new] = self._since[old]
        self._contacts = contacts
        self._since = since
        self._time = snapshot.time

    def close(self) -> None:
        """End the burst."""
        self._record(np.ones(len(self._since), dtype=bool), self._time, has_ended=False)

    def _record(self, selected: np.ndarray, time: float, has_ended: bool) -> None:
        """Add the selected contacts that began within the burst, with durations up to `time` [s]."""
        began = self._since[selected]
        self._followed.add(time - began[np.isfinite(began)], has_ended)


class ActingContacts(NamedTuple):
    """Contacts with a force above zero: integer key (n,) of the two partners, and branch vector (n, 3) [m].

    A pair has several contacts where a particle is in contact with several triangles of one mesh, two clumps
    with several of their spheres, or two particles directly and across a periodic face; these have equal
    keys.
    """

    keys: np.ndarray
    branch: np.ndarray


def acting_contacts(snapshot: Snapshot) -> ActingContacts:
    """The contacts of a snapshot with a force above zero; keys and branch vectors depend on the two partners
    only.

    Walls have numbers from FIRST_WALL_KEY on, above all ids. The branch vector points from the lower to the
    higher one.
    """
    contacts = snapshot.contacts
    assert contacts is not None
    first, second, wall = (contacts[name].astype(np.int64) for name in ("id_i", "id_j", "wall"))
    other = np.where(wall >= 0, FIRST_WALL_KEY + wall, second)
    low, high = np.minimum(first, other), np.maximum(first, other)
    branch = np.where((first <= other)[:, None], 1.0, -1.0) * (
        contacts["position_j"] - contacts["position_i"]
    )
    acting = contacts["normal_force"] > 0.0
    return ActingContacts((low * KEY_BASE + high)[acting], branch[acting])


def continued(before: ActingContacts, after: ActingContacts) -> tuple[np.ndarray, np.ndarray]:
    """Indices (m,) of the contacts that continue from one sample to the next, in the first and in the second
    one.

    The contact of a pair with one contact in both samples continues. Of a pair with several, those with the
    nearest branch vectors are the same contact, the nearest two first.
    """
    rows_before, rows_after = _rows_by_key(before.keys), _rows_by_key(after.keys)
    found: list[tuple[int, int]] = []
    for key in rows_before.keys() & rows_after.keys():
        old, new = rows_before[key], rows_after[key]
        if len(old) == len(new) == 1:
            found.append((old[0], new[0]))
            continue
        distance = np.linalg.norm(before.branch[old][:, None] - after.branch[new][None], axis=2)
        for _ in range(min(len(old), len(new))):
            i, j = np.unravel_index(np.argmin(distance), distance.shape)
            found.append((old[i], new[j]))
            distance[i, :] = distance[:, j] = np.inf
    pairs = np.array(found, dtype=np.int64).reshape(-1, 2)
    return pairs[:, 0], pairs[:, 1]


def _rows_by_key(keys: np.ndarray) -> dict[int, list[int]]:
    """Rows of each key."""
    found: dict[int, list[int]] = {}
    for row, key in enumerate(keys.tolist()):
        found.setdefault(key, []).append(row)
    return found


def survival(observed: np.ndarray, has_ended: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Survival function of the contact duration: times (m,) of observed ends [s], and share (m,) that lasts
    longer.

        S(t) = product over t_i <= t of (1 - d_i / n_i)

    d_i: ended at t_i, n_i: at risk. Estimator of Kaplan and Meier (1958): a censored contact counts as at
    risk until its observation ends. `observed` (n,) [s], `has_ended` (n,) bool.
    """
    times = np.unique(observed[has_ended])
    at_risk = len(observed) - np.searchsorted(np.sort(observed), times)
    ended_count = np.array([np.count_nonzero(has_ended & (observed == time)) for time in times])
    return times, np.cumprod(1.0 - ended_count / at_risk) if len(times) else np.empty(0)


def median_of(times: np.ndarray, share: np.ndarray) -> float:
    """Median duration [s] of a survival function; nan if more than half of the contacts outlast the
    observation.

    `times` (m,) [s], `share` (m,): from `survival`.
    """
    below = np.flatnonzero(share <= 0.5)
    return float(times[below[0]]) if len(below) else float("nan")


def bursts(end: float, count: int, samples: int, spacing: float) -> Iterable[list[float]]:
    """Sample times [s] of each burst; the bursts are evenly spaced over a run that ends at `end` [s].

    `count`: number of bursts; `samples`: samples of each, with `spacing` [s] between them.
    """
    for number in range(count):
        start = (number + 0.5) / count * end
        yield [start + sample * spacing for sample in range(samples)]


# Observers of a variant's run: bed heights, normal forces, contact durations.
#
# They hold their results in memory; `granflow.studies.compare.report` writes them.

SURFACE_PERCENTILE = 95.0
"""Percentile of the particle tops that defines the surface of the bed."""
FORCE_EDGES = np.concatenate([np.arange(0.0, 8.01, 0.2), [np.inf]])
"""Bin edges of force over mean force."""
MIN_CONTACTS = 10
"""Minimum number of particle-particle contacts of a frame for a meaningful mean force."""


@dataclass
class BedHeights:
    """Heights of the center of mass and of the surface [m] above the origin, opposite to gravity.

    `rows`: time [s], height of the center of mass [m] and of the surface [m] of each snapshot.
    """

    up: np.ndarray
    """Unit vector opposite to gravity (3,); zero without gravity."""
    rows: list[tuple[float, float, float]] = field(default_factory=list)
    speeds: list[float] = field(default_factory=list)
    """Percentile SURFACE_PERCENTILE of the particle speeds [m/s] in each snapshot."""

    @property
    def typical_speed(self) -> float:
        """Median of `speeds` [m/s], the upper end of the color scale."""
        return float(np.median(self.speeds)) if self.speeds else 0.0

    @classmethod
    def of(cls, scene: Scene) -> "BedHeights":
        """Create the observer for a scene."""
        gravity = np.array(scene.gravity, dtype=float)
        strength = float(np.linalg.norm(gravity))
        return cls(-gravity / strength if strength > 0.0 else gravity)

    def update(self, snapshot: Snapshot) -> None:
        """Add a row: time [s], center [m], surface [m]; nan without particles or without gravity.

        The surface is the percentile SURFACE_PERCENTILE of the tops of the particles.
        """
        particles = snapshot.particles
        if len(particles["mass"]):
            speed = np.linalg.norm(particles["velocity"], axis=1)
            self.speeds.append(float(np.percentile(speed, SURFACE_PERCENTILE)))
        if not len(particles["mass"]) or not self.up.any():
            self.rows.append((snapshot.time, np.nan, np.nan))
            return
        height = particles["position"] @ self.up
        center = float(np.average(height, weights=particles["mass"]))
        self.rows.append(
            (snapshot.time, center, float(np.percentile(height + particles["radius"], SURFACE_PERCENTILE)))
        )


@dataclass
class ForceHistogram:
    """Histogram of the normal forces between particles over their mean in the same frame, by stage.

    `counts`: stage -> numbers of contacts (bins,) with the bin edges FORCE_EDGES; the last bin is open.
    """

    counts: dict[str, np.ndarray] = field(default_factory=dict)

    def update(self, snapshot: Snapshot) -> None:
        """Add the contacts of a frame with at least MIN_CONTACTS contacts."""
        contacts = snapshot.contacts
        assert contacts is not None
        force = contacts["normal_force"][contacts["id_j"] >= 0]
        force = force[force > 0.0]
        if len(force) < MIN_CONTACTS:
            return
        found, _ = np.histogram(force / force.mean(), FORCE_EDGES)
        self.counts[snapshot.stage] = self.counts.get(snapshot.stage, 0) + found

    def density(self, stage: str) -> np.ndarray:
        """P(f/<f>) in all bins except the last, open one (bins - 1,); nan for a stage without frames.

        The integral over all bins, the open one included, is 1.
        """
        found = self.counts.get(stage)
        if found is None:
            return np.full(len(FORCE_EDGES) - 2, np.nan)
        return np.asarray(found[:-1] / (found.sum() * np.diff(FORCE_EDGES[:-1])))

    def share_above(self, stage: str, multiple: float) -> float:
        """Share of contacts of a stage with more than this multiple of the mean force, which must be a bin
        edge.

        Between 0 and 1; nan for a stage without frames.
        """
        found = self.counts.get(stage)
        if found is None:
            return float("nan")
        return float(found[FORCE_EDGES[:-1] > multiple - 1e-9].sum() / found.sum())


class ContactBursts:
    """Samples all contacts in short bursts at several times of the run; see `ContactFollower`.

    `times`: sample times [s] of each burst, in ascending order; `spacing` [s]: time between the samples of a
    burst. `followed`: the observed contacts.
    """

    wants = frozenset({"contacts"})

    def __init__(self, times: list[list[float]], spacing: float) -> None:
        self.followed = FollowedContacts()
        self._pending = [list(burst) for burst in times]
        self._spacing = spacing
        self._follower: ContactFollower | None = None

    def next_time(self) -> float:
        """Time of the next sample [s]; inf after the last."""
        return self._pending[0][0] if self._pending else inf

    def observe(self, snapshot: Snapshot) -> None:
        """Sample the contacts if a sample is due; a run calls every observer at its start."""
        if not self._pending or snapshot.time < self.next_time() - 0.5 * self._spacing:
            return
        if self._follower is None:
            self._follower = ContactFollower(self.followed)
        self._follower.update(snapshot)
        remaining = [time for time in self._pending[0] if time > snapshot.time + 0.5 * self._spacing]
        self._pending[0] = remaining
        if not remaining:
            self._pending.pop(0)
            self._close()

    def finish(self) -> None:
        """End the current burst at the end of the run."""
        self._close()

    def _close(self) -> None:
        """End the current burst; its remaining contacts are censored."""
        if self._follower is not None:
            self._follower.close()
            self._follower = None


# Variants of a scene with each contact model and matched parameters.
#
# Linear springs have the stiffness of Eq. 19 (Zhou 2011), per contact or at the reference velocity.

LINEAR_KEYS = ("linear_onset", "linear_reference")
"""Directories of the two variants of the linear contact model: spring per contact, and from the reference
velocity."""
TYPICAL_SHARE = 0.1
"""Default reference velocity over the largest expected impact velocity."""


@dataclass(frozen=True)
class LawVariant:
    """The scene with one contact model; `key` names its directory, `normal` is its `contact.normal`.

    If the contact model cannot run the scene, `scene` is None and `refused` gives the reason.
    """

    key: str
    title: str
    normal: Mapping[str, Any]
    scene: Scene | None
    refused: str = ""


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
    return TYPICAL_SHARE * automatic_plan(scene).velocity_max


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
            yield name, name, {"law": name, **scene.contact.normal.settings()}
        else:
            example = dict(models("normal")[name].example)
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
    explicit_kinds = ("positions", "file")
    scalable = {
        name: group.count
        for name, group in scene.particles.items()
        if group.insert.kind not in explicit_kinds
    }
    explicit_count = sum(group.count for group in scene.particles.values()) - sum(scalable.values())
    if most is None or explicit_count + sum(scalable.values()) <= most:
        return {}
    share = max(most - explicit_count, 0) / sum(scalable.values()) if scalable else 1.0
    return {name: max(int(share * count), 1) for name, count in scalable.items()}


SERIES = "timeseries.csv"
RECORD = "compare_run.npz"
"""File in the directory of a run with what the comparison needs of it, apart from timeseries.csv."""
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

    @property
    def meters(self) -> list[str]:
        """Names of the flow meters."""
        return [name.partition(".")[2] for name in self.columns if name.startswith("flow_mass.")]

    def mass_flow(self, meter: str) -> float:
        """Steady mass flow rate [kg/s] through a meter, as reported by `granflow run`
        (`flow_meters.steady_flow`)."""
        columns = (self.columns[name].tolist() for name in ("time", "stage", f"flow_mass.{meter}"))
        return steady_flow(list(zip(*columns, strict=True)))

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
        "time_step": run.time_step,
        "step_limit": run.step_limit,
        "step_count": run.step_count,
        "time": run.time,
        "seconds": run.seconds,
        "compile_seconds": run.compile_seconds,
        "stopped": run.stopped,
        "typical_speed": run.typical_speed,
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
    forces = ForceHistogram()
    followed = FollowedContacts([arrays["observed"]], [arrays["has_ended"]])
    forces.counts = {stage: arrays[f"force_counts_{k}"] for k, stage in enumerate(numbers["stages"])}
    keys = (
        "time_step",
        "step_limit",
        "step_count",
        "time",
        "seconds",
        "compile_seconds",
        "stopped",
        "typical_speed",
    )
    columns = dict(read_run(out).timeseries_arrays)
    return VariantRun(
        variant,
        **{key: numbers[key] for key in keys},
        columns=columns,
        heights=arrays["heights"],
        forces=forces,
        followed=followed,
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


def hertz_duration(scene: Scene, velocity: float) -> float:
    """Duration [s] of the shortest elastic collision in the scene at an approach velocity [m/s] (Eq. 13, e =
    1)."""
    durations = []
    for pair_case in automatic_plan(scene).pair_cases:
        k = theory.hertz_stiffness(pair_case.pair.modulus_eff, pair_case.radius_eff)
        durations.append(float(theory.duration(1.0, k, pair_case.mass_eff, velocity)))
    return min(durations)


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
    Returns the runs, and the reasons of rejected variants by title. Raises GranflowError if no variant can
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
    return ran, refused


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


def _last(name: str, run: VariantRun) -> float:
    """Last value of a column."""
    return run.columns[name][-1]
