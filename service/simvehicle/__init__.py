"""Simulated flight controllers that speak real MAVLink: ArduPilot and PX4 personalities in a process of their own.

An independent second reading of the facts that `calib.firmware` encodes: nothing of `calib` or of the rest of
`service` is imported here, so that the two readings check each other.

Way of a sample, once per tick of the wall clock: `motion` (attitude, body rate) and `thermal` (temperature) drive
`sensors` (raw = M·true + b + p(T) + noise), `corrections` applies the firmware's own formulas with the parameters
in force, the personality (`ardupilot`, `px4`) quantises and packs what was asked for, `faults` spoils it, `links`
sends it. Units inside: s, m/s², rad/s, µT, °C, A; FRD body and NED frames; quaternions w x y z, body to NED.
"""
