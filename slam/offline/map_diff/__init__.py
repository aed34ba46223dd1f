"""Compare two maps of one building: which walls and corners are new, gone or moved, and which were not seen again."""

from .changes import Change, ChangeKind, MapDiff
from .comparison import compare
from .surveys import Survey, survey_session

__all__ = ["Change", "ChangeKind", "MapDiff", "Survey", "compare", "survey_session"]
