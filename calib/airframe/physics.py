"""The forward model of a multicopter: force and torque from commands and motion, one formula an effect (AIRFRAME 2).

Force is the specific force at the inertial unit, m/s2; torque is the angular acceleration, rad/s2. Both are divided by
mass or inertia, since only ratios are observable. A parameter vector is one flight's airframe; :class:`Layout` names
its elements.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.airframe.flown import FlownFlight, on_grid
from mavcal.calib.airframe.geometry import arms
from mavcal.calib.airframe.nameless import columns_of, names_of
from mavcal.calib.airframe.signals import Grid
from mavcal.calib.recording import Sensor

Array = NDArray[np.float64]

AXES: Final = ("x", "y", "z")
PRODUCTS: Final[tuple[str, ...]] = ("xy", "xz", "yz")
_FALLING_ROUNDS: Final = 2
"""Iterations after which a different lag for falling commands is accurate to 1 % of a doublet. Measured."""
_PLAIN: Final = (
    "k", "expo", "sag", "c1", "cz", "c2_x", "c2_y", "ch", "climb", "wind_north", "wind_east", "bias_x", "bias_y",
    "bias_z", "lever_x", "lever_y", "lever_z", "gain_x", "gain_y", "gain_z", "damping_x", "damping_y", "damping_z",
    "torque_x", "torque_y", "torque_z", "cg_x", "cg_y", "spin_up", "flap_x", "flap_y", "cross_x", "cross_y", "cross_z",
    "tau", "fall", "delay", "scale", "load", "rise", "product_xy", "product_xz", "product_yz",
)  # fmt: skip
_OF_THRUST: Final = ("delay", "tau", "fall", "expo", "sag")
_OF_ROTORS: Final = ("k", "c1", "cz", "climb", "wind_north", "wind_east")
_OF_FORCE: Final = ("c2_x", "c2_y", "ch", "load")
_OF_TORQUE: Final = ("torque_x", "torque_y", "torque_z", "cg_x", "cg_y", "spin_up", "flap_x", "flap_y", "gain_x",
                     "gain_y", "gain_z")  # fmt: skip
"""Parameters of each step of a prediction, in addition to those of the previous step. Thrust also depends on the
parameters of each motor. A step is recomputed only if one of its parameters changes."""
_LEAST_TURNED: Final = 1e-3
"""Mass over inertia of an axis, 1/m2, used if the gain is not positive. Chosen, not measured: small beside 100."""
_REMEMBERED: Final = 2
"""Cached results of a step: at the point of a derivative, and at the last shifted point."""
FORCE_ONLY: Final = frozenset(
    {
        "cz",
        "c1",
        "c2_x",
        "c2_y",
        "ch",
        "climb",
        "scale",
        "load",
        "wind_north",
        "wind_east",
        *(f"{n}_{a}" for n in ("bias", "lever") for a in AXES),
    }
)
TORQUE_ONLY: Final = frozenset(
    {*(f"{n}_{a}" for n in ("gain", "damping", "torque", "cross") for a in AXES), "cg_x", "cg_y", "spin_up", "flap_x",
     "flap_y", "rise", "product_xy", "product_xz", "product_yz"}
)  # fmt: skip


@dataclass(frozen=True)
class Layout:
    """Names of the parameters of an airframe with `motors` motors, in their order.

    ====================  ==============================================================================================
    k                     thrust over mass of all motors at full command, m/s2
    expo                  curve of one motor: (1 - expo) x + expo x^2
    sag                   exponent of V/V0
    c1, cz                drag that is linear in the air velocity, 1/s at hover: in the rotor plane, along the axis
    c2_x, c2_y            drag of the body by the square of its speed, 1/m: along x, along y; their mean along z
    ch, climb             lift by horizontal speed, 1/m; thrust lost by the square of the climb, 1/m
    gain_x y z            angular acceleration at a full differential command, rad/s2
    damping_x y z         1/s
    torque_x y z          constant, rad/s2
    cg_x, cg_y            centre of mass forward and right of the motors' centre, arms
    spin_up               reaction of the rotors' own inertia, s
    flap_x, flap_y        torque by air velocity at hover, rad/s2 per m/s
    cross_x y z           torque by products of rates
    tau, fall             lag of the motors, s; how much longer it is where a command falls, s
    delay                 of the commands, s
    scale                 of the accelerometer, relative, about what it reads at rest: there, bias_z is the whole error
    load                  mass that is gained at one moment, relative
    rise                  damping by the inflow that a climb or a tilt in wind adds, over the gain of the axis, s2/m
    product_xy xz yz      product of inertia over the moment of its second axis
    weak_1 ..., pulse_1   of one motor beside the others, relative: its thrust, or the pulse that it obeys
    ====================  ==============================================================================================
    """

    motors: int
    free: tuple[str, ...] = ()

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of all parameters; those of nameless effects are last."""
        each = (f"{name}_{i + 1}" for name in ("weak", "pulse") for i in range(self.motors))
        return (*_PLAIN, *each, *self.free)

    @cached_property
    def place(self) -> Mapping[str, int]:
        """Index of each parameter by its name."""
        return {name: k for k, name in enumerate(self.names)}

    def start(self, hover: float, gravity: float) -> Array:
        """Parameters of a plain airframe that hovers at the mean command `hover`."""
        theta = np.zeros(len(self.names))
        plain = {"expo": 0.5, "c1": 0.3, "c2_x": 0.02, "c2_y": 0.02, "damping_x": 1.0, "damping_y": 1.0}
        for name, value in plain.items():
            theta[self.place[name]] = value
        theta[self.place["k"]] = gravity / max(0.5 * hover + 0.5 * hover**2, 0.05)
        for axis, gain in zip(AXES, (100.0, 100.0, 5.0), strict=True):
            theta[self.place[f"gain_{axis}"]] = gain
        return theta


class _Step:
    """One step of a prediction, with its latest results cached by the parameters at `places`."""

    def __init__(self, places: Sequence[int], compute: Callable[[Array], Any]) -> None:
        self._places, self._compute = np.array(places), compute
        self._results: dict[bytes, Any] = {}

    def __call__(self, theta: Array) -> Any:
        """Result of the step at `theta`."""
        told = theta[self._places].tobytes()
        found = self._results.pop(told) if told in self._results else self._compute(theta)
        if len(self._results) >= _REMEMBERED:
            del self._results[next(iter(self._results))]
        self._results[told] = found  # the last one that was asked for is kept longest
        return found


@dataclass(frozen=True)
class Kind:
    """Force model of a family of vehicles or simulators; the same for both flights of a pair.

    `drag_by_rotor`: linear drag grows with the rotors' speed; `yaw_by_command`: the yaw reaction is proportional to
    command times thrust, as in ArduPilot's simulator. `drag_turns`: drag acts at the rotors, and damps turns. In
    ArduPilot's simulator of 2023 it acted at the centre (``SIM_Motor.cpp`` took the torque before the drag).
    """

    drag_by_rotor: bool = True
    yaw_by_command: bool = False
    drag_turns: bool = True

    @property
    def rotors_damp(self) -> bool:
        """Whether the rotors' drag also sets the damping."""
        return self.drag_by_rotor and self.drag_turns


class Airframe:
    """The forward model on one flight.

    Parameters
    ----------
    flight
        Commands and motion.
    kind
        See :class:`Kind`.
    full_voltage
        Voltage at which k is stated, V; None: voltage has no effect.
    spin_low
        Pulse at which a motor starts to turn, relative to the range of c: a weak pulse is reduced by it even at c = 0.
    slew
        Fastest change of a motor's command, 1/s; None: without limit.
    torque
        Whether torque is judged.
    loaded_at
        When the mass may have changed, s; None: it did not.
    """

    def __init__(
        self,
        flight: FlownFlight,
        kind: Kind,
        full_voltage: float | None,
        *,
        spin_low: float = 0.1875,
        slew: float | None = None,
        torque: bool = True,
        loaded_at: float | None = None,
    ) -> None:
        self.flight, self.kind, self.spin_low, self.slew = flight, kind, spin_low, slew
        self.full_voltage, self.loaded_at, self._torque_judged = full_voltage, loaded_at, torque
        self._loaded = np.zeros(len(flight.t)) if loaded_at is None else (flight.t >= loaded_at).astype(np.float64)
        self._dt = 1.0 / flight.fs
        self._x, self._y, self._spin = arms(flight.geometry.motors)
        self._lever = max(np.abs(self._x).max(), np.abs(self._y).max())
        known = full_voltage is not None and flight.has_voltage
        self._log_v = np.log(np.maximum(flight.voltage, 1.0) / full_voltage) if known else np.zeros(len(flight.t))
        self.body_from_local = _body_from_local(flight.q)

        w = flight.rate
        self._products = np.column_stack([w[:, 1] * w[:, 2], w[:, 2] * w[:, 0], w[:, 0] * w[:, 1]])
        self.free = columns_of(flight, self._over_ground(), self.body_from_local, torque=torque)
        self.layout = Layout(flight.c.shape[1], names_of(self.free))
        self._grid = Grid(len(flight.t), flight.fs)
        self._filters = {s: self._grid.butterworth(flight.cutoff_hz.get(s, 0.0)) for s in (Sensor.ACCEL, Sensor.GYRO)}
        place = self.layout.place
        each = [f"{n}_{i + 1}" for n in ("weak", "pulse") for i in range(self.layout.motors)]
        of_thrust = [place[n] for n in (*_OF_THRUST, *each)]
        of_rotors = [*of_thrust, *(place[n] for n in _OF_ROTORS)]
        self._thrusts = _Step(of_thrust, self._thrusts_of)
        self._rotors = _Step(of_rotors, self._rotors_of)
        self._force = _Step([*of_rotors, *(place[n] for n in _OF_FORCE)], self._force_of)
        self._torque = _Step([*of_rotors, *(place[n] for n in _OF_TORQUE)], self._torque_of)
        self._air: tuple[float, float, Array] | None = None
        self._commanded = self._grid.spectrum(flight.c if slew is None else _limited(flight, slew))

    def changed(self, *, slew: float | None = None, loaded_at: float | None = None) -> Airframe:
        """The same flight with another rate limit of the commands, or time of a load change; None: unchanged."""
        return Airframe(
            self.flight,
            self.kind,
            self.full_voltage,
            spin_low=self.spin_low,
            slew=self.slew if slew is None else slew,
            torque=self._torque_judged,
            loaded_at=self.loaded_at if loaded_at is None else loaded_at,
        )

    def hovering(self, theta: Array, kept: Sequence[str]) -> Array:
        """A plain airframe whose thrust is linear and balances gravity at the usual command; `kept` as in `theta`."""
        plain = np.zeros_like(theta)
        for name in kept:
            plain[self.layout.place[name]] = theta[self.layout.place[name]]
        plain[self.layout.place["k"]] = self.flight.gravity / max(float(np.median(self.flight.c)), 0.05)
        return plain

    def _over_ground(self) -> Array:
        return np.asarray(np.einsum("nij,nj->ni", self.body_from_local, self.flight.velocity))

    @cached_property
    def free_signals(self) -> Array:
        """Force and torque (F, N, 6) by one unit of each nameless parameter, filtered as the sensors are."""
        made = [c.spread() for c in self.free]
        for rows in made:
            for at, sensor in ((slice(0, 3), Sensor.ACCEL), (slice(3, 6), Sensor.GYRO)):
                if rows[:, at].any():
                    rows[:, at] = self._grid.through(rows[:, at], self._filters[sensor])
        return np.array(made)

    @property
    def measured(self) -> tuple[Array, Array]:
        """Force (N, 3), m/s2, and torque (N, 3), rad/s2."""
        return self.flight.force, self.flight.acceleration

    @property
    def voltage_span(self) -> float:
        """Relative change of the voltage in flight, 5th to 95th percentile; 0 where it is not known."""
        return float(np.expm1(np.ptp(np.percentile(self._log_v, (5.0, 95.0)))))

    @property
    def voltage_off(self) -> float:
        """Relative difference of the voltage from `full_voltage`; 0 where either is not known."""
        return float(np.expm1(abs(np.median(self._log_v))))

    def predicted(self, theta: Array) -> tuple[Array, Array]:
        """Force and torque (N, 3) as the filtered sensors would show them."""
        force = self._force(theta) + self._at_unit(theta)
        force = force + theta[self.layout.place["scale"]] * (force + np.array([0.0, 0.0, self.flight.gravity]))
        torque = self._coupled(theta, self._torque(theta) + self._by_rates(theta))
        nameless = theta[len(theta) - len(self.free) :]
        if nameless.any():
            beyond = np.tensordot(nameless, self.free_signals, axes=1)
            return force + beyond[:, :3], torque + beyond[:, 3:]
        return force, torque

    def thrusts(self, theta: Array) -> tuple[Array, Array, Array]:
        """Normalised thrust (N, n) of each motor, its yaw reaction, and the rotors' relative speeds."""
        found: tuple[Array, Array, Array] = self._thrusts(theta)
        return found

    def _thrusts_of(self, theta: Array) -> tuple[Array, Array, Array]:
        of = self._of(theta)
        weak, pulse = (np.array([of(f"{n}_{i + 1}") for i in range(self.layout.motors)]) for n in ("weak", "pulse"))
        x = self._followed(of("delay"), of("tau"), of("fall"))
        if pulse.any():
            x = np.clip(x * (1.0 + pulse) + pulse * self.spin_low, 0.0, None)
        expo = of("expo")
        unit = x * (1.0 - expo) + expo * x**2
        thrust = unit * np.exp(of("sag") * self._log_v)[:, None] * (1.0 + weak)
        return thrust, (thrust * x if self.kind.yaw_by_command else thrust), np.sqrt(np.clip(unit, 0.0, None))

    def _of(self, theta: Array) -> Callable[[str], float]:
        place = self.layout.place
        return lambda name: float(theta[place[name]])

    def _followed(self, delay: float, tau: float, fall: float) -> Array:
        """Commands as the motors follow them (N, n): delayed, rate-limited, with a first-order lag.

        A longer lag for falling commands is computed as the plain lag of a command that is extended by its own rate of
        fall.
        """
        grid, response = self._grid, self._grid.behind(delay, tau)
        found = grid.series(self._commanded, response)
        if fall:
            late = grid.series(self._commanded, grid.behind(delay, 0.0))
            for _ in range(_FALLING_ROUNDS):
                falling = np.minimum(np.gradient(found, self._dt, axis=0), 0.0)
                found = grid.through(late - fall * falling, grid.behind(0.0, tau))
        return found

    def air_velocity(self, theta: Array) -> Array:
        """Velocity through the air, body axes (N, 3)."""
        of = self._of(theta)
        north, east = of("wind_north"), of("wind_east")
        if self._air is None or self._air[:2] != (north, east):
            moving = self.flight.velocity - np.array([north, east, 0.0])
            self._air = north, east, np.asarray(np.einsum("nij,nj->ni", self.body_from_local, moving))
        return self._air[2]

    def _rotors_of(self, theta: Array) -> tuple[Array, Array, Array]:
        """Specific forces of each rotor along x, y and z, (N, n) each, acting at the rotor."""
        of, thrust = self._of(theta), self.thrusts(theta)[0]
        k, v, n = of("k"), self.air_velocity(theta), self.layout.motors
        drive = self._drive(thrust, k)
        across = (-of("c1") / n) * drive
        climb = of("climb") * self._inflow(theta) ** 2
        along = (-k / n) * thrust - (of("cz") / n) * drive * v[:, 2:] + climb[:, None] / n
        return across * v[:, :1], across * v[:, 1:2], along

    def _inflow(self, theta: Array) -> Array:
        """Airspeed along the thrust (N,), m/s; 0 in a descent."""
        return np.clip(-self.air_velocity(theta)[:, 2], 0.0, None)

    def _drive(self, thrust: Array, k: float) -> Array:
        """Speed of each rotor relative to hover (N, n); 1 for a vehicle whose drag does not depend on it."""
        if not self.kind.drag_by_rotor:
            return np.ones_like(thrust)
        return np.sqrt(np.clip(thrust, 0.0, None) * (max(k, 1.0) / self.flight.gravity))

    def _force_of(self, theta: Array) -> Array:
        """Force of rotors and body (N, 3), filtered as the accelerometer is."""
        of, v, rotors = self._of(theta), self.air_velocity(theta), self._rotors(theta)
        of_body = np.array([of("c2_x"), of("c2_y"), 0.5 * (of("c2_x") + of("c2_y"))])
        f = np.column_stack([each.sum(axis=1) for each in rotors]) - of_body * v * np.abs(v)
        f[:, 2] -= of("ch") * (v[:, 0] ** 2 + v[:, 1] ** 2)
        if load := of("load"):
            f /= (1.0 + load * self._loaded)[:, None]
        return self._grid.through(f, self._filters[Sensor.ACCEL])

    def _at_unit(self, theta: Array) -> Array:
        """Contribution of the unit's position and offsets, from the measured rates, which are already filtered."""
        of = self._of(theta)
        lever = np.array([of(f"lever_{a}") for a in AXES])
        w = self.flight.rate
        turn = np.cross(self.flight.acceleration, lever) + np.cross(w, np.cross(w, lever))
        return np.asarray(turn + np.array([of(f"bias_{a}") for a in AXES]))

    def _torque_of(self, theta: Array) -> Array:
        """Torque of the rotors (N, 3), filtered as the gyroscope is."""
        of, v, rotors = self._of(theta), self.air_velocity(theta), self._rotors(theta)
        thrust, turning, spinning = self.thrusts(theta)
        n, k = self.layout.motors, of("k")
        x, y = self._x - of("cg_x"), self._y - of("cg_y")
        by_x, by_y, by_z = self._turned_by(theta)
        flapping = v * self._drive(thrust, k).mean(axis=1)[:, None]
        along = rotors[2] if self.kind.drag_turns else (-k / n) * thrust
        roll = by_x * (along @ y) + of("torque_x") - of("flap_x") * flapping[:, 1]
        pitch = -by_y * (along @ x) + of("torque_y") + of("flap_y") * flapping[:, 0]
        yaw = of("gain_z") * (turning @ self._spin) / n + of("torque_z")
        yaw += of("gain_z") * of("spin_up") * np.gradient(spinning @ self._spin, self._dt) / n
        if self.kind.rotors_damp:
            yaw += by_z * (rotors[1] @ x - rotors[0] @ y)
        return self._grid.through(np.column_stack([roll, pitch, yaw]), self._filters[Sensor.GYRO])

    def _coupled(self, theta: Array, torque: Array) -> Array:
        """The angular acceleration (N, 3) with products of inertia, from that without them."""
        products = theta[[self.layout.place[f"product_{pair}"] for pair in PRODUCTS]]
        if not products.any():
            return torque
        x, y, z = root = 1.0 / np.sqrt(self._turned_by(theta))  # of the moments of inertia, in one unit for all axes
        xy, xz, yz = products * (y / x, z / x, z / y)  # over the root of both moments
        gyroscopic = np.tensordot(products * (y * y, z * z, z * z), self._twists, axes=1) / root**2
        whole = np.array([[1.0, xy, xz], [xy, 1.0, yz], [xz, yz, 1.0]])
        return np.asarray((torque - gyroscopic) @ (np.linalg.inv(whole) * root / root[:, None]).T)

    @cached_property
    def _twists(self) -> Array:
        """Cross product (3, N, 3) of the rate with the angular momentum of each product of inertia of one."""
        p, q, r = self.flight.rate.T
        xy = np.column_stack([-r * p, q * r, p * p - q * q])
        xz = np.column_stack([p * q, r * r - p * p, -q * r])
        yz = np.column_stack([q * q - r * r, -p * q, r * p])
        return np.array([xy, xz, yz])

    def _turned_by(self, theta: Array) -> Array:
        """Mass over inertia of each axis (3,), 1/m2: gain over thrust at its arm; of a flat body, I_z = I_x + I_y."""
        of = self._of(theta)
        x, y = (max(of(f"gain_{a}") / (of("k") * self._lever), _LEAST_TURNED) for a in "xy")
        return np.array([x, y, 1.0 / (1.0 / x + 1.0 / y)])

    def _by_rates(self, theta: Array) -> Array:
        """Torque from body rates: products of rates, and damping.

        Damping grows with the inflow, since a rotor's thrust falls with the square of it.
        """
        of = self._of(theta)
        damping = np.array([of(f"damping_{a}") for a in AXES])
        cross = np.array([of(f"cross_{a}") for a in AXES])
        rising = of("rise") * np.array([of("gain_x"), of("gain_y"), 0.0])
        damped = damping + self._inflow(theta)[:, None] * rising
        return np.asarray(-damped * self.flight.rate + cross * self._products)


def _limited(flight: FlownFlight, most: float) -> Array:
    """Commands on the grid (N, n), rate-limited to `most` 1/s at the logged rate."""
    told = flight.commands
    steps = most * np.diff(told.t, prepend=told.t[0])
    return on_grid(flight.t, told.t, slewed(told.c, steps), told.rate_hz)


def slewed(c: Array, most: Array) -> Array:
    """`c` (N, n), limited to a change of `most` (N,) from row to row."""
    steps = most.tolist()
    out = []
    for column in c.T.tolist():  # plain floats: a row of numpy takes ten times as long
        state, kept = column[0], []
        for value, step in zip(column, steps, strict=True):
            state = min(max(value, state - step), state + step)
            kept.append(state)
        out.append(kept)
    return np.array(out).T


def _body_from_local(q: Array) -> Array:
    """Rotations (N, 3, 3) that take local vectors to body axes."""
    w, x, y, z = q.T
    local = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    return np.asarray(local.transpose(2, 1, 0))
