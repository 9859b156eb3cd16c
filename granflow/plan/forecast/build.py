"""All forecasts of a scene that need no particles."""

from collections.abc import Iterator

from granflow.load import Scene
from granflow.plan.forecast.clumps import clump_warnings
from granflow.plan.forecast.drop import forecast_velocity, path_velocity, velocity_warnings
from granflow.plan.forecast.files import file_warnings
from granflow.plan.forecast.forecast import Forecast
from granflow.plan.forecast.insertion import flow_warnings, insertion_warnings
from granflow.plan.forecast.intervals import interval_warnings, vibration_forecasts
from granflow.plan.forecast.overlaps import impact_forecast, static_forecasts, supported_forecast
from granflow.plan.forecast.pairs import supported_pairs, touching_pairs
from granflow.plan.forecast.pressures import bed_pressures
from granflow.plan.forecast.regions import region_warnings
from granflow.plan.forecast.servos import servo_warnings
from granflow.plan.forecast.sizes import size_warnings
from granflow.plan.forecast.times import nominal_times
from granflow.plan.forecast.units import unit_warnings
from granflow.plan.forecast.walls import coincidence_warnings, wall_warnings
from granflow.plan.plan import Plan


def forecasts_of(scene: Scene, plan: Plan) -> Iterator[Forecast]:
    """Forecasts of overlaps, walls, regions and servos; `plan`: that of the scene, without forecasts."""
    pairs, times = list(touching_pairs(plan)), nominal_times(plan.stages)
    supported = list(supported_pairs(scene, plan))
    hitting = [*pairs, *(pair for pair, _weight in supported)]
    expected = forecast_velocity(scene, plan)
    impact = impact_forecast(plan, hitting, expected.value, expected.source)
    if impact is not None and impact.warning is not None:  # the paths over the walls take time
        expected = path_velocity(scene, plan)
        impact = impact_forecast(plan, hitting, expected.value, expected.source)
    if impact is not None:
        yield impact
    static = list(static_forecasts(plan, pairs, bed_pressures(scene, plan)))
    below = supported_forecast(plan, supported)
    static += [] if below is None else [below]
    yield from static
    yield from vibration_forecasts(scene)
    explained = max((each.overlap for each in static), default=0.0)
    for sentence in (
        *file_warnings(scene.particles, explained, 0.0 if impact is None else impact.overlap),
        *size_warnings(scene),
        *clump_warnings(scene),
        *wall_warnings(scene, plan.walls, times),
        *coincidence_warnings(scene, plan.walls),
        *region_warnings(scene, plan, times),
        *servo_warnings(scene, plan, times),
        *insertion_warnings(scene, plan, times),
        *flow_warnings(scene, plan),
        *interval_warnings(scene, times),
        *unit_warnings(scene),
        *velocity_warnings(scene, plan),
    ):
        yield Forecast("", "", sentence, sentence)
