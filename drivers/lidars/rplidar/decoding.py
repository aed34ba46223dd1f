"""The decoder for each type of answer with measurements."""

from __future__ import annotations

from ...errors import DriverError
from ..records import Decoder
from . import dense, express, hq, standard, ultra, ultra_dense
from .answers import Answer, Descriptor
from .capsules import CapsuleDecoder
from .hq import HqDecoder
from .standard import StandardDecoder

CAPSULES = {format.answer: format for format in (express.FORMAT, ultra.FORMAT, dense.FORMAT, ultra_dense.FORMAT)}
SIZES = {
    Answer.STANDARD: standard.SIZE,
    Answer.HQ: hq.LAYOUT.itemsize,
    **{Answer(answer): format.size for answer, format in CAPSULES.items()},
}
"""Bytes of a packet."""


def decoder_for(answer: int, sample_period: float, baud: float, corrected: bool) -> Decoder:
    """The decoder of a scan mode's type of answer; raises DriverError where there is none.

    sample_period  seconds between samples
    baud           of the port, bits a second
    corrected      whether the model triangulates (see `models.Model`)
    """
    if answer == Answer.STANDARD:
        return StandardDecoder(sample_period, baud, corrected)
    if answer == Answer.HQ:
        return HqDecoder(sample_period, baud)
    if answer in CAPSULES:
        return CapsuleDecoder(CAPSULES[answer], sample_period, baud)
    raise DriverError(f"measurements of type 0x{answer:02X} are unknown")


def descriptor_of(answer: int) -> Descriptor:
    """What a device sends before measurements of that type; raises DriverError where it is unknown."""
    for known, size in SIZES.items():
        if known == answer:
            return Descriptor(size, True, answer)
    raise DriverError(f"measurements of type 0x{answer:02X} are unknown")
