"""A simulated multicopter that flies: airframe, controller, MAVLink and a DataFlash log, faster than real time.

Its airframe has the equations and the key names of ArduPilot's SITL (``SIM_Frame.cpp``, ``SIM_Motor.cpp``). Its
firmware has the mixer, filters and log messages of ArduCopter, as far as a diagnosis of the airframe needs them. Modes,
estimator and controller are the minimum for GUIDED, and for a mission in AUTO.

Order of the modules: `frame`, `parameters` (what is read from files) -> `air`, `airframe` (physics) -> `estimator`,
`control`, `items`, `modes`, `auto` (firmware) -> `vehicle` -> `flightlog` (what is logged) -> `ground` (MAVLink) ->
`run`.
"""
