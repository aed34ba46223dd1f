"""Add a measurement of your own beside the graph: a surveyed mark at the end of a bare corridor.

python examples/own_factors.py corridor.svg

Nothing in a bare corridor shows how far along it the robot is, so odometry alone decides. A mark on the floor, whose
place was measured with a tape, determines the length of the map. The drawing has the path before (orange) and after
(blue), and the mark.
"""

import sys
from pathlib import Path

import gtsam
import numpy as np

import slam

mapped = slam.run("sim:bare_corridor?lidar=short&duration=60")
graph, values = mapped.factor_graph()
stamps, keyframes = mapped.finished.keyframes.stamps, mapped.finished.keyframes.poses
first, last = gtsam.symbol("x", 0), gtsam.symbol("x", len(keyframes) - 1)

# The distance between the first and the last keyframe as the tape measures it: here from the simulation.
assert mapped.truth is not None
start, mark = mapped.truth.at(stamps[[0, -1]]).poses
distance = float(np.hypot(*(mark - start)[:2]))

# The measurement has an accuracy of 1 cm. Any factor of GTSAM can be used.
graph.add(gtsam.RangeFactorPose2(first, last, distance, gtsam.noiseModel.Isotropic.Sigma(1, 0.01)))
optimised = gtsam.LevenbergMarquardtOptimizer(graph, values).optimize()

poses = [optimised.atPose2(gtsam.symbol("x", k)) for k in range(len(keyframes))]
corrected = np.array([[pose.x(), pose.y()] for pose in poses])
before, after = np.hypot(*keyframes[-1, :2]), np.hypot(*corrected[-1])
print(f"by odometry the mark is {before:.2f} m away, by the tape {distance:.2f} m, with both {after:.2f} m")

if len(sys.argv) > 1:
    lines = ""
    for colour, path in (("#e69f00", keyframes[:, :2] + [0.0, 0.2]), ("#0072b2", corrected)):
        points = " ".join(f"{x:.3f},{-y:.3f}" for x, y in path)
        lines += f'<polyline fill="none" stroke="{colour}" stroke-width=".1" points="{points}"/>'
    lines += f'<path d="M{distance:.3f},-1V1" stroke="#1f2933" stroke-width=".05"/>'
    view = f'viewBox="-1 -3 {before + 2:.1f} 6" width="1000"'
    svg = f'<svg xmlns="http://www.w3.org/2000/svg" {view}>{lines}</svg>\n'
    Path(sys.argv[1]).write_text(svg, encoding="utf-8")
