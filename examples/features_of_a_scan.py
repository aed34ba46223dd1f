"""Extract the lines and corners of one scan, without SLAM, and print their standard deviations.

python examples/features_of_a_scan.py
python examples/features_of_a_scan.py scan.svg

In a notebook, the last line of a cell with `found` alone shows the drawing.
"""

import sys
from pathlib import Path

import numpy as np

from features import Extractor, Noise
from features.drawing import draw

# A scan: ranges in metres and bearings in radians, here simulated in a room of 6 m by 4 m.
random = np.random.default_rng(0)
bearings = np.linspace(-np.pi, np.pi, 720, endpoint=False) + 0.001
c, s = np.cos(bearings), np.sin(bearings)
x, y = np.where(c > 0, 4.0, -2.0), np.where(s > 0, 2.5, -1.5)
ranges = np.minimum(x / c, y / s) + random.normal(0.0, 0.01, len(bearings))

# The covariances follow from the noise of each ray. By default the extractor adapts it from scan to scan.
extractor = Extractor(Noise(sigma_range=0.01, sigma_bearing=np.radians(0.05)), adapt_noise=False)
found = extractor.extract(ranges, bearings)

# A line is u x + v y = 1; its point closest to the lidar is (u, v) / (u^2 + v^2).
for (u, v), covariance, count in zip(found.lines.uv, found.lines.covariance, found.lines.count, strict=True):
    distance = 1.0 / np.hypot(u, v)
    gradient = -(distance**3) * np.array([u, v])  # gradient of the distance by (u, v)
    sigma = np.sqrt(gradient @ covariance @ gradient)
    print(
        f"a wall {distance:.4f} m away (standard deviation {1000 * sigma:.2f} mm), "
        f"{np.degrees(np.arctan2(v, u)):6.1f} degrees to the left, from {count} rays"
    )
for position, covariance in zip(found.corners.position, found.corners.covariance, strict=True):
    largest = np.sqrt(np.linalg.eigvalsh(covariance)[-1])
    print(f"a corner at {position[0]:.3f} m, {position[1]:.3f} m (standard deviation at most {1000 * largest:.1f} mm)")

# The drawing has the corners with their 3-sigma ellipses, enlarged.
if len(sys.argv) > 1:
    Path(sys.argv[1]).write_text(draw(found), encoding="utf-8")
