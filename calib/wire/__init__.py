"""MAVLink frames in bytes: to headers and payloads, and back.

A frame is cut out of the bytes, its checksum is verified, and nothing else happens until somebody asks:
:func:`calib.wire.codec.decode` builds the dialect's message object, which costs several times more than the cut.
"""
