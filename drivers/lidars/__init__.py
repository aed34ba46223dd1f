"""Protocols of serial lidars, in both directions. Nothing here opens a port, waits or reads a clock.

A decoder converts bytes, in any chunks, to `Measurements`; `revolutions` makes a `Scan` of every turn. Next to every
decoder is the encoder of the same format, so that emulated devices and tests use the same layouts.

    measurements  the common form of every lidar's measurements
    framing       packets of fixed length in a stream that may have lost bytes
    revolutions   measurements cut into one scan per revolution
    rplidar       all RPLIDARs
    ld06          LDROBOT LD06 and LD19
    scip          Hokuyo's SCIP 2.0: commands and replies
    scip_scan     Hokuyo's SCIP 2.0: measurements
"""
