"""Sessions on disk, complete enough to be gone on from."""

from .head import Recording
from .store import StoredSession, is_stored, read_stored, write_stored

__all__ = ["Recording", "StoredSession", "is_stored", "read_stored", "write_stored"]
