"""Pin poses and walls of a map to surveyed coordinates: test them, move the map into their frame, and solve again."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from drivers import se2

from ...io.sessions.corrections import Pin, PinSet
from ...mapping.frame_change import change_frame
from ...mapping.mapper import Mapper
from ...measuring.wall_map import WallMap
from .pin_adjustment import Adjustment, adjust
from .pin_places import PinnedVariables, PinPlaces, PinTarget, rotation

UNKNOWN_HEADING_SIGMA = 1.0
"""Radians; standard deviation of a heading that was not surveyed, which the rest of the map determines."""


def apply_pins(mapper: Mapper, places: PinPlaces, correction: PinSet, wall_map: WallMap) -> dict[str, Any]:
    """Pin a map that has converged, and solve its graph again; return what became of each pin.

    places    of the robot at the stamps of pinned poses
    wall_map  walls of the map

    A map without earlier pins and without a plan is moved into the frame of the survey; otherwise the pins must be in
    the frame of the map. Pins that are grossly wrong are left out. Raises MapError if a pin names nothing in the map,
    or if the pins do not determine the place of the map or contradict each other.
    """
    pins, fixed = correction.pins, bool(mapper.graph.pins() or mapper.graph.plan_walls())
    targets = [places.target(pin) for pin in pins]
    adjustment = _adjusted(pins, PinnedVariables(mapper, wall_map, pins, targets), fixed=fixed)
    if not fixed:
        change_frame(mapper, se2.inverse(adjustment.motion))
    before = [_difference(mapper, pin, target) for pin, target in zip(pins, targets, strict=True)]
    for pin, target, used in zip(pins, targets, adjustment.used.tolist(), strict=True):
        if used:
            _add_factor(mapper, pin, target)
    mapper.graph.update()
    mapper.graph.update_until_converged()
    mapper.read_back_all()
    after = [_difference(mapper, pin, target) for pin, target in zip(pins, targets, strict=True)]
    return _outcome(pins, adjustment, before, after)


def _adjusted(pins: Sequence[Pin], variables: PinnedVariables, *, fixed: bool) -> Adjustment:
    """Return the adjustment of all pins."""
    values, names = variables.values(pins), [pin.name for pin in pins]
    # where along a wall a pin is depends on the motion
    motion = adjust(values, names, variables.covariance(values, np.zeros(3)), fixed=fixed).motion
    return adjust(values, names, variables.covariance(values, motion), fixed=fixed)


def _surveyed_pose(pin: Pin, estimate: se2.Pose) -> tuple[se2.Pose, float]:
    """Return the surveyed pose, with the heading of the map if that was not surveyed, and its deviation."""
    if pin.heading is None or pin.sigma_heading is None:
        return np.array([pin.x, pin.y, estimate[2]]), UNKNOWN_HEADING_SIGMA
    heading = pin.heading
    if pin.kind == "wall" and np.cos(heading - estimate[2]) < 0.0:  # a line has no direction
        heading += np.pi
    return np.array([pin.x, pin.y, se2.wrap(heading)]), pin.sigma_heading


def _add_factor(mapper: Mapper, pin: Pin, target: PinTarget) -> None:
    """Add the factor of a pin to the graph of a map that is in its frame."""
    covariance = np.array([[pin.xx, pin.xy], [pin.xy, pin.yy]])
    if target.keyframe is None:
        wall = int(pin.id)
        frame = mapper.graph.wall_frames([wall])[0]
        pose, sigma = _surveyed_pose(pin, frame)
        along = float(se2.between(pose, frame)[0])
        normal = np.array([-np.sin(pose[2]), np.cos(pose[2])])
        lever = np.array([[1.0, along], [0.0, 1.0]])
        at_point = np.diag([float(normal @ covariance @ normal), sigma**2])
        mapper.graph.add_pinned_wall(wall, se2.compose(pose, np.array([along, 0.0, 0.0])), lever @ at_point @ lever.T)
        return
    pose, sigma = _surveyed_pose(pin, se2.compose(mapper.keyframe_poses[target.keyframe], target.relative))
    axes = rotation(float(pose[2]))
    own = np.zeros((3, 3))
    own[:2, :2], own[2, 2] = covariance, sigma**2
    own = axes.T @ own @ axes + target.covariance
    adjoint = se2.adjoint(target.relative)
    mapper.graph.add_pinned_pose(
        target.keyframe, se2.compose(pose, se2.inverse(target.relative)), adjoint @ own @ adjoint.T
    )


def _difference(mapper: Mapper, pin: Pin, target: PinTarget) -> float:
    """Return the distance of the surveyed point from its place in the map, metres."""
    if target.keyframe is None:
        frame = mapper.graph.wall_frames([int(pin.id)])[0]
        return abs(float(se2.between(frame, np.array([pin.x, pin.y, 0.0]))[1]))
    place = se2.compose(mapper.keyframe_poses[target.keyframe], target.relative)
    return float(np.hypot(pin.x - place[0], pin.y - place[1]))


def _outcome(
    pins: Sequence[Pin], adjustment: Adjustment, before: Sequence[float], after: Sequence[float]
) -> dict[str, Any]:
    """Return the result as plain data for summary.json; distances in metres."""
    rows = [
        {
            "name": pin.name,
            "used": used,
            "checked": bool(np.isfinite(p_value)),
            "p_value": p_value,
            "before": one,
            "after": other,
        }
        for pin, used, p_value, one, other in zip(
            pins, adjustment.used.tolist(), adjustment.p_value.tolist(), before, after, strict=True
        )
    ]
    return {"pins": rows, "chi2": adjustment.chi2, "dof": adjustment.dof}
