"""Settings of all tests: a busy machine makes no test fail, and everything is compiled before the first one."""

import gc
from collections.abc import Iterator, Sequence
from functools import cache
from hashlib import blake2b

import pytest
from hypothesis import settings
from typer.main import get_command

from drivers import se2
from drivers.messages import Floats
from drivers.timing import beam_order, turns
from drivers.timing.beam_times import BeamTimes
from features.kernel import extract_features
from kernel_cache import is_cached
from slam.cli import COLLECTION_THRESHOLD

gc.set_threshold(COLLECTION_THRESHOLD)  # as on the command line: a tenth of the time, with all modules and tests loaded
# The same examples in each run: a failure is due to the last change. `make fuzz` tries others.
settings.register_profile("repeatable", deadline=None, derandomize=True)
settings.load_profile("repeatable")


def pytest_sessionstart(session: pytest.Session) -> None:
    """Compile if nothing is on disk yet: beside other programs that can take longer than a test may."""
    if not hasattr(session.config, "workerinput") and not is_cached(extract_features):
        from slam import warm_up

        warm_up()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with modules that share a long run: a process that takes over some of their tests would repeat the run."""
    items.sort(key=lambda item: item.get_closest_marker("shared_run") is None)
    gc.freeze()  # modules and tests stay to the end: collections of garbage need not search them, nor those at the end


@pytest.fixture(autouse=True, scope="session")
def no_messages_about_slowness() -> Iterator[None]:
    """Let no command print on stderr that it takes long: the listener to compilations stays for all later tests."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("slam.cli.console.SLOW_SECONDS", 120.0)
        patch.setattr("slam.cli.compilation_message.SLOW_SECONDS", 120.0)
        yield


@pytest.fixture(autouse=True, scope="session")
def command_line_is_built_once() -> Iterator[None]:
    """Build the commands and options once and not at each call of CliRunner: most of the time of a short command."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("typer.testing._get_command", cache(get_command))
        yield


@pytest.fixture(autouse=True, scope="session")
def code_stays_in_memory() -> Iterator[None]:
    """Do not return the code of imported libraries to the system at each run: the next test needs it again."""
    with pytest.MonkeyPatch.context() as patch:
        for module in ("slam_run", "run_writer", "autosave"):
            patch.setattr(f"slam.cli.{module}.return_code_of_imports", lambda: None)
        yield


@pytest.fixture(autouse=True, scope="session")
def scans_are_matched_once() -> Iterator[None]:
    """Keep the matches of scans from which the timing of a recording is estimated: most of the time that it takes to
    open one, and many tests open the same ones again.
    """
    measure, compare = turns._motion, beam_order._costs
    motions: dict[bytes, se2.Pose | None] = {}
    costs: dict[tuple[bytes, tuple[BeamTimes, ...]], tuple[float, ...] | None] = {}

    def measure_once(before: Floats, points: Floats, guess: se2.Pose) -> se2.Pose | None:
        key = digest(guess, before, points)
        if key not in motions:
            motions[key] = measure(before, points, guess)
        return motions[key]

    def compare_once(
        run: turns.Run, first: int, second: int, hypotheses: Sequence[BeamTimes]
    ) -> tuple[float, ...] | None:
        scans = [(scan.ranges, scan.angles, scan.time_offsets) for scan in (run.scans[first], run.scans[second])]
        motion = run.poses[[first, second]], run.twists[[first, second]]
        key = digest(*scans[0], *scans[1], *motion), tuple(hypotheses)
        if key not in costs:
            costs[key] = compare(run, first, second, hypotheses)
        return costs[key]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(turns, "_motion", measure_once)
        patch.setattr(beam_order, "_costs", compare_once)
        yield


def digest(*arrays: Floats) -> bytes:
    return blake2b(b"".join(array.tobytes() for array in arrays)).digest()
