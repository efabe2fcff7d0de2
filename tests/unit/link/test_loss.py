from __future__ import annotations

import random
from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mavcal.service.link.loss import SequenceCounter
from tests.examples import examples


def steady(
    counter: SequenceCounter, frames: int, rate: float = 200.0, start: int = 0, t: float = 0.0
) -> tuple[int, float]:
    """A sender that loses nothing; returns the next sequence and time."""
    for _ in range(frames):
        counter.see(start & 0xFF, t, 40)
        start, t = start + 1, t + 1 / rate
    return start, t


@pytest.mark.parametrize("lost", [1, 7, 60, 200, 255, 257, 300, 700, 1000, 5000])
def test_a_silence_is_worth_what_the_senders_rate_says(lost: int) -> None:
    counter = SequenceCounter()
    sequence, t = steady(counter, 600)
    steady(counter, 10, start=sequence + lost, t=t + lost / 200.0)
    assert counter.lost == lost
    assert counter.lost_inferred == lost // 256 * 256
    assert (counter.duplicated, counter.out_of_order) == (0, 0)


@pytest.mark.parametrize("lost", [3, 255, 256, 512, 700, 92_673])
def test_what_the_socket_dropped_is_counted_exactly(lost: int) -> None:
    counter = SequenceCounter()
    sequence, t = steady(counter, 600)
    for k in range(10):  # read at once after a stall: arrival times tell nothing
        counter.see((sequence + lost + k) & 0xFF, t, 40, dropped=lost)
    assert counter.lost == lost


def test_a_stream_that_was_switched_off_is_not_loss() -> None:
    counter = SequenceCounter()
    sequence, t = steady(counter, 600)
    counter.see(sequence & 0xFF, t + 1.0, 21)
    counter.see((sequence + 1) & 0xFF, t + 2.0, 21)
    assert counter.lost == 0


def test_doubled_and_late_frames_are_told_apart_from_lost_ones() -> None:
    counter = SequenceCounter()
    sequence, t = steady(counter, 300)
    for k, number in enumerate((sequence, sequence, sequence + 2, sequence + 1, sequence + 3, sequence + 1)):
        counter.see(number & 0xFF, t + 0.005 * k, 40)
    assert (counter.lost, counter.out_of_order, counter.duplicated) == (0, 1, 2)
    assert counter.received == 306


@pytest.mark.parametrize("late", [2, 40, 90, 120])
def test_a_frame_that_comes_much_later_is_late_and_not_a_wrap(late: int) -> None:
    counter = SequenceCounter()
    sequence, t = steady(counter, 600, rate=1000.0)
    held = sequence
    sequence, t = steady(counter, late, rate=1000.0, start=sequence + 1, t=t + 0.001)
    assert counter.lost == 1
    counter.see(held & 0xFF, t, 40)
    steady(counter, 300, rate=1000.0, start=sequence, t=t)
    assert (counter.lost, counter.out_of_order, counter.duplicated) == (0, 1, 0)


def test_rates_are_those_of_the_last_moment() -> None:
    counter = SequenceCounter()
    _, t = steady(counter, 600)
    statistics = counter.statistics(4, t)
    assert statistics.frames_per_s == pytest.approx(200, rel=0.03)
    assert statistics.bytes_per_s == pytest.approx(8000, rel=0.03)
    assert statistics.crc_errors == 4
    assert counter.statistics(0, t + 10).bytes_per_s == 0


def test_the_lost_share() -> None:
    counter = SequenceCounter()
    counter.see(0, 0.0, 40)
    counter.see(4, 0.01, 40)
    assert counter.statistics(0, 0.01).loss == pytest.approx(3 / 5)
    assert SequenceCounter().statistics(0, 0.0).loss == 0.0


@pytest.mark.parametrize("longest", [0.002, 0.15])
def test_a_rate_counts_all_frames_that_were_taken_together(longest: float) -> None:
    """However unevenly a busy machine takes what has come, the rate is right; and so is what rests on it."""
    counter, rate, draw = SequenceCounter(), 2000, random.Random(5)
    k, now, rates = 0, 0.0, set[float]()
    while k < 20_000:
        now += max(0.002, longest * draw.random())
        while k / rate <= now:
            counter.see(k & 0xFF, now, 41)
            k += 1
        if now > 1.5:
            rates.add(counter.frames_per_s)
    assert len(rates) > 5
    assert min(rates) == pytest.approx(rate, rel=0.01)
    assert max(rates) == pytest.approx(rate, rel=0.01)


@settings(max_examples=examples(50))
@given(st.lists(st.booleans(), min_size=2, max_size=600), st.integers(0, 255))
def test_received_and_lost_together_are_what_was_sent_between_the_first_and_the_last(
    arrived: list[bool], start: int
) -> None:
    """The second count: by the sender, who knows what it sent."""
    came = [n for n, arrives in enumerate(arrived) if arrives]
    counter = SequenceCounter()
    for n in came:
        counter.see((start + n) & 0xFF, n / 200.0, 40)
    short = all(b - a < 100 for a, b in pairwise(came))
    assert counter.received == len(came)
    if came and short:
        assert counter.received + counter.lost == came[-1] - came[0] + 1
        assert (counter.duplicated, counter.out_of_order, counter.lost_inferred) == (0, 0, 0)


@settings(max_examples=examples(30))
@given(st.lists(st.integers(0, 4), min_size=20, max_size=200), st.randoms(use_true_random=False))
def test_frames_that_swap_with_near_ones_are_late_and_none_is_lost(shifts: list[int], draw: random.Random) -> None:
    order = sorted(range(len(shifts)), key=lambda n: n + shifts[n] + draw.random() / 2)
    order.insert(0, order.pop(order.index(0)))  # what comes before the first is of an earlier life
    counter = SequenceCounter()
    for k, n in enumerate(order):
        counter.see(n & 0xFF, k / 200.0, 40)
    newest, late = -1, 0
    for n in order:
        late += n < newest
        newest = max(newest, n)
    assert (counter.lost, counter.out_of_order, counter.duplicated) == (0, late, 0)


@pytest.mark.parametrize("gone", [1, 90, 133, 200, 255, 256])
def test_a_silence_of_half_a_minute_is_an_absence_and_a_shorter_one_is_loss(gone: int) -> None:
    """Sequence numbers after an absence say nothing: the vehicle may have been restarted meanwhile."""
    counter = SequenceCounter()
    sequence, t = steady(counter, 600)
    steady(counter, 300, start=sequence + gone, t=t + 30.0)
    assert (counter.lost, counter.lost_inferred, counter.duplicated, counter.out_of_order) == (0, 0, 0, 0)
    assert counter.received == 900


def test_a_silence_of_almost_half_a_minute_is_worth_what_the_rate_says() -> None:
    counter = SequenceCounter()
    sequence, t = steady(counter, 600)
    lost = round(29.9 * 200)
    steady(counter, 10, start=sequence + lost, t=t + 29.9)
    assert counter.lost == lost


def test_the_first_frame_says_nothing_about_loss_whatever_its_number() -> None:
    for first in (0, 1, 200, 255):
        counter = SequenceCounter()
        counter.see(first, 5.0, 40)
        counter.see((first + 1) & 0xFF, 5.01, 40)
        assert (counter.received, counter.lost, counter.duplicated) == (2, 0, 0)


@pytest.mark.parametrize(("share", "lost"), [(1.0, 1024), (0.25, 256)])
def test_a_sender_loses_its_share_of_what_the_socket_dropped(share: float, lost: int) -> None:
    counter = SequenceCounter()
    sequence, t = steady(counter, 600)
    counter.see((sequence + lost) & 0xFF, t, 40, dropped=1024, share=share)
    counter.see((sequence + lost + 1) & 0xFF, t + 0.005, 40, dropped=1024, share=share)  # told again, counted once
    assert (counter.lost, counter.lost_inferred) == (lost, lost)


def test_rates_last_for_two_seconds_after_the_last_window() -> None:
    counter = SequenceCounter()
    _, t = steady(counter, 601)
    assert counter.statistics(0, t + 1.9).frames_per_s > 0.0
    stale = counter.statistics(3, t + 2.6)
    assert (stale.frames_per_s, stale.bytes_per_s, stale.received, stale.crc_errors) == (0.0, 0.0, 601, 3)
