"""Serial lidars: what their bytes mean, in both directions. Nothing here opens a port, waits or asks for the time.

A decoder takes bytes as they come and gives `Measurements`; `revolutions` makes a `Scan` of every turn. Beside every
decoder stands the encoder of the same format, so that an emulated device and tests speak the same layouts.

    records      the one form in which every lidar's measurements come out
    framing      packets of one length found in a stream that may have lost bytes
    revolutions  measurements cut into one scan a turn
    rplidar      all RPLIDARs
    ld06         LDROBOT LD06 and LD19
    scip         Hokuyo's SCIP 2.0
"""
