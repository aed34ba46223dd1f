"""Serial ports of the board itself, such as the UARTs on the pins of a Raspberry Pi, which have no adapter's name."""

from __future__ import annotations

from pathlib import Path

TERMINALS = Path("/sys/class/tty")
"""Directory of the system with all terminals."""
DEVICE_TREE_LEVELS = 3
"""Directories above a port's device in which the entry of its UART in the device tree is looked for."""


def board_ports() -> dict[str, bool]:
    """Return the paths of the UARTs that the board's device tree describes, and whether the system's console is there.

    PCs have no device tree: their built-in ports mostly lead nowhere and are left out.
    """
    if not TERMINALS.is_dir():
        return {}
    consoles = _consoles()
    return {
        f"/dev/{entry.name}": entry.name in consoles
        for entry in sorted(TERMINALS.iterdir())
        if (entry / "device").exists() and _is_uart_of_board((entry / "device").resolve())
    }


def _is_uart_of_board(device: Path) -> bool:
    """Return whether a terminal's device is a UART in the device tree; adapters on USB are not, whatever is above."""
    if any(part.startswith("usb") for part in device.parts):
        return False
    return any((folder / "of_node").exists() for folder in [device, *device.parents][: DEVICE_TREE_LEVELS + 1])


def _consoles() -> set[str]:
    """Return the names of the terminals on which the system prints and a login may wait."""
    try:
        return set((TERMINALS / "console" / "active").read_text(encoding="ascii").split())
    except OSError:
        return set()
