"""Metrics of a running service for Prometheus; loaded when they are first asked for."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable

from prometheus_client import CONTENT_TYPE_LATEST, CollectorRegistry, generate_latest
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

from mavcal.service.core import Service

CONTENT_TYPE = CONTENT_TYPE_LATEST


def counted(service: Service) -> bytes:
    """Every counter, written out."""
    registry = CollectorRegistry(auto_describe=False)
    registry.register(_Counts(service))
    return generate_latest(registry)


class _Counts(Collector):
    def __init__(self, service: Service) -> None:
        self._service = service

    def collect(self) -> Iterable[Metric]:
        labels = ["vehicle", "link"]
        received = CounterMetricFamily("mavcal_frames_received", "MAVLink frames received", labels=labels)
        lost = CounterMetricFamily("mavcal_frames_lost", "MAVLink frames lost", labels=labels)
        for vehicle in self._service.vehicles.all():
            for link in vehicle.links:
                counted = link.statistics(vehicle.system, vehicle.component)
                received.add_metric([vehicle.id, link.id], counted.received)
                lost.add_metric([vehicle.id, link.id], counted.lost)
        jobs = GaugeMetricFamily("mavcal_jobs", "Jobs by state", labels=["state"])
        for state, count in Counter(job.state.value for job in self._service.jobs.list()).items():
            jobs.add_metric([state], count)
        links = GaugeMetricFamily("mavcal_links", "Links by state", labels=["state"])
        for state, count in Counter(link.state.value for link in self._service.links.all()).items():
            links.add_metric([state], count)
        return [received, lost, jobs, links]
