from __future__ import annotations

from mavcal.service.vehicle.boot_time import BootClock
from mavcal.service.vehicle.kin import WITH_ID_S, WITHOUT_ID_S, clocks_agree


def running(start: float, *, speed: float = 1.0, late: float = 0.0, seconds: float = 3.0) -> BootClock:
    """The clock of a vehicle that was started `start` s before ours, over a link with a delay."""
    clock = BootClock()
    for k in range(int(seconds / 0.25) + 1):
        clock.see((start + 0.25 * k) * speed, 100.0 + 0.25 * k + late)
    return clock


def test_only_several_stamps_from_before_are_a_restart() -> None:
    clock = BootClock()
    assert not any(clock.see(stamp, 0.0) for stamp in (50.0, 60.0, 40.0, 60.1, 58.0, 60.2))
    assert (clock.latest, clock.restarts) == (60.2, 0)
    assert [clock.see(stamp, 1.0) for stamp in (1.0, 1.1, 1.2, 1.3)] == [False, False, True, False]
    assert (clock.latest, clock.restarts) == (1.3, 1)


def test_one_late_stamp_at_a_time_never_adds_up() -> None:
    clock = BootClock()
    for _ in range(10):
        clock.see(100.5, 0.0)
        clock.see(90.0, 0.0)
    assert (clock.latest, clock.restarts) == (100.5, 0)


def test_two_links_to_one_vehicle_have_one_clock_whatever_their_delay_and_its_speed() -> None:
    for speed in (1.0, 20.0):
        assert clocks_agree(running(40.0, speed=speed), running(40.0, speed=speed, late=0.3), WITHOUT_ID_S)
        assert clocks_agree(running(40.0, speed=speed), running(40.0, speed=speed, late=2.0), WITH_ID_S)
        assert not clocks_agree(running(40.0, speed=speed), running(47.0, speed=speed), WITH_ID_S)
        assert not clocks_agree(running(40.0, speed=speed), running(40.8, speed=speed), WITHOUT_ID_S)


def test_nothing_is_said_of_a_clock_that_was_hardly_heard() -> None:
    assert clocks_agree(running(40.0), BootClock(), WITH_ID_S) is None
    assert clocks_agree(running(40.0, seconds=0.0), running(40.0), WITH_ID_S) is None


def test_after_an_absence_the_next_stamp_is_the_first() -> None:
    clock = running(40.0)
    clock.forget()
    assert not any(clock.see(stamp, 200.0) for stamp in (1.0, 1.1, 1.2, 1.3))
    assert clock.restarts == 0
