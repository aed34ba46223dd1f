"""Sessions as earlier versions have written them."""

from typing import Any


def remove_odometry_stamps(checkpoint: dict[str, Any]) -> None:
    """Remove the stamps of the readings of odometry from the checkpoint in the header of a session."""
    fixes = [checkpoint["tracker"]["fix"], checkpoint["tracker"]["reference"], checkpoint["anchor"]]
    for fix in [*fixes, checkpoint.get("learned_until") or {"odometry_stamp": None}]:
        del fix["odometry_stamp"]
