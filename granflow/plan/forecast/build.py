"""All forecasts of a scene that need no particles."""

from collections.abc import Iterator, Sequence

from granflow.contact.laws import ContactLaws
from granflow.load import Scene
from granflow.plan.forecast.drop import forecast_velocity
from granflow.plan.forecast.files import file_warnings
from granflow.plan.forecast.insertion import insertion_warnings
from granflow.plan.forecast.overlaps import Forecast, impact_forecast, static_forecasts
from granflow.plan.forecast.pairs import touching_pairs
from granflow.plan.forecast.pressures import bed_pressures
from granflow.plan.forecast.regions import region_warnings
from granflow.plan.forecast.servos import servo_warnings
from granflow.plan.forecast.units import unit_warnings
from granflow.plan.forecast.walls import size_warnings, wall_warnings
from granflow.plan.max_impact_velocity import ImpactVelocity
from granflow.plan.wall_control import ControlledMotion
from granflow.plan.walls import PlannedWall


def forecasts_of(
    scene: Scene,
    laws: ContactLaws,
    impact_velocity: ImpactVelocity,
    walls: Sequence[PlannedWall],
    controlled: Sequence[ControlledMotion],
) -> Iterator[Forecast]:
    """Forecasts of overlaps, walls, regions and servos."""
    pairs = list(touching_pairs(scene))
    expected = forecast_velocity(scene, tuple(walls), impact_velocity)
    impact = impact_forecast(scene, laws, pairs, expected.value, expected.source)
    if impact is not None:
        yield impact
    static = list(static_forecasts(scene, laws, pairs, bed_pressures(scene, walls, controlled)))
    yield from static
    explained = max((each.overlap for each in static), default=0.0)
    for sentence in (
        *file_warnings(scene.particles, explained, 0.0 if impact is None else impact.overlap),
        *size_warnings(scene),
        *wall_warnings(scene, walls),
        *region_warnings(scene, walls),
        *servo_warnings(scene, walls, controlled),
        *insertion_warnings(scene),
        *unit_warnings(scene),
    ):
        yield Forecast("", "", sentence, sentence)
