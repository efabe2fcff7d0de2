"""Closes the loop between a real flight and a simulator: fly, diagnose, set, fly again.

The simulator is whatever a command starts and MAVLink flies. Order of the modules: `settings`, `simulator`, `logs` (a
round's files and process) -> `link`, `autopilot`, `proof` (it is a simulator), `conversation`, `mission`, `pilot` (its
flight), `follower` (its flight of a log's mission) -> `rounds` (what was measured), `work` (what is kept) -> `loop` ->
`report` (words and a page).
"""
