"""MAVLink frames in bytes: to headers and payloads, and back.

A frame is cut out of the bytes, its checksum is verified, and nothing else happens until somebody asks:
:func:`decode` builds the dialect's message object, which costs several times more than the cut itself.
"""

from __future__ import annotations

from mavcal.calib.wire.codec import (
    Message,
    ParamValue,
    RawMessage,
    decode,
    decode_param_value,
    encode,
    padded_payload,
    param_bytes,
    param_set,
    raw_message,
)
from mavcal.calib.wire.frames import CRC_EXTRA, Frame, FrameParser
from mavcal.calib.wire.parameters import (
    HASH_CHECK,
    NO_INDEX,
    HeardValue,
    ParameterEncoding,
    ParamType,
    heard_value,
    usual_encoding,
    value_from_bits,
)
from mavcal.calib.wire.signing import SignatureState, Signing, check_signature, sign, signing_time
from mavcal.calib.wire.texts import CHUNK_BYTES, joined_text, text_bytes
from mavcal.calib.wire.tlog import TlogReader, iter_tlog, tlog_record

__all__ = [
    "CHUNK_BYTES",
    "CRC_EXTRA",
    "HASH_CHECK",
    "NO_INDEX",
    "Frame",
    "FrameParser",
    "HeardValue",
    "Message",
    "ParamType",
    "ParamValue",
    "ParameterEncoding",
    "RawMessage",
    "SignatureState",
    "Signing",
    "TlogReader",
    "check_signature",
    "decode",
    "decode_param_value",
    "encode",
    "heard_value",
    "iter_tlog",
    "joined_text",
    "padded_payload",
    "param_bytes",
    "param_set",
    "raw_message",
    "sign",
    "signing_time",
    "text_bytes",
    "tlog_record",
    "usual_encoding",
    "value_from_bits",
]
