"""Devices on ports: found, started, read in a process of their own, and halted.

device_spec     the user's text: `rplidar:/dev/ttyUSB0?mode=Standard + create2:/dev/ttyUSB1`
device          interface of all devices: identify, start, step, halt
lidar, rplidar, ld06, scip, wheel_base   the devices
registry        from a device spec to its device
external_lidars drivers of lidars in other packages
device_clock    a device's clock fitted to the host's
packet_stamper  from the arrival of bytes to stamps
ports           connections, and the list of serial ports
supervisor      runs one device, with its reconnections
reorder_buffer  the messages of all devices in time order, bounded
reading_process, outbox  the reading process, and its queue to the consumer
acquisition     the consumer's side of the reading process
snapshot        status of all devices
device_source   devices as a `Source`
recorder        writes the messages and the devices' status to a file, in the reading process
probing         identifies the device on a port
"""
