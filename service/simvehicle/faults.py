"""Faults on demand: impairments of the wire, errors of the vehicle, and their triggers.

Kinds and their options (`direction` is in, out or both, as the vehicle sees it; times in vehicle seconds except the
delays of the wire, which are the wall's)::

    loss, duplication, reordering, bit_errors, truncation   p, direction; last until `clear_faults`
    delay                delay_s, jitter_s, direction
    throttle             bytes_per_s (5760: a port of 57600 baud), buffer_bytes of the vehicle's port, direction
    reboot               flush (false: what is not saved is lost)
    silence              duration_s
    lost_echo, late_echo name (any), count, delay_s
    not_applied          name (or the one that triggers it): the value in force stays, the stored one changes
    foreign_write        name (or the one that triggers it), value, delay_s
    arm                  duration_s (for good)
    onboard_calibration  duration_s (until `clear_faults`)
    stuck, nan, absent   sensor (accel, gyro, mag), instance
    twin                 a second vehicle of the same system id
    move                 the vehicle goes on from another address
    cut                  link (0: the first): nothing passes on it in either direction
    disconnect           the TCP connection is cut; the ground station may connect again

Triggers: "now", {"time": t}, {"after_s": s}, {"nth_set": n} (the n-th PARAM_SET from now, before it acts).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

from mavcal.service.simvehicle.errors import ControlError
from mavcal.service.simvehicle.impairment import FaultyLink, Impairment
from mavcal.service.simvehicle.sensor_faults import SENSORS, SensorFault
from mavcal.service.simvehicle.vehicle import FlightController

DEFAULT_SILENCE_S = 5.0
DEFAULT_ECHO_DELAY_S = 1.5
PERSISTENT = ("loss", "duplication", "reordering", "delay", "bit_errors", "truncation", "throttle")


@dataclass
class Fault:
    """One fault that was asked for.

    Attributes:
        kind: its name.
        options: its own entries, as given.
        at_time: vehicle time of the stroke; None: not by time.
        nth_set: strikes with the n-th PARAM_SET received from now on; None: not by count.
        struck: when it struck, by the clock that goes on through restarts.
    """

    kind: str
    options: Mapping[str, Any]
    at_time: float | None = None
    nth_set: int | None = None
    struck: list[float] = field(default_factory=list)
    done: bool = False


class Site(Protocol):
    """Target of the faults: a vehicle, its links and its twins."""

    vehicle: FlightController
    """The vehicle."""

    links: Sequence[FaultyLink]
    """Impairments that its frames pass."""

    def add_twin(self) -> None:
        """Add another vehicle with the same system id."""

    def remove_twins(self) -> None:
        """Remove the other vehicles."""


class Injector:
    """Keeps pending faults, and applies each when it is due."""

    def __init__(self, site: Site) -> None:
        self._site = site
        self._faults: list[Fault] = []
        self._echoes: list[tuple[Fault, int]] = []
        self._kinds: dict[str, Callable[[Fault, str | None], None]] = {
            **dict.fromkeys(PERSISTENT, self._impair),
            "reboot": lambda f, _n: self._vehicle.reboot(flush=bool(f.options.get("flush", False))),
            "silence": self._silence,
            "lost_echo": lambda f, _n: self._echo(f),
            "late_echo": lambda f, _n: self._echo(f),
            "not_applied": self._not_applied,
            "foreign_write": self._foreign_write,
            "arm": lambda f, _n: self._arm(f),
            "onboard_calibration": lambda f, _n: self._onboard_calibration(f),
            "stuck": self._sensor,
            "nan": self._sensor,
            "absent": self._sensor,
            "twin": lambda _f, _n: self._site.add_twin(),
            "move": lambda _f, _n: self._move(),
            "cut": lambda f, _n: self._cut(f),
            "disconnect": lambda _f, _n: self._disconnect(),
        }
        site.vehicle.echo_filter = self._filter_echo

    @property
    def _vehicle(self) -> Any:
        return self._site.vehicle

    def arm(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """The `fault` verb. Raises ControlError where the kind, an option or the trigger makes no sense."""
        kind = request.get("kind")
        if kind not in self._kinds:
            raise ControlError(f"unknown fault {kind!r}; known: {', '.join(self._kinds)}")
        options = {k: v for k, v in request.items() if k not in ("kind", "trigger")}
        fault = Fault(str(kind), options, *self._trigger(request.get("trigger") or "now"))
        self._check(fault)
        self._faults.append(fault)
        if fault.at_time is None and fault.nth_set is None:
            self._strike(fault, None)
        return {"fault": len(self._faults) - 1}

    def _trigger(self, trigger: Any) -> tuple[float | None, int | None]:
        """Vehicle time and count of PARAM_SETs at which a fault begins; neither: at once."""
        if trigger == "now":
            return None, None
        if isinstance(trigger, Mapping) and "time" in trigger:
            return finite("trigger.time", trigger["time"]), None
        if isinstance(trigger, Mapping) and "after_s" in trigger:
            return self._vehicle.time + finite("trigger.after_s", trigger["after_s"]), None
        if isinstance(trigger, Mapping) and "nth_set" in trigger:
            return None, self._vehicle.set_count + int(finite("trigger.nth_set", trigger["nth_set"]))
        raise ControlError('trigger must be "now", {"time": t}, {"after_s": s} or {"nth_set": n}')

    def _check(self, fault: Fault) -> None:
        """Refuse a fault that could not be carried out later."""
        if fault.kind in PERSISTENT:
            _impairment_values(fault)
            _direction(fault)
        for name in ("duration_s", "delay_s", "count", "value", "instance", "link"):
            finite(name, fault.options.get(name, 0))
        if fault.kind == "cut" and not 0 <= int(fault.options.get("link", 0)) < len(self._site.links):
            raise ControlError(f"there is no link {fault.options['link']}")
        if fault.kind in ("not_applied", "foreign_write") and not (fault.nth_set and "name" not in fault.options):
            target = fault.options.get("name")
            if target not in self._vehicle.table:
                raise ControlError(f"{fault.kind} needs the name of a parameter of this vehicle, got {target!r}")
        if fault.kind in tuple(SensorFault) and fault.options.get("sensor", "accel") not in SENSORS:
            raise ControlError(f"unknown sensor {fault.options['sensor']!r}; known: {', '.join(SENSORS)}")

    def saw_set(self, count: int, name: str) -> None:
        """Apply faults due at a PARAM_SET that has arrived but not acted yet."""
        for fault in self._faults:
            if not fault.done and fault.nth_set == count:
                self._strike(fault, name)

    def tick(self) -> None:
        """Apply faults that are due by vehicle time."""
        for fault in self._faults:
            if not fault.done and fault.at_time is not None and self._vehicle.time >= fault.at_time:
                self._strike(fault, None)

    def _strike(self, fault: Fault, name: str | None) -> None:
        fault.done = True
        if fault.kind not in ("lost_echo", "late_echo"):  # these strike with the echo
            fault.struck.append(self._vehicle.elapsed)
        self._kinds[fault.kind](fault, name)

    def clear(self) -> None:
        """End every lasting fault, and drop pending ones."""
        for fault in self._faults:
            fault.done = True
        self._echoes.clear()
        for link in self._site.links:
            link.set_impairments(Impairment(), Impairment())
            link.cut = False
        self._vehicle.faults.clear()
        self._vehicle.table.unpin_all()
        self._vehicle.reload_calibration()
        self._vehicle.stop_onboard_calibration()
        self._vehicle.silent_until = -math.inf
        self._site.remove_twins()

    def report(self) -> list[dict[str, Any]]:
        """Every fault asked for, when it struck, and for one on the wire how many frames it has hit in all.

        `nth_set` counts PARAM_SETs since the start, as ``param_sets`` of the state does; null for another trigger.
        """
        return [
            {"kind": f.kind, **f.options, "nth_set": f.nth_set, "struck": f.struck, **self._hits(f)}
            for f in self._faults
        ]

    def _hits(self, fault: Fault) -> dict[str, int]:
        if fault.kind not in PERSISTENT:
            return {}
        return {"hits": sum(link.spoilt[fault.kind] for link in self._site.links)}

    # --- the strokes

    def _impair(self, fault: Fault, _name: str | None) -> None:
        direction, values = _direction(fault), _impairment_values(fault)
        for link in self._site.links:
            link.set_impairments(
                replace(link.incoming, **values) if direction != "out" else link.incoming,
                replace(link.outgoing, **values) if direction != "in" else link.outgoing,
            )

    def _silence(self, fault: Fault, _name: str | None) -> None:
        seconds = finite("duration_s", fault.options.get("duration_s", DEFAULT_SILENCE_S))
        self._vehicle.silent_until = self._vehicle.time + seconds

    def _echo(self, fault: Fault) -> None:
        self._echoes.append((fault, int(finite("count", fault.options.get("count", 1)))))

    def _filter_echo(self, name: str, echo: Callable[[], None]) -> None:
        """Send, drop or delay the echo of a PARAM_SET, by the faults."""
        for i, (fault, left) in enumerate(self._echoes):
            if fault.options.get("name", name) != name:
                continue
            fault.struck.append(self._vehicle.elapsed)
            self._echoes[i : i + 1] = [(fault, left - 1)] if left > 1 else []
            if fault.kind == "late_echo":
                self._vehicle.at(finite("delay_s", fault.options.get("delay_s", DEFAULT_ECHO_DELAY_S)), echo)
            return
        echo()

    def _not_applied(self, fault: Fault, name: str | None) -> None:
        target = fault.options.get("name", name)
        if target in self._vehicle.table:
            self._vehicle.table.pin(target)

    def _foreign_write(self, fault: Fault, name: str | None) -> None:
        target, value = fault.options.get("name", name), float(fault.options.get("value", 0.123))
        if target in self._vehicle.table:
            # After the PARAM_SET that triggered it, as from a competing ground station.
            delay = float(fault.options.get("delay_s", 0.0))
            self._vehicle.at(delay, lambda: self._vehicle.foreign_set(target, value))

    def _arm(self, fault: Fault) -> None:
        self._set_armed(armed=True)
        if "duration_s" in fault.options:
            self._vehicle.at(float(fault.options["duration_s"]), lambda: self._set_armed(armed=False))

    def _set_armed(self, *, armed: bool) -> None:
        self._vehicle.armed = armed
        self._vehicle.broadcast(self._vehicle.heartbeat())

    def _onboard_calibration(self, fault: Fault) -> None:
        self._vehicle.start_onboard_calibration()
        if "duration_s" in fault.options:
            self._vehicle.at(float(fault.options["duration_s"]), self._vehicle.stop_onboard_calibration)

    def _sensor(self, fault: Fault, _name: str | None) -> None:
        sensor = str(fault.options.get("sensor", "accel"))
        instance = int(finite("instance", fault.options.get("instance", 0)))
        self._vehicle.faults.set(sensor, instance, SensorFault(fault.kind))

    def _move(self) -> None:
        for link in self._site.links:
            link.move()

    def _cut(self, fault: Fault) -> None:
        self._site.links[int(fault.options.get("link", 0))].cut = True

    def _disconnect(self) -> None:
        for link in self._site.links:
            link.disconnect()


def _direction(fault: Fault) -> str:
    direction = fault.options.get("direction", "both")
    if direction not in ("in", "out", "both"):
        raise ControlError(f'direction must be "in", "out" or "both", got {direction!r}')
    return str(direction)


def _impairment_values(fault: Fault) -> dict[str, float]:
    if fault.kind == "delay":
        return {
            "delay_s": finite("delay_s", fault.options.get("delay_s", 0.2)),
            "jitter_s": finite("jitter_s", fault.options.get("jitter_s", 0.0)),
        }
    if fault.kind == "throttle":
        carried = finite("bytes_per_s", fault.options.get("bytes_per_s", 5760.0))
        if carried <= 0:
            raise ControlError(f"bytes_per_s must be above 0, got {carried}")
        return {"bytes_per_s": carried, "buffer_bytes": finite("buffer_bytes", fault.options.get("buffer_bytes", 512))}
    probability = finite("p", fault.options.get("p", 0.1))
    if not 0 <= probability <= 1:
        raise ControlError(f"p must be a probability, got {probability}")
    return {fault.kind: probability}


def finite(name: str, value: Any) -> float:
    """`value` as a number. Raises ControlError if it is none, or not finite."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise ControlError(f"{name} must be a finite number, got {value!r}")
    return float(value)
