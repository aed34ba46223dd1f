"""Emulated lidars, read through pyserial on pseudo terminals by the drivers' own decoders."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from drivers.emulator.ld06 import LD06_VARIANTS
from drivers.emulator.rplidar_scan import BURST_DURATION
from drivers.emulator.rplidar_variants import RPLIDAR_VARIANTS
from drivers.emulator.scip import INTENSITY, URG, UTM
from drivers.lidars import ld06, scip, scip_scan
from drivers.lidars.measurements import Decoder, Measurements
from drivers.lidars.revolutions import RevolutionAssembler
from drivers.lidars.rplidar import modes, requests
from drivers.lidars.rplidar.decoding import decoder_for
from drivers.lidars.rplidar.models import BAUDS
from drivers.lidars.rplidar.responses import Health, HealthStatus, Info, ResponseReader, ResponseType, SampleRate
from drivers.messages import Floats, Scan

from .conftest import Bench, Host

MakeBench = Callable[..., Bench]

MEASURE = scip.MeasureRequest(URG.first, URG.last)
RPLIDARS = [
    *(("rplidar-a1", mode.name) for mode in RPLIDAR_VARIANTS["rplidar-a1"].modes.modes),
    *(("rplidar-s1", mode.name) for mode in RPLIDAR_VARIANTS["rplidar-s1"].modes.modes),
    ("rplidar-a1-old", "Express"),
    ("rplidar-a2", "typical"),
    ("rplidar-a3", "typical"),
    ("rplidar-c1", "Standard"),
    ("rplidar-s2", "typical"),
    ("rplidar-s3", "typical"),
]
QUANTA = {ResponseType.ULTRA: 0.009, ResponseType.ULTRA_DENSE: 0.003}
"""Resolution of the ranges in metres; half a millimetre for all other formats."""


def started(bench: Bench, lidar: str, mode: str) -> tuple[Host, Decoder, float]:
    """Return a scanning lidar, its decoder, and the resolution of its ranges; all bytes read from now on are
    measurements.
    """
    if lidar in LD06_VARIANTS:
        model = LD06_VARIANTS[lidar]
        return bench.open("lidar", model.baud), ld06.Ld06Decoder(model), 0.0006
    if lidar == "scip":
        host = bench.open("lidar")
        host.write(scip.LASER_ON + MEASURE.packet())
        return host, scip_scan.ScipDecoder(URG, MEASURE), 0.0006
    kind = RPLIDAR_VARIANTS[lidar]
    chosen = kind.modes.choose(mode)
    host = bench.open("lidar", kind.baud)
    bench.go(0.6)
    host.write(requests.set_motor_pwm(660).packet())
    start = requests.HQ_SCAN if chosen.response_type == ResponseType.HQ else chosen.start()
    reader = ResponseReader(chosen.response_type, multiple=True)
    assert host.ask(start, reader) == b""
    assert reader.remainder == b""
    host.forget()
    decoder = decoder_for(chosen.response_type, chosen.sample_period, kind.baud, kind.model.triangulates)
    return host, decoder, QUANTA.get(ResponseType(chosen.response_type), 0.0006)


def measured(host: Host, decoder: Decoder) -> tuple[Measurements, Floats]:
    measurements = decoder.feed(host.data)
    return measurements, measurements.stamps(host.arrivals(measurements.packets["end"]))


def scans_of(measurements: Measurements, stamps: Floats, whole: bool = False) -> list[Scan]:
    return RevolutionAssembler(0.02, 40.0, whole_packets=whole).add(measurements, stamps)


@pytest.mark.parametrize(
    ("lidar", "mode"), [*RPLIDARS, ("ld06", ""), pytest.param("stl-27l", "", marks=pytest.mark.slow), ("scip", "")]
)
def test_decoded_ranges_are_the_true_ranges(bench: MakeBench, lidar: str, mode: str) -> None:
    robot = bench(lidar=lidar)
    robot.go(1.0)  # the robot stands still at first
    host, decoder, quantum = started(robot, lidar, mode)
    robot.go(1.5)
    measurements, stamps = measured(host, decoder)
    assert decoder.counters.checksum_failures == 0
    samples = measurements.samples
    # Arrival times are at most one tick late, and standard nodes come in small bursts. Directions have a resolution of
    # 1/64 degree, corrections of 1/8 degree.
    latest = robot.step + (BURST_DURATION if mode == "Standard" else 0.0)
    motion, mount = robot.emulator.motion, np.array(robot.emulator.setup.mount)
    cast = [
        motion.cast_beams(stamps - late, samples["angle"] + aside, mount)
        for late in (0.0, 0.5 * latest, latest)
        for aside in np.radians([-0.08, -0.03, 0.0, 0.03, 0.08])
    ]
    has_return = ~np.isnan(samples["range"])
    right = (samples["range"] > np.min(cast, axis=0) - quantum) & (samples["range"] < np.max(cast, axis=0) + quantum)
    assert np.count_nonzero(has_return) > 0.95 * len(samples)
    assert np.count_nonzero(right | ~has_return) >= 0.995 * len(samples)
    assert np.ptp(motion.poses(np.array([stamps[0], stamps[-1]])), axis=0).max() > 0.1  # the robot was moving


@pytest.mark.parametrize(
    ("lidar", "mode", "rate", "turns"),
    [
        ("rplidar-s1", "DenseBoost", 9200.0, 10.0),
        ("rplidar-a1", "Sensitivity", 1e6 / 127, 7.5),
        ("ld06", "", 4500.0, 10.0),
        pytest.param("stl-27l", "", 21600.0, 10.0, marks=pytest.mark.slow),
    ],
)
def test_lidars_turn_clockwise_at_their_rate(
    bench: MakeBench, lidar: str, mode: str, rate: float, turns: float
) -> None:
    robot = bench(lidar=lidar, drive="base")
    host, decoder, _ = started(robot, lidar, mode)
    robot.go(3.2)
    measurements, stamps = measured(host, decoder)
    assert len(measurements) / np.ptp(stamps) == pytest.approx(rate, rel=0.02)
    scans = scans_of(measurements, stamps)
    assert len(scans) >= 1.8 * turns
    assert np.diff([scan.stamp for scan in scans]).mean() == pytest.approx(1.0 / turns, rel=0.02)
    assert all(scan.time_offsets[0] > scan.time_offsets[-1] for scan in scans)  # angles increase, times decrease


@pytest.mark.parametrize(("wanted", "turns"), [(60, 5.0), (900, 15.0), (6000, 20.0)])
def test_an_rplidar_turns_within_its_limits(bench: MakeBench, wanted: int, turns: float) -> None:
    robot = bench(lidar="rplidar-s1", drive="base")
    robot.step = 0.002  # the stamps of scans are only as accurate
    host, decoder, _ = started(robot, "rplidar-s1", "DenseBoost")
    host.write(requests.set_motor_speed(wanted).packet())
    robot.go(2.5)
    scans = scans_of(*measured(host, decoder))
    assert np.median(np.diff([scan.stamp for scan in scans])[-10:]) == pytest.approx(1.0 / turns, rel=0.02)


def test_scip_turns_counter_clockwise_and_sends_its_clock(bench: MakeBench) -> None:
    robot = bench(lidar="scip", lidar_drift=2000.0)
    host, decoder, _ = started(robot, "scip", "")
    robot.go(2.0)
    measurements, stamps = measured(host, decoder)
    scans = scans_of(measurements, stamps, whole=True)
    assert 19 <= len(scans) <= 20
    assert all(np.all(np.diff(scan.time_offsets) > 0.0) for scan in scans)
    # The device's clock is fast by 0.2 %, so its revolutions are shorter.
    assert np.diff([scan.stamp for scan in scans]).mean() == pytest.approx(0.1 / 1.002, rel=2e-3)
    assert np.diff(measurements.packets["device_time"]) == pytest.approx(0.1, abs=1.1e-3)


@pytest.mark.parametrize("echoes", [False, True])
def test_a_utm_reports_intensities_and_echoes(bench: MakeBench, echoes: bool) -> None:
    robot = bench(lidar="scip-utm")
    host = robot.open("lidar")
    request = scip.MeasureRequest(UTM.first, UTM.last, intensity=True, echoes=echoes)
    host.write(scip.LASER_ON + request.packet())
    robot.go(2.5)
    measurements, stamps = measured(host, scip_scan.ScipDecoder(UTM, request))
    scans = scans_of(measurements, stamps, whole=True)
    assert np.diff([scan.stamp for scan in scans]).mean() == pytest.approx(0.025, rel=2e-3)
    for scan in scans:
        assert scan.intensities is not None
        seen = ~np.isnan(scan.ranges)
        assert np.count_nonzero(seen) > 0.9 * len(seen)
        # The intensity is that of the first echo: of the last one where there is no other.
        agrees = np.abs(scan.intensities * scan.ranges / INTENSITY - 1.0)[seen] < 2e-3
        assert (np.count_nonzero(~agrees) > 0) == echoes
        assert np.count_nonzero(agrees) > 0.9 * np.count_nonzero(seen)


def test_a_urg_has_neither_intensities_nor_echoes(bench: MakeBench) -> None:
    robot = bench(lidar="scip")
    host, replies = robot.open("lidar"), scip.ReplyParser()
    for options in ({"intensity": True}, {"echoes": True}):
        host.forget()
        host.write(scip.MeasureRequest(URG.first, URG.last, **options).packet())
        robot.go(0.35)
        assert [reply.status for reply in replies.feed(host.data)] == ["0E"]


def test_a_device_clock_drifts(bench: MakeBench) -> None:
    robot = bench(lidar="ld06", lidar_drift=5000.0)
    host, decoder, _ = started(robot, "ld06", "")
    robot.go(3.0)
    packets = measured(host, decoder)[0].packets
    gone = np.ptp(packets["device_time"]) / np.ptp(host.arrivals(packets["end"]))
    assert gone == pytest.approx(1.005, abs=2e-3)


@pytest.mark.parametrize("lidar", RPLIDAR_VARIANTS)
def test_an_rplidar_reports_its_identity_health_and_modes(bench: MakeBench, lidar: str) -> None:
    robot, kind = bench(lidar=lidar), RPLIDAR_VARIANTS[lidar]
    host = robot.open("lidar", kind.baud)
    robot.go(0.6)
    assert host.data.startswith(b"RP LIDAR System")
    info = host.ask(requests.GET_INFO, ResponseReader(ResponseType.INFO, Info.SIZE))
    health = host.ask(requests.GET_HEALTH, ResponseReader(ResponseType.HEALTH, Health.SIZE))
    assert info is not None
    assert Info.parse(info) == kind.info
    assert health is not None
    assert Health.parse(health).status == HealthStatus.GOOD
    if not kind.reports_modes:
        count_request = requests.get_configuration(modes.ConfigEntry.COUNT)
        assert host.ask(count_request, ResponseReader(ResponseType.CONFIGURATION)) is None
        rate = host.ask(requests.GET_SAMPLE_RATE, ResponseReader(ResponseType.SAMPLE_RATE, SampleRate.SIZE))
        assert rate is not None
        assert SampleRate.parse(rate) == SampleRate(508e-6, 254e-6)
        return

    def query_modes() -> modes.Modes:
        steps = modes.query_modes()
        request = next(steps)
        while True:
            payload = host.ask(request, ResponseReader(ResponseType.CONFIGURATION, prefix=modes.echo(request)))
            assert payload is not None
            try:
                request = steps.send(payload)
            except StopIteration as done:
                found: modes.Modes = done.value
                return found

    for entry, limit in modes.ROTATION_LIMITS.items():
        request = requests.get_configuration(modes.ConfigEntry(entry))
        payload = host.ask(request, ResponseReader(ResponseType.CONFIGURATION, prefix=modes.echo(request)))
        assert payload == modes.echo(request) + limit.to_bytes(2, "little")
    found = query_modes()
    assert [(m.name, m.response_type) for m in found.modes] == [(m.name, m.response_type) for m in kind.modes.modes]
    assert found.choose().sample_period == pytest.approx(kind.modes.choose().sample_period, rel=1e-3)


def test_only_the_right_baud_rate_is_understood(bench: MakeBench) -> None:
    robot = bench(lidar="rplidar-s1")
    robot.go(0.6)
    answered = []
    for baud in BAUDS:
        host = robot.open("lidar", baud)
        if host.ask(requests.GET_INFO, ResponseReader(ResponseType.INFO, Info.SIZE), patience=0.1) is not None:
            answered.append(baud)
        robot.close(host)
    assert answered == [256000]
    assert robot.emulator.lidar.counts.garbled == 3 * len(requests.GET_INFO.packet())


def test_stop_ends_a_scan_and_reset_sends_the_banner(bench: MakeBench) -> None:
    robot = bench(lidar="rplidar-s1")
    host, _, _ = started(robot, "rplidar-s1", "DenseBoost")
    robot.go(1.5)
    assert len(host.data) > 5000
    assert (
        host.ask(requests.GET_INFO, ResponseReader(ResponseType.INFO, Info.SIZE)) is None
    )  # no response while scanning
    host.write(requests.STOP.packet())
    robot.go(0.1)
    host.forget()
    robot.go(0.3)
    assert host.data == b""
    host.write(requests.RESET.packet() + requests.GET_INFO.packet())
    robot.go(1.0)
    assert host.data.startswith(b"RP LIDAR System")  # and nothing more: the early request was ignored
    assert host.data.count(b"\n") == 3
    assert robot.emulator.lidar.report()["starts"] == 2


def test_an_a2_needs_pwm_to_turn(bench: MakeBench) -> None:
    robot = bench(lidar="rplidar-a2")
    host = robot.open("lidar", 115200)
    robot.go(0.6)
    assert host.ask(requests.GET_MOTOR_BOARD, ResponseReader(ResponseType.MOTOR_BOARD, 4)) == b"\1\0\0\0"
    assert host.ask(requests.SCAN, ResponseReader(ResponseType.STANDARD, multiple=True)) == b""
    host.forget()
    robot.go(1.5)
    assert host.data == b""  # the head does not turn
    host.write(requests.set_motor_pwm(660).packet())
    robot.go(1.5)
    turning = len(host.data)
    assert turning > 4000
    host.write(requests.set_motor_pwm(0).packet())
    robot.go(0.5)
    assert len(host.data) < turning + 100


def test_an_internal_error_lasts_until_a_reset(bench: MakeBench) -> None:
    robot = bench(lidar="rplidar-s1")
    host, _, _ = started(robot, "rplidar-s1", "DenseBoost")
    robot.go(1.5)
    robot.emulator.lidar.device.inject_error(robot.time)
    robot.go(0.1)
    for status in (HealthStatus.ERROR, HealthStatus.GOOD):
        payload = host.ask(requests.GET_HEALTH, ResponseReader(ResponseType.HEALTH, Health.SIZE))
        assert payload is not None
        assert Health.parse(payload).status == status
        host.write(requests.RESET.packet())
        robot.go(0.6)


def test_scip_replies_to_all_commands(bench: MakeBench) -> None:
    robot = bench(lidar="scip")
    host = robot.open("lidar", 19200)  # on USB any baud rate works
    replies = scip.ReplyParser()

    def ask(command: bytes) -> list[scip.Reply]:
        host.forget()
        host.write(command)
        robot.go(0.35)
        return replies.feed(host.data)

    (parameters,) = ask(scip.PARAMETERS)
    assert scip.Parameters.parse(parameters) == URG
    assert [reply.status for command in (scip.STOP, scip.LASER_ON, scip.USE_SCIP2) for reply in ask(command)] == [
        "00"
    ] * 3
    clocks = [scip.parse_clock(reply.lines[0]) for _ in range(2) for reply in ask(b"TM1\n")]
    assert clocks[0] is not None
    assert clocks[1] == pytest.approx(clocks[0] + 350, abs=3)
    (state,) = ask(scip.STATE)
    assert len(state.packet().split(b"\n")) == 2 + 7 + 2  # Hokuyo's library expects exactly these lines
    assert all(scip.strip_checksum(line) is not None for line in state.lines)
    assert ask(b"XX\n")[0].status == "0E"
    assert ask(b"MD0000999901000\n")[0].status == "04"
    once = ask(scip.MeasureRequest(100, 200, cluster=3, continuous=False, width=2).packet())
    assert [(reply.status, len(reply.lines)) for reply in once] == [("00", 3)]  # the clock, 68 characters
    echoes = [reply.echo[-2:] for reply in ask(MEASURE.echo_prefix + b"02\n")]
    assert echoes == [b"02", b"01", b"00"]
    assert robot.emulator.lidar.device.unrecognised == 3
