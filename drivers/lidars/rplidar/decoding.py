"""The decoder for each response type with measurements."""

from __future__ import annotations

from ...errors import DriverError
from ..measurements import Decoder
from . import dense, express, hq, standard, ultra, ultra_dense
from .capsules import CapsuleDecoder
from .hq import HqDecoder
from .responses import Descriptor, ResponseType
from .standard import StandardDecoder

CAPSULES = {format.response_type: format for format in (express.FORMAT, ultra.FORMAT, dense.FORMAT, ultra_dense.FORMAT)}
SIZES = {
    ResponseType.STANDARD: standard.SIZE,
    ResponseType.HQ: hq.LAYOUT.itemsize,
    **{ResponseType(response_type): format.size for response_type, format in CAPSULES.items()},
}
"""Bytes of a packet, by response type."""


def decoder_for(response_type: int, sample_period: float, baud: float, triangulates: bool) -> Decoder:
    """Return the decoder for a scan mode's response type; raises DriverError if it is unknown.

    sample_period  seconds between samples
    baud           of the port, bits per second
    triangulates   of the model (see `models.Model`)
    """
    if response_type == ResponseType.STANDARD:
        return StandardDecoder(sample_period, baud, triangulates)
    if response_type == ResponseType.HQ:
        return HqDecoder(sample_period, baud)
    if response_type in CAPSULES:
        return CapsuleDecoder(CAPSULES[response_type], sample_period, baud)
    raise DriverError(f"measurements of type 0x{response_type:02X} are unknown")


def descriptor_of(response_type: int) -> Descriptor:
    """Return the descriptor that a device sends before measurements of a type; raises DriverError if it is unknown."""
    for known, size in SIZES.items():
        if known == response_type:
            return Descriptor(size, True, response_type)
    raise DriverError(f"measurements of type 0x{response_type:02X} are unknown")
