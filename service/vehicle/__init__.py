"""Vehicles: identity, state with its evidence, streams, parameters and commands, on top of links."""
