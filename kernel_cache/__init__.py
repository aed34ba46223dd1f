"""Functions that numba compiles once: loaded from the installed wheel, or else from a cache on disk.

    from kernel_cache import compile_cached

    double = compile_cached(lambda x: 2.0 * x)

`features`, `drivers` and `slam` use it by their decorators, for all functions that numba compiles.
"""

from .functions import compile_cached, is_cached

__all__ = ["compile_cached", "is_cached"]
