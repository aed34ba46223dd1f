"""LD06 and Hokuyo's SCIP: known bytes, round trips, unwrapped clocks."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from drivers import DriverError
from drivers.lidars import ld06, scip, scip_scan
from drivers.lidars.measurements import NO_QUALITY

PACKET = bytes.fromhex(
    "54 2C 68 08 AB 7E E0 00 E4 DC 00 E2 D9 00 E5 D5 00 E3 D3 00 E4 D0 00 E9 CD 00 E4 CA 00 E2 C7 00 E9 C5 00 E5 C2 00"
    " E5 C0 00 E5 BE 82 3A 1A 50"
)
URG = scip.Parameters("URG-04LX", 0.02, 5.6, 1024, 44, 725, 384, 600.0)
QUICK = settings(max_examples=20, deadline=None)


class TestLd06:
    def test_a_known_packet_is_decoded(self) -> None:
        measurements = ld06.Ld06Decoder().feed(PACKET)
        samples = measurements.samples
        degrees = np.degrees(-samples["angle"]) % 360
        np.testing.assert_allclose(degrees, 324.27 + np.arange(12) * (334.70 - 324.27) / 11, atol=1e-9)
        millimetres = [224, 220, 217, 213, 211, 208, 205, 202, 199, 197, 194, 192]
        np.testing.assert_allclose(samples["range"] * 1e3, millimetres)
        assert samples["quality"].tolist() == [228, 226, 229, 227, 228, 233, 228, 226, 233, 229, 229, 229]
        assert measurements.packets["device_time"] == pytest.approx(6.714)
        assert measurements.packets["end"].tolist() == [47]

    def test_a_known_packet_is_encoded(self) -> None:
        ranges = np.array([[224, 220, 217, 213, 211, 208, 205, 202, 199, 197, 194, 192]]) * 1e-3
        intensities = np.array([[228, 226, 229, 227, 228, 233, 228, 226, 233, 229, 229, 229]])
        angles = np.radians([[324.27, 334.70]])
        assert ld06.encode(angles, ranges, intensities, np.radians(2152), 6.714) == PACKET

    def test_every_flipped_bit_is_detected(self) -> None:
        for at in range(47):
            for bit in range(8):
                broken = bytearray(PACKET)
                broken[at] ^= 1 << bit
                assert not len(ld06.Ld06Decoder().feed(bytes(broken)))

    def test_the_clock_is_unwrapped(self) -> None:
        decoder = ld06.Ld06Decoder()
        data = b"".join(
            ld06.encode(np.radians([[0.0, 9.0]]), np.ones((1, 12)), np.zeros((1, 12), int), np.radians(3600), t)
            for t in (29.990, 29.998, 30.006, 59.0, 61.0)
        )
        times = np.concatenate([decoder.feed(data[i : i + 50]).packets["device_time"] for i in range(0, len(data), 50)])
        np.testing.assert_allclose(times, [29.990, 29.998, 30.006, 59.0, 61.0])

    def test_a_packet_wider_than_its_speed_allows_is_rejected(self) -> None:
        decoder = ld06.Ld06Decoder()
        wide = ld06.encode(np.radians([[0.0, 32.0]]), np.ones((1, 12)), np.zeros((1, 12), int), np.radians(3600), 0.0)
        assert not len(decoder.feed(wide))
        assert decoder.counters.implausible == 12

    @QUICK
    @given(
        ranges=arrays(np.float64, (2, 12), elements=st.integers(1, 65535).map(lambda mm: mm / 1000) | st.just(np.nan)),
        intensities=arrays(np.int64, (2, 12), elements=st.integers(0, 255)),
        begin=st.floats(0.0, 360.0),
    )
    def test_decoding_inverts_encoding(self, ranges: np.ndarray, intensities: np.ndarray, begin: float) -> None:
        angles = np.radians(begin + np.array([[0.0, 8.8], [9.6, 18.4]]))
        samples = ld06.Ld06Decoder().feed(ld06.encode(angles, ranges, intensities, 2 * np.pi * 10, 1.0)).samples
        np.testing.assert_allclose(samples["range"], ranges.ravel(), rtol=1e-12)
        np.testing.assert_array_equal(samples["quality"], intensities.ravel())
        expected = np.concatenate([np.linspace(*pair, 12) for pair in angles])
        assert np.abs(np.mod(-samples["angle"] - expected + np.pi, 2 * np.pi) - np.pi).max() <= np.radians(0.0051)


class TestScipLanguage:
    def test_known_checksums_and_values_are_reproduced(self) -> None:
        assert scip.checksum(b"00") == b"P"
        assert scip.checksum(b"99") == b"b"
        assert scip.strip_checksum(b"1Dh1Dhj") == b"1Dh1Dh"
        for text, width, value in ((b"1Dh", 3, 5432), (b"CB", 2, 1234)):
            values, good = scip.decode_values(np.frombuffer(text, np.uint8), width)
            assert (values.tolist(), good.tolist()) == ([value], [True])
            assert scip.encode_values(np.array([value]), width) == text
        values, good = scip.decode_values(np.frombuffer(b"1Dh1Dh", np.uint8), 3)
        assert values.tolist() == [5432, 5432]
        assert scip.MeasureRequest(44, 725).packet() == b"MD0044072501000\n"
        assert scip.MeasureRequest(44, 725, continuous=False).packet() == b"GD0044072501\n"

    @settings(deadline=None)
    @given(arrays(np.int64, st.integers(1, 50), elements=st.integers(0, (1 << 18) - 1)))
    def test_values_round_trip(self, values: np.ndarray) -> None:
        text = scip.encode_values(values, 3)
        got, good = scip.decode_values(np.frombuffer(text, np.uint8), 3)
        np.testing.assert_array_equal(got, values)
        assert good.all()

    def test_parameters_are_encoded_and_parsed(self) -> None:
        reply = scip.Reply(b"PP", "00", URG.lines(), 0)
        assert b"DMIN:20;" in reply.packet()
        (got,) = scip.ReplyParser().feed(reply.packet())
        assert scip.Parameters.parse(got) == URG
        assert pytest.approx(0.1 / 1024) == URG.step_period

    def test_invalid_parameters_are_rejected(self) -> None:
        lines = list(URG.lines())
        with pytest.raises(DriverError, match="make no sense"):
            scip.Parameters.parse(scip.Reply(b"PP", "00", tuple(lines[:-1]), 0))
        lines[2] = lines[2].replace(b"DMAX", b"DMAY")
        with pytest.raises(DriverError, match="damaged"):
            scip.Parameters.parse(scip.Reply(b"PP", "00", tuple(lines), 0))

    @settings(deadline=None)
    @given(st.lists(st.binary(max_size=20), max_size=10))
    def test_any_lines_are_parsed_or_rejected(self, texts: list[bytes]) -> None:
        lines = tuple(text + scip.checksum(text) for text in texts)
        with pytest.raises(DriverError):
            scip.Parameters.parse(scip.Reply(b"PP", "00", lines, 0))

    def test_replies_are_found_and_other_bytes_counted(self) -> None:
        reader = scip.ReplyParser()
        replies = reader.feed(b"noise\nQT\n00P\n\nQT\nE\n\nTM1\n00P\n00000\n\nMD\n99b\n")
        assert [(r.echo, r.status) for r in replies] == [(b"QT", "E"), (b"TM1", "00")]
        assert reader.bytes_skipped == len(b"noise\nQT\n00P\n")
        replies = reader.feed(b"\nQT\n00P\n\n")
        assert [(r.echo, r.status) for r in replies] == [(b"MD", "99"), (b"QT", "00")]
        assert scip.parse_clock(b"00000") == 0
        assert scip.parse_clock(b"00001") is None
        assert scip.parse_clock(b"") is None


class TestScipScan:
    def test_known_lines_are_decoded(self) -> None:
        """Two steps whose values and checksum are from the manual, preceded by the clock."""
        measure = scip.MeasureRequest(383, 384)
        far = scip.Parameters("UTM-30LX", 0.02, 60.0, 1440, 0, 1080, 384, 2400.0)
        decoder = scip_scan.ScipDecoder(far, measure)
        data = b"MD0383038401000\n00P\n\nMD0383038401000\n99b\n0?Ooa\n1Dh1Dhj\n\n"
        clock = scip.encode_values(np.array([1000]), 4)
        data = data.replace(b"0?Ooa", clock + scip.checksum(clock))
        measurements = decoder.feed(data)
        assert measurements.samples["range"].tolist() == [5.432, 5.432]
        assert measurements.samples["angle"] == pytest.approx([-2 * np.pi / 1440, 0.0])
        assert measurements.samples["start"].tolist() == [True, False]
        assert measurements.packets["device_time"].tolist() == [1.0]
        assert (measurements.samples["quality"] == NO_QUALITY).all()
        assert decoder.counters.bytes_skipped == 0

    @QUICK
    @given(
        ranges=arrays(np.float64, 228, elements=st.integers(20, 4095).map(lambda mm: mm / 1000) | st.just(np.nan)),
        clock=st.integers(0, (1 << 24) - 1),
        width=st.sampled_from([2, 3]),
        continuous=st.booleans(),
    )
    def test_decoding_inverts_encoding(self, ranges: np.ndarray, clock: int, width: int, continuous: bool) -> None:
        measure = scip.MeasureRequest(44, 725, 3, continuous, width)
        assert measure.count == 228
        decoder = scip_scan.ScipDecoder(URG, measure)
        measurements = decoder.feed(scip_scan.encode(ranges, measure, clock))
        np.testing.assert_allclose(measurements.samples["range"], ranges, rtol=1e-12)
        assert measurements.packets["device_time"][0] == pytest.approx(clock * 1e-3)
        assert measurements.samples["angle"][0] == pytest.approx((45 - 384) * 2 * np.pi / 1024)
        assert np.all(np.diff(measurements.samples["angle"]) > 0)

    def test_the_clock_is_unwrapped(self) -> None:
        measure = scip.MeasureRequest(44, 725)
        decoder = scip_scan.ScipDecoder(URG, measure)
        clocks = [(1 << 24) - 100, 0, 100]
        data = b"".join(scip_scan.encode(np.ones(682), measure, clock) for clock in clocks)
        times = decoder.feed(data).packets["device_time"]
        np.testing.assert_allclose(np.diff(times), 0.1)

    def test_error_codes_and_out_of_range_values_become_nan(self) -> None:
        measure = scip.MeasureRequest(44, 53)
        ranges = np.array([0.0, 0.001, 0.019, 0.02, 1.0, 5.6, 5.601, 5.0, 0.006, 2.0])
        got = scip_scan.ScipDecoder(URG, measure).feed(scip_scan.encode(ranges, measure, 0)).samples["range"]
        np.testing.assert_array_equal(np.isnan(got), [1, 1, 1, 0, 0, 0, 1, 0, 1, 0])

    def test_a_damaged_line_loses_only_its_beams(self) -> None:
        measure = scip.MeasureRequest(44, 725)
        data = bytearray(scip_scan.encode(np.full(682, 3.0), measure, 5))
        data[data.index(b"\n", 60) + 10] ^= 1
        decoder = scip_scan.ScipDecoder(URG, measure)
        ranges = decoder.feed(bytes(data)).samples["range"]
        assert 21 <= np.count_nonzero(np.isnan(ranges)) <= 22
        assert decoder.counters.checksum_failures == 1

    def test_replies_to_other_requests_are_skipped(self) -> None:
        other, mine = scip.MeasureRequest(45, 725), scip.MeasureRequest(44, 725)
        decoder = scip_scan.ScipDecoder(URG, mine)
        assert not len(decoder.feed(scip_scan.encode(np.ones(681), other, 5)))
        assert decoder.counters.bytes_skipped > 2000
        assert len(decoder.feed(scip_scan.encode(np.ones(682), mine, 5))) == 682

    @QUICK
    @given(
        ranges=arrays(np.float64, 20, elements=st.integers(20, 5000).map(lambda mm: mm / 1000)),
        farther=arrays(np.float64, 20, elements=st.integers(1, 600).map(lambda mm: mm / 1000) | st.just(np.nan)),
        intensities=arrays(np.float64, 20, elements=st.integers(0, (1 << 15) - 1)),
        continuous=st.booleans(),
    )
    def test_the_last_echo_and_its_intensity_are_decoded(
        self, ranges: np.ndarray, farther: np.ndarray, intensities: np.ndarray, continuous: bool
    ) -> None:
        measure = scip.MeasureRequest(100, 119, continuous=continuous, intensity=True, echoes=True)
        behind = ranges + farther
        data = scip_scan.encode(ranges, measure, 7, intensities=intensities, behind=behind)
        samples = scip_scan.ScipDecoder(URG, measure).feed(data).samples
        np.testing.assert_allclose(samples["range"], np.where(np.isnan(behind), ranges, behind), atol=5e-4)
        np.testing.assert_array_equal(samples["quality"], intensities)

    def test_known_echoes_are_decoded(self) -> None:
        """Three steps with two, three and one echo: ranges and intensities as in SCIP 2.2, six characters each."""
        measure = scip.MeasureRequest(100, 102, intensity=True, echoes=True)
        steps = [[(1000, 5), (3000, 90)], [(1500, 70), (2500, 8), (4, 900)], [(2000, 30)]]
        text = b"".join(b"&".join(scip.encode_values(np.array(echo), 3) for echo in echoes) for echoes in steps)
        clock = scip.encode_values(np.array([1000]), 4)
        lines = b"".join(line + scip.checksum(line) + b"\n" for line in (clock, text))
        data = b"NE0100010201000\n99b\n" + lines + b"\n"
        assert measure.packet() == b"NE0100010201000\n"
        for strongest, ranges, intensities in (
            (False, [3.0, 2.5, 2.0], [90, 8, 30]),
            (True, [3.0, 1.5, 2.0], [90, 70, 30]),
        ):
            samples = scip_scan.ScipDecoder(URG, measure, strongest=strongest).feed(data).samples
            assert samples["range"].tolist() == ranges  # an error code is no echo
            assert samples["quality"].tolist() == intensities

    def test_a_damaged_line_of_echoes_loses_the_scan(self) -> None:
        measure = scip.MeasureRequest(44, 725, echoes=True)
        intact = scip_scan.encode(np.full(682, 3.0), measure, 5, behind=np.full(682, 4.0))
        data = bytearray(intact)
        data[data.index(b"\n", 60) + 10] ^= 1
        decoder = scip_scan.ScipDecoder(URG, measure)
        assert not len(decoder.feed(bytes(data)))
        assert decoder.counters.checksum_failures == 1
        assert (decoder.feed(intact).samples["range"] == 4.0).all()

    @QUICK
    @given(st.lists(st.binary(max_size=70).map(lambda line: line.replace(b"\n", b"")), max_size=5))
    def test_any_lines_are_echoes_or_rejected(self, texts: list[bytes]) -> None:
        measure = scip.MeasureRequest(100, 102, intensity=True, echoes=True)
        clock = scip.encode_values(np.array([1000]), 4)
        lines = [clock, *(text for text in texts if text)]
        reply = scip.Reply(b"NE010001020100", "99", tuple(line + scip.checksum(line) for line in lines), 0)
        decoder = scip_scan.ScipDecoder(URG, measure)
        assert len(decoder.feed(reply.packet())) in (0, 3)
