"""The review log: what the pipeline did, keyframe by keyframe, as a Rerun recording for people to look at.

Rerun is imported only when a ReviewLog is made.
"""

from .server import ViewerServer
from .sink import ReviewLog

__all__ = ["ReviewLog", "ViewerServer"]
