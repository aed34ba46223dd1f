"""Map arrays of scans and odometry, read covariances, compare with a reference, and plot with matplotlib.

    python examples/map_arrays.py [picture.svg]

The arrays are those of a simulated drive; replace them by your own.
"""

import sys

import numpy as np

import drivers
from drivers import GroundTruth, Odometry, Scan, se2
from slam import Slam
from slam.evaluation.metrics import score_reference
from slam.io.tum import Trajectory
from slam.io.wall_maps import settled_wall_map

messages = list(drivers.open("sim:room?duration=20"))
scans = [message for message in messages if isinstance(message, Scan)]
readings = [message for message in messages if isinstance(message, Odometry)]
truths = [message for message in messages if isinstance(message, GroundTruth)]
scan_stamps, ranges = np.array([one.stamp for one in scans]), np.array([one.ranges for one in scans])  # (n,), (n, b)
angles, offsets = scans[0].angles, scans[0].time_offsets  # (b,) each: radians counter-clockwise, seconds; zeros if none
odometry_stamps = np.array([one.stamp for one in readings])  # (m,) seconds
odometry = np.array([one.pose for one in readings])  # (m, 3) x, y, heading from wherever it starts
reference = Trajectory(np.array([one.stamp for one in truths]), np.array([one.pose for one in truths]))

mount = np.array([0.1, 0.0, 0.0])  # x, y, heading of the lidar on the robot
inputs = [Odometry(stamp, pose) for stamp, pose in zip(odometry_stamps, odometry, strict=True)]
inputs += [
    Scan(stamp, row, angles, offsets, range_min=0.1, range_max=30.0, mount=mount)  # NaN for no-returns
    for stamp, row in zip(scan_stamps, ranges, strict=True)
]
pipeline = Slam()
for message in sorted(inputs, key=lambda one: one.stamp):
    pipeline.add(message)
result = pipeline.finish()
print(result)

# Walls: the covariance (2, 2) of each is that of its offset across the wall (metres) and of its heading (radians).
longest = int(np.argmax(result.walls.high - result.walls.low))
sigma_offset, sigma_heading = np.sqrt(np.diag(result.walls.covariance[longest]))
print(
    f"wall {result.walls.identity[longest]}: ± {1e3 * sigma_offset:.1f} mm, ± {np.degrees(sigma_heading):.3f} degrees"
)
# The errors of walls are correlated: for distances and angles take the joint covariance (2 n, 2 n) of all of them.
joint = settled_wall_map(pipeline.slam_state.mapper).covariance
print(f"joint covariance of {len(result.walls)} walls: {joint.shape}")

# Keyframes: poses with covariances (k, 3, 3) in each pose's own frame. `poses` are those at all stamps, without.
worst = int(np.argmax(np.trace(result.keyframes.covariance[:, :2, :2], axis1=1, axis2=2)))
sigmas = np.sqrt(np.diag(result.keyframes.covariance[worst]))
print(f"least certain keyframe {worst}: ± {1e3 * sigmas[0]:.1f} mm ahead, ± {1e3 * sigmas[1]:.1f} mm to its left")

score = score_reference(Trajectory(result.stamps, result.poses), reference)  # both are aligned first
print(f"error of the path (RMS): {1e3 * score.figures()['ate_rmse']:.1f} mm")

if len(sys.argv) > 1:
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots()
    for begin, end in result.walls.piece_points()[0]:  # observed pieces of walls: doors stay open
        axes.plot(*np.array([begin, end]).T, color="black")
    axes.plot(*result.poses[:, :2].T, label="path")
    true = se2.compose(se2.inverse(score.alignment), reference.poses)  # into the map
    axes.plot(*true[:, :2].T, "--", label="reference")
    turns = np.linspace(0.0, 2.0 * np.pi, 50)
    for pose, covariance in zip(result.keyframes.poses, result.keyframes.covariance, strict=True):
        ellipse = 100.0 * np.linalg.cholesky(covariance[:2, :2]) @ np.stack([np.cos(turns), np.sin(turns)])
        corners = se2.compose(pose, np.column_stack([ellipse.T, np.zeros(len(turns))]))  # from the pose's own frame
        axes.plot(*corners[:, :2].T, color="tab:blue", linewidth=0.5)
    axes.set_aspect("equal")
    axes.set_title("ellipses: 100 standard deviations")
    axes.legend()
    figure.savefig(sys.argv[1])
