"""`wclm devices`: serial ports, connected devices and their counters."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from ..console import print_if_slow, print_message

if TYPE_CHECKING:
    from drivers.devices.device_spec import DeviceSpec

CONSOLE = "not probed; to use it, switch the console off"


def devices(
    specs: Annotated[
        list[str] | None,
        typer.Argument(metavar="SPEC", help="Devices, e.g. rplidar:/dev/ttyUSB0; by default all serial ports."),
    ] = None,
    watch: Annotated[bool, typer.Option("--watch", help="Start the devices and show their counters.")] = False,
    seconds: Annotated[
        float | None,
        typer.Option("--for", metavar="SECONDS", help="Duration of --watch in seconds; by default until Ctrl-C."),
    ] = None,
) -> None:
    """List serial ports and the lidars and wheel bases connected to them.

    No base moves: each port is probed for a base first, as some queries for lidars are motion commands of some bases.

    Example: [bold]wclm devices rplidar:/dev/ttyUSB0 create2:/dev/ttyUSB1 --watch[/bold]
    """
    from drivers.devices.device_spec import parse_devices

    if seconds is not None and not watch:
        raise typer.BadParameter("has no effect without --watch", param_hint="--for")
    requested = parse_devices(" + ".join(specs)) if specs else []
    if watch:
        if not requested:
            raise typer.BadParameter("--watch needs at least one device", param_hint="SPEC")
        _watch(requested, seconds)
    elif requested:
        _identify(requested)
    else:
        _list()


def _list() -> None:
    from concurrent.futures import ThreadPoolExecutor

    from drivers.devices.ports import built_in_ports, serial_ports
    from drivers.devices.probing import probe

    ports = [*serial_ports(), *built_in_ports()]
    if not ports:
        print_message("no serial port found; is an adapter connected?")
    with ThreadPoolExecutor() as pool, print_if_slow("probing the serial ports; takes up to half a minute"):
        answers = pool.map(lambda port: CONSOLE if port.is_console else probe(port.path), ports)
        for port, answer in zip(ports, answers, strict=True):
            typer.echo(f"{port.path}  {port.description}\n    {answer}")


def _identify(specs: list[DeviceSpec]) -> None:
    from drivers.devices.probing import identify

    for spec in specs:
        typer.echo(f"{spec.text}\n    {identify(spec)}")


def _watch(specs: list[DeviceSpec], seconds: float | None) -> None:
    from drivers.devices.acquisition import Acquisition

    from ..acquisition_loop import receive_messages, stop_on_signals
    from ..device_monitor import DeviceMonitor

    with Acquisition(specs) as acquisition, stop_on_signals(acquisition), DeviceMonitor() as monitor:
        for _ in receive_messages(acquisition, seconds, lambda: monitor.show(acquisition.snapshot)):
            pass
    for device in acquisition.snapshot.devices:
        typer.echo(f"{device.spec}\n    {device.identity}")
        typer.echo("\n".join(f"    {name:<22} {count:10d}" for name, count in device.counters.items()))
