"""MAVLink frames: from bytes to headers and payloads, and back.

A frame is cut out of the bytes and its checksum is verified. Only :func:`calib.wire.codec.decode` builds the dialect's
message object, which costs several times more than the cut.
"""
