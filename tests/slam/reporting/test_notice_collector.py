"""Warnings of a run."""

from slam.events import Notice
from slam.reporting.notice_collector import MAX_EQUAL_NOTICES, NoticeCollector


def test_equal_warnings_do_not_fill_the_memory() -> None:
    collector = NoticeCollector()
    for k in range(2 * MAX_EQUAL_NOTICES):
        collector.handle(Notice(float(k), "the scan fits nowhere"))
    collector.handle(Notice(7.0, "odometry slipped"))
    collector.handle(Notice(8.0, "all is well", "INFO"))
    assert len(collector.texts) == MAX_EQUAL_NOTICES + 2
    assert collector.texts[0] == "the scan fits nowhere (at 0.00 s)"
    assert collector.texts[-2:] == [
        f"more than {MAX_EQUAL_NOTICES} times: the scan fits nowhere",
        "odometry slipped (at 7.00 s)",
    ]
