"""Formats of an RPLIDAR's measurements: known bytes, and encoded measurements decoded again."""

from __future__ import annotations

import struct
import zlib
from functools import reduce
from operator import xor

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from drivers.lidars.measurements import NO_QUALITY, StructuredArray
from drivers.lidars.rplidar import dense, express, hq, standard, ultra, ultra_dense
from drivers.lidars.rplidar.capsules import CapsuleDecoder, CapsuleFormat

PERIOD = 100e-6
QUICK = settings(max_examples=20, deadline=None)


def decoded(format: CapsuleFormat, data: bytes) -> StructuredArray:
    return CapsuleDecoder(format, PERIOD, 256000).feed(data).samples


def clockwise(samples: StructuredArray) -> np.ndarray:
    """Return the device's own angles in degrees."""
    return np.degrees(-samples["angle"]) % 360.0


def sealed(body: bytes) -> bytes:
    """Return a capsule with its sync nibbles and checksum, computed independently."""
    checksum = reduce(xor, body)
    return bytes([0xA0 | (checksum & 15), 0x50 | (checksum >> 4)]) + body


def capsule(prefix: str, filler: bytes, size: int) -> bytes:
    raw = bytes.fromhex(prefix)
    return raw + filler[: size - len(raw)]


class TestStandard:
    @pytest.mark.parametrize(
        ("node", "start", "quality", "degrees", "millimetres"),
        [
            ("3D 61 00 71 17", True, 15, 0.75, 1500.25),
            ("02 01 5A A0 0F", False, 0, 180.0, 1000.0),
            ("3E 9B 64 00 00", False, 15, 201.203125, np.nan),
        ],
    )
    def test_known_nodes_are_decoded(
        self, node: str, start: bool, quality: int, degrees: float, millimetres: float
    ) -> None:
        nodes = np.frombuffer(bytes.fromhex(node), standard.NODE)
        assert standard.check_bits_match(nodes).all()
        (sample,) = standard.decode_nodes(nodes)
        assert (bool(sample["start"]), int(sample["quality"])) == (start, quality)
        assert np.degrees(-sample["angle"]) % 360 == pytest.approx(degrees, abs=1e-9)
        assert sample["range"] == pytest.approx(millimetres * 1e-3, nan_ok=True)

    @pytest.mark.parametrize("node", ["3C 61 00 71 17", "3F 61 00 71 17", "3D 60 00 71 17"])
    def test_wrong_check_bits_are_detected(self, node: str) -> None:
        assert not standard.check_bits_match(np.frombuffer(bytes.fromhex(node), standard.NODE)).any()

    @QUICK
    @given(
        ranges=arrays(np.float64, 60, elements=st.floats(0.01, 16.0) | st.just(np.nan)),
        qualities=arrays(np.int64, 60, elements=st.integers(0, 63)),
        step=st.floats(0.1, 2.5),
        begin=st.floats(0.0, 6.28),
    )
    def test_decoding_inverts_encoding(
        self, ranges: np.ndarray, qualities: np.ndarray, step: float, begin: float
    ) -> None:
        angles = begin + np.radians(step) * np.arange(60)
        starts = np.arange(60) == 20
        data = standard.encode(angles, ranges, qualities, starts)
        samples = standard.StandardDecoder(PERIOD, 115200, triangulates=False).feed(data).samples
        known = len(samples)
        assert known == 60 - standard.CONFIRMING_NODES
        np.testing.assert_allclose(samples["range"], ranges[:known], atol=0.126e-3)
        np.testing.assert_array_equal(samples["quality"], qualities[:known])
        np.testing.assert_array_equal(samples["start"], starts[:known])
        error = np.mod(-samples["angle"] - angles[:known] + np.pi, 2 * np.pi) - np.pi
        assert np.abs(error).max() <= np.radians(1 / 128) + 1e-12


class TestExpress:
    def test_known_capsules_are_decoded(self) -> None:
        first = capsule("AE 57 80 D7 A0 0F 02 00 84", bytes(75), 84)
        second = capsule("A2 58 80 02", bytes(80), 84)
        samples = decoded(express.FORMAT, first + second)
        assert len(samples) == 32
        angles = clockwise(samples)
        assert angles[[0, 1, 16, 31]] == pytest.approx([349.5, 345.625, 0.0, 9.375], abs=1e-9)
        assert samples["range"][0] == pytest.approx(1.0)
        assert np.isnan(samples["range"][1:]).all()
        assert np.flatnonzero(samples["start"]).tolist() == [16]
        assert (samples["quality"] == NO_QUALITY).all()

    @pytest.mark.parametrize(
        ("cabin", "degrees", "millimetres"),
        [
            ("7E 09 72 09 DE", (5.75, 5.625), (607, 604)),
            ("66 09 5A 09 CE", (5.75, 5.5), (601, 598)),
            ("66 09 6E 09 CD", (5.625, 5.5), (601, 603)),
        ],
    )
    def test_corrections_are_unsigned(
        self, cabin: str, degrees: tuple[float, float], millimetres: tuple[int, int]
    ) -> None:
        """Cabins of a real lidar: their corrections agree with the geometry of the optics, within the resolution."""
        capsules = np.zeros(1, express.LAYOUT)
        capsules["cabins"][0, 0] = np.frombuffer(bytes.fromhex(cabin), express.CABIN)[0]
        returns = express.decode(capsules, capsules)
        assert returns.correction is not None
        assert tuple(returns.correction[0, :2]) == degrees
        assert returns.ranges[0, :2] * 1e3 == pytest.approx(millimetres)
        assert returns.correction[0, :2] == pytest.approx(ultra.correction(np.array(millimetres)), abs=0.3)

    @QUICK
    @given(
        ranges=arrays(np.float64, (3, 32), elements=st.integers(1, 16000).map(lambda mm: mm / 1000) | st.just(np.nan)),
        lag=arrays(np.float64, (3, 32), elements=st.integers(0, 63).map(lambda q: q / 8)),
        begin=st.floats(0.0, 6.28),
        step=st.floats(0.05, 0.3),
    )
    def test_decoding_inverts_encoding(self, ranges: np.ndarray, lag: np.ndarray, begin: float, step: float) -> None:
        heads = begin + step * np.arange(3)
        samples = decoded(express.FORMAT, express.encode(heads, ranges, np.radians(lag), reset=True))
        np.testing.assert_allclose(samples["range"], ranges[:2].ravel(), rtol=1e-12)
        expected = np.degrees(heads[:2, None] + step / 32 * np.arange(32)) - lag[:2]
        error = np.mod(clockwise(samples) - expected.ravel() + 180, 360) - 180
        assert np.abs(error).max() < 3 / 128


class TestDense:
    def test_known_capsules_are_decoded(self) -> None:
        words = struct.pack("<37H", *range(1003, 1040))
        first = bytes.fromhex("A2 5C 80 96 E8 03 D0 07 00 00") + words
        second = capsule("A9 51 00 19", bytes(80), 84)
        samples = decoded(dense.FORMAT, first + second)
        np.testing.assert_allclose(clockwise(samples), 90 + 0.25 * np.arange(40), atol=1e-9)
        np.testing.assert_allclose(samples["range"] * 1e3, [1000, 2000, np.nan, *range(1003, 1040)])
        assert not samples["start"].any()
        for at in range(84):
            for bit in range(8):
                broken = bytearray(first)
                broken[at] ^= 1 << bit
                assert not len(decoded(dense.FORMAT, bytes(broken) + second))

    def test_a_turn_within_a_capsule_starts_a_revolution(self) -> None:
        first = bytes.fromhex("A9 59 C0 59") + bytes.fromhex("F4 01") * 40
        second = bytes.fromhex("A2 50 00 02") + bytes.fromhex("F4 01") * 40
        samples = decoded(dense.FORMAT, first + second)
        assert clockwise(samples)[:6] == pytest.approx([359.0, 359.225, 359.45, 359.675, 359.9, 0.125], abs=1e-9)
        assert np.flatnonzero(samples["start"]).tolist() == [5]
        assert (samples["range"] == 0.5).all()

    def test_a_turn_between_capsules_starts_a_revolution(self) -> None:
        heads = np.radians([352.0, 0.0, 8.0])
        samples = decoded(dense.FORMAT, dense.encode(heads, np.ones((3, 40))))
        assert np.flatnonzero(samples["start"]).tolist() == [40]

    def test_offsets_refer_to_the_arrival_of_the_capsule_itself(self) -> None:
        data = dense.encode(np.radians([0.0, 4.0, 8.0]), np.ones((3, 40)))
        measurements = CapsuleDecoder(dense.FORMAT, 108.7e-6, 256000).feed(data)
        assert measurements.packets["end"].tolist() == [84, 168]
        line = 84 * 10 / 256000
        assert measurements.samples["offset"][39] == pytest.approx(-(line + 1.5 * 108.7e-6))
        assert measurements.samples["offset"][40] == pytest.approx(-(line + 40.5 * 108.7e-6))

    def test_a_reset_of_the_angle_discards_the_previous_capsule(self) -> None:
        decoder = CapsuleDecoder(dense.FORMAT, PERIOD, 256000)
        before = dense.encode(np.radians([0.0, 4.0]), np.ones((2, 40)), reset=True)
        after = dense.encode(np.radians([100.0, 104.0]), np.ones((2, 40)), reset=True)
        samples = decoder.feed(before + after).samples
        assert decoder.counters.discarded == 1
        assert clockwise(samples)[[0, 39, 40, 79]] == pytest.approx([0, 3.9, 100, 103.9], abs=0.01)

    def test_a_head_that_turns_back_is_rejected(self) -> None:
        decoder = CapsuleDecoder(dense.FORMAT, PERIOD, 256000)
        assert not len(decoder.feed(dense.encode(np.radians([10.0, 9.9]), np.ones((2, 40)))))
        assert decoder.counters.implausible == 40

    @QUICK
    @given(
        ranges=arrays(np.float64, (3, 40), elements=st.integers(1, 65535).map(lambda mm: mm / 1000) | st.just(np.nan)),
        begin=st.floats(0.0, 6.28),
        step=st.floats(0.01, 0.9),
    )
    def test_decoding_inverts_encoding(self, ranges: np.ndarray, begin: float, step: float) -> None:
        heads = begin + step * np.arange(3)
        samples = decoded(dense.FORMAT, dense.encode(heads, ranges))
        np.testing.assert_allclose(samples["range"], ranges[:2].ravel(), rtol=1e-12)
        expected = np.degrees(heads[:2, None] + step / 40 * np.arange(40)).ravel()
        assert np.abs(np.mod(clockwise(samples) - expected + 180, 360) - 180).max() < 3 / 128


class TestUltra:
    def test_known_capsules_are_decoded(self) -> None:
        first = capsule("A4 50 80 16 0B 52 40 FF 19 F2 1F 80", bytes(120), 132)
        second = capsule("A9 51 00 19", bytes(128), 132)
        assert first == sealed(first[2:])
        samples = decoded(ultra.FORMAT, first + second)
        assert len(samples) == 96
        assert samples["range"][:6] * 1e3 == pytest.approx([534, 544, 556, 562, np.nan, np.nan], nan_ok=True)
        expected = [84.574, 84.622, 84.670, 84.718, 82.917, 83.021]
        assert clockwise(samples)[:6] == pytest.approx(expected, abs=1e-3)  # the correction is quantised to 2^-16 rad

    @pytest.mark.parametrize(
        ("major", "value", "level"),
        [
            (480, 480, 0),
            (511, 511, 0),
            (512, 512, 1),
            (523, 534, 1),
            (1279, 2046, 1),
            (1280, 2048, 2),
            (1791, 4092, 2),
            (1792, 4096, 3),
            (3327, 16376, 3),
            (3328, 16384, 4),
            (4095, 28656, 4),
        ],
    )
    def test_known_majors_are_decoded_and_encoded(self, major: int, value: int, level: int) -> None:
        assert [int(part[0]) for part in ultra.decode_majors(np.array([major]))] == [value, level]
        assert ultra.encode_majors(np.array([value]))[0] == major

    def test_every_major_is_decoded_and_encoded_again(self) -> None:
        majors = np.arange(4096)
        np.testing.assert_array_equal(ultra.encode_majors(ultra.decode_majors(majors)[0]), majors)

    @pytest.mark.parametrize(
        ("millimetres", "degrees"),
        [(100, -5.84), (200, 1.16), (534, 5.43), (607, 5.76), (1000, 6.66), (2000, 7.33), (10000, 7.89), (49, 7.5)],
    )
    def test_angle_corrections_have_known_values(self, millimetres: int, degrees: float) -> None:
        assert ultra.correction(np.array([millimetres]))[0] == pytest.approx(degrees, abs=0.006)

    @QUICK
    @given(
        base=st.floats(0.2, 20.0),
        changes=arrays(np.float64, (3, 96), elements=st.floats(-0.1, 0.1)),
        lost=arrays(np.bool_, (3, 96)),
    )
    def test_decoding_inverts_encoding(self, base: float, changes: np.ndarray, lost: np.ndarray) -> None:
        """Distances near their neighbours are encoded to half a step of their level, others not at all; never wrong."""
        ranges = np.where(lost & (changes > 0), np.nan, base + changes)
        got = decoded(ultra.FORMAT, ultra.encode(np.radians([10.0, 20.0, 30.0]), ranges))["range"]
        wanted = ranges[:2].ravel()
        stored = ~np.isnan(got)
        assert not np.any(stored & np.isnan(wanted))
        assert np.abs(got[stored] - wanted[stored]).max(initial=0.0) <= 8.6e-3
        firsts = np.arange(0, len(wanted), 3)
        assert np.array_equal(np.isnan(got[firsts]), np.isnan(wanted[firsts]))
        built = ~np.isnan(ranges.ravel()[: len(wanted) + 1])
        expected = built[:-1][1::3] & built[:-1][0::3]
        assert np.all(stored[1::3][expected])

    @given(st.binary(min_size=128, max_size=128), st.binary(min_size=128, max_size=128))
    @QUICK
    def test_decoded_ranges_are_encoded_again(self, one: bytes, other: bytes) -> None:
        data = sealed(struct.pack("<H", 640) + one) + sealed(struct.pack("<H", 1280) + other)
        ranges = decoded(ultra.FORMAT, data)["range"].reshape(1, 96)
        ahead = ultra.decode(*(np.frombuffer(data[132:], ultra.LAYOUT),) * 2).ranges[0, 0]
        again = ultra.encode(np.radians([10.0]), ranges, ahead)
        again += ultra.encode(np.radians([20.0]), np.full((1, 96), ahead))
        second = decoded(ultra.FORMAT, again)["range"]
        stored = ~np.isnan(second)
        np.testing.assert_allclose(second[stored], ranges[0][stored], atol=8.1e-3)
        assert np.count_nonzero(stored) >= np.count_nonzero(~np.isnan(ranges[0, ::3]))


class TestUltraDense:
    @pytest.mark.parametrize(
        ("word", "millimetres", "quality"),
        [(0xC87D0, 1000, 200), (0xC87D1, 3546, 200), (0xC87D2, 10187, 200), (0xA07D3, 27067, 160)],
    )
    def test_known_words_are_unpacked_and_packed(self, word: int, millimetres: int, quality: int) -> None:
        assert [int(part[0]) for part in ultra_dense.unpack_words(np.array([word]))] == [millimetres, quality]
        assert ultra_dense.pack_words(np.array([millimetres]), np.array([quality]))[0] == word

    def test_a_known_cabin_is_decoded(self) -> None:
        capsules = np.zeros(1, ultra_dense.LAYOUT)
        capsules["cabins"][0, 0] = np.frombuffer(bytes.fromhex("D0 87 D1 87 CC"), ultra_dense.CABIN)[0]
        returns = ultra_dense.decode(capsules, capsules)
        assert returns.ranges[0, :2] == pytest.approx([1.0, 3.546])
        assert returns.quality is not None
        assert returns.quality[0, :2].tolist() == [200, 200]

    @QUICK
    @given(
        ranges=arrays(np.float64, (2, 64), elements=st.floats(0.02, 65.0) | st.just(np.nan)),
        qualities=arrays(np.int64, (2, 64), elements=st.integers(0, 255)),
    )
    def test_decoding_inverts_encoding(self, ranges: np.ndarray, qualities: np.ndarray) -> None:
        data = ultra_dense.encode(np.radians([350.0, 357.0]), ranges, qualities)
        assert len(data) == 340
        samples = decoded(ultra_dense.FORMAT, data)
        np.testing.assert_allclose(samples["range"], ranges[0], atol=3.6e-3)
        assert np.all(np.abs(samples["quality"] - qualities[0]) <= 7)
        assert np.all(samples["quality"] <= qualities[0])


class TestHq:
    def packet(self) -> bytes:
        nodes = struct.pack("<HIBB", 8192, 4000, 188, 1) + bytes(8 * 95)
        body = b"\xa5" + struct.pack("<Q", 123456) + nodes
        return body + struct.pack("<I", 0x8B818E8A)

    def test_a_known_packet_is_decoded(self) -> None:
        packet = self.packet()
        assert len(packet) == 781
        assert hq.crc32_of(packet) == zlib.crc32(packet[:777] + bytes(3)) == 0x8B818E8A
        samples = hq.HqDecoder(PERIOD, 1e6).feed(packet).samples
        assert len(samples) == 96
        assert np.degrees(-samples["angle"][0]) == pytest.approx(45.0)
        assert (samples["range"][0], samples["quality"][0], samples["start"][0]) == (1.0, 188, True)
        assert np.isnan(samples["range"][1:]).all()
        assert not samples["start"][1:].any()

    def test_the_known_packet_is_encoded(self) -> None:
        zeros = np.zeros((1, 96))
        angles, ranges, qualities, starts = zeros.copy(), zeros.copy(), zeros.astype(int), zeros.astype(bool)
        angles[0, 0], ranges[0, 0], qualities[0, 0], starts[0, 0] = np.pi / 4, 1.0, 188, True
        assert hq.encode(angles, ranges, qualities, starts, 123456) == self.packet()

    def test_damage_is_detected(self) -> None:
        packet = bytearray(self.packet())
        packet[400] ^= 4
        decoder = hq.HqDecoder(PERIOD, 1e6)
        assert not len(decoder.feed(bytes(packet) + self.packet()[:-1]))
