"""Kinds of input that can be damaged, with an intact example and the function that reads each."""

from __future__ import annotations

import gzip
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from rosbags.rosbag2 import StoragePlugin
from typer.testing import CliRunner

import drivers
from drivers import GroundTruth, Message, Scan
from drivers.recordings.inspection import inspect
from drivers.recordings.mcap import McapWriter
from drivers.recordings.point_clouds import POINT_CLOUD
from drivers.recordings.ros_encoder import RosEncoder
from drivers.simulation import LidarModel, Simulation
from drivers.simulation.world import load_world
from drivers.timestamps import to_nanoseconds
from drivers.transport.byte_capture import read_capture
from slam import Slam
from slam.cli.app import app
from slam.config import load_config
from slam.graph.pose_graph import read_pose_graph
from slam.io.exports import write_dxf, write_geojson, write_svg
from slam.io.output_dir import CONFIG, KEYFRAMES, MAP, SESSION, SUMMARY, TRAJECTORY
from slam.io.pins_csv import read_pins
from slam.io.plans.reader import read_plan
from slam.io.run_results import read_run_results
from slam.io.sessions import read_session
from slam.ros.parameter_files import load_parameters
from slam.visualisation.report_page import write_page

from ..clouds import cloud_of_scan
from ..drivers.conftest import carmen_lines, ros_entries, write_bag1, write_bag2
from .mutations import Mutation, mutate_bytes, mutate_gzip, mutate_json, mutate_table, mutate_text

SEED, SECONDS = 3, 3.0
CONTINUED = 2.0
"""Seconds by which a session is continued: up to the next keyframe."""
RECORDED, BEAMS = 1.0, 40
"""Seconds and beams of the recordings: small ones are read fast, and more of the damage is in their structure."""


@dataclass(frozen=True)
class Kind:
    """Kind of input.

    path    what is read: a file or a directory
    file    the file that is damaged: `path`, or in it
    mutate  damages its content
    read    reads `path`; may raise SlamError
    """

    path: Path
    file: Path
    mutate: Mutation
    read: Callable[[Path], object]


def make_kinds(folder: Path) -> dict[str, Kind]:
    """Write an example of each kind below an empty folder; return the kinds by name."""
    lidar = LidarModel(beams=BEAMS, rate=5.0)
    messages = list(Simulation("room", seed=SEED, duration=RECORDED, lidar=lidar))
    return {**recordings(folder, messages), **results(folder / "run"), **small_files(folder)}


def recordings(folder: Path, messages: list[Message]) -> dict[str, Kind]:
    text = "\n".join(carmen_lines(messages)).encode()
    entries = ros_entries(messages, RosEncoder())
    clouds = [
        ("/points", POINT_CLOUD, to_nanoseconds(m.stamp), cloud_of_scan(m)) for m in messages if isinstance(m, Scan)
    ]
    entries += clouds[:5]
    (folder / "a.clf").write_bytes(text)
    (folder / "a.clf.gz").write_bytes(gzip.compress(text))
    with McapWriter(folder / "a.mcap") as writer:
        for message in messages:
            writer.write(message)
    write_plain_mcap(folder / "plain.mcap", folder / "a.mcap")
    write_bag1(folder / "a.bag", entries)
    write_bag2(folder / "sqlite3", entries, StoragePlugin.SQLITE3)
    write_bag2(folder / "mcap", entries, StoragePlugin.MCAP)
    (folder / "capture.txt").write_text("# a capture\n" + "".join(f"{k / 10} < a5{k:02x}\n" for k in range(20)))
    single = {
        "carmen": ("a.clf", mutate_text),
        "carmen-gzip": ("a.clf.gz", mutate_gzip),
        "mcap": ("a.mcap", mutate_bytes),
        "mcap-plain": ("plain.mcap", mutate_bytes),
        "ros1-bag": ("a.bag", mutate_bytes),
    }
    found = {
        name: Kind(folder / file, folder / file, mutate, read_recording) for name, (file, mutate) in single.items()
    }
    for name, suffix in (("sqlite3", "db3"), ("mcap", "mcap")):
        (data,) = (folder / name).glob(f"*.{suffix}")
        found[f"ros2-{name}"] = Kind(folder / name, data, mutate_bytes, read_recording)
        found[f"ros2-{name}-metadata"] = Kind(
            folder / name, folder / name / "metadata.yaml", mutate_text, read_recording
        )
    capture = folder / "capture.txt"
    found["byte-capture"] = Kind(capture, capture, mutate_text, lambda path: consume(read_capture(path)))
    return found


def write_plain_mcap(path: Path, original: Path) -> None:
    """Write a recording without compression and checksums, so that damage reaches the messages."""
    with path.open("wb") as file, original.open("rb") as source:
        writer = Writer(file, chunk_size=4096, compression=CompressionType.NONE, enable_crcs=False)
        writer.start()
        channels = {}
        for schema, channel, message in make_reader(source).iter_messages():
            if channel.id not in channels:
                assert schema is not None
                of_type = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[channel.id] = writer.register_channel(channel.topic, channel.message_encoding, of_type)
            writer.add_message(channels[channel.id], message.log_time, message.data, message.publish_time)
        writer.finish()


def results(path: Path) -> dict[str, Kind]:
    arguments = ["run", f"sim:room?seed={SEED}&duration={SECONDS}", "--out", str(path), "--no-review"]
    ended = CliRunner().invoke(app, arguments)
    assert ended.exit_code == 0, ended.output
    end = read_session(path).latest
    drive = Simulation("room", seed=SEED, duration=SECONDS + CONTINUED, lidar=LidarModel(rate=4.0))
    following = [m for m in drive if m.stamp > end and not isinstance(m, GroundTruth)]
    read: Callable[[Path], object] = partial(continue_session, following=following)
    of_suffix: dict[str, Mutation] = {".parquet": mutate_table, ".json": mutate_json}
    found = {
        f"session/{file.name}": Kind(path, file, of_suffix[file.suffix], read)
        for file in sorted((path / SESSION).iterdir())
    }
    found[f"session/{CONFIG}"] = Kind(path, path / CONFIG, mutate_text, read)
    for name in (MAP, SUMMARY, TRAJECTORY, KEYFRAMES):
        mutate = of_suffix.get(Path(name).suffix, mutate_text)
        found[f"results/{name}"] = Kind(path, path / name, mutate, write_report)
    drawings = {"dxf": write_dxf, "geojson": write_geojson, "svg": write_svg}
    run = read_run_results(path)
    for suffix, write in drawings.items():
        file = path.with_name(f"plan.{suffix}")
        write(file, run)
        found[f"plan-{suffix}"] = Kind(file, file, mutate_json if suffix == "geojson" else mutate_text, read_plan)
    return found


def small_files(folder: Path) -> dict[str, Kind]:
    """Return kinds of text files, whose examples are written here."""
    examples: dict[str, tuple[str, Callable[[Path], object]]] = {
        "grid.yaml": (
            "image: grid.pgm\nmode: trinary\nresolution: 0.05\norigin: [-1.0, -2.0, 0.1]\nnegate: 0\n"
            "occupied_thresh: 0.65\nfree_thresh: 0.196\n",
            read_plan,
        ),
        "pins.csv": (
            "kind,id,x,y,sigma,heading,sigma_heading\npose,0,1,2,0.01,-0.5,0.002\nwall,7,3,4,0.01,,\n",
            read_pins,
        ),
        "graph.g2o": (
            "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 0 0.1\nVERTEX_XY 2 3 1\nFIX 0\n"
            "EDGE_SE2 0 1 1 0 0.1 100 0 0 100 0 400\nEDGE_SE2_XY 1 2 2 1 10 0 10\n",
            read_pose_graph,
        ),
        "graph.graph": (
            "VERTEX2 0 0 0 0\nVERTEX2 1 1 0 0.1\nEDGE2 0 1 1 0 0.1 100 0 100 400 0 0\n",
            read_pose_graph,
        ),
        "world.toml": (
            'title = "a"\nspeed = 0.4\npath = [[1.0, 1.0], [5.0, 1.0], [5.0, 3.2]]\n'
            "[[walls]]\nfrom = [0, 0]\nto = [6, 0]\n[[boxes]]\nat = [3.0, 2.1]\nsize = [1.2, 0.7]\nturn = 10\n",
            load_world,
        ),
        "settings.toml": (
            '[lidar]\nsigma_range = 0.01\nmount = [0.1, 0.0, 0.0]\n[odometry]\nsource = "wheels"\n',
            load_config,
        ),
        "node.yaml": (
            "/**:\n  ros__parameters:\n    use_sim_time: false\n    resolution: 0.05\n    names: [a, b]\n",
            lambda path: load_parameters([path], [], "/wclm"),
        ),
    }
    (folder / "grid.pgm").write_bytes(b"P5\n40 30\n255\n" + bytes(k % 251 for k in range(1200)))
    found = {}
    for name, (text, read) in examples.items():
        (folder / name).write_text(text)
        found[name] = Kind(folder / name, folder / name, mutate_text, read)
    found["grid.pgm"] = Kind(folder / "grid.yaml", folder / "grid.pgm", mutate_bytes, read_plan)
    return found


def read_recording(path: Path) -> None:
    """Read a recording as `wclm info` and `wclm run` do."""
    inspect(drivers.open(path))


def continue_session(path: Path, following: Sequence[Message]) -> None:
    """Read a session, and do what a run that continues it by some scans does, with a copy of its state before."""
    session = read_session(path)
    slam = Slam(session.config, resumed=session)
    slam.snapshot().finished()
    for message in following:
        slam.add(message)
    slam.finish()


def write_report(path: Path) -> None:
    """Read the results of a run and write its report page."""
    run = read_run_results(path)
    run.mounts()
    write_page(path.with_name("report.html"), run)


def consume(items: Iterable[object]) -> None:
    for _ in items:
        pass
