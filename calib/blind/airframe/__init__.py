"""The foreign generator of the airframe's withheld-effect check.

A rigid body with rotors, air, battery, autopilot and log, written from physics; cases whose cause is withheld; and the
scores of what a diagnosis answered. It shares no code with ``calib.airframe``: it knows the diagnosis only by the JSON
that it prints, so that the check has two authors. Frames are those of the project: body forward-right-down, world
north-east-down.
"""
