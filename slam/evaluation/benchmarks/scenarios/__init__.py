"""Worlds and logs for benchmarks: variants of worlds, random buildings, crowds, and defects of recordings."""
