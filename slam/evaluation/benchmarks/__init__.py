"""Repeatable benchmarks, run by `wclm bench`."""
