"""The review log: a Rerun recording of what the pipeline did, keyframe by keyframe.

`ReviewLog` is the sink that receives the events; `EventLog` decides what each event becomes; the `*_layer` modules draw
one subject each; `RrdWriter` writes the rows to files and to connected viewers. Rerun is imported only when a ReviewLog
is created.
"""

from .review_log import ReviewLog
from .viewer import ViewerServer

__all__ = ["ReviewLog", "ViewerServer"]
