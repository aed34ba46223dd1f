"""Slamtec's RPLIDARs: A1 to A3, S1 to S3, C1.

    requests     requests of the host
    responses    single responses: descriptors, identity, health, sample rates
    modes        the scan modes that a device reports, and the choice among them
    models       differences between the models
    decoding     the decoder for a scan mode's format
    standard, express, ultra, dense, ultra_dense, hq   formats of measurements, each with decoder and encoder
    capsules     common part of the capsule formats

All numbers on the wire are little-endian.
"""
