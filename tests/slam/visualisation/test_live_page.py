"""The page of a live run: what clients receive, which requests are refused, and what its buttons do."""

from __future__ import annotations

import asyncio
import json
import re
import time
import urllib.error
import urllib.request
from base64 import b64decode
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tornado.httpclient import HTTPClientError, HTTPRequest
from tornado.websocket import WebSocketClientConnection, websocket_connect

from drivers.se2 import Pose
from slam.errors import OutputError
from slam.events import Finished, KeyframeAdded, MapUpdated, Notice, ScanTracked, StateChanged, SuspectFound
from slam.geometry.segments import CornerPoints, Floats, Segments
from slam.io.exports import Occupancy
from slam.io.exports.occupancy import FREE, OCCUPIED, UNKNOWN
from slam.visualisation.live_page import GridLayer, LiveState, PageServer
from slam.visualisation.live_page.grid_layer import RESOLUTION, TILE, tiles
from slam.visualisation.live_page.live_state import MAX_MESSAGES, MAX_POINTS
from slam.visualisation.live_page.requests import MAX_COMMAND_DELAY

from ..browser import browser
from ..chromium import CHROMIUM, in_a_browser

POSE = np.array([1.0, 2.0, 0.5])


@contextmanager
def served(state: LiveState | None = None, address: str = "127.0.0.1", port: int | None = None) -> Iterator[PageServer]:
    with PageServer(state or LiveState(), address, port) as server:
        yield server


OPENED: list[WebSocketClientConnection] = []


async def connect(server: PageServer, **headers: str) -> WebSocketClientConnection:
    host = f"127.0.0.1:{server.port}"
    query = f"?token={server.token}" if server.token else ""
    wanted = {"Origin": f"http://{host}", **headers}
    request = HTTPRequest(f"ws://{host}/live{query}", headers={k: v for k, v in wanted.items() if v})
    client = await websocket_connect(request)
    OPENED.append(client)
    return client


async def frame(client: WebSocketClientConnection) -> dict[str, Any]:
    """Receive a frame and ask for the next one."""
    received = await asyncio.wait_for(client.read_message(), 120.0)
    assert received is not None
    await client.write_message('{"drawn": 1}')
    content: dict[str, Any] = json.loads(received)
    return content


async def until(condition: Callable[[], bool]) -> None:
    end = time.monotonic() + 120.0
    while not condition():
        assert time.monotonic() < end
        await asyncio.sleep(0.01)


def run(test: Callable[[], Awaitable[None]]) -> None:
    """Run a test, then close its connections."""

    async def limited() -> None:
        try:
            await asyncio.wait_for(test(), 60.0)
        finally:
            while OPENED:
                client = OPENED.pop()
                client.close()
                while await client.read_message() is not None:
                    pass

    asyncio.run(limited())


def keyframe(index: int, points: Floats, pose: Pose) -> KeyframeAdded:
    segments = Segments(np.zeros((0, 3)), np.zeros(0), np.zeros((0, 2, 2)))
    corners = CornerPoints(np.zeros((0, 2)), np.zeros((0, 2, 2)), np.zeros((0, 2), dtype=np.int64), np.zeros((0, 2)))
    ids, none = np.zeros(0, dtype=np.int64), np.zeros(0)
    matches = (ids, none, ids, ids, none, ids, ids)
    return KeyframeAdded(
        index, float(index), pose, np.eye(3), pose, points, segments, corners, *matches, 0.01, {}, {"walls": 0}
    )


def refused(url: str, **headers: str) -> int:
    with pytest.raises(urllib.error.HTTPError) as error:
        urllib.request.urlopen(urllib.request.Request(url, headers=headers), timeout=20.0)
    with error.value as response:
        assert len(response.read()) < 200
    return error.value.code


def test_the_page_has_no_external_parts_and_only_its_own_script_may_run() -> None:
    with served() as server, urllib.request.urlopen(server.url, timeout=20.0) as response:
        text, headers = response.read().decode(), response.headers
    policy = headers["Content-Security-Policy"]
    assert policy.startswith("default-src 'none'")
    assert "unsafe" not in policy
    assert headers["Cache-Control"] == "no-store"
    assert not re.search(r"(src|href)=\"(?!data:)", text)
    assert "https://" not in text


def test_clients_receive_map_scan_pose_and_state(finished: Finished) -> None:
    state = LiveState()
    scan = ScanTracked(10.0, POSE, POSE, 0.9, 4, np.random.default_rng(1).normal(size=(2000, 2)))

    async def test() -> None:
        state.handle(scan)
        state.handle(MapUpdated(4, 10.0, finished.keyframes.poses, finished.walls, finished.corners, 1.0, 0.0))
        client = await connect(server)
        first = await frame(client)
        assert len(first["map"]["walls"]) == len(finished.walls.piece_points()[0])
        assert first["map"]["walls"][0] == pytest.approx([0.0, 0.0, 6.0, 0.0])
        assert first["pose"]["pose"] == pytest.approx(POSE)
        assert len(first["scan"]["points"]) <= MAX_POINTS
        assert first["status"]["state"] == "OK"
        state.put_pose(10.5, POSE + 1.0, np.diag([4e-4, 1e-4, 1e-6]))
        second = await frame(client)
        assert set(second) == {"pose"}
        c, s = np.cos(1.5), np.sin(1.5)
        turned = np.array([[c, -s], [s, c]]) @ np.diag([4e-4, 1e-4]) @ np.array([[c, s], [-s, c]])
        assert second["pose"]["covariance"] == pytest.approx(turned)
        state.handle(StateChanged(11.0, "LOST", None))
        assert (await frame(client))["status"]["state"] == "LOST"
        state.handle(Notice(12.0, "the pose is lost"))
        state.handle(SuspectFound(4, 12.0, "at 0:10: the map is bent", np.zeros(2)))
        state.handle(replace(finished))
        client.close()
        state.handle(replace(scan, overlap_ratio=float("nan"), points=np.zeros((0, 2))))  # no wall, no points
        late = await connect(server)
        status = (await frame(late))["status"]
        assert (status["state"], status["finished"]) == ("SUSPECT", True)
        assert status["doubts"] == [[2.0, "the pose is lost"], [None, "SUSPECT at 0:10: the map is bent"]]

    with served(state) as server:
        run(test)


def test_a_slow_client_misses_frames_and_delays_nobody() -> None:
    """It gets one frame, and when it has drawn that, only the newest pose.

    It draws that frame after the last pose is put: if poses waited for it, the test would not end.
    """
    state = LiveState()

    async def test() -> None:
        slow, fast = await connect(server), await connect(server)
        assert await slow.read_message() is not None
        await frame(fast)
        for number in range(2000):
            state.put_pose(float(number), POSE, None)
        while (await frame(fast))["pose"]["stamp"] != 1999.0:
            pass
        await slow.write_message('{"drawn": 1}')
        assert (await frame(slow))["pose"]["stamp"] == 1999.0

    with served(state) as server:
        run(test)


def test_nothing_is_encoded_without_clients(monkeypatch: pytest.MonkeyPatch) -> None:
    state = LiveState()
    for number in range(2 * MAX_MESSAGES):
        state.handle(ScanTracked(float(number), POSE, POSE, 0.9, 4, None))  # type: ignore[arg-type]
        state.handle(Notice(float(number), "text"))
    with pytest.raises(TypeError):
        state.frame({})


def test_requests_of_other_sites_are_refused() -> None:
    """Also if another site has made its name point to this computer."""
    with served() as server:
        assert server.token == ""
        assert refused(server.url, Host="evil.example") == 403
        assert refused(server.url + "nothing") == 404
        local = f"127.0.0.1:{server.port}"

        async def test() -> None:
            for headers in ({"Origin": "http://evil.example"}, {"Origin": ""}, {"Host": f"evil.example:{server.port}"}):
                with pytest.raises(HTTPClientError, match="403"):
                    await connect(server, **headers)
            (await connect(server, Origin=f"http://{local}")).close()
            (await connect(server, Origin="http://localhost:9000", Host="localhost:9000")).close()  # through SSH

        run(test)


def test_other_computers_need_the_token() -> None:
    with served(address="0.0.0.0") as server:
        local = f"http://127.0.0.1:{server.port}/"
        assert server.url.endswith(f":{server.port}/?token={server.token}")
        assert len(server.token) > 20
        for wrong in ("", "?token=", "?token=x", f"?token={server.token}x"):
            assert refused(local + wrong) == 403
            assert refused(f"{local}live{wrong}") == 403
        with urllib.request.urlopen(f"{local}?token={server.token}", timeout=20.0) as response:
            assert response.status == 200

        async def test() -> None:
            (await connect(server)).close()
            with pytest.raises(HTTPClientError, match="403"):
                await connect(server, Origin="http://evil.example")

        run(test)


def test_a_taken_port_is_named() -> None:
    with served() as one, served() as other:
        assert one.port != other.port
        with pytest.raises(OutputError, match=f"at port {one.port}: .*in use"):
            PageServer(LiveState(), port=one.port)


def test_buttons_save_pause_and_drive_within_the_limits() -> None:
    done: list[Any] = []
    with served() as server:
        actions = server.actions
        actions.save = lambda: done.append("save")
        actions.pause = done.append
        actions.freeze = lambda frozen: done.append(f"frozen: {frozen}")
        actions.drive = lambda speed, turn_rate: done.append((speed, turn_rate))
        actions.limits = 0.3, 1.0

        async def test() -> None:
            client, now = await connect(server), 5000.0
            useless = ("", "[1]", '{"drive": [1]}', '{"drive": [1, "a"], "time": 0}', '{"drive": [1, NaN], "time": 0}')
            for text in (*useless, '{"drive": [1, 1]}', '{"pause": 1}', '{"save": 2}', '{"freeze": 0}'):
                await client.write_message(text)
            for content in (
                {"save": True},
                {"pause": True},
                {"freeze": True},
                {"freeze": False},
                {"drive": [0.5, -1.0], "time": now},
                {"drive": [9.0, 0.0], "time": now},
                {"drive": [1.0, 0.0], "time": now - 2000 * MAX_COMMAND_DELAY},  # held back by the network
                {"drive": [0.0, 0.0], "time": now - 2000 * MAX_COMMAND_DELAY},
                {"drive": [0.0, 1.0], "time": now},
            ):
                await client.write_message(json.dumps(content))
            wanted = ["save", True, "frozen: True", "frozen: False", (0.15, -1.0), (0.3, 0.0), (0.0, 0.0), (0.0, 1.0)]
            await until(lambda: len(done) >= len(wanted))
            assert done == wanted
            client.close()  # while it drives
            await until(lambda: done[-1] == (0.0, 0.0))

        run(test)


def test_a_page_without_permission_to_drive_cannot() -> None:
    with served() as server:

        async def test() -> None:
            client = await connect(server)
            await frame(client)
            await client.write_message('{"drive": [1, 0], "time": 1, "save": true, "pause": true, "freeze": true}')
            server.state.update(message="still there")
            assert (await frame(client))["status"]["message"] == "still there"

        run(test)


def test_only_the_tiles_of_the_grid_that_change_are_sent(finished: Finished) -> None:
    """A wall 2 m ahead, then another one 12 m away; then the map is corrected by 1 m, which moves the first one."""
    state, wall = LiveState(), np.column_stack([np.full(41, 2.0), np.linspace(-1.0, 1.0, 41)])

    def occupied(frames: dict[str, Any]) -> set[tuple[float, float]]:
        found = set()
        for tile in (part for name, part in frames.items() if name.startswith("tile ")):
            codes = np.frombuffer(b64decode(tile["cells"]), dtype=np.uint8)
            cells = (codes[:, None] >> np.array([0, 2, 4, 6]) & 3).reshape(tile["count"], tile["count"])
            for row, column in np.argwhere(cells == 2).tolist():
                size = tile["size"] / tile["count"]
                found.add((round(tile["x"] + size * (column + 0.5), 3), round(tile["y"] + size * (row + 0.5), 3)))
        return found

    async def received_tiles(client: WebSocketClientConnection) -> dict[str, Any]:
        while True:
            received = await frame(client)
            if any(name.startswith("tile ") for name in received):
                return received

    async def test() -> None:
        client = await connect(server)
        with GridLayer(state, lambda: np.zeros((1, 2))) as layer:
            layer.handle(keyframe(0, wall, np.zeros(3)))
            first = await received_tiles(client)
            assert {x for x, _ in occupied(first)} <= {1.975, 2.025}
            layer.handle(keyframe(1, wall, np.array([12.0, 0.0, 0.0])))
            second = await received_tiles(client)
            names = {name for name in second if name.startswith("tile ")}
            assert names
            assert not names & first.keys()
            poses = np.array([[1.0, 0.0, 0.0], [12.0, 0.0, 0.0]])
            layer.handle(MapUpdated(1, 2.0, poses, finished.walls, finished.corners, 1.0, 0.0))
            moved = await received_tiles(client)
            assert {x for x, _ in occupied(moved)} <= {2.975, 3.025}
            assert not names & moved.keys()

    with served(state) as server:
        run(test)


@pytest.mark.parametrize("origin", [(0.0, 0.0), (-6.4, 6.4), (-0.05, -13.25)])
def test_tiles_make_up_the_grid(origin: tuple[float, float]) -> None:
    cells = np.random.default_rng(1).choice(np.array([FREE, UNKNOWN, OCCUPIED], dtype=np.int8), (130, 300))
    occupancy = Occupancy(cells, np.array(origin), RESOLUTION)
    found = set()
    for (column, row), tile in tiles(occupancy):
        corner = TILE * RESOLUTION * np.array([column, row])
        found |= {tuple(place) for place in Occupancy(tile, corner, RESOLUTION).centres(OCCUPIED).round(3).tolist()}
    assert found == {tuple(place) for place in occupancy.centres(OCCUPIED).round(3).tolist()}


@in_a_browser
def test_a_browser_shows_the_grid_if_it_is_switched_on(tmp_path: Path) -> None:
    """The cell in the middle of the window is free, and the window is all unknown if the layer is switched off.

    The browser is as that of a tablet of 2021, which lacks these two.
    """
    missing = "delete window.OffscreenCanvas; delete Array.prototype.toReversed"
    state = LiveState()
    state.handle(ScanTracked(10.0, np.zeros(3), np.zeros(3), 0.9, 4, np.zeros((0, 2))))
    wall = np.column_stack([np.full(401, 4.0), np.linspace(-4.0, 4.0, 401)])
    middle = (
        "(() => { const map = document.getElementById('map');"
        " return [...map.getContext('2d').getImageData(0.75 * map.width, 0.5 * map.height, 1, 1).data].join() })()"
    )

    async def test() -> None:
        assert CHROMIUM is not None
        async with browser(CHROMIUM, tmp_path / "profile") as tab:
            await tab.call("Page.enable")
            await tab.call("Page.addScriptToEvaluateOnNewDocument", source=missing)
            await tab.open(server.url, 900, 700, mobile=False)
            await tab.wait("!document.getElementById('grid').hidden")
            await tab.wait(f"{middle} === '226,235,243,255'")
            await tab.evaluate("document.getElementById('grid').click()")
            await tab.wait(f"{middle} === '0,0,0,0'")
            assert not [text for text in tab.console if "Multiple readback" not in text]  # a warning about this test

    with served(state) as server:
        with GridLayer(state, lambda: np.zeros((1, 2))) as layer:
            layer.handle(keyframe(0, wall, np.zeros(3)))
        run(test)


@in_a_browser
def test_a_browser_forgets_the_run_before_when_it_connects_to_another_one(tmp_path: Path) -> None:
    """A page that stays open connects again if `wclm live` is started again."""
    before, after = LiveState(), LiveState()
    before.handle(ScanTracked(10.0, POSE, POSE, 0.9, 4, np.zeros((3, 2))))
    wall = np.column_stack([np.full(401, 4.0), np.linspace(-4.0, 4.0, 401)])
    after.update(state="LOST")

    async def test() -> None:
        assert CHROMIUM is not None
        async with browser(CHROMIUM, tmp_path / "profile") as tab:
            with served(before) as server, GridLayer(before, lambda: np.zeros((1, 2))) as layer:
                layer.handle(keyframe(0, wall, np.zeros(3)))
                await tab.open(server.url, 900, 700, mobile=False)
                await tab.wait("!document.getElementById('grid').hidden")
            with served(after, port=server.port):
                await tab.wait("document.getElementById('state').textContent === 'LOST'")
                assert await tab.evaluate("document.getElementById('grid').hidden")
                assert await tab.evaluate("document.getElementById('pose').textContent") == ""

    run(test)


@in_a_browser
@pytest.mark.slow
def test_a_browser_states_that_nothing_arrives_any_more(tmp_path: Path) -> None:
    """As on a phone that has left the network: it learns of that only after minutes."""
    state = LiveState()
    note = "document.getElementById('note').textContent"

    async def test() -> None:
        assert CHROMIUM is not None
        async with browser(CHROMIUM, tmp_path / "profile") as tab:
            await tab.open(server.url, 900, 700, mobile=False)
            state.update(message="map saved")
            await tab.wait(f"{note} === 'map saved'")
            await tab.wait(f"{note} === 'no data from the robot'")
            state.update(message="map saved again")
            await tab.wait(f"{note} === 'map saved again'")

    with served(state) as server:
        run(test)


@in_a_browser
@pytest.mark.parametrize(("width", "height", "mobile"), [(1280, 800, False), (390, 844, True)])
def test_a_browser_shows_the_run_and_drives(
    width: int, height: int, mobile: bool, finished: Finished, tmp_path: Path
) -> None:
    state, driven, frozen = LiveState(), [], list[bool]()
    state.handle(ScanTracked(10.0, POSE, POSE, 0.9, 4, np.zeros((3, 2))))
    state.handle(MapUpdated(4, 10.0, finished.keyframes.poses, finished.walls, finished.corners, 1.0, 0.0))
    state.handle(StateChanged(11.0, "DEGENERATE", None))
    state.handle(Notice(12.0, "odometry <b>slipped</b>"))
    state.update(can_drive=True, can_freeze=True, frozen=True, devices=[("ld06:/dev/a", "lost", "losses 1")])

    async def test() -> None:
        assert CHROMIUM is not None
        async with browser(CHROMIUM, tmp_path / "profile") as tab:
            await tab.open(server.url, width, height, mobile=mobile)
            await tab.wait("document.getElementById('state').textContent === 'DEGENERATE'")
            document = await tab.evaluate("document.body.innerText")
            for text in (
                "1.00 m, 2.00 m, 29°",
                "only localising",
                "Extend map",
                "odometry <b>slipped</b>",
                "ld06:/dev/a: lost, losses 1",
                "ld06:/dev/a is lost; only localising",
            ):
                assert text in document
            assert await tab.evaluate("document.documentElement.scrollWidth") == width
            x, y, size = await tab.evaluate(
                "(() => { const b = document.getElementById('stick').getBoundingClientRect();"
                " return [b.left + b.width / 2, b.top + b.height / 2, b.width] })()"
            )
            assert 0 < x - size / 2 < x + size / 2 < width
            assert y + size / 2 < height
            await tab.evaluate("document.getElementById('freeze').click()")
            await until(lambda: frozen == [False])
            at = {"x": x, "y": y - 0.4 * size}
            if mobile:
                await tab.call("Input.dispatchTouchEvent", type="touchStart", touchPoints=[at])
            else:
                await tab.call("Input.dispatchMouseEvent", type="mousePressed", button="left", clickCount=1, **at)
            await until(lambda: len(driven) > 3)
            assert driven[-1] == (pytest.approx(0.8 * 0.3, abs=0.02), pytest.approx(0.0, abs=0.05))
            if mobile:
                await tab.call("Input.dispatchTouchEvent", type="touchEnd", touchPoints=[])
            else:
                await tab.call("Input.dispatchMouseEvent", type="mouseReleased", button="left", clickCount=1, **at)
            await until(lambda: driven[-1] == (0.0, 0.0))
            state.put_pose(13.0, POSE + 1.0, np.diag([0.01, 0.04, 0.001]))
            await tab.wait("document.getElementById('pose').textContent.startsWith('2.00 m, 3.00 m')")
            assert tab.console == []

    with served(state) as server:
        server.actions.drive = lambda speed, turn_rate: driven.append((speed, turn_rate))
        server.actions.limits, server.actions.freeze = (0.3, 1.0), frozen.append
        run(test)
