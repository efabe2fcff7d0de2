"""Actuators, airframe and air: which force or torque of a simulator differs from the real one."""
