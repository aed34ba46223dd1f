"""Write and read sessions: everything needed to continue or refine a run."""

from ..stored_session import StoredSession
from .header import Recording
from .session import is_session, read_session, write_session

__all__ = ["Recording", "StoredSession", "is_session", "read_session", "write_session"]
