"""The drawing of a scan's features is SVG with all lines and corners in their places."""

from __future__ import annotations

from xml.etree import ElementTree

import numpy as np

from features import Extractor, Noise
from features.drawing import draw

SVG = "{http://www.w3.org/2000/svg}"


def room_features():
    random = np.random.default_rng(0)
    bearings = np.linspace(-np.pi, np.pi, 720, endpoint=False) + 0.001
    c, s = np.cos(bearings), np.sin(bearings)
    ranges = np.minimum(np.where(c > 0, 4.0, -2.0) / c, np.where(s > 0, 2.5, -1.5) / s)
    noise = Noise(sigma_range=0.01, sigma_bearing=np.radians(0.05))
    return Extractor(noise, adapt_noise=False).extract(ranges + random.normal(0.0, 0.01, len(bearings)), bearings)


def test_lines_and_corners_are_where_they_are_with_y_up() -> None:
    features = room_features()
    drawing = ElementTree.fromstring(draw(features))
    assert features._repr_svg_() == draw(features)
    lines = [path for path in drawing.iter(f"{SVG}path") if path.get("stroke")]
    assert len(lines) == len(features.lines) == 4
    ends = np.array([[float(v) for v in path.get("d", "")[1:].replace("L", ",").split(",")] for path in lines])
    np.testing.assert_allclose(ends[:, :2] * [1, -1], features.lines.start, atol=1e-3)
    np.testing.assert_allclose(ends[:, 2:] * [1, -1], features.lines.end, atol=1e-3)
    ellipses = list(drawing.iter(f"{SVG}ellipse"))
    assert len(ellipses) == len(features.corners)
    for ellipse, (x, y) in zip(ellipses, features.corners.position, strict=True):
        assert ellipse.get("transform", "").startswith(f"translate({x:.3f} {-y:.3f})")


def test_a_scan_without_features_is_drawn() -> None:
    noise = Noise(sigma_range=0.01, sigma_bearing=0.001)
    nothing = Extractor(noise).extract(np.full(10, np.nan), np.linspace(-1.0, 1.0, 10))
    assert ElementTree.fromstring(draw(nothing)).tag == f"{SVG}svg"
