"""Arduino sketch, compiled for the host with a simulated board: two motors, two encoders, a serial port."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest

import drivers.bases
from drivers.bases import DifferentialDrive, Odometer, Velocity, WheelLine

SKETCH = Path(drivers.bases.__file__).parent / "arduino" / "wheel_line" / "wheel_line.ino"
DRIVE = DifferentialDrive(left=1 / 5000, right=1 / 5000, track=0.30, bits=32, top_speed=0.6)
START_TIME = (1 << 32) - 1_000_000
"""Microseconds on the board's clock at the start: the clock wraps during the run."""

BOARD = r"""
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <string>
const int HIGH = 1, LOW = 0, CHANGE = 1, OUTPUT = 1, INPUT_PULLUP = 2;
template <class T> T constrain(T x, T low, T high) { return x < low ? low : x > high ? high : x; }
uint32_t board_time = %(starts)du;
int pins[32], duties[32];
void (*interrupt_of[32])();
uint32_t micros() { return board_time; }
void pinMode(int, int) {}
void digitalWrite(int pin, int value) { pins[pin] = value; }
void analogWrite(int pin, int value) { duties[pin] = value; }
int digitalRead(int pin) { return pins[pin]; }
int digitalPinToInterrupt(int pin) { return pin; }
void attachInterrupt(int pin, void (*handler)(), int) { interrupt_of[pin] = handler; }
void noInterrupts() {}
void interrupts() {}
struct {
  std::string input;
  void begin(uint32_t) {}
  int available() { return (int)input.size(); }
  int read() { int c = (unsigned char)input[0]; input.erase(0, 1); return c; }
  void print(const char *text) { fputs(text, stdout); }
} Serial;
%(prototypes)s
#include "%(sketch)s"
void turn(double &rest, uint8_t pwm, uint8_t direction, uint8_t a, uint8_t b) {
  double speed = 0.6 * duties[pwm] / 255 * (pins[direction] ? -1 : 1);  // m/s of the shaft
  for (rest += speed * 0.0001 * COUNTS_PER_METRE; fabs(rest) >= 1; rest -= rest > 0 ? 1 : -1) {
    pins[a] = !pins[a];
    pins[b] = rest > 0 ? !pins[a] : pins[a];
    interrupt_of[a]();
  }
}
int main() {
  double left = 0, right = 0;
  uint32_t at;
  char command[200];
  bool more = scanf("%%u %%199[^;];", &at, command) == 2;
  setup();
  for (uint32_t t = 0; t < 3000000; t += 100, board_time += 100) {
    while (more && t >= at) {
      Serial.input += command;
      more = scanf("%%u %%199[^;];", &at, command) == 2;
    }
    turn(left, LEFT_PWM, LEFT_DIRECTION, LEFT_A, LEFT_B);
    turn(right, RIGHT_PWM, RIGHT_DIRECTION, RIGHT_A, RIGHT_B);
    loop();
  }
}
"""


@pytest.fixture(scope="module")
def board(tmp_path_factory: pytest.TempPathFactory) -> Path:
    compiler = shutil.which("g++")
    if compiler is None:
        pytest.skip("no C++ compiler is installed")
    folder = tmp_path_factory.mktemp("board")
    signatures = re.findall(r"^\w[\w ]* \w+\([^;{]*\)(?= \{$)", SKETCH.read_text(), re.MULTILINE)
    prototypes = "struct Wheel;\n" + "".join(f"{signature.replace('IN_INTERRUPT ', '')};\n" for signature in signatures)
    source = BOARD % {"starts": START_TIME, "prototypes": prototypes, "sketch": SKETCH}
    (folder / "board.cpp").write_text(source)
    subprocess.run(
        [compiler, "-std=c++11", "-Wall", "-Wextra", "-Werror", "-o", folder / "board", folder / "board.cpp"],
        check=True,
    )
    return folder / "board"


def run(board: Path, commands: list[tuple[float, bytes]]) -> bytes:
    """Run the board for three seconds with bytes sent to it at times (seconds); return its output."""
    script = b"".join(b"%d %b;" % (round(at * 1e6), command) for at, command in commands)
    return subprocess.run([board], input=script, stdout=subprocess.PIPE, check=True).stdout


def test_the_sketch_sends_its_counts_on_time(board: Path) -> None:
    base = WheelLine(DRIVE)
    readings = base.feed(run(board, []))
    assert len(readings) == 150
    assert base.counters.bad == base.counters.lost == base.counters.skipped == 0
    times = [reading.time for reading in readings if reading.time is not None]
    assert times == [(START_TIME + 20_000 * i) % (1 << 32) for i in range(150)]
    assert {(reading.left, reading.right) for reading in readings} == {(0, 0)}


def test_the_sketch_drives_as_commanded_and_stops_without_commands(board: Path) -> None:
    base = WheelLine(DRIVE)
    readings = base.feed(run(board, [(1.0, base.start() + base.drive(Velocity(0.25, -0.5)))]))
    odometer = Odometer(DRIVE)
    poses = [odometer.add(reading, 0.02 * i) for i, reading in enumerate(readings)]
    assert odometer.counters.readings == 150
    assert poses[49] is not None
    assert poses[80] is not None
    assert not poses[49].pose.any()
    assert (readings[80].left, readings[80].right) == (readings[-1].left, readings[-1].right)
    distance = (readings[-1].left + readings[-1].right) / 2 * DRIVE.left
    assert distance == pytest.approx(0.25 * 0.5, rel=0.1)
    assert poses[80].pose[2] == pytest.approx(-0.5 * 0.5, rel=0.1)


@pytest.mark.parametrize(
    "damaged", [b"V,250,-500*78\n", b"V,250,-50079\n", b"V,250*66\n", b"x" * 300 + b"\n", b"*\n", b"\n"]
)
def test_the_sketch_ignores_damaged_commands(board: Path, damaged: bytes) -> None:
    assert not damaged.endswith(WheelLine(DRIVE).drive(Velocity(0.25, -0.5)))
    pieces = [(0.5 + 0.01 * i, damaged[150 * i : 150 * (i + 1)]) for i in range(len(damaged) // 150 + 1)]
    readings = WheelLine(DRIVE).feed(run(board, [piece for piece in pieces if piece[1]]))
    assert (readings[-1].left, readings[-1].right) == (0, 0)
    assert len(readings) == 150
