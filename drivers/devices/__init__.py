"""Devices on ports: found, started, read in a process of their own, and halted.

specs        what a user types: `rplidar:/dev/ttyUSB0?mode=Standard + create2:/dev/ttyUSB1`
device       what all devices do: identify, start, step, halt
lidar, rplidar, ld06, scip, wheels   the devices
stamping     from the arrival of bytes to stamps
ports        connections, and the serial ports there are
session      the life of one device, with its recoveries
outlet       the messages of all devices in the order of time, bounded
acquisition  the process that reads, and the consumer's side of it
live         devices as a `Source`
probing      who answers on which port
"""
