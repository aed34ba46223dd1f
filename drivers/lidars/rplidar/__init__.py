"""Slamtec's RPLIDARs: A1 to A3, S1 to S3, C1.

    requests     what the host sends
    answers      what comes back once: descriptors, identity, health, rates
    modes        the scan modes that a device tells, and the choice among them
    models       what differs from model to model
    decoding     the decoder for a scan mode's format
    standard, express, ultra, dense, ultra_dense, hq   the formats of measurements, each decoded and encoded
    capsules     what the capsule formats have in common

All numbers on the wire are little-endian.
"""
