"""Scans of a second lidar are paired with those of the first, whatever the order of their arrival."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import pairwise

import numpy as np
import pytest

from drivers.messages import Scan
from slam.preprocessing.deskew import sweep_middle
from slam.preprocessing.scan_queue import MAX_ABSENCE, MAX_QUEUED_SCANS, MAX_QUEUED_SECONDS, ScanPair, ScanQueue

COUNT = 60


def scans(lidar: int, rate: float, start: float, jitter: float = 0.0, count: int = COUNT) -> list[Scan]:
    """Return scans whose sweep takes the whole period."""
    noise = np.random.default_rng(lidar).uniform(-jitter, jitter, count)
    beams = np.ones(3), np.linspace(-1.0, 1.0, 3), np.linspace(0.0, 1.0 / rate, 3)
    return [Scan(start + k / rate + noise[k], *beams, 0.1, 10.0, lidar=lidar) for k in range(count)]


def pair_up(messages: Iterable[Scan], queue: ScanQueue | None = None, covered: float = np.inf) -> list[ScanPair]:
    queue = ScanQueue(two_lidars=True) if queue is None else queue
    pairs = []
    for scan in messages:
        queue.add(scan)
        while (pair := queue.take(covered)) is not None:
            pairs.append(pair)
    while (pair := queue.take(covered, flush=True)) is not None:
        pairs.append(pair)
    return pairs


def by_arrival(messages: Iterable[Scan], delays: tuple[float, float]) -> list[Scan]:
    """Return the scans in the order in which they arrive, `delays` seconds after their sweep."""
    return sorted(messages, key=lambda scan: scan.stamp + scan.duration + delays[scan.lidar])


@pytest.mark.parametrize("offset", [-0.05, -0.02, 0.0, 0.03, 0.05])
@pytest.mark.parametrize("rate", [5.0, 10.0, 13.0, 40.0])
def test_pairs_do_not_depend_on_the_arrival(offset: float, rate: float) -> None:
    both = [*scans(0, 10.0, 7.0, 0.005), *scans(1, rate, 7.0 + offset, 0.05 / rate, int(6 * rate))]
    orders = [sorted(both, key=lambda scan: scan.stamp)]
    orders += [by_arrival(both, delays) for delays in ((0.0, 0.0), (0.05, 0.0), (0.0, 0.05))]
    found = [[(p.first.stamp, p.second and p.second.stamp) for p in pair_up(order)] for order in orders]
    assert all(pairs == found[0] for pairs in found)
    assert [first for first, _ in found[0]] == sorted(scan.stamp for scan in both if not scan.lidar)
    joined = [second for _, second in found[0] if second is not None]
    assert all(a < b for a, b in pairwise(joined))
    assert len(joined) >= 0.95 * min(1.0, rate / 10.0) * COUNT - 2
    for first, second in pair_up(orders[0]):
        assert second is None or abs(sweep_middle(first) - sweep_middle(second)) < 0.1


def test_scans_at_the_same_time_are_paired() -> None:
    both = sorted([*scans(0, 10.0, 7.0), *scans(1, 10.0, 7.0)], key=lambda scan: scan.stamp)
    assert all(second is not None and first.stamp == second.stamp for first, second in pair_up(both))


def test_without_odometry_the_second_scan_is_not_later() -> None:
    both = sorted([*scans(0, 10.0, 7.0), *scans(1, 10.0, 7.03)], key=lambda scan: scan.stamp)
    pairs = pair_up(both, ScanQueue(two_lidars=True, predicts_odometry=True))
    assert all(second is not None and second.stamp < first.stamp for first, second in pairs[1:])


def test_a_lidar_that_falls_silent_is_waited_for_no_longer() -> None:
    queue, waiting, taken = ScanQueue(two_lidars=True), [], 0
    for scan in sorted([*scans(0, 10.0, 7.0), *scans(1, 10.0, 7.0, count=20)], key=lambda scan: scan.stamp):
        queue.add(scan)
        while queue.take(np.inf) is not None:
            taken += 1
        waiting.append(len(queue))
    assert max(waiting) <= MAX_ABSENCE * 10 + 1
    assert waiting[-1] == 0
    assert taken == COUNT


def test_a_single_lidar_waits_for_odometry_only() -> None:
    queue = ScanQueue()
    first, second = scans(0, 10.0, 7.0, count=2)
    queue.add(first)
    queue.add(second)
    assert queue.take(7.05) is None
    assert queue.take(7.1) == ScanPair(first)
    assert queue.take(7.1) is None
    assert queue.take(7.2) == ScanPair(second)


@pytest.mark.parametrize("rate", [1.0, 10.0, 40.0])
def test_odometry_is_not_waited_for_too_long(rate: float) -> None:
    """Once it has not come for long, no scan waits until it goes on."""
    queue, taken = ScanQueue(), 0
    waiting = max(MAX_QUEUED_SCANS, round(rate * MAX_QUEUED_SECONDS))
    for count, scan in enumerate(scans(0, rate, 7.0, count=2 * waiting), start=1):
        queue.add(scan)
        while queue.take(7.0) is not None:
            taken += 1
        if count <= waiting:
            assert taken == 0
        elif count > waiting + 1:
            assert taken == count
    latest = scans(0, rate, 500.0, count=1)[0]
    queue.add(latest)
    assert queue.take(499.0) is None
    assert queue.take(latest.stamp + latest.duration) is not None


def test_readings_that_arrive_in_bursts_are_waited_for() -> None:
    queue, rate = ScanQueue(), 10.0
    waiting = scans(0, rate, 0.0, count=round(rate * MAX_QUEUED_SECONDS) + 1)
    for scan in waiting:
        queue.add(scan)
    covered = waiting[-1].stamp + waiting[-1].duration
    while queue.take(covered) is not None:
        pass
    assert not len(queue)
    queue.add(scans(0, rate, covered, count=1)[0])
    assert queue.take(covered) is None
