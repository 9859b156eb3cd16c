"""The number of threads follows what is fastest now, told by launches alone."""

from granflow.device.crew import Crew


def work(crew, speed, launches, waits_above=99):
    """Launches of 0.1 s in which `size` threads do `speed[size]` units; the sizes used."""
    used = []
    for _ in range(launches):
        size = crew.next_size
        used.append(size)
        crew.record(0.1 * speed[size], 0.1, waited=size > waits_above)
    return used


def test_all_threads_stay_where_they_are_faster():
    crew = Crew(4)
    used = work(crew, {1: 1.0, 2: 1.9, 4: 3.6}, 400)
    assert crew.size == 4
    assert used.count(4) > 380, "trials of fewer threads are rare"


def test_long_waits_halve_the_crew_at_once_and_it_comes_back_when_they_end():
    crew, speed = Crew(4), {1: 1.0, 2: 1.9, 4: 3.6}
    work(crew, {1: 1.0, 2: 0.3, 4: 0.1}, 12, waits_above=1)
    assert crew.size == 1
    work(crew, speed, 200)
    assert crew.size == 4


def test_fewer_threads_are_found_where_more_are_slower():
    crew = Crew(4)
    work(crew, {1: 1.0, 2: 0.9, 4: 0.5}, 400)
    assert crew.size == 1


def test_a_launch_too_short_to_tell_changes_nothing():
    crew = Crew(2)
    for _ in range(100):
        crew.record(1, 1e-4 if crew.next_size == 1 else 1e-3, waited=False)
    assert crew.size == 2
